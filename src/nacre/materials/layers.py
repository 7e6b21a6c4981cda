"""The layers of a material that is a stack, in words and numbers for sheets and pages."""

from __future__ import annotations

import numpy as np

from nacre.errors import NacreError, UnsupportedError
from nacre.materials.material import Material


def layers_of(material: Material) -> tuple[list[str], list[float]]:
    """Return the media of a stack from the light's side and its thicknesses; nothing of what is no stack."""
    if "structure" not in material.model.figures:
        return [], []
    try:
        data = material.figure_data("structure")
    except (NacreError, UnsupportedError):
        return [], []
    if "thicknesses_nm" not in data or "names" not in data:
        return [], []
    return [str(name) for name in data["names"]], [float(d) for d in np.atleast_1d(data["thicknesses_nm"])]
