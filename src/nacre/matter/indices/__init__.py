"""Optical constants: dispersion models, tables, the database, and material names."""
