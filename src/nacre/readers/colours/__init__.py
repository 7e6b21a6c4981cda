"""Readers for colour lists: one module per format."""
