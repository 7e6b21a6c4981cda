"""Measured and imported materials: a fifth family, whose physics was done by somebody's instrument."""
