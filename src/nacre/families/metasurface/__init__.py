"""Metasurfaces: a disordered monolayer of resonant spheres on a layered substrate.

angular -> sphere (one particle on a stack) -> neighbours, qca (the mean field) -> diffuse, corrections (the
diffuse light) -> compile (tables over angles and wavelengths) -> material, spec. structure, patterns and arrangement
give the particles' positions.
"""
