"""Files of T-matrices: what another program writes, what we write, what is refused, and what a recipe makes of them."""

import dataclasses
import json
import shutil
from itertools import pairwise

import h5py
import numpy as np
import pytest
from helpers_metasurface import REFERENCE, reference, t_matrix
from validation._metasurface_helpers import cross_sections

import nacre
from nacre.cli import run
from nacre.core.errors import MaterialRangeError
from nacre.families.metasurface.material import MetasurfaceWarning
from nacre.families.metasurface.species import place
from nacre.families.metasurface.tmatrix.axisymmetric import (
    AxialTMatrices,
    TabulatedBody,
    as_blocks,
    gain,
    mirror_signs,
)
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    AZIMUTHAL_ORDERS,
    ParticleOnStack,
    amplitude,
    pattern_change,
    probe_pattern,
    probes,
)
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.families.metasurface.tmatrix.tmatrix_file import TMatrixFileError, read_tmatrices, write_tmatrices
from nacre.readers import hdf5

SAME = 1e-10  # of spheres by way of a file, against Mie
TREAMS = 1e-6
RECIPE = """
family = "metasurface"
substrate = {n = 1.5}
[particle]
%s
[monolayer]
coverage = 0.08
packing = 0.2
[model]
correction = "qca-balanced"
multipole_order = 5
%s
"""


@pytest.fixture
def intact(monkeypatch):
    """Skip the subprocess that looks for damage, in tests of many intact files."""
    monkeypatch.setattr(hdf5, "probe", lambda *_: None)


def _spheres(wavelengths=(500.0, 520.0), radius=75.0, index=4.0 + 0.05j, ambient=1.0, lmax=5):
    k = 2 * np.pi * ambient / np.array(wavelengths)
    blocks = np.stack([as_blocks(t_matrix(lmax, x, index / ambient)) for x in k * radius])
    return AxialTMatrices(
        np.array(wavelengths), blocks, np.full(len(wavelengths), ambient), "sphere", radius, 2 * radius, radius,
        np.full(len(wavelengths), index),
    )  # fmt: skip


def _disc():
    name = REFERENCE / "tmat" / "tmat_open_01.h5"
    if not name.is_file():
        pytest.skip("../shared/reference is absent")
    return name


def _recipe(folder, particle, model="", name="recipe.toml"):
    path = folder / name
    path.write_text(RECIPE % (particle, model))
    return path


def _refusal(folder, capsys, particle, *arguments, model=""):
    """Run a command on a recipe that is refused; return its line."""
    path = _recipe(folder, particle, model)
    status = run(["spectrum", str(path), "--wavelengths-nm", "500", *arguments])
    said = capsys.readouterr().err.strip().splitlines()
    assert status == 2 and len(said) == 1, said
    return said[0]


def test_cross_sections_of_a_file_are_those_of_who_wrote_it():
    data = reference("particles_open.npz")
    for i in range(len(data["wavelength_nm"])):
        known = read_tmatrices(REFERENCE / "tmat" / f"tmat_open_{i:02d}.h5")
        t, k = known.blocks[0], 2 * np.pi / known.wavelengths_nm[0]
        weight = np.where(np.arange(len(t)) == 0, 1.0, 2.0)
        # the mean over all directions and polarisations; the file's own are at three angles: the trace is compared
        top = 6
        kept = np.concatenate([np.arange(top), known.lmax + np.arange(top)])
        scattered = (
            2
            * np.pi
            / k**2
            * np.sum(weight[: top + 1] * np.sum(np.abs(t[: top + 1, kept[:, None], kept]) ** 2, (1, 2)))
        )
        whole = data["tmatrix_lmax6"][i]
        assert scattered == pytest.approx(2 * np.pi / k**2 * np.sum(np.abs(whole) ** 2), rel=1e-9)
        assert known.radius_nm == pytest.approx(data["radius_nm"][i])
        assert known.height_nm == pytest.approx(data["height_nm"][i])
        assert known.circumscribing_nm == pytest.approx(data["circumscribing_radius_nm"][i])
        assert known.material_index[0] == pytest.approx(data["n_particle"][i])


def test_what_is_written_is_read_again_the_same(tmp_path):
    made = _spheres()
    write_tmatrices(tmp_path / "a.tmat.h5", made, "sphere", "Mie", "for a test")
    found = read_tmatrices(tmp_path / "a.tmat.h5")
    assert np.abs(found.blocks - made.blocks).max() < 1e-15
    assert np.allclose(found.wavelengths_nm, made.wavelengths_nm, rtol=1e-14)
    assert (found.radius_nm, found.height_nm) == pytest.approx((75.0, 150.0))
    assert found.material_index[1] == pytest.approx(4.0 + 0.05j)


@pytest.mark.parametrize("basis", ["parity", "helicity"])
def test_treams_reads_ours_and_we_read_treams(tmp_path, basis):
    treams = pytest.importorskip("treams.io").treams

    known = read_tmatrices(_disc())
    write_tmatrices(tmp_path / "ours.tmat.h5", known, "cylinder", "finite elements", "")
    theirs = treams.io.load_hdf5(str(tmp_path / "ours.tmat.h5"))[0]
    again = theirs.changepoltype(basis) if basis == "helicity" else theirs
    with h5py.File(tmp_path / "theirs.tmat.h5", "w") as file:
        treams.io.save_hdf5(file, [again], computation={"keywords": "semi-analytical"}, scatterers={})
    assert np.abs(read_tmatrices(tmp_path / "theirs.tmat.h5").blocks - known.blocks).max() < 1e-12


def test_scattering_of_a_disc_is_that_of_treams(tmp_path):
    """Far fields of a lone disc at slanted light: phases between m, l and polarisations all count."""
    treams = pytest.importorskip("treams.io").treams

    known = read_tmatrices(_disc())
    lam = known.wavelengths_nm[0]
    alone = ParticleOnStack(
        Substrate(lam, np.array([1.0, 1.0], complex), np.array([])), 100.0, known.blocks[0], known.lmax
    )
    theta, phi = np.radians([0.0, 25.0, 70.0]), np.radians([0.0, 40.0, 110.0])
    light = np.radians(35.0)
    found = amplitude(alone.harmonics(alone.directions(np.cos(theta)), alone.directions([np.cos(light)])), phi)
    matrix = treams.io.load_hdf5(str(_disc()))
    k = float(matrix.k0)
    data = reference("particles_open.npz")
    for pol in range(2):
        # s: along y; p: along the polar unit vector of the wave that comes down in the plane phi = 0
        vector = k * np.array([np.sin(light), 0.0, -np.cos(light)])
        field = [0.0, 1.0, 0.0] if pol == 0 else [-np.cos(light), 0.0, -np.sin(light)]
        wave = treams.plane_wave(vector, field, k0=k, material=1, poltype="parity")
        sent = matrix @ wave.expand(matrix.basis)
        radius = 1e9
        for i, t in enumerate(theta):
            for j, p in enumerate(phi):
                place = radius * np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
                theirs = np.sum(np.abs(np.asarray(sent.efield(place))) ** 2) * radius**2
                ours = np.sum(np.abs(found[:, i, pol, 0, j]) ** 2)
                assert ours == pytest.approx(theirs, rel=TREAMS)
    sections = cross_sections(alone, [np.cos(np.radians(45.0))])
    assert sections.extinction[:, 0] == pytest.approx(data["sigma_ext_nm2"][1, 1], rel=1e-4)  # the file goes to l = 10


def test_spheres_by_way_of_a_file_are_spheres(tmp_path):
    write_tmatrices(tmp_path / "si.tmat.h5", _spheres(index=4.0 + 0.05j), "sphere")
    by_file = nacre.load(_recipe(tmp_path, 'tmatrix = "si.tmat.h5"'))
    by_mie = nacre.load(_recipe(tmp_path, "material = {n = 4.0, k = 0.05}\nradius_nm = 75", name="mie.toml"))
    lam = np.array([500.0, 520.0])
    wi = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    wo = np.array([[0.0, 0.6, 0.8], [0.5, 0.1, np.sqrt(0.74)]])
    ours, mie = (m.model.values_at(wi, wo, lam) for m in (by_file, by_mie))
    assert np.abs(ours / mie - 1).max() <= SAME
    for a, b in zip(by_file.model.powers([1.0, 0.5], 500.0), by_mie.model.powers([1.0, 0.5], 500.0), strict=True):
        assert np.abs(a - b).max() <= SAME


def test_export_writes_what_a_recipe_reads_to_the_same_numbers(tmp_path, capsys):
    mie = _recipe(tmp_path, "material = {n = 4.0, k = 0.05}\nradius_nm = 75", name="mie.toml")
    assert run(["export", str(mie), "--to", "tmat", "-o", str(tmp_path / "out.tmat.h5")]) == 0
    assert "not stored: the stack" in capsys.readouterr().err
    by_file = nacre.load(_recipe(tmp_path, 'tmatrix = "out.tmat.h5"'))
    for w in (400.0, 600.0):
        for a, b in zip(by_file.model.powers([0.9], w), nacre.load(mie).model.powers([0.9], w), strict=True):
            assert np.abs(a - b).max() <= SAME


ROUND = """
family = "metasurface"
substrate = "%s"
layers = [{material = {n = 1.5}, thickness_nm = 200}]
[particle]
%s
[monolayer]
coverage = %g
packing = 0.2
"""


def test_the_stated_truncation_is_the_next_step_of_the_multipole_series():
    """The steps of a sphere of silicon beside glass fall geometrically: each predicts the next one."""
    body = TabulatedBody(_spheres((500.0,), radius=60.0, lmax=7), 60.0, 120.0, 60.0, "x")
    below = Substrate(500.0, np.array([1.0, 1.5], complex), np.array([]))

    def pattern(order):
        particle = place(body, below, 2.0, order).particle
        top = min(AZIMUTHAL_ORDERS, order)
        alone = ParticleOnStack(below, particle.centre_nm, particle.t_matrix, top)
        return probe_pattern(alone.dressed, *probes(below, particle.centre_nm, order, top))

    patterns = [pattern(order) for order in range(4, 8)]
    steps = [pattern_change(a, b) for a, b in pairwise(patterns)]
    for order, step in zip((4, 5, 6), steps, strict=True):
        np.testing.assert_allclose(place(body, below, 2.0, order).change, step, rtol=0.2)


@pytest.mark.parametrize(
    ("substrate", "more", "coverage", "around"),
    [("glass", "", 0.03, 1.0), ("Si", "gap_nm = 3", 0.03, 1.0), ("glass", "depth_nm = 20", 0.002, 1.5)],
)
def test_at_default_orders_a_sphere_and_its_file_are_the_same(tmp_path, substrate, more, coverage, around):
    """The file holds more multipoles than are taken, and "auto" takes the mean field of silicon spheres there."""
    write_tmatrices(tmp_path / "s.tmat.h5", _spheres((500.0, 650.0), lmax=12, ambient=around), "sphere")
    particles = (f"material = {{n = 4.0, k = 0.05}}\nradius_nm = 75\n{more}", f'tmatrix = "s.tmat.h5"\n{more}')
    found = []
    for name, particle in zip(("mie.toml", "file.toml"), particles, strict=True):
        (tmp_path / name).write_text(ROUND % (substrate, particle, coverage))
        model = nacre.load(tmp_path / name).model
        assert model.chosen_correction[0] == "qca-balanced"
        at = np.array([[0.6, 0.0, 0.8], [0.0, 0.5, np.sqrt(0.75)]])
        found.append([model.values_at(at, at[::-1], np.array([500.0, 650.0])), *model.powers([1.0, 0.5], 650.0)])
    assert max(np.abs(a - b).max() for a, b in zip(*found, strict=True)) <= SAME


def test_what_the_command_exports_gives_the_same_spectrum_at_default_orders(tmp_path, capsys):
    mie, by_file = tmp_path / "mie.toml", tmp_path / "file.toml"
    mie.write_text(ROUND % ("glass", 'material = "Ag"\nradius_nm = 50', 0.05))
    by_file.write_text(ROUND % ("glass", 'tmatrix = "s.tmat.h5"', 0.05))
    assert run(["export", str(mie), "--to", "tmat", "-o", str(tmp_path / "s.tmat.h5")]) == 0
    capsys.readouterr()
    reported = []
    for path in (mie, by_file):
        assert run(["spectrum", str(path), "--angles-deg", "0,60", "--wavelengths-nm", "400,550,700", "--json"]) == 0
        reported.append(json.loads(capsys.readouterr().out))
    for key in reported[0]:
        if key.endswith(("reflectance", "transmittance")):
            assert np.abs(np.subtract(reported[0][key], reported[1][key])).max() <= SAME, key


def test_a_file_of_too_few_multipoles_of_a_sphere_says_so(tmp_path, caplog):
    """By how much is held against the same sphere of more multipoles."""
    write_tmatrices(tmp_path / "s.tmat.h5", _spheres((500.0,), radius=60.0, lmax=3), "sphere")
    path = _recipe(tmp_path, 'tmatrix = "s.tmat.h5"\ngap_nm = 2')
    path.write_text(path.read_text().replace("multipole_order = 5", ""))
    assert run(["spectrum", str(path), "--wavelengths-nm", "500"]) == 0
    said = [line for line in caplog.messages if "multipoles" in line]
    assert len(said) == 1 and "holds multipoles up to l = 3, and this sphere takes up to 4 over this stack" in said[0]
    (note,) = nacre.load(path).model.bsdf(np.array([500.0])).provenance["multipoles"]
    views = np.radians(np.arange(5.0, 90.0, 12.0))
    patterns = [_pattern_over_glass(lmax, views) for lmax in (3, 12)]
    squares = [np.sum(each**2, axis=(0, 1, 4)) for each in (patterns[0] - patterns[1], patterns[1])]
    assert note["change"] == pytest.approx(np.sqrt(squares[0] / squares[1]).max(), rel=0.1)


def _pattern_over_glass(lmax, views):
    """d sigma/d Omega of the sphere at four incidences, `[pol out, view, pol, light, azimuth]`."""

    one = ParticleOnStack(
        Substrate(500.0, np.array([1.0, 1.5], complex), np.array([])), 62.0,
        t_matrix(lmax, 2 * np.pi * 60 / 500, 4.0 + 0.05j), min(4, lmax),
    )  # fmt: skip
    light = one.directions(np.cos(np.radians([0.0, 30.0, 60.0, 80.0])))
    field = amplitude(one.harmonics(one.directions(np.cos(views)), light), np.linspace(0, np.pi, 9))
    return np.abs(field) ** 2


def test_a_film_has_no_t_matrix(tmp_path, capsys):
    (tmp_path / "film.toml").write_text('family = "film"\nsubstrate = "Si"\nlayers = []\n')
    assert run(["export", str(tmp_path / "film.toml"), "--to", "tmat", "-o", str(tmp_path / "x.tmat.h5")]) == 2
    assert "has no T-matrix" in capsys.readouterr().err
    assert not (tmp_path / "x.tmat.h5").exists()


def test_between_wavelengths_a_particle_stays_passive():
    known = _spheres((480.0, 560.0), index=4.0 + 0j)
    assert gain(known.at(520.0)) < 1e-12
    assert np.allclose(known.at(480.0), known.blocks[0]) and np.allclose(known.at(560.0), known.blocks[1])
    with pytest.raises(MaterialRangeError, match="from 480 to 560 nm, not at 600 nm"):
        known.at(600.0)
    assert np.allclose(known.at(600.0, hold_ends=True), known.blocks[1])


@pytest.mark.usefixtures("intact")
@pytest.mark.parametrize(
    ("name", "unit", "value"),
    [
        ("vacuum_wavelength", "um", 0.5),
        ("vacuum_wavenumber", "nm^{-1}", 1 / 500.0),
        ("angular_vacuum_wavenumber", "um^{-1}", 2e3 * np.pi / 500.0),
        ("frequency", "THz", 299792.458 / 500.0),
        ("angular_frequency", "fs^{-1}", 2e-3 * np.pi * 299792.458 / 500.0),
        ("vacuum_wavelength", "µm", 0.5),
        ("vacuum_wavenumber", "cm^{-1}", 1e7 / 500.0),
        ("vacuum_wavenumber", "1/cm", 1e7 / 500.0),
        ("angular_vacuum_wavenumber", "rad/um", 2e3 * np.pi / 500.0),
        ("angular_vacuum_wavenumber", "nm-1", 2 * np.pi / 500.0),
        ("frequency", "s^{-1}", 299792458e9 / 500.0),
        ("frequency", "PHz", 299.792458 / 500.0),
        ("angular_frequency", "rad/s", 2e9 * np.pi * 299792458 / 500.0),
        ("angular_frequency", "rad fs^{-1}", 2e-3 * np.pi * 299792.458 / 500.0),
        ("angular_frequency", "THz", 2 * np.pi * 299792.458 / 500.0),  # as the format's own tools read it
    ],
)
def test_every_spectral_axis_and_unit_of_the_format(tmp_path, name, unit, value):
    path = tmp_path / "a.tmat.h5"
    write_tmatrices(path, _spheres((500.0,)), "sphere")
    with h5py.File(path, "a") as file:
        del file["vacuum_wavelength"]
        file[name] = value
        file[name].attrs["unit"] = unit
    assert read_tmatrices(path).wavelengths_nm[0] == pytest.approx(500.0, rel=1e-12)


@pytest.mark.usefixtures("intact")
@pytest.mark.parametrize(
    ("name", "unit", "allowed"),
    [
        ("vacuum_wavelength", "angstrom", "m with an SI prefix, as nm"),
        ("vacuum_wavelength", "cm^{-1}", "m with an SI prefix, as nm"),
        ("vacuum_wavelength", "eV", "m with an SI prefix, as nm"),
        ("vacuum_wavenumber", "rad/m", "m^{-1} with an SI prefix, as nm^{-1} or cm^{-1}"),
        ("angular_vacuum_wavenumber", "eV", "m^{-1} with an SI prefix, as nm^{-1} or cm^{-1}"),
        ("frequency", "rad/s", "Hz or s^{-1} with an SI prefix, as THz or fs^{-1}"),
        ("frequency", "eV", "Hz or s^{-1} with an SI prefix, as THz or fs^{-1}"),
        ("angular_frequency", "cm^{-1}", "Hz or s^{-1} with an SI prefix, as THz or fs^{-1}"),
        ("angular_frequency", "s", "Hz or s^{-1} with an SI prefix, as THz or fs^{-1}"),
    ],
)
def test_a_unit_that_the_format_does_not_have_is_refused_with_what_it_has(tmp_path, capsys, name, unit, allowed):
    path = tmp_path / "a.tmat.h5"
    write_tmatrices(path, _spheres((500.0,)), "sphere")
    with h5py.File(path, "a") as file:
        del file["vacuum_wavelength"]
        file[name] = 2.0
        file[name].attrs["unit"] = unit
    line = _refusal(tmp_path, capsys, 'tmatrix = "a.tmat.h5"')
    assert f'gives {name} in "{unit}", which is not a unit of' in line and line.endswith(f"it should be {allowed}")


def test_modes_may_stand_in_any_order_and_scattered_apart_from_incident(tmp_path):
    made = _spheres()
    path = tmp_path / "a.tmat.h5"
    write_tmatrices(path, made, "sphere")
    with h5py.File(path, "a") as file:
        shuffled = np.random.default_rng(1).permutation(file["modes/l"].size)
        matrix = file["tmatrix"][()][:, shuffled]
        modes = {n: file[f"modes/{n}"][()] for n in ("l", "m", "polarization")}
        del file["modes"], file["tmatrix"]
        file["tmatrix"] = matrix
        for n, v in modes.items():
            file[f"modes/{n}_scattered"], file[f"modes/{n}_incident"] = v[shuffled], v
    assert np.abs(read_tmatrices(path).blocks - made.blocks).max() < 1e-15


def _broken(path, how):
    with h5py.File(path, "a") as file:
        how(file)


def _set(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


def _without(name):
    def change(file):
        del file[name]

    return change


def _scaled(factor):
    def change(file):
        file["tmatrix"][...] = file["tmatrix"][()] * factor

    return change


def _tilted(file):
    values = file["tmatrix"][()]
    values[:, 0, 3] = 0.6  # couples m = -1 and m = 0
    file["tmatrix"][...] = values


def _handed(file):
    values = file["tmatrix"][()]
    values[:, 0, 1] = values[:, 1, 0] = 0.01j  # m = -1 alone: electric to magnetic
    file["tmatrix"][...] = values


def _one_way(file):
    values = file["tmatrix"][()]
    values[:, 2, 22] = 0.05  # l = 1, m = 0 electric from l = 3, m = 0 electric, and not back
    file["tmatrix"][...] = values


def _elsewhere(file):
    del file["tmatrix"]
    file["tmatrix"] = h5py.ExternalLink("other.h5", "/tmatrix")


def _too_small(file):
    geometry = file["scatterer/geometry"]  # its lengths are in nm
    geometry.attrs["shape"] = "cylinder"
    for name, value in (("radius", 30.0), ("height", 90.0), ("circumscribing_radius", 44.0)):
        geometry.pop(name, None)
        geometry[name] = value


BROKEN = {
    "no matrix": (_without("tmatrix"), 'holds no dataset "tmatrix"'),
    "no axis": (_without("vacuum_wavelength"), "gives no wavelength"),
    "no modes": (_without("modes/l"), "does not name its modes"),
    "no unit": (lambda f: f["vacuum_wavelength"].attrs.__delitem__("unit"), "without a unit"),
    "odd unit": (lambda f: f["vacuum_wavelength"].attrs.__setitem__("unit", "parsec"), 'vacuum_wavelength in "parsec"'),
    "nan": (_scaled(np.nan), "not finite"),
    "gain": (_scaled(4.0), "radiates more"),
    "not axisymmetric": (_tilted, "of what it scatters depends on its turn"),
    "handed": (_handed, "handed particle, with no mirror plane"),
    "not reciprocal": (_one_way, "not reciprocal"),
    "magnetic medium": (_set("embedding/relative_permeability", 2.0), "magnetic or chiral"),
    "absorbing medium": (_set("embedding/relative_permittivity", 2.0 + 1j), "absorbing medium"),
    "another file": (_elsewhere, "leads to another file"),
    "two wavelengths the same": (
        lambda f: f["vacuum_wavelength"].write_direct(np.array([500.0, 500.0])),
        "a wavelength twice",
    ),
    "odd polarization": (_set("modes/polarization", ["left"] * 70), 'names a polarization "left"'),
    "what a terminal obeys": (_set("modes/polarization", ["\x1b[2Jred\n"] * 70), 'names a polarization "[2jred"'),
    "a mode twice": (_set("modes/m", np.zeros(70, int)), "every mode up to l = 5 once"),
    "wrong shape": (_set("tmatrix", np.zeros(5)), "of shape (5,)"),
    "too small a sphere around it": (_too_small, "gives a circumscribing_radius of 44 nm, and what is"),
}


@pytest.mark.usefixtures("intact")
@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_gets_one_line(tmp_path, capsys, what):
    how, said = BROKEN[what]
    write_tmatrices(tmp_path / "b.tmat.h5", _spheres(), "sphere")
    _broken(tmp_path / "b.tmat.h5", how)
    with pytest.raises(TMatrixFileError):
        read_tmatrices(tmp_path / "b.tmat.h5")
    line = _refusal(tmp_path, capsys, 'tmatrix = "b.tmat.h5"')
    assert 'particle.tmatrix = "b.tmat.h5"' in line and said in line


def test_what_is_no_such_file_gets_one_line(tmp_path, capsys):
    (tmp_path / "text.h5").write_text("not a file of this kind")
    (tmp_path / "half.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40))
    (tmp_path / "folder.h5").mkdir()
    reported = {
        "text": "is not a readable HDF5 file",
        "half": "is not a readable HDF5 file",
        "folder": "is a folder",
        "none": "does not exist",
    }
    for name, said in reported.items():
        assert said in _refusal(tmp_path, capsys, f'tmatrix = "{name}.h5"')


@pytest.mark.parametrize(
    ("probe", "patience", "said"),
    [
        ("import os; os.abort()", 60.0, "HDF5 crashes on it"),
        ("import time; time.sleep(300)", 0.5, "is not done with it"),
    ],
)
def test_a_file_that_hdf5_does_not_survive_gets_one_line(tmp_path, capsys, monkeypatch, probe, patience, said):
    """Met by changing bytes at random: a broken heap of strings is read for ever."""
    monkeypatch.setattr(hdf5, "PROBE", probe)
    monkeypatch.setattr(hdf5, "PROBE_TIMEOUT_S", patience)
    write_tmatrices(tmp_path / "b.tmat.h5", _spheres(), "sphere")
    assert said in _refusal(tmp_path, capsys, 'tmatrix = "b.tmat.h5"')


def test_what_does_not_fit_the_recipe_gets_one_line(tmp_path, capsys):
    write_tmatrices(tmp_path / "water.tmat.h5", _spheres(ambient=1.33), "sphere")
    write_tmatrices(tmp_path / "air.tmat.h5", _spheres(), "sphere")
    write_tmatrices(tmp_path / "unsized.tmat.h5", dataclasses.replace(_spheres(), radius_nm=None))
    air = 'tmatrix = "air.tmat.h5"\n'
    assert "in a medium of n = 1.33, and the ambient has 1" in _refusal(tmp_path, capsys, 'tmatrix = "water.tmat.h5"')
    assert "give particle.diameter_nm" in _refusal(tmp_path, capsys, 'tmatrix = "unsized.tmat.h5"')
    assert "tmatrix and radius_nm" in _refusal(tmp_path, capsys, air + "radius_nm = 70")
    assert "not what air.tmat.h5 says: 150 nm" in _refusal(tmp_path, capsys, air + "diameter_nm = 170")
    assert "needs material and radius_nm of a sphere, or tmatrix" in _refusal(tmp_path, capsys, "gap_nm = 1")
    sphere = 'material = "Si"\nradius_nm = 75\nheight_nm = 30'
    assert "gives height_nm, which a sphere does not have" in _refusal(tmp_path, capsys, sphere)
    path = _recipe(tmp_path, air)
    assert run(["spectrum", str(path), "--wavelengths-nm", "600"]) == 2
    assert "from 500 to 520 nm, not at 600 nm" in capsys.readouterr().err
    path.write_text(path.read_text().replace("multipole_order = 5", "multipole_order = 7"))
    assert run(["spectrum", str(path), "--wavelengths-nm", "500"]) == 2
    assert "multipole_order = 7 is higher than what" in capsys.readouterr().err


def test_circumscribing_spheres_may_not_meet(tmp_path, capsys):
    shutil.copy(_disc(), tmp_path / "disc.tmat.h5")
    disc = 'tmatrix = "disc.tmat.h5"\ngap_nm = 40'
    path = _recipe(tmp_path, disc)
    text = path.read_text().replace("multipole_order = 5", "")
    path.write_text(text.replace("packing = 0.2", "packing = 0.09"))
    assert run(["spectrum", str(path), "--wavelengths-nm", "620"]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1 and "circumscribing spheres, 144.2 nm wide, meet" in said
    path.write_text(text.replace("coverage = 0.08\npacking = 0.2", "coverage = 0.6"))
    assert run(["spectrum", str(path), "--wavelengths-nm", "620"]) == 2
    assert "apart only at a packing of 0.867" in capsys.readouterr().err
    path.write_text(text.replace("packing = 0.2", ""))  # what is not said is chosen to fit
    assert nacre.load(path).model.structure.diameter_nm == pytest.approx(144.22, rel=1e-3)


def test_a_changed_file_is_another_material(tmp_path):
    write_tmatrices(tmp_path / "a.tmat.h5", _spheres(), "sphere")
    path = _recipe(tmp_path, 'tmatrix = "a.tmat.h5"')
    first = nacre.load(path)
    before, kept = first.fingerprint, first.model.powers([1.0], 500.0)[2]
    write_tmatrices(tmp_path / "a.tmat.h5", _spheres(index=3.0 + 0.05j), "sphere")
    second = nacre.load(path)
    assert second.fingerprint != before
    assert np.abs(second.model.powers([1.0], 500.0)[2] / kept - 1).max() > 0.01


def test_signs_between_m_and_minus_m_are_those_of_a_mirror():
    assert np.array_equal(mirror_signs(1), [[1, -1], [-1, 1]])


def _cluster(treams, corners, radius=30.0, apart=80.0, wavelength=500.0):
    """Silicon spheres at the corners of a polygon about z, as one T-matrix about its middle, in the parity basis."""
    k, turn = 2 * np.pi / wavelength, 2 * np.pi * np.arange(corners) / corners
    at = np.column_stack([apart / 2 * np.cos(turn), apart / 2 * np.sin(turn), 0 * turn])
    one = treams.TMatrix.sphere(4, k, radius, [3.5**2, 1.0])
    cluster = treams.TMatrix.cluster([one] * corners, at).interaction.solve()
    return cluster.expand(treams.SphericalWaveBasis.default(4)).changepoltype("parity")


def _saved(treams, matrix, path):
    with h5py.File(path, "w") as file:
        treams.io.save_hdf5(file, [matrix], computation={"keywords": "semi-analytical"}, scatterers={})


def test_a_particle_with_corners_is_taken_as_the_mean_over_its_turns(tmp_path, capsys):
    """Against the code that made it: extinction at slanted light, averaged over turns about the normal."""
    treams = pytest.importorskip("treams.io").treams

    matrix = _cluster(treams, 4)
    _saved(treams, matrix, tmp_path / "square.tmat.h5")
    known = read_tmatrices(tmp_path / "square.tmat.h5")
    assert 1e-6 < known.turn_loss < 0.05
    alone = ParticleOnStack(
        Substrate(500.0, np.array([1.0, 1.0], complex), np.array([])), 100.0, known.blocks[0], known.lmax
    )
    light, k = np.radians(50.0), float(matrix.k0)
    ours = cross_sections(alone, [np.cos(light)]).extinction[:, 0]
    turns, theirs = 2 * np.pi * np.arange(24) / 24, np.zeros(2)
    for phi in turns:
        along, across = np.array([np.cos(phi), np.sin(phi), 0.0]), np.array([-np.sin(phi), np.cos(phi), 0.0])
        vector = k * (np.sin(light) * along - np.cos(light) * np.array([0, 0, 1.0]))
        for pol, field in enumerate((across, -np.cos(light) * along - np.sin(light) * np.array([0, 0, 1.0]))):
            wave = treams.plane_wave(list(vector), list(field), k0=k, material=1, poltype="parity")
            wave = wave.expand(matrix.basis)
            sent = np.asarray(matrix @ wave)
            theirs[pol] += -np.real(np.vdot(np.asarray(wave), sent)) / k**2 / len(turns)
    assert ours == pytest.approx(theirs, rel=TREAMS)
    path = _recipe(tmp_path, 'tmatrix = "square.tmat.h5"\ndiameter_nm = 140\nheight_nm = 60\ngap_nm = 60')
    path.write_text(path.read_text().replace("multipole_order = 5", ""))
    with pytest.warns(MetasurfaceWarning, match="mean over its turn"):
        made = nacre.load(path).model.bsdf(np.array([500.0]))
    assert 0 < made.provenance["left_out_by_turns"] < 0.05


@pytest.mark.parametrize(("index", "radius"), [(4.0 + 0.05j, 40.0), (0.1 + 3.5j, 60.0)])
def test_the_magnetic_elements_of_any_body_give_its_time_sign(tmp_path, index, radius):
    """As of a cylinder, whose electric dipole has no closed form."""
    path = tmp_path / "a.tmat.h5"
    write_tmatrices(path, _spheres(radius=radius, index=index), "cylinder", "Mie", "")
    assert read_tmatrices(path).shape == "cylinder"
    with h5py.File(path, "r+") as file:
        file["tmatrix"][...] = np.conj(file["tmatrix"][()])
    with pytest.raises(TMatrixFileError, match="conjugate"):
        read_tmatrices(path)
