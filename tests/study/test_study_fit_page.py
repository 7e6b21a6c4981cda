"""The page of a fit: numbers with bounds, measured beside fitted, for spectra and for directions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.arrays import direction
from nacre.core.errors import NacreError

FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 280}]\n'


def measured(folder: Path, thickness_nm: float, waves: str = "400:750:10") -> Path:
    (folder / "oxide.toml").write_text(FILM)
    name = folder / "wafer.csv"
    made = ["--set", f"layers[0].thickness_nm={thickness_nm:g}", "--wavelengths-nm", waves, "--angles-deg", "0,45"]
    assert run(["spectrum", str(folder / "oxide.toml"), *made, "-o", str(name)]) == 0
    return name


def test_the_page_of_a_spectrum_holds_numbers_bounds_and_differences_and_is_self_contained(tmp_path: Path) -> None:
    csv, page = measured(tmp_path, 333.0), tmp_path / "fit.html"
    arguments = ["fit", str(csv), str(tmp_path / "oxide.toml"), "--parameter", "layers[0].thickness_nm=100:500"]
    assert run([*arguments, "--report", str(page), "-o", str(tmp_path / "fitted.toml")]) == 0
    text = page.read_text(encoding="utf-8")
    assert "<code>layers[0].thickness_nm</code></td><td>333</td>" in text and "100 to 500" in text
    assert "All numbers are determined." in text
    # one file: the picture stands in it, and no address of anything else
    assert "data:image/png;base64," in text and not re.search(r'(?:src|href)="(?!data:|#)', text)


def test_a_number_at_its_bound_is_said_to_be_there(tmp_path: Path) -> None:
    csv, page = measured(tmp_path, 333.0), tmp_path / "fit.html"
    fit = nacre.fit(csv, tmp_path / "oxide.toml", ["layers[0].thickness_nm=280:320"], starts=1, report=page)
    assert fit.numbers[0].value == pytest.approx(320.0, abs=0.1)
    assert "layers[0].thickness_nm: at a bound; the best may lie beyond it." in page.read_text(encoding="utf-8")


def test_the_page_of_a_spectrum_beyond_the_visible_is_written_without_colours(tmp_path: Path) -> None:
    csv, page = measured(tmp_path, 290.0, "900:1400:50"), tmp_path / "fit.html"
    fit = nacre.fit(csv, tmp_path / "oxide.toml", ["layers[0].thickness_nm=250:350"], starts=1, report=page)
    assert fit.numbers[0].value == pytest.approx(290.0, abs=0.1)
    assert "data:image/png;base64," in page.read_text(encoding="utf-8")


def test_the_page_of_directions_is_written_too(tmp_path: Path) -> None:
    film = nacre.material({"family": "film", "substrate": "Al", "surface": {"roughness": 0.2},
                           "layers": [{"material": "SiO2", "thickness_nm": 240}]})  # fmt: skip
    bsdf = film.bsdf(np.array([450.0, 650.0]))
    lines = ["theta_i,phi_i,theta_o,phi_o,wavelength,value"]
    for theta in (0.0, 15.0, 30.0, 45.0):
        wo = np.broadcast_to(direction(np.radians(theta), np.pi), (1, 3))
        seen = nacre.evaluate(bsdf, direction(np.radians(30.0))[None], wo)
        values = zip(bsdf.wavelengths_nm, np.asarray(seen).ravel())
        lines += [f"30,0,{theta},180,{nm:g},{value}" for nm, value in values]
    (tmp_path / "g.csv").write_text("\n".join(lines))
    nacre.fit(tmp_path / "g.csv", film, ["surface.roughness=0.1:0.4"], starts=1, report=tmp_path / "g.html")
    assert "<td>0.2</td>" in (tmp_path / "g.html").read_text(encoding="utf-8")


def test_another_suffix_is_refused_before_the_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv = measured(tmp_path, 333.0)
    with pytest.raises(NacreError, match=r"fit.pdf: the suffix must be .html"):
        nacre.fit(csv, tmp_path / "oxide.toml", ["layers[0].thickness_nm=100:500"], report=tmp_path / "fit.pdf")
    assert run(["fit", str(csv), str(tmp_path / "oxide.toml"), "--report", "fit.txt"]) == 2
    assert "fit.txt: the suffix must be .html" in capsys.readouterr().err
