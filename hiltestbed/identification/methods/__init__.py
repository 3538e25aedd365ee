"""Estimators of stiffness and damping, one per module."""
