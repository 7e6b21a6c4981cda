"""Colour tables for RGB engines: images and shaders."""
