"""Readers of BSDF files; `gonio_table` has their common part."""
