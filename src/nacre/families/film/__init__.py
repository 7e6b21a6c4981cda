"""Films: stacks of thin layers on a substrate, smooth, rough or ridged, with uniform or varying thickness."""

from nacre.families.film.material import Film, FilmLayer
from nacre.families.film.ridges import Ridges

__all__ = ["Film", "FilmLayer", "Ridges"]
