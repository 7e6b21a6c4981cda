"""The random walk through strata with flakes, for the renderer and for arrays."""
