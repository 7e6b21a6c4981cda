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
