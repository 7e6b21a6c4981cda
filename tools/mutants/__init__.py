"""Mutation test of the physics: what share of small errors, drawn at random, the quick tests notice."""
