"""From a metasurface to the files that make it: where its particles lie, and what lies under them."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.errors import UnsupportedError, did_you_mean
from nacre.exchange.point_pattern import write_layout, write_points_csv
from nacre.files import check_writable, write_text
from nacre.metasurface.material import Metasurface

SUFFIXES = {"gds": ".gds", "oas": ".oas", "csv": ".csv", "sheet": ".csv"}
PERIOD_POINTS = 20_000  # S(q) of a period is that of the endless pattern beyond some 2 pi / period
MAX_CSV_POINTS = 5_000_000
REFERENCE_NM = 550.0


def write_pattern(
    material: Metasurface,
    name: str,
    to: str,
    path: str | Path | None = None,
    size_mm: tuple[float, float] | None = None,
    seed: int | None = None,
) -> tuple[Path, ...]:
    """Write the particles of a metasurface, or the sheet of its layers, and a JSON beside it that says what it is.

    A layout holds one period of the pattern, with every particle a reference to one cell, and repeats it by one
    array of references: 1 cm^2 costs no more than its period. A CSV lists every particle.

    Args:
        material: the metasurface.
        name: of its recipe.
        to: "gds", "oas", "csv" or "sheet".
        path: where; default: `pattern` with the format's ending in the present folder.
        size_mm: area (x, y) to cover; whole periods are written, so that the pattern reaches over its far edges.
            Default: one period of about 20 000 particles.
        seed: of the points; default: the recipe's.

    Raises:
        UnsupportedError: another format, only S(q) is known, or a CSV of more than 5 million points.
        NacreError: the area is too wide for a layout's coordinates, or the file cannot be written.
    """
    if to not in SUFFIXES:
        hint = did_you_mean(to, tuple(SUFFIXES))
        raise UnsupportedError(f"--to {to} is not known for a metasurface.{hint} Formats: {', '.join(SUFFIXES)}")
    path = Path(path) if path is not None else Path(f"pattern{SUFFIXES[to]}")
    check_writable(path)
    if to == "sheet":
        write_text(path, _sheet(material, name))
        return (path,)
    columns, rows = 1, 1
    wanted = PERIOD_POINTS
    density_per_um2 = material.structure.density_per_nm2 * 1e6
    if size_mm is not None:
        # a small field needs no larger period than its longer side
        wanted = min(wanted, max(50, math.ceil(density_per_um2 * (1e3 * max(size_mm)) ** 2)))
    pattern = material.pattern(wanted, seed)
    box_um = pattern.box_nm * 1e-3
    if size_mm is not None:
        columns, rows = (max(1, math.ceil(1e3 * side / box_um - 1e-9)) for side in size_mm)
    xy_um = pattern.xy_nm * 1e-3
    core_um = float(np.dot(material.sizes.radii_nm, material.sizes.shares)) * 1e-3
    count = len(xy_um) * columns * rows
    if to == "csv":
        if count > MAX_CSV_POINTS:
            raise UnsupportedError(
                f"--to csv: {count} particles are more than {MAX_CSV_POINTS}; write gds or oas, which repeat a period"
            )
        offsets = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 1, 2) * box_um
        write_points_csv(path, (xy_um + offsets).reshape(-1, 2))
    else:
        if path.suffix.lower() != SUFFIXES[to]:
            raise UnsupportedError(f"{path}: --to {to} needs a name that ends in {SUFFIXES[to]}")
        write_layout(path, xy_um, core_um, box_um, periods=(columns, rows))
    facts: dict[str, Any] = {
        "format": to,
        "source": name,
        "nacre": __version__,
        "unit": "um",
        "particles": count,
        "particles_a_period": len(xy_um),
        "period_um": box_um,
        "periods": [columns, rows],
        "covers_mm": [columns * box_um * 1e-3, rows * box_um * 1e-3],
        "radius_um": core_um,
        "radii_spread": len(material.sizes.radii_nm) > 1,
        "arrangement": material.structure.name,
        "density_per_um2": density_per_um2,
        "packing": material.structure.packing,
        "seed": seed if seed is not None else getattr(material.arrangement, "seed", None),
        "shape": "circles are the outlines of spheres, seen from above",
    }
    beside = path.with_name(path.name + ".json")
    write_text(beside, json.dumps(facts, indent=2) + "\n")
    return path, beside


def _sheet(material: Metasurface, name: str) -> str:
    """Return the table of what to make, from the light's side inward, as CSV."""
    radius = float(np.dot(material.sizes.radii_nm, material.sizes.shares))
    core: list[Any] = [("core", material.core, "radius_nm", radius)]
    if material.shell is not None:
        core.insert(0, ("shell", material.shell.material, "thickness_nm", material.shell.thickness_nm))
    entries = [("ambient", material.ambient, "", ""), *core]
    if material.gap_nm:
        entries.append(("gap", material.ambient, "thickness_nm", material.gap_nm))
    entries += [(str(k), m, "thickness_nm", d) for k, (m, d) in enumerate(material.layers, start=1)]
    entries.append(("substrate", material.substrate, "", ""))
    buffer = io.StringIO()
    buffer.write(
        f"# sheet of {name}, nacre {__version__}; light comes from the ambient's side\n"
        f"# {material.structure.density_per_nm2 * 1e6:.6g} particles a um^2, packing {material.structure.packing:.4g}, "
        f"{material.structure.name}\n"
    )
    if len(material.sizes.radii_nm) > 1:
        shares, radii = np.array(material.sizes.shares), np.array(material.sizes.radii_nm)
        spread = float(np.sqrt(shares @ (radii - radius) ** 2))
        buffer.write(f"# the radii spread by {spread:.4g} nm about their mean\n")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["position", "material", "quantity", "value", "n_550nm", "k_550nm", "source"])
    for position, medium, quantity, value in entries:
        low, high = medium.range_nm
        n = complex(medium.n_complex(np.array([min(max(REFERENCE_NM, low), high)]))[0])
        shown = f"{value:.6g}" if value != "" else ""
        writer.writerow([position, medium.name, quantity, shown, f"{n.real:.6g}", f"{n.imag:.6g}", medium.source])
    return buffer.getvalue()
