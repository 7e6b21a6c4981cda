"""Sparkle and graininess of 30 random effect paints: statistics of their flakes against drawn patches.

Both are asked through `nacre.texture`, so that times are those of a user. The paints are those of the tests
(`tests/pearl/test_pearl_texture.py`): metal or pearl flakes of 8 to 60 um, with and without a clear coat.
"""

from __future__ import annotations

import importlib.util
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from validation._film import canvas
from validation._rows import finish, row

FIGURE = "pearl_texture.png"
PAINTS, SIGMAS = 30, 2.0
WITHIN, BIAS = 0.9, 0.05  # share of values within two joint standard errors, and the mean ratio's deviation from 1
CLOSED_S, PATCH_S = 10.0, 60.0  # CPU time of one paint
NAMES = ("intensity", "area")
LEAST_PIXELS = 10.0  # sparkling pixels on the field, below which a ratio says nothing


def paints() -> Any:
    """The tests' own random paints."""
    path = Path(__file__).resolve().parents[1] / "tests" / "pearl" / "test_pearl_texture.py"
    spec = importlib.util.spec_from_file_location("test_pearl_texture", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.paint


def measured(data: dict[str, Any], method: str, seed: int = 0) -> tuple[Any, float]:
    """Texture and its CPU time."""
    begun = time.process_time()
    found = nacre.texture(data, method=method, seed=seed)
    return found, time.process_time() - begun


def main(out: Path) -> list[dict[str, Any]]:
    """Compare all paints; the rows hold shares, biases and times."""
    paint = paints()
    measured(paint(0), "statistics")  # compiles
    deviations: list[tuple[str, float, float, float]] = []
    grain, times = [], []
    for number in range(PAINTS):
        closed, closed_s = measured(paint(number), "statistics")
        patch, patch_s = measured(paint(number), "patch", seed=number)
        times.append((closed_s, patch_s))
        for angle, one in closed.sparkle.items():
            other = patch.sparkle[angle]
            tool = closed.instrument
            count = 0.01 * one.area * (1e3 * tool.field_mm / tool.pixel_um) ** 2
            for name in NAMES:
                a, b = getattr(one, name), getattr(other, name)
                joint = math.hypot(getattr(one, f"{name}_error"), getattr(other, f"{name}_error"))
                if count >= LEAST_PIXELS and b > 0:
                    deviations.append((name, a, b, joint))
        joint = math.hypot(closed.graininess.error, patch.graininess.error)
        grain.append((closed.graininess.value, patch.graininess.value, joint))
    rows = []
    for name in NAMES:
        a, b, joint = np.array([each[1:] for each in deviations if each[0] == name]).T
        share, ratio = float(np.mean(np.abs(a - b) <= SIGMAS * joint)), float(np.mean(a / b))
        rows.append(row(f"{name} of sparkle, {len(a)} values of {PAINTS} paints: within two joint standard errors",
                        f"at least {WITHIN:g}", f"{share:.3f}", share >= WITHIN, FIGURE))  # fmt: skip
        rows.append(row(f"{name} of sparkle: mean ratio of closed form and patch", f"within {BIAS:g} of 1",
                        f"{ratio:.3f}", abs(ratio - 1) <= BIAS, FIGURE))  # fmt: skip
    a, b, joint = np.array(grain).T
    share, ratio = float(np.mean(np.abs(a - b) <= SIGMAS * joint)), float(np.mean(a / b))
    rows.append(row(f"graininess of {PAINTS} paints: mean ratio of closed form and patch", f"within {BIAS:g} of 1",
                    f"{ratio:.3f}; {share:.2f} within two joint errors", abs(ratio - 1) <= BIAS, FIGURE))  # fmt: skip
    closed_s, patch_s = np.array(times).T
    rows.append(row("CPU seconds of a paint, closed form: median, largest", f"at most {CLOSED_S:g}",
                    f"{np.median(closed_s):.2f}, {max(closed_s):.2f}", max(closed_s) <= CLOSED_S, FIGURE))  # fmt: skip
    rows.append(row("CPU seconds of a paint, drawn patch: median, largest", f"at most {PATCH_S:g}",
                    f"{np.median(patch_s):.2f}, {patch_s.max():.2f}", patch_s.max() <= PATCH_S, FIGURE))  # fmt: skip
    draw(out, deviations, grain)
    return rows


def draw(out: Path, deviations: list[tuple[str, float, float, float]], grain: list[tuple[float, float, float]]) -> None:
    """Closed form over patch, with two joint standard errors."""
    figure, axes = canvas(1, 3, 9.0, 3.2)
    groups = [(name, [each[1:] for each in deviations if each[0] == name]) for name in NAMES] + [("graininess", grain)]
    for axis, (name, values) in zip(np.ravel(axes), groups, strict=True):
        a, b, joint = np.array(values).T
        axis.errorbar(b, a, yerr=SIGMAS * joint, fmt=".", markersize=4, linewidth=0.8)
        ends = [min(a.min(), b.min()), max(a.max(), b.max())]
        axis.plot(ends, ends, color="0.6", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel=f"{name}, drawn patch", ylabel=f"{name}, closed form")
    finish(figure, out, FIGURE)
