"""Frames of an animation on a Dask cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_study import dask_over_tcp
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.jobs import Workers

FILM: dict[str, Any] = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 200}]}
SMALL: dict[str, Any] = {"size": (16, 14), "spp": 2, "progress": False, "denoise": False}

pytestmark = pytest.mark.render


@pytest.mark.full
def test_a_cluster_renders_the_frames_of_one_machine(tmp_path: Path) -> None:
    film, motion = nacre.material(FILM), "layers[0].thickness_nm=100:300"
    here = nacre.render.animate(film, motion, tmp_path / "here.gif", frames=3, **SMALL)
    with dask_over_tcp(tmp_path, 1) as address:
        there = nacre.render.animate(
            film, motion, tmp_path / "there.gif", frames=3, workers=Workers(cluster=address), **SMALL
        )
    assert there.path is not None and there.reused == 0
    for one, two in zip(here.frames, there.frames, strict=True):
        np.testing.assert_array_equal(np.asarray(Image.open(one)), np.asarray(Image.open(two)))
    again = nacre.render.animate(film, motion, tmp_path / "there.gif", frames=3, **SMALL)
    assert again.reused == 3  # the frames carry the key of this machine's frames


def test_a_cluster_renders_no_single_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["render", "gold", "--cluster", "tcp://127.0.0.1:1", "-o", str(tmp_path / "gold.png")]
    assert run(line) == 2
    assert "--animate" in capsys.readouterr().err and list(tmp_path.iterdir()) == []
