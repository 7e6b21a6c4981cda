"""Colours that a design states are those of its written recipe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.light import smooth_weights, white_xyz, xyz_to_lab
from nacre.optimise.evaluation import evaluate
from nacre.optimise.image.design import _sampler
from nacre.optimise.run import evaluate_solution
from nacre.optimise.spec import LightSpec
from nacre.optimise.task import read_task


def recipe() -> dict[str, Any]:
    line = {"shape": "line", "material": "Al", "width_nm": 150}
    return {
        "family": "grating",
        "substrate": "Al",
        "layers": [{"thickness_nm": 60, "material": "air", "shapes": [line]}],
        "lattice": {"period_nm": 320},
        "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 60},
    }


def target(start: dict[str, Any]) -> dict[str, Any]:
    return {
        "recipe": start,
        "parameters": {"layers[0].shapes[0].width_nm": [60, 260]},
        "target": [{"geometry": "specular 0", "lab": [50, 0, 0], "tolerance": 1.0}],
        "search": {"seconds": 1},
    }


def spectrum_lab(start: dict[str, Any], width_nm: float) -> np.ndarray:
    made = nacre.material(start).vary({"layers[0].shapes[0].width_nm": width_nm})
    seen = made.spectrum([0.0])
    assert seen.specular_reflectance is not None
    xyz = seen.specular_reflectance[0] @ smooth_weights(seen.wavelengths_nm, "D65", "10deg")
    return np.asarray(xyz_to_lab(xyz, white_xyz("D65", "10deg")))


def test_colours_of_a_designed_grating_are_those_of_its_spectrum() -> None:
    """The search solves gratings once, coarsely; for these lines that is 0.01 off in L*."""
    task = read_task(target(recipe()))
    found = evaluate_solution(task, {"layers[0].shapes[0].width_nm": 200.0}, 0.1, 0.0)
    assert found is not None and found.targets[0].lab is not None
    np.testing.assert_allclose(found.targets[0].lab, spectrum_lab(recipe(), 200.0), atol=1e-9)


def test_pixels_of_one_free_size_have_the_colours_of_spectra(tmp_path: Path) -> None:
    """A palette of coarse solutions is off by dE00 3 for discs of silicon, and by 0.02 in L* for these lines."""
    Image.fromarray(np.zeros((2, 2, 3), dtype=np.uint8)).save(tmp_path / "photo.png")
    wanted = target(recipe())
    wanted["target"] = [{"geometry": "specular 0", "image": str(tmp_path / "photo.png")}]
    sampler = _sampler(read_task(wanted))
    found = xyz_to_lab(sampler.xyz(np.array([[0.7]])), sampler.white)
    np.testing.assert_allclose(found[0], spectrum_lab(recipe(), 200.0), atol=1e-9)


def test_colours_from_wavelengths_that_miss_a_guided_mode_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    """Lines of n = 2 on a film, 340 nm apart, reflect lines of some 10 nm."""
    line = {"shape": "line", "material": {"n": 2.0}, "width_nm": 170}
    film = {"thickness_nm": 80, "material": {"n": 2.0}}
    layers = [{"thickness_nm": 100, "material": "air", "shapes": [line]}, film]
    grid = {"lattice": {"period_nm": 340}, "wavelengths": {"step_nm": 20}}
    start = {"family": "grating", "substrate": "glass", "layers": layers, **grid}
    targets = read_task(target(start)).targets
    caplog.clear()
    evaluate(nacre.material(start), targets, LightSpec())
    assert [record.levelname for record in caplog.records] == ["WARNING"]
