"""Ensemble ratios over wavelength: solved at nodes, interpolated between them, cached on disk."""

import contextlib
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.disk_cache import cache_arrays, cached_arrays, drop_arrays
from nacre.core.jobs import in_workers, is_on_cluster
from nacre.core.memory import check_memory
from nacre.core.parallel import available_jobs
from nacre.core.progress import announce, duration
from nacre.families.metasurface.ensemble.ensemble import REACH, Ensemble, EnsembleSettings, middle_sizes, same_order
from nacre.families.metasurface.ensemble.supercells import (
    max_far_wavenumber,
    supercells,
    translation_order,
    with_species,
)
from nacre.families.metasurface.monolayer.arrangement import Pattern
from nacre.families.metasurface.monolayer.ensemble_ratio import Block, Ratio, Sums, as_arrays, from_arrays
from nacre.families.metasurface.monolayer.monolayer import Monolayer
from nacre.families.metasurface.tmatrix.substrate import Embedded
from nacre.recipe.fingerprint import fingerprint

MOST_WAVELENGTHS = 16  # solved wavelengths; sufficient for resonances wider than 30 nm
SOLVE_S = 0.9  # seconds per pattern with `UNKNOWNS` on one core
UNKNOWNS = 2080
ONE_SIDE, OF_MIXTURES = 0.5, 1.15  # relative work without the factorisation: opaque substrate, and mixtures
TABLES_S = 1.0  # seconds per wavelength
# species at different heights need vertical translations: seconds per pattern, wave and
# pair of multipoles, and per wavelength
CARRYING_S, CARRIED_TABLES_S = 6.6e-9, 6e-5


@dataclass(frozen=True)
class EnsembleInterpolation:
    """Ratios at some wavelengths, and their standard errors.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        ratios: at each.
        errors: relative standard error for the diffuse light above, `[wavelength, s, i]`, over azimuth and
            polarisation.
        angles_rad: `[s]`, for s and i.
        settings: ensemble size.
    """

    wavelengths_nm: Array
    ratios: tuple[Ratio, ...]
    errors: Array
    angles_rad: Array
    settings: EnsembleSettings

    def at(self, wavelength_nm: float) -> Ratio:
        """Return the ratio at a wavelength, interpolated linearly."""
        x = float(np.interp(wavelength_nm, self.wavelengths_nm, np.arange(len(self.ratios))))
        low = min(int(x), len(self.ratios) - 1)
        high = min(low + 1, len(self.ratios) - 1)
        return self.ratios[low] if x == low else self.ratios[low].mixed(self.ratios[high], x - low)

    @property
    def standard_error(self) -> float:
        """Root mean square over all wavelengths and pairs of angles, by projected solid angle."""
        projected = np.sin(2 * self.angles_rad)
        weights = projected[:, None] * projected
        return float(np.sqrt(np.mean(np.sum(weights * self.errors**2, axis=(1, 2)) / weights.sum())))

    @property
    def notes(self) -> dict[str, Any]:
        """Notes for a Bsdf."""
        return {
            "spheres": self.settings.spheres,
            "realisations": self.settings.realisations,
            "multipole_order": self.settings.multipole_order,
            "standard_error": round(self.standard_error, 4),
            "wavelengths_nm": self.wavelengths_nm.tolist(),
            "angles_deg": np.degrees(self.angles_rad).round(2).tolist(),
            "standard_errors": self.errors.round(4).tolist(),
        }


def node_wavelengths(wavelengths_nm: Array) -> Array:
    """Return the wavelengths solved for a grid: all, or at most `MOST_WAVELENGTHS` evenly spaced ones."""
    if len(wavelengths_nm) <= MOST_WAVELENGTHS:
        return wavelengths_nm
    return wavelengths_nm[np.linspace(0, len(wavelengths_nm) - 1, MOST_WAVELENGTHS).round().astype(int)]


def expected_seconds(wavelengths: int, settings: EnsembleSettings, layer: Monolayer) -> float:
    """Return the expected wall clock time for an ensemble on this machine.

    Args:
        layer: the model at any one wavelength.
    """
    n = 2 * settings.multipole_order * (settings.multipole_order + 2)
    share = settings.spheres * n / UNKNOWNS
    effort = (1.0 if layer.transmits_below else ONE_SIDE) * (1.0 if layer.shares.size == 1 else OF_MIXTURES)
    one = SOLVE_S * (0.3 * share**3 + effort * (0.4 * share**2 + 0.3 * share))  # factorisation, matrix, directions, fit
    tables = TABLES_S
    heights = np.unique([p.centre_nm for p in layer.particles])
    if len(heights) > 1:
        surface, side = layer.surface, float(np.sqrt(settings.spheres / layer.structure.density_per_nm2))
        top = translation_order(settings.multipole_order, surface.inner_wavenumber * float(np.ptp(heights)))
        carried = (2 * top * (top + 2)) ** 2
        largest = max_far_wavenumber(surface, REACH * side) * surface.inner_wavenumber
        waves = np.pi * (largest * side / (2 * np.pi)) ** 2
        one += CARRYING_S * waves * n * carried
        tables += CARRIED_TABLES_S * carried
    return wavelengths * (tables + settings.realisations * one / min(available_jobs(), settings.realisations))


def interpolate_ensemble(
    wavelengths_nm: Array,
    layer: Callable[[float], Monolayer],
    pattern: Callable[[int, int], Pattern],
    settings: EnsembleSettings,
    seed: int,
    source: str,
    is_list: bool = False,
    because: str = "",
) -> EnsembleInterpolation:
    """Return the ratios for a wavelength grid, reusing cached results, also from an interrupted run.

    Args:
        wavelengths_nm: ascending.
        layer: the mean-field model at a wavelength, used with the middle particle size per species.
        pattern: function (count, seed) that returns the arrangement.
        source: recipe name, for messages.
        is_list: whether the arrangement is a point list.
        because: reason for an ensemble, for the progress message.

    Raises:
        UnsupportedError: the ensemble is too large for the memory.
    """
    size = settings.spheres * 2 * settings.multipole_order * (settings.multipole_order + 2)
    if not is_on_cluster():
        check_memory(
            3.0 * 8.0 * size**2 * available_jobs(),
            f"{source}: model.ensemble.spheres = {settings.spheres} of order {settings.multipole_order}",
            "take fewer spheres, or fewer --jobs",
        )
    solved_at = node_wavelengths(np.atleast_1d(np.asarray(wavelengths_nm, dtype=float)))
    first = layer(float(solved_at[0]))
    structure = first.structure
    made = supercells(
        pattern,
        structure.density_per_nm2,
        structure.diameter_nm,
        settings.spheres,
        settings.realisations,
        seed,
        is_list,
    )
    ensembles = []
    for wavelength in solved_at:
        whole = layer(float(wavelength))
        alone = same_order(whole, settings.multipole_order, *middle_sizes(whole))
        ensembles.append(Ensemble(alone, with_species(made, alone.shares, seed) if len(alone.particles) > 1 else made))
    keys = [_key(one, settings) for one in ensembles]
    found = [_read(key) for key in keys]
    missing = [n for n, one in enumerate(found) if one is None]
    if missing:
        cached = [_read_patterns(keys[n], len(made)) for n in missing]
        done_before = sum(len(patterns) for patterns in cached)
        share = 1.0 - done_before / (len(missing) * len(made))
        seconds = share * expected_seconds(len(missing), settings, ensembles[0].layer)
        parts = []
        if len(missing) < len(found):
            parts.append(f"{len(found) - len(missing)} more are cached")
        if done_before:
            noun = "pattern" if done_before == 1 else "patterns"
            parts.append(f"{done_before} {noun} of these {'is' if done_before == 1 else 'are'} cached")
        kept = f" ({', '.join(parts)})" if parts else ""
        noun = "wavelength" if len(missing) == 1 else "wavelengths"
        time = "on a cluster" if is_on_cluster() else f"about {duration(seconds)}"
        announce(
            f"{source}: {because}{settings.realisations} patterns of {settings.spheres} particles at {len(missing)} "
            f"{noun}{kept}: {time}",
            seconds,
        )
        for n, solved in _solve([ensembles[n] for n in missing], [keys[n] for n in missing], missing, cached):
            found[n] = solved
    done = [one for one in found if one is not None]
    angles = ensembles[0].angles_rad
    return EnsembleInterpolation(solved_at, tuple(r for r, _ in done), np.stack([e for _, e in done]), angles, settings)


def _solve(
    ensembles: list[Ensemble], keys: list[str], names: list[int], cached: list[dict[int, dict[Block, Sums]]]
) -> list[tuple[int, tuple[Ratio, Array]]]:
    """Solve all patterns for all wavelengths, in threads or on a cluster; fit each wavelength after its last pattern.

    Each pattern is cached until the fit, for a resumed run.

    Args:
        keys, names: identify each ensemble in the disk cache and the result.
        cached: patterns already solved for each.
    """
    solved = [dict(patterns) for patterns in cached]
    out: list[tuple[int, tuple[Ratio, Array]]] = []

    def fit(n: int) -> None:
        ratio, errors = ensembles[n].ratio([solved[n][k] for k in range(len(solved[n]))])
        for one in solved[n].values():
            one.clear()  # the list of results still holds it
        _tables.pop(keys[n], None)
        _store(keys[n], ratio, errors)
        drop_arrays(_pattern_key(keys[n], k) for k in range(len(ensembles[n].supercells)))
        out.append((names[n], (ratio, errors)))

    def keep(item: tuple[int, str, Ensemble, int], one: dict[Block, Sums]) -> None:
        n, key, ensemble, number = item
        solved[n][number] = one
        if len(solved[n]) == len(ensemble.supercells):
            fit(n)
        else:
            cache_arrays(_pattern_key(key, number), as_arrays(one))

    for n, one in enumerate(ensembles):
        if len(cached[n]) == len(one.supercells):
            fit(n)
    items = [
        (n, keys[n], one, k)
        for n, one in enumerate(ensembles)
        for k in range(len(one.supercells))
        if k not in cached[n]
    ]
    try:
        in_workers(_solve_pattern, items, keep)
    finally:
        for key in keys:
            _tables.pop(key, None)
    return out


# ensembles with their tables, by key, each with a lock: in a worker process each item arrives as a new object
_tables: OrderedDict[str, tuple[Ensemble, threading.Lock]] = OrderedDict()
_tables_lock = threading.Lock()


def _solve_pattern(item: tuple[int, str, Ensemble, int]) -> dict[Block, Sums]:
    _, key, ensemble, number = item
    with _tables_lock:
        one, lock = _tables.setdefault(key, (ensemble, threading.Lock()))
        _tables.move_to_end(key)
        while len(_tables) > max(2, available_jobs()):
            _tables.popitem(last=False)
    with lock:  # the first thread computes the tables
        one.prepare()
    return one.solve(number)


def _pattern_key(key: str, number: int) -> str:
    return f"{key}-{number}"


def _read_patterns(key: str, patterns: int) -> dict[int, dict[Block, Sums]]:
    """Return the cached patterns for one wavelength, by pattern number."""
    out = {}
    for number in range(patterns):
        stored = cached_arrays(_pattern_key(key, number))
        with contextlib.suppress(KeyError, ValueError):  # damaged entries are solved again
            if stored:
                out[number] = from_arrays(stored)
    return out


def _key(one: Ensemble, settings: EnsembleSettings) -> str:
    """Return a fingerprint for optics, positions and code."""
    surface, particles, structure = one.layer.surface, one.layer.particles, one.layer.structure
    digest = hashlib.sha256()
    arrays: list[NDArray[Any]] = [surface.indices, surface.thicknesses_nm, *(p.t_matrix for p in particles)]
    arrays += [structure.q_per_nm, structure.s, structure.r_nm, structure.h]
    arrays += [cell.xy_nm for cell in one.supercells] + [cell.period.bloch for cell in one.supercells]
    arrays += [cell.species for cell in one.supercells if cell.species is not None]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    numbers = [
        surface.wavelength_nm,
        structure.density_per_nm2,
        structure.diameter_nm,
        *(n for p in particles for n in (p.share, p.centre_nm, p.cut or 0.0)),
        *(n for cell in one.supercells for n in (cell.period.side_nm, float(cell.seed))),
        *([float(surface.host)] if isinstance(surface, Embedded) else ()),
    ]
    return "ensemble-" + fingerprint(
        {"arrays": digest.hexdigest(), "numbers": [float(n).hex() for n in numbers]}, {}, settings=str(settings)
    )


def _store(key: str, ratio: Ratio, errors: Array) -> None:
    names = {"-".join(map(str, block)): values for block, values in ratio.coefficients.items()}
    cache_arrays(key, {**names, "errors": errors})


def _read(key: str) -> tuple[Ratio, Array] | None:
    stored = cached_arrays(key)
    if not stored or "errors" not in stored:
        return None
    errors = stored.pop("errors")
    blocks = {}
    try:
        for name, values in stored.items():
            a, b, c, d = (int(part) for part in name.split("-"))
            blocks[(a, b, c, d)] = values
    except ValueError:  # a damaged entry is solved again
        return None
    return Ratio(blocks), errors
