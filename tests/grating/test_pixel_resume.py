"""Pictures of pixels: the same answer after interrupts and on machines of any speed."""

from __future__ import annotations

import itertools
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.core.errors import NacreError, RecipeError
from nacre.optimise import checkpoint
from nacre.optimise.solutions import DesignProgress

NODES = 33  # 17 nodes and one refinement
STABLE = ("layers-0-thickness_nm.npy", "layers-0-thickness_nm.png", "reached.png", "pixels.json")


@pytest.fixture
def target(tmp_path: Path) -> dict[str, Any]:
    Image.fromarray(np.random.default_rng(1).integers(0, 256, (5, 6, 3), dtype=np.uint8)).save(tmp_path / "photo.png")
    line = {"shape": "line", "material": {"n": 2.2}, "width_nm": 100}
    return {
        "recipe": {
            "family": "grating", "substrate": "glass", "lattice": {"period_nm": 250},
            "layers": [{"thickness_nm": 100, "material": "air", "shapes": [line]}],
            "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 150},
        },
        "parameters": {"layers[0].thickness_nm": [50, 600]},
        "target": [{"image": str(tmp_path / "photo.png"), "geometry": "specular 0"}],
        "search": {"evaluations": NODES},
    }  # fmt: skip


def interrupting(at: list[int]) -> Any:
    """Return a progress callback that sends SIGINT when a number of materials is solved."""

    def hear(progress: DesignProgress) -> None:
        if at and progress.evaluations >= at[0]:
            at.pop(0)
            signal.raise_signal(signal.SIGINT)

    return hear


def same(one: Path, other: Path) -> bool:
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in STABLE)


def test_a_picture_resumes_to_the_same_bits(target: dict[str, Any], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(checkpoint, "WRITE_INTERVAL_S", -1.0)
    whole = nacre.design(target, tmp_path / "whole")
    assert whole.summary["solutions"][0]["nodes"] == NODES
    with pytest.raises(KeyboardInterrupt):  # before any picture is possible
        nacre.design(target, tmp_path / "stopped", progress=interrupting([5]))
    early = nacre.design(target, tmp_path / "stopped", resume=True, progress=interrupting([20]))
    assert early.status == "interrupted" and early.summary["solutions"][0]["nodes"] < NODES
    seen: list[float] = []
    found = nacre.design(
        target, tmp_path / "stopped", resume=True, progress=lambda p: seen.append(p.evaluations)
    )  # fmt: skip
    assert found.status == whole.status and same(tmp_path / "whole", tmp_path / "stopped")
    assert min(n for n in seen if n) > 20  # earlier materials are not solved again


def test_levels_resume_too(target: dict[str, Any], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(checkpoint, "WRITE_INTERVAL_S", -1.0)
    target["limits"] = {"height_levels": 6}
    nacre.design(target, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        nacre.design(target, tmp_path / "stopped", progress=interrupting([3]))
    nacre.design(target, tmp_path / "stopped", resume=True)
    assert same(tmp_path / "whole", tmp_path / "stopped")


def test_a_slow_machine_finds_the_same_picture(target: dict[str, Any], tmp_path: Path, monkeypatch: Any) -> None:
    nacre.design(target, tmp_path / "fast")

    def slow() -> Iterator[float]:
        return (1e4 * k for k in itertools.count())  # hours between two readings

    readings = slow()
    monkeypatch.setattr(time, "monotonic", lambda: next(readings))
    nacre.design(target, tmp_path / "slow")
    assert same(tmp_path / "fast", tmp_path / "slow")


def test_a_given_time_limit_ends_the_refinement_only(target: dict[str, Any], tmp_path: Path) -> None:
    target["search"] = {"seconds": 1e-6}
    found = nacre.design(target, tmp_path / "limited")
    assert found.summary["solutions"][0]["nodes"] == 17 and found.status != "interrupted"


@pytest.mark.parametrize("levels", [None, 20])
def test_a_budget_below_the_first_materials_is_refused(target: dict[str, Any], tmp_path: Path, levels: Any) -> None:
    target["search"], target["limits"] = {"evaluations": 16}, {} if levels is None else {"height_levels": levels}
    with pytest.raises(RecipeError):
        nacre.design(target, tmp_path / "refused")
    assert not (tmp_path / "refused").exists()


def test_a_damaged_palette_is_refused(target: dict[str, Any], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(checkpoint, "WRITE_INTERVAL_S", -1.0)
    nacre.design(target, tmp_path / "made")
    state = tmp_path / "made" / "search.json"
    state.write_text(state.read_text().replace("[[", '[["x", '))
    with pytest.raises(NacreError):
        nacre.design(target, tmp_path / "made", resume=True)
