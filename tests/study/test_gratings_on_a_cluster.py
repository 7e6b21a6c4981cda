"""Orders of gratings on a Dask cluster."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_study import dask_over_tcp

import nacre
from nacre.cli import run
from nacre.core.jobs import Workers, on_cluster
from nacre.core.machine import on_progress

SINE: dict[str, Any] = {
    "family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 80},
    "lattice": {"period_nm": 500}, "wavelengths": {"min_nm": 500, "max_nm": 600, "step_nm": 100},
}  # fmt: skip
DISC: dict[str, Any] = {
    "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 300}, "model": {"tolerance": 0.02},
    "layers": [
        {"thickness_nm": 90, "material": "air", "shapes": [{"shape": "disc", "material": {"n": 2}, "diameter_nm": 140}]}
    ],
}  # fmt: skip
RECIPE = """family = "grating"
substrate = "Al"
profile = {shape = "sinusoidal", depth_nm = 80}
lattice = {period_nm = 500}
"""
QUESTION = ["orders", "sine.toml", "--angles-deg", "0,30", "--wavelengths-nm", "500,600"]
NOBODY = "tcp://127.0.0.1:1"


@pytest.mark.full
def test_a_cluster_solves_the_orders_of_one_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NACRE_CACHE", "off")
    (tmp_path / "sine.toml").write_text(RECIPE)
    here = nacre.orders(DISC, [0.0, 20.0], 10.0, [500.0, 600.0])
    table = nacre.material(SINE).bsdf()
    assert run([*QUESTION, "-o", "here.json"]) == 0
    with dask_over_tcp(tmp_path, 2) as address:
        steps: list[tuple[int, int]] = []
        with on_cluster(Workers(cluster=address)), on_progress(lambda done, total: steps.append((done, total))):
            there = nacre.orders(DISC, [0.0, 20.0], 10.0, [500.0, 600.0])
            assert steps[-1] == (4, 4)
            other = nacre.material(SINE).bsdf()
        assert run([*QUESTION, "--cluster", address, "-o", "there.json"]) == 0
    # another process rounds the last digits otherwise
    np.testing.assert_allclose(there.reflected_jones, here.reflected_jones, rtol=0, atol=1e-10)
    np.testing.assert_allclose(there.reflected, here.reflected, rtol=0, atol=1e-10)
    for one, two in zip(table.lobes, other.lobes, strict=True):
        wi = np.array([[0.1, 0.2, 0.97], [0.5, 0.0, 0.86]])
        wi /= np.linalg.norm(wi, axis=1)[:, None]
        np.testing.assert_allclose(one.evaluate(wi, wi[::-1]), two.evaluate(wi, wi[::-1]), rtol=1e-6, atol=1e-9)
    answers = [json.loads((tmp_path / name).read_text()) for name in ("here.json", "there.json")]
    for side in ("reflected", "transmitted"):
        for polarisation in "sp":
            one, two = (np.array(answer[side][polarisation], dtype=float) for answer in answers)
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-10)


def test_a_stopped_solution_keeps_the_orders_that_arrived(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.matter.periodic import orders

    monkeypatch.setenv("NACRE_CACHE", str(tmp_path))
    monkeypatch.setattr(orders, "MIN_STORED_S", 0.0)
    solve, solved = orders.solve, []

    def counted(*args: Any) -> Any:
        solved.append(args[1])
        return solve(*args)

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(orders, "solve", counted)
    with pytest.raises(KeyboardInterrupt), on_progress(stop):
        nacre.orders(SINE, 10.0, 0.0, [500.0, 550.0, 600.0, 650.0])
    solved.clear()
    resumed = nacre.orders(SINE, 10.0, 0.0, [500.0, 550.0, 600.0, 650.0])
    assert sorted(solved) == [600.0, 650.0]
    monkeypatch.setenv("NACRE_CACHE", "off")
    np.testing.assert_array_equal(
        resumed.reflected, nacre.orders(SINE, 10.0, 0.0, [500.0, 550.0, 600.0, 650.0]).reflected
    )


@pytest.mark.parametrize("command", ["orders", "spectrum", "compile", "export"])
def test_a_cluster_that_cannot_serve_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    more = ["--to", "csv"] if command == "export" else []
    before = os.listdir(tmp_path)
    assert run([command, "film.toml", *more, "--cluster", NOBODY]) == 2
    error = capsys.readouterr().err
    assert "--cluster" in error and error.count("\n") == 1
    assert os.listdir(tmp_path) == before


def test_a_cluster_that_cannot_be_reached_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NACRE_CACHE", "off")
    monkeypatch.setattr("nacre.core.jobs.CONNECT_TIMEOUT_S", 0.5)
    (tmp_path / "sine.toml").write_text(RECIPE)
    assert run([*QUESTION, "--cluster", NOBODY]) == 2
    assert "--cluster" in capsys.readouterr().err
