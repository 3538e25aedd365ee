"""Compiled kernels: how they are cached, bound to their arrays, and saved with their state."""
