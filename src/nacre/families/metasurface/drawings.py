"""The data for fabricating a metasurface: particle positions, and the layers under them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nacre.families.metasurface.material import Metasurface
from nacre.matter.drawings import DrawingRequest, LayerSheet, Layout

PERIOD_POINTS = 20_000  # S(q) of a period is that of the endless pattern beyond some 2 pi / period
REFERENCE_NM = 550.0
COLUMNS = ("position", "material", "quantity", "value", "n_550nm", "k_550nm", "source")


def layout(material: Metasurface, request: DrawingRequest) -> Layout:
    """Return one period of about 20 000 particles, repeated until it covers the area asked for.

    Whole periods are drawn, so that the pattern reaches over the area's far edges.

    Raises:
        UnsupportedError: only S(q) is known.
    """
    columns, rows = 1, 1
    wanted = PERIOD_POINTS
    density_per_um2 = material.structure.density_per_nm2 * 1e6
    if request.size_mm is not None:
        # a small field needs no larger period than its longer side
        wanted = min(wanted, max(50, math.ceil(density_per_um2 * (1e3 * max(request.size_mm)) ** 2)))
    pattern = material.pattern(wanted, request.seed)
    box_um = pattern.box_nm * 1e-3
    if request.size_mm is not None:
        columns, rows = (max(1, math.ceil(1e3 * side / box_um - 1e-9)) for side in request.size_mm)
    seed = request.seed if request.seed is not None else getattr(material.arrangement, "seed", None)
    facts: dict[str, Any] = {
        "radii_spread": len(material.sizes.radii_nm) > 1,
        "arrangement": material.structure.name,
        "density_per_um2": density_per_um2,
        "packing": material.structure.packing,
        "seed": seed,
        "shape": f"circles are the outlines of {_noun(material)}, seen from above",
    }
    return Layout(pattern.xy_nm * 1e-3, _mean_radius_nm(material) * 1e-3, box_um, (columns, rows), facts)


def layer_sheet(material: Metasurface) -> LayerSheet:
    """Return the table of what to make, from the light's side inward."""
    radius = _mean_radius_nm(material)
    core: list[Any] = [] if material.core is None else [("core", material.core, "radius_nm", radius)]
    if material.shell is not None:
        core.insert(0, ("shell", material.shell.material, "thickness_nm", material.shell.thickness_nm))
    entries = [("ambient", material.ambient, "", ""), *core]
    if material.gap_nm:
        entries.append(("gap", material.ambient, "thickness_nm", material.gap_nm))
    entries += [(str(k), m, "thickness_nm", d) for k, (m, d) in enumerate(material.layers, start=1)]
    entries.append(("substrate", material.substrate, "", ""))
    remarks = [
        f"{material.structure.density_per_nm2 * 1e6:.6g} particles a um^2, packing {material.structure.packing:.4g}, "
        f"{material.structure.name}"
    ]
    if material.body is not None:
        remarks.append(
            f"particles: {material.body.name}, {2 * material.body.radius_nm:.6g} nm wide, "
            f"{material.body.height_nm:.6g} nm high, {material.gap_nm:g} nm above the layers"
        )
    if len(material.sizes.radii_nm) > 1:
        shares, radii = np.array(material.sizes.shares), np.array(material.sizes.radii_nm)
        spread = float(np.sqrt(shares @ (radii - radius) ** 2))
        remarks.append(f"the radii spread by {spread:.4g} nm about their mean")
    rows = []
    for position, medium, quantity, value in entries:
        low, high = medium.range_nm
        n = complex(medium.n_complex(np.array([min(max(REFERENCE_NM, low), high)]))[0])
        shown = float(value) if value != "" else ""
        rows.append(dict(zip(COLUMNS, (position, medium.name, quantity, shown, n.real, n.imag, medium.source))))
    return LayerSheet(COLUMNS, tuple(rows), tuple(remarks), "sheet", "pattern")


def _mean_radius_nm(material: Metasurface) -> float:
    return float(np.dot(material.sizes.radii_nm, material.sizes.shares))


def _noun(material: Metasurface) -> str:
    if material.body is None:
        return "spheres"
    return f"{material.body.shape}s" if material.body.shape else "particles"
