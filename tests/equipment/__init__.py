"""Test equipment: a rig that shares no code with the package, random inputs, and the benchmarks
that need them.
"""
