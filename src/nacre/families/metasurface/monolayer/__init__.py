"""The disordered monolayer at one wavelength: structure, mean field, coherent and diffuse light."""
