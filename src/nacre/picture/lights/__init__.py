"""The lights of pictures: studio lights, skies, rooms and streets, all with spectra."""
