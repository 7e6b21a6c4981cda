"""The film's lobes on the device against exact optics and against Mitsuba's own BSDFs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre.material.material
from nacre.bsdf.bsdf import Bsdf

pytestmark = pytest.mark.render

DIRECTION_TOLERANCE = 2e-6  # single precision
WEIGHT_TOLERANCE = 2e-5  # single precision through table and ratio
CONDUCTOR_TOLERANCE = 3e-4  # the bar, of the maximum
DIELECTRIC_MOST, DIELECTRIC_ALL = 1e-3, 2e-2  # the bars: of 99.9 % and of all values
SMOOTH_FURNACE = 0.003  # the bar
COMPENSATED_FURNACE = 0.98  # the bar at alpha 0.3
FURNACE_TOP = 1.002
DRAWS = 100_000
INDEX = 1.5


def film(**recipe: Any) -> Bsdf:
    """Build a film's Bsdf from the keys of a recipe."""
    return nacre.material({"family": "film", **recipe}).bsdf()


def smooth(substrate: Any, thickness_nm: float = 400.0, n: float = 2.0) -> Bsdf:
    """Return a smooth film of index `n`."""
    return film(substrate=substrate, layers=[{"material": {"n": n}, "thickness_nm": thickness_nm}])


@pytest.mark.parametrize("theta_deg", [0.0, 35.0, 80.0, 110.0, 150.0])
@pytest.mark.parametrize("kind", ["opaque", "glass", "soap"])
def test_delta_lobes_go_where_optics_says_with_the_weights_it_says(mi: Any, kind: str, theta_deg: float) -> None:
    """100,000 draws: two exact directions, weight * probability = R or T (times the squeeze of radiance)."""
    from lobe_trials import HERO_WAVELENGTHS_NM, direction, draw

    bsdf = {
        "opaque": lambda: smooth({"n": 1.2, "k": 7.0}),
        "glass": lambda: smooth({"n": INDEX}),
        "soap": lambda: film(substrate="air", layers=[{"material": {"n": 1.33}, "thickness_nm": 350}]),
    }[kind]()
    eta = INDEX if kind == "glass" else 1.0
    wi = direction(theta_deg, 25.0)
    draws = draw(bsdf, wi, DRAWS, seed=5)
    exact = bsdf.specular(np.radians(theta_deg))
    reflectance, transmittance = (
        np.array([np.interp(HERO_WAVELENGTHS_NM, bsdf.wavelengths_nm, values)])
        for values in (exact.reflectance, exact.transmittance)
    )
    if kind == "opaque" and theta_deg > 90:
        assert np.all(draws.weight == 0.0)
        return
    ratio = 1.0 / eta if wi[2] > 0 else eta
    sin2 = (1.0 - wi[2] ** 2) * ratio**2
    assert np.all(draws.is_delta)
    reflected = draws.wo[:, 2] * wi[2] > 0
    mirrored = np.array([-wi[0], -wi[1], wi[2]])
    assert np.max(np.abs(draws.wo[reflected] - mirrored)) <= DIRECTION_TOLERANCE
    product = (draws.weight * draws.pdf[:, None])[reflected]
    assert np.max(np.abs(product - reflectance)) <= WEIGHT_TOLERANCE
    assert np.all(draws.eta[reflected] == 1.0)
    if sin2 < 1.0 and kind != "opaque":
        bent = np.array([-wi[0] * ratio, -wi[1] * ratio, -np.sign(wi[2]) * np.sqrt(1.0 - sin2)])
        assert np.max(np.abs(draws.wo[~reflected] - bent)) <= DIRECTION_TOLERANCE
        product = (draws.weight * draws.pdf[:, None])[~reflected]
        assert np.max(np.abs(product - transmittance * ratio**2)) <= WEIGHT_TOLERANCE * max(1.0, ratio**2)
        assert np.allclose(draws.eta[~reflected], 1.0 / ratio, rtol=1e-6)
        share = draws.pdf[reflected][0] if np.any(reflected) else 0.0
        assert abs(reflected.mean() - share) <= 4.5 * np.sqrt(0.25 / DRAWS)
    else:
        assert np.all(reflected)
    assert np.all(draws.value == 0.0) and np.all(draws.density == 0.0)


@pytest.mark.parametrize("theta_deg", [0.5, 45.0, 85.0, 100.0, 170.0])
def test_smooth_lossless_film_keeps_all_light(mi: Any, theta_deg: float) -> None:
    """A white furnace around coated glass, from both sides, is 1 within 0.3 %."""
    from lobe_trials import furnace

    mean, _ = furnace(smooth({"n": INDEX}), theta_deg, 50_000)
    assert np.max(np.abs(mean - 1.0)) <= SMOOTH_FURNACE


@pytest.mark.parametrize("distribution", ["ggx", "beckmann", "blinn", "ashikhmin-shirley"])
@pytest.mark.parametrize("substrate", ["mirror", "glass"])
def test_compensation_gives_back_what_facets_lose(mi: Any, substrate: str, distribution: str) -> None:
    """Above 0.98 and never above 1.002 at alpha 0.3, lossless, all angles and both sides."""
    from lobe_trials import furnace

    # a huge k reflects everything: the lossless opaque case
    index = {"n": 0.001, "k": 60.0} if substrate == "mirror" else {"n": INDEX}
    bsdf = film(
        substrate=index,
        layers=[{"material": {"n": 1.8}, "thickness_nm": 300}],
        surface={"distribution": distribution, "roughness": 0.3, "compensate": True},
    )
    for theta_deg in (1.0, 40.0, 75.0) + ((105.0, 140.0, 179.0) if substrate == "glass" else ()):
        mean, error = furnace(bsdf, theta_deg, 150_000)
        assert np.all(mean - 3.0 * error <= FURNACE_TOP), (theta_deg, mean, error)
        assert np.all(mean + 3.0 * error >= COMPENSATED_FURNACE), (theta_deg, mean, error)


def spectrum(wavelengths_nm: Any, values: Any) -> dict[str, Any]:
    """Return a scene entry for a tabulated spectrum, straight lines between its nodes."""
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{w:.10g}" for w in wavelengths_nm),
        "values": ", ".join(f"{v:.10g}" for v in values),
    }


def pairs(n: int, both: bool, width: float, eta: float) -> tuple[Any, Any]:
    """Return light and eye: half anywhere, half near the mirror or refracted image."""
    from lobe_trials import directions, near_mirror

    eye = directions(n, 21, both)
    return np.concatenate([directions(n // 2, 22, both), near_mirror(eye[n // 2 :], 23, width, eta)]), eye


@pytest.mark.parametrize("alpha", [0.1, 0.3])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_zero_film_on_aluminium_is_mitsubas_roughconductor(mi: Any, distribution: str, alpha: float) -> None:
    """f cos over directions, of its maximum."""
    from lobe_trials import plugin_values

    from nacre.matter.indices.library import index

    bsdf = film(
        substrate="Al",
        layers=[{"material": "SiO2", "thickness_nm": 0.0}],
        surface={"distribution": distribution, "roughness": alpha},
    )
    grid = bsdf.wavelengths_nm
    n = index("Al").n_complex(grid)
    theirs = mi.load_dict(
        {
            "type": "roughconductor",
            "distribution": distribution,
            "alpha": alpha,
            "eta": spectrum(grid, n.real),
            "k": spectrum(grid, n.imag),
        }
    )
    light, eye = pairs(20_000, False, alpha, 1.0)
    nodes = grid[2:-2:11]
    ours = plugin_values(bsdf, light, eye, nodes) * light[:, 2:]
    reference = plugin_values(theirs, light, eye, nodes) * light[:, 2:]
    assert np.max(np.abs(ours - reference)) <= CONDUCTOR_TOLERANCE * np.max(reference)


@pytest.mark.parametrize("alpha", [0.1, 0.3])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_zero_film_on_glass_is_mitsubas_roughdielectric(mi: Any, distribution: str, alpha: float) -> None:
    """f cos over both sides, relative to its maximum on each side of each kind."""
    from lobe_trials import plugin_values

    bsdf = film(
        substrate={"n": INDEX},
        layers=[{"material": "SiO2", "thickness_nm": 0.0}],
        surface={"distribution": distribution, "roughness": alpha},
    )
    theirs = mi.load_dict(
        {"type": "roughdielectric", "distribution": distribution, "alpha": alpha, "int_ior": INDEX, "ext_ior": 1.0}
    )
    light, eye = pairs(40_000, True, alpha, INDEX)
    nodes = np.array([500.0])
    ours = plugin_values(bsdf, light, eye, nodes) * np.abs(light[:, 2:])
    reference = plugin_values(theirs, light, eye, nodes) * np.abs(light[:, 2:])
    error = np.abs(ours - reference) / np.max(reference)
    assert np.quantile(error, 0.999) <= DIELECTRIC_MOST
    assert np.max(error) <= DIELECTRIC_ALL
    # the same, value by value, where the value is not negligible: a wrong factor cannot hide behind the peak
    seen = reference > 1e-3 * np.max(reference)
    assert np.quantile(np.abs(ours[seen] / reference[seen] - 1.0), 0.99) <= DIELECTRIC_ALL


@pytest.mark.parametrize(("k", "tolerance"), [(0.0, 1e-5), (1e-5, 1e-4), (1e-3, 1e-5)])
def test_soap_film_passes_light_unbent(mi: Any, k: float, tolerance: float) -> None:
    """The transmission of a free film is Mitsuba's null interaction, for shadow rays too.

    Of one that absorbs less than lobes and arrays may differ by (1e-4) it is what is not reflected.
    """
    from lobe_trials import direction, interaction

    from nacre.device.bsdf import make_bsdf

    bsdf = film(substrate="air", layers=[{"material": {"n": 1.33, "k": k}, "thickness_nm": 350}])
    plugin = make_bsdf(bsdf)
    assert mi.has_flag(plugin.flags(), mi.BSDFFlags.Null)
    si = interaction(direction(40.0, 10.0)[None, :], bsdf.wavelengths_nm[[3, 20, 30, 40]])
    passed = np.array(plugin.eval_null_transmission(si)).ravel()
    assert np.allclose(passed, bsdf.specular(np.radians(40.0)).transmittance[[3, 20, 30, 40]], rtol=0.0, atol=tolerance)
