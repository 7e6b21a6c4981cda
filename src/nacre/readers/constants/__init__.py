"""Readers of optical constants: one module per format."""
