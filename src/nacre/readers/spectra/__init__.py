"""Readers for files of spectrometers: by their content."""
