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
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.lobes.layered import Layered
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError, did_you_mean
from nacre.light import default_wavelengths
from nacre.matter.drawings import Drawer

Figure = Callable[..., dict[str, NDArray[Any]]]
Writer = Callable[[Path, str], list[str]]  # (path, a comment for the file) -> in words what the file does not hold


class Model(abc.ABC):
    """The frozen physics of one material.

    Attributes:
        noun: what a message calls it: "a film".
        why_unpolarised: the end of the sentence that refuses s and p where `spectrum` is left to the Bsdf.
        usual_parts: what a sweep stores of its spectrum unless told.
        usual_look: the geometry at which its colour is asked for unless told, as a want's `at`.
        is_quick: whether `bsdf` is solved in milliseconds, so that it may be asked for while a recipe is read.
        is_direct: whether a few directions cost a small part of the `bsdf`, without noise: see `values_at`.
        takes_ambient: whether it is built in the medium that another recipe puts it into.
        has_strata: whether it is walked through, so that strata of any family may lie on it: see `strata_at`.
        bytes_a_wavelength: memory that solving it takes, so that too many wavelengths are refused before.
    """

    version: ClassVar[int] = 1  # raise when the numbers of this model change; part of every fingerprint
    noun: ClassVar[str] = "material"
    why_unpolarised: ClassVar[str] = "is known for unpolarised light only"
    usual_parts: ClassVar[tuple[str, ...]] = ("specular_reflectance", "diffuse_reflectance")
    usual_look: ClassVar[str] = "specular 0"
    is_quick: ClassVar[bool] = False
    is_direct: ClassVar[bool] = False
    takes_ambient: ClassVar[bool] = True
    has_strata: ClassVar[bool] = False
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

    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the strata that it is walked through by, with its base, whatever form its `bsdf` has.

        Raises:
            UnsupportedError: it has none.
        """
        raise UnsupportedError(f"a {self.noun} is not made of strata that light walks through")

    def lost_at(self, theta_rad: Array, wavelengths_nm: Array, seed: int = 0) -> Array | None:
        """Return the light that a recipe's way of counting loses, `[angle, wavelength]`; None: it loses none.

        What is neither reflected nor transmitted, and absorbed by nothing: energy that the model's source does not
        account for, where a recipe asks to count as the source does.
        """
        return None

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Return what `bsdf` gives at a few pairs `[pair, 3]`, `[pair, wavelength]`, where that costs less than it.

        None: it does not, and the Bsdf is solved. A family that overrides it scatters, and has no lobe that is random;
        what its mirror-like lobes send into one direction alone is left out, as by `Bsdf.evaluate`.
        """
        return None

    def among_many(self, memory: dict[Any, Any], is_rough: bool = False) -> Model:
        """Return the model as one of the many near each other that a search tries.

        What hardly changes between them is looked up in `memory`, or kept there for the next one; an answer is judged
        by the model itself. A rough one may leave out what costs most, if it still ranks first draws.
        """
        return self

    @property
    def sketch(self) -> Model | None:
        """The model without what costs most and changes its colours least, for drafts; None: it has no such form.

        Nothing that is kept is made of it: what is told is a draft until the model itself has answered.
        """
        return None

    def likeness_at(
        self, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
    ) -> tuple[Array, Array] | None:
        """Return what a random walk would give at a few pairs `[pair, 3]`, without its noise: known, and guessed.

        For searches, which steer by it: cheap, and smooth in every number of the recipe. The value is about the sum of
        the two, each `[pair, wavelength]`, 1/sr; the second is the part that a walk may correct. None: there is none.

        Args:
            wi, wo: `[pair, 3]`, above the surface.
            wavelengths_nm: `[wavelength]`.
            is_fine: the better guess of two where there are two, at some hundred times the time.
        """
        return None

    @property
    def likeness_error(self) -> float | None:
        """The share of its fine guess by which `likeness_at` is off, as a standard deviation; None: not known."""
        return None

    def walked_at(
        self, wi: Array, wo: Array, wavelengths_nm: Array, walks: int, seed: int
    ) -> tuple[Array, Array] | None:
        """Return the values that belong to `likeness_at` and their standard errors, by a quick walk to a few viewers.

        None: there is none, and the Bsdf is walked.

        Args:
            wi, wo: `[pair, 3]`, above the surface.
            wavelengths_nm: `[wavelength]`.
            walks: for each light.
            seed: another one gives independent noise.
        """
        return None

    @property
    def slow_way(self) -> str:
        """The way that it takes by itself though it takes minutes, and how to name it; empty: there is none.

        Work that solves it many times builds it without that way, see `RecipeContext.is_low_fidelity`, and says so.
        """
        return ""

    @property
    def spared_way(self) -> str:
        """The way of minutes that a quick one stands in for because it is one of many; empty: nothing was spared."""
        return ""

    @property
    def spared_changes(self) -> Mapping[str, Any]:
        """Changes of the recipe, by path, that name the quick way where it stood in; an answer's file has them."""
        return {}

    @property
    def unbounded_because(self) -> str:
        """Why its spectra may sum to more than one: the data or the model chosen say so; empty: they never do."""
        return ""

    @property
    def outside(self) -> str:
        """Why its colours may be off, after the recipe's name: it lies where the model is not good; else empty."""
        return ""

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures that only this family has: kind -> function of its options that returns arrays."""
        return {}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """The fabrication files: format -> function of a request that returns the drawing."""
        return {}

    @property
    def own_formats(self) -> Mapping[str, Writer]:
        """The formats of other programs that hold what only this family has: format -> what writes the file."""
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
