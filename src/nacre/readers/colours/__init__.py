"""Readers for colour lists: by their content."""
