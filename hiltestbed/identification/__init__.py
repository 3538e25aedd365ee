"""Identification of stiffness and damping, axis by axis, during the contact."""
