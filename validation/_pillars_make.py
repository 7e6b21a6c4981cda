"""Draw gratings of two periods from clear materials and solve them by `fmmax`, with two numbers of Fourier orders.

Run as `.venv-validate/bin/python -m validation._pillars_make`, ten minutes of processor time; a second run goes on.
Each line of `validation/data/pillar_orders.jsonl` has a recipe, the light, and the efficiencies of the orders that
propagate.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).resolve().parent / "data"
ORDERS = DATA / "pillar_orders.jsonl"
SEED = 20261127
KINDS = ("disc", "ellipse", "rectangle", "ring", "cross", "polygon")
LATTICES = ("square", "rectangular", "hexagonal")
INDICES = {"Si": (3.9, 0.02), "TiO2": (2.45, 0.0), "SiN": (2.02, 0.0), "glass": (1.46, 0.0)}
COUNT = 18  # twelve of them are solved so far, four with silicon
GRID = 512  # samples of the cell along each vector
TERMS = (200, 400)


def drawn_case(number: int) -> dict[str, Any]:
    """Return a grating and `light`: wavelength in nm, incidence and azimuth (of the wave vector) in degrees."""
    g = np.random.default_rng((SEED, number))
    kind = KINDS[number % len(KINDS)]
    lattice = LATTICES[(number + number // len(KINDS)) % len(LATTICES)]
    name = str(g.choice(list(INDICES)))
    is_hole = bool(g.random() < 0.4)
    period = float(2 * g.integers(125, 300))
    second = float(2 * g.integers(125, 300)) if lattice == "rectangular" else period
    least = min(period, second) * (0.9 if lattice == "hexagonal" and kind in ("rectangle", "cross", "polygon") else 1.0)
    shape = _shape(kind, least, g)
    n, k = INDICES[name]
    solid, air = {"n": n, "k": k}, {"n": 1.0}
    cell: dict[str, Any] = {"period_nm": [period, second] if lattice == "rectangular" else period}
    recipe = {
        "family": "grating", "substrate": {"n": 1.46},
        "lattice": cell | ({"kind": "hexagonal"} if lattice == "hexagonal" else {}),
        "layers": [{
            "thickness_nm": float(g.integers(80, 400)), "material": solid if is_hole else air,
            "shapes": [shape | {"material": air if is_hole else solid}],
        }],
    }  # fmt: skip
    azimuth = float(g.integers(0, 360)) if g.random() < 0.7 else 0.0
    light = float(g.integers(430, 720)) + 0.3, float(g.choice([0, *g.integers(3, 65, 4)])), azimuth
    return {"number": number, "material": name, "is_hole": is_hole, "recipe": recipe, "light": light}


def _shape(kind: str, period: float, g: np.random.Generator) -> dict[str, Any]:
    """Return a shape of a recipe; its size lies between 0.35 and 0.8 of the period."""
    size, other = (float(round(period * x)) for x in np.sort(g.uniform(0.35, 0.8, 2))[::-1])
    if kind == "disc":
        return {"shape": kind, "diameter_nm": size}
    if kind == "ring":
        return {"shape": kind, "diameter_nm": size, "inner_diameter_nm": float(round(size * g.uniform(0.3, 0.7)))}
    if kind == "polygon":
        corners = int(g.integers(3, 7))
        angles = 2 * np.pi * (np.arange(corners) + g.uniform(-0.2, 0.2, corners)) / corners
        points = 0.5 * size * np.column_stack([np.cos(angles), np.sin(angles)])
        return {"shape": kind, "points_nm": np.round(points, 1).tolist()}
    return {"shape": kind, "width_nm": other if kind != "cross" else float(round(0.5 * other)), "length_nm": size}


def is_inside(shape: dict[str, Any], x: Any, y: Any) -> Any:
    """Whether points lie inside a shape of a recipe."""
    kind = shape["shape"]
    if kind in ("disc", "ring"):
        r = 2 * np.hypot(x, y)
        return (r < shape["diameter_nm"]) & (r >= shape.get("inner_diameter_nm", -1.0))
    if kind == "polygon":
        points = np.array(shape["points_nm"])
        found = np.zeros(x.shape, dtype=bool)
        for (x_0, y_0), (x_1, y_1) in zip(points, np.roll(points, -1, axis=0), strict=True):
            is_left = (x - x_0) * abs(y_1 - y_0) < (x_1 - x_0) * (y - y_0) * np.sign(y_1 - y_0)
            found ^= ((y_0 > y) != (y_1 > y)) & is_left
        return found
    w, h = shape["width_nm"], shape["length_nm"]
    if kind == "ellipse":
        return np.hypot(2 * x / w, 2 * y / h) < 1.0
    a, b = 2 * np.abs(x), 2 * np.abs(y)
    return (a < w) & (b < h) if kind == "rectangle" else ((a < w) & (b < h)) | ((a < h) & (b < w))


def cell_vectors(recipe: dict[str, Any]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lattice vectors."""
    period = recipe["lattice"]["period_nm"]
    a, b = period if isinstance(period, list) else (period, period)
    turn = np.radians(60.0 if recipe["lattice"].get("kind") == "hexagonal" else 90.0)
    return (a, 0.0), (float(b * np.cos(turn)), float(b * np.sin(turn)))


def permittivity(recipe: dict[str, Any], grid: int = GRID) -> Any:
    """Return the layer's permittivity `[u, v]`: the mean over 4 x 4 points of each sample."""
    layer = recipe["layers"][0]
    (a, _), (b_x, b_y) = cell_vectors(recipe)
    u = (np.arange(4 * grid) + 0.5) / (4 * grid) - 0.5
    u, v = np.meshgrid(u, u, indexing="ij")
    inside = np.zeros(u.shape, dtype=bool)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            inside |= is_inside(layer["shapes"][0], (u + i) * a + (v + j) * b_x, (v + j) * b_y)
    share = inside.reshape(grid, 4, grid, 4).mean(axis=(1, 3))
    ground, own = ((m["n"] + 1j * m.get("k", 0.0)) ** 2 for m in (layer["material"], layer["shapes"][0]["material"]))
    return ground + (own - ground) * share


def solve_by_fmmax(case: dict[str, Any], terms: int) -> dict[str, Any]:
    """Return "reflected" and "transmitted": (m, n) -> efficiency for s and p light."""
    from validation._fmmax_orders import crossed_orders

    recipe = case["recipe"]
    found = crossed_orders(
        cell_vectors(recipe), permittivity(recipe), recipe["layers"][0]["thickness_nm"], recipe["substrate"]["n"],
        tuple(case["light"]), terms,
    )  # fmt: skip
    return {
        side: {
            f"{m},{n}": [round(float(e), 6) for e in values]
            for (m, n), values in zip(found["numbers"].tolist(), found[side], strict=True)
            if abs(values).max() > 1e-7
        }
        for side in ("reflected", "transmitted")
    }


def read_cases() -> list[dict[str, Any]]:
    """Return the solved cases."""
    if not ORDERS.exists():
        return []
    return [json.loads(line) for line in ORDERS.read_text(encoding="utf-8").splitlines()]


def main() -> None:
    """Solve what is not solved yet, a line a case."""
    DATA.mkdir(exist_ok=True)
    done = {case["number"] for case in read_cases()}
    for number in range(COUNT):
        if number in done:
            continue
        case = drawn_case(number)
        case["fmmax"] = {str(terms): solve_by_fmmax(case, terms) for terms in TERMS}
        with ORDERS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(case) + "\n")
        print(number, case["recipe"]["layers"][0]["shapes"][0]["shape"], flush=True)


if __name__ == "__main__":
    sys.exit(main())
