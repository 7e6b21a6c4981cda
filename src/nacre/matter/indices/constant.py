"""Optical constants: n + ik of a material by name, database entry, formula or table.

`index("Ag").n_complex(wavelengths_nm)` is the interface to the optics. Outside the published range it raises an error,
unless `extrapolate="edge"` selects the end values.

Every named material covers 360-830 nm. Most names in `materials.toml` are one entry of the refractiveindex.info
database. If no entry covers the range, `splice` describes the substitute, and `nacre indices show` prints it.
"""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray, floats
from nacre.core.errors import MaterialRangeError, NacreError, UnknownMaterialError, did_you_mean
from nacre.matter.indices import models
from nacre.matter.indices.database import catalogue, find_page, load_entry
from nacre.recipe.model import written_as_number

Extrapolation = Literal["error", "edge"]

RANGE_TOLERANCE = 1e-9  # relative: 0.360 um in a file is 360 nm up to rounding
MIN_INDEX = 1e-6  # as in the stack solver; published indices are above 0.01
MAX_CACHED_WAVELENGTHS = 1000  # longer arrays are not cached
# suffixes of tables, not material names
FILE_ENDS = (".csv", ".txt", ".dat", ".tsv", ".nk", ".mat", ".spd", ".nxs", ".yml", ".yaml")
# factor by which a table's wavelengths would cover a request -> what is probably wrong
WRONG_UNITS = {
    1e3: "They would fit in um; write it in the heading, or state unit",
    1e-3: "They would fit in nm; write it in the heading, or state unit",
    0.1: "They would fit in angstrom; write it in the heading, or state unit",
    10.0: "They would fit in nm; write it in the heading, or state unit",
}
MAX_INDEX = 100.0  # far above any optical material: a larger value indicates a wrong unit


@dataclass(frozen=True)
class OpticalConstant:
    """The complex refractive index n + ik of one material, k >= 0.

    Attributes:
        name: the user's spelling, for errors and plots.
        model: n + ik as a function of wavelength.
        source: database entry, publication or recipe.
        splice: data joined or continued beyond the published range; may be empty.
        title: description.
        extrapolate: "error", or "edge" for the end values outside the range.
    """

    name: str
    model: models.Dispersion
    source: str = ""
    splice: str = ""
    title: str = ""
    extrapolate: Extrapolation = "error"

    @property
    def range_nm(self) -> tuple[float, float]:
        """Valid wavelength range (0 to infinity for a formula without a range)."""
        return self.model.range_nm

    def n_complex(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return n + ik at vacuum wavelengths, same shape.

        Raises:
            MaterialRangeError: a wavelength lies outside the published range and `extrapolate` is "error".
            NacreError: the formula gives no index there (n^2 < 0), or k < 0.

        Example:
            >>> from nacre.matter import index
            >>> round(float(index("SiO2").n_complex([587.6])[0].real), 4)
            1.4585
        """
        wavelengths = floats(wavelengths_nm, "wavelengths_nm")
        if wavelengths.size > MAX_CACHED_WAVELENGTHS:
            return self._computed(wavelengths)
        return _cached_index(self, wavelengths.tobytes()).reshape(wavelengths.shape).copy()

    def _computed(self, wavelengths: Array) -> ComplexArray:
        if not (np.isfinite(wavelengths).all() and (wavelengths > 0.0).all()):
            raise NacreError(f'"{self.name}": wavelengths_nm must be finite and positive')
        low, high = self.range_nm
        if wavelengths.size and (
            wavelengths.min() < low * (1.0 - RANGE_TOLERANCE) or wavelengths.max() > high * (1.0 + RANGE_TOLERANCE)
        ):
            if self.extrapolate == "error":
                raise MaterialRangeError(self._range_message(wavelengths))
        with np.errstate(all="ignore"):  # absurd coefficients overflow; the check below reports them
            values = np.asarray(self.model(np.clip(wavelengths, low, high)), dtype=np.complex128)
        self._check(values, wavelengths)
        return values

    def with_extrapolation(self, extrapolate: Extrapolation) -> OpticalConstant:
        """Return the same constant with another extrapolation rule."""
        return self if extrapolate == self.extrapolate else replace(self, extrapolate=extrapolate)

    def without_absorption(self) -> OpticalConstant:
        """Return the same constant with k = 0."""
        return replace(self, model=models.Clear(self.model))

    def describe(self) -> IndexDescription:
        """Return the data of `nacre indices show`."""
        return IndexDescription(self.name, self.title, self.source, self.range_nm, self.splice)

    def _range_message(self, wavelengths: Array) -> str:
        low, high = self.range_nm
        requested = sorted({f"{wavelengths.min():g}", f"{wavelengths.max():g}"}, key=float)
        where = self.source.removeprefix(f"{self.name}: ")
        source = f" ({where})" if where and where != self.name else ""
        text = (
            f'"{self.name}" is known from {low:g} to {high:g} nm{source}, but {"-".join(requested)} nm was requested. '
        )
        first, last = float(wavelengths.min()), float(wavelengths.max())
        wrong = next((f for f in WRONG_UNITS if low * f <= first and last <= high * f), None)
        if names_file(self.source) and wrong is not None:
            return f"{text}Is the unit of its wavelengths right? {WRONG_UNITS[wrong]}"
        return f'{text}Choose another entry, fewer wavelengths, or extrapolate = "edge" to use the end values'

    def _check(self, values: ComplexArray, wavelengths: Array) -> None:
        is_bad = ~(
            np.isfinite(values) & (values.real >= 0.0) & (np.abs(values) <= MAX_INDEX) & (np.abs(values) >= MIN_INDEX)
        )
        if is_bad.any():
            at = float(np.ravel(wavelengths)[np.flatnonzero(np.ravel(is_bad))[0]])
            is_table = names_file(self.source)
            check = "rows of the file" if is_table else "coefficients (they are for the wavelength in um)"
            raise NacreError(
                f'"{self.name}" has no usable refractive index at {at:g} nm: |n + ik| must lie between {MIN_INDEX:g} '
                f"and {MAX_INDEX:g}; check the {check}"
            )
        if (values.imag < 0.0).any():
            at = float(np.ravel(wavelengths)[np.flatnonzero(np.ravel(values.imag) < 0.0)[0]])
            raise NacreError(
                f'"{self.name}" has k < 0 at {at:g} nm, which would be gain; nacre takes n + ik with k >= 0'
            )


@functools.lru_cache(maxsize=256)
def _cached_index(constant: OpticalConstant, samples: bytes) -> ComplexArray:
    """Return n + ik at wavelengths given as bytes; one evaluation of a film repeats the same request many times."""
    return constant._computed(np.frombuffer(samples))


def constant(value: complex, name: str | None = None) -> OpticalConstant:
    """Return an optical constant without dispersion.

    Raises:
        NacreError: n < 0, k < 0, both zero, or not finite.
    """
    value = complex(value)
    if value.real < 0.0 or value.imag < 0.0 or value == 0.0:
        raise NacreError(
            f"a refractive index of {value:g} is not allowed; n and k of n + ik are 0 or positive, not both 0"
        )
    made = OpticalConstant(name or _show(value), models.Constant(value.real, value.imag), "given")
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
    from nacre.recipe.model import show_value  # imports pydantic: only for an error message

    raise UnknownMaterialError(f"material {show_value(name)} {unknown_material(name)}")


def database_index(key: str) -> OpticalConstant:
    """Return the optical constant of one refractiveindex.info entry, "shelf/book/page".

    If the entry tabulates only n (or k for other wavelengths), k is 0; otherwise the range is the overlap.

    Raises:
        UnknownMaterialError: unknown entry, or one without n.
    """
    page = find_page(key)
    entry = load_entry(page.key)
    source = f"{page.key}: {entry.reference}" if entry.reference else page.key
    splice = "" if entry.has_k else "the entry lacks k in the range of n; k = 0 is used"
    return OpticalConstant(page.key, entry.model, source, splice, f"{page.book_title}; {page.title}")


def names_file(name: str) -> bool:
    """Whether a material name has the suffix of a table file."""
    return name.lower().endswith(FILE_ENDS)


def unknown_material(name: str) -> str:
    """Return the message's end for an unknown name: the nearest names and the search command."""
    if number := written_as_number("n", name):
        return f"is text; a constant index stands without quotes: {number.rpartition(' ')[2]}"
    if names_file(name):
        return f'is the name of a file, not of a material; write {{file = "{name}"}} in its place'
    if hint := scattering_hint(name):
        return f"is not an optical constant: {hint}"
    books = {page.key.split("/")[1] for page in catalogue().values()}
    if name in books:
        return f"has no default entry. Choose one for {{rii = ...}}: nacre indices search {name}"
    names = [d.name for d in DEFAULTS] + [alias for d in DEFAULTS for alias in d.aliases]
    element = re.match(r"[A-Z][a-z]?(?=[A-Z0-9]|$)", name)
    word = element[0] if element else (name.split() or ["..."])[0][:40]
    return f"is not known.{did_you_mean(name, names)} List: nacre indices search {word}"


# albedos of matt materials that people name, for the hint
_ALBEDOS = {"black": 0.04, "paper": 0.8, "white": 0.8, "paint": 0.5, "wood": 0.3, "cardboard": 0.5, "textile": 0.4}


def scattering_hint(text: str) -> str:
    """Return how to describe a matt material, such as "black paper", that is named like an optical constant, or ""."""
    words = text.lower().replace("-", " ").split()
    matching = [word for word in _ALBEDOS if word in words]
    if not matching:
        return ""
    albedo = min(_ALBEDOS[word] for word in matching)
    return f'{" ".join(words)} scatters light; write substrate = "glass" with base = {{albedo = {albedo:g}}}'


@dataclass(frozen=True)
class IndexDescription:
    """A line of `nacre indices search` and the head of `nacre indices show`.

    Attributes:
        name: a material name, or the key after `rii =`.
        title: description.
        source: database entry, publication or recipe.
        range_nm: valid wavelength range; unset in search results, which read only the catalogue.
        splice: data joined or continued beyond the published range.
        is_default: whether `name` is a material name.
    """

    name: str
    title: str
    source: str
    range_nm: tuple[float, float] | None
    splice: str = ""
    is_default: bool = False


COLOUR_RANGE_NM = (360.0, 830.0)


@dataclass(frozen=True)
class Default:
    """One named material.

    Attributes:
        name: name in recipes.
        title: description.
        build: returns the dispersion model.
        source: database keys or literature.
        splice: data joined or continued beyond the published range; may be empty.
        aliases: other spellings.
    """

    name: str
    title: str
    build: Callable[[], models.Dispersion]
    source: str
    splice: str = ""
    aliases: tuple[str, ...] = ()


def _default(name: str, data: Mapping[str, Any]) -> Default:
    """Return a material of `materials.toml`, which describes the forms."""

    def made(build: Callable[[], models.Dispersion], source: str, splice: str = "") -> Default:
        return Default(name, data["title"], build, source, splice, tuple(data.get("aliases", ())))

    match data:
        case {"n": n, "source": source}:
            return made(lambda: models.Constant(n), f"n = {n:g}: {source}")
        case {"abbe": [n_d, abbe]}:
            source = f"n_d = {n_d:g}, Abbe number {abbe:g}: Guillen et al. 2020, table A1"
            splice = "no database entry; the two-term Cauchy formula through n_d and the Abbe number, no absorption"
            return made(lambda: models.abbe_cauchy(n_d, abbe), source, splice)
        case {"cauchy": coefficients, "source": source, "splice": splice}:
            return made(lambda: models.Cauchy(tuple(coefficients)), source, splice)
        case {"n_entry": n_key, "k_entry": k_key}:
            splice = "n and k come from two entries, since the entry with the better n lacks k"
            joined = f"{n_key} (n) and {k_key} (k)"
            return made(lambda: models.Joined(load_entry(n_key).model, load_entry(k_key).model), joined, splice)
        case {"entry": key, "tail_nm": [first, second, third], "splice": splice}:
            return made(lambda: _with_tail(load_entry(key).model, (first, second, third)), key, splice)
        case {"entry": key, "continued": remark}:
            splice = f"the entry's formula is continued to 360 nm; {remark}"
            return made(lambda: models.Continued(load_entry(key).model, *COLOUR_RANGE_NM), key, splice)
        case _:
            return made(lambda: load_entry(data["entry"]).model, data["entry"])


def _with_tail(published: models.Dispersion, tail_nm: tuple[float, float, float]) -> models.Dispersion:
    tail = models.cauchy_tail(published, tail_nm, COLOUR_RANGE_NM[0])
    return models.Spliced(tail, published, published.range_nm[0])


DEFAULTS: tuple[Default, ...] = tuple(
    _default(name, data)
    for name, data in tomllib.loads(files(__package__).joinpath("materials.toml").read_text("utf-8")).items()
)
BY_NAME: dict[str, Default] = {d.name: d for d in DEFAULTS}
BY_ANY_NAME: dict[str, Default] = {
    **{alias.lower(): d for d in DEFAULTS for alias in d.aliases},
    **{d.name.lower(): d for d in DEFAULTS},
}


def find_default(name: str) -> Default | None:
    """Return the named material, ignoring case, or None."""
    return BY_NAME.get(name) or BY_ANY_NAME.get(name.strip().lower())
