"""The studio: a page on the user's own machine on which a recipe is turned like a knob and seen at once."""
