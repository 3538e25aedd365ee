"""What a run, or a scenario before it runs, amounts to: figures, ledger, stability, verdicts."""
