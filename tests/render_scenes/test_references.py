"""The long renders that `benchmarks/bench_pictures.py` compares with: kept whole, and of the scenes as they are."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
HALF = 2.0**-11  # relative rounding of a half float
FEWEST = 512  # samples a pixel
BLOCK, FEW = 64, 8  # pixels along a side whose mean is compared, samples a pixel of the quick render
SAME = 0.05  # of a block's light, beyond noise: a moved lamp or another shape is further off
NOISE = 4.0  # standard errors: of 576 channels of blocks none by chance


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"{name}_under_test", FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look their annotations up
    spec.loader.exec_module(module)
    return module


REFERENCES = script("picture_references")
CASES = {case.name: case for case in REFERENCES.CASES}


def blocks(xyz: np.ndarray, side: int) -> np.ndarray:
    rows, columns = (size // side for size in xyz.shape[:2])
    return np.asarray(xyz.reshape(rows, side, columns, side, 3).mean(axis=(1, 3)))


def test_a_reference_comes_back_as_half_floats() -> None:
    generator = np.random.default_rng(3)
    xyz = generator.lognormal(-1.0, 3.0, (7, 9, 3))
    back = REFERENCES.unpacked_halfs(REFERENCES.packed_halfs(xyz))
    assert np.abs(back / xyz - 1.0)[xyz > 1e-4].max() <= HALF
    half = generator.normal(0.0, 0.1, (7, 9, 3))
    back = REFERENCES.unpacked_signs(REFERENCES.packed_signs(half))
    assert (np.sign(back) == np.sign(half)).all()
    assert np.abs(back / half - 1.0)[np.abs(half) > 1e-6].max() <= REFERENCES.STEP**0.5 - 1.0


@pytest.mark.parametrize("name", CASES)
def test_a_picture_has_a_reference_whose_middle_is_seen_twice_as_large(name: str) -> None:
    whole, middle = (REFERENCES.reference(CASES[name], of_middle) for of_middle in (False, True))
    assert whole.spp >= FEWEST and middle.spp == whole.spp // REFERENCES.FINER**2
    side = REFERENCES.SIDE
    assert whole.xyz.shape == middle.xyz.shape == (side, side, 3)
    assert whole.xyz.mean() > 0.01 and 0.0 < whole.variance.mean() < middle.variance.mean()
    seen, inner = blocks(middle.xyz, 2), whole.xyz[side // 4 : 3 * side // 4, side // 4 : 3 * side // 4]
    # each pixel of the one is the mean of four of the other, rounded when kept, at most twice at each lengthening
    assert np.abs(seen - inner).max() <= 8.0 * HALF * inner.max()
    assert np.median(np.abs(seen - inner) / np.maximum(inner, 1e-3)) <= HALF


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_a_reference_shows_the_scene_of_today(name: str) -> None:
    case = CASES[name]
    now = blocks(REFERENCES.take(case, case.bsdf(), REFERENCES.SIDE, FEW, seed=5).xyz, BLOCK)
    kept = REFERENCES.reference(case)
    then = blocks(kept.xyz, BLOCK)
    noise = np.sqrt(blocks(kept.variance, BLOCK) * kept.spp / FEW) / BLOCK
    off = np.abs(now - then) - SAME * then - NOISE * noise
    assert off.max() <= 0.0, f"run `python benchmarks/picture_references.py --anew {name}`"
