"""Mosaic example, and Monte Carlo over process errors."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from read_back import depth_of, read_grey16

from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.plane_cut import CutGeometry
from nacre.formats.layouts import PUBLISHED_CALIBRATION
from nacre.optimise.relief.merit import Problem, View, published_weights
from nacre.optimise.relief.report import robustness

_PATH = Path(__file__).resolve().parents[2] / "examples" / "mosaic.py"
_SPEC = importlib.util.spec_from_file_location("example_mosaic", _PATH)
assert _SPEC is not None and _SPEC.loader is not None
example = importlib.util.module_from_spec(_SPEC)
sys.modules["example_mosaic"] = example  # dataclasses look their module up
_SPEC.loader.exec_module(example)
mosaic, write_mosaic = example.mosaic, example.write_mosaic

COLOURS = np.array([[3.0, 0.2, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 4.0]])
PALETTE = np.random.default_rng(1).random((3, 6, 6)) * 0.7


def wanted(size: int = 24) -> np.ndarray:
    x = np.linspace(0.3, 1, size)  # within the palette's gamut
    return np.stack(np.broadcast_arrays(x[:, None], 1.3 - x[None, :], 0.5 * x[:, None] * x[None, :]), axis=-1)


def test_mosaic_shows_the_image() -> None:
    made = mosaic(wanted(), PALETTE, COLOURS, cells_per_pixel=5)
    error = made.seen() - made.exposure * wanted()
    # one cell of 25 is what a pixel's rounding can be off by; areas keep their mean
    assert np.abs(error).max() < 2.5 * COLOURS.max() / 25
    blocks = error.reshape(4, 6, 4, 6, 3).mean(axis=(1, 3))
    assert np.abs(blocks).max() < 0.1 * (made.exposure * wanted()).max()
    assert abs(made.seen().mean() / (made.exposure * wanted().mean()) - 1) < 0.02


def test_mosaic_rows_are_its_patches() -> None:
    made = mosaic(wanted(4), PALETTE, COLOURS, cells_per_pixel=2)
    heights = np.stack(list(made.rows_um()))
    assert heights.shape == made.shape == (48, 48)
    for x in range(8):
        for y in range(8):
            patch = heights[6 * x : 6 * x + 6, 6 * y : 6 * y + 6]
            assert np.array_equal(patch, made.palette_um[made.cells[x, y]])


def test_mosaic_is_written_as_one_map(tmp_path: Path) -> None:
    made = mosaic(wanted(4), PALETTE, COLOURS, cells_per_pixel=2)
    write_mosaic(tmp_path / "m.png", made, 1.6, PUBLISHED_CALIBRATION, {"made": "test"})
    grey, facts = read_grey16(tmp_path / "m.png")
    heights = facts["top_um"] - depth_of(PUBLISHED_CALIBRATION, grey)
    assert np.abs(heights - np.stack(list(made.rows_um()))).max() * 1e3 <= PUBLISHED_CALIBRATION.nm_per_level
    with pytest.raises(NacreError, match="covers depths"):
        write_mosaic(tmp_path / "n.png", mosaic(wanted(4), 3 * PALETTE, COLOURS), 1.6, PUBLISHED_CALIBRATION, {})


def test_the_example_designs_patches_and_mixes_a_colour_wheel(tmp_path: Path) -> None:
    made = example.main(tmp_path, quick=True)
    # each patch shows its own colour most: red and blue clearly, green as far as so small a relief can
    assert made.colours[1].argmax() == 0 and made.colours[2].argmax() == 1 and made.colours[3].argmax() == 2
    wanted, seen = example.colour_wheel(12), made.seen() / made.exposure
    assert np.corrcoef(wanted.ravel(), seen.ravel())[0, 1] > 0.75
    grey, facts = read_grey16(tmp_path / "mosaic.png")
    heights = facts["top_um"] - depth_of(PUBLISHED_CALIBRATION, grey)
    assert heights.shape == made.shape
    assert np.abs(heights - np.stack(list(made.rows_um()))).max() * 1e3 <= PUBLISHED_CALIBRATION.nm_per_level
    assert (tmp_path / "mosaic-seen.png").stat().st_size > 500


@pytest.mark.parametrize("image", [np.zeros((4, 4, 3)), np.ones((4, 4)), np.full((4, 4, 3), np.nan)])
def test_an_image_that_cannot_be_mixed_is_refused(image: np.ndarray) -> None:
    with pytest.raises(UnsupportedError):
        mosaic(image, PALETTE, COLOURS)


def test_losses_grow_with_process_errors() -> None:
    spectrum = published_weights(None)
    axis = np.linspace(-0.25, 0.25, 12)
    geometry = CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), spectrum.wavelengths_nm)
    heights = 400.0 * np.random.default_rng(2).random((8, 8))
    view = View(geometry, np.ones((1, 12, 12, 3)), spectrum.rgb_weights)
    problem = Problem(8, 1500.0, 500.0, 400.0, Coherence.from_sigma(0.8), (view,), 0.1)
    none = robustness(problem, heights, height_error=0.0, blur_error=0.0, noise=0.0, draws=3)
    assert none.delta_e.percentile_95 < 0.05 and none.loss_fixed.mean == pytest.approx(
        none.loss_fixed.nominal, rel=1e-4
    )
    small, large = (robustness(problem, heights, height_error=e, blur_error=e, noise=e, draws=20) for e in (0.02, 0.1))
    assert 0 < small.delta_e.mean < large.delta_e.mean
    assert large.delta_e.percentile_95 > large.delta_e.mean and small.draws == 20
