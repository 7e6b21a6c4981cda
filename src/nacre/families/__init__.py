"""The families of materials: from the keys of a recipe over the physics to a Bsdf."""
