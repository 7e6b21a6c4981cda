"""What the commands print and write, in the words the design promises."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import COMMANDS, run

FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
ROUGH = FILM + "[surface]\nroughness = 0.2\n"


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "film.toml"
    path.write_text(ROUGH)
    return path


def test_spectrum_json_holds_the_promised_arrays(recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["spectrum", str(recipe), "--json", "--angles-deg", "0:60:30", "--wavelengths-nm", "400:700:100"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["wavelengths_nm"] == [400, 500, 600, 700]
    assert document["angles_deg"] == [0, 30, 60]
    assert np.shape(document["specular_reflectance"]) == (3, 4)


def test_polarisations_average_to_the_unpolarised_spectrum(recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = {}
    for polarisation in ("s", "p", "both"):
        arguments = ["--angles-deg", "50", "--wavelengths-nm", "450:650:50", "--json", "--polarisation", polarisation]
        assert run(["spectrum", str(recipe), *arguments]) == 0
        values[polarisation] = np.array(json.loads(capsys.readouterr().out)["specular_reflectance"])
    np.testing.assert_allclose((values["s"] + values["p"]) / 2, values["both"], rtol=1e-12)


def test_lengths_may_be_written_in_any_unit(recipe: Path, tmp_path: Path) -> None:
    other = tmp_path / "um.toml"
    other.write_text(ROUGH.replace("thickness_nm = 300", "thickness_um = 0.3"))
    first, second = (nacre.load(p).spectrum([0.0]).specular_reflectance for p in (recipe, other))
    np.testing.assert_allclose(first, second, rtol=1e-9)


def test_evaluate_writes_what_the_api_gives(recipe: Path, tmp_path: Path) -> None:
    wi = np.tile([0.0, 0.0, 1.0], (4, 1))
    theta = np.radians([0, 10, 20, 40])
    wo = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    np.savez(tmp_path / "d.npz", wi=wi, wo=wo)
    output = tmp_path / "v.npz"
    assert run(["evaluate", str(recipe), "--directions", str(tmp_path / "d.npz"), "-o", str(output)]) == 0
    with np.load(output) as found:
        np.testing.assert_allclose(found["f"], nacre.evaluate(recipe, wi, wo), rtol=1e-12)
        assert found["f"].shape == (4, len(found["wavelengths_nm"]))
        assert "f_std" not in found
        assert json.loads(str(found["provenance"]))["recipe"] == ROUGH


def test_a_compiled_file_gives_the_recipes_values(recipe: Path, tmp_path: Path) -> None:
    stored = tmp_path / "film.nacre"
    assert run(["compile", str(recipe), "-o", str(stored)]) == 0
    wi, wo = np.array([0.0, 0.6, 0.8]), np.array([0.0, -0.6, 0.8])
    np.testing.assert_allclose(nacre.evaluate(stored, wi, wo), nacre.evaluate(recipe, wi, wo), rtol=1e-6)
    assert nacre.Bsdf.load(stored).provenance["recipe"] == ROUGH
    assert run(["spectrum", str(stored)]) == 0
    assert run(["report", str(stored), "-o", str(tmp_path / "r.json")]) == 0


def test_set_changes_one_number_for_one_run(recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "spectrum",
        str(recipe),
        "--json",
        "--set",
        "layers[0].thickness_nm=100",
        "--set",
        "surface.roughness=0",
    ]
    assert run(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    changed = nacre.load(recipe).vary({"layers[0].thickness_nm": 100, "surface.roughness": 0})
    np.testing.assert_allclose(document["specular_reflectance"], changed.spectrum([0.0]).specular_reflectance)
    assert nacre.load(recipe).get("layers[0].thickness_nm") == 300


def test_vary_writes_a_recipe_that_loads_to_the_same_material(recipe: Path) -> None:
    changed = nacre.load(recipe).vary({"layers[0].thickness_nm": 123.5})
    again = recipe.with_name("again.toml")
    again.write_text(changed.text)
    np.testing.assert_array_equal(
        nacre.load(again).spectrum([0.3]).specular_reflectance, changed.spectrum([0.3]).specular_reflectance
    )


def test_messages_go_to_stderr_and_data_to_stdout(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["spectrum", str(recipe), "-o", str(tmp_path / "s.csv")]) == 0
    captured = capsys.readouterr()
    assert captured.out == "" and "s.csv" in captured.err


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    assert "Usage: nacre" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["report", "tolerance", "gamut", "plot"])
def test_help_names_every_lamp(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    from nacre.light import ILLUMINANTS

    assert run([command, "--help"]) == 0
    said = capsys.readouterr().out.replace(",", " ").replace(".", " ").split()
    assert set(ILLUMINANTS) <= set(said)


@pytest.mark.parametrize(
    "kind", ["spectrum", "ribbon", "colour-map", "slice", "lobe", "chromaticity", "field", "structure"]
)
def test_every_figure_of_a_film_is_drawn(recipe: Path, tmp_path: Path, kind: str) -> None:
    output = tmp_path / "figure.png"
    assert run(["plot", str(recipe), "--kind", kind, "-o", str(output)]) == 0
    assert output.stat().st_size > 5000


@pytest.mark.render
def test_a_picture_carries_its_provenance(recipe: Path, tmp_path: Path) -> None:
    from nacre.picture.images import read_provenance

    output = tmp_path / "x.png"
    assert run(["render", str(recipe), "--size", "32x24", "--spp", "4", "--seed", "5", "-o", str(output)]) == 0
    found = read_provenance(output)
    assert found["seed"] == 5 and found["illuminant"] == "D65"
    assert "SiO2" in json.dumps(found)


@pytest.mark.render
def test_packages_are_verbs(recipe: Path) -> None:
    result = nacre.render(nacre.load(recipe), size=(16, 16), spp=4, progress=False)
    assert result.srgb8.shape == (16, 16, 3)
    assert "<img" in nacre.load(recipe)._repr_html_()


@pytest.mark.render
def test_a_notebook_shows_the_files_of_a_recipe_as_they_are_now(tmp_path: Path) -> None:
    table = tmp_path / "metal.csv"
    path = tmp_path / "plain.toml"
    path.write_text('family = "film"\nsubstrate = {file = "metal.csv"}\nlayers = []\n')

    def shown(index: float, absorption: float) -> str:
        table.write_text("".join(f"{w},{index},{absorption}\n" for w in (300, 600, 900)))
        return str(nacre.load(path)._repr_html_())

    assert shown(0.2, 3.0) != shown(3.0, 0.1)
