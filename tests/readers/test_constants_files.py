"""Optical constants in the formats of other programs, as materials of recipes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.matter import index
from nacre.matter.indices.spec import index_spec
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file
from nacre.recipe.model import RecipeContext

SHARED = Path(__file__).parents[2] / ".." / "shared" / "reference" / "instruments" / "nk"
EV_NM = 6.62607015e-34 * 299792458 / 1.602176634e-19 * 1e9  # h c / e
N = np.array([1.5 + 0.1j, 1.6 + 0.2j, 1.8 + 0.4j])
NM = np.array([400.0, 500.0, 800.0])
EPS = N**2


def wvase(folder: Path) -> str:
    rows = "\n".join(f" {EV_NM / nm:.17g}  {e.real:.17g}  {e.imag:.17g}" for nm, e in zip(NM, EPS))
    (folder / "m.mat").write_text(
        f"###### File Layer=3\n  Name=Mine\n  LambdaMin=1\nUnits=eV,E1E2\nBegin of array\n{rows}\n"
    )
    return "m.mat"


def short_mat(folder: Path) -> str:
    rows = "\n".join(f"{10 * nm:g}\t{n.real:.17g}\t{n.imag:.17g}" for nm, n in zip(NM, N))
    (folder / "m.mat").write_text(f"my film\nAngstroms\nNK\n{rows}\n")
    return "m.mat"


def zemax(folder: Path) -> str:
    rows = "\n".join(f"{nm / 1000} {n.real} {-n.imag}" for nm, n in zip(NM, N))
    (folder / "coat.dat").write_text(f"! mine\nMATE MINE\n{rows}\n\nCOAT AR\nMINE 0.25\n")
    return "coat.dat"


def spd_pair(folder: Path) -> str:
    for part, values in (("eta", N.real), ("k", N.imag)):
        (folder / f"M.{part}.spd").write_text("# nm\n" + "".join(f"{nm} {v!r}\n" for nm, v in zip(NM, values.tolist())))
    return "M.eta.spd"


def page(folder: Path) -> str:
    rows = "\n".join(f"        {nm / 1000} {n.real} {n.imag}" for nm, n in zip(NM, N))
    (folder / "page.txt").write_text(f'REFERENCES: "mine"\nDATA:\n  - type: tabulated nk\n    data: |\n{rows}\n')
    return "page.txt"


def nexus(folder: Path) -> str:
    import h5py

    with h5py.File(folder / "m.nxs", "w") as file:
        file["entry/definition"] = b"NXdispersive_material"
        plot = file.create_group("entry/dispersion_x/plot")
        plot["wavelength"], plot["refractive_index"], plot["extinction"] = NM / 1000, N.real, N.imag
        plot["wavelength"].attrs["units"] = "um"
    return "m.nxs"


def export(folder: Path) -> str:
    (folder / "rii.csv").write_text(
        '\ufeff"Wavelength, µm",n,k\r\n' + "".join(f"{nm / 1000},{n.real},{n.imag}\r\n" for nm, n in zip(NM, N)),
        encoding="utf-8",
    )
    return "rii.csv"


WRITERS = {"wvase": wvase, "short mat": short_mat, "zemax": zemax, "spd pair": spd_pair, "page": page, "nexus": nexus,
           "refractiveindex.info": export}  # fmt: skip


@pytest.mark.parametrize("form", WRITERS)
def test_a_file_of_another_program_is_a_material(form: str, tmp_path: Path) -> None:
    name = WRITERS[form](tmp_path)
    constant = index_spec({"file": name}, RecipeContext("r.toml", tmp_path)).build()
    np.testing.assert_allclose(constant.n_complex(NM), N, rtol=1e-12, atol=1e-12)


def test_one_of_several_materials_is_named(tmp_path: Path) -> None:
    (tmp_path / "c.dat").write_text("MATE A\n0.4 1.5 0\n0.8 1.5 0\nMATE B\n0.4 2 -0.5\n0.8 2 -0.5\n")
    context = RecipeContext("r.toml", tmp_path)
    assert index_spec({"file": "c.dat", "spectrum": "B"}, context).build().n_complex([500]) == 2 + 0.5j
    for table in ({"file": "c.dat"}, {"file": "c.dat", "spectrum": "C"}):
        with pytest.raises(NacreError, match=r"c\.dat"):
            index_spec(table, context)


def test_one_file_of_a_pair_alone_is_refused_and_the_other_is_part_of_the_material(tmp_path: Path) -> None:
    name = spd_pair(tmp_path)
    film = {"family": "film", "substrate": {"file": name}, "layers": []}
    before = nacre.material(film, tmp_path).fingerprint
    text = (tmp_path / "M.k.spd").read_text()
    (tmp_path / "M.k.spd").write_text(text.replace("0.4\n", "0.5\n"))
    assert nacre.material(film, tmp_path).fingerprint != before
    (tmp_path / "M.k.spd").unlink()
    with pytest.raises(NacreError, match=r"M\.k\.spd"):
        nacre.material(film, tmp_path)


def test_three_columns_without_headings_in_electron_volts_are_named(tmp_path: Path) -> None:
    rows = "".join(f"{EV_NM / nm:.9f} {e.real:.9f} {e.imag:.9f}\n" for nm, e in zip(NM, EPS))
    (tmp_path / "eps.txt").write_text(rows)
    for options in (ReadOptions(expects="constants"), ReadOptions(expects="constants", unit="eV")):
        with pytest.raises(AmbiguousFileError):
            open_file(tmp_path / "eps.txt", options)
    table = {"file": "eps.txt", "columns": ["energy_eV", "e1", "e2"]}
    found = index_spec(table, RecipeContext("r.toml", tmp_path)).build().n_complex(NM[:2])
    np.testing.assert_allclose(found, N[:2], rtol=1e-6)


def test_keys_of_a_file_need_a_file() -> None:
    with pytest.raises(NacreError, match="unit"):
        index({"n": 1.5, "unit": "nm"})


def test_a_library_of_models_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "lib.txt").write_text('dispers-library 1\nlibrary-id "a"\n  tauc-lorentz "Mine" 1 1 1 4 3 9 8\n')
    with pytest.raises(NacreError, match="regress-pro"):
        open_file(tmp_path / "lib.txt")


def readings() -> list[Path]:
    return sorted(SHARED.glob("*.reading.json"))


@pytest.mark.skipif(not SHARED.exists(), reason="../shared/reference/instruments is absent")
@pytest.mark.parametrize("reading", readings() or [Path("absent")], ids=lambda path: path.name)
def test_real_files_agree_with_independent_readings(reading: Path) -> None:
    right = json.loads(reading.read_text(encoding="utf-8"))
    path = reading.with_name(right["file"])
    try:
        found = open_file(path, ReadOptions(expects="constants"))
    except NacreError:
        assert right["file"] in ("Au.eta.spd", "GaussianMulti_fromCompleteEase.txt")  # n alone; no headings, in eV
        return
    assert {measurement.kind for measurement in found} == {"constants"}
    for sample in right["right_reading"].get("samples", []):
        data = found[0].data
        place = int(np.argmin(np.abs(data["wavelength_nm"] - sample["x"])))
        assert data["wavelength_nm"][place] == pytest.approx(sample["x"], rel=2e-7)
        for name in ("n", "k"):
            if name in sample:
                assert data[name][place] == pytest.approx(sample[name], rel=2e-6, abs=1e-8)
    for measurement in found:
        facts = right["right_reading"].get("materials", {}).get(measurement.name)
        if facts:
            assert len(measurement.data["n"]) == facts["rows"]
            assert measurement.data["k"][0] == pytest.approx(facts["k_first"])
