"""Effects of the numerical model."""
