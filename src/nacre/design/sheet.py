"""The layer sheet: what a coater needs to make a film, as a table from the light's side inward."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.errors import UnsupportedError
from nacre.files import write_text
from nacre.film.material import Film
from nacre.recipe import Material

REFERENCE_NM = 550.0
COLUMNS = (
    "position", "material", "thickness_nm", "thickness_min_nm", "thickness_max_nm", f"n_{REFERENCE_NM:.0f}nm",
    f"k_{REFERENCE_NM:.0f}nm", "optical_thickness_nm", "quarter_waves", "incoherent", "source",
)  # fmt: skip


def layer_rows(film: Film) -> list[dict[str, Any]]:
    """Return a row a medium: ambient, layers from the light's side inward, substrate.

    A thickness that varies over the surface is given at its middle, with its ends beside it; quarter waves are of
    550 nm.
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
    index = complex(material.n_complex(np.array([min(max(REFERENCE_NM, low), high)]))[0])
    return {
        "position": position, "material": material.name, COLUMNS[5]: index.real, COLUMNS[6]: index.imag,
        "source": material.source,
    }  # fmt: skip


def write_sheet(material: Material, path: str | Path) -> None:
    """Write the layer sheet of a film as CSV; comment lines hold the provenance.

    Raises:
        UnsupportedError: the material is no film.
        NacreError: the file cannot be written.
    """
    if not isinstance(material.model, Film):
        raise UnsupportedError(
            f"{material.context.source}: a layer sheet is made of films only, not of a {material.family}"
        )
    buffer = io.StringIO()
    buffer.write(f"# layer sheet of {material.name}, nacre {__version__}; light comes from the ambient's side\n")
    if material.model.ridges is not None:
        buffer.write("# the film stands in ridges: see the recipe\n")
    writer = csv.DictWriter(buffer, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in layer_rows(material.model):
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
    write_text(path, buffer.getvalue())
