"""Optimisation and inverse design: parameters, targets, merit functions, methods, results."""
