"""Inputs modelled on public bug reports: each gives the right answer, or a refusal where its README allows one.

The inputs are not part of the project; where their folder is absent, these tests skip.
"""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.optimise.spec import LightSpec, TargetEntry
from nacre.optimise.targets import read_targets
from nacre.recipe.model import RecipeContext

CASES = Path(__file__).parents[2] / ".." / "shared" / "cases" / "readers"
pytestmark = pytest.mark.skipif(not CASES.exists(), reason="../shared/cases is absent")

METAL = [0.4085, 0.7711, 0.9458]
REFUSED = None
SPECTRA: dict[str, list[float] | None] = {
    "A-nm-and-eV": METAL, "A-title": METAL, "A-two-materials": REFUSED, "A1-eps2": METAL, "A1-k-unit": METAL,
    "A1-kappa": METAL, "A1-remark-kn": METAL, "A10-twice": METAL, "A16-noise-k": [0.04258], "A2-quoted-comma": METAL,
    "A3-n-alone": [0.04258], "A4-eps": METAL, "A4-eps-words": METAL, "A5-eV": REFUSED, "A5-edge": REFUSED,
    "A5-um-long-first": [0.1552], "A6-eps-neg": REFUSED, "A8-cm-1": METAL, "A9-D": METAL,
}  # fmt: skip
DIFFUSE: dict[str, list[float] | None] = {
    "C-albedo-micron": [0.0705, 0.203, 0.402], "D-hist-um": [0.283, 0.369, 0.355], "D-points-px": REFUSED,
    "D-points-id": [0.001124, 0.000176], "D-sq-nm": [0.00602, 0.00059, 0.00011],
    "D-sq-number-column": [0.00236, 0.00048],
}  # fmt: skip
FITS: dict[str, float | None] = {
    "B-AOI": 333.0, "B-T-renamed": REFUSED, "B-angle-rad": 333.0, "B-num-error-cell": REFUSED, "B-own-p": 333.0,
    "B-twice": REFUSED, "B-um-as-nm": REFUSED, "B2-psi-delta": 103.0, "C5-headerless-fit": REFUSED,
}  # fmt: skip
BLUE = {450: 0.66, 550: 0.10, 650: 0.10}
TARGETS: dict[str, dict[int, float]] = {
    "C-want-THz": BLUE, "C-want-percent": {450: 0.0078, 550: 0.0059}, "C2-begin-end": BLUE, "C3-five-columns": BLUE,
    "C4-jcamp-factor": {450: 0.33, 550: 0.05, 650: 0.05},
}  # fmt: skip
COLOURS: dict[str, list[list[float]] | None] = {
    "H-angles": [[70, -8, -25]], "H-hash": [[52, -30, 28], [62, -8, -30], [45, 28, 30]], "H-twice": REFUSED,
    "H1-cgats": [[50.09, 21.77, -20.04], [62.40, -4.52, -29.47]], "H2-hex": [[57.97, -2.42, -39.46]],
    "H2-lch": [[62, -8.02, -29.94]], "H3-cxf": REFUSED, "H5-d50": [[62.43, -4.38, -29.44]],
}  # fmt: skip
# keys of the recipes before they were renamed
RENAMED = {"[[want]]": "[[target]]", "\nat =": "\ngeometry =", "\nwithin =": "\ntolerance ="}


@pytest.fixture
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the case with the present names of the keys."""
    case = tmp_path / request.node.callspec.params["case"]
    shutil.copytree(CASES / case.name, case)
    for recipe in case.glob("*.toml"):
        text = recipe.read_text(encoding="utf-8")
        for former, present in RENAMED.items():
            text = text.replace(former, present)
        recipe.write_text(text, encoding="utf-8")
    monkeypatch.chdir(case)
    return case


def commands(folder: Path) -> list[list[str]]:
    text = (folder / "cmd").read_text(encoding="utf-8")
    return [part.split()[1:] for part in text.strip().split("&&") if part.strip().startswith("nacre")]


def refused(status: int, capsys: pytest.CaptureFixture[str]) -> bool:
    said = capsys.readouterr().err
    return status == 2 and said.strip().splitlines()[-1].startswith("nacre: ")


def column(text: str, name: str) -> list[float]:
    return [float(row[name]) for row in csv.DictReader(text.splitlines())]


@pytest.mark.parametrize("case", [*SPECTRA, *DIFFUSE])
def test_a_spectrum_is_right_or_refused(case: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = SPECTRA[case] if case in SPECTRA else DIFFUSE[case]
    (command,) = commands(folder)
    status = run(command)
    if wanted is REFUSED:
        assert refused(status, capsys)
        return
    assert status == 0
    name = "specular_reflectance" if case in SPECTRA else "diffuse_reflectance"
    np.testing.assert_allclose(column(capsys.readouterr().out, name), wanted, rtol=0.02, atol=6e-6)


@pytest.mark.parametrize("case", FITS)
def test_a_fit_is_right_or_refused(case: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    statuses = [run(command) for command in commands(folder)]
    wanted = FITS[case]
    if wanted is REFUSED:
        assert refused(statuses[-1], capsys) and not (folder / "fitted.toml").exists()
        return
    assert statuses[-1] == 0
    assert nacre.load(folder / "fitted.toml").get("layers[0].thickness_nm") == pytest.approx(wanted, abs=0.1)


@pytest.mark.parametrize("case", TARGETS)
def test_a_target_spectrum_is_right(case: str, folder: Path) -> None:
    name = re.search(r'spectrum = "(.*)"', (folder / "want.toml").read_text(encoding="utf-8"))
    assert name is not None
    want = TargetEntry(geometry="specular 0", spectrum=name[1])
    (found,) = read_targets([want], LightSpec(), RecipeContext("want.toml", folder))
    assert found.spectrum is not None
    for nm, value in TARGETS[case].items():
        assert np.interp(nm, *found.spectrum) == pytest.approx(value, rel=0.07)


@pytest.mark.parametrize("case", COLOURS)
def test_a_list_of_colours_is_right_or_refused(case: str, folder: Path) -> None:
    from nacre.core.errors import NacreError
    from nacre.optimise.colour_list import read_colours

    text = (folder / "any.toml").read_text(encoding="utf-8")
    geometries = re.findall(r'geometry = "(.*)"', text)
    wanted = COLOURS[case]
    if wanted is REFUSED:
        with pytest.raises(NacreError):
            read_colours(folder / "labs.csv", len(geometries), ("D65", "10deg"), geometries)
        return
    rows = read_colours(folder / "labs.csv", len(geometries), ("D65", "10deg"), geometries)
    np.testing.assert_allclose([row.lab[0] for row in rows], wanted, atol=0.01)
    if case == "H-angles":
        np.testing.assert_allclose(rows[0].lab[1], [50, 20, -20])
