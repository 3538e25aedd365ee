"""What watches a run: safety limits, monitoring of the process, states kept for a replay."""
