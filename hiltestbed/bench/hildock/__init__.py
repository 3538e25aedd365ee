"""HILDOCK-1: a benchmark problem for the delay compensation of a docking rig, in closed form.

The definition is docs/hildock.md; this package follows it line by line.
"""
