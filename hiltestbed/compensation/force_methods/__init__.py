"""Methods that correct the measured wrench, one per module."""
