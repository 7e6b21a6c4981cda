"""Films: stacks of thin layers on anything, smooth or rough, even or drained, flat or on ridges."""

from nacre.film.material import Film, FilmLayer, Surface
from nacre.film.ridges import Ridges

__all__ = ["Film", "FilmLayer", "Ridges", "Surface"]
