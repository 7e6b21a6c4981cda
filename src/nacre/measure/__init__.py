"""Asking a Bsdf for numbers, as instruments do."""
