"""The force sensor: from the physical wrench to its reading."""
