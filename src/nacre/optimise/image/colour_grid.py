"""The colours that one or two free numbers make, as a fine sheet: solved at nodes, a spline between them.

The nodes are halved until the spline is as good as the eye needs: every halving solves points that tell how far the
coarser spline was off.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.optimise.measurement import Geometry, evaluation_wavelengths, search_wavelengths, simulate_measurement
from nacre.optimise.merit import smooth_weights
from nacre.optimise.parameters import Parameter, values_at
from nacre.optimise.thin_film.adapter import drawn_factors

FIRST_NODES = {1: 17, 2: 9}  # along a number
MOST_NODES = {1: 2049, 2: 257}
FINE = {1: 8192, 2: 512}  # along a number: what a pixel chooses from
SPLINE_ERROR = 0.1  # dE00 of the spline between nodes, at all but a thousandth of the points
SPLINE_SHARE = 99.9
BATCH = 8192  # stacks at a time: memory
POWER = 2.0  # of the least node count of a cubic spline


@dataclass(frozen=True, eq=False)
class Sheet:
    """Colours over one or two numbers.

    Attributes:
        axes: the values of each number, ascending, in the recipe's own unit.
        xyz: `[value, 3]` or `[value, value, 3]`; white has Y = 1.
        nodes: solved along each number.
        error: dE00 of the spline that all but a thousandth of the points keep, as last halved; 0 where every value is
            solved.
    """

    axes: tuple[Array, ...]
    xyz: Array
    nodes: int
    error: float

    @property
    def flat_xyz(self) -> Array:
        """`[point, 3]`."""
        return self.xyz.reshape(-1, 3)

    def values(self, points: NDArray[np.int64]) -> Array:
        """Return the numbers `[number, ...]` of points, indices into `flat_xyz`."""
        places = np.unravel_index(points, tuple(len(axis) for axis in self.axes))
        return np.stack([axis[place] for axis, place in zip(self.axes, places, strict=True)])


class Eye:
    """Looks at many variants of one material at one geometry: stacks all at once, anything else one by one.

    Args:
        numbers: what varies.
        seed: of random walks.
        is_judge: whether to look as closely as answers are judged.
    """

    def __init__(
        self, material: Material, numbers: Sequence[Parameter], at: Geometry, lamp: str, observer: str, seed: int,
        is_judge: bool = False,
    ) -> None:  # fmt: skip
        self.material, self.numbers, self.at, self.seed = material, numbers, at, seed
        thickest = material.vary(values_at(numbers, np.ones(len(numbers))))
        self.grid = (evaluation_wavelengths if is_judge else search_wavelengths)(thickest, [lamp])
        self.weights = smooth_weights(self.grid, lamp, observer)
        self.white = white_xyz(lamp, observer)

    @property
    def is_batched(self) -> bool:
        """Whether many variants are computed at once."""
        paths = [number.path for number in self.numbers]
        low = np.array([[number.low for number in self.numbers]])
        return drawn_factors(self.material, paths, low, [self.at], self.grid) is not None

    def xyz(self, places: Array, is_over: Callable[[], bool] = lambda: False) -> Array | None:
        """Return XYZ `[place, 3]` at places `[place, number]` of the unit cube; None where it is over before the end.

        Raises:
            NacreError: a material cannot be computed.
        """
        found = []
        paths = [number.path for number in self.numbers]
        low, high = (np.array([getattr(n, end) for n in self.numbers]) for end in ("low", "high"))
        for start in range(0, len(places), BATCH):
            values = low + (high - low) * places[start : start + BATCH]
            seen = drawn_factors(self.material, paths, values, [self.at], self.grid)
            if seen is not None:
                found.append(seen[:, 0] @ self.weights)
                continue
            for row in values:
                if is_over():
                    return None
                made = self.material.vary(dict(zip(paths, map(float, row), strict=True)))
                found.append(
                    (simulate_measurement(made, [self.at], self.grid, seed=self.seed).factors[0] @ self.weights)[None]
                )
        return np.concatenate(found)


def level_sheet(eye: Eye, levels: int) -> Sheet:
    """Return the colours of every pair of levels of a process.

    Raises:
        NacreError: a material cannot be computed.
    """
    units = np.linspace(0.0, 1.0, levels)
    xyz = eye.xyz(_places([units] * len(eye.numbers)))
    assert xyz is not None
    return Sheet(_axes(eye.numbers, units), xyz.reshape(*[levels] * len(eye.numbers), 3), levels, 0.0)


def fine_sheet(eye: Eye, seconds: float, is_interrupted: Callable[[], bool] = lambda: False) -> Sheet:
    """Return the colours over the numbers' whole ranges, so closely that neighbours hardly differ.

    Args:
        seconds: time allowed; the nodes are no more halved when it is up.
        is_interrupted: asked now and then; so are they then.

    Raises:
        RecipeError: not even the first nodes can be computed in the time.
        NacreError: a material cannot be computed.
    """
    from scipy.interpolate import make_interp_spline

    begun, count = time.monotonic(), len(eye.numbers)
    nodes = FIRST_NODES[count]

    def spline(values: Array, units: Array, at: Array) -> Array:
        for axis in range(count):
            values = make_interp_spline(units, values, k=3, axis=axis)(at)
        return values

    def is_over() -> bool:
        return time.monotonic() - begun > seconds or is_interrupted()

    units = np.linspace(0.0, 1.0, nodes)
    first = eye.xyz(_places([units] * count), is_over)
    if first is None:
        if is_interrupted():
            raise KeyboardInterrupt
        each = (time.monotonic() - begun) / nodes
        raise RecipeError(
            f"{eye.material.context.source}: {nodes**count} materials cannot be solved in {seconds:.0f} s; give search."
            f"seconds some {10 * nodes**count * max(each, 0.1):.0f}, or free one number"
        )
    xyz, error = first.reshape(*[nodes] * count, 3), np.inf
    while error > SPLINE_ERROR and nodes < MOST_NODES[count] and not is_over():
        finer = np.linspace(0.0, 1.0, 2 * nodes - 1)
        guess = spline(xyz, units, finer)
        is_new = np.ones([len(finer)] * count, dtype=bool)
        is_new[tuple([slice(None, None, 2)] * count)] = False
        solved = eye.xyz(_places([finer] * count)[is_new.ravel()], is_over)
        if solved is None:
            break
        known = guess.copy()
        known[tuple([slice(None, None, 2)] * count)] = xyz
        known[is_new] = solved
        off = delta_e_2000(xyz_to_lab(guess[is_new], eye.white), xyz_to_lab(solved, eye.white))
        # the finer spline is better still: by a cubic's 2^4, of which a part is taken for granted
        error = float(np.percentile(off, SPLINE_SHARE)) / POWER**2
        xyz, units, nodes = known, finer, len(finer)
    at = np.linspace(0.0, 1.0, FINE[count])
    return Sheet(_axes(eye.numbers, at), np.maximum(spline(xyz, units, at), 0.0), nodes, error)


def _places(axes: Sequence[Array]) -> Array:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _axes(numbers: Sequence[Parameter], units: Array) -> tuple[Array, ...]:
    return tuple(number.low + (number.high - number.low) * units for number in numbers)


__all__ = ["Eye", "Sheet", "fine_sheet", "level_sheet"]
