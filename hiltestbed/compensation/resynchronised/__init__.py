"""Resynchronised prediction: a delayed model, driven by the measured wrench, and a predictor that
starts from its state.
"""
