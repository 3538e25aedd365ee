"""Compensation of the delay: between the measured wrench and the motion that the rig is told to make."""
