"""Gratings and pixels: layers with shapes that repeat in one or two directions, solved rigorously."""
