"""Simulated measurements of a Bsdf."""
