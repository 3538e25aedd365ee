"""Methods that correct the platform's tracking, one per module."""
