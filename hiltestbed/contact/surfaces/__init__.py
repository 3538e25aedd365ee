"""Surfaces: the nearest point, its signed distance and normal."""
