"""Reports and tables that a person reads."""
