"""The shipped mechanisms, one per module."""
