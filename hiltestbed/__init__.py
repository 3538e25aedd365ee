"""hiltestbed: a hardware-in-the-loop contact simulator for spacecraft docking, in software."""
