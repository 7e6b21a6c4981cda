"""Measured and imported materials: a family without a model, whose BSDF comes from an instrument."""
