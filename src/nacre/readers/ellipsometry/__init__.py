"""Readers for ellipsometer files: by their content."""
