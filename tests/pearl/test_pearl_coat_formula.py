"""Does a smooth clear coat over a matt ground follow the known formula, whichever way the ground is written?"""

from __future__ import annotations

import numpy as np
import pytest
from helpers_pearl import direction

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import TableLobe
from nacre.measure.evaluate import evaluate_with_error

NM = np.array([400.0, 500.0, 600.0, 700.0])
ALBEDO = 0.7
INDEX = 1.5
NOISE = 4.0  # standard deviations
FLOOR = 2e-3  # single precision, and the plugin's own table of what is reflected inside


@pytest.fixture(scope="module")
def coats(tmp_path_factory):
    folder = tmp_path_factory.mktemp("matt")
    theta, azimuth = np.linspace(0, np.pi / 2, 5), np.linspace(0, np.pi, 4)
    values = np.full((len(theta), len(theta), len(azimuth), 1), ALBEDO / np.pi)
    Bsdf((TableLobe(NM, values, np.ones((1, len(NM)))),)).save(folder / "matt.nacre")
    (folder / "matt.toml").write_text('family = "measured"\nfile = "matt.nacre"\n')
    strata = [{"resin": {"n": INDEX}, "thickness_um": 30}]
    known = nacre.material({"family": "pearl", "strata": strata, "base": {"albedo": ALBEDO}}, folder).bsdf(NM)
    table = nacre.material({"family": "pearl", "strata": strata, "base": {"recipe": "matt.toml"}}, folder).bsdf(NM)
    assert (known.lobes[0].base, table.lobes[0].base) == ("diffuse", "lobes")
    return {"albedo": known, "measured": table}


def pairs():
    wi = np.stack([direction(5), direction(30), direction(60), direction(75)])
    return wi, np.stack([direction(40, 70), direction(10, 180), direction(55, 20), direction(30, 130)])


@pytest.mark.render
@pytest.mark.parametrize("base", ["albedo", "measured"])
def test_a_coat_over_a_matt_ground_is_mitsubas_plastic(coats, base):
    from tested_variant import use_tested_variant

    mi = use_tested_variant()
    grey = {"type": "uniform", "value": ALBEDO}
    plastic = mi.load_dict({
        "type": "plastic", "diffuse_reflectance": grey, "int_ior": INDEX, "ext_ior": 1.0, "nonlinear": True,
        "specular_reflectance": {"type": "uniform", "value": 1.0},
    })  # fmt: skip
    wi, wo = pairs()
    si = mi.SurfaceInteraction3f()
    si.wi, si.wavelengths = mi.Vector3f(wi.T), mi.Spectrum(*NM.tolist())
    known = np.array(plastic.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T))).T / wo[:, 2:]
    found, error = evaluate_with_error(coats[base], wi, wo, samples=1 << 16)
    assert np.all(np.abs(found - known) < NOISE * error + FLOOR * known)
    assert np.all(NOISE * error < 0.05 * known)  # or the line above says little


@pytest.mark.render
def test_a_measured_matt_ground_below_a_coat_reflects_what_a_diffuse_one_does(coats):
    from nacre.device.walk.arrays import hemispherical_layered

    for angle in (0, 70):
        known, found = (
            hemispherical_layered(coats[b].lobes[0], direction(angle), samples=1 << 18)[0].mean() for b in coats
        )
        assert found == pytest.approx(known, rel=5e-3)
        assert found < 1.0
