"""Is the walk right? Against a volumetric path tracer that shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers_pearl import WAVELENGTHS_NM, direction, dissolved_dye, grey_flakes, layered_lobe, sphere_dye
from helpers_pearl_volume import trace_slab

BAR = 0.003  # of the albedo, issue's bar
MAX_Z = 3.0

NO_PHASE = np.zeros(2)
TRACED_NM = (450.0, 520.0, 580.0, 650.0)

# deviation, rotation in degrees, alpha, number, albedo, angle
CONFIGURATIONS = [
    ((0.2, 0.2), (0, 0, 0), (0.1, 0.1), 3.0, 0.6, 20.0),
    ((0.1, 0.3), (15, -5, 10), (0.05, 0.05), 4.0, 0.5, 40.0),
    ((0.5, 0.2), (0, 20, 0), (0.0, 0.0), 1.5, 0.8, 60.0),
    ((0.05, 0.05), (0, 0, 0), (0.1, 0.1), 8.0, 0.6, 60.0),
    ((0.05, 0.05), (0, 0, 0), (0.0, 0.0), 2.0, 0.6, 20.0),
    ((0.3, 0.3), (0, 0, 0), (0.3, 0.3), 5.0, 0.9, 40.0),
    ((1.0, 1.0), (0, 0, 0), (0.2, 0.2), 3.0, 0.6, 30.0),
    ((0.1, 0.4), (0, 0, 0), (0.1, 0.1), 3.0, 0.3, 50.0),
    ((0.4, 0.1), (0, 0, 45), (0.0, 0.0), 6.0, 0.7, 70.0),
    ((0.1, 0.1), (30, 0, 0), (0.1, 0.1), 3.0, 0.6, 20.0),
    ((0.1, 0.1), (80, 0, 0), (0.05, 0.05), 2.0, 0.6, 45.0),
    ((0.2, 0.2), (10, 10, 0), (0.05, 0.2), 3.0, 0.6, 35.0),
    ((0.2, 0.2), (0, 0, 0), (0.5, 0.5), 1.0, 0.0, 75.0),
]


# as above, with a dye; the last without flakes
DYED = {
    "dissolved": (dissolved_dye(), ((0.2, 0.2), (0, 0, 0), (0.1, 0.1), 2.0, 0.8, 30.0)),
    "spheres": (sphere_dye(), ((0.1, 0.3), (15, -5, 10), (0.2, 0.2), 2.0, 0.6, 50.0)),
    "large spheres, smooth face": (
        sphere_dye(400.0, 0.004),
        ((0.3, 0.3), (0, 0, 0), (0.0, 0.0), 1.0, 0.8, 60.0),
    ),
    "spheres alone": (sphere_dye(150.0, 0.004), ((0.2, 0.2), (0, 0, 0), (0.1, 0.1), 0.0, 0.5, 20.0)),
}


def _compare(configuration: tuple, paths: int, seed: int, dye=None, band: int = 0) -> tuple[float, float, float]:
    """Worst |z| over albedo and three lobes, the relative difference of the albedo and its standard error."""
    from tested_variant import use_tested_variant

    mi = use_tested_variant()
    from nacre.device.walk.strata import Strata
    from nacre.device.walk.walk import sample_walk

    deviation, rotation, alpha, number, albedo, angle = configuration
    lobe = layered_lobe(number, deviation, alpha, albedo=albedo, rotation_deg=rotation, dye=dye)
    wi = direction(angle, 25.0)
    strata = Strata(lobe)
    wavelengths = mi.Spectrum(*TRACED_NM)
    d, f, _ = sample_walk(
        strata, mi.PCG32(size=paths, initstate=seed), mi.Vector3f(*wi.tolist()), strata.axis.locate(wavelengths),
        mi.Bool(True),
    )  # fmt: skip
    ours, weight = np.array(d).T.astype(float), np.array(f[band]).astype(float)
    root = lobe.flake_frame[0] @ np.diag(lobe.flake_axes[0]) if number > 0 else np.eye(3)
    r, t = grey_flakes(np.array([0.0, 1.0]))
    coefficients = (r[0], r[1] - r[0], t[0], t[1] - t[0])
    at, phase, dyed = int(np.searchsorted(WAVELENGTHS_NM, TRACED_NM[band])), NO_PHASE, (0.0, 0.0)
    if dye is not None:
        dyed = (float(dye.extinction[at]), float(dye.scattering[at]))
        phase = NO_PHASE if dye.phase is None else np.ascontiguousarray(dye.phase[:, at])
    theirs = trace_slab(paths, seed, number, root, coefficients, *map(float, alpha), 1.575, albedo, wi, *dyed, phase)
    left = (np.abs(theirs).sum(axis=1) > 0).astype(float)
    mirror = wi * np.array([-1, -1, 1])
    side = direction(50.0, 115.0)
    z, difference, relative = [], 0.0, 0.0
    for i, lobe_of in enumerate(
        [
            lambda w: np.ones(len(w)),
            lambda w: np.clip(w @ mirror, 0, 1) ** 30,
            lambda w: np.clip(w @ wi, 0, 1) ** 10,
            lambda w: np.clip(w @ side, 0, 1) ** 10,
        ]
    ):
        a, b = weight * lobe_of(ours), left * lobe_of(theirs)
        error = np.sqrt((a.var() + b.var()) / paths)
        z.append(abs(a.mean() - b.mean()) / error)
        if i == 0:
            difference, relative = abs(a.mean() / b.mean() - 1), error / b.mean()
    return max(z), difference, relative


@pytest.mark.render
@pytest.mark.parametrize("configuration", CONFIGURATIONS[1:3])
def test_the_walk_agrees_with_a_volumetric_path_tracer(configuration):
    z, _, _ = _compare(configuration, 200_000, 7)
    assert z < 3.4  # 3 sigma for one number; four are looked at


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_the_walk_agrees_within_three_permille(configuration):
    z, difference, error = _compare(configuration, 500_000, 11)
    assert z < 3.4
    assert difference < BAR + 2 * error


@pytest.mark.render
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.full) if n != "spheres" else n for n in DYED])
def test_dye_agrees_with_a_volumetric_path_tracer(name):
    """At the first and the last of four wavelengths that walk together: what a dye does differs among them."""
    dye, configuration = DYED[name]
    paths = 200_000 if name == "spheres" else 500_000
    for band in (0, 3):
        z, difference, error = _compare(configuration, paths, 13, dye, band)
        assert z < 3.4
        assert difference < BAR + 2 * error
