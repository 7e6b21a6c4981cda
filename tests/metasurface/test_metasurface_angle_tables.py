"""Do the tables of a metasurface have the R and T of the direct solution at any incidence, or the error they state?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf

pytestmark = pytest.mark.filterwarnings("ignore::nacre.families.metasurface.material.MetasurfaceWarning")

LAM = np.array([450.0, 550.0, 650.0])
BAR = 0.005  # of R and T, where no larger error is stated
ANGLES = np.radians(np.concatenate([np.linspace(0.5, 84.0, 40), np.linspace(85.0, 89.5, 10)]))


def recipe(seed: int) -> dict[str, Any]:
    """Random spheres on a random film and substrate."""
    rng = np.random.default_rng(seed)
    found = {
        "family": "metasurface",
        "particle": {
            "material": str(rng.choice(["Au", "Ag", "TiO2", "Si"])),
            "radius_nm": float(rng.uniform(30, 60)),
            "gap_nm": 6.0,
        },
        "monolayer": {"coverage": float(rng.uniform(0.01, 0.25))},
        "substrate": (1.0, 1.5, "Si")[seed % 3],
        "model": {"correction": "qca-balanced"},
    }
    if seed % 2:
        layer = {"material": str(rng.choice(["SiO2", "TiO2"])), "thickness_nm": float(rng.uniform(50, 2500))}
        found["layers"] = [layer]
    return found


def specular_and_diffuse(bsdf: Bsdf) -> Any:
    """Return specular R and T, diffuse R and T of the tables, `[part, angle, wavelength]`."""
    found = []
    for theta in ANGLES:
        wi = np.array([np.sin(theta), 0.0, np.cos(theta)])
        mirrored = bsdf.lobes[0].specular(wi[2:])
        found.append([mirrored.reflectance[0], mirrored.transmittance[0], *bsdf.lobes[1].hemispherical(wi)])
    return np.moveaxis(np.array(found), 1, 0)


@pytest.mark.parametrize("seed", range(9))
def test_the_powers_of_the_tables_are_within_the_stated_error(seed: int) -> None:
    model = nacre.material(recipe(seed)).model
    bsdf, exact = model.bsdf(LAM), model.spectrum(ANGLES, LAM)
    parts = [
        exact.specular_reflectance, exact.specular_transmittance, exact.diffuse_reflectance,
        exact.diffuse_transmittance,
    ]  # fmt: skip
    stated = bsdf.provenance["angle_table"]["largest_error"]
    for found, part in zip(specular_and_diffuse(bsdf), parts, strict=True):
        assert np.max(np.abs(found - (0.0 if part is None else part))) <= max(BAR, stated)
    assert stated <= 0.05  # a bound that covers everything would say nothing


def test_fringes_of_a_thick_film_get_more_nodes_than_a_bare_substrate() -> None:
    bare = recipe(2)
    thick = bare | {"layers": [{"material": "SiO2", "thickness_nm": 2500.0}]}
    counts = [nacre.material(d).model.bsdf(LAM).provenance["angle_table"]["cosines"] for d in (bare, thick)]
    assert counts[0] < counts[1]
