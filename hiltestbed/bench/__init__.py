"""Benchmarks: what the rig, the compensators, the identification and the diagnosis are worth, in numbers."""
