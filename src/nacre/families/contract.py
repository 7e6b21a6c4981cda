"""The interface of a family: the base class of every model that a recipe builds.

A family must compute its `bsdf`, and may give more: spectra of its own where integrating the Bsdf would lose
something (polarisation, a closed form), arrays for figures that only it has, data for fabrication files. What it does
not give has a default here, so no code elsewhere depends on the family of a model.

                    light          viewer
                  wi  \\        / wo            z: the normal, towards the light's side
                       \\      /
      ambient           \\    /                 x, y: along the surface; u, v run along them
      ==================================       interface 0, its upper face turned to the ambient
      layer 0 / stratum 0 / particles          lists run from the light's side inward
      ==================================       interface 1
      layer 1 / stratum 1
      ==================================
      substrate / base                         transmitted light leaves with wo_z < 0

Both directions point away from the surface; angles of incidence are counted from z in the ambient.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.spectrum import Spectrum
from nacre.errors import UnsupportedError, did_you_mean
from nacre.light import default_wavelengths
from nacre.matter.drawings import Drawer

Figure = Callable[..., dict[str, NDArray[Any]]]


class Model(abc.ABC):
    """The frozen physics of one material.

    Attributes:
        noun: what a message calls it: "a film".
        why_unpolarised: the end of the sentence that refuses s and p where `spectrum` is left to the Bsdf.
        usual_parts: what a sweep stores of its spectrum unless told.
        is_quick: whether `bsdf` is solved in milliseconds, so that it may be asked for while a recipe is read.
        takes_ambient: whether it is built in the medium that another recipe puts it into.
        bytes_a_wavelength: memory that solving it takes, so that too many wavelengths are refused before.
    """

    noun: ClassVar[str] = "material"
    why_unpolarised: ClassVar[str] = "is known for unpolarised light only"
    usual_parts: ClassVar[tuple[str, ...]] = ("specular_reflectance", "diffuse_reflectance")
    is_quick: ClassVar[bool] = False
    takes_ambient: ClassVar[bool] = True
    bytes_a_wavelength: ClassVar[int] = 50_000

    @abc.abstractmethod
    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the optics and return the lobes.

        Args:
            wavelengths_nm: `[wavelength]`, ascending; None: the model's own choice.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """

    @property
    def wavelengths_nm(self) -> Array:
        """The grid of the model's own choice, ascending."""
        return default_wavelengths()

    def spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0
    ) -> Spectrum | None:
        """Return reflectance and transmittance `[angle, wavelength]`, or None: then the Bsdf is integrated.

        Args:
            theta_rad: `[angle]` in the ambient, in [0, pi/2].
            wavelengths_nm: `[wavelength]`, or None: the model's own choice.
            polarisation: "s", "p" or "both".
            seed: of a random walk.

        Raises:
            UnsupportedError: a polarisation is asked of a part that has none.
        """
        return None

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Return what `bsdf` gives at a few pairs `[pair, 3]`, `[pair, wavelength]`, where that costs less than it.

        None: it does not, and the Bsdf is solved. A family that overrides it has no lobe that mirrors or is random.
        """
        return None

    @property
    def unbounded_because(self) -> str:
        """Why its spectra may sum to more than one: the data or the model chosen say so; empty: they never do."""
        return ""

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures that only this family has: kind -> function of its options that returns arrays."""
        return {}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """The fabrication files: format -> function of a request that returns the drawing."""
        return {}

    def figure_data(self, kind: str, **options: Any) -> dict[str, NDArray[Any]]:
        """Return the arrays of one of `figures`.

        Raises:
            UnsupportedError: there is no such figure.
        """
        figures = self.figures
        if kind in figures:
            return figures[kind](**options)
        known = f"it has {', '.join(figures)}" if figures else "it has none of its own"
        raise UnsupportedError(f'a {self.noun} has no figure of kind "{kind}".{did_you_mean(kind, figures)} ({known})')
