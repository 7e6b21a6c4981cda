"""Metasurfaces: a disordered monolayer of resonant particles on a layered substrate.

`tmatrix` solves one particle on a stack, `monolayer` the mean field and the diffuse light, `ensemble` the multi-sphere
reference. `spec` and `material` are the recipe and the model.
"""
