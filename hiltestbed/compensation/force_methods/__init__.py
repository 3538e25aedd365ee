"""Methods that correct the measured wrench, one a module."""
