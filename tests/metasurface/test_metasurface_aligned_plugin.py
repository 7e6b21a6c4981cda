"""Aligned particles on the device, by their recipes and in files: the questions that every lobe is asked."""

import dataclasses
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.monolayer import ROUNDING, encode
from nacre.cli import run
from nacre.core.arrays import direction
from nacre.material.material import material
from nacre.measure.evaluate import bsdf_spectrum

ARRAY_BAR = 1e-4
CHI_SQUARE_LEVEL = 0.01
FURNACE_TOP = 1.002
FILE = Path(__file__).with_name("dimer.tmat.h5")
GRID = np.array([500.0, 600.0])
CASES = {
    "opaque": ('substrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 120}]', 1.0),
    "on glass": ("substrate = {n = 1.5}", 1.5),
}
RECIPE = """
family = "metasurface"
%s
[particle]
tmatrix = "dimer.tmat.h5"
%s
diameter_nm = 200
height_nm = 100
gap_nm = 60
%s
[monolayer]
coverage = 0.1
packing = 0.4
[model]
%s
"""
ALIGNED = 'orientation = "aligned"\nturn_deg = 25'


def recipe(folder, stack="opaque", particle=ALIGNED, more="", model="multipole_order = 4", name="recipe.toml"):
    shutil.copy(FILE, folder / "dimer.tmat.h5")
    path = folder / name
    path.write_text(RECIPE % (CASES[stack][0], particle, more, model))
    return path


@cache
def made(name, folder):
    return nacre.load(recipe(folder, name, name=f"{name.replace(' ', '-')}.toml")).bsdf(GRID)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("aligned")


@pytest.fixture(scope="module")
def trials():
    from tested_variant import use_tested_variant

    use_tested_variant()
    import lobe_trials as testing

    return testing


def as_held(lobe):
    """Return the lobe with the numbers that its words on the device can hold."""
    rows = lobe.table
    for _ in range(6):
        rows = encode(rows).numbers()[:, : rows.shape[1]].astype(np.float32)
    return Bsdf((dataclasses.replace(lobe, table=np.ascontiguousarray(rows)),))


@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_device_and_arrays_agree_at_both_azimuths(trials, folder, name):
    lobe = as_held(made(name, folder).lobes[1])
    both = lobe.transmits
    a, b = trials.directions(3000, 1, both), trials.directions(3000, 2, both)
    assert trials.array_mismatch(lobe, a, b) <= ARRAY_BAR
    assert trials.reciprocity_mismatch(lobe, a, b, CASES[name][1]) <= ARRAY_BAR
    exact = Bsdf((made(name, folder).lobes[1],))
    a, b = a.astype(np.float32).astype(float), b.astype(np.float32).astype(float)
    expected = exact.evaluate(a, b)
    wrong = trials.plugin_values(exact, a, b, exact.wavelengths_nm) - expected
    assert np.all(np.sqrt(np.mean(wrong**2, axis=0)) <= ROUNDING * np.sqrt(np.mean(expected**2, axis=0)))


@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_directions_are_drawn_as_their_density_says(trials, folder, name):
    lobe = as_held(made(name, folder).lobes[1])
    views = [(25.0, 40.0), (72.0, 200.0)] + ([(160.0, 10.0), (118.0, 100.0)] if lobe.transmits else [])
    for view in views:
        assert trials.chi_square(lobe, *view, samples=400_000).passes(CHI_SQUARE_LEVEL, 10), view
        assert trials.weight_mismatch(trials.draw(lobe, trials.direction(*view), 20_000)) <= 2e-3
        mean, error = trials.furnace(lobe, view[0], n=50_000)
        assert np.all(mean - 3 * error <= FURNACE_TOP) and np.all(mean > 0)


@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_mirror_light_on_the_device_has_the_powers_of_the_tables(trials, folder, name):
    """From each azimuth, and from below by the way out; the two directions are exact."""
    mirror = made(name, folder).lobes[0]
    powers = []
    for view in [(30.0, 10.0), (30.0, 100.0), (60.0, 190.0)] + ([(155.0, 60.0)] if mirror.transmits else []):
        eye = trials.direction(*view)
        draws = trials.draw(Bsdf((mirror,)), eye, 4000)
        power = mirror.specular_at(eye[2], np.arctan2(eye[1], eye[0]))
        reflects = draws.wo[:, 2] * eye[2] > 0
        assert np.allclose(draws.wo[reflects], eye * [-1.0, -1.0, 1.0], atol=1e-6)
        at = [float(np.interp(w, GRID, power.reflectance)) for w in trials.HERO_WAVELENGTHS_NM]
        got = (draws.weight * draws.pdf[:, None])[reflects][0]
        assert got == pytest.approx(at, abs=2e-4)
        if not reflects.all():
            squeeze = draws.eta[~reflects][0] ** -2  # radiance in the denser medium
            at = [float(np.interp(w, GRID, power.transmittance)) for w in trials.HERO_WAVELENGTHS_NM]
            assert (draws.weight * draws.pdf[:, None])[~reflects][0] == pytest.approx(
                np.multiply(at, squeeze), abs=2e-4
            )
        powers.append(at[1])
    assert abs(powers[1] - powers[0]) > 2e-4  # the azimuth counts


@pytest.mark.render
def test_a_built_scene_takes_other_numbers_and_no_other_terms(trials, folder):
    from nacre.core.errors import UnsupportedError
    from nacre.device.bsdf import make_bsdf, update_bsdf

    bsdf = made("opaque", folder)
    plugin = make_bsdf(bsdf)
    turned = Bsdf(tuple(dataclasses.replace(lobe, rotation=lobe.rotation + 1.0) for lobe in bsdf.lobes))
    update_bsdf(plugin, turned)
    a, b = trials.directions(300, 1, False), trials.directions(300, 2, False)
    wrong = trials.plugin_values(plugin, a, b, GRID) - turned.evaluate(a, b)
    assert np.abs(wrong).max() <= 3 * ROUNDING * turned.evaluate(a, b).max()
    diffuse = bsdf.lobes[1]
    fewer = dataclasses.replace(diffuse, table=diffuse.table[:, :-1], orders=diffuse.orders[:-1])
    with pytest.raises(UnsupportedError, match="build the scene again"):
        update_bsdf(plugin, Bsdf((bsdf.lobes[0], fewer)))


def test_spectra_with_and_without_tables_agree_and_follow_the_turn(folder):
    """The light comes in the plane of x: turning the particles is turning it the other way."""
    found = nacre.load(recipe(folder, "on glass"))
    theta = np.radians([0.0, 40.0])
    direct = found.spectrum(theta, GRID).parts()
    bsdf = made("on glass", folder)
    for name, values in bsdf_spectrum(bsdf, theta).parts().items():
        assert np.abs(values - direct[name]).max() <= 5e-3, name
    straight = nacre.load(recipe(folder, "on glass", 'orientation = "aligned"', name="straight.toml")).bsdf(GRID)
    turned = straight.specular(theta, phi_rad=-np.radians(25.0)).reflectance
    assert np.abs(bsdf.specular(theta).reflectance - turned).max() <= 1e-12
    assert np.abs(straight.specular(theta).reflectance - turned).max() > 2e-4


def test_a_bsdf_of_aligned_particles_is_saved_and_loaded(folder, tmp_path):
    bsdf = made("on glass", folder)
    bsdf.save(tmp_path / "a.nacre")
    again = Bsdf.load(tmp_path / "a.nacre")
    a, b = direction(np.array([0.3, 1.1]), np.array([0.2, 4.0])), direction(np.array([0.8, 2.0]), np.array([1.2, 3.0]))
    assert np.array_equal(again.evaluate(a, b), bsdf.evaluate(a, b))
    assert np.array_equal(again.specular(0.5, phi_rad=1.0).reflectance, bsdf.specular(0.5, phi_rad=1.0).reflectance)
    assert bsdf.evaluate(a, b).max() > 0
    for field, value in (("orders", bsdf.lobes[1].orders[:-1]), ("count_above", 3)):
        with pytest.raises(ValueError, match=r"orders|table"):
            dataclasses.replace(bsdf.lobes[1], **{field: value}).check()
    assert bsdf.provenance["correction"] == "qca-balanced"
    assert "not measured" in bsdf.provenance["correction_because"]


def test_the_file_of_an_aligned_particle_is_exported_whole(folder, tmp_path, capsys):
    out = tmp_path / "out.tmat.h5"
    assert run(["export", str(recipe(folder)), "--to", "tmat", "-o", str(out)]) == 0
    from nacre.families.metasurface.tmatrix.tmatrix_file import read_tmatrices

    assert np.abs(read_tmatrices(out, True).full - read_tmatrices(FILE, True).full).max() <= 1e-15


@pytest.mark.parametrize(
    ("particle", "more", "model", "said"),
    [
        (ALIGNED, "", 'correction = "ensemble"', 'model.correction = "ensemble" is not modelled for aligned'),
        (ALIGNED, "", 'correction = "optical-depth"', "is not modelled for aligned particles"),
        (ALIGNED, 'second = {material = "Ag", radius_nm = 40, share = 0.5}', "", "not modelled in a mixture"),
        ("turn_deg = 30", "", "", 'turn_deg, which needs orientation = "aligned"'),
        ('orientation = "alinged"', "", "", "aligned"),
        ("", "", "", 'orientation = "aligned"'),  # depends too much on its turn for a mean: the line says what to do
        (ALIGNED.replace("25", "1e9"), "", "", "360"),
    ],
)
def test_what_aligned_particles_cannot_be_gets_one_line(folder, capsys, particle, more, model, said):
    path = recipe(folder, particle=particle, more=more, model=model, name="refused.toml")
    assert run(["spectrum", str(path), "--wavelengths-nm", "500"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "refused.toml" in lines[0] and said in lines[0], lines


def test_an_axisymmetric_file_aligned_is_the_same_as_averaged(tmp_path):
    from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices
    from nacre.families.metasurface.tmatrix.tmatrix_file import read_tmatrices, write_tmatrices

    known = read_tmatrices(FILE, True)
    disc = AxialTMatrices(known.wavelengths_nm, known.blocks, known.ambient_index)
    write_tmatrices(tmp_path / "disc.tmat.h5", disc)
    data = {
        "family": "metasurface", "substrate": "Si",
        "particle": {"tmatrix": "disc.tmat.h5", "diameter_nm": 200, "height_nm": 100, "gap_nm": 60},
        "monolayer": {"coverage": 0.1, "packing": 0.4}, "model": {"correction": "qca-balanced"},
    }  # fmt: skip
    found = []
    for orientation in ("averaged", "aligned"):
        data["particle"]["orientation"] = orientation
        model = material(data, tmp_path).model
        assert not model.is_aligned
        found.append(model.spectrum([0.5], [500.0]).diffuse_reflectance)
    assert np.array_equal(*found)
