"""What a design's freedom reaches at its first colour: the gamut behind its report."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.design.wants.films import StackSearch, film_search
from nacre.design.wants.gamut import Gamut, gamut_of, gamut_of_free
from nacre.design.wants.geometry import At
from nacre.design.wants.target import Target
from nacre.errors import NacreError
from nacre.light import white_xyz
from nacre.matter.stack.solve import powers

STACKS = 800
POINTS = 400
SHORT_SHARE = 0.3  # of thicknesses: drawn near the lower bound, where metals let light through


def reach_of(target: Target, seconds: float) -> tuple[Gamut, Array] | None:
    """Return the gamut at the first colour that is wanted, and the colours wanted there `[want, 3]`, CIELAB.

    None where only spectra are wanted.

    Args:
        seconds: time allowed where a material is computed one by one.

    Raises:
        NacreError: nothing can be computed.
    """
    colours = [want for want in target.wants if want.spectrum is None]
    if not colours:
        return None
    at, light = colours[0].at, target.spec.light
    white = white_xyz(light.illuminants[0], light.observer)
    wanted = [want.wanted_lab(white) for want in colours if want.at == at]
    marks = np.array([lab for lab in wanted if lab is not None]).reshape(-1, 3)
    search = film_search(target, 0)
    if search is not None:
        return _of_stacks(search, target, at), marks
    seed = target.spec.search.seed
    found = gamut_of_free(
        target.material, target.free, at, points=POINTS, seconds=seconds, illuminant=light.illuminants[0],
        observer=light.observer, seed=seed,
    )  # fmt: skip
    return found, marks


def _of_stacks(search: StackSearch, target: Target, at: At) -> Gamut:
    """Draw stacks that the target allows, many at once."""
    problem, light = search.problem, target.spec.light
    generator = np.random.default_rng([target.spec.search.seed, 5])
    grid = problem.goals.wavelengths_nm
    media = {m.name: m.n for m in problem.palette}
    factors: list[Array] = []
    structures: list[dict[str, Any]] = []
    counts = range(1, problem.layers + 1) if problem.slots is None else [problem.layers]
    for count in counts:
        share = max(STACKS // len(counts), 1)
        n = np.empty((share, count + 2, len(grid)), dtype=complex)
        d = np.zeros((share, count))
        n[:, 0] = problem.ambient
        for k in range(share):
            names = [_pick(search, j, generator) for j in range(count)]
            below = problem.substrates[int(generator.integers(len(problem.substrates)))]
            n[k, 1:-1] = [media[name] for name in names] if names else np.zeros((0, len(grid)))
            n[k, -1] = below.n
            for j, name in enumerate(names):
                slot = None if problem.slots is None else problem.slots[j]
                low, high = problem.bounds_of(name) if slot is None else (slot.low_nm, slot.high_nm)
                unit = generator.random() * (SHORT_SHARE if generator.random() < SHORT_SHARE else 1.0)
                d[k, j] = low + unit * (min(high, 1e5) - low)
            d[k] *= min(1.0, problem.total_nm / max(float(d[k].sum()), 1e-9))
            structures.append({"layers": [{"material": m, "thickness_nm": float(t)} for m, t in zip(names, d[k])],
                               "substrate": below.name})  # fmt: skip
        found = powers(n, d, grid, np.radians([at.theta_deg]))
        part = found.reflectance if at.kind == "specular" else found.transmittance
        factors.append(np.asarray(part[..., 0, :]))
    return gamut_of(np.concatenate(factors), grid, structures, str(at), light.illuminants[0], light.observer)


def _pick(search: StackSearch, slot: int, generator: np.random.Generator) -> str:
    slots = search.problem.slots
    names = [m.name for m in search.problem.palette] if slots is None else slots[slot].materials
    return str(names[int(generator.integers(len(names)))])


def reach_of_or_none(target: Target, seconds: float) -> tuple[Gamut, Array] | None:
    """As `reach_of`; None where it cannot be computed: the report then goes without."""
    try:
        return reach_of(target, seconds)
    except NacreError:
        return None


__all__ = ["reach_of", "reach_of_or_none"]
