"""The wavelength grid: 360-830 nm, with the step that a structure's colour requires."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError

WAVELENGTH_RANGE_NM = (360.0, 830.0)
# all of these divide 470 nm, so both ends are always on the grid
STEPS_NM = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
REFERENCE_NM = 550.0


def colour_step_nm(optical_thickness_nm: float = 0.0, finesse: float = 1.0) -> float:
    """Return the wavelength step at which a stack's colour is within 0.5 dE00 of a grid of 1 nm or finer.

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
