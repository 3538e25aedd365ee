"""How often hidden causes are found in the records of the independent rig."""
