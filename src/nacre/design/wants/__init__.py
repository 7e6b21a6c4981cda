"""Designs by wants: colours and spectra at geometries, of a material of any family."""
