"""Colours under a narrow-band lamp: wherever one is shown, it is the colour of a spectrum known in 1 nm steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre import plot
from nacre.analysis.tolerance import ColourProbe
from nacre.core.arrays import direction
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.measure.colours import colour_bsdf, colour_spectrum, colour_values
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.geometry import aspecular_direction

LAMP = "F11"
BAR = 0.5  # dE00, as promised for sweeps and reports
SINGLE = 1e-3  # of Lab: a relief is tabulated in single precision
EVERY_NM = np.arange(380.0, 781.0)
ANGLES = (-15.0, 25.0, 75.0)
WI = np.broadcast_to(direction(np.radians(45.0)), (len(ANGLES), 3))
WO = np.stack([aspecular_direction(45.0, a) for a in ANGLES])

METASURFACE = {"family": "metasurface", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 400}],
              "particle": {"material": "Ag", "radius_nm": 70, "gap_nm": 2}, "monolayer": {"coverage": .1}}  # fmt: skip
RELIEF = {"family": "relief", "heights": "h.npy", "feature_um": 1.0, "blur_um": 0.3, "coating": "Au",
          "coherence": {"sigma": 1.0}, "accuracy": 0.03, "bounded": False}  # fmt: skip
ROUGH = {"family": "film", "substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": 900}],
         "surface": {"roughness": 0.3}}  # fmt: skip
PEARL = {
    "family": "pearl",
    "strata": [{"resin": {"n": 1.575}, "thickness_um": 50, "roughness": 0.02, "platelets": [{
        "volume_fraction": 0.02, "substrate": {"material": "SiO2", "thickness_nm": 80},
        "coatings": [{"material": "TiO2", "thickness_nm": 100}], "normal_deviation": 0.05}]}],
    "base": {"albedo": 0.5},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.save(tmp_path / "h.npy", np.random.default_rng(4).uniform(0.0, 0.6, (8, 8)))
    return tmp_path


def lab(values: Any, nm: Any, observer: str = "10deg") -> Any:
    return xyz_to_lab(spectrum_to_xyz(np.asarray(values), nm, LAMP, observer), white_xyz(LAMP, observer))


def worst(found: Any, reference: Any) -> float:
    return float(np.max(delta_e_2000(reference, found)))


@pytest.mark.parametrize("recipe", [ROUGH, RELIEF], ids=["rough film", "relief"])
def test_tolerances_measure_scattering_materials_at_the_lamps_lines(recipe: Any, folder: Path) -> None:
    material = nacre.material(recipe, folder)
    exact = material.values_at(WI, WO, EVERY_NM)
    values = material.bsdf(EVERY_NM).evaluate(WI, WO) if exact is None else exact[0]
    found, nm = colour_values(material, WI, WO, LAMP)
    assert worst(lab(np.pi * found, nm), lab(np.pi * values, EVERY_NM)) <= BAR
    probe = ColourProbe(material, LAMP, "10deg", None, 0)
    picked = [probe.angles_deg.index(a) for a in ANGLES]
    np.testing.assert_allclose(probe(material)[picked], lab(np.pi * found, nm), atol=SINGLE)


@pytest.mark.full
def test_a_metasurface_has_its_colour_under_a_lamp_in_every_place(folder: Path) -> None:
    material = nacre.material(METASURFACE, folder)
    fine = material.bsdf(EVERY_NM[::2])
    reference = lab(np.pi * fine.evaluate(WI, WO), fine.wavelengths_nm)
    values, nm = colour_values(material, WI, WO, LAMP)
    assert worst(lab(np.pi * values, nm), reference) <= BAR
    bsdf = colour_bsdf(material, LAMP)
    assert worst(lab(np.pi * bsdf.evaluate(WI, WO), bsdf.wavelengths_nm), reference) <= BAR


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("quality", ["fast"])  # the walk at 1 nm takes too long; it stands on the same wavelengths
def test_a_pearl_has_its_colour_under_a_lamp_in_every_place(quality: str, folder: Path) -> None:
    material = nacre.material({**PEARL, "quality": quality}, folder)
    samples = 1 << 16
    fine = material.bsdf(EVERY_NM[::4] if quality == "fast" else EVERY_NM)
    reference = lab(np.pi * evaluate_with_error(fine, WI, WO, samples=samples)[0], fine.wavelengths_nm)
    values, nm = colour_values(material, WI, WO, LAMP, samples=samples)
    assert worst(lab(np.pi * values, nm), reference) <= BAR
    coarse = colour_bsdf(material, LAMP)
    values = evaluate_with_error(coarse, WI, WO, samples=samples)[0]
    assert worst(lab(np.pi * values, coarse.wavelengths_nm), reference) <= BAR


@pytest.mark.parametrize("kind", ["spectrum", "ribbon", "chromaticity", "tracks", "colour-map", "slice", "lobe"])
def test_every_figure_with_colours_asks_at_the_lamps_lines(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    material = nacre.material(ROUGH)
    kinds = type(material.model)
    for name in ("bsdf", "spectrum"):
        plain = getattr(kinds, name)

        def watch(self: Any, *args: Any, plain: Any = plain, **rest: Any) -> Any:
            given = [a for a in (*args, *rest.values()) if isinstance(a, np.ndarray) and a.size > 40 and a.max() > 600]
            asked.extend(len(a) for a in given)
            return plain(self, *args, **rest)

        monkeypatch.setattr(kinds, name, watch)
    over = None if kind in ("slice", "lobe") else ("layers[0].thickness_nm", [850.0, 950.0])
    plot.material_figure(material, kind, illuminant=LAMP, over=over)
    assert asked and min(asked) > len(material.model.wavelengths_nm)


def test_a_films_spectra_keep_their_colour_under_a_lamp() -> None:
    material = nacre.material({**ROUGH, "surface": {"roughness": 0.0}})
    theta = np.radians([0.0, 45.0])
    found, exact = colour_spectrum(material, theta, LAMP), material.spectrum(theta, EVERY_NM)
    assert found.specular_reflectance is not None
    assert (
        worst(lab(found.specular_reflectance, found.wavelengths_nm), lab(exact.specular_reflectance, EVERY_NM)) <= BAR
    )
