"""Numbers that vary over the surface: plain materials at the nodes, the stated colour error between them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.lobes.masked import hat
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab
from nacre.material.material import material
from nacre.material.spatial_variation import COLOUR_ERROR, MAX_NODES, Varying, choose_nodes, node_colours
from nacre.recipe.paths import varying_numbers
from nacre.recipe.toml import dump_toml

WAVES = np.array([430.0, 550.0, 650.0])
FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "glass",
    "layers": [{"material": "TiO2", "thickness_nm": 60}],
    "base": {"albedo": 0.5},
}
METASURFACE: dict[str, Any] = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 55.0, "gap_nm": 2.0},
    "monolayer": {"density_per_um2": 8.0, "packing": 0.3},
}
PEARL: dict[str, Any] = {
    "family": "pearl",
    "strata": [
        {
            "resin": "PET",
            "thickness_um": 20.0,
            "roughness": 0.1,
            "platelets": [
                {
                    "volume_fraction": 0.03,
                    "substrate": {"material": "mica", "thickness_nm": 400.0, "deviation_nm": 100.0},
                    "coatings": [{"material": "TiO2", "thickness_nm": 60.0}],
                    "normal_deviation": 0.15,
                }
            ],
        }
    ],
    "base": {"albedo": 0.1},
}
FLAKE = "strata[0].platelets[0]"
CASES = [
    pytest.param(FILM, "base.albedo", (0.2, 0.5), id="tint of a film's base"),
    pytest.param(METASURFACE, "particle.radius_nm", (52.0, 56.0), id="particle radius"),
    pytest.param(METASURFACE, "monolayer.density_per_um2", (6.0, 8.0), id="density"),
]
WALKS = [
    pytest.param(PEARL, f"{FLAKE}.volume_fraction", (0.02, 0.05), id="platelet fraction"),
    pytest.param(PEARL, f"{FLAKE}.coatings[0].thickness_nm", (60.0, 66.0), id="coating"),
    pytest.param(PEARL, "strata[0].thickness_um", (15.0, 20.0), id="stratum thickness"),
    pytest.param(PEARL, "strata[0].roughness", (0.1, 0.16), id="roughness"),
    pytest.param(PEARL, f"{FLAKE}.rotation_deg", (0.0, 6.0), id="rotation"),
    pytest.param(PEARL, "base.albedo", (0.1, 0.3), id="tint of a pearl's base"),
]


def fixed(recipe: dict[str, Any], path: str, value: Any) -> nacre.Material:
    if path.endswith("rotation_deg"):
        value = [0.0, value, 0.0]
    return nacre.material(recipe).vary({path: value})


def across(recipe: dict[str, Any], path: str, ends: tuple[float, float]) -> nacre.Material:
    return fixed(recipe, path, {"formula": f"{ends[0]} + {ends[1] - ends[0]}*u"})


def pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    z, phi = generator.uniform(0.3, 1, (2, count)), generator.uniform(0, 6, (2, count))
    r = np.sqrt(1 - z**2)
    wi, wo = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
    return wi, wo


def check_ends_and_middle(recipe: dict[str, Any], path: str, ends: tuple[float, float], samples: int | None) -> None:
    bsdf = across(recipe, path, ends).bsdf(WAVES)
    note = next(iter(bsdf.provenance["varying"].values()))
    assert note["colour_error_dE00"] <= COLOUR_ERROR and note["nodes"] <= MAX_NODES
    wi, wo = pairs(6)
    for u, value in ((0.0, ends[0]), (1.0, ends[1])):
        uv = np.full((len(wi), 2), u)
        plain = fixed(recipe, path, value).bsdf(WAVES)
        ours = nacre.evaluate(bsdf, wi, wo, uv=uv, samples=samples)
        np.testing.assert_allclose(ours, nacre.evaluate(plain, wi, wo, samples=samples), rtol=1e-9, atol=1e-12)
        ours_specular, plain_specular = bsdf.specular(0.5, uv[0]), plain.specular(0.5)
        np.testing.assert_allclose(ours_specular.reflectance, plain_specular.reflectance, atol=1e-12)
        np.testing.assert_allclose(ours_specular.transmittance, plain_specular.transmittance, atol=1e-12)


@pytest.mark.parametrize(("recipe", "path", "ends"), CASES)
def test_the_ends_are_the_plain_materials(recipe: dict[str, Any], path: str, ends: tuple[float, float]) -> None:
    check_ends_and_middle(recipe, path, ends, None)


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize(("recipe", "path", "ends"), WALKS)
def test_the_ends_of_a_walk_are_the_plain_materials(
    recipe: dict[str, Any], path: str, ends: tuple[float, float]
) -> None:
    check_ends_and_middle(recipe, path, ends, 256)


@pytest.mark.parametrize(("recipe", "path", "ends"), CASES[::2])
def test_colours_between_nodes_are_within_the_stated_error(
    recipe: dict[str, Any], path: str, ends: tuple[float, float]
) -> None:
    # places that the choice of nodes did not look at
    def colours(value: float) -> np.ndarray:
        return node_colours(fixed(recipe, path, value))

    nodes, _ = choose_nodes(colours, *ends, path)
    known = [colours(float(node)) for node in nodes]
    for share in (0.3, 0.85):
        value = ends[0] + share * (ends[1] - ends[0])
        blended = sum(float(hat(np.array(value), nodes, k)) * xyz for k, xyz in enumerate(known))
        assert np.max(delta_e_2000(xyz_to_lab(blended), xyz_to_lab(colours(value)))) <= COLOUR_ERROR


def test_the_spectrum_is_the_mean_over_the_surface() -> None:
    path, ends = "base.albedo", (0.2, 0.5)
    found = across(FILM, path, ends).spectrum([0.3], WAVES).parts()
    places = ends[0] + (np.arange(16) + 0.5) / 16 * (ends[1] - ends[0])
    plain = [fixed(FILM, path, float(value)).spectrum([0.3], WAVES).parts() for value in places]
    mean = np.mean([parts["diffuse_reflectance"] for parts in plain], axis=0)
    np.testing.assert_allclose(found["diffuse_reflectance"], mean, rtol=0.03)  # dE00 of 1
    np.testing.assert_allclose(found["specular_reflectance"], plain[0]["specular_reflectance"], rtol=1e-12)


def test_two_numbers_vary_at_once_and_are_stored(tmp_path: Path) -> None:
    material = nacre.material(METASURFACE).vary(
        {"particle.radius_nm": {"formula": "54 + u"}, "monolayer.density_per_um2": {"formula": "7 + v"}}
    )
    bsdf = material.bsdf(WAVES)
    wi, wo = pairs(4)
    corner = nacre.material(METASURFACE).vary({"particle.radius_nm": 55.0, "monolayer.density_per_um2": 7.0})
    uv = np.broadcast_to([1.0, 0.0], (4, 2))
    np.testing.assert_allclose(bsdf.evaluate(wi, wo, uv), corner.bsdf(WAVES).evaluate(wi, wo), rtol=1e-9)
    bsdf.save(tmp_path / "m.nacre")
    again = nacre.Bsdf.load(tmp_path / "m.nacre")
    uv = np.random.default_rng(1).random((4, 2))
    np.testing.assert_array_equal(again.evaluate(wi, wo, uv), bsdf.evaluate(wi, wo, uv))
    assert set(again.lobes[0].varying) == {"particle.radius_nm", "monolayer.density_per_um2"}


def test_an_image_drives_a_number_in_the_recipes_own_unit(tmp_path: Path) -> None:
    from PIL import Image

    Image.fromarray(np.array([[0, 255]], dtype=np.uint8)).save(tmp_path / "t.png")
    data = METASURFACE | {
        "particle": {"material": "Ag", "gap_nm": 2.0, "radius_um": {"texture": "t.png", "min": 0.053, "max": 0.055}},
    }
    (tmp_path / "m.toml").write_text(dump_toml(data))
    bsdf = nacre.load(tmp_path / "m.toml").bsdf(WAVES)
    wi, wo = pairs(4)
    for u, radius in ((0.25, 53.0), (0.75, 55.0)):  # the middles of the two texels
        plain = nacre.material(METASURFACE).vary({"particle.radius_nm": radius}).bsdf(WAVES)
        uv = np.broadcast_to([u, 0.5], (4, 2))
        np.testing.assert_allclose(bsdf.evaluate(wi, wo, uv), plain.evaluate(wi, wo), rtol=1e-6)


def test_nodes_gather_where_colours_bend() -> None:
    nodes, error = choose_nodes(lambda x: np.array([[x**2, x**2, x**2]]), 0.05, 1.0, "x")
    assert error <= COLOUR_ERROR
    assert np.diff(nodes)[0] < np.diff(nodes)[-1]
    single, error = choose_nodes(lambda x: np.ones((1, 3)), 2.0, 2.0, "x")
    assert list(single) == [2.0] and error == 0.0


def test_weights_of_the_nodes_sum_to_one() -> None:
    nodes = np.array([1.0, 1.5, 3.0])
    values = np.linspace(0.0, 4.0, 41)
    np.testing.assert_allclose(sum(hat(values, nodes, k) for k in range(3)), 1.0)
    assert hat(np.array(2.25), nodes, 2) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"particle.radius_nm": {"formula": "5*u - 1"}}, "particle.radius_nm"),
        ({"particle.radius_nm": {"texture": "none.png", "min": 50, "max": 60}}, "none.png"),
        ({"particle.radius_nm": {"formula": "50+u", "steps": 3}}, "particle.radius_nm: key steps"),
        ({"particle.radius_nm": {"formula": "50+u"}, "monolayer.packing": {"formula": "0.3+0.1*v"},
          "monolayer.density_per_um2": {"formula": "8+u"}}, "at most 2"),
    ],
)  # fmt: skip
def test_a_bad_texture_is_refused_in_one_line(changes: dict[str, Any], what: str) -> None:
    with pytest.raises(NacreError) as caught:
        nacre.material(METASURFACE).vary(changes)
    assert what in str(caught.value) and "\n" not in str(caught.value)


def test_too_wide_a_range_is_refused_with_its_error() -> None:
    with pytest.raises(UnsupportedError, match=f"{MAX_NODES} nodes.*narrow"):
        choose_nodes(lambda x: np.full((1, 3), 0.5 + 0.5 * np.sin(300 * x)), 0.0, 1.0, "x")


def test_ends_of_another_kind_are_refused() -> None:
    # without a base the film lets light pass; with one it does not
    with pytest.raises(UnsupportedError, match=r"^base\.albedo: "):
        across(FILM, "base.albedo", (0.0, 0.5)).bsdf(WAVES)


def test_what_a_family_varies_by_itself_is_left_to_it() -> None:
    data = FILM | {"layers": [{"material": "TiO2", "thickness_nm": {"formula": "50 + 10*u"}}]}
    assert not isinstance(nacre.material(data).model, Varying)
    assert varying_numbers(data, ("base.albedo",)) == {}
    both = data | {"base": {"albedo": {"formula": "0.4 + 0.1*v"}}}
    assert set(nacre.material(both).bsdf().lobes[0].varying) == {"base.albedo", "layers[0].thickness_nm"}


def test_the_numbers_message_names_them_all() -> None:
    with pytest.raises(RecipeError, match="strata\\[\\]\\.platelets\\[\\]\\.volume_fraction"):
        nacre.material(PEARL | {"strata": [PEARL["strata"][0] | {"resin": {"n": {"formula": "1.5+u"}}}]})


@pytest.mark.render
@pytest.mark.parametrize(("recipe", "path", "ends"), [CASES[0], CASES[2]], ids=["film", "metasurface"])
def test_the_plugin_gives_the_arrays_values(recipe: dict[str, Any], path: str, ends: tuple[float, float]) -> None:
    import nacre.render
    from nacre.bsdf import Bsdf
    from nacre.bsdf.lobes.monolayer import ROUNDING

    nacre.render.use_variant()
    from lobe_trials import array_mismatch

    # words round the series of a metasurface by up to ROUNDING in root mean square: by four times that at most
    bar = 4 * ROUNDING if recipe["family"] == "metasurface" else 1e-4

    bsdf = across(recipe, path, ends).bsdf(WAVES)
    wi, wo = pairs(100)
    uv = np.random.default_rng(2).random((100, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert array_mismatch(Bsdf(tuple(x for x in bsdf.lobes if not x.is_delta)), wi, wo, uv) <= bar


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize(("recipe", "path", "ends"), [CASES[0], CASES[1], WALKS[0]])
def test_a_family_renders_with_a_texture(
    tmp_path: Path, recipe: dict[str, Any], path: str, ends: tuple[float, float]
) -> None:
    from nacre.cli import run

    (tmp_path / "m.toml").write_text(dump_toml(across(recipe, path, ends).data))
    options = ["--size", "24x24", "--spp", "4", "-o", str(tmp_path / "x.png")]
    assert run(["render", str(tmp_path / "m.toml"), *options]) == 0


STAIN = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": {"formula": "100+300*u"}}],
}


@pytest.mark.parametrize("grid", [[500.0, 525.0, 550.0, 575.0, 600.0], [550.0], [900.0, 950.0, 1000.0]])
def test_a_film_that_varies_needs_no_colour_to_be_solved(grid: list[float]) -> None:
    """On a grid too narrow for a colour each wavelength is kept as a grey would be: within half a dE00."""
    bsdf = material(STAIN).bsdf(np.array(grid))
    for u in np.linspace(0.03, 0.97, 12):
        even = {**STAIN, "layers": [{"material": "SiO2", "thickness_nm": 100 + 300 * u}]}
        exact = material(even).bsdf(np.array(grid)).specular(np.radians([0.0, 50.0])).reflectance
        seen = bsdf.specular(np.radians([0.0, 50.0]), np.array([[u, 0.5]] * 2)).reflectance
        white = white_xyz()
        assert np.max(delta_e_2000(xyz_to_lab(seen[..., None] * white), xyz_to_lab(exact[..., None] * white))) <= 0.75


@pytest.mark.parametrize("ends", [(450.0, 650.0), (900.0, 1100.0)])
@pytest.mark.parametrize("thickness", [300.0, 3000.0, {"formula": "100+300*u"}])
def test_a_recipe_may_be_known_in_a_part_of_the_colours_only(ends: tuple[float, float], thickness: object) -> None:
    even = {**STAIN, "layers": [{"material": "SiO2", "thickness_nm": thickness}]}
    found = material({**even, "wavelengths": {"min_nm": ends[0], "max_nm": ends[1]}}).bsdf()
    assert (found.wavelengths_nm[0], found.wavelengths_nm[-1]) == ends


def test_any_number_may_vary_where_colours_are_undefined() -> None:
    base = {"substrate": {"n": 1.5}, "base": {"albedo": {"formula": "0.1+0.8*u"}}}
    even = {**STAIN, **base, "layers": [], "wavelengths": {"min_nm": 450.0, "max_nm": 650.0}}
    assert len(material(even).bsdf().lobes) >= 4
