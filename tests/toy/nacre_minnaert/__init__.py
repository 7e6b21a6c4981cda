"""Minnaert's law of moonlight as a package of its own: what somebody else would write to add to nacre."""
