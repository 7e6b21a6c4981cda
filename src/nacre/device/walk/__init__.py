"""The random walk through strata of flakes, for the renderer and for arrays."""
