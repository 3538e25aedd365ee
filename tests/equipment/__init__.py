"""Test equipment: a rig that shares no code with the package, and the benchmark that needs it."""
