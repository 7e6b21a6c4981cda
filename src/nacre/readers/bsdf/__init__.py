"""Readers of BSDF files: one module per format; `samples` has their common part."""
