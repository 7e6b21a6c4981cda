"""Readers for height maps of profilometers and scanning probe microscopes."""
