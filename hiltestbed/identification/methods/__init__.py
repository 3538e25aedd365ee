"""Estimators of stiffness and damping, one a module."""
