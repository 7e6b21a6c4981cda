"""Angle and polarisation above a table are used; reflectances of unknown scale are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.headings import read_preamble
from nacre.readers.measurement import ReadOptions
from nacre.readers.registry import open_file


@pytest.mark.parametrize(
    ("lines", "angle_deg", "polarisation"),
    [
        (["Angle of incidence: 45 deg", "Polarization: s"], 45.0, "s"),
        (["# AOI = 45", "# pol = p"], 45.0, "p"),
        (["Einfallswinkel;60,5;°"], None, ""),
        (["Reflectance at 45 degrees, s-pol"], 45.0, "s"),
        (["8° incidence, unpolarized"], 8.0, "unpolarised"),
        (["theta,0.5 rad"], np.degrees(0.5), ""),
        (["Temperature at 25 deg C", "Polarizer angle: 90"], None, ""),
        (["AOI = 45", "AOI = 60"], None, ""),
        (["Polarizer at 45 deg, integrating sphere"], None, ""),
        (["film's polarisation study, sample rotated at 30 deg"], None, ""),
        (["sample rotated by 90 deg, incidence 8 deg"], 8.0, ""),
    ],
)
def test_lines_above_a_table(lines: list[str], angle_deg: float | None, polarisation: str) -> None:
    found = read_preamble(lines)
    assert found.angle_deg == (None if angle_deg is None else pytest.approx(angle_deg))
    assert found.polarisation == polarisation


def rows(heading: str) -> str:
    return heading + "\n" + "\n".join(f"{nm},{0.2 + nm / 1e4:.4f}" for nm in range(400, 701, 20)) + "\n"


def test_a_spectrum_has_the_angle_and_polarisation_above_it(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("Sample: wafer 3\nAOI: 45 deg\nPolarization: s\n\n" + rows("wavelength (nm),R"))
    (found,) = open_file(path)
    assert found.metadata["angle_of_incidence_deg"] == 45.0 and found.metadata["polarisation"] == "s"
    assert any("AOI: 45 deg" in line for line in found.assumed)


def test_a_heading_takes_precedence_over_the_lines_above(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("AOI: 45 deg\n" + rows("wavelength (nm),Rs 60°"))
    (found,) = open_file(path)
    assert found.metadata["angle_of_incidence_deg"] == 60.0 and found.metadata["polarisation"] == "s"


@pytest.mark.parametrize("heading", ["wavelength (nm),R", "wavelength (nm),Reflectance (%)"])
def test_an_angle_of_the_user_takes_precedence(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("AOI: 45 deg\n" + rows(heading))
    (found,) = open_file(path, ReadOptions(angle_deg=8.0))
    assert found.metadata.get("angle_of_incidence_deg", 8.0) == 8.0


@pytest.mark.parametrize("heading", ["50x objective reflectance (%)", "reflectance mix 2"])
def test_a_magnification_is_no_scale(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(rows(f"wavelength (nm),{heading}"))
    assert "reflectance" in open_file(path)[0].data


@pytest.mark.parametrize("heading", ["wavelength (nm),R", "wavelength (nm),Rs"])
def test_both_readers_of_tables_use_them(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("AOI: 45 deg\n" + rows(heading))
    assert open_file(path)[0].metadata["angle_of_incidence_deg"] == 45.0


@pytest.mark.parametrize(
    "heading",
    ["R (a.u.)", "Reflectance (arb. units)", "1-R", "1 - Reflectance", "Reflectance (dB)", "R (ppm)", "log(R)",
     "Reflectance x1000", "delta Reflectance", "R/R0", "normalised reflectance"],
)  # fmt: skip
def test_reflectances_of_another_scale_are_refused(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(rows(f"wavelength (nm),{heading}"))
    with pytest.raises(NacreError, match="m.csv"):
        open_file(path)
