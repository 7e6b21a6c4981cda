"""Optical constants: n + ik of a material by name, database entry, formula or table.

`index("Ag").n_complex(wavelengths_nm)` is all that the optics needs. Outside the published range the answer is
an error, never a guess, unless `extrapolate="edge"` asks for the end values to be held.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import Array, ComplexArray, floats
from nacre.errors import MaterialRangeError, NacreError, UnknownMaterialError, did_you_mean
from nacre.matter.indices.database import catalogue, find_page, load_entry
from nacre.matter.indices.defaults import DEFAULTS, find_default
from nacre.matter.indices.models import Clear, Constant, Dispersion
from nacre.recipe.measures import written_as_number

Extrapolation = Literal["error", "edge"]

RANGE_TOLERANCE = 1e-9  # relative: 0.360 um in a file is 360 nm up to rounding
MIN_INDEX = 1e-6  # as the stack solver takes; no published one is below 0.01
MOST_REMEMBERED = 1000  # wavelengths of a call whose answer is kept for the next one
FILE_ENDS = (".csv", ".txt", ".dat", ".tsv", ".nk", ".yml", ".yaml")  # of tables, which a recipe names otherwise
MAX_INDEX = 100.0  # far above any material of optics: more is a formula in the wrong unit


@dataclass(frozen=True)
class OpticalConstant:
    """The complex refractive index n + ik of one material, k >= 0.

    Attributes:
        name: as the user wrote it; errors and plots show it.
        model: n + ik over wavelength.
        source: database entry, publication or recipe.
        splice: what was joined or continued beyond the published data; empty if nothing was.
        title: what the material is.
        extrapolate: "error", or "edge" to hold the end values outside the range.
    """

    name: str
    model: Dispersion
    source: str = ""
    splice: str = ""
    title: str = ""
    extrapolate: Extrapolation = "error"

    @property
    def range_nm(self) -> tuple[float, float]:
        """The wavelengths in which the constant is known (0 and infinity for a formula without a range)."""
        return self.model.range_nm

    def n_complex(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return n + ik at vacuum wavelengths, same shape.

        Raises:
            MaterialRangeError: a wavelength lies outside the published range and `extrapolate` is "error".
            NacreError: the formula gives no index there (n^2 < 0), or k < 0.

        Example: `index("SiO2").n_complex([587.6])` is 1.4585.
        """
        wavelengths = floats(wavelengths_nm, "wavelengths_nm")
        if wavelengths.size > MOST_REMEMBERED:
            return self._computed(wavelengths)
        return _remembered(self, wavelengths.tobytes()).reshape(wavelengths.shape).copy()

    def _computed(self, wavelengths: Array) -> ComplexArray:
        if not (np.isfinite(wavelengths).all() and (wavelengths > 0.0).all()):
            raise NacreError(f'"{self.name}": wavelengths_nm must be finite and positive')
        low, high = self.range_nm
        if wavelengths.size and (
            wavelengths.min() < low * (1.0 - RANGE_TOLERANCE) or wavelengths.max() > high * (1.0 + RANGE_TOLERANCE)
        ):
            if self.extrapolate == "error":
                raise MaterialRangeError(self._range_message(wavelengths))
        with np.errstate(all="ignore"):  # absurd coefficients overflow; the check below tells it in words
            values = np.asarray(self.model(np.clip(wavelengths, low, high)), dtype=np.complex128)
        self._check(values, wavelengths)
        return values

    def with_extrapolation(self, extrapolate: Extrapolation) -> OpticalConstant:
        """Return the same constant with another rule outside its range."""
        return self if extrapolate == self.extrapolate else replace(self, extrapolate=extrapolate)

    def without_absorption(self) -> OpticalConstant:
        """Return the same constant with k = 0."""
        return replace(self, model=Clear(self.model))

    def describe(self) -> IndexDescription:
        """Return what `nacre indices show` prints."""
        return IndexDescription(self.name, self.title, self.source, self.range_nm, self.splice)

    def _range_message(self, wavelengths: Array) -> str:
        low, high = self.range_nm
        asked = sorted({f"{wavelengths.min():g}", f"{wavelengths.max():g}"}, key=float)
        where = self.source.removeprefix(f"{self.name}: ")
        source = f" ({where})" if where and where != self.name else ""
        return (
            f'"{self.name}" is known from {low:g} to {high:g} nm{source}, but {"-".join(asked)} nm was asked for. '
            'Choose another entry, fewer wavelengths, or extrapolate = "edge" to hold the end values'
        )

    def _check(self, values: ComplexArray, wavelengths: Array) -> None:
        is_bad = ~(
            np.isfinite(values) & (values.real >= 0.0) & (np.abs(values) <= MAX_INDEX) & (np.abs(values) >= MIN_INDEX)
        )
        if is_bad.any():
            at = float(np.ravel(wavelengths)[np.flatnonzero(np.ravel(is_bad))[0]])
            raise NacreError(
                f'"{self.name}" has no usable refractive index at {at:g} nm: |n + ik| must lie between {MIN_INDEX:g} '
                f"and {MAX_INDEX:g}; check the coefficients (they are for the wavelength in um)"
            )
        if (values.imag < 0.0).any():
            at = float(np.ravel(wavelengths)[np.flatnonzero(np.ravel(values.imag) < 0.0)[0]])
            raise NacreError(
                f'"{self.name}" has k < 0 at {at:g} nm, which would be gain; nacre takes n + ik with k >= 0'
            )


@functools.lru_cache(maxsize=256)
def _remembered(constant: OpticalConstant, samples: bytes) -> ComplexArray:
    """Return n + ik at wavelengths given as bytes: one look at a film asks for the same ones a dozen times."""
    return constant._computed(np.frombuffer(samples))


def constant(value: complex, name: str | None = None) -> OpticalConstant:
    """Return the optical constant with one n + ik everywhere.

    Raises:
        NacreError: n < 0, k < 0, both zero, or not finite.
    """
    value = complex(value)
    if value.real < 0.0 or value.imag < 0.0 or value == 0.0:
        raise NacreError(
            f"a refractive index of {value:g} is not allowed; n and k of n + ik are 0 or positive, not both 0"
        )
    made = OpticalConstant(name or _show(value), Constant(value.real, value.imag), "given")
    made.n_complex([550.0])
    return made


def _show(value: complex) -> str:
    return f"n = {value.real:g}" + (f" + {value.imag:g}i" if value.imag else "")


@functools.cache
def named_constant(name: str) -> OpticalConstant:
    default = find_default(name)
    if default is not None:
        return OpticalConstant(default.name, default.build(), default.source, default.splice, default.title)
    if name.count("/") >= 2:
        return database_index(name)
    from nacre.recipe.model import show_value  # pydantic comes with it: only on the way to an error

    raise UnknownMaterialError(f"material {show_value(name)} {unknown_material(name)}")


def database_index(key: str) -> OpticalConstant:
    """Return the optical constant of one refractiveindex.info entry, "shelf/book/page".

    Where the entry tabulates n alone (or k for other wavelengths), k is 0; else the range is that of both.

    Raises:
        UnknownMaterialError: no such entry, or one without n.
    """
    page = find_page(key)
    entry = load_entry(page.key)
    source = f"{page.key}: {entry.reference}" if entry.reference else page.key
    splice = "" if entry.has_k else "the entry has no k where it has n; 0 is taken"
    return OpticalConstant(page.key, entry.model, source, splice, f"{page.book_title}; {page.title}")


def names_file(name: str) -> bool:
    """Whether the name of a material is that of somebody's table: it ends as such files do."""
    return name.lower().endswith(FILE_ENDS)


def unknown_material(name: str) -> str:
    """Return the end of the message for an unknown name: what is near, and where to look."""
    if number := written_as_number("n", name):
        return f"is text; a constant index stands without quotes: {number.rpartition(' ')[2]}"
    if names_file(name):
        return f'is the name of a file, not of a material; write {{file = "{name}"}} in its place'
    books = {page.key.split("/")[1] for page in catalogue().values()}
    if name in books:
        return f"has no default entry. Choose one for {{rii = ...}}: nacre indices search {name}"
    names = [d.name for d in DEFAULTS] + [alias for d in DEFAULTS for alias in d.aliases]
    element = re.match(r"[A-Z][a-z]?(?=[A-Z0-9]|$)", name)
    word = element[0] if element else (name.split() or ["..."])[0][:40]
    return f"is not known.{did_you_mean(name, names)} List: nacre indices search {word}"


@dataclass(frozen=True)
class IndexDescription:
    """A line of `nacre indices search` and the head of `nacre indices show`.

    Attributes:
        name: what a recipe writes: a name, or the key after `rii =`.
        title: what it is.
        source: where it comes from.
        range_nm: where it is known; None where the entry was not opened (search reads the catalogue only).
        splice: what was joined or continued beyond the published data.
        is_default: whether `name` is a bare name.
    """

    name: str
    title: str
    source: str
    range_nm: tuple[float, float] | None
    splice: str = ""
    is_default: bool = False
