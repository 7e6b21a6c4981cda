"""Film recipes: what they build, and the one line for what they may not say."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from nacre import light
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.families.film.spec import FilmSpec, leading_layer
from nacre.material.material import Material, load, material
from nacre.recipe.model import RecipeContext, validate

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def build(**recipe: Any) -> Any:
    return material({"family": "film", "substrate": "Si", **recipe}).model


def refused(tmp_path: Path, **recipe: Any) -> str:
    """Return the one line with which a recipe is refused."""
    context = RecipeContext("my.toml", tmp_path)
    with pytest.raises(NacreError) as caught:
        validate(FilmSpec, {"family": "film", "substrate": "Si", **recipe}, context).build(context)
    message = str(caught.value)
    assert message.startswith("my.toml: ") and "\n" not in message and len(message) < 500, message
    return message


def test_lengths_may_carry_any_unit() -> None:
    nm = build(layers=[{"material": "SiO2", "thickness_nm": 400}])
    um = build(layers=[{"material": "SiO2", "thickness_um": 0.4}])
    assert um.layers[0].thickness_nm == pytest.approx(nm.layers[0].thickness_nm, rel=1e-15)


def test_exponents_and_alphas_say_the_same() -> None:
    by_alpha = build(surface={"roughness": [0.1, 0.2], "distribution": "blinn"}).surface
    by_exponent = build(surface={"exponent": [2 / 0.01 - 2, 2 / 0.04 - 2], "distribution": "blinn"}).surface
    assert (by_exponent.alpha_x, by_exponent.alpha_y) == pytest.approx((by_alpha.alpha_x, by_alpha.alpha_y))


def test_a_formula_makes_a_thickness_over_uv() -> None:
    film = build(layers=[{"material": "SiO2", "thickness_nm": {"formula": "100 + 600*v"}}])
    texture = film.layers[0].thickness_nm
    assert (texture.low, texture.high) == (100.0, 700.0)
    assert texture(np.array([[0.2, 0.0], [0.9, 0.5]])) == pytest.approx([100.0, 400.0])
    scaled = build(layers=[{"material": "SiO2", "thickness_um": {"formula": "0.1 + 0.6*v"}}])
    assert scaled.layers[0].thickness_nm.high == pytest.approx(700.0)


@pytest.mark.parametrize("mode", ["L", "RGB", "I;16", "1", "P", "RGBA"])
def test_an_image_makes_a_thickness_over_uv(tmp_path: Path, mode: str) -> None:
    if mode == "I;16":
        image = Image.fromarray(np.array([[0, 65535], [65535, 0]], dtype=np.uint16))
    else:
        image = Image.fromarray(np.array([[0, 255], [255, 0]], dtype=np.uint8)).convert(mode)
    image.save(tmp_path / "t.png")
    film = material(
        {
            "family": "film",
            "substrate": "Si",
            "layers": [{"material": "SiO2", "thickness_nm": {"texture": "t.png", "min": 100, "max": 700}}],
        },
        tmp_path,
    ).model
    at_top_right = film.layers[0].thickness_nm(np.array([0.75, 0.75]))
    assert at_top_right == pytest.approx(700.0)
    assert film.layers[0].thickness_nm(np.array([0.25, 0.75])) == pytest.approx(100.0)


def test_the_preset_yields_to_what_is_given() -> None:
    film = build(preset="morpho", substrate={"n": 1.56}, ridges={"width_um": 0.25})
    assert film.ridges.width_nm == pytest.approx(250.0)
    assert film.ridges.pitch_nm == 700.0
    assert len(film.layers) == 17


@pytest.mark.parametrize(
    ("recipe", "says"),
    [
        ({"sustrate": "Si"}, 'Did you mean "substrate"'),
        ({"N": 1.5}, 'key N is not known. Did you mean "ambient.n"?'),
        ({"Substrate": "Si"}, 'key Substrate is not known. Did you mean "substrate"?'),
        ({"layers": [{"material": "TiO3", "thickness_nm": 10}]}, "TiO2"),
        ({"layers": [{"material": "TiO2", "thickness_nm": -1}]}, "layers[0].thickness_nm"),
        ({"layers": [{"material": "TiO2", "thickness_nm": "thick"}]}, "layers[0].thickness_nm"),
        ({"layers": [{"material": "TiO2", "thicknes_nm": 3}]}, 'Did you mean "thickness_nm"'),
        ({"layers": [{"material": "TiO2"}]}, "layers[0].thickness_nm is missing"),
        ({"layers": [{"material": "TiO2", "thickness_nm": 1, "thickness_um": 1}]}, "twice"),
        ({"layers": [{"material": "TiO2", "thickness_nm": True}]}, "thickness"),
        ({"layers": [{"material": "SiO2", "thickness_mm": 1}]}, "incoherent = true"),
        ({"layers": [{"material": "SiO2", "thickness_nm": 30000.5}]}, "incoherent = true"),
        ({"layers": [{"material": {"n": 1.5, "k": -0.1}, "thickness_nm": 10}]}, "k"),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"formula": "__import__('os')"}}]}, "not allowed"),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"formula": "u**"}}]}, "formula"),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"formula": "u - 5"}}]}, "0 ..."),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"formula": "log(-1-u)"}}]}, "finite"),
        (
            {"layers": [{"material": "SiO2", "thickness_nm": {"texture": "no.png", "min": 0, "max": 9}}]},
            "does not exist",
        ),
        (
            {"layers": [{"material": "SiO2", "thickness_nm": {"texture": "bad.png", "min": 0, "max": 9}}]},
            "readable image",
        ),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"texture": "bad.png"}}]}, "min and max"),
        ({"layers": [{"material": "SiO2", "thickness_nm": {"formula": "u"}}] * 3}, "at most 2"),
        ({"surface": {"roughness": 1.5}}, "[0, 1]"),
        ({"surface": {"roughness": [0.1, 0.2, 0.3]}}, "roughness"),
        ({"surface": {"roughness": -0.1}}, "[0, 1]"),
        ({"surface": {"distribution": "gxx"}}, "surface.distribution"),
        ({"surface": {"roughness": 0.1, "exponent": 100}}, "exclude"),
        ({"surface": {"exponent": -3}}, "exponent"),
        ({"ridges": {"pitch_nm": 300, "width_nm": 400, "height_deviation_nm": 0}}, "width_nm"),
        ({"preset": "morfo"}, "preset"),
        ({"base": {"albedo": 1.2}}, "base.albedo"),
        ({"wavelengths": {"min_nm": 700, "max_nm": 400}}, "max_nm"),
        ({"layers": 3}, "layers"),
        ({"substrate": 0}, "substrate"),
    ],
)
def test_bad_input_gets_one_clear_line(tmp_path: Path, recipe: dict, says: str) -> None:
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n not really")
    assert says in refused(tmp_path, **recipe)


def test_a_base_under_a_metal_is_refused() -> None:
    with pytest.raises(NacreError, match="opaque"):
        build(substrate="Au", base={"albedo": 0.5}).bsdf()


def test_wavelengths_outside_a_constant_are_an_error_unless_opted_in() -> None:
    recipe = {"substrate": "Ag", "wavelengths": {"min_nm": 300, "max_nm": 40000, "step_nm": 50}}
    with pytest.raises(NacreError, match="Ag"):
        build(**recipe).bsdf()
    build(**recipe, extrapolate="edge").bsdf()


def test_films_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        build().base_albedo = 1.0


FILMS = sorted(path for path in EXAMPLES.glob("*.toml") if 'family = "film"' in path.read_text())


@pytest.mark.parametrize("path", FILMS, ids=lambda p: p.stem)
def test_examples_of_films_build_and_keep_energy(path: Path) -> None:
    spectrum = load(path).spectrum(np.radians([0.0, 60.0]))
    total = sum(np.asarray(part) for part in spectrum.parts().values())
    assert np.all(total <= 1.0 + 1e-3)
    assert np.all(total >= 0.0)


def test_examples_are_many() -> None:
    assert len(FILMS) >= 10


def test_a_recipe_error_is_the_class_that_is_raised() -> None:
    with pytest.raises(RecipeError):
        build(surface={"roughness": 7})


def test_a_key_of_another_table_is_named_with_its_place() -> None:
    with pytest.raises(RecipeError, match=r'key roughness is not known\. Did you mean "surface\.roughness"\?'):
        material({"family": "film", "substrate": "Si", "roughness": 0.2})


def test_the_map_of_a_film_is_over_the_layer_whose_ten_percent_change_the_colour_most() -> None:
    """15 nm of chromium change the colour more than the glass below once they are nearly left out, but not at 10 %."""
    thicknesses = {"Cr": 15.0, "SiO2": 350.0}
    wavelengths = np.arange(380.0, 781.0, 10.0)

    def film(**changed: float) -> Material:
        layers = [{"material": m, "thickness_nm": changed.get(m, d)} for m, d in thicknesses.items()]
        return material({"family": "film", "substrate": "Si", "layers": layers})

    def lab(name: str, factor: float) -> np.ndarray:
        seen = film(**{name: factor * thicknesses[name]}).bsdf(wavelengths).specular(np.zeros(1)).reflectance
        return light.xyz_to_lab(light.spectrum_to_xyz(seen, wavelengths), light.white_xyz("D65"))

    def change(name: str, factor: float) -> float:
        return float(light.delta_e_2000(lab(name, factor), lab(name, 2.0 - factor))[0])

    assert change("Cr", 0.1) > change("SiO2", 0.1)
    assert change("SiO2", 0.9) > change("Cr", 0.9)
    assert leading_layer(film().model) == 1


def test_the_layer_sheet_states_index_and_quarter_waves(tmp_path: Path) -> None:
    recipe = tmp_path / "coat.toml"
    recipe.write_text(
        'family = "film"\nsubstrate = {n = 1.52}\nlayers = [{material = {n = 1.38}, thickness_nm = 100}]\n'
    )
    assert run(["fabricate", str(recipe), "--to", "sheet", "-o", str(tmp_path / "s.csv")]) == 0
    lines = (tmp_path / "s.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [float(row["n_550nm"]) for row in rows] == [pytest.approx(n, abs=1e-3) for n in (1.0, 1.38, 1.52)]
    assert float(rows[1]["quarter_waves"]) == pytest.approx(4 * 1.38 * 100 / 550, rel=1e-5)
