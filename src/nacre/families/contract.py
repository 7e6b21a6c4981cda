"""The interface of a family: `Model`, which every recipe builds, and one small class for each optional capability.

A family computes a `bsdf`. It gives more by deriving from the classes below (`Surrogate`, `Strata`, `Fabricable`, ...);
callers find them by `isinstance`, so that no code elsewhere depends on the family of a model.

                    light          viewer
                  wi  \\        / wo            z: the normal, towards the light
                       \\      /
      ambient           \\    /                 x, y: along the surface, parallel to u and v
      ==================================       interface 0, its upper face in contact with the ambient
      layer 0 / stratum 0 / particles          lists are ordered from the light inward
      ==================================       interface 1
      layer 1 / stratum 1
      ==================================
      substrate / base                         transmitted light leaves with wo_z < 0

Both directions point away from the surface; incidence angles are counted from z in the ambient.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.glints import DiffuseFlakes, LitFlakes
from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.bsdf.substrate import Strata as Strata  # one of the capabilities
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError, did_you_mean
from nacre.light import default_wavelengths
from nacre.matter.drawings import Drawer
from nacre.matter.periodic.order_tables import MAX_THETA
from nacre.matter.periodic.orders import Orders

if TYPE_CHECKING:
    from nacre.matter.stack.stack import Stack

Figure = Callable[..., dict[str, NDArray[Any]]]
Writer = Callable[[Path, str], list[str]]  # (path, a comment for the file) -> in words, the losses of the format


@dataclass(frozen=True)
class Traits:
    """Fixed facts about a family.

    Attributes:
        noun: name in messages, as in "a film".
        unpolarised_reason: end of the message that refuses s and p polarisation.
        default_geometry: measurement geometry of its colour in targets and sweeps.
        default_parts: parts of the spectrum that a sweep stores.
        is_quick: `bsdf` takes milliseconds and may be called while a recipe is read.
        takes_ambient: it can be built in the medium of another recipe.
        bytes_per_wavelength: memory of a solution, from which too many wavelengths are refused.
    """

    noun: str = "material"
    unpolarised_reason: str = "is known for unpolarised light only"
    default_geometry: str = "specular 0"
    default_parts: tuple[str, ...] = ("specular_reflectance", "diffuse_reflectance")
    is_quick: bool = False
    takes_ambient: bool = True
    bytes_per_wavelength: int = 50_000


class Model(abc.ABC):
    """The frozen physical parameters of one material.

    Attributes:
        traits: fixed facts about the family.
        version: raised when the family's numbers change, which invalidates stored results.
    """

    traits: ClassVar[Traits] = Traits()
    version: ClassVar[int] = 1

    @abc.abstractmethod
    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the optics and return the lobes.

        Args:
            wavelengths_nm: `[wavelength]`, ascending; default: `self.wavelengths_nm`.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """

    @property
    def wavelengths_nm(self) -> Array:
        """Default wavelength grid, ascending."""
        return default_wavelengths()

    def spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0
    ) -> Spectrum | None:
        """Return reflectance and transmittance `[angle, wavelength]`, or None for integration of the Bsdf.

        Args:
            theta_rad: `[angle]` in the ambient, in [0, pi/2].
            wavelengths_nm: `[wavelength]`; default: `self.wavelengths_nm`.
            polarisation: "s", "p" or "both".
            seed: random-walk seed.

        Raises:
            UnsupportedError: the polarisation is not known for a part of the spectrum.
        """
        return None

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of this family: name -> function of its options that returns arrays."""
        return {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limits of validity that this material exceeds, to be shown after the recipe's name."""
        return ()

    @property
    def surface_figures(self) -> Mapping[str, float]:
        """Figures of a measured surface for reports: name with its unit -> value."""
        return {}


# Stokes vectors of unit power, over the frame (p, s)
STOKES = {"p": (1.0, 1.0, 0.0, 0.0), "s": (1.0, -1.0, 0.0, 0.0), "both": (1.0, 0.0, 0.0, 0.0),
          "mueller": (1.0, 0.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0, 1.0), "left": (1.0, 0.0, 0.0, -1.0)}  # fmt: skip


class Polarised(Model):
    """A material whose spectra are known for circular light, as Mueller matrices, and from any azimuth."""

    @property
    def mixes_polarisations(self) -> bool:
        """Whether s light may be reflected as p light."""
        return False

    def spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None = None, polarisation: str = "both", seed: int = 0
    ) -> Spectrum:
        """Return `polarised_spectrum` for light from the azimuth 0."""
        return self.polarised_spectrum(theta_rad, wavelengths_nm, polarisation, 0.0)

    @abc.abstractmethod
    def polarised_spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, azimuth_rad: float
    ) -> Spectrum:
        """Return reflectance and transmittance `[angle, wavelength]`.

        Args:
            theta_rad: `[angle]` in the ambient, in [0, pi/2].
            wavelengths_nm: `[wavelength]`; default: `self.wavelengths_nm`.
            polarisation: "s", "p", "left", "right", "both", or "mueller" for "both" with Mueller matrices.
            azimuth_rad: azimuth of the direction towards the light, from u.

        Raises:
            UnsupportedError: the polarisation is not known for a part of the spectrum.
        """


class EnergyDefect(abc.ABC):
    """A material whose published model does not conserve energy."""

    @abc.abstractmethod
    def energy_defect(self, theta_rad: Array, wavelengths_nm: Array, seed: int = 0) -> Array | None:
        """Return the share of light that is neither reflected, transmitted nor absorbed, `[angle, wavelength]`.

        None for an energy-conserving recipe, or if the defect cannot be computed.
        """


class ExcessEnergy(abc.ABC):
    """A material whose spectra may sum to more than one."""

    @property
    @abc.abstractmethod
    def excess_reason(self) -> str:
        """Why its spectra may exceed one, or empty if they cannot."""


class DirectEvaluation(abc.ABC):
    """A material that can be evaluated at single direction pairs without a whole Bsdf.

    Attributes:
        is_direct: a few directions take a small fraction of the time of `bsdf`; searches evaluate only these.
    """

    is_direct: ClassVar[bool] = True

    @property
    def line_nm(self) -> float:
        """Standard deviation of the narrowest line over wavelength at fixed directions; infinite if there is none."""
        return np.inf

    @abc.abstractmethod
    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Evaluate `bsdf` at direction pairs `[pair, 3]`, without delta lobes; return `[pair, wavelength]`.

        None if any pair can only be evaluated with the whole Bsdf.
        """


class Surrogate(abc.ABC):
    """A material solved by random walks for which a smooth, noise-free approximation steers searches."""

    @abc.abstractmethod
    def surrogate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
    ) -> tuple[Array, Array] | None:
        """Return the exact and the approximate part of the BRDF at pairs, each `[pair, wavelength]`, 1/sr.

        Their sum approximates the Bsdf; a random walk may correct the second part. None if the surrogate does not apply
        to these parameters.

        Args:
            wi, wo: `[pair, 3]`, above the surface.
            wavelengths_nm: `[wavelength]`.
            is_fine: use the more accurate of two approximations, at about a hundred times the cost.
        """

    @property
    def surrogate_error(self) -> float | None:
        """Relative standard error of the fine surrogate's approximate part, if known."""
        return None

    def estimate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, walks: int, seed: int
    ) -> tuple[Array, Array] | None:
        """Return a Monte Carlo estimate of the BRDF at pairs and its standard error; None without a random walk.

        Args:
            wi, wo: `[pair, 3]`, above the surface.
            wavelengths_nm: `[wavelength]`.
            walks: number per light direction.
            seed: random seed; different seeds give independent noise.
        """
        return None


class SingleFlakes(Protocol):
    """Individual flakes of a material at given wavelengths."""

    def lit(self, theta_rad: float, lamp_rad: float, camera_rad: float) -> list[LitFlakes]:
        """Return the flakes under a lamp at an angle from the normal, seen along the normal.

        Args:
            theta_rad: angle between the normal and the lamp, in the ambient.
            lamp_rad, camera_rad: half angles of the cones to the lamp and to the entrance pupil of the camera.
        """
        ...

    def diffuse(self) -> list[DiffuseFlakes]:
        """Return the flakes under uniform diffuse light, seen along the normal."""
        ...


class ResolvedFlakes(abc.ABC):
    """A material of flakes that a camera resolves, with sparkle and graininess."""

    @abc.abstractmethod
    def single_flakes(self, wavelengths_nm: Array, weights: Array) -> SingleFlakes:
        """Return the flakes at given wavelengths.

        Args:
            wavelengths_nm: `[wavelength]`.
            weights: `[wavelength]`, whose sum with a reflectance factor is the luminance factor.

        Raises:
            UnsupportedError: a flake has no size, or there is no flake.
        """

    @property
    @abc.abstractmethod
    def over_black(self) -> Model:
        """The same flakes over a black base."""


class Mixed(abc.ABC):
    """A material made of others that share its surface."""

    @property
    @abc.abstractmethod
    def mixture(self) -> list[tuple[float, list[tuple[float, Model]]]]:
        """Parts of the surface: share of the surface, and the materials there with the factors on their Bsdfs."""


class Draft(abc.ABC):
    """A material with a cheaper form for drafts."""

    @property
    @abc.abstractmethod
    def draft(self) -> Model:
        """The model without its most expensive part, never used for stored results."""


class SearchFidelity(abc.ABC):
    """A material with a cheaper form for the candidates of a search."""

    @abc.abstractmethod
    def search_model(self, memory: dict[Any, Any], is_rough: bool = False) -> Model:
        """Return the model for a search among similar candidates.

        Args:
            memory: cache, shared by the candidates, for quantities that hardly change between them.
            is_rough: omit the most expensive part without effect on the ranking of first draws.
        """


class ExpensiveMethod(abc.ABC):
    """A material that may choose a method of minutes, which searches replace by a quick one."""

    @property
    @abc.abstractmethod
    def expensive_method(self) -> str:
        """Name of the expensive method that this model would use, or empty."""

    @property
    @abc.abstractmethod
    def is_distributed(self) -> bool:
        """Whether the model uses the expensive method, selected or named, so that a cluster can share its work."""

    @property
    @abc.abstractmethod
    def replaced_method(self) -> str:
        """Name of the expensive method that was replaced in this model, or empty."""

    @property
    @abc.abstractmethod
    def method_overrides(self) -> Mapping[str, Any]:
        """Recipe changes, by path, that select the replacement explicitly; solution files contain them."""


class Diffracting(Polarised):
    """A periodic material, whose light leaves in orders.

    Attributes:
        has_mirror: the zero order is specular; otherwise it is as wide as the others, and diffuse.
    """

    has_mirror: ClassVar[bool] = False

    @property
    def coarse_warning(self) -> str:
        """Warning about the error of coarse solutions if this model uses them for colours, or empty."""
        return ""

    @property
    @abc.abstractmethod
    def order_width_rad(self) -> float:
        """Angular standard deviation of each order."""

    @abc.abstractmethod
    def diffraction_orders(self, theta_rad: Array, azimuth_rad: float, wavelengths_nm: Array | None) -> Orders:
        """Return the orders of plane waves.

        Args:
            theta_rad: `[angle]` of incidence in the ambient.
            azimuth_rad: azimuth of the direction towards the light.
            wavelengths_nm: `[wavelength]`; default: `wavelengths_nm` of the model.
        """

    def transmits_orders(self, wavelengths_nm: Array) -> bool:
        """Whether transmitted orders are part of the spectra."""
        return False

    def scatters_orders(self, wavelengths_nm: Array) -> bool:
        """Whether orders beside the mirror propagate at some direction of the light."""
        return True

    @property
    def mixes_polarisations(self) -> bool:
        """Whether s light may be reflected as p light: the mirror of a grating, in conical incidence."""
        return self.has_mirror

    def polarised_spectrum(
        self,
        theta_rad: Array,
        wavelengths_nm: Array | None = None,
        polarisation: str = "both",
        azimuth_rad: float = 0.0,
    ) -> Spectrum:
        """Return the sums over orders, specular for the zero order of a mirror, diffuse for all others."""
        if polarisation not in STOKES or (polarisation == "mueller" and not self.has_mirror):
            known = ", ".join(name for name in STOKES if self.has_mirror or name != "mueller")
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use {known}')
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        orders = self.diffraction_orders(np.minimum(theta, MAX_THETA), azimuth_rad, wavelengths_nm)
        lam, is_zero = orders.wavelengths_nm, np.all(orders.numbers == 0, axis=1)
        is_specular = is_zero & self.has_mirror
        matrices = orders.mueller()
        powers = [np.nan_to_num(m[..., 0, :] @ np.array(STOKES[polarisation])) for m in matrices]
        back, through = ([p[..., part].sum(axis=-1) for part in (is_specular, ~is_specular)] for p in powers)
        is_clear = self.transmits_orders(lam)
        is_full = polarisation == "mueller"
        return Spectrum(
            lam,
            np.degrees(theta),
            back[0] if self.has_mirror else None,
            through[0] if self.has_mirror and is_clear else None,
            back[1],
            through[1] if is_clear else None,
            mueller_reflected=matrices[0][:, :, is_zero][:, :, 0] if is_full else None,
            mueller_transmitted=np.nan_to_num(matrices[1][:, :, is_zero][:, :, 0]) if is_full and is_clear else None,
        )


class Pixels(abc.ABC):
    """A periodic material whose cells, with numbers of their own, are the pixels of a picture."""

    @property
    @abc.abstractmethod
    def pitch_nm(self) -> tuple[float, float]:
        """Periods along x and y.

        Raises:
            UnsupportedError: the cell is not a rectangle.
        """

    @abc.abstractmethod
    def pixel_polygons(self) -> list[tuple[int, Array]]:
        """Return the layer and the corners `[corner, 2]` in nm of each shape, about the cell's centre."""


class Fabricable(abc.ABC):
    """A material that can be drawn for fabrication."""

    @property
    @abc.abstractmethod
    def fabrications(self) -> Mapping[str, Drawer]:
        """File formats: name -> function of a request that returns the drawing."""


class OwnFormats(abc.ABC):
    """A material with its own file formats."""

    @property
    @abc.abstractmethod
    def own_formats(self) -> Mapping[str, Writer]:
        """Formats: name -> function that writes the file."""


@runtime_checkable
class Masked(Protocol):
    """A model of two materials, the first one over the second by a mask over the surface."""

    first: Any
    second: Any
    mask: Any


@runtime_checkable
class RoughSurface(Protocol):
    """A model with a rough upper surface (`nacre.bsdf.facet_distributions.Roughness`)."""

    surface: Any


@runtime_checkable
class Ridged(Protocol):
    """A model that may have ridges of lamellae."""

    ridges: Any


@runtime_checkable
class Aligned(Protocol):
    """A model that is anisotropic if its particles are aligned."""

    @property
    def is_aligned(self) -> bool:
        """Whether the particles are aligned."""


@runtime_checkable
class BetweenMedia(Protocol):
    """A model between two media."""

    ambient: Any
    substrate: Any


@runtime_checkable
class Polarising(Protocol):
    """A model with Mueller matrices for polarised rendering."""

    def polarisation(self, wavelengths_nm: Array | None = None) -> InterfacePolarisation | None:
        """Tabulate the Mueller interface matrices; None: it is rendered as depolarising."""
        ...


@runtime_checkable
class SpecularStack(Protocol):
    """A model whose specular reflection is that of a stack of layers."""

    @property
    def specular_stack(self) -> Stack:
        """The stack.

        Raises:
            UnsupportedError: no light is reflected specularly.
        """
        ...


def figure_data(model: Model, name: str, **options: Any) -> dict[str, NDArray[Any]]:
    """Return the arrays of one of `model.figures`.

    Raises:
        UnsupportedError: the family has no such figure.
    """
    figures = model.figures
    if name in figures:
        return figures[name](**options)
    known = f"it has {', '.join(figures)}" if figures else "it has none of its own"
    hint = did_you_mean(name, figures)
    raise UnsupportedError(f'a {model.traits.noun} has no figure of kind "{name}".{hint} ({known})')


def is_direct(model: Model) -> bool:
    """Whether a few directions take a small fraction of the Bsdf's time, without noise."""
    return isinstance(model, DirectEvaluation) and model.is_direct


def values_at(model: Model, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
    """Return `DirectEvaluation.values_at` of a model that has it."""
    return model.values_at(wi, wo, wavelengths_nm) if isinstance(model, DirectEvaluation) else None


def narrowest_line_nm(model: Model) -> float:
    """Return a model's `DirectEvaluation.line_nm`, or infinity if it has no direct evaluation."""
    return model.line_nm if isinstance(model, DirectEvaluation) else np.inf


def search_model(model: Model, memory: dict[Any, Any], is_rough: bool = False) -> Model:
    """Return `SearchFidelity.search_model`, or the model itself if it lacks a cheaper form."""
    return model.search_model(memory, is_rough) if isinstance(model, SearchFidelity) else model


def surrogate_radiance(
    model: Model, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
) -> tuple[Array, Array] | None:
    """Return `Surrogate.surrogate_radiance`; None without a surrogate, or if single directions are quick."""
    if not isinstance(model, Surrogate) or is_direct(model):
        return None
    return model.surrogate_radiance(wi, wo, wavelengths_nm, is_fine)


def fabrications(model: Model) -> Mapping[str, Drawer]:
    """Return `Fabricable.fabrications`, or an empty table."""
    return model.fabrications if isinstance(model, Fabricable) else {}


def method_overrides(model: Model) -> Mapping[str, Any]:
    """Return `ExpensiveMethod.method_overrides`, or an empty table."""
    return model.method_overrides if isinstance(model, ExpensiveMethod) else {}


def energy_defect(model: Model, theta_rad: Array, wavelengths_nm: Array, seed: int = 0) -> Array | None:
    """Return `EnergyDefect.energy_defect` of a model that has it."""
    return model.energy_defect(theta_rad, wavelengths_nm, seed) if isinstance(model, EnergyDefect) else None
