"""Compensation of the delay, between the measured wrench and the commanded motion of the rig."""
