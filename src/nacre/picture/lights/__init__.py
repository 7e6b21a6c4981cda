"""Picture lights: studio lights, skies, rooms and streets, all with spectra."""
