"""The settings of the shipped platforms in a scenario, one file each."""
