"""Formulation: pigments, dyes and concentrations of an effect paint from a library."""
