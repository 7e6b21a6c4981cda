"""Anisotropic and twisted films through recipes: an independent solver, invariants, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import nan

import nacre
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.measure.evaluate import directional_hemispherical

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "anisotropic" / "anisotropic_open.npz"
REFERENCE_BAR = 1e-9  # the reference agrees with pyElli to 2e-15
HELIX_BAR = 1e-5  # the reference is extrapolated to about 1e-6
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def reference() -> Any:
    if not REFERENCE.exists():
        pytest.skip("the shared reference data are not here")
    return np.load(REFERENCE)


def film(**keys: Any) -> Any:
    return nacre.material({"family": "film", **keys})


def constant(n: complex) -> dict[str, float]:
    return {"n": float(np.real(n)), "k": float(np.imag(n))}


def biaxial(n: Any, euler_deg: Any) -> dict[str, Any]:
    """Return a medium whose axes are given with z into the stack, for light that travels along u: y is then -v."""
    a, b, c = (float(x) for x in euler_deg)
    return {"principal": [constant(x) for x in n], "euler_deg": [-a, b, -c]}


def test_the_stacks_of_an_independent_solver_are_reproduced(reference: Any) -> None:
    for i in range(len(reference["stack_layers"])):
        layers = [
            {
                "material": biaxial(reference["stack_layer_n"][i, j], reference["stack_layer_euler_deg"][i, j]),
                "thickness_nm": float(reference["stack_layer_thickness_nm"][i, j]),
            }
            for j in range(int(reference["stack_layers"][i]))
        ]
        made = film(
            ambient={"n": float(np.real(reference["stack_n_ambient"][i]))},
            layers=layers,
            substrate=biaxial(reference["stack_substrate_n"][i], reference["stack_substrate_euler_deg"][i]),
        )
        found = nacre.spectrum(
            made,
            float(reference["stack_theta_deg"][i]),
            [float(reference["stack_wavelength_nm"][i])],
            polarisation="mueller",
            azimuth_deg=180.0,
        )
        assert found.mueller_reflected is not None
        np.testing.assert_allclose(
            found.mueller_reflected[0, 0], reference["stack_mueller_reflected"][i], atol=REFERENCE_BAR, rtol=0
        )


def test_the_cholesterics_of_an_independent_solver_are_reproduced(reference: Any) -> None:
    waves = reference["wavelengths_nm"]
    for i in range(len(reference["cholesteric_n_o"])):
        pitch = float(reference["cholesteric_pitch_nm"][i])
        hand = "right" if reference["cholesteric_handedness"][i] > 0 else "left"
        material = {
            "ordinary": float(reference["cholesteric_n_o"][i]), "extraordinary": float(reference["cholesteric_n_e"][i]),
            "axis_polar_deg": 90.0, "axis_azimuth_deg": -float(reference["cholesteric_azimuth_deg"][i]),
        }  # fmt: skip
        layer = {
            "material": material, "thickness_nm": 0.5 * pitch * float(reference["cholesteric_half_turns"][i]),
            "pitch_nm": pitch, "handedness": hand,
        }  # fmt: skip
        made = film(layers=[layer], substrate=constant(complex(reference["cholesteric_n_substrate"][i])))
        theta = float(reference["cholesteric_theta_deg"][i])
        seen = {
            state: nacre.spectrum(made, theta, waves, polarisation=state, azimuth_deg=180.0)
            for state in ("p", "s", "right", "left", "mueller")
        }
        for k, state in enumerate(("p", "s")):
            np.testing.assert_allclose(
                seen[state].specular_reflectance[0], reference["cholesteric_R"][i, :, :, k].sum(axis=-1), atol=HELIX_BAR
            )
        for k, state in enumerate(("right", "left")):
            np.testing.assert_allclose(
                seen[state].specular_reflectance[0], reference["cholesteric_R_circular"][i, :, :, k].sum(axis=-1),
                atol=HELIX_BAR,
            )  # fmt: skip
        # power from S = (1, 0, 0, 1) that arrives at the analyser (1, 0, 0, 1) / 2
        mueller = seen["mueller"].mueller_reflected[0]
        found = 0.5 * (mueller[:, 0, 0] + mueller[:, 0, 3] + mueller[:, 3, 0] + mueller[:, 3, 3])
        np.testing.assert_allclose(found, reference["cholesteric_R_circular"][i, :, 0, 0], atol=HELIX_BAR)


def test_a_cholesteric_has_a_plateau_for_one_hand_only() -> None:
    """n 1.5/1.7, pitch 650 nm, 7.5 turns between 1.55: .989 over 975-1105 nm."""
    medium = {"ordinary": 1.5, "extraordinary": 1.7, "axis_polar_deg": 90.0}
    waves = np.arange(1000.0, 1081.0, 5.0)
    for hand, other in (("right", "left"), ("left", "right")):
        layer = {"material": medium, "thickness_nm": 7.5 * 650, "pitch_nm": 650, "handedness": hand}
        made = film(ambient=1.55, substrate=1.55, layers=[layer])
        same = nacre.spectrum(made, 0.0, waves, polarisation=hand).specular_reflectance
        opposite = nacre.spectrum(made, 0.0, waves, polarisation=other).specular_reflectance
        assert same is not None and opposite is not None
        assert same.max() == pytest.approx(np.tanh(np.pi * 0.2 / 1.6 * 7.5) ** 2, abs=0.002)
        assert opposite.max() < 0.01


@pytest.mark.parametrize("polarisation", ["s", "p", "both", "left", "mueller"])
def test_isotropic_media_written_as_anisotropic_ones_change_nothing(polarisation: str) -> None:
    plain = film(
        substrate="Si", layers=[{"material": 1.7, "thickness_nm": 250}, {"material": "Ag", "thickness_nm": 20}]
    )
    medium = {"principal": [1.7, 1.7, 1.7], "euler_deg": [10, 20, 30]}
    other = film(substrate="Si", layers=[{"material": medium, "thickness_nm": 250}, plain.data["layers"][1]])
    waves, angles = np.linspace(400, 700, 7), [0.0, 40.0, 80.0]
    one = nacre.spectrum(plain, angles, waves, polarisation)
    two = nacre.spectrum(other, angles, waves, polarisation, azimuth_deg=33.0)
    for name, value in (one.parts() | one.matrices()).items():
        np.testing.assert_allclose((two.parts() | two.matrices())[name], value, atol=ROUNDING)


@pytest.mark.parametrize(("split", "bar"), [(0.0, ROUNDING), (1e-9, 2e-4)])
def test_an_incoherent_pane_written_as_anisotropic_is_the_isotropic_one(split: float, bar: float) -> None:
    """Nearly equal indices are averaged over thicknesses: the window's side lobes leave some 1e-5."""
    tensor = {"principal": [1.7, 1.7 + split, 1.7], "euler_deg": [10, 20, 30]}
    coat = {"material": 2.2, "thickness_nm": 100.0}

    def spectrum(medium: Any) -> Any:
        pane = {"material": medium, "thickness_nm": 3e5, "incoherent": True}
        made = film(substrate=constant(0.2 + 3.0j), layers=[coat, pane])
        return nacre.spectrum(made, [0.0, 30.0, 60.0], [450.0, 650.0], polarisation="s").specular_reflectance

    np.testing.assert_allclose(spectrum(tensor), spectrum(1.7), atol=bar)


def test_a_fast_axis_follows_the_azimuth_of_the_light() -> None:
    """Light polarised along the axis sees the extraordinary index, from either side of it."""
    medium = {"ordinary": 1.5, "extraordinary": 1.9, "axis_polar_deg": 90.0, "axis_azimuth_deg": 30.0}
    made = film(substrate=1.5, layers=[{"material": medium, "thickness_nm": 120}])
    expected = nacre.spectrum(film(substrate=1.5, layers=[{"material": 1.9, "thickness_nm": 120}]), 0.0, [550.0])
    for azimuth in (30.0, 210.0):
        along = nacre.spectrum(made, 0.0, [550.0], "p", azimuth_deg=azimuth)
        np.testing.assert_allclose(along.specular_reflectance, expected.specular_reflectance, atol=ROUNDING)


def test_an_axis_towards_the_light_shows_the_ordinary_index_to_both_polarisations() -> None:
    """The optic axis has the polar angle and azimuth of the refracted ray's direction back to the light."""
    polar = float(np.degrees(np.arcsin(np.sin(np.radians(50.0)) / 1.5)))
    medium = {"ordinary": 1.5, "extraordinary": 1.9, "axis_polar_deg": polar, "axis_azimuth_deg": 70.0}
    made = film(substrate=medium, layers=[])
    plain = film(substrate=1.5, layers=[])
    right = nacre.spectrum(made, 50.0, [550.0], "s", azimuth_deg=70.0).specular_reflectance
    other = nacre.spectrum(made, 50.0, [550.0], "s", azimuth_deg=250.0).specular_reflectance
    expected = nacre.spectrum(plain, 50.0, [550.0], "s").specular_reflectance
    np.testing.assert_allclose(right, expected, atol=ROUNDING)
    np.testing.assert_allclose(other, expected, atol=ROUNDING)  # s light is across the axis from both sides
    # only along the axis p light has the ordinary index, too; Fresnel's p reflectance of an isotropic medium differs
    p_along = nacre.spectrum(made, 50.0, [550.0], "mueller", azimuth_deg=70.0).mueller_reflected
    p_against = nacre.spectrum(made, 50.0, [550.0], "mueller", azimuth_deg=250.0).mueller_reflected
    assert p_along is not None and p_against is not None
    np.testing.assert_allclose(p_along, p_against, atol=ROUNDING)  # reciprocity of a stack that does not mix s and p


def test_a_repeated_group_equals_its_layers_written_out() -> None:
    pair = [{"material": "TiO2", "thickness_nm": 55}, {"material": "SiO2", "thickness_nm": 90}]
    short = film(substrate="Si", layers=[{"repeat": 3, "layers": pair}, {"material": "SiO2", "thickness_nm": 10}])
    long = film(substrate="Si", layers=[*pair * 3, {"material": "SiO2", "thickness_nm": 10}])
    assert nacre.spectrum(short, [0, 60], [450.0, 600.0]) == nacre.spectrum(long, [0, 60], [450.0, 600.0])


def test_a_graded_layer_lies_within_its_stated_error_of_many_slices() -> None:
    graded = film(substrate=2.4, layers=[{"graded": {"from": 1.45, "to": 2.4}, "thickness_nm": 300}])
    n = 1.45 + 0.95 * (np.arange(1000) + 0.5) / 1000
    fine = film(substrate=2.4, layers=[{"material": float(x), "thickness_nm": 0.3} for x in n])
    waves = np.linspace(400, 700, 13)
    one, two = (nacre.spectrum(f, [0, 60], waves).specular_reflectance for f in (graded, fine))
    np.testing.assert_allclose(one, two, atol=2e-4)


def test_rough_interfaces_are_mixtures_of_their_neighbours() -> None:
    layer = {"material": 1.9, "thickness_nm": 100.0}
    rough = film(substrate=1.5, layers=[layer], surface={"interface_roughness_nm": [4.0, 0.0]})
    mixed = {"mix": ["air", 1.9], "volume_fractions": [0.5]}
    written = film(substrate=1.5, layers=[{"material": mixed, "thickness_nm": 4.0}, {**layer, "thickness_nm": 98.0}])
    one, two = (nacre.spectrum(f, [0, 60], [500.0]).specular_reflectance for f in (rough, written))
    np.testing.assert_allclose(one, two, atol=ROUNDING)


def test_a_spread_of_the_pitch_averages_the_powers_of_single_pitches() -> None:
    medium = {"ordinary": 1.5, "extraordinary": 1.65, "axis_polar_deg": 90.0}
    layer = {"material": medium, "thickness_nm": 3000.0, "pitch_nm": 350.0}
    waves = np.linspace(480, 600, 9)
    spread = nacre.spectrum(film(substrate=1.5, layers=[{**layer, "pitch_deviation_nm": 8.0}]), 20.0, waves, "right")
    x, weight = np.polynomial.hermite_e.hermegauss(61)
    single = [
        nacre.spectrum(film(substrate=1.5, layers=[{**layer, "pitch_nm": 350 + 8 * s}]), 20.0, waves, "right")
        for s in x
    ]
    mean = np.tensordot(weight / weight.sum(), [one.specular_reflectance[0] for one in single], 1)
    np.testing.assert_allclose(spread.specular_reflectance[0], mean, atol=1e-3)  # tails beyond 3.5 standard deviations


TILTED = {"ordinary": 1.5, "extraordinary": 2.0, "axis_polar_deg": 50.0}


def test_the_bsdf_of_a_smooth_anisotropic_film_depends_on_the_azimuth() -> None:
    made = film(substrate=1.5, layers=[{"material": TILTED, "thickness_nm": 300.0}], wavelengths={"step_nm": 25.0})
    bsdf = made.bsdf()
    for azimuth in (0.0, 33.0, 120.0, 260.0):
        seen = bsdf.specular(np.radians(50.0), phi_rad=np.radians(azimuth))
        exact = nacre.spectrum(made, 50.0, bsdf.wavelengths_nm, azimuth_deg=azimuth)
        # the table of 65 cosines and linear interpolation between 32 azimuths
        np.testing.assert_allclose(seen.reflectance, exact.specular_reflectance[0], atol=5e-3)
        np.testing.assert_allclose(seen.reflectance + seen.transmittance, 1.0, atol=1e-9)


def test_light_from_below_an_absorbing_anisotropic_film_leaves_towards_the_azimuth_of_the_table() -> None:
    medium = {"principal": [{"n": 1.5, "k": 0.05}, 1.9, 1.6], "euler_deg": [25, 40, 10]}
    made = film(substrate=1.33, layers=[{"material": medium, "thickness_nm": 250.0}], wavelengths={"step_nm": 50.0})
    grid = made.bsdf().wavelengths_nm
    below = made.model.tables(grid).lit(np.array([250.0]), from_above=False)
    theta = np.radians(40.0)
    for azimuth in np.radians([0.0, 33.0, 190.0]):
        seen = made.bsdf().specular(np.pi - theta, phi_rad=azimuth)
        exact = below.polarised(np.array([theta]), grid, -azimuth)  # turned about u
        np.testing.assert_allclose(seen.reflectance, exact.mueller_reflected[0, :, 0, 0], atol=6e-3)
        np.testing.assert_allclose(seen.transmittance, exact.entering[0, :, 0], atol=6e-3)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_facets_of_a_rough_anisotropic_film_reflect_by_the_azimuth_in_their_own_frame(tilt_deg: float) -> None:
    layers = [{"material": TILTED, "thickness_nm": 300.0}]
    made = film(substrate=1.5, layers=layers, wavelengths={"step_nm": 50.0}, surface={"roughness": 0.3})
    bsdf = made.bsdf()
    (lobe,) = bsdf.lobes
    mean = lobe.mean()
    tilt, turn = np.radians(tilt_deg), np.radians(70.0)
    axis = np.array([-np.sin(turn), np.cos(turn), 0.0])
    for azimuth in np.radians([0.0, 33.0, 200.0]):
        # light and viewer about the normal, then turned with the facet by Rodrigues' formula
        pair = direction(np.radians(35.0), np.array([azimuth, azimuth + np.pi]))
        wi, wo = (
            np.cos(tilt) * w + np.sin(tilt) * np.cross(axis, w) + (1 - np.cos(tilt)) * (axis @ w) * axis for w in pair
        )
        ratio = bsdf.evaluate(wi, wo) / mean.evaluate(wi, wo)
        found = ratio * mean.response.lookup(np.cos(np.radians(35.0)), np.array(False))[0]
        exact = nacre.spectrum(made, 35.0, bsdf.wavelengths_nm, azimuth_deg=float(np.degrees(azimuth)))
        np.testing.assert_allclose(found, exact.specular_reflectance[0], atol=5e-3)  # as of a smooth film
    reverse = bsdf.evaluate(wo, wi)
    np.testing.assert_allclose(bsdf.evaluate(wi, wo), reverse, rtol=1e-12)


def test_a_rough_free_anisotropic_film_keeps_the_energy() -> None:
    layers = [{"material": TILTED, "thickness_nm": 300.0}]
    made = film(substrate="air", layers=layers, wavelengths={"step_nm": 50.0}, surface={"roughness": 0.3})
    bsdf = made.bsdf()
    assert [lobe.kind for lobe in bsdf.lobes] == ["aligned-microfacet", "aligned-specular"]
    smooth = film(substrate="air", layers=layers, wavelengths={"step_nm": 50.0}).bsdf(bsdf.wavelengths_nm)
    for azimuth in (0.0, 1.2):
        reflected, passed = directional_hemispherical(bsdf, direction(np.radians([0.0, 45.0, 70.0]), azimuth))
        assert np.all(reflected + passed < 1.002)  # single scattering only loses light between facets
        assert np.all(reflected + passed > 0.85)
    nearly_smooth = film(substrate="air", layers=layers, wavelengths={"step_nm": 50.0}, surface={"roughness": 0.05})
    for azimuth in (0.0, 1.2):
        found = nearly_smooth.bsdf(bsdf.wavelengths_nm).specular(0.8, phi_rad=azimuth).transmittance
        exact = smooth.specular(0.8, phi_rad=azimuth).transmittance
        np.testing.assert_allclose(found, exact, atol=0.01)  # tilts change T in second order: 0.05^2 R''


@pytest.mark.parametrize(
    "keys",
    [
        {"base": {"albedo": 0.5}},
        {"ambient": 1.6, "substrate": 1.4},
        {"layers": [{"material": TILTED, "thickness_nm": {"formula": "200 + 100*u", "min": 200, "max": 300}}]},
    ],
)
def test_films_without_azimuth_hold_the_mean_with_a_warning(keys: dict[str, Any]) -> None:
    layers = [{"material": TILTED, "thickness_nm": 300.0}]
    bsdf = film(**{"substrate": 1.5, "layers": layers, "wavelengths": {"step_nm": 50.0}, **keys}).bsdf()
    assert bsdf.provenance["warnings"] and not any(lobe.kind.startswith("aligned") for lobe in bsdf.lobes)


def test_the_mean_over_the_azimuth_is_that_of_spectra() -> None:
    """An absorbing film that transmits has to be averaged over a whole turn."""
    medium = {"principal": [{"n": 1.4, "k": 0.05}, 2.8, 1.6], "euler_deg": [25, 10, 10]}
    thickness = {"formula": "250 + 10*u", "min": 250, "max": 260}
    varying, level = (
        film(substrate=1.33, layers=[{"material": medium, "thickness_nm": d}], wavelengths={"step_nm": 50.0})
        for d in (thickness, 250.0)
    )
    bsdf, theta_deg = varying.bsdf(), 65.0
    seen = bsdf.specular(np.radians(theta_deg), np.zeros(2))
    azimuths = np.arange(12) * 30.0
    found = [nacre.spectrum(level, theta_deg, bsdf.wavelengths_nm, azimuth_deg=a) for a in azimuths]
    mean = np.mean([one.specular_reflectance[0] for one in found], axis=0)
    np.testing.assert_allclose(seen.reflectance, mean, atol=5e-3)  # 4e-3 between azimuths, 1e-3 between angles
    mean = np.mean([one.specular_transmittance[0] for one in found], axis=0)
    np.testing.assert_allclose(seen.transmittance, mean, atol=5e-3)


def test_a_film_whose_colour_hardly_depends_on_the_azimuth_has_the_mean() -> None:
    medium = {"principal": [1.500, 1.501, 1.502], "euler_deg": [25, 40, 10]}
    bsdf = film(
        substrate=1.5, layers=[{"material": medium, "thickness_nm": 250.0}], wavelengths={"step_nm": 50.0}
    ).bsdf()
    assert [lobe.kind for lobe in bsdf.lobes] == ["specular"] and not bsdf.provenance.get("warnings")


@pytest.mark.parametrize(
    "keys",
    [
        {"layers": [{"material": {"principal": [1.5, 1.6, {"n": 1.7, "k": -0.1}]}, "thickness_nm": 100}]},
        {"layers": [{"material": {"principal": [1.5, 1.6]}, "thickness_nm": 100}]},
        {"layers": [{"material": {"principal": [1.5, 1.6, 1.7], "euler_deg": [1, 2]}, "thickness_nm": 100}]},
        {"layers": [{"material": {"ordinary": 1.5}, "thickness_nm": 100}]},
        {"layers": [{"material": {"ordinary": 1.5, "extraordinary": 1.6}, "thickness_nm": 100, "pitch_nm": 0}]},
        {"layers": [{"material": {"ordinary": 1.5, "extraordinary": 1.6}, "thickness_nm": 100, "pitch_nm": 0.01}]},
        {"layers": [{"material": {"principal": [1.5, 1.6, 1.7], "euler_deg": [1, nan, 2]}, "thickness_nm": 100}]},
        {"layers": [{"material": {"ordinary": 1.5, "extraordinary": 1.6}, "thickness_nm": 100, "handedness": "left"}]},
        {"layers": [{"material": 1.5, "thickness_nm": 100, "pitch_nm": 300}]},
        {"ambient": {"principal": [1.0, 1.0, 1.0]}},
        {"layers": [{"material": 1.5, "thickness_nm": 1}], "surface": {"interface_roughness_nm": 3}},
        {"layers": [{"material": 1.5, "thickness_nm": 9}], "surface": {"interface_roughness_nm": [3]}},
        {"layers": [{"repeat": 2.5, "layers": [{"material": 1.5, "thickness_nm": 1}]}]},
        {"layers": [{"repeat": 600, "layers": [{"material": 1.5, "thickness_nm": 1}] * 2}]},
        {"layers": [{"material": {"mix": ["SiO2", "air"], "volume_fractions": [0.5, 0.6]}, "thickness_nm": 1}]},
        {"layers": [{"material": {"mix": ["SiO2", "air"]}, "thickness_nm": 1}]},
    ],
)
def test_impossible_films_are_refused(keys: dict[str, Any]) -> None:
    with pytest.raises(NacreError):
        film(**{"substrate": "Si", **keys})


def test_fields_of_isotropic_layers_written_as_anisotropic_ones_are_those_of_the_isotropic_kernel() -> None:
    from nacre.matter.stack.field import field_profile

    def stack(medium: object) -> object:
        layers = [{"material": medium, "thickness_nm": 200.0}, {"material": 1.4, "thickness_nm": 80.0}]
        return film(substrate={"n": 0.2, "k": 3.0}, layers=layers).model.stack

    waves, z = np.array([450.0, 600.0]), np.linspace(-150.0, 380.0, 31)
    plain, tensor = stack(1.7), stack({"principal": [1.7, 1.7, 1.7], "euler_deg": [10, 20, 30]})
    for theta in (0.0, 0.6, 1.2):
        expected = field_profile(plain.indices(waves), np.array([200.0, 80.0]), waves, np.array([theta]), z)
        s, p = tensor.polarised_field(theta, waves, z)
        np.testing.assert_allclose(s, expected.s[:, 0], atol=1e-12)
        np.testing.assert_allclose(p, expected.p[:, 0], atol=1e-12)


def test_the_field_in_a_helix_explains_its_absorption() -> None:
    """Power lost = k0 eps'' integral of |E|^2 / (n0 cos theta) where eps'' is the same along all axes."""
    loss = 0.02
    ordinary, extraordinary = (np.sqrt(n**2 + 1j * loss) for n in (1.5, 1.7))
    medium = {
        "ordinary": {"n": float(ordinary.real), "k": float(ordinary.imag)},
        "extraordinary": {"n": float(extraordinary.real), "k": float(extraordinary.imag)},
        "axis_polar_deg": 70,
        "axis_azimuth_deg": 25,
    }
    layers = [{"material": medium, "thickness_nm": 900.0, "pitch_nm": 350.0, "handedness": "left"}]
    stack = film(substrate=1.5, layers=layers, ambient={"n": 1.0}).model.stack
    nodes, weights = np.polynomial.legendre.leggauss(60)
    theta, waves = np.radians(40.0), np.array([560.0])
    for azimuth in (0.0, 1.0):
        s, p = stack.polarised_field(theta, waves, 450.0 * (nodes + 1.0), azimuth)
        lost = [2 * np.pi / 560.0 * loss * 450.0 * np.sum(weights * f[:, 0]) / np.cos(theta) for f in (s, p)]
        row = stack.polarised(theta, waves, azimuth, absorption=True).absorbed[0, 0, 0]
        np.testing.assert_allclose(lost, [row[0] - row[1], row[0] + row[1]], rtol=1e-6)


def test_a_field_is_refused_for_a_spread_of_the_pitch() -> None:
    medium = {"ordinary": 1.5, "extraordinary": 1.7, "axis_polar_deg": 90}
    layer = {"material": medium, "thickness_nm": 900, "pitch_nm": 350, "pitch_deviation_nm": 10}
    with pytest.raises(NacreError):
        film(substrate=1.5, layers=[layer]).figure_data("field")


def test_a_helix_thinner_than_a_slice_is_refused() -> None:
    layer = {"material": TILTED, "thickness_nm": 0.5, "pitch_nm": 350}
    with pytest.raises(NacreError):
        film(substrate=1.5, layers=[layer])
    film(substrate=1.5, layers=[{**layer, "thickness_nm": 6.0}])


def test_an_azimuth_that_is_not_finite_is_refused() -> None:
    made = film(substrate=1.5, layers=[{"material": TILTED, "thickness_nm": 300.0}])
    with pytest.raises(NacreError):
        nacre.spectrum(made, 30.0, [500.0], "mueller", azimuth_deg=nan)
    with pytest.raises(NacreError):
        nacre.ellipsometry(made, [70.0], [500.0], nan)


def test_a_rough_anisotropic_film_is_a_mirror_part_of_pictures() -> None:
    from nacre.picture.picture import resolve_material

    layer = {
        "material": {"ordinary": {"n": 1.5}, "extraordinary": {"n": 2.2}, "axis_polar_deg": 90},
        "thickness_nm": 300,
    }
    film = nacre.material({"family": "film", "substrate": "Si", "layers": [layer], "surface": {"roughness": 0.2}})
    bsdf, _ = resolve_material(film.bsdf(np.array([450.0, 550.0, 650.0])), None, "specular")
    assert [lobe.kind for lobe in bsdf.lobes] == ["aligned-microfacet"]
    with pytest.raises(UnsupportedError):
        resolve_material(bsdf, None, "diffuse")


def test_a_table_of_light_in_a_dense_ambient_states_its_own_error() -> None:
    medium = {"ordinary": 1.5, "extraordinary": 1.7, "axis_polar_deg": 90}
    made = film(ambient={"n": 1.5}, substrate={"n": 1.0}, layers=[{"material": medium, "thickness_nm": 900}])
    bsdf = made.bsdf(np.array([450.0, 600.0]))
    note = bsdf.provenance["angle_table"]
    assert note["largest_error"] < 5e-3 and note["ranges"] == []
    assert np.all(bsdf.angle_error(np.radians([20.0, 160.0])) < 5e-3)


def test_a_stored_rough_anisotropic_film_has_its_mirror_spectrum(tmp_path: Path) -> None:
    medium = {"ordinary": {"n": 1.5}, "extraordinary": {"n": 2.2}, "axis_polar_deg": 90}
    made = film(substrate="Si", layers=[{"material": medium, "thickness_nm": 300}], surface={"roughness": 0.2})
    waves, angles = np.array([450.0, 550.0, 650.0]), np.radians([0.0, 40.0])
    made.bsdf(waves).save(tmp_path / "film.nacre")
    stored = nacre.spectrum(nacre.load(tmp_path / "film.nacre"), np.degrees(angles)).specular_reflectance
    assert stored == pytest.approx(made.spectrum(angles, waves).specular_reflectance, abs=1e-3)


def test_a_smooth_interface_of_a_crystal_is_no_rough_one() -> None:
    calcite = {"ordinary": "calcite-o", "extraordinary": "calcite-e"}
    layers = [{"material": 1.5, "thickness_nm": 90}, {"material": calcite, "thickness_nm": 200}]
    made = film(substrate=1.5, layers=layers, surface={"interface_roughness_nm": [4.0, 0.0, 0.0]})
    assert [layer.thickness_nm for layer in made.model.layers] == pytest.approx([4.0, 88.0, 200.0])
