"""Model selection: the mean field within its measured validity range, else an ensemble.

`mean_field_errors.toml` holds the mean-field error for every system compared with multi-sphere solutions.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

MAX_ERROR = 0.12  # relative L2 error up to which the mean field is accepted
METAL, RESONANT, FAINT = "metal", "high-index", "low-index"
SPHERE, SPHEROID, DISC, OTHER = "sphere", "spheroid", "disc", "particle"
HIGH_INDEX = 2.5  # core index over the ambient index with sharp resonances in the visible
SAME_INDEX = 0.2  # relative index contrast below which a substrate is neglected
SHAPES = {"": OTHER, "sphere": SPHERE, "cylinder": DISC, "spheroid": SPHEROID}


@dataclass(frozen=True)
class SystemClass:
    """Particle species class: shape and core type."""

    shape: str
    core: str

    def __str__(self) -> str:
        return f"{self.core} {self.shape}s"


@dataclass(frozen=True)
class MeasuredSystem:
    """A system with a measured mean-field error.

    Attributes:
        name: description.
        species: one or two classes.
        error: relative L2 error, the maximum over wavelengths.
    """

    name: str
    species: tuple[SystemClass, ...]
    on_substrate: bool
    coverage: float
    packing: float
    error: float


def _load_systems() -> tuple[MeasuredSystem, ...]:
    text = files(__package__).joinpath("mean_field_errors.toml").read_text("utf-8")
    return tuple(
        MeasuredSystem(**{**entry, "species": tuple(SystemClass(*pair) for pair in entry["species"])})
        for entry in tomllib.loads(text)["system"]
    )


MEASURED = _load_systems()

# Errors inside a layer at coverage 0.1, by the ensemble: silver r 60 nm in resin on glass 38 to 58 %, on silicon 28 %,
# in n = 1.7 54 to 74 %; silicon r 75 nm 44 to 78 %; titania r 75 nm 10 to 75 %. The upward share is small there and
# includes light reflected by the faces. At 550 nm: silver 17 % at coverage 0.02 and 4.6 % at 0.003, titania 8 and 1.8 %
MAX_EMBEDDED_COVERAGE = 0.003
EMBEDDED_ERROR = "10 to 78 % off at a coverage of 0.1"


def core_class(relative_index: complex) -> str:
    """Return the core class from its index over the ambient index."""
    if relative_index.imag > relative_index.real:
        return METAL
    return RESONANT if relative_index.real > HIGH_INDEX else FAINT


def conservative_class(species: Sequence[SystemClass]) -> list[tuple[str, str]]:
    """Return sorted classes with weakly scattering low-index cores replaced by metal, the class with data."""
    return sorted((one.shape, METAL if one.core == FAINT else one.core) for one in species)


def highest_coverage(species: Sequence[SystemClass], on_substrate: bool) -> tuple[float, MeasuredSystem | None]:
    """Return the coverage up to which the mean field is valid, and the decisive system; (0, None) without data.

    This is the densest matching system within `MAX_ERROR`, or else an extrapolation with an error proportional
    to the coverage.
    """
    classes = sorted((one.shape, one.core) for one in species)
    candidates = [m for m in MEASURED if m.on_substrate == on_substrate]
    matching = [m for m in candidates if sorted((one.shape, one.core) for one in m.species) == classes]
    matching = matching or [m for m in candidates if conservative_class(m.species) == conservative_class(species)]
    if not matching:
        return 0.0, None
    failed = min((m.coverage for m in matching if m.error > MAX_ERROR), default=float("inf"))
    valid = [m for m in matching if m.error <= MAX_ERROR and m.coverage < failed]
    if valid:
        best = max(valid, key=lambda m: m.coverage)
        return best.coverage, best
    nearest = min(matching, key=lambda m: MAX_ERROR * m.coverage / m.error)
    return nearest.coverage * MAX_ERROR / nearest.error, nearest


def mean_field_holds(species: Sequence[SystemClass], on_substrate: bool, coverage: float) -> tuple[bool, str]:
    """Return whether the mean field is selected, and the reason.

    Args:
        species: classes; both in a mixture are evaluated together.
        on_substrate: whether there is a relevant substrate.
        coverage: by all particles.
    """
    limit, system = highest_coverage(species, on_substrate)
    name = _describe(species, on_substrate)
    if system is None:
        return False, f"{name}: no such layer was measured"
    return coverage <= limit * (1 + 1e-6), (
        f"{name} at coverage {coverage:.3g}; measured: {system.name}, coverage {system.coverage:g}, "
        f"{100 * system.error:.0f} % off, so the mean field is taken up to {limit:.2g}"
    )


def mean_field_holds_inside(coverage: float) -> tuple[bool, str]:
    """Return whether the mean field is selected for particles inside a layer, and the reason."""
    return coverage <= MAX_EMBEDDED_COVERAGE, (
        f"particles inside a layer at coverage {coverage:.3g}; measured: the mean field is {EMBEDDED_ERROR}, so it is "
        f"taken up to {MAX_EMBEDDED_COVERAGE:g}"
    )


def warning(species: Sequence[SystemClass], on_substrate: bool) -> str:
    """Return the mean-field validity warning, the same for each coverage."""
    limit, system = highest_coverage(species, on_substrate)
    name = _describe(species, on_substrate)
    if system is None:
        return f"the mean field is taken of {name}, of which no layer was measured"
    return (
        f"the mean field is taken of {name} beyond a coverage of {limit:.2g}, up to which it is known to hold to "
        f"{100 * MAX_ERROR:.0f} %"
    )


def _describe(species: Sequence[SystemClass], on_substrate: bool) -> str:
    name = " and ".join(map(str, species))
    name = f"a mixture of {name}" if len(species) > 1 else name
    return f"{name} {'on a substrate' if on_substrate else 'with nothing below'}"
