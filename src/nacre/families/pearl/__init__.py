"""Pearlescent pigments: coated platelets and dyes in strata of resin over a base."""
