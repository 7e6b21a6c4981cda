"""Photonic glass: spheres packed in disorder, whose colour hardly changes with the angle."""
