"""Export formats of materials, their requirements, and remarks on an exported file."""

from collections.abc import Mapping
from typing import Any

from nacre.bsdf import Bsdf
from nacre.core.errors import UnsupportedError

# suffix of the file or folder
EXPORTS = {
    "rgl": ".bsdf", "merl": ".binary", "csv": ".csv", "zemax": ".bsdf", "gltf": ".gltf", "materialx": ".mtlx",
    "exr": ".exr", "nacre": ".nacre", "lut": "-lut", "tmat": ".tmat.h5", "astm": ".astm", "brdf-json": ".json",
    "speos": ".brdf", "three": "-three", "usd": ".usda",
}  # fmt: skip
FOLDERS = ("lut", "three")  # these formats are folders, with colours of one lamp
FAMILY_FORMATS = ("tmat",)  # only some families write these (`OwnFormats`)


def refuse_unsuitable(bsdf: Bsdf, noun: str) -> None:
    """Refuse to tabulate random walks and pure mirrors.

    Raises:
        UnsupportedError: a lobe is stochastic, or all lobes are deltas.
    """
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError(f'{noun} needs arrays, not a random walk; set quality = "fast" in the recipe')
    if all(lobe.is_delta for lobe in bsdf.lobes):
        raise UnsupportedError(f"{noun} cannot store a smooth material: mirror directions are delta functions")


def export_remarks(facts: Mapping[str, Any]) -> list[str]:
    """Return remarks on an export: its colour error, and properties that the format cannot store.

    Args:
        facts: from `nacre.analysis.import_export.export_material`.
    """
    lines = []
    for part in facts.get("parts", ()):
        lines.append(
            f"{part['name']}, {100 * part['mean_share']:.0f} % of the surface: one film of "
            f"{part['film']['thickness_nm']:.1f} nm, n = {part['film']['film_ior']:.3f}; "
            f"dE00 {part['residual_delta_e_2000']:.2f} on the mean of the angles"
        )
    if "film" in facts:
        film, varied = facts["film"], facts.get("thickness_map")
        size = f"{film['thickness_nm']:.1f}" if varied is None else f"{varied['low_nm']:.1f} to {varied['high_nm']:.1f}"
        over = "the angles" if varied is None else "the angles and the thickness map"
        lines.append(
            f"one film of {size} nm, n = {film['film_ior']:.3f}; "
            f"dE00 {facts['residual_delta_e_2000']:.2f} on the mean of {over}"
        )
    for name, error in facts.get("errors_dE00", {}).items():
        lines.append(
            f"{name}: dE00 {error['mean']:.2f} mean, {error['max']:.2f} maximum; PNG {error['mean_png']:.2f}, "
            f"{error['max_png']:.2f}"
        )
    return lines + [f"not stored: {part}" for part in facts["lost"]]
