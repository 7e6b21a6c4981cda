"""Optical constants: models, tables, the database, and their library of names."""
