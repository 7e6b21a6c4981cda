"""What a photonic glass can reach: its colour, not that of its upper face's mirror, and in bounded time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.families.glass.composite import Balls
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.recipe.toml import dump_toml

PAINT: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 60,
    "spheres": {"material": {"n": 1.59}, "radius_nm": 115, "volume_fraction": 0.55},
    "balls": {"binder": {"n": 1.5}, "radius_um": 4, "volume_fraction": 0.3},
    "absorber": {"k": 0.002},
}
FREE = ["spheres.radius_nm=90:140"]


def test_a_gamut_of_balls_is_of_light_from_45_degrees_and_ends_in_its_seconds() -> None:
    found = nacre.gamut(nacre.material(PAINT), FREE, points=1000, seconds=1.0)
    assert found.geometry == "45as45" and 8 <= len(found.lab) < 1000
    # a mirror of n = 1.5 would be 4 % of grey: hues run here
    assert np.ptp(found.lab[:, 1]) > 5 and np.ptp(found.lab[:, 2]) > 5


def test_the_command_says_that_it_stopped(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "paint.toml").write_text(dump_toml(PAINT))
    path = tmp_path / "gamut.svg"
    assert run(["gamut", str(tmp_path / "paint.toml"), "--parameter", FREE[0], "--seconds", "1", "-o", str(path)]) == 0
    said = capsys.readouterr().out
    assert "paint: 45as45" in said and "of 1000 points; --seconds gives it more" in said


def test_a_film_is_still_asked_for_its_mirror() -> None:
    film = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
    assert nacre.gamut(nacre.material(film), ["layers[0].thickness_nm=0:400"], points=8).geometry == "specular 0"


def test_candidates_of_balls_take_fewer_paths_and_the_same_colour() -> None:
    """Fewer walkers cost 0.4 dE00: less than the tolerance of a search, and the final evaluation takes all of them."""
    model = nacre.material(PAINT).model
    tried = model.search_model({})
    assert isinstance(tried.composite, Balls) and isinstance(model.composite, Balls)
    assert tried.composite.walkers < model.composite.walkers
    lam = np.linspace(400.0, 700.0, 16)
    wi, wo = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5)]]), np.array([[0.0, 0.0, 1.0]])
    seen = tried.values_at(wi, wo, lam), model.surrogate_radiance(wi, wo, lam)
    assert seen[0] is not None and seen[1] is not None
    white = white_xyz("D65", "10deg")
    labs = [
        xyz_to_lab(spectrum_to_xyz(np.pi * f, lam, "D65", "10deg"), white) for f in (seen[0][0], np.sum(seen[1], 0)[0])
    ]
    assert float(delta_e_2000(*labs)) < 2.0
