"""Tests of the diagnosis of a single axis."""
