"""Illuminants and observers: the 1 nm tables behind every colour computation, and its wavelength grid.

The tables ship with the package (`tools/make_light_tables.py` writes them from colour-science) and are read on
first use.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean

ILLUMINANTS = ("A", "C", "D50", "D65", "E", "F2", "F11", "LED-B3")
OBSERVERS = ("2deg", "10deg")


@dataclass(frozen=True, eq=False)
class Illuminant:
    """A light's relative spectral power; unpacks as `wavelengths_nm, power = illuminant("D65")`.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        power: `[wavelength]`, relative power per nanometre, >= 0; its scale cancels in every colour.
        name: label in outputs.
    """

    wavelengths_nm: Array
    power: Array
    name: str = "custom"

    def __post_init__(self) -> None:
        wavelengths = np.asarray(self.wavelengths_nm, dtype=float)
        power = np.asarray(self.power, dtype=float)
        if wavelengths.ndim != 1 or wavelengths.shape != power.shape or len(wavelengths) < 2:
            raise NacreError(
                f"illuminant {self.name}: wavelengths_nm and power must be lists of one length, at least 2; "
                f"got shapes {wavelengths.shape} and {power.shape}"
            )
        if not (np.isfinite(wavelengths).all() and (np.diff(wavelengths) > 0).all()):
            raise NacreError(f"illuminant {self.name}: wavelengths_nm must ascend")
        if not (np.isfinite(power).all() and (power >= 0).all() and power.max() > 0):
            raise NacreError(f"illuminant {self.name}: power must be finite, never negative and somewhere positive")
        object.__setattr__(self, "wavelengths_nm", wavelengths)
        object.__setattr__(self, "power", power)

    def __iter__(self) -> Iterator[Array]:
        return iter((self.wavelengths_nm, self.power))

    def at(self, wavelengths_nm: Array) -> Array:
        """Return the power at any wavelengths: linear between samples, constant beyond the ends."""
        return np.interp(wavelengths_nm, self.wavelengths_nm, self.power)


@functools.cache
def _tables() -> dict[str, Array]:
    with resources.files("nacre.light").joinpath("data/cie_1nm.npz").open("rb") as file, np.load(file) as arrays:
        tables = {name: arrays[name] for name in arrays.files}
    for table in tables.values():
        table.setflags(write=False)  # shared by every caller
    return tables


def table_wavelengths_nm() -> Array:
    """Return the wavelengths of the tables: 360, 361, ..., 830."""
    return _tables()["wavelengths_nm"]


@functools.cache
def _standard_illuminant(name: str) -> Illuminant:
    return Illuminant(table_wavelengths_nm(), _tables()[f"illuminant {name}"], name)


def illuminant(name: str | Illuminant = "D65") -> Illuminant:
    """Return a standard illuminant on 360-830 nm in steps of 1 nm; an `Illuminant` passes through.

    Source: CIE 15:2018 (A, C, D50, D65, E, the fluorescent F2 and F11, the white LED-B3); interpolated to 1 nm
    with Sprague's formula, the last published value continued to 830 nm.

    Raises:
        NacreError: unknown illuminant.

    Example:
        >>> float(illuminant("D65").at(560.0))
        100.0
    """
    if isinstance(name, Illuminant):
        return name
    by_lower = {known.lower(): known for known in ILLUMINANTS}
    key = by_lower.get(str(name).lower())
    if key is None:
        raise NacreError(
            f'illuminant "{name}" is not known.{did_you_mean(str(name), ILLUMINANTS)} '
            f"Choose from {', '.join(ILLUMINANTS)}"
        )
    return _standard_illuminant(key)


def observer(name: str = "2deg") -> Array:
    """Return the colour matching functions `[wavelength, 3]` (x, y, z) on 360-830 nm in steps of 1 nm.

    Source: CIE 1931 standard observer ("2deg") and CIE 1964 standard observer ("10deg"), CIE 15:2018.

    Raises:
        NacreError: unknown observer.

    Example:
        >>> round(float(observer("2deg")[555 - 360, 1]), 3)
        1.0
    """
    if name not in OBSERVERS:
        raise NacreError(
            f'observer "{name}" is not known.{did_you_mean(str(name), OBSERVERS)} Choose from {", ".join(OBSERVERS)}'
        )
    return _tables()[f"observer {name}"]


WAVELENGTH_RANGE_NM = (360.0, 830.0)
# all of these divide 470 nm, so both ends are always on the grid
STEPS_NM = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
REFERENCE_NM = 550.0


def colour_step_nm(optical_thickness_nm: float = 0.0, finesse: float = 1.0) -> float:
    """Return the wavelength step at which a stack's colour is within 0.5 dE00 of a 1 nm or finer grid.

    Film fringes repeat every lambda^2 / (2 n d). The step samples each fringe 20 times at 550 nm, or 40 times if high
    finesse sharpens it.

    Args:
        optical_thickness_nm: sum of n d over the interfering layers.
        finesse: fringe spacing over fringe width; 1 for a plain film, above 2 for metal cavities and mirrors.

    Raises:
        NacreError: a negative or non-finite thickness, or one that needs a step below 0.01 nm.

    Example:
        >>> colour_step_nm(1.33 * 300), colour_step_nm(1.5 * 2000)  # a soap film, 2 um of glass
        (10.0, 2.0)
    """
    thickness, sharpness = float(optical_thickness_nm), float(finesse)
    if not (np.isfinite(thickness) and thickness >= 0.0 and np.isfinite(sharpness) and sharpness >= 0.0):
        raise NacreError(
            f"optical_thickness_nm and finesse must be finite and not negative; got {thickness:g} and {sharpness:g}"
        )
    if thickness == 0.0:
        return STEPS_NM[0]
    needed = REFERENCE_NM**2 / (40.0 * thickness) / (2.0 if sharpness > 2.0 else 1.0)
    for step in STEPS_NM:
        if step <= needed:
            return step
    raise NacreError(
        f"an optical thickness of {thickness / 1e6:g} mm needs a wavelength step of {needed:.2g} nm; "
        f"layers thicker than about {REFERENCE_NM**2 / 40 / STEPS_NM[-1] / 1e6:.1f} mm should be incoherent"
    )


def default_wavelengths(optical_thickness_nm: float = 0.0, finesse: float = 1.0, step_nm: float | None = None) -> Array:
    """Return ascending wavelengths from 360 to 830 nm, both included, with a given step or that of `colour_step_nm`.

    Raises:
        NacreError: an unusable thickness, or a step outside (0, 10].

    Example:
        >>> default_wavelengths().size, default_wavelengths(3000).size
        (48, 236)
    """
    low, high = WAVELENGTH_RANGE_NM
    step = colour_step_nm(optical_thickness_nm, finesse) if step_nm is None else float(step_nm)
    if not 0.001 <= step <= 10.0:
        raise NacreError(f"step_nm = {step:g} is not allowed; it should be from 0.001 to 10")
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)
