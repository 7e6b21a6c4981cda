"""Ensembles, tables of gratings and frames of animations on a Dask cluster that loses a worker at work."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from helpers_study import KillsOneWorker, dask_over_tcp
from PIL import Image

import nacre
from nacre.bsdf import Bsdf
from nacre.cli import run
from nacre.core.jobs import Workers, on_cluster
from nacre.core.machine import on_progress

ENSEMBLE: dict[str, Any] = {
    "family": "metasurface", "substrate": {"n": 1.5, "k": 0.01}, "particle": {"material": "Ag", "radius_nm": 90},
    "monolayer": {"coverage": 0.1},
    "model": {"correction": "ensemble", "multipole_order": 3, "ensemble": {"spheres": 20, "realisations": 8}},
}  # fmt: skip
SINE: dict[str, Any] = {
    "family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 80},
    "lattice": {"period_nm": 500},
}  # fmt: skip
FILM: dict[str, Any] = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 200}]}
GRID = np.array([500.0, 560.0])
ACROSS_PROCESSES = 1e-5  # of the largest value, in single precision: other threads sum in another order
NOBODY = "tcp://127.0.0.1:1"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return the address of a cluster with a worker more than tests kill."""
    pytest.importorskip("distributed")
    with dask_over_tcp(tmp_path_factory.mktemp("cluster"), 4) as address:
        yield address


def _values(table: Bsdf) -> np.ndarray:
    wi = np.array([[0.1, 0.2, 0.97], [0.5, 0.0, 0.86], [0.0, 0.7, 0.7]])
    wi /= np.linalg.norm(wi, axis=1)[:, None]
    return np.concatenate([lobe.evaluate(wi, wi[::-1]) for lobe in table.lobes])


@pytest.mark.full
@pytest.mark.parametrize("recipe", [ENSEMBLE, SINE], ids=["ensemble", "table of a grating"])
def test_a_lost_worker_costs_no_number(recipe: dict[str, Any], cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NACRE_CACHE", "off")
    here = _values(nacre.material(recipe).bsdf(GRID))
    kills = KillsOneWorker()
    with on_cluster(Workers(cluster=cluster)), on_progress(kills):
        there = _values(nacre.material(recipe).bsdf(GRID))
    assert kills.killed == 1
    np.testing.assert_allclose(there, here, rtol=0, atol=ACROSS_PROCESSES * np.abs(here).max())


@pytest.mark.full
@pytest.mark.render
def test_a_lost_worker_costs_no_frame(tmp_path: Path, cluster: str) -> None:
    small: dict[str, Any] = {"size": (16, 14), "spp": 2, "denoise": False, "frames": 8}
    film, motion = nacre.material(FILM), "layers[0].thickness_nm=100:300"
    here = nacre.render.animate(film, motion, tmp_path / "here.gif", progress=False, **small)
    kills = KillsOneWorker()
    there = nacre.render.animate(
        film, motion, tmp_path / "there.gif", workers=Workers(cluster=cluster), progress=kills, **small
    )
    assert kills.killed == 1 and there.path is not None and there.reused == 0
    for one, two in zip(here.frames, there.frames, strict=True):
        np.testing.assert_array_equal(np.asarray(Image.open(one)), np.asarray(Image.open(two)))


@pytest.mark.full
def test_the_command_solves_an_ensemble_on_a_cluster(
    tmp_path: Path, cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NACRE_CACHE", "off")
    (tmp_path / "discs.toml").write_text(tomlkit.dumps(ENSEMBLE))
    assert run(["compile", "discs.toml", "--wavelengths-nm", "500,560", "--cluster", cluster, "-o", "there.nacre"]) == 0
    there, here = _values(Bsdf.load("there.nacre")), _values(nacre.material(ENSEMBLE).bsdf(GRID))
    np.testing.assert_allclose(there, here, rtol=0, atol=ACROSS_PROCESSES * np.abs(here).max())


@pytest.mark.parametrize("correction", ["ensemble", "qca-balanced"])
def test_an_ensemble_asks_the_cluster_and_a_mean_field_is_refused(
    tmp_path: Path, correction: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NACRE_CACHE", "off")
    monkeypatch.setattr("nacre.core.jobs.CONNECT_TIMEOUT_S", 0.5)
    recipe = {**ENSEMBLE, "model": {**ENSEMBLE["model"], "correction": correction}}
    (tmp_path / "m.toml").write_text(tomlkit.dumps(recipe))
    assert run(["spectrum", "m.toml", "--wavelengths-nm", "500", "--cluster", NOBODY]) == 2
    error = capsys.readouterr().err
    assert error.splitlines()[-1].startswith("nacre: --cluster") and (NOBODY in error) == (correction == "ensemble")
