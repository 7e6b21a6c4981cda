"""Named numbers in formulas, the time of animations, and the recipes that come with nacre."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.texture import parse_formula, uses_time, with_values
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.material.examples import copy_examples, examples, examples_folder, find_example

FORMULA = "100 + 500*v^drain + 40*sin(drain*u) + t"


def _film(formula: str = FORMULA, **tables: Any) -> dict[str, Any]:
    thickness = {"formula": formula, "min": 20, "max": 700}
    layer = {"material": {"n": 1.33}, "thickness_nm": thickness}
    return {"family": "film", "substrate": "air", "layers": [layer], **tables}


def _value(material: Any, u: float, v: float) -> float:
    """The thickness that the film's own lobe gives at a place."""
    texture = material.bsdf(np.array([500.0, 600.0])).lobes[0].parameters[0].texture
    return float(texture(np.array([u, v])))


def test_a_named_number_stands_in_the_formula() -> None:
    film = nacre.material(_film(numbers={"drain": 2.0}))
    assert _value(film, 0.3, 0.5) == pytest.approx(100 + 500 * 0.25 + 40 * np.sin(0.6), rel=1e-6)
    changed = film.vary({"numbers.drain": 1.0, "numbers.t": 7.0})
    assert _value(changed, 0.3, 0.5) == pytest.approx(107 + 250 + 40 * np.sin(0.3), rel=1e-6)
    assert film.parameters["numbers.drain"] == 2.0
    assert film.fingerprint != changed.fingerprint


def test_names_are_whole_words_and_no_functions() -> None:
    names = {"s": 2.0, "sin": 3.0, "e2": 4.0}
    assert with_values("s*sin(u) + 1e2*e2 + sin + steps", names) == "(2.0)*sin(u) + 1e2*(4.0) + (3.0) + steps"


def test_a_recipe_inside_keeps_its_own_numbers() -> None:
    """Of a share a + b the inner a counts, and the b around it."""
    inner = {"family": "blend", "first": {"family": "film", "substrate": "Ag"},
             "second": {"family": "film", "substrate": "Cu"}, "mask": {"formula": "a + b"}}  # fmt: skip
    numbers = {"a": 0.5, "b": 0.2}
    outer = {"family": "blend", "first": inner, "second": {"family": "film", "substrate": "Si"}, "mask": 1.0}

    def shown(share: float | None) -> Any:
        own = {**inner, "numbers": {"a": 0.1}} if share is None else {**inner, "mask": share}
        return nacre.material({**outer, "numbers": numbers, "first": own}).spectrum([0.0]).specular_reflectance

    np.testing.assert_allclose(shown(None), shown(0.3), atol=1e-12)
    assert np.abs(shown(None) - shown(0.7)).max() > 0.01


def test_a_number_that_the_recipe_lacks_cannot_be_set() -> None:
    made = nacre.material(_film("100*drain", numbers={"drain": 1.0}))
    assert made.vary({"numbers.drain": 2.0}).parameters["numbers.drain"] == 2.0
    with pytest.raises(RecipeError, match=r"numbers\.dran"):
        made.vary({"numbers.dran": 2.0})


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("100*drain + foo(u)", r'formula "100\*drain \+ foo\(u\)": "foo\(u\)" is not allowed'),
        ("100*drain +", r'formula "100\*drain \+" cannot be read'),
        ("log(drain - 2 - u)", r'thickness_nm.formula = "log\(drain - 2 - u\)" has no finite value'),
    ],
)
def test_messages_show_a_formula_as_it_is_written(formula: str, words: str) -> None:
    with pytest.raises(RecipeError, match=words) as caught:
        nacre.material(_film(formula, numbers={"drain": 1.0}))
    assert "1.0" not in str(caught.value)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"u": 1.0}, "numbers.u cannot be a name"),
        ({"two words": 1.0}, "cannot be a name"),
        ({"a": "x"}, 'numbers.a = "x" should be a number'),
        ({"a": True}, "should be a number"),
        ({"a": float("nan")}, "should be a number"),
        (3, "should be a table"),
    ],
)
def test_bad_numbers_get_one_line(numbers: Any, words: str) -> None:
    with pytest.raises(RecipeError, match=words):
        nacre.material(_film("100", numbers=numbers))


@pytest.mark.parametrize(("formula", "words"), [("9 + sqrt(u - 0.25)", "25 %"), ("9 + sin(9*u)/u", "")])
def test_a_formula_without_a_value_in_places_is_reported(
    formula: str, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Its lowest value stands there; a quotient 0/0 at a point or along a line is undefined."""
    nacre.material(_film(formula)).bsdf()
    assert [record.getMessage().count(words) for record in caplog.records] == ([1] if words else [])


def test_an_unknown_name_says_what_is_known() -> None:
    with pytest.raises(RecipeError, match=r'"drian" is not allowed; use u, v, x, y, z, t, .* names of \[numbers\]'):
        nacre.material(_film("100*drian", numbers={"drain": 1.0}))


def test_time_is_found_as_a_word() -> None:
    assert uses_time(_film("100 + t*u")) and not uses_time(_film("100 + tan(u)"))
    assert not uses_time({"title": "t", "layers": [{"formula": "u"}]})


def test_formulas_that_differ_in_numbers_share_a_kernel() -> None:
    first, one = parse_formula("2*u^2 + 3.5").with_holes()
    second, two = parse_formula("7*u^2 - -1").with_holes()
    third, _ = parse_formula("2*u^3 + 3.5").with_holes()
    assert first == parse_formula("9*u^2 + 1").with_holes()[0] and first != second and first != third
    assert list(one.values()) == [2.0, 3.5] and list(two.values()) == [7.0, 1.0]
    u = np.linspace(0, 1, 5)
    np.testing.assert_allclose(first(u, 0 * u, None, one), 2 * u**2 + 3.5)


@pytest.mark.render
def test_the_picture_follows_the_number_without_a_new_scene() -> None:
    """The same picture as of a recipe with the value written out; the same as before when it goes back."""
    options: dict[str, Any] = {"size": (24, 24), "spp": 4, "exposure": 0.0, "progress": False}
    film = nacre.material(_film(numbers={"drain": 2.0}))
    first = nacre.render(film, **options).xyz
    other = nacre.render(film.vary({"numbers.drain": 0.4}), **options).xyz
    written = nacre.render(nacre.material(_film(FORMULA.replace("drain", "0.4"))), **options).xyz
    assert np.abs(first - other).mean() > 0.01 * first.mean()
    np.testing.assert_allclose(other, written, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(nacre.render(film, **options).xyz, first, rtol=1e-4, atol=1e-6)


@pytest.mark.render
def test_time_runs_in_an_animation(tmp_path: Path) -> None:
    """At the end of "time" the frame is the still of t = 1; a material without t cannot be animated by it."""
    options: dict[str, Any] = {"size": (16, 16), "spp": 4, "exposure": 0.0, "progress": False}
    film = nacre.material(_film("100 + 300*v + 200*t"))
    made = nacre.render.animate(film, "time", tmp_path / "a.gif", frames=2, **options)
    from PIL import Image

    last = np.asarray(Image.open(made.frames[1]).convert("RGB")).astype(int)
    still = nacre.render(film.vary({"numbers.t": 1.0}), **options).srgb8.astype(int)
    assert np.abs(last - still).max() <= 1
    assert np.abs(last - np.asarray(Image.open(made.frames[0]).convert("RGB")).astype(int)).max() > 3
    with pytest.raises(NacreError, match="no formula of the material uses the time t"):
        nacre.render.animate(nacre.material(_film("100")), "time", tmp_path / "b.gif", frames=2, **options)


def test_every_example_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = {example.name for example in examples()}
    assert {"soap", "pearl/bottle1", "metasurface/silver_halo", "relief/star"} <= names and "gallery" not in names
    for example in examples():
        assert find_example(example.name) == example.path
        assert example.about and example.family
    assert nacre.load("bottle1").fingerprint == nacre.load(examples_folder() / "pearl" / "bottle1.toml").fingerprint


def test_a_target_goes_by_its_name_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.material.examples import resolve_recipe_path

    monkeypatch.chdir(tmp_path)
    assert resolve_recipe_path("magenta-to-green") == examples_folder() / "targets" / "magenta-to-green.toml"
    (tmp_path / "magenta-to-green").write_text("mine")
    assert resolve_recipe_path("magenta-to-green") == Path("magenta-to-green")


def test_all_files_of_the_examples_are_in_the_wheel() -> None:
    """The wheel takes them folder by folder, so that a new one has to be named."""
    import tomllib

    root = Path(__file__).resolve().parents[2]
    patterns = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    shipped = {path for globs in patterns.values() for pattern in globs for path in root.glob(pattern)}
    there = {path for path in (root / "examples").rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert {path.name for path in there - shipped} <= {"feather.py", "foils.py", "mosaic.py", "photograph.py"}


def test_a_file_of_ones_own_comes_before_an_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "soap").write_text('family = "film"\nsubstrate = "Si"\n')
    assert nacre.load("soap").data["substrate"] == "Si"


@pytest.mark.parametrize("name", ["../soap", "*", "soap\0", "gallery", "", "/soap", "targets"])
def test_odd_names_are_no_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_example(name) is None
    with pytest.raises(NacreError):
        nacre.load(name)


@pytest.mark.parametrize("name, meant", [("bragg-miror", "bragg-mirror"), ("pearl/botle3", "pearl/bottle3")])
def test_a_misspelt_example_is_guessed(name: str, meant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NacreError, match=f'{name}: does not exist.* Did you mean "{meant}"'):
        nacre.load(name)


def test_a_recipe_of_ones_own_is_guessed_before_an_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "titanium.toml").write_text('family = "film"\nsubstrate = "Ti"\n')
    with pytest.raises(NacreError, match=r'titanium: does not exist.* Did you mean "titanium.toml"'):
        nacre.load("titanium")


def test_examples_are_listed_and_copied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["examples", "film", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {"soap", "gold"} <= {entry["name"] for entry in listed}
    assert run(["examples", "blend", "relief/star", "-o", str(tmp_path / "mine")]) == 0
    written = {path.relative_to(tmp_path / "mine").as_posix() for path in (tmp_path / "mine").rglob("*.*")}
    assert written == {"blend.toml", "gold.toml", "blue-oxide.toml", "relief/star.toml", "relief/star-height.npy"}
    nacre.load(tmp_path / "mine" / "relief" / "star.toml")
    # the second run finds them there; a changed file is not overwritten
    assert run(["examples", "blend", "-o", str(tmp_path / "mine")]) == 0
    (tmp_path / "mine" / "gold.toml").write_text("mine")
    assert run(["examples", "blend", "-o", str(tmp_path / "mine")]) == 2
    assert (tmp_path / "mine" / "gold.toml").read_text() == "mine"
    assert run(["examples", "sopa", "-o", str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


def test_an_example_that_the_disk_has_no_room_for_leaves_no_half_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A partial copy would block the next one, as an existing file with other content."""

    def full(source: Path, target: Path) -> None:
        Path(target).write_bytes(b"half")
        raise OSError(28, "No space left on device", str(source))

    monkeypatch.setattr("nacre.material.examples.shutil.copyfile", full)
    with pytest.raises(NacreError, match=r"mine/soap.toml: cannot be written: No space left"):
        copy_examples(["soap"], tmp_path / "mine")
    assert not list((tmp_path / "mine").iterdir())
