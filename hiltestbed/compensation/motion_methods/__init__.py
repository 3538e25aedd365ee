"""Ways to tell the platform where to go, one a module."""
