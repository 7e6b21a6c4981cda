"""What the pearl scripts share: where gloss and diffuse are looked at, colours without brightness, rows, tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.table import from_half_difference
from nacre.core.arrays import Array
from nacre.families.pearl.tables import tables
from nacre.light import spectrum_to_xyz, xyz_to_lab, xyz_to_xyy

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "pearl"
SRGB = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.64, 0.33]])
GRID_NM = np.arange(360.0, 831.0, 10.0)
ENERGY_BALANCES = ("conserving", "published")
_energy_balance = ["conserving"]  # in effect; see `with_balance`
MIDDLE_GREY = 0.1842  # luminance of L* = 50: chroma is compared there, so that brightness does not pass for it


@contextmanager
def with_balance(how: str) -> Iterator[None]:
    """Use "conserving" or "published" flakes in the block, whatever the recipes say."""
    before, _energy_balance[0] = _energy_balance[0], how
    try:
        yield
    finally:
        _energy_balance[0] = before


def energy_balance() -> str:
    """The energy balance in effect."""
    return _energy_balance[0]


def material_of(recipe: Any) -> nacre.Material:
    """The material of a file or a dictionary, with the energy balance in effect."""
    material = nacre.load(recipe) if isinstance(recipe, str | Path) else nacre.material(recipe)
    return material.vary({
        f"strata[{i}].platelets[{j}].energy_balance": energy_balance()
        for i, stratum in enumerate(material.data["strata"]) for j in range(len(stratum.get("platelets", ())))
    })  # fmt: skip


def in_both_balances(
    compare: Callable[[], list[dict[str, Any]]], why: dict[str, str] | None = None
) -> list[dict[str, Any]]:
    """Check each claim with both energy balances: columns "conserving" and "as printed", and a verdict.

    Args:
        compare: returns the rows of `row`, in the same order whatever the balance.
        why: claim -> what the verdict on a claim that holds in neither balance says; default: "false".
    """
    found = {}
    for how in ENERGY_BALANCES:
        with with_balance(how):
            found[how] = compare()
    rows = []
    for physical, printed in zip(*(found[how] for how in ENERGY_BALANCES), strict=True):
        good, well = (one["verdict"] == "holds" for one in (physical, printed))
        verdict = "holds" if good else "holds only as printed, not physical"
        if not (good or well):
            verdict = (why or {}).get(physical["claim"], "false: in neither balance")
        rows.append({**physical, "ours": f"{physical['ours']}{'' if good else ' (no)'}",
                     "printed": f"{printed['ours']}{'' if well else ' (no)'}", "verdict": verdict})  # fmt: skip
    return rows


def baked(recipe: Any, effort: float) -> Any:
    """The noise-free form of a pearl at 10 nm, made with a share of its usual walks.

    Args:
        recipe: a file or a dictionary.
        effort: 1 for the usual number of walks.
    """
    material = material_of(recipe).vary({"quality": "reference"})
    (lobe,) = [lobe for lobe in material.bsdf(GRID_NM).lobes if isinstance(lobe, Layered)]
    return tables(lobe, effort)


def seen(lobe: Any, half_deg: Any, difference_deg: Any) -> Array:
    """XYZ of pi f, `[..., 3]`, at half and difference angles; the difference across the half vector's plane."""
    half, difference = np.broadcast_arrays(np.radians(half_deg), np.radians(difference_deg))
    wi, wo = from_half_difference(half, difference, np.full(half.shape, 0.5 * np.pi))
    return np.asarray(spectrum_to_xyz(np.pi * lobe.evaluate(wi, wo), lobe.wavelengths_nm))


def lab_at_50(xyz: Array) -> Array:
    """CIELAB of colours brought to lightness 50, `[..., 3]`."""
    return np.asarray(xyz_to_lab(MIDDLE_GREY * xyz / xyz[..., 1:2]))


def chroma(xyz: Array) -> Any:
    """CIELAB chroma at lightness 50, `[...]`."""
    lab = lab_at_50(xyz)
    return np.hypot(lab[..., 1], lab[..., 2])


def hue_deg(xyz: Array) -> Any:
    """CIELAB hue in [0, 360)."""
    lab = lab_at_50(xyz)
    return np.degrees(np.arctan2(lab[..., 2], lab[..., 1])) % 360.0


def hue_distance(a: Array, b: Array) -> Any:
    """Degrees between two hues, 0 to 180."""
    return np.abs((hue_deg(a) - hue_deg(b) + 180.0) % 360.0 - 180.0)


def track(axis: Any, xyz: Any, style: str, label: str, colour: str) -> None:
    """Draw a chromaticity track with the sRGB triangle; a square marks its first value."""
    xy = np.array([xyz_to_xyy(value)[:2] for value in xyz])
    axis.plot(*SRGB.T, color="0.8", linewidth=1)
    axis.plot(*xy.T, style, color=colour, marker="o", markersize=3, label=label)
    axis.plot(*xy[0], marker="s", color=colour)
    axis.set(xlim=(0.05, 0.6), ylim=(0.0, 0.6), xlabel="x", ylabel="y")
    axis.legend(frameon=False, fontsize=8)
