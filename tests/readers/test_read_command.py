"""`nacre read` and `nacre.read`: descriptions, tidy files, and files that are refused."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError
from nacre.readers.registry import FORMATS

TEXT = "wavelength (nm),white %R,dark %R\n" + "".join(f"{nm},90.5,0.{nm // 100}\n" for nm in range(400, 701, 10))


@pytest.fixture
def card(tmp_path: Path) -> Path:
    path = tmp_path / "card.txt"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_the_description_is_json(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["read", str(card), "--json", "--show", "2"]) == 0
    white, dark = json.loads(capsys.readouterr().out)
    assert white["kind"] == "spectrum" and white["points"] == 31
    assert white["quantities"]["reflectance"]["max"] == pytest.approx(0.905)
    assert (
        white["quantities"]["wavelength_nm"] | {"first": 400.0, "last": 700.0, "unit": "nm"}
        == white["quantities"]["wavelength_nm"]
    )
    assert dark["rows"][1] == {"wavelength_nm": 410.0, "reflectance": 0.004}


def test_tidy_files_hold_all_data(card: Path, tmp_path: Path) -> None:
    assert run(["read", str(card), "-o", str(tmp_path / "t.csv")]) == 0
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 62 and set(rows[0]) == {"sample", "wavelength_nm", "reflectance"}
    assert run(["read", str(card), "-o", str(tmp_path / "t.npz")]) == 0
    with np.load(tmp_path / "t.npz") as arrays:
        np.testing.assert_allclose(arrays["white %R/reflectance"], 0.905)
    assert run(["read", str(card), "-o", str(tmp_path / "t.doc")]) == 2


def test_a_tidy_file_is_read_back(card: Path, tmp_path: Path) -> None:
    assert run(["read", str(card), "--spectrum", "white %R", "-o", str(tmp_path / "t.csv")]) == 0
    again = nacre.read(tmp_path / "t.csv")
    assert isinstance(again, nacre.Measurement)
    np.testing.assert_allclose(again.data["reflectance"], 0.905)


def test_a_figure_is_drawn(card: Path, tmp_path: Path) -> None:
    assert run(["read", str(card), "--plot", str(tmp_path / "f.png")]) == 0
    assert (tmp_path / "f.png").stat().st_size > 1000


def test_the_formats_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["read", "--formats"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == [entry.id for entry in FORMATS]
    assert len(set(listed)) == len(listed)


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "missing", "empty", "image", "prose"])
def test_what_is_no_measurement_is_refused_in_one_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.txt"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/null")
    elif kind != "missing":
        path.write_bytes(
            {"empty": b" \n", "image": b"\x89PNG\r\n\x1a\n1234", "prose": b"Lorem ipsum\ndolor sit\n"}[kind]
        )
    assert run(["read", str(path)]) == 2
    reported = capsys.readouterr().err
    assert reported.count("\n") == 1 and str(path) in reported


def test_an_open_property_is_refused_with_its_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.csv"
    path.write_text("".join(f"{nm},2.0\n" for nm in range(400, 701, 10)), encoding="utf-8")
    assert run(["read", str(path)]) == 2
    assert "--quantity" in capsys.readouterr().err
    with pytest.raises(AmbiguousFileError) as error:
        nacre.read(path)
    assert error.value.option == "quantity" and "absorbance" in error.value.choices
    assert run(["read", str(path), "--quantity", "absorbance"]) == 0
    assert "absorbance" in nacre.read(path, quantity="absorbance").data  # type: ignore[union-attr]  # one spectrum


@pytest.mark.parametrize("options", [{"colour": 1}, {"format": "no-format"}, {"unit": "kg"}, {"quantity": "joy"}])
def test_unknown_options_are_refused(card: Path, options: dict[str, object]) -> None:
    with pytest.raises(NacreError):
        nacre.read(card, **options)


WHITE = "".join(f"{nm},0.45\n" for nm in range(400, 701, 10))
ENERGIES = "".join(f"{ev},0.45\n" for ev in (1.8, 2.0, 2.5, 3.0))
CONTRADICTIONS = {
    "a transmittance under R": (
        "wavelength (nm),R\n" + WHITE,
        {"quantity": "transmittance"},
    ),
    "a polarised one": ("wavelength (nm),Rs\n" + WHITE, {"quantity": "transmittance"}),
    "one below a key": ("#YUNITS=REFLECTANCE\n" + WHITE, {"quantity": "absorbance"}),
    "factors under per cent": ("wavelength (nm),R (%)\n" + WHITE, {"quantity": "reflectance (1)"}),
    "micrometres under nm": ("wavelength (nm),R\n" + WHITE, {"unit": "um"}),
    "energies under nm": ("wavelength (nm),Rp\n" + WHITE, {"unit": "eV"}),
    "nanometres under eV": ("energy (eV),R\n" + ENERGIES, {"unit": "nm"}),
    "constants in other units": ("wavelength (nm),n\n" + WHITE, {"unit": "um"}),
    "a reflectance among constants": ("wavelength (nm),n\n" + WHITE, {"quantity": "reflectance"}),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_an_option_that_contradicts_the_file_is_refused(name: str, tmp_path: Path) -> None:
    text, options = CONTRADICTIONS[name]
    path = tmp_path / "x.csv"
    path.write_text(text, encoding="utf-8")
    nacre.read(path)
    with pytest.raises(NacreError):
        nacre.read(path, **options)


def test_a_quantity_without_a_scale_keeps_the_per_cent_of_the_heading(card: Path) -> None:
    """Dark values below 1 under "%R" are per cent, whether or not the quantity is given too."""
    dark = nacre.read(card, spectrum="dark %R", quantity="reflectance")
    assert isinstance(dark, nacre.Measurement)
    np.testing.assert_allclose(dark.data["reflectance"].max(), 0.007)


def test_a_unit_may_replace_an_impossible_one(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("wavelength (um),R\n" + WHITE, encoding="utf-8")
    with pytest.raises(AmbiguousFileError):
        nacre.read(path)
    found = nacre.read(path, unit="nm")
    assert isinstance(found, nacre.Measurement) and found.data["wavelength_nm"][-1] == 700.0


@pytest.mark.parametrize("heading", ["R (60°)", "R"])
def test_an_angle_beside_another_one_in_the_file_is_stated(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    above = "# AOI = 60 deg\n" if heading == "R" else ""
    path.write_text(f"{above}wavelength (nm),{heading}\n" + WHITE, encoding="utf-8")
    with_other, alone = nacre.read(path, angle_deg=45.0), nacre.read(path)
    assert isinstance(with_other, nacre.Measurement) and isinstance(alone, nacre.Measurement)
    assert len(with_other.assumed) == len(alone.assumed) + (heading != "R")
    assert any("45" in said and "60" in said for said in with_other.assumed)
