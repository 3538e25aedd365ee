"""Effects of the force sensor, in the order of its chain."""
