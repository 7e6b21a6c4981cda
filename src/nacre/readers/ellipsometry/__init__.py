"""Readers for files of ellipsometers: one module per format."""
