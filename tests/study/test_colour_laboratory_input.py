"""Wrong input of the colour laboratory ends with one line and status 2; nothing is written."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nacre.cli import run
from nacre.recipe.toml import dump_toml

FIRST, SECOND = "layers[0].thickness_nm", "layers[1].thickness_nm"
FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 100}, {"material": "TiO2", "thickness_nm": 50}],
}
FLAKE = {"coatings": [{"material": "Al", "thickness_nm": 60}], "normal_deviation": 0.12}
SILVER = {"name": "silver", "volume_fraction": [0, 0.03], "cost_per_kg": 45, "density_kg_l": 2.6, "platelet": FLAKE}
PAINT: dict[str, Any] = {
    "library": {"pigment": [SILVER]},
    "recipe": {"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]},
    "target": [{"geometry": "45as15", "lab": [60, 0, 0]}, {"geometry": "45as110", "lab": [20, 0, 0]}],
}
LIST: dict[str, Any] = {
    "recipe": FILM,
    "parameters": {FIRST: [20, 300]},
    "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}],
    "search": {"seconds": 1},
}
CGATS = "CGATS.17\nBEGIN_DATA_FORMAT\nSAMPLE_ID {}\nEND_DATA_FORMAT\nNUMBER_OF_SETS 1\nBEGIN_DATA\n1 {}\nEND_DATA\n"
CXF = '<cc:CxF xmlns:cc="http://colorexchangeformat.com/CxF3-core"><cc:Resources><cc:ObjectCollection/></cc:Resources></cc:CxF>'
NEGATIVE = "wavelength_nm,a\n" + "".join(f"{nm},-0.5\n" for nm in range(380, 790, 10))


def pigment(**changes: Any) -> dict[str, Any]:
    return {"library": {"pigment": [SILVER | changes]}}


@pytest.mark.parametrize(
    ("key", "options", "changes"),
    [
        ("geometry", ("report",), {"geometry": [{"name": "a", "at": "45as15"}, {"name": "a", "at": "45as25"}]}),
        ("geometry", ("report",), {"geometry": [{"name": "a", "at": "45as170"}]}),
        ("geometry", ("report",), {"geometry": [{"name": "45as15", "at": "45as25"}]}),
        ("geometry", ("report",), {"geometry": [{"name": "a", "at": "45asnan"}]}),
        ("formula", ("report", "RECIPE", "--formula", "cmc(0:1)"), {}),
        ("formula", ("report", "RECIPE", "--formula", "din6175-2"), {}),
        ("45as99", ("report", "RECIPE", "--tolerance", "45as99=1"), {}),
        ("matrix", ("tolerance",), {"tolerance": {FIRST: 2, SECOND: 2},
                                    "correlation": [{"of": [FIRST, SECOND], "matrix": [[1, 1.8], [1.8, 1]]}]}),
        ("door", ("tolerance", "--geometry", "door"), {"tolerance": {FIRST: 2}}),
        ("limit", ("tolerance", "--limit", "inf"), {"tolerance": {FIRST: 2}}),
        ("door", ("diagnose", "--lab", "door=50,0,0"), {"tolerance": {FIRST: 2}}),
        ("texture", ("diagnose", "--texture", "sparkle_45=1"), {"tolerance": {FIRST: 2}}),
        ("wavelength", ("runsheet", "--wavelength-nm", "nan"), {}),
    ],
)  # fmt: skip
def test_a_wrong_recipe_or_option_is_refused_in_one_line(
    key: str, options: tuple[str, ...], changes: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "film.toml"
    path.write_text(dump_toml(FILM | changes))
    command, *more = options
    assert run([command, str(path), *(str(path) if word == "RECIPE" else word for word in more)]) == 2
    message = capsys.readouterr().err.strip()
    assert key in message and "\n" not in message


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        ("txt", CGATS.format("LAB_L LAB_A LAB_B", "5000 0 0")),
        ("txt", CGATS.format("LAB_L LAB_C LAB_H", "50 -20 10")),
        ("csv", "name,L,C,h\nleaf,50,-20,10\n"),
        ("csv", NEGATIVE),
        ("cxf", CXF),
        ("ase", b"ASEF\x00\x01\x00\x00\x00\x00\x00\x05\x00\x01"),
    ],
)
def test_a_wrong_colour_list_is_refused_in_one_line(
    suffix: str, content: str | bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target, colours, out = tmp_path / "target.toml", tmp_path / f"list.{suffix}", tmp_path / "out"
    target.write_text(dump_toml(LIST))
    colours.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert run(["design", str(target), "--many", str(colours), "-o", str(out)]) == 2
    message = capfd.readouterr().err.strip()
    assert colours.name in message and "\n" not in message
    assert not out.exists()


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("cost_per_kg", pigment(cost_per_kg=-3)),
        ("cost_per_kg", pigment(cost_per_kg=float("nan"))),
        ("volume_fraction", pigment(volume_fraction=[0.03, 0.01])),
        ("silver", {"library": {"pigment": [SILVER, SILVER]}}),
        ("45as15", {"target": [PAINT["target"][0], PAINT["target"][0] | {"lab": [90, 0, 0]}]}),
    ],
)
def test_a_wrong_library_or_target_is_refused_before_any_search(
    key: str, changes: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad, out = tmp_path / "good.toml", tmp_path / "bad.toml", tmp_path / "out"
    good.write_text(dump_toml(PAINT))
    bad.write_text(dump_toml(copy.deepcopy(PAINT) | changes))
    assert run(["formulate", str(good), str(bad), "-o", str(out)]) == 2  # the good one is not searched either
    message = capsys.readouterr().err.strip()
    assert key in message and "bad.toml" in message and "\n" not in message
    assert not out.exists()


def test_two_targets_of_one_name_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "good.toml"
    path.write_text(dump_toml(PAINT))
    assert run(["formulate", str(path), str(path), "-o", str(tmp_path / "out")]) == 2
    assert "good" in capsys.readouterr().err


def test_several_targets_have_a_folder_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nacre.optimise import formulation

    seen: list[Any] = []
    search: Callable[..., Any] = formulation.formulate

    def counted(task: Any, *more: Any) -> Any:
        seen.append(task)
        return search(task, *more)

    monkeypatch.setattr(formulation, "formulate", counted)
    for name, light in (("door", 60), ("roof", 40)):
        rows = [PAINT["target"][0] | {"lab": [light, 0, 0]}, PAINT["target"][1]]
        (tmp_path / f"{name}.toml").write_text(dump_toml(PAINT | {"target": rows, "search": {"solutions": 1}}))
    names = [str(tmp_path / f"{name}.toml") for name in ("door", "roof")]
    assert run(["formulate", *names, "-o", str(tmp_path / "out"), "--json"]) == 0
    assert len(seen) == 2
    for name in ("door", "roof"):
        assert (tmp_path / "out" / name / "recipe.toml").exists()


def test_a_report_compares_several_recipes_with_the_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for number in range(3):
        layers = [FILM["layers"][0] | {"thickness_nm": 100 + number}, FILM["layers"][1]]
        paths.append(tmp_path / f"film{number}.toml")
        paths[-1].write_text(dump_toml(FILM | {"layers": layers}))
    assert run(["report", *map(str, paths)]) == 0
    text = capsys.readouterr().out
    assert "film1 to film0" in text and "film2 to film0" in text
