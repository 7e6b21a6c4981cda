"""`nacre fabricate --to sheet`: the table a coater works from."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from nacre.cli import run

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_the_sheet_of_a_bragg_mirror_lists_quarter_waves(tmp_path: Path) -> None:
    path = tmp_path / "mirror.csv"
    assert run(["fabricate", str(EXAMPLES / "bragg-mirror.toml"), "--to", "sheet", "-o", str(path)]) == 0
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    assert rows[0]["position"] == "ambient" and rows[-1]["position"] == "substrate"
    layers = rows[1:-1]
    assert len(layers) >= 20
    for row in layers:
        optical = float(row["n_550nm"]) * float(row["thickness_nm"])
        assert float(row["optical_thickness_nm"]) == pytest.approx(optical, rel=1e-4)
        assert float(row["quarter_waves"]) == pytest.approx(4 * optical / 550, rel=1e-4)


def test_a_varying_thickness_gives_its_ends(tmp_path: Path) -> None:
    recipe = tmp_path / "wedge.toml"
    layers = 'layers = [{material = "TiO2-film", thickness_nm = {formula = "20+200*u"}}]'
    recipe.write_text(f'family = "film"\nsubstrate = "Ti"\n{layers}\n')
    path = tmp_path / "wedge.csv"
    assert run(["fabricate", str(recipe), "--to", "sheet", "-o", str(path)]) == 0
    row = list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))[1]
    assert (float(row["thickness_min_nm"]), float(row["thickness_max_nm"])) == (20.0, 220.0)


def test_a_relief_has_no_layer_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = EXAMPLES / "relief" / "star.toml"
    assert run(["fabricate", str(source), "--to", "sheet", "-o", str(tmp_path / "x.csv")]) == 2
    assert "--to sheet is not known for a relief" in capsys.readouterr().err


def test_a_sheet_of_a_design_is_called_after_its_folder(tmp_path: Path) -> None:
    (tmp_path / "stamp").mkdir()
    (tmp_path / "stamp" / "recipe.toml").write_text(
        'family = "film"\nsubstrate = "Al"\nlayers = [{material = "MgF2", thickness_nm = 400}]\n'
    )
    assert run(["fabricate", str(tmp_path / "stamp"), "--to", "sheet", "-o", str(tmp_path / "s.csv")]) == 0
    assert (tmp_path / "s.csv").read_text().startswith("# layer sheet of stamp, nacre ")
