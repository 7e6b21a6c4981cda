"""Layer table for coating a film, from the light inward."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.families.film.material import Film
from nacre.matter.drawings import LayerSheet
from nacre.matter.indices.crystal import AnisotropicConstant

REFERENCE_NM = 550.0
COLUMNS = (
    "position", "material", "thickness_nm", "thickness_min_nm", "thickness_max_nm", f"n_{REFERENCE_NM:.0f}nm",
    f"k_{REFERENCE_NM:.0f}nm", "optical_thickness_nm", "quarter_waves", "incoherent", "source",
)  # fmt: skip


def layer_rows(film: Film) -> list[dict[str, Any]]:
    """Return a row per medium: ambient, layers from the light inward, substrate.

    Varying thicknesses are given at the centre with their range; quarter waves refer to 550 nm.
    """
    uv = np.stack(np.meshgrid(*[np.linspace(0, 1, 33)] * 2), axis=-1).reshape(-1, 2)
    middle = np.array([0.5, 0.5])
    rows = [_row("ambient", film.ambient)]
    for number, layer in enumerate(film.layers, start=1):
        here = float(layer.thickness_at(middle))
        everywhere = [float(layer.thickness_at(place)) for place in uv]
        row = _row(str(number), layer.material)
        optical = row[COLUMNS[5]] * here
        row |= {
            "thickness_nm": here, "thickness_min_nm": min(everywhere), "thickness_max_nm": max(everywhere),
            "optical_thickness_nm": optical, "quarter_waves": 4 * optical / REFERENCE_NM,
            "incoherent": layer.incoherent,
        }  # fmt: skip
        rows.append(row)
    return [*rows, _row("substrate", film.substrate)]


def _row(position: str, material: Any) -> dict[str, Any]:
    low, high = material.range_nm
    at = np.array([min(max(REFERENCE_NM, low), high)])
    is_tensor = isinstance(material, AnisotropicConstant)  # its row holds the mean index
    index = complex((material.mean_index(at) if is_tensor else material.n_complex(at))[0])
    return {
        "position": position, "material": material.name, COLUMNS[5]: index.real, COLUMNS[6]: index.imag,
        "source": material.source,
    }  # fmt: skip


def layer_sheet(film: Film) -> LayerSheet:
    """Return the film's layers as a table."""
    remarks = () if film.ridges is None else ("the film stands in ridges: see the recipe",)
    return LayerSheet(COLUMNS, tuple(layer_rows(film)), remarks)
