"""Random gratings, drawn by class, for the script that measures stated errors."""

from __future__ import annotations

from typing import Any

import numpy as np

METALS = ("Ag", "Au", "Al")
GLASS: dict[str, Any] = {"n": 1.5}
Case = tuple[dict[str, Any], float, float, float]  # recipe, wavelength in nm, angle and azimuth in degrees


def draw(kind: str, rng: np.random.Generator) -> Case:
    """Return a random grating of a class with its light."""
    wavelength, angle = float(rng.uniform(400, 700)), float(rng.uniform(0, 60))
    azimuth = 0.0 if rng.random() < 0.4 else float(rng.uniform(0, 90))
    recipe: dict[str, Any] = {"family": "grating"}
    if "lines" in kind:
        recipe |= _lines(rng, "metal" in kind, "sloping" in kind)
    elif "profile" in kind:
        recipe |= _profile(rng, "metal" in kind, "smooth" in kind)
    else:
        recipe |= _two_periods(rng, kind)
        # light along the normal or in a plane of symmetry, so that a finer solution is affordable
        angle, azimuth = (0.0, 0.0) if rng.random() < 0.5 else (angle, float(rng.choice([0.0, 90.0])))
    return recipe, wavelength, angle, azimuth


def _clear(rng: np.random.Generator) -> dict[str, Any]:
    return {"n": float(rng.uniform(1.3, 2.6))}


def _lines(rng: np.random.Generator, is_metal: bool, is_sloping: bool) -> dict[str, Any]:
    period = float(rng.uniform(300, 700))
    width = period * float(rng.uniform(0.2, 0.8))
    depth = float(rng.uniform(30, 300))
    material: Any = str(rng.choice(METALS)) if is_metal else "Si" if rng.random() < 0.3 else _clear(rng)
    line = {"shape": "line", "material": material, "width_nm": width}
    if is_sloping:
        least = np.degrees(np.arctan2(depth, 0.8 * min(width, period - width)))
        line["sidewall_deg"] = float(rng.uniform(max(60.0, least), 89.0))
    layers: list[dict[str, Any]] = [{"thickness_nm": depth, "material": "air", "shapes": [line]}]
    if rng.random() < 0.4:
        layers.append({"thickness_nm": float(rng.uniform(20, 200)), "material": _clear(rng)})
    substrate = material if rng.random() < 0.4 else GLASS
    return {"substrate": substrate, "layers": layers, "lattice": {"period_nm": period}}


def _profile(rng: np.random.Generator, is_metal: bool, is_smooth: bool) -> dict[str, Any]:
    period = float(rng.uniform(300, 500))
    profile: dict[str, Any] = {"depth_nm": period * float(rng.uniform(0.1, 0.9))}
    kind = "sinusoidal" if is_smooth else str(rng.choice(["triangle", "triangle", "trapezoid"]))
    profile["shape"] = kind
    if kind == "triangle":
        profile["apex"] = float(rng.uniform(0.05, 0.95))
    if kind == "trapezoid":
        top = float(rng.uniform(0.15, 0.6))
        profile |= {"top": top, "bottom": float(rng.uniform(0.1, 0.9 - top))}
    material: Any = str(rng.choice(METALS)) if is_metal else _clear(rng)
    return {"substrate": material, "lattice": {"period_nm": period}, "profile": profile}


def _two_periods(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    period = float(rng.uniform(250, 500))
    shape, material = kind.split(" of ")
    filling: Any = str(rng.choice(METALS)) if material == "metal" else "Si" if rng.random() < 0.3 else _clear(rng)
    size = period * float(rng.uniform(0.3, 0.85))
    outline: dict[str, Any] = {"shape": "disc", "diameter_nm": size}
    if shape == "rectangles":
        outline = {"shape": "rectangle", "width_nm": size, "length_nm": period * float(rng.uniform(0.3, 0.85))}
    elif shape == "ellipses":
        outline = {"shape": "ellipse", "width_nm": size, "length_nm": size * float(rng.uniform(0.4, 0.9))}
    elif shape == "rings":
        outline = {"shape": "ring", "diameter_nm": size, "inner_diameter_nm": size * float(rng.uniform(0.3, 0.8))}
    is_hole = shape == "discs" and material == "metal" and rng.random() < 0.3
    ground: Any = filling if is_hole else "air"
    outline["material"] = "air" if is_hole else filling
    layers: list[dict[str, Any]] = [
        {"thickness_nm": float(rng.uniform(20, 150)), "material": ground, "shapes": [outline]}
    ]
    if rng.random() < 0.4:
        layers.append({"thickness_nm": float(rng.uniform(20, 150)), "material": _clear(rng)})
    kinds = ["square", "square", "hexagonal"] if shape in ("discs", "rings") else ["square"]
    lattice = {"kind": str(rng.choice(kinds)), "period_nm": period}
    return {"substrate": filling if rng.random() < 0.2 else GLASS, "layers": layers, "lattice": lattice}
