"""Array types and the conversion of arguments to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.errors import NacreError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
SingleArray = NDArray[np.float32]


def floats(value: ArrayLike, what: str) -> Array:
    """Return an argument as an array of real numbers.

    Raises:
        NacreError: text, complex numbers or lists of unequal length; `what` names the argument.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" and array.size:
            raise TypeError
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise NacreError(f"{what} should be a number or an array of numbers, not {value!r:.60}") from None


def wavelength_grid(value: ArrayLike | None) -> Array | None:
    """Return `wavelengths_nm` as an ascending array `[wavelength]`; None stays None, a number becomes an array of one.

    Raises:
        NacreError: empty, not ascending, not positive, not finite, or not numbers.
    """
    if value is None:
        return None
    grid = np.atleast_1d(floats(value, "wavelengths_nm"))
    if grid.ndim != 1 or grid.size == 0 or not np.all(np.isfinite(grid)) or np.any(grid <= 0):
        raise NacreError("wavelengths_nm must be a list of positive numbers, at least one")
    if np.any(np.diff(grid) <= 0):
        raise NacreError("wavelengths_nm must be ascending, each given once")
    return grid
