"""Films: stacks of thin layers on anything, smooth or rough, even or drained, flat or on ridges."""

from nacre.families.film.material import Film, FilmLayer
from nacre.families.film.ridges import Ridges

__all__ = ["Film", "FilmLayer", "Ridges"]
