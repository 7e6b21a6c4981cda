"""Pictures through polarising filters: Malus' sums, circular light at a mirror, Stokes layers, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
import nacre.render
from nacre.core.errors import NacreError

FILM = {"family": "film", "substrate": "Al", "layers": [{"material": "TiO2", "thickness_nm": 120}]}
OPTIONS = {"size": (24, 24), "spp": 4, "exposure": 0.0, "progress": False, "denoise": False}

pytestmark = pytest.mark.render


def xyz(**options: Any) -> np.ndarray:
    return nacre.render.render(nacre.material(FILM), "sphere", **OPTIONS, **options).xyz


def test_two_crossed_filters_share_the_light() -> None:
    whole = nacre.render.render(nacre.material(FILM), "sphere", layers="stokes", **OPTIONS)
    s0, s1, s2, s3 = (whole.layers[name][1] for name in ("S0", "S1", "S2", "S3"))
    for first, second, part in ((0, 90, s1), (45, -45, s2), ("right", "left", s3)):
        one, other = xyz(polariser=first), xyz(polariser=second)
        np.testing.assert_allclose(one + other, s0, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(one - other, part, rtol=1e-5, atol=1e-6)
    # the degree of polarisation is at most 1 at every wavelength, hence in Y
    assert np.all(np.sqrt(s1**2 + s2**2 + s3**2)[..., 1] <= s0[..., 1] * (1 + 1e-5))


def test_a_mirror_reverses_the_handedness_of_circular_light() -> None:
    """At the middle of a metal ball right-handed light returns left-handed, apart from ellipticity at the rim."""
    middle = (slice(10, 14), slice(10, 14))
    same, reversed_ = (xyz(light_polarisation="right", polariser=hand)[middle].sum() for hand in ("right", "left"))
    assert reversed_ > 3.0 * same


def test_the_unpolarised_picture_returns_to_its_variant() -> None:
    import mitsuba as mi

    before = xyz()
    variant = mi.variant()
    xyz(polariser="left")
    assert mi.variant() == variant
    np.testing.assert_allclose(xyz(), before, rtol=1e-5, atol=1e-7)  # threads sum in any order


@pytest.mark.parametrize(
    "options",
    [{"polariser": "up"}, {"polariser": float("nan")}, {"light_polarisation": "circular"}, {"layers": "mueller"}],
)
def test_a_bad_filter_is_refused(options: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(NacreError):
        nacre.render.render(nacre.material(FILM), "sphere", output=tmp_path / "x.exr", **OPTIONS, **options)
    assert not list(tmp_path.iterdir())


def test_a_scene_with_its_own_light_takes_no_light_polarisation() -> None:
    with pytest.raises(NacreError):
        nacre.render.render(nacre.material(FILM), "screen", polariser="left")
