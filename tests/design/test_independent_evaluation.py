"""Designed films evaluated by tmm and colour-science at 1 nm, in a fresh process, from the file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre

# the stranger's own optics and colours; the indices of the named materials are data, and come from nacre
JUDGE = """
import json, sys, tomllib
import colour, numpy as np, tmm
from nacre.matter.indices.constant import named_constant

recipe, angle, lamp = tomllib.load(open(sys.argv[1], "rb")), float(sys.argv[2]), sys.argv[3]
nm = np.arange(380.0, 781.0)
names = [recipe.get("ambient", "air"), *[layer["material"] for layer in recipe["layers"]], recipe["substrate"]]
n = [named_constant(name).n_complex(nm) for name in names]
d = [np.inf, *[layer["thickness_nm"] for layer in recipe["layers"]], np.inf]
seen = [tmm.unpolarized_RT([m[i] for m in n], d, np.radians(angle), w)["R"] for i, w in enumerate(nm)]
shape = colour.SpectralShape(380, 780, 1)
observer = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"].copy().align(shape)
light = colour.SDS_ILLUMINANTS[lamp].copy().align(shape)
weights = observer.values * light.values[:, None]
weights = weights / weights[:, 1].sum()
white = weights.sum(axis=0)
f = lambda t: np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
x, y, z = f(np.array(seen) @ weights / white)
print(json.dumps([116 * y - 16, 500 * (x - y), 200 * (y - z)]))
"""
# both cut the spectrum at 380 and 780 nm here, nacre goes on to 360 and 830
CUT_OFF = 0.03


def stranger(recipe: Path, angle: float, lamp: str) -> np.ndarray:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", JUDGE, str(recipe), str(angle), lamp], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


@pytest.mark.full
@pytest.mark.parametrize("lamps", [["D65"], ["D65", "A"]])
def test_reported_distances_agree_with_tmm_and_colour_science(tmp_path: Path, lamps: list[str]) -> None:
    import colour

    angles = (0.0, 45.0)
    target: dict[str, Any] = {
        "recipe": {"family": "film", "substrate": "Al", "layers": []},
        "layers": {"palette": ["SiO2", "TiO2", "Si", "Cr"], "max_layers": 5, "substrate": ["Al", "Ag"]},
        "target": [{"geometry": f"specular {a:g}", "lab": [50, -20, 10], "tolerance": 2.0} for a in angles],
        "light": {"illuminants": lamps},
        "search": {"seconds": 20, "solutions": 2},
    }
    design = nacre.design(target, tmp_path / "out")
    assert len(design.solutions) == 2
    for solution in design.solutions:
        assert solution.recipe is not None
        for r in solution.targets:
            assert r.lamp is not None
            seen = stranger(solution.recipe, r.target.geometry.theta_deg, r.lamp)
            own = float(colour.delta_E(np.array([50.0, -20.0, 10.0]), seen, method="CIE 2000"))
            assert r.distance == pytest.approx(own, abs=CUT_OFF)
