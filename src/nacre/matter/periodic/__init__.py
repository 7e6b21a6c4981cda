"""Rigorous solvers of structures that are periodic in one or two directions."""
