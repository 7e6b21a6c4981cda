"""What `nacre plot` draws of a photonic glass alone: order, scattering inside, reflectance over thickness."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import UnsupportedError

ONE: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 20,
    "spheres": {"material": {"n": 1.59}, "radius_nm": 120, "volume_fraction": 0.5},
    "absorber": {"k": 0.002},
}
BALLS = {**ONE, "thickness_um": 60, "balls": {"binder": {"n": 1.5}, "radius_um": 4, "volume_fraction": 0.3}}


@pytest.mark.parametrize("compensate", [True, False])
def test_the_map_of_a_rough_face_is_what_its_walk_sends_back(compensate: bool) -> None:
    """The map is noise-free: walks for all of its places would take a minute."""
    surface = {"roughness": 0.15, "compensate": compensate}
    material = nacre.material({**ONE, "surface": surface})
    mapped = material.figure_data("colour-map")
    row = int(np.argmin(np.abs(mapped["y"] - 20.0)))
    nm, angles = mapped["wavelengths_nm"][::8], mapped["angles_deg"][:6:2]
    again = material.vary({"thickness_um": float(mapped["y"][row])})
    traced = again.spectrum(np.radians(angles), nm).diffuse_reflectance
    assert traced is not None
    # 4 %: what the fast form states of a face of 0.15 over black
    difference = np.linalg.norm(mapped["reflectance"][row, :6:2, ::8] - traced) / np.linalg.norm(traced)
    assert difference < 0.04


def test_the_structure_is_that_of_the_note() -> None:
    found = nacre.material(ONE).figure_data("structure")
    np.testing.assert_allclose(found["sq"][0][found["q"] == 7.0], 3.24003571, rtol=1e-8)


def test_a_spread_of_sizes_blurs_the_structure() -> None:
    wide = {**ONE, "spheres": {**ONE["spheres"], "deviation_nm": 1e-3}}
    narrow, plain = (nacre.material(data).figure_data("structure")["sq"] for data in (wide, ONE))
    np.testing.assert_allclose(narrow, plain, atol=1e-3)
    spread = {**ONE, "spheres": {**ONE["spheres"], "deviation_nm": 12}}
    found = nacre.material(spread).figure_data("structure")
    assert found["sq"].max() < plain.max()
    assert found["sq"][0, 0] > 2 * plain[0, 0]  # numbers of spheres in a volume may vary more than of equal ones
    far = found["q"] > 12
    assert np.ptp(found["sq"][0, far]) < np.ptp(plain[0, far])


@pytest.mark.parametrize("data", [ONE, BALLS], ids=["glass", "balls"])
def test_scattered_light_sums_to_the_scattering_coefficient(data: dict[str, Any]) -> None:
    lam = [450.0, 650.0]
    material = nacre.material(data)
    found = material.figure_data("scattering", wavelengths_nm=lam)
    theta = np.radians(found["theta_deg"])
    mean = 0.5 * (found["s"] + found["p"])  # 1/(um sr)
    total = 2 * np.pi * np.trapezoid(mean * np.sin(theta), theta, axis=1)
    np.testing.assert_allclose(total, material.model.composite.medium(np.array(lam)).scattering * 1e3, rtol=3e-3)


def test_scattering_of_small_spheres_at_right_angles_is_polarised_across() -> None:
    small = {**ONE, "spheres": {**ONE["spheres"], "radius_nm": 15}}
    found = nacre.material(small).figure_data("scattering", wavelengths_nm=[600.0])
    assert found["p"][0, 180] < 1e-3 * found["s"][0, 180]


@pytest.mark.parametrize("data", [ONE, BALLS], ids=["glass", "balls"])
def test_the_map_holds_the_materials_own_spectrum(data: dict[str, Any]) -> None:
    material = nacre.material(data)
    found = material.figure_data("colour-map", angles_deg=[0.0, 50.0])
    thickness = float(found["y"][6])
    own = nacre.material({**data, "thickness_um": thickness}).spectrum(np.radians([0.0, 50.0]), found["wavelengths_nm"])
    np.testing.assert_allclose(found["reflectance"][6], own.diffuse_reflectance, rtol=1e-9)
    assert np.all(np.diff(found["reflectance"].mean(axis=(1, 2))) > 0)  # thicker is brighter over black


def test_what_has_no_such_figure_says_so() -> None:
    layer = {key: value for key, value in ONE.items() if key != "family"}
    two = nacre.material({"family": "glass", "strata": [layer, layer]})
    assert two.figure_data("structure")["sq"].shape[0] == 2
    with pytest.raises(UnsupportedError, match="one stratum"):
        two.figure_data("colour-map")
