"""The formats that materials are exported in, and what is said of a file once it is written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# the ending of a file, or of a folder's name
EXPORTS = {
    "rgl": ".bsdf", "merl": ".binary", "csv": ".csv", "zemax": ".bsdf", "gltf": ".gltf", "materialx": ".mtlx",
    "exr": ".exr", "nacre": ".nacre", "lut": "-lut", "tmat": ".tmat.h5",
}  # fmt: skip
FOLDER = "lut"  # the one that is a folder of files
OF_SOME = ("tmat",)  # that only models with such a format of their own can write (`OwnFormats`)


def said_of(facts: Mapping[str, Any]) -> list[str]:
    """Return what an export came to, in lines: its error, and what the format does not hold.

    Args:
        facts: from `nacre.analysis.import_export.export_material`.
    """
    lines = []
    if "residual_delta_e_2000" in facts:
        film = facts["film"]
        lines.append(
            f"one film of {film['thickness_nm']:.1f} nm, n = {film['film_ior']:.3f}; "
            f"dE00 {facts['residual_delta_e_2000']:.2f} on the mean of the angles"
        )
    for what, told in facts.get("errors_dE00", {}).items():
        lines.append(
            f"{what}: dE00 {told['mean']:.2f} mean, {told['max']:.2f} at most; PNG {told['mean_png']:.2f}, "
            f"{told['max_png']:.2f}"
        )
    return lines + [f"not held: {what}" for what in facts["lost"]]
