"""Readers for ellipsometer files: one module per format."""
