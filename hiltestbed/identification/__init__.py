"""Identification of stiffness and damping, axis by axis, while the contact lasts."""
