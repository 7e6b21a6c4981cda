"""Chromatic adaptation: from a colour under one illuminant to the colour that looks alike under another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import Array
from nacre.errors import NacreError, did_you_mean

if TYPE_CHECKING:
    pass

Adaptation = Literal["bradford", "none"]
ADAPTATIONS = ("bradford", "none")

# Lam 1985, as used by ICC profiles: XYZ to sharpened cone responses.
BRADFORD: Array = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def adaptation_matrix(white_from: ArrayLike, white_to: ArrayLike, method: Adaptation = "bradford") -> Array:
    """Return the `[3, 3]` matrix that takes XYZ seen under one white to XYZ seen alike under another.

    Bradford's transform: each sharpened cone response is scaled by the ratio of the whites' responses; for a
    complete adaptation. "none" is the identity.

    Raises:
        NacreError: no such method.
    """
    if method == "none":
        return np.eye(3)
    if method != "bradford":
        raise NacreError(
            f'adaptation "{method}" is not known.{did_you_mean(str(method), ADAPTATIONS)} '
            f"Choose from {', '.join(ADAPTATIONS)}"
        )
    gain = (BRADFORD @ np.asarray(white_to, dtype=float)) / (BRADFORD @ np.asarray(white_from, dtype=float))
    return np.linalg.solve(BRADFORD, gain[:, None] * BRADFORD)


def adapt_xyz(xyz: ArrayLike, white_from: ArrayLike, white_to: ArrayLike, method: Adaptation = "bradford") -> Array:
    """Return XYZ `[..., 3]` adapted from one white to another; the white itself maps to the other white.

    Example: `adapt_xyz(white_xyz("A"), white_xyz("A"), white_xyz("D65"))` is the white of D65.
    """
    return np.asarray(xyz, dtype=float) @ adaptation_matrix(white_from, white_to, method).T
