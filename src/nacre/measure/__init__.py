"""Measuring a Bsdf, as instruments do."""
