"""T-matrices of particles, free and above or inside a planar stack."""
