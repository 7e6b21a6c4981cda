"""A material on an object, under a light, as a picture."""
