"""How finely a surface must be sampled for a stated error.

A wall whose phase turns by more than about 5 rad between neighbouring samples causes aliasing in the image
(physics/relief.md, section 11.4). The rule gives a first guess; comparing the lines of two samplings decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.errors import UnsupportedError
from nacre.families.relief.lines import line_power
from nacre.families.relief.surface import Array, Tile, largest_step_nm
from nacre.recipe.memory import check_memory

# phase steps, rad, at which the measured errors are about 1e-4, 1e-3 and 1e-2 (section 11.4); interpolated in log error
STEP_FOR_ERROR = ((1e-6, 1.6), (1e-4, 3.0), (1e-3, 4.4), (1e-2, 6.0))
GROWTH = 1.5  # ratio of the sampling that checks to the one that is checked
MAX_SAMPLES = 16384  # along one side; 2 GiB of complex field in single precision
# the difference of two samplings is a good measure of the coarser one's error; the margin covers its scatter
MARGIN = 2.0
BYTES_A_SAMPLE = 24  # the surface in double precision, and the field and its transform in single


@dataclass(frozen=True)
class Sampling:
    """A chosen sampling and why.

    Attributes:
        samples_per_feature: U.
        phase_step_rad: largest phase difference between neighbouring samples at the largest kappa.
        estimated_error: relative L2 difference of the line powers from a finer sampling; an upper estimate.
        highest_line: lines kept on each side.
    """

    samples_per_feature: int
    phase_step_rad: float
    estimated_error: float
    highest_line: int


def _step_limit(error: float) -> float:
    errors, steps = zip(*STEP_FOR_ERROR)
    return float(np.interp(np.log(error), np.log(errors), steps))


def choose_sampling(tile: Tile, kappa_max: float, highest_line: int, error: float) -> Sampling:
    """Return the smallest sampling whose line powers are within `error` of converged, relative L2.

    Args:
        tile: the relief.
        kappa_max: largest xi / lambda that will be asked for, 1/nm; the phase is steepest there.
        highest_line: highest wanted diffraction line; the samples must hold it twice over.
        error: wanted error, for example 1e-3.

    Raises:
        UnsupportedError: more than 16384 samples along a side would be needed, or more memory than is allowed.
    """
    n = tile.features
    least = max(2, -(-(2 * highest_line + 4) // n))
    check_memory(
        BYTES_A_SAMPLE * float(n * least) ** 2,
        f"feature_um = {tile.feature_nm / 1e3:.4g} of {n} x {n} features, which sends light into {highest_line} orders "
        "on each side of the mirror's,",
        "take smaller or fewer features, or light of higher coherence",
    )
    # walls of a blurred relief are no steeper than this; without blur a wall is one step whatever the sampling
    probe = max(least, 4)
    step_nm = largest_step_nm(tile.surface_nm(probe)) * probe
    wanted = int(np.ceil(2.0 * np.pi * kappa_max * step_nm / _step_limit(error) * 0.8)) if tile.blur_nm > 0 else least
    upsampling = max(least, min(wanted, MAX_SAMPLES // n))
    coarse = _powers(tile, upsampling, kappa_max, highest_line)
    while True:
        finer = max(upsampling + 1, int(np.ceil(GROWTH * upsampling)))
        if upsampling * n > MAX_SAMPLES:
            raise UnsupportedError(
                f"the relief needs more than {MAX_SAMPLES} samples along a side for an error of {error:g}; "
                "allow a larger error, blur the walls, or use fewer features"
            )
        fine = _powers(tile, finer, kappa_max, highest_line)
        estimate = float(np.linalg.norm(coarse - fine) / max(float(np.linalg.norm(fine)), 1e-300))
        if MARGIN * estimate <= error:
            break
        upsampling, coarse = finer, fine
    phase = 2.0 * np.pi * kappa_max * largest_step_nm(tile.surface_nm(upsampling))
    return Sampling(upsampling, float(phase), MARGIN * estimate, highest_line)


def _powers(tile: Tile, upsampling: int, kappa: float, highest: int) -> Array:
    # large tiles in single precision: half the memory, and rounding (1e-6) is far under any error asked for there
    dtype = np.float64 if tile.features * upsampling <= 1024 else np.float32
    surface = tile.surface_nm(upsampling).astype(dtype)
    return np.asarray(line_power(surface, kappa, highest), dtype=float)
