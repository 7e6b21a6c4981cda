"""Target files: meaning of all keys, and one-line errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import colour
import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, lab_to_lch, lch_to_lab, white_xyz, xyz_to_lab
from nacre.measure.geometry import Geometry
from nacre.optimise.evaluation import nearest_in_ranges
from nacre.optimise.measurement import simulate_measurement
from nacre.optimise.spec import LightSpec, TargetEntry
from nacre.optimise.targets import read_targets, srgb_to_lab
from nacre.optimise.task import read_task
from nacre.recipe.model import RecipeContext

FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 120}, {"material": "TiO2", "thickness_nm": 40}],
}
FLAKE = {"volume_fraction": 0.01, "substrate": {"material": "mica", "thickness_nm": 400}}
PEARL = {"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 20, "platelets": [FLAKE]}]}
ONE = {"geometry": "specular 0", "colour": "#777777"}
# nacre's white is that of the sRGB matrix, colour-science's that of the four digits of xy: 2e-2 in a blue
SRGB_WHITE = 0.05


def task(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {"recipe": FILM, "parameters": {"layers[0].thickness_nm": [50, 300]}, "target": [ONE]}
    return {key: value for key, value in (base | changes).items() if value is not None}


def test_srgb_is_read_by_d65_and_the_2_degree_observer() -> None:
    for text in ("#c2185b", "#0000ff", "#08f", "#ffffff", "#010203"):
        digits = text[1:] if len(text) == 7 else "".join(2 * d for d in text[1:])
        rgb = np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)]) / 255
        white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
        expected = colour.XYZ_to_Lab(colour.sRGB_to_XYZ(rgb), white)
        np.testing.assert_allclose(srgb_to_lab(text, "here"), expected, atol=SRGB_WHITE)


def test_all_forms_of_a_colour_agree() -> None:
    lab = np.array([60.0, 20.0, -30.0])
    white = white_xyz("D65", "10deg")
    xyz = nacre.light.lab_to_xyz(lab, white)
    forms = [
        {"lab": lab.tolist()},
        {"lch": lab_to_lch(lab).tolist()},
        {"xyz": xyz.tolist()},
        {"xyy": nacre.light.xyz_to_xyy(xyz).tolist()},
    ]
    for form in forms:
        want = read_task(task(target=[{"geometry": "specular 0", **form}])).targets[0]
        np.testing.assert_allclose(want.target_lab(white), lab, atol=1e-9)


def test_xyz_applies_to_the_first_lamp_and_lab_to_all() -> None:
    from nacre.optimise.evaluation import evaluate

    light = {"illuminants": ["D65", "A"]}
    for form, count in (({"xyz": [0.2, 0.2, 0.2]}, 1), ({"lab": [50, 0, 0]}, 2), ({"chroma": "<=5"}, 2)):
        read = read_task(task(target=[{"geometry": "specular 0", **form}], light=light))
        found, _ = evaluate(read.material, read.targets, read.spec.light)
        assert [r.lamp for r in found] == ["D65", "A"][:count]


def test_geometries_mean_what_spectrum_and_report_say() -> None:
    rough = nacre.material({**FILM, "surface": {"roughness": 0.3}})
    grid = rough.bsdf().wavelengths_nm
    ats = [Geometry.read(text, "x") for text in ("specular 30", "45as15", "45as-15", "45as110")]
    seen = simulate_measurement(rough, ats, grid)
    np.testing.assert_array_equal(seen.factors[0], rough.spectrum(np.radians([30.0]), grid).specular_reflectance[0])
    report = nacre.report(rough)
    table = dict(zip(report.aspecular.angles_deg, report.aspecular.lab))
    for row, angle in ((1, 15.0), (2, -15.0), (3, 110.0)):
        xyz = seen.factors[row] @ nacre.light.smooth_weights(grid, "D65", "10deg")
        lab = xyz_to_lab(xyz, white_xyz("D65", "10deg"))
        np.testing.assert_allclose(lab, table[angle], atol=1e-9)


def test_hemispherical_is_specular_and_diffuse_and_transmitted_is_that_of_nacre_spectrum() -> None:
    ground = nacre.material({**FILM, "substrate": "glass", "base": {"albedo": 0.4}})
    ats = [Geometry(kind, 20.0) for kind in ("specular", "diffuse", "hemispherical")]
    mirror, diffuse, both = simulate_measurement(ground, ats).factors
    np.testing.assert_allclose(mirror + diffuse, both, atol=1e-15)
    clear = nacre.material({**FILM, "substrate": "glass"})
    seen = simulate_measurement(clear, [Geometry("transmitted", 20.0)])
    spectrum = clear.spectrum(np.radians([20.0]), seen.wavelengths_nm)
    np.testing.assert_array_equal(seen.factors[0], spectrum.specular_transmittance[0])


@pytest.mark.parametrize(
    "ranges",
    [
        {"hue": (350.0, 10.0)},
        {"hue": (350.0, 10.0), "chroma": (40.0, None)},
        {"chroma": (40.0, None)},
        {"chroma": (None, 10.0), "lightness": (None, 30.0)},
        {"lightness": (70.0, 90.0)},
    ],
)
def test_the_nearest_colour_of_a_range_is_that_of_a_dense_search(
    ranges: dict[str, tuple[float | None, float | None]],
) -> None:
    generator = np.random.default_rng(3)
    for lab in generator.uniform([20, -50, -50], [90, 50, 50], (6, 3)):
        found = nearest_in_ranges(lab, ranges)
        own = lab_to_lch(lab)
        # lightness is independent of the others in dE00, so that only chroma and hue are searched
        low, high = ranges.get("lightness", (own[0], own[0]))
        light = np.clip(own[0], low, high)
        low, high = ranges.get("chroma", (0.0, 120.0))
        chromas = np.linspace(low or 0.0, 120.0 if high is None else high, 241)
        hues = np.linspace(0.0, 360.0, 1441)
        if "hue" in ranges:
            first, last = (float(end or 0.0) for end in ranges["hue"])
            hues = hues[(hues - first) % 360.0 <= (last - first) % 360.0 + 1e-9]
        box = np.stack(np.meshgrid([light], chromas, hues, indexing="ij"), axis=-1)
        least = float(np.min(delta_e_2000(lch_to_lab(box), lab)))
        assert float(delta_e_2000(found, lab)) <= least + 0.1


def test_two_numbers_and_a_table_are_the_same_bounds_and_a_star_is_every_index() -> None:
    plain = read_task(task(parameters={"layers[*].thickness_nm": [50, 300]})).parameters
    table = read_task(task(parameters={"layers[*].thickness_nm": {"min": 50, "max": 300}})).parameters
    assert plain == table and [f.path for f in plain] == ["layers[0].thickness_nm", "layers[1].thickness_nm"]


BAD = {
    "a path that does not exist": (task(parameters={"layers[0].thicknes_nm": [5, 10]}), "thickness_nm"),
    "an index that does not exist": (task(parameters={"layers[7].thickness_nm": [5, 10]}), "layers[7]"),
    "a path that is no number": (task(parameters={"layers[0].material": [5, 10]}), "not a number"),
    "bounds that cross": (task(parameters={"layers[0].thickness_nm": [300, 50]}), "cross"),
    "text for bounds": (task(parameters={"layers[0].thickness_nm": ["a", "b"]}), "two numbers"),
    "one number": (task(parameters={"layers[0].thickness_nm": 5}), "[low, high]"),
    "an unknown choice": (task(parameters={"layers[0].material": {"choices": ["SiO3"]}}), "SiO2"),
    "nothing free": (task(parameters=None), "nothing varies"),
    "a file as a palette's name": (task(parameters=None, layers={"palette": ["own.csv"]}), 'write {file = "own.csv"}'),
    "an unknown palette name": (task(parameters=None, layers={"palette": ["TiO3"]}), 'Did you mean "TiO2"'),
    "an unknown substrate": (task(parameters=None, layers={"palette": ["TiO2"], "substrate": ["Aq"]}), "substrate"),
    "bounds of nothing": (
        task(parameters=None, layers={"palette": ["Cr"], "thickness_nm": {"Cx": [3, 20], "other": [1, 2]}}),
        "Cx",
    ),
    "a material without bounds": (
        task(parameters=None, layers={"palette": ["Cr", "SiO2"], "thickness_nm": {"Cr": [3, 20]}}),
        "SiO2",
    ),
    "crossing bounds of layers": (task(parameters=None, layers={"palette": ["Cr"], "thickness_nm": [20, 3]}), "cross"),
    "free naming a layer beside layers": (task(layers={"palette": ["TiO2"]}), "remove one"),
    "a want that an opaque base cannot answer": (
        task(target=[{**ONE, "geometry": "transmitted 0"}]),
        "is not possible",
    ),
    "diffuse light of a mirror": (task(target=[{**ONE, "geometry": "diffuse 0"}]), "is not possible"),
    "aspecular light of a mirror": (task(target=[{**ONE, "geometry": "45as15"}]), "is not possible"),
    "two colours at one place": (task(target=[ONE, {**ONE, "colour": "#ff0000"}]), "no answer has both"),
    "an unknown geometry": (task(target=[{**ONE, "geometry": "speculr 0"}]), 'Did you mean "specular"'),
    "light from behind": (task(target=[{**ONE, "geometry": "specular 95"}]), "90"),
    "a viewer behind the surface": (task(target=[{**ONE, "geometry": "20as115"}]), "behind"),
    "a colour that is none": (task(target=[{**ONE, "colour": "pinkish"}]), "#rrggbb"),
    "two forms of a colour": (task(target=[{**ONE, "lab": [1, 2, 3]}]), "exactly one"),
    "no colour": (task(target=[{"geometry": "specular 0"}]), "exactly one"),
    "a bound that cannot be read": (task(target=[{"geometry": "specular 0", "chroma": "> 40"}]), ">=40"),
    "a spectrum that is not there": (task(target=[{"geometry": "specular 0", "spectrum": "no.csv"}]), "does not exist"),
    "an unknown lamp": (task(light={"illuminants": ["D66"]}), "D65"),
    "an unknown observer": (task(light={"observer": "3deg"}), "10deg"),
    "spreads without targets": (task(target=None, tolerance={"layers[*].thickness_nm": "2%"}), "target is missing"),
    "a spread of nothing": (task(tolerance={"layers[9].thickness_nm": "2%"}), "layers[9]"),
    "a spread that is none": (task(tolerance={"layers[0].thickness_nm": "much"}), "percentage"),
    "both forms of target": (task(target={"kind": "uniform"}), "write [[target]]"),
    "a recipe that is wrong": (task(recipe={**FILM, "substrat": "Si"}), "Did you mean"),
    "layers of what is no film": (
        task(recipe={"family": "pearl"}, parameters=None, layers={"palette": ["TiO2"]}),
        "only the stack of a film",
    ),
    "a bound that the recipe never allows": (task(parameters={"layers[0].thickness_nm": [-50, 50]}), "= [-50, 50]: "),
    "a bound that the table of a flake never allows": (
        task(
            recipe=PEARL,
            parameters={"strata[0].platelets[0].volume_fraction": [0, 0.5]},
            target=[{**ONE, "geometry": "45as15"}],
        ),
        "= 0.5 is not allowed",
    ),
    "bounds without an end": (task(parameters={"layers[0].thickness_nm": {"min": 3}}), "{min = 3}"),
    "bounds and choices": (task(parameters={"layers[0].thickness_nm": {"min": 3, "choices": [4]}}), "not both"),
    "a chroma without a side": (task(target=[{"geometry": "specular 0", "chroma": 40}]), 'write ">=40"'),
    "the fewest of given layers": (task(limits={"max_layers": "fewest"}), "add [layers]"),
    "a total below the least of given layers": (task(limits={"max_total_nm": 60}), "is 90 nm"),
    "a total of what has no layers": (
        task(
            recipe=PEARL,
            parameters={"base.albedo": [0, 1]},
            target=[{**ONE, "geometry": "45as15"}],
            limits={"max_total_nm": 60},
        ),
        "has no layers",
    ),
    "a chromaticity outside all colours": (
        task(target=[{"geometry": "specular 0", "xyy": [0.3, 0, 0.2]}]),
        "target[0].xyy = [0.3, 0.0, 0.2]",
    ),
    "a total below every layer": (
        task(parameters=None, layers={"palette": ["SiO2"], "thickness_nm": [50, 90]}, limits={"max_total_nm": 20}),
        "no layer",
    ),
    "a spread of an index that does not exist": (task(tolerance={"layers[9].thickness_nm": 3}), "does not exist"),
    "a key that is not known": (task(targets=3), 'Did you mean "target"'),
}


@pytest.mark.parametrize("name", BAD)
def test_errors_are_one_line(name: str) -> None:
    data, word = BAD[name]
    with pytest.raises(NacreError) as caught:
        read_task(data)
    message = str(caught.value)
    assert word in message and "\n" not in message and message.startswith("target: "), message


def test_the_command_ends_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text('recipe = "no.toml"\n[[target]]\ngeometry = "specular 0"\ncolour = "#777777"\n')
    assert run(["design", str(path), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert "no.toml" in err and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "has no targets"),
        (
            'recipe = {family = "film", substrate = "Si", layers = [{material = "SiO2", thickness_nm = 50}]}\n'
            "[parameters]\n"
            '"layers[0].thickness_nm" = [5, 90]\n[[target]]\ngeometry = "specular 0"\nspectrum = "uv.csv"\n',
            "is known from",
        ),
    ],
)
def test_a_refused_target_leaves_no_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, word: str
) -> None:
    (tmp_path / "uv.csv").write_text("nm,R\n150,0.2\n190,0.3\n")
    (tmp_path / "wrong.toml").write_text(text)
    assert run(["design", str(tmp_path / "wrong.toml"), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert "wrong.toml: " in err and word in err and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("heading", "nm", "share"),
    [
        ("nm,R", 1.0, 1.0),
        ("Wavelength (nm),%R", 1.0, 100.0),
        ("wavelength / nm;Reflectance (%)", 1.0, 100.0),
        ("wavelength_um,R [%]", 1e-3, 100.0),
        ("lambda (angstrom)\tR", 10.0, 1.0),
        ("nm,percent", 1.0, 100.0),
    ],
)
def test_the_heading_of_a_spectrum_gives_its_units(tmp_path, heading, nm, share) -> None:
    """0.4 under "R (%)" is 0.4 per cent, not 40; and what an instrument exports in per cent can be wanted as it is."""
    part = next(mark for mark in ";\t," if mark in heading)
    rows = [f"{400 * nm}{part}{0.004 * share}", f"{500 * nm}{part}{0.4 * share}", f"{700 * nm}{part}{0.35 * share}"]
    (tmp_path / "r.csv").write_text("\n".join([heading, *rows]), encoding="utf-8")
    want = TargetEntry(geometry="specular 0", spectrum="r.csv")
    (found,) = read_targets([want], LightSpec(), RecipeContext("t.toml", tmp_path))
    np.testing.assert_allclose(found.spectrum, [[400, 500, 700], [0.004, 0.4, 0.35]], rtol=1e-12)


def spectrum_of(folder: Path, text: str) -> Any:
    (folder / "r.csv").write_text(text, encoding="utf-8")
    want = TargetEntry(geometry="specular 0", spectrum="r.csv")
    return read_targets([want], LightSpec(), RecipeContext("t.toml", folder))[0].spectrum


def test_a_spectrum_may_have_descending_wavelengths(tmp_path: Path) -> None:
    found = spectrum_of(tmp_path, "nm,R\n700,0.3\n500,0.2\n400,0.1\n")
    np.testing.assert_array_equal(found, [[400, 500, 700], [0.1, 0.2, 0.3]])
    with pytest.raises(NacreError, match="ascending or descending"):
        spectrum_of(tmp_path, "nm,R\n700,0.3\n400,0.2\n500,0.1\n")


def test_implausible_wavelengths_are_refused_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match=r'spectrum = "r.csv" holds wavelengths of 0.4 to 0.7.*"um"'):
        spectrum_of(tmp_path, "0.4,0.1\n0.55,0.2\n0.7,0.3\n")


@pytest.mark.parametrize("colour", [{"xyz": [25, 33, 20]}, {"xyy": [0.33, 0.42, 33]}])
def test_a_colour_in_per_cent_is_refused(colour: dict[str, Any]) -> None:
    def read(at: str) -> Any:
        return read_targets([TargetEntry(geometry=at, **colour)], LightSpec(), RecipeContext("t.toml"))

    with pytest.raises(NacreError, match="white has Y = 1, .*divide by 100"):
        read("specular 0")
    assert read("45as15")  # a lobe may be that bright
