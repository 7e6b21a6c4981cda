"""Units in files of other programs: their spellings, conversion, and readings of numbers without a unit."""

import tomllib
import unicodedata
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.errors import NacreError

Floats = NDArray[np.float64]

EV_NM = 1239.8419843320026  # h c / e in eV nm, exact in the SI of 2019
LIGHT_NM_S = 2.99792458e17  # speed of light, nm/s

VOCABULARY: dict[str, dict[str, Any]] = tomllib.loads(
    files("nacre.readers").joinpath("vocabulary.toml").read_text("utf-8")
)
# unit -> (dimension, factor to the SI unit; for lengths to nm)
UNITS: dict[str, tuple[str, float]] = {unit: (kind, factor) for unit, (kind, factor) in VOCABULARY["units"].items()}
SPECTRAL = ("length", "energy", "wavenumber", "frequency", "angular_frequency")
_CASED: dict[str, str] = VOCABULARY["cased"]
_UNIT_OF = {word: unit for unit, words in VOCABULARY["spellings"].items() for word in words.split()}


def normal(text: str) -> str:
    """Return a text with one form of each character: compatibility forms composed, one minus, one mu, one blank.

    Example:
        >>> normal("cm\\u207b\\u00b9  \\u00b5m")
        'cm-1 μm'
    """
    text = unicodedata.normalize("NFKC", text)
    for variant, standard in (("\u2212", "-"), ("\u2013", "-"), ("\u2010", "-"), ("\u2011", "-"), ("\u22c5", "·")):
        text = text.replace(variant, standard)
    return " ".join(text.replace("\ufeff", "").replace("\u200b", "").split())


def parse_unit(text: str) -> str | None:
    """Return a spelling's canonical unit, or None.

    Example:
        >>> [parse_unit(word) for word in ("µm", "cm^-1", "Microns", "Å", "%", "sample")]
        ['um', '1/cm', 'um', 'angstrom', '%', None]
    """
    word = normal(text).replace(" ", "").strip("'\"")
    if not word:
        return None
    if word in _CASED:
        return _CASED[word] or None
    return _UNIT_OF.get(word) or _UNIT_OF.get(word.lower()) or _UNIT_OF.get(word.lower().rstrip("."))


def spectral_unit(text: str) -> str | None:
    """Return the canonical unit of a wavelength, energy, wavenumber or frequency that a text spells, or None.

    Example:
        >>> spectral_unit("Angstroms"), spectral_unit("deg")
        ('angstrom', None)
    """
    unit = parse_unit(text)
    return unit if unit is not None and UNITS[unit][0] in SPECTRAL else None


def to_nm(values: ArrayLike, unit: str) -> Floats:
    """Convert a spectral quantity to vacuum wavelengths in nm; 0 becomes inf.

    Args:
        values: lengths, photon energies, wavenumbers, frequencies or angular frequencies.
        unit: a canonical unit of one of those dimensions.
    """
    kind, factor = UNITS[unit]
    scaled = np.asarray(values, dtype=float) * factor
    if kind == "length":
        return scaled
    if kind not in _TIMES_NM:
        raise NacreError(f'"{unit}" is not a unit of a wavelength, energy, wavenumber or frequency')
    with np.errstate(divide="ignore"):
        return _TIMES_NM[kind] / scaled


# product of a quantity and the wavelength in nm
_TIMES_NM = {
    "energy": EV_NM, "wavenumber": 1.0, "frequency": LIGHT_NM_S, "angular_frequency": 2.0 * np.pi * LIGHT_NM_S,
}  # fmt: skip
# unit -> whether numbers without one may be in it: a test of the least and the greatest number
_Readings = dict[str, Callable[[float, float], bool]]
# Optical tables of films, glasses and metals lie between 100 nm and some 100 um. Instruments: 190-3300 nm,
# 0.5-7 eV, infrared 350-12000 1/cm.
_OF_DIMENSION: dict[str, _Readings] = {
    "length": {
        "nm": lambda low, high: low >= 100.0 and high <= 50_000.0,
        "um": lambda low, high: low >= 0.05 and high <= 100.0 and low < 30.0,
        "angstrom": lambda low, high: low >= 1800.0 and 6000.0 <= high <= 100_000.0,
        "mm": lambda low, high: low >= 1e-4 and high < 0.02,
        "m": lambda low, high: low >= 1e-7 and high < 2e-5,
    },
    "energy": {
        "eV": lambda low, high: 0.005 <= low and high <= 60.0,
        "meV": lambda low, high: low >= 100.0 and high <= 10_000.0,
        "J": lambda low, high: high < 1e-15,
    },
    "wavenumber": {
        "1/cm": lambda low, high: low >= 50.0 and high <= 200_000.0,
        "1/um": lambda low, high: 0.02 <= low and high <= 20.0,
    },
    "frequency": {
        "THz": lambda low, high: 5.0 <= low and high <= 5000.0,
        "Hz": lambda low, high: 1e12 <= low and high <= 1e17,
    },
    "angular_frequency": {
        "rad/s": lambda low, high: 1e13 <= low and high <= 1e18,
        "rad/fs": lambda low, high: 0.1 <= low and high <= 30.0,
    },
}
# without a heading: narrower, as the quantity is unknown too
_OF_NONE: _Readings = {
    "nm": _OF_DIMENSION["length"]["nm"],
    "um": lambda low, high: low >= 0.05 and high <= 100.0,
    "eV": lambda low, high: 0.01 <= low and 1.3 <= high <= 20.0,
    "1/cm": lambda low, high: low >= 300.0 and high >= 2650.0 or low > 750.0 and high > 1300.0,
    "angstrom": _OF_DIMENSION["length"]["angstrom"],
    "m": _OF_DIMENSION["length"]["m"],
}


def spectral_units(values: Floats, quantity: str | None = None) -> tuple[str, ...]:
    """Return the plausible units for numbers without one.

    All numbers must be plausible in the unit.

    Args:
        values: finite numbers.
        quantity: "wavelength", "energy", "wavenumber", "frequency", "angular_frequency", or None if unknown.

    Example:
        >>> spectral_units(np.array([400.0, 700.0])), spectral_units(np.array([0.3, 6.0]))
        (('nm',), ('um', 'eV'))
    """
    low, high = float(np.min(values)), float(np.max(values))
    readings = _OF_NONE if quantity is None else _OF_DIMENSION["length" if quantity == "wavelength" else quantity]
    return tuple(unit for unit, is_plausible in readings.items() if is_plausible(low, high))


def in_range(values: Floats, units: Iterable[str]) -> str:
    """Return the readings of numbers for a message.

    Example:
        >>> in_range(np.array([0.3, 6.0]), ("um", "eV"))
        '300-6000 nm (um) or 206.6-4133 nm (eV)'
    """
    low, high = float(np.min(values)), float(np.max(values))
    ends = {unit: sorted(to_nm(np.array([low, high]), unit)) for unit in units}
    return " or ".join(f"{first:.4g}-{last:.4g} nm ({unit})" for unit, (first, last) in ends.items())


SHORTEST_NM, SOFT_X_RAY_NM = 10.0, 100.0  # optics of films begins in the extreme ultraviolet


def likely_unit(values: Floats, unit: str) -> str | None:
    """Return the unit that numbers are probably in if the stated unit puts them outside of optics; None: plausible.

    Example:
        >>> likely_unit(np.array([0.4, 0.75]), "nm"), likely_unit(np.array([400.0, 750.0]), "nm")
        ('um', None)
    """
    nm = to_nm(values, unit)
    low, high = float(nm.min()), float(nm.max())
    raw_low, raw_high = float(np.min(values)), float(np.max(values))
    if low < SHORTEST_NM and high < SOFT_X_RAY_NM:
        other = [u for u in ("um", "nm", "eV", "m", "mm") if u != unit and _is_common(raw_low, raw_high, u)]
        return other[0] if other else "another unit"
    if unit == "nm" and low >= 1800.0 and high >= 6000.0:
        return "angstrom or 1/cm"
    if unit == "eV" and 0.19 <= raw_low <= 0.45 and 0.65 <= raw_high < 1.65:
        return "um"  # covers the visible range in um; in eV it would be invisible
    if low > 1e5 and unit != "nm" and raw_low > 0:
        other = [u for u in ("nm", "um", "angstrom", "1/cm", "THz") if u != unit and _is_common(raw_low, raw_high, u)]
        return other[0] if other else ("another unit" if low > 1e7 else None)
    return None


def _is_common(low: float, high: float, unit: str) -> bool:
    ends = to_nm(np.array([low, high]), unit)
    return bool(ends.min() >= 90.0 and ends.max() <= 30_000.0)
