"""Benchmarks of the rig, the compensators, the identification and the diagnosis."""
