"""Worker of bench_design_filters: optiland's needle synthesis in its own environment. Started by `common.Worker`."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from common import serve
from optiland.materials.base import BaseMaterial
from optiland.thin_film import ThinFilmStack
from optiland.thin_film.optimization import NeedleSynthesis

IN_PER_CENT = 1e4  # weight of squared residuals: the optimiser's tolerance is absolute where the merit is below 1


class Tabulated(BaseMaterial):
    """A material of indices given at wavelengths, linear between them."""

    def __init__(self, name: str, nm: list[float], n: list[float], k: list[float]) -> None:
        super().__init__()
        self.name, self.nm, self.table_n, self.table_k = name, np.array(nm), np.array(n), np.array(k)

    def _cache_state(self) -> tuple[str]:
        return (self.name,)

    def _calculate_n(self, wavelength: Any, **_: Any) -> Any:
        return np.interp(1e3 * np.asarray(wavelength, dtype=float), self.nm, self.table_n)

    def _calculate_k(self, wavelength: Any, **_: Any) -> Any:
        return np.interp(1e3 * np.asarray(wavelength, dtype=float), self.nm, self.table_k)


def needle(
    media: dict[str, list[list[float]]], nm: list[float], ambient: str, palette: list[str], substrate: str,
    start: list[tuple[str, float]], wanted_nm: list[float], wanted: list[float], angle_deg: float, needles: int,
    least_nm: float,
) -> dict[str, Any]:  # fmt: skip
    """Synthesise a stack for a wanted reflectance; return materials, thicknesses, its own rms and CPU seconds.

    Args:
        media: name -> n and k at `nm`.
        start: the stack to begin with, from the light's side.
        needles: insertions at most.
    """
    made = {name: Tabulated(name, nm, *rows) for name, rows in media.items()}
    stack = ThinFilmStack(incident_material=made[ambient], substrate_material=made[substrate])
    for name, thickness in start:
        stack.add_layer_nm(made[name], thickness, name)
    begun = time.process_time()
    synthesis = NeedleSynthesis(
        stack, [made[name] for name in palette], min_thickness_nm=least_nm, max_iterations=needles
    )
    synthesis.add_target(
        "R", list(wanted_nm), "equal", list(wanted), weight=IN_PER_CENT, aoi_deg=angle_deg, polarization="u"
    )
    result = synthesis.run()
    spent = time.process_time() - begun
    layers = [(layer.material.name, float(1e3 * layer.thickness_um)) for layer in result.stack.layers]
    return {"layers": layers, "merit": float(result.final_merit), "cpu": spent, "needles": result.num_iterations}


if __name__ == "__main__":
    serve({"needle": needle})
