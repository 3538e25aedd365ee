"""The mechanisms that ship, one a module."""
