"""The gratings and reliefs on which nacre is held against Maxwell's equations: drawn once, by a seed.

A *group* is one profile, one material and one direction of light at some wavelengths, in s and in p; a *case* is one
wavelength of it in one polarisation. `python -m validation._relief_cases` writes the groups, with their indices, to
`validation/data/relief_groups.json`; `_relief_cases_make.py` solves them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).resolve().parent / "data"
GROUPS, ORDERS = DATA / "relief_groups.json", DATA / "relief_orders.jsonl"
WAVELENGTHS_UM = np.linspace(0.4, 0.7, 16)
ANGLES_DEG = (0, 15, 30, 45, 60)
MATERIALS = ("Al", "Ag", "SiO2")
KINDS = ("lamellar", "sinusoidal")
EACH = 30  # groups of each kind of grating
STEEP_SHARE = 0.5  # of the lamellar ones: these can be deep, a third of all has to be
PERIOD_UM, DEPTH_UM = (0.6, 8.0), (0.05, 1.2)
STEEP = 0.3  # depth over period
MORE_STEEP = 2  # sinusoids, drawn later: with all shallow ones agreed on, a third of the cases was no longer deep
RELIEFS = 40
RELIEF_PERIOD_UM = (0.8, 2.0)
RELIEF_GRID = 64
SMOOTH_KINDS = ("hill", "swell")
SMOOTHS = 40  # of these reliefs
COLOURED = 4  # of every so many of them the colour is solved, of the others a few wavelengths
FEW_UM = [0.45, 0.55, 0.65]
SMOOTH_PERIOD_UM, SMOOTH_DEPTH_UM = (0.6, 1.2), (0.04, 0.35)
SMOOTH_STEEP = {"hill": 0.7, "swell": 0.0}  # shares of them that are deep
SMOOTH_MOST = {"hill": 0.38, "swell": 0.16}  # depth over period
SWELLS = 2  # highest order of the waves that a swell is made of


def draw_groups(seed: int = 1) -> list[dict[str, Any]]:
    """All groups, without indices."""
    random = np.random.default_rng(seed)
    groups = []
    for number in range(EACH * len(KINDS)):
        kind = KINDS[number % 2]
        rank = number // 2
        is_steep = rank < EACH * STEEP_SHARE if kind == "lamellar" else rank < EACH // 6
        while True:
            period, depth = (float(np.exp(random.uniform(*np.log(span)))) for span in (PERIOD_UM, DEPTH_UM))
            ratio = depth / period
            # beyond .4 the method of coordinates has no digits left for a sinusoid
            if is_steep == (ratio > STEEP) and (kind == "lamellar" or ratio < 0.4) and ratio < 1.2:
                break
        share = int(random.integers(78, 179)) / 256  # walls that lie on every solver's grid
        groups.append({
            "name": f"{kind}-{rank}", "kind": kind, "material": MATERIALS[rank % 3],
            "period_um": round(period, 4), "depth_um": round(depth, 4), "share": share,
            "angle_deg": int(random.choice(ANGLES_DEG)), "wavelengths_um": WAVELENGTHS_UM.round(4).tolist(),
        })  # fmt: skip
    for rank in range(RELIEFS):
        kind = ("bump", "random")[rank % 2]
        period = float(np.exp(random.uniform(*np.log(RELIEF_PERIOD_UM))))
        depth = float(np.exp(random.uniform(np.log(0.05), np.log(0.3))))
        groups.append({
            "name": f"{kind}-{rank}", "kind": kind, "material": ("SiO2", "Al")[rank // 2 % 2],
            "period_um": round(period, 4), "depth_um": round(depth, 4), "seed": rank,
            "angle_deg": int(random.choice(ANGLES_DEG[:4])),
            "wavelengths_um": [round(float(random.uniform(0.45, 0.65)), 4)],
        })  # fmt: skip
    random = np.random.default_rng(seed + 1)
    for rank in range(EACH, EACH + MORE_STEEP):
        period, ratio = float(np.exp(random.uniform(np.log(0.8), np.log(3.0)))), float(random.uniform(0.31, 0.4))
        groups.append({
            "name": f"sinusoidal-{rank}", "kind": "sinusoidal", "material": MATERIALS[rank % 3],
            "period_um": round(period, 4), "depth_um": round(ratio * period, 4), "share": 0.5,
            "angle_deg": int(random.choice(ANGLES_DEG)), "wavelengths_um": WAVELENGTHS_UM.round(4).tolist(),
        })  # fmt: skip
    return [*groups, *_draw_smooth_reliefs(np.random.default_rng(seed + 2))]


def _draw_smooth_reliefs(random: np.random.Generator) -> list[dict[str, Any]]:
    groups = []
    for number in range(SMOOTHS):
        kind, rank = SMOOTH_KINDS[number % 2], number // 2
        is_steep = rank < SMOOTHS // 2 * SMOOTH_STEEP[kind]
        while True:
            spans = SMOOTH_PERIOD_UM, SMOOTH_DEPTH_UM
            period, depth = (float(np.exp(random.uniform(*np.log(span)))) for span in spans)
            if is_steep == (depth / period > STEEP) and depth / period < SMOOTH_MOST[kind]:
                break
        all_waves = WAVELENGTHS_UM.round(4).tolist()
        groups.append({
            "name": f"{kind}-{rank}", "kind": kind, "material": MATERIALS[rank % 3],
            "period_um": round(period, 4), "depth_um": round(depth, 4), "seed": rank,
            "angle_deg": int(random.choice(ANGLES_DEG[:4])),
            "wavelengths_um": all_waves if rank % COLOURED == 0 else FEW_UM,
        })  # fmt: skip
    return groups


def relief_heights(group: dict[str, Any]) -> Any:
    """The heights of a relief over its depth, `[x, y]`.

    A round bump of three steps, 4 x 4 random features of two, a smooth hill, or a swell of the lowest waves.
    """
    if group["kind"] == "hill":
        wave = 0.5 + 0.5 * np.cos(2 * np.pi * np.arange(RELIEF_GRID) / RELIEF_GRID)
        return wave[:, None] * wave[None, :]
    if group["kind"] == "swell":
        random = np.random.default_rng(group["seed"])
        series = np.zeros((RELIEF_GRID, RELIEF_GRID), dtype=complex)
        low = np.arange(-SWELLS, SWELLS + 1)
        parts = random.normal(size=(2, len(low), len(low)))
        series[low[:, None], low[None, :]] = parts[0] + 1j * parts[1]
        heights = np.fft.ifft2(series).real
        return (heights - heights.min()) / np.ptp(heights)
    middle = (np.arange(RELIEF_GRID) + 0.5) / RELIEF_GRID - 0.5
    if group["kind"] == "bump":
        radius = np.hypot(middle[:, None], middle[None, :])
        return ((radius < 0.42).astype(float) + (radius < 0.3) + (radius < 0.18)) / 3.0
    random = np.random.default_rng(group["seed"])
    while True:
        features = random.integers(0, 2, (4, 4))
        if 4 <= features.sum() <= 12:
            return np.kron(features, np.ones((RELIEF_GRID // 4, RELIEF_GRID // 4)))


def relief_slopes(group: dict[str, Any]) -> Any:
    """dh/dx and dh/dy `[2, x, y]` of a smooth relief, exact: its waves are resolved."""
    series = np.fft.fft2(group["depth_um"] * relief_heights(group))
    wave = 2j * np.pi * np.fft.fftfreq(RELIEF_GRID, 1 / RELIEF_GRID) / group["period_um"]
    return np.array([np.fft.ifft2(wave[:, None] * series).real, np.fft.ifft2(wave[None, :] * series).real])


def profile(group: dict[str, Any], samples: int) -> tuple[Any, Any]:
    """Heights in um, and dh/dx, of one period of a grating."""
    x = (np.arange(samples) + 0.5) / samples
    depth = group["depth_um"]
    if group["kind"] == "lamellar":
        return depth * (np.abs(x - 0.5) < 0.5 * group["share"]), None
    wave = 2 * np.pi / group["period_um"]
    return 0.5 * depth * np.cos(2 * np.pi * x), -0.5 * depth * wave * np.sin(2 * np.pi * x)


def read_groups() -> list[dict[str, Any]]:
    """The groups that were drawn, with the material's index at each wavelength."""
    groups: list[dict[str, Any]] = json.loads(GROUPS.read_text(encoding="utf-8"))
    for group in groups:
        group["n"] = [complex(*pair) for pair in group["n"]]
    return groups


def read_orders() -> dict[str, list[dict[str, Any]]]:
    """What the solvers found: for each group a list over its wavelengths."""
    if not ORDERS.exists():
        return {}
    lines = ORDERS.read_text(encoding="utf-8").splitlines()
    return {found["name"]: found["cases"] for found in map(json.loads, lines)}


def main() -> None:
    """Write the groups with the indices that nacre's library gives."""
    from nacre.matter.indices.constant import named_constant

    groups = draw_groups()
    for group in groups:
        nm = 1e3 * np.array(group["wavelengths_um"])
        n = named_constant(group["material"]).n_complex(nm)
        group["n"] = [[round(float(each.real), 5), round(float(each.imag), 5)] for each in n]
    DATA.mkdir(exist_ok=True)
    text = "[\n" + ",\n".join(json.dumps(group) for group in groups) + "\n]\n"
    GROUPS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
