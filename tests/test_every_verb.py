"""Every verb says the same through Python and through the command, for one small material of every family.

Either both answer, with the same numbers, pixels or bytes, or both refuse, in the same line.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.cli import run
from nacre.cli.design import TARGETS
from nacre.core.errors import NacreError
from nacre.families.contract import Model
from nacre.families.registry import FAMILIES, family_names, family_spec
from nacre.formats.bsdf_tables import EXPORTS
from nacre.recipe.toml import dump_toml

TWO_NM = np.array([400.0, 700.0])  # the least that a colour takes
WI = np.array([[0.3, 0.1, 0.9], [0.0, 0.6, 0.8]]) / np.linalg.norm([[0.3, 0.1, 0.9], [0.0, 0.6, 0.8]], axis=1)[:, None]
WO = WI[::-1] * [-1.0, 1.0, 1.0]
SAMPLES = 64  # of a walk
FILM = """family = "film"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 120}]
surface = {roughness = 0.2}
tolerance = {"layers[0].thickness_nm" = 5}
fit = {"layers[0].thickness_nm" = {min = 100, max = 140}}
"""
RECIPES = {
    "film": FILM,
    "pearl": """family = "pearl"
[[strata]]
resin = {n = 1.5}
thickness_um = 50
roughness = 0.2
[[strata.platelets]]
volume_fraction = 0.01
substrate = {material = "mica", thickness_nm = 400, deviation_nm = 50}
coatings = [{material = "TiO2", thickness_nm = 60}]
normal_deviation = 0.3
[tolerance]
"strata[0].thickness_um" = 5
[fit]
"strata[0].thickness_um" = {min = 40, max = 60}
""",
    "metasurface": """family = "metasurface"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 100}]
[particle]
material = {n = 2.0}
radius_nm = 60
[monolayer]
coverage = 0.05
[model]
multipole_order = 2
[tolerance]
"particle.radius_nm" = 1
[fit]
"particle.radius_nm" = {min = 55, max = 65}
""",
    "relief": """family = "relief"
heights = "heights.npy"
feature_um = 1.0
blur_um = 0.4
coating = "Al"
[coherence]
sigma = 1.5
[tolerance]
blur_um = 0.05
[fit]
blur_um = {min = 0.3, max = 0.5}
""",
    "grating": """family = "grating"
substrate = "Al"
profile = {shape = "sinusoidal", depth_nm = 60}
lattice = {period_nm = 500}
wavelengths = {min_nm = 400, max_nm = 700, step_nm = 300}
[tolerance]
"profile.depth_nm" = 2
[fit]
"profile.depth_nm" = {min = 50, max = 70}
""",
    "measured": """family = "measured"
file = "measured.nacre"
scale = 1.0
[tolerance]
scale = 0.05
[fit]
scale = {min = 0.5, max = 2}
""",
    "blend": """family = "blend"
first = {recipe = "film.toml"}
second = {recipe = "gold.toml"}
mask = 0.25
[tolerance]
mask = 0.05
[fit]
mask = {min = 0.0, max = 0.5}
""",
}
RECIPES |= {name: dump_toml(family_spec(name, "here").example) for name in family_names() if name not in FAMILIES}
# one that a sweep may vary
NUMBERS = {"film": "layers[0].thickness_nm", "pearl": "strata[0].thickness_um", "metasurface": "particle.radius_nm",
           "relief": "blur_um", "grating": "profile.depth_nm", "measured": "scale", "blend": "mask"}  # fmt: skip
DRAWINGS = {  # what the families promise to makers; all else is refused
    "film": {"sheet"},
    "metasurface": {"gds", "oas", "csv", "sheet"},
    "relief": {"png16", "tiff16", "stl", "gds", "oas", "csv"},
}


def families(*slow: str) -> pytest.MarkDecorator:
    """Run a test on every family, on those named in the full suite only."""
    cases = [pytest.param(name, marks=pytest.mark.full) if name in slow else name for name in RECIPES]
    return pytest.mark.parametrize("both", cases, indirect=True)


@dataclass
class Both:
    """One material, and two folders in which its verbs leave files: one for Python, one for the command."""

    recipe: Path
    python: Path
    command: Path
    capsys: pytest.CaptureFixture[str]

    def ask(self, api: Callable[[], Any], arguments: list[str]) -> tuple[Any, str] | None:
        """Ask both ways; return Python's answer and the command's output, or None if both refuse in the same line."""
        self.capsys.readouterr()
        status = run(arguments)
        out, err = self.capsys.readouterr()
        try:
            answer = api()
        except NacreError as error:
            assert status == 2 and err.strip().splitlines()[-1] == f"nacre: {error}"
            return None
        assert status == 0, err
        return answer, out

    def files(self, api: Callable[[Path], Any], arguments: list[str], name: str) -> list[str] | None:
        """Let both write; compare all files and return their names, or None if both refuse in the same line."""
        if self.ask(lambda: api(self.python / name), [*arguments, "-o", str(self.command / name)]) is None:
            assert list(self.python.iterdir()) == list(self.command.iterdir()) == []
            return None
        names = sorted(p.name for p in self.python.iterdir())
        assert names == sorted(p.name for p in self.command.iterdir()) and name in names
        for each in names:
            assert content(self.python / each) == content(self.command / each), each
        return names


def content(path: Path) -> Any:
    """Return what a file holds, without what legitimately differs between two runs (names, times)."""
    if path.is_dir():
        return {p.relative_to(path).as_posix(): content(p) for p in sorted(path.rglob("*")) if p.is_file()}
    data = path.read_bytes()
    if path.suffix in (".png", ".tif") and b"nacre" not in data[:8]:
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image).tobytes()
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as zipped:
            return {name: zipped.read(name) for name in zipped.namelist() if name.endswith(".npy")}
    if path.suffix in (".gds", ".oas"):  # both hold the time of writing
        import gdstk

        library: Any = (gdstk.read_gds if path.suffix == ".gds" else gdstk.read_oas)(str(path))
        return [(c.name, [p.points.tolist() for p in c.polygons], len(c.references)) for c in library.cells]
    return re.sub(rb'"timestamp": "[^"]*"', b"", data)  # of `brdf-json`: the time of writing


@pytest.fixture
def both(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Both:
    folder = tmp_path / "recipes"
    folder.mkdir()
    for name, text in RECIPES.items():
        (folder / f"{name}.toml").write_text(text)
    (folder / "gold.toml").write_text('family = "film"\nsubstrate = "Au"\n')
    np.save(folder / "heights.npy", np.random.default_rng(1).uniform(0, 0.1, (3, 3)))
    for model in all_models(Model):
        if "wavelengths_nm" in vars(model):
            monkeypatch.setattr(model, "wavelengths_nm", TWO_NM)
    monkeypatch.setattr(Model, "wavelengths_nm", TWO_NM)
    half = np.linspace(0.0, 1.0, 5)
    table = nacre.bsdf.lobes.table.TableLobe(
        TWO_NM, np.full((5, 5, 5, 1), 0.2) + 0.1 * half[:, None, None, None], np.ones((1, 2)), "half"
    )
    nacre.Bsdf((table,)).save(folder / "measured.nacre")
    for side in ("python", "command"):
        (tmp_path / side).mkdir()
    from nacre.analysis.fit import run_fit

    monkeypatch.setitem(run_fit.__kwdefaults__, "scouts", 2)  # the quality of the fit is tested elsewhere
    monkeypatch.chdir(folder)
    return Both(folder / f"{request.param}.toml", tmp_path / "python", tmp_path / "command", capsys)


def all_models(base: type) -> list[type]:
    """Return a class and all that are derived from it, those of all families loaded."""
    for family in family_names():
        family_spec(family, "here")
    return [base, *(model for child in base.__subclasses__() for model in all_models(child))]


@families()
def test_spectrum(both: Both) -> None:
    for polarisation in ("both", "s"):
        arguments = ["spectrum", str(both.recipe), "--angles-deg", "0,40", "--wavelengths-nm", "400,700", "--json",
                     "--polarisation", polarisation]  # fmt: skip
        found = both.ask(lambda p=polarisation: nacre.spectrum(both.recipe, [0, 40], TWO_NM, p), arguments)
        if found is None:
            assert polarisation == "s"
            continue
        document = json.loads(found[1])
        for name, values in found[0].parts().items():
            np.testing.assert_array_equal(document[name], values)


@families()
@pytest.mark.render
def test_evaluate(both: Both) -> None:
    np.savez(both.recipe.parent / "directions.npz", wi=WI, wo=WO)
    arguments = ["evaluate", str(both.recipe), "--directions", "directions.npz", "--samples", str(SAMPLES), "--seed",
                 "3", "--wavelengths-nm", "400,700"]  # fmt: skip
    assert run([*arguments, "-o", str(both.command / "values.npz")]) == 0
    bsdf = nacre.load(both.recipe).bsdf(TWO_NM)
    with np.load(both.command / "values.npz") as seen:
        np.testing.assert_array_equal(seen["f"], nacre.evaluate(bsdf, WI, WO, samples=SAMPLES, seed=3))


@families("metasurface", "relief", "grating")
@pytest.mark.render
@pytest.mark.parametrize("kind", ["spectrum", "structure", "field"])
def test_plot(both: Both, kind: str) -> None:
    material = nacre.load(both.recipe)
    names = both.files(
        lambda path: nacre.plot(material, kind, path), ["plot", str(both.recipe), "--kind", kind], "x.png"
    )
    assert names == ["x.png"] if kind == "spectrum" or kind in material.model.figures else names is None


@families()
def test_compile(both: Both) -> None:
    arguments = ["compile", str(both.recipe)]
    assert both.files(lambda path: nacre.load(both.recipe).bsdf().save(path), arguments, "x.nacre") == ["x.nacre"]


@families("metasurface", "relief", "grating")
@pytest.mark.render
def test_render(both: Both) -> None:
    arguments = ["render", str(both.recipe), "--size", "12x10", "--spp", "2", "--seed", "5"]
    names = both.files(
        lambda path: nacre.render(nacre.load(both.recipe), size="12x10", spp=2, seed=5, output=path), arguments, "x.png"
    )
    assert names == ["x.png"]


@families("pearl", "metasurface", "relief", "grating")
@pytest.mark.render
def test_report(both: Both) -> None:
    arguments = ["report", str(both.recipe), "--samples", str(SAMPLES), "--json"]
    answer, out = both.ask(lambda: nacre.report(both.recipe, samples=SAMPLES), arguments) or (None, "")
    assert answer is not None
    document = json.loads(out)
    document = document["reports"][0] if "reports" in document else document
    np.testing.assert_allclose(
        [row["lab"] for row in document["aspecular"]["rows"]] if "rows" in document["aspecular"]
        else document["aspecular"]["lab"],
        answer.aspecular.lab, rtol=1e-12,
    )  # fmt: skip


@families("pearl", "metasurface", "relief", "grating")
@pytest.mark.render
def test_tolerance(both: Both) -> None:
    arguments = ["tolerance", str(both.recipe), "--draws", "3", "--seed", "2", "--samples", str(SAMPLES), "--json"]
    found = both.ask(lambda: nacre.tolerance(both.recipe, draws=3, seed=2, samples=SAMPLES), arguments)
    assert found is not None
    assert json.loads(found[1])["yield"] == pytest.approx(found[0].yield_share, abs=1e-12)


@families("pearl", "metasurface", "relief", "blend", "grating")
@pytest.mark.render
def test_fit(both: Both) -> None:
    # of a relief near what it sends out, where the fit ends after few of its expensive trials
    seen = (0.923, 0.897) if both.recipe.stem == "relief" else (0.2, 0.3)
    rows = "".join(f"{w:g},0,{v}\n" for w, v in zip((400, 700), seen, strict=True))
    column = "specular_reflectance" if both.recipe.stem in ("film", "metasurface", "blend") else "diffuse_reflectance"
    (both.recipe.parent / "seen.csv").write_text(f"wavelength_nm,angle_deg,{column}\n{rows}")
    arguments = ["fit", "seen.csv", str(both.recipe), "--starts", "1", "--samples", str(SAMPLES), "--intervals",
                 "linear", "--json", "-o", str(both.command / "fitted.toml")]  # fmt: skip
    found = both.ask(
        lambda: nacre.fit("seen.csv", both.recipe, starts=1, samples=SAMPLES, intervals="linear"), arguments
    )
    assert found is not None
    values = [number["value"] for number in json.loads(found[1])["numbers"]]
    assert values == [number.value for number in found[0].numbers]
    fitted = nacre.load(both.command / "fitted.toml") if both.recipe.stem in ("film", "pearl", "metasurface") else None
    if fitted is not None:
        assert [fitted.get(number.path) for number in found[0].numbers] == values


@families("pearl", "metasurface", "relief", "grating")
@pytest.mark.render
def test_sweep(both: Both) -> None:
    numbers = nacre.load(both.recipe).parameters
    path = NUMBERS.get(both.recipe.stem, next(iter(numbers)))
    value = numbers[path]
    (both.recipe.parent / "plan.toml").write_text(
        f'recipe = "{both.recipe.name}"\n[axes]\n"{path}" = [{value}, {0.9 * value}]\n'
        "[measure]\nangles_deg = [0]\nwavelengths_nm = [400, 700]\n"
    )
    arguments = ["sweep", "plan.toml", "--jobs", "1", "-o", str(both.command / "x.zarr")]
    assert run(arguments) == 0
    nacre.sweep("plan.toml", both.python / "x.zarr", jobs=1)
    assert content(both.python / "x.zarr") == content(both.command / "x.zarr")


@families("film", "pearl", "metasurface", "relief", "blend", "grating")
# folders: tests/exchange/test_lut_files.py, test_three.py
@pytest.mark.parametrize("to", sorted(set(EXPORTS) - {"lut", "three"}))
@pytest.mark.render
def test_export(both: Both, to: str, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    # a material is solved once for all formats, as within a test for both ways: a grating takes seconds
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path_factory.getbasetemp() / "solved"))
    name = f"x{EXPORTS[to]}"
    both.files(lambda path: nacre.export(both.recipe, to, path, angle_step_deg=30.0),
               ["export", str(both.recipe), "--to", to, "--angle-step-deg", "30"], name)  # fmt: skip


@families()
@pytest.mark.parametrize("to", TARGETS)
def test_fabricate(both: Both, to: str) -> None:
    from nacre.formats import fabrication, number_maps

    suffix = {**number_maps.SUFFIXES, **fabrication.SUFFIXES}[to]
    family = both.recipe.stem
    if family == "metasurface" and to in ("gds", "oas", "csv"):
        size = {"size_mm": (0.005, 0.005)}, ["--size-mm", "0.005x0.005"]
    else:
        size = {}, []
    names = both.files(lambda path: nacre.fabricate(both.recipe, to, path, **size[0]),
                       ["fabricate", str(both.recipe), "--to", to, *size[1]], f"x{suffix}")  # fmt: skip
    assert (names is not None) == (to in DRAWINGS.get(family, set()))


@families("pearl", "metasurface", "relief", "blend", "grating")
@pytest.mark.render
def test_gamut(both: Both) -> None:
    number = NUMBERS.get(both.recipe.stem) or next(iter(nacre.load(both.recipe).parameters))
    value = nacre.load(both.recipe).get(number)
    free = f"{number}={0.9 * value}:{1.1 * value}"
    arguments = ["gamut", str(both.recipe), "--parameter", free, "--points", "8", "--samples", str(SAMPLES), "--json"]
    found = both.ask(lambda: nacre.gamut(both.recipe, [free], points=8, samples=SAMPLES), arguments)
    if found is not None:
        assert json.loads(found[1]) == json.loads(json.dumps(found[0].document()))


@families("pearl", "metasurface", "relief", "blend", "grating")
@pytest.mark.render
def test_design(both: Both) -> None:
    """A budget of evaluations gives the same solution by Python and by command."""
    number = NUMBERS.get(both.recipe.stem) or next(iter(nacre.load(both.recipe).parameters))
    value = nacre.load(both.recipe).get(number)
    (both.recipe.parent / "asked.toml").write_text(
        f'recipe = "{both.recipe.name}"\n[parameters]\n"{number}" = [{0.9 * value}, {1.1 * value}]\n'
        '[[target]]\ngeometry = "hemispherical 0"\nlightness = "<=100"\n'
        "[search]\nevaluations = 4\nseconds = 300\nsolutions = 1\n"
    )
    found = both.ask(
        lambda: nacre.design("asked.toml", both.python / "x"),
        ["design", "asked.toml", "--json", "-o", str(both.command / "x")],
    )
    assert found is not None
    document = json.loads(found[1])
    assert document["solutions"][0]["changes"] == found[0].best.changes
    names = ("recipe.toml", "design.json", "report.html", "report.png", "search.json")
    assert all((side / "x" / name).is_file() for side in (both.python, both.command) for name in names)
    nacre.load(both.command / "x")
