"""Random recipes of every family, one a generator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

DIELECTRICS = ("SiO2", "TiO2", "MgF2", "Al2O3", "Si3N4", "ZnS")
ANYTHING = (*DIELECTRICS, "Ag", "Au", "Cr", "Si", "Ti", "Fe2O3")


def random_film(g: np.random.Generator) -> dict[str, Any]:
    layers = [
        {"material": str(g.choice(ANYTHING)), "thickness_nm": float(g.uniform(0, 600))} for _ in range(g.integers(0, 6))
    ]
    surface = {
        "distribution": str(g.choice(["ggx", "beckmann", "blinn", "ashikhmin-shirley"])),
        "roughness": [float(v) for v in g.uniform(0.02, 0.6, 2)],
        "compensate": bool(g.integers(2)),
    }
    substrate: Any = {"n": float(g.uniform(1.2, 2.2))} if g.random() < 0.5 else str(g.choice(ANYTHING))
    return {"family": "film", "substrate": substrate, "layers": layers, "surface": surface}


def random_relief(g: np.random.Generator, folder: Path) -> dict[str, Any]:
    np.save(folder / "h.npy", g.uniform(0, g.uniform(0.05, 0.5), (8, 8)))
    return {
        "family": "relief",
        "heights": "h.npy",
        "feature_um": float(g.uniform(1.0, 2.0)),
        "blur_um": float(g.uniform(0.3, 0.6)),
        "coating": str(g.choice(["Al", "Ag", "Cr", "Cu"])),
        "coherence": {"sigma": float(g.uniform(1.5, 3.0))},
    }


def random_metasurface(g: np.random.Generator) -> dict[str, Any]:
    coverage = float(g.uniform(0.01, 0.1))
    return {
        "family": "metasurface",
        "substrate": {"n": float(g.uniform(1.4, 1.8))},
        "particle": {
            "material": str(g.choice(["Ag", "Si", "TiO2"])),
            "radius_nm": float(g.uniform(40, 90)),
            "gap_nm": 2,
        },
        "monolayer": {"coverage": coverage, "packing": float(min(0.5, coverage * g.uniform(1.0, 4.0)))},
        "model": {"correction": "qca-balanced"},
    }


def random_pearl(g: np.random.Generator) -> dict[str, Any]:
    flakes = {
        "volume_fraction": float(g.uniform(0.005, 0.03)),
        "substrate": {"material": "mica", "thickness_nm": 400.0, "deviation_nm": float(g.uniform(0, 100))},
        "coatings": [{"material": str(g.choice(["TiO2", "Fe2O3", "SiO2"])), "thickness_nm": float(g.uniform(40, 150))}],
        "normal_deviation": float(g.uniform(0.05, 0.3)),
    }
    stratum = {"resin": {"n": 1.5}, "thickness_um": 100, "roughness": float(g.uniform(0, 0.3)), "platelets": [flakes]}
    return {"family": "pearl", "strata": [stratum], "base": {"albedo": float(g.uniform(0, 1))}}
