"""The reference gratings as recipes."""

from __future__ import annotations

from collections.abc import Sized
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.matter.periodic import order_tables

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "gratings" / "gratings_open.npz"


@cache
def reference() -> dict[str, Any]:
    """Return the arrays of the reference."""
    if not REFERENCE.is_file():
        pytest.skip("the shared reference of gratings is absent")
    with np.load(REFERENCE) as stored:
        return {name: stored[name] for name in stored.files}


def index(n: complex) -> dict[str, float]:
    return {"n": float(n.real), "k": float(n.imag)}


def recipe(i: int) -> dict[str, Any]:
    """Return a case of the reference as a recipe."""
    z = reference()
    period = 1e3 * float(z["period_x"][i])
    made: dict[str, Any] = {
        "family": "grating", "substrate": index(z["n_substrate"][i]), "lattice": {"period_nm": period},
    }  # fmt: skip
    shape = str(z["shape"][i])
    if shape in ("sine", "triangle"):
        made["profile"] = {"shape": "sinusoidal", "depth_nm": 1e3 * float(z["relief_depth"][i])}
        if shape == "triangle":
            made["profile"] |= {"shape": "triangle", "apex": float(z["relief_apex"][i])}
        return made
    made["layers"] = []
    for k in range(int(z["layer_count"][i])):
        ridge, groove = index(z["layer_n_ridge"][i, k]), index(z["layer_n_groove"][i, k])
        layer: dict[str, Any] = {"thickness_nm": 1e3 * float(z["layer_depth"][i, k]), "material": groove}
        if shape == "lamellar" and z["layer_fill"][i, k] == 1.0:
            layer["material"] = ridge
        elif shape == "lamellar":
            width, centre = float(z["layer_fill"][i, k]) * period, 1e3 * float(z["layer_center"][i, k])
            layer["shapes"] = [{"shape": "line", "material": ridge, "width_nm": width, "center_nm": [centre, 0.0]}]
        elif shape == "box":
            layer["shapes"] = [{"shape": "rectangle", "material": ridge, "width_nm": 1e3 * float(z["width"][i])}]
        else:
            layer["shapes"] = [{"shape": "disc", "material": ridge, "diameter_nm": 1e3 * float(z["width"][i])}]
        made["layers"].append(layer)
    if z["is_crossed"][i]:
        made["lattice"]["kind"] = "square"
    return made


def differences(i: int, found: Any) -> tuple[float, float]:
    """Return the largest difference of an efficiency and of a Jones coefficient from the reference."""
    z = reference()
    places = {tuple(number): k for k, number in enumerate(found.numbers.tolist())}
    efficiency = jones = 0.0
    seen = {"reflected": 0, "transmitted": 0}
    for k in range(int(z["order_start"][i]), int(z["order_stop"][i])):
        side = "transmitted" if z["order_side"][k] else "reflected"
        at = places[int(z["order_m"][k]), int(z["order_n"][k])]
        efficiency = max(efficiency, float(np.abs(getattr(found, side)[0, 0, at] - z["order_efficiency"][k]).max()))
        jones = max(jones, float(np.abs(getattr(found, f"{side}_jones")[0, 0, at] - z["order_jones"][k]).max()))
        seen[side] += 1
    for side, count in seen.items():
        assert np.isfinite(getattr(found, side)[0, 0, :, 0]).sum() == count
    return efficiency, jones


def check_resumed_table(
    monkeypatch: pytest.MonkeyPatch, folder: Path, name: str, stacks: Any, lam: np.ndarray, calls: int
) -> None:
    """Interrupt a table of orders, resume it: the same numbers as of one that was never interrupted, for less work.

    Args:
        name: the solver in `order_tables`, called with what it solves first, that the interrupt stops.
        calls: after which it does.
    """
    monkeypatch.setenv("NACRE_CACHE", str(folder))
    for least in ("MIN_STORED_S", "MIN_PART_S"):
        monkeypatch.setattr(order_tables, least, 0.0)
    solve, solved, limit = getattr(order_tables, name), [], float(calls)

    def counted(*given: Any) -> Any:
        if len(solved) >= limit:
            raise KeyboardInterrupt
        cases: Sized = next(value for value in given if isinstance(value, list | np.ndarray))  # the channels precede it
        solved.append(len(cases))
        return solve(*given)

    monkeypatch.setattr(order_tables, name, counted)
    with pytest.raises(KeyboardInterrupt):
        order_tables.order_tables(stacks, lam, None)
    limit, before = np.inf, sum(solved)
    resumed = order_tables.order_tables(stacks, lam, None)
    again = sum(solved) - before
    monkeypatch.setenv("NACRE_CACHE", str(folder / "other"))
    solved.clear()
    whole = order_tables.order_tables(stacks, lam, None)
    assert again < sum(solved)  # complete parts are not solved again
    assert np.array_equal(resumed.reflected, whole.reflected) and np.array_equal(resumed.mirror, whole.mirror)
