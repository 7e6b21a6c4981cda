"""What lights a picture: lamps, skies, rooms and streets, spectral from end to end."""
