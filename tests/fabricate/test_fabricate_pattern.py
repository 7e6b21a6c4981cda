"""A metasurface handed over: its particles as layouts and lists, its layers as a sheet."""

import json
from pathlib import Path

import numpy as np
import pytest
from read_back import read_layout, read_points_csv

from nacre.api import fabricate
from nacre.cli import run
from nacre.core.errors import UnsupportedError
from nacre.families.metasurface.monolayer.arrangement import Pattern, nearest_distances
from nacre.material.material import material

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "metasurface" / "silver_native_oxide.toml"
LAYOUT_STEP_UM = 1.5e-3  # two coordinates rounded to 1 nm


def made(structure="rsa", **particle):
    data = {
        "family": "metasurface",
        "substrate": "Si",
        "layers": [{"material": "SiO2", "thickness_nm": 300}],
        "particle": {"material": "Ag", "radius_nm": 90, **particle},
        "monolayer": {"density_per_um2": 5, "packing": 0.3, "structure": structure},
    }
    return material(data)


@pytest.mark.parametrize("to", ["gds", "oas"])
def test_a_square_centimetre_streams_by_references(tmp_path, to):
    path, beside = fabricate(made(), to, tmp_path / f"a.{to}", size_mm=(10.0, 10.0))
    facts = json.loads(beside.read_text())
    assert path.stat().st_size < 3e6 and facts["particles"] >= 5e8
    assert min(facts["covers_mm"]) >= 10.0
    xy, radius = read_layout(path)
    assert radius == pytest.approx(0.09, abs=1e-3) and len(xy) == facts["particles_a_period"]
    a_um = np.sqrt(4 * 0.3 / (np.pi * 5))
    assert nearest_distances(Pattern(xy, facts["period_um"])).min() >= a_um - LAYOUT_STEP_UM
    assert len(xy) / facts["period_um"] ** 2 == pytest.approx(5.0, rel=1e-3)


def test_a_list_covers_an_oblong_and_repeats_its_period(tmp_path):
    path, beside = fabricate(made(), "csv", tmp_path / "a.csv", size_mm=(0.2, 0.05), seed=4)
    facts = json.loads(beside.read_text())
    xy = read_points_csv(path)
    columns, rows = facts["periods"]
    assert columns > rows >= 1 and len(xy) == facts["particles"]
    n = facts["particles_a_period"]
    assert np.allclose(xy[n : 2 * n] - xy[:n], [facts["period_um"], 0.0], atol=2e-4)


def test_the_seed_is_the_recipes_unless_another_is_given(tmp_path):
    def points(structure, seed=None):
        path, _ = fabricate(made(structure), "csv", tmp_path / "s.csv", seed=seed)
        return read_points_csv(path)

    other = points({"name": "rsa", "seed": 7})
    assert np.array_equal(other, points("rsa", 7)) and not np.array_equal(other, points("rsa"))


def test_the_command_writes_a_layout_and_a_sheet(tmp_path):
    assert run(["fabricate", str(EXAMPLE), "--to", "oas", "-o", str(tmp_path / "p.oas")]) == 0
    assert len(read_layout(tmp_path / "p.oas")[0]) == pytest.approx(20_000, rel=0.01)
    assert run(["fabricate", str(EXAMPLE), "--to", "sheet", "-o", str(tmp_path / "s.csv")]) == 0
    lines = (tmp_path / "s.csv").read_text().splitlines()
    positions = [line.split(",")[0] for line in lines if not line.startswith("#")]
    assert positions == ["position", "ambient", "core", "gap", "1", "substrate"]
    assert any(line.startswith("core,Ag,radius_nm,90") for line in lines)


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(UnsupportedError, match="not known for a metasurface"):
        fabricate(made(), "stl", tmp_path / "a.stl")
    with pytest.raises(UnsupportedError, match="ends in .gds"):
        fabricate(made(), "gds", tmp_path / "a.csv")
    with pytest.raises(UnsupportedError, match="write gds or oas"):
        fabricate(made(), "csv", tmp_path / "a.csv", size_mm=(10.0, 10.0))
    (tmp_path / "s.csv").write_text("".join(f"{q},1\n" for q in range(0, 60, 5)))
    data = dict(made().data, monolayer={"density_per_um2": 5, "structure": {"sq": str(tmp_path / "s.csv")}})
    with pytest.raises(UnsupportedError, match="name an arrangement"):
        fabricate(material(data), "gds", tmp_path / "a.gds")
