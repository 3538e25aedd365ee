"""Effects of the motion platform; they act on the three translations."""
