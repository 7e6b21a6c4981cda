"""Readers for files of spectrometers: one module per maker or format."""
