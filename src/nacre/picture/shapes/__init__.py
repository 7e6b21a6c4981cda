"""Shapes of our own: analytic or meshed finely enough to look smooth at 1024 pixels."""
