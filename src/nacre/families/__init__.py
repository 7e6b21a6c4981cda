"""The families of materials: from the recipe keys over the physics to a Bsdf."""
