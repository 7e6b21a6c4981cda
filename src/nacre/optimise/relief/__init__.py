"""Inverse design of relief height maps."""
