"""Films: stacks of thin layers on a substrate, smooth or rough, of even or varying thickness, flat or on ridges."""

from nacre.families.film.material import Film, FilmLayer
from nacre.families.film.ridges import Ridges

__all__ = ["Film", "FilmLayer", "Ridges"]
