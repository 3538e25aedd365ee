"""Resynchronised prediction: the numerical model as it was when the force was felt, and the prediction from there."""
