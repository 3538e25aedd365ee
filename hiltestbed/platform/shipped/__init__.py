"""The platforms that ship, one file each: what a scenario says of it, and the facility that it is."""
