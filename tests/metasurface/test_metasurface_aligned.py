"""Particles that all point one way: known particles by this route, turns, other codes, energy, reciprocity."""

import dataclasses
import importlib.util
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers_metasurface import monolayer, surface, t_matrix
from validation._metasurface_helpers import plane_waves

import nacre
from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobe import SpecularResponse
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.monolayer import PolarGrid
from nacre.bsdf.texture import Texture
from nacre.core.arrays import direction
from nacre.families.metasurface.monolayer import aligned as aligned_compile
from nacre.families.metasurface.monolayer.aligned import (
    AlignedLayer,
    aligned_powers,
    aligned_term,
    aligned_values,
    azimuth_nodes,
    light_of,
    tabulate_aligned,
)
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.evaluation import Grids, direct_powers, direct_values, tabulate
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.supercells import Coupling
from nacre.families.metasurface.tmatrix import tmatrix_file
from nacre.families.metasurface.tmatrix.axisymmetric import (
    as_blocks,
    full_order,
    multipole_index,
    reversed_full,
    spread_blocks,
    with_negative_orders,
)
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Embedded
from nacre.families.metasurface.tmatrix.tmatrix_file import TMatrixFileError, read_tmatrices, write_tmatrices
from nacre.measure.evaluate import directional_hemispherical

TABLES = 0.01  # each table is within 0.005 of the solution
SAME = 1e-10  # of what is computed another way from the same numbers
SINGLE = 2e-6  # of tables of single precision, over the largest value
OTHER_CODE = 1e-6
EXPANDED = 2e-3  # of the largest far field: multipoles up to 5 about the middle of two spheres that reach 100 nm
LINES = 1e-2  # of the root mean square: what 64 angles leave over a film, twice the bar of tables of 120
QCA_ENERGY = 1e-2  # energy error of the mean field, see docs/physics/metasurface.md, "Aligned particles"
ROOT = Path(__file__).parents[2]
EXAMPLE, TOOL = ROOT / "examples" / "metasurface" / "silver_rods.toml", ROOT / "tools" / "lying_rods.py"
tool_spec = importlib.util.spec_from_file_location("lying_rods", TOOL)
tool = importlib.util.module_from_spec(tool_spec)
tool_spec.loader.exec_module(tool)
FILE = Path(__file__).with_name("dimer.tmat.h5")
RADII, APART, INDEX = (50.0, 38.0), 100.0, 4.0 + 0.05j  # of the two spheres of the file, the larger one at -x
LENGTH, HEIGHT = APART + 2 * RADII[0], 2 * RADII[0]


@cache
def known():
    return read_tmatrices(FILE, is_aligned=True)


def dimers(substrate, coverage=0.1, packing=0.4, films=(), gap=60.0, whole=None, wavelength=500.0, mmax=4):
    """Return a monolayer of the file's particles, or of others of the same size."""
    below = surface(wavelength, substrate, films)
    density = coverage / (np.pi * (LENGTH / 2) ** 2)
    structure = hard_disk_structure(density, packing, 4.5 * below.wavenumber * max(1.0, below.index_below))
    at = int(np.argmin(np.abs(known().wavelengths_nm - wavelength)))
    mean = Monolayer(below, (Particle(1.0, HEIGHT / 2 + gap, known().blocks[at]),), structure, mmax=mmax)
    return AlignedLayer(mean, known().full[at] if whole is None else whole)


def spheres(substrate, lmax=4):
    """Return a monolayer of spheres by today's way, and by this one."""
    layer = monolayer(520.0, 75.0, 4 + 0.05j, substrate, 0.1, 0.3, lmax=lmax)
    return layer, AlignedLayer(layer, spread_blocks(as_blocks(layer.particles[0].t_matrix), multipole_index(lmax)))


def lobes(layer, above=24, below=None, turn=0.0):
    """Return the two lobes at one wavelength."""
    eta = 1.0 if below is None else below.eta
    grids = Grids(PolarGrid(above), below)
    nm = np.array([layer.mean.surface.wavelength_nm])
    return tabulate_aligned(nm, lambda _: layer, layer.mean.structure, grids, eta, turn)[0]


def vectors(count, seed, both=False):
    rng = np.random.default_rng(seed)
    z = rng.uniform(-1.0 if both else 0.0, 1.0, count)
    return direction(np.arccos(z), rng.uniform(0, 2 * np.pi, count))


def about_z(w, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return w @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def about_y(w, angle):
    """From z towards x."""
    cos, sin = np.cos(angle), np.sin(angle)
    return w @ np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


# -- what is known already, by this route -----------------------------------------------------------------


@pytest.mark.parametrize("substrate", [4.0 + 0.05j, 1.5])
def test_axisymmetric_particles_send_what_they_always_did(substrate):
    today, here = spheres(substrate)
    cosines, turns = np.array([0.15, 0.5, 0.97]), np.array([0.0, 0.7, 3.0])
    for known_power, power in zip(today.specular_above(cosines), here.specular_above(cosines, turns), strict=True):
        assert np.abs(power - known_power).max() <= SAME
    count = 36  # azimuths: as many as today's sums over the azimuth have points
    rules = [(*hemisphere_rule(6), False)]
    if today.transmits_below:
        rules.append((*hemisphere_rule(4, 1.5), True))
        assert np.abs(here.specular_below(cosines, turns) - today.specular_below(cosines)).max() <= SAME
    wanted = diffuse_term(today, [(today.illuminate(mu, below), w) for mu, w, below in rules], 8)
    found = aligned_term(here, [(light_of(here, mu, below, count), w) for mu, w, below in rules])
    # from wavevector to wavevector: that of the light runs the other way than its direction
    waves = np.cos(np.multiply.outer(azimuth_nodes(count) - np.pi, np.arange(8)))
    series = np.einsum("sbi,bk->sik", found.power[..., 0], waves) * np.where(np.arange(8) == 0, 1.0, 2.0) / count
    expected = 0.5 * wanted.coherent.sum(axis=(2, 3))
    assert np.abs(series - expected).max() <= SAME * np.abs(expected).max()
    sent = found.flow[..., 5].sum(axis=1) * 2 * np.pi / count
    assert np.abs(sent - wanted.unpolarised).max() <= SAME * wanted.unpolarised.max()


@pytest.mark.parametrize("below", [None, PolarGrid(8, 5, 1.5)])
def test_their_lobes_are_the_same_too(below, monkeypatch):
    monkeypatch.setattr(aligned_compile, "LEFT_OUT", 0.0)
    monkeypatch.setattr(aligned_compile.solve_aligned, "__defaults__", (36,))
    today, here = spheres(4.0 + 0.05j if below is None else 1.5)
    grids, eta = Grids(PolarGrid(12), below), 1.0 if below is None else 1.5
    mirror, harmonic = tabulate(np.array([520.0]), lambda _: today, today.structure, grids, eta)[0]
    mirror_here, aligned = lobes(here, 12, below, turn=0.4)
    a, b = vectors(2000, 0, below is not None), vectors(2000, 1, below is not None)
    expected = harmonic.evaluate(a, b)
    assert np.abs(aligned.evaluate(a, b) - expected).max() <= SINGLE * expected.max()
    # the tables have other nodes over angle: 64 equal steps of the cosine are common to both
    nodes = np.arange(1, 65) / 64
    for cosines, limit in ((nodes, SAME), (-np.sqrt(1.0 - (1.0 - nodes**2) / eta**2), SAME), (a[:, 2], TABLES)):
        if below is None and cosines[0] < 0.0:
            continue
        expected, found = mirror.specular(cosines), mirror_here.specular_at(cosines, np.linspace(-1, 1, cosines.size))
        assert np.abs(found.reflectance - expected.reflectance).max() <= limit
        assert np.abs(found.transmittance - expected.transmittance).max() <= limit


def test_and_their_few_powers():
    today, here = spheres(1.5)
    cosines = np.array([0.2, 0.8])
    for expected, found in zip(direct_powers(today, cosines), aligned_powers(here, cosines, 0.3), strict=True):
        assert np.abs(found - expected).max() <= 1e-6  # another rule over the azimuth


@pytest.mark.parametrize("substrate", [4.0 + 0.05j, 1.5])
def test_and_their_values_at_a_few_pairs(substrate):
    today, here = spheres(substrate)
    wi, wo = vectors(5, 12), vectors(5, 13)
    wi[:, 2], wo[:, 2] = np.maximum(wi[:, 2], 0.2), np.maximum(wo[:, 2], 0.2)
    wi, wo = (w / np.linalg.norm(w, axis=1)[:, None] for w in (wi, wo))
    expected = direct_values(today, wi, wo)
    assert (
        np.abs(aligned_values(here, wi, wo, 0.3) - expected).max() <= 1e-4 * expected.max()
    )  # other sums over the azimuth


@pytest.mark.parametrize("turn", [0.7])
def test_values_at_a_few_pairs_are_those_of_the_lobe_between_its_angles(turn):
    layer = dimers(4.3 + 0.07j, films=((1.46, 120.0),))
    lobe = lobes(layer, 64, turn=turn)[1]
    wi, wo = (
        direction(np.radians([15.0, 35.0, 50.0, 60.0]), phi) for phi in ([0.0, 1.0, 2.5, 4.0], [0.5, 3.0, 3.1, 0.2])
    )
    expected = lobe.evaluate(wi, wo)[:, 0]
    found = aligned_values(layer, wi, wo, turn)
    assert np.sqrt(np.mean((found - expected) ** 2)) <= LINES * np.sqrt(np.mean(expected**2))
    assert np.abs(aligned_values(layer, wo, wi, turn) - found).max() <= SAME * found.max()
    assert np.abs(aligned_values(layer, wi, wo, turn + 1.0) / found - 1.0).max() > 0.05


# -- turns ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt_deg", [90.0, 35.0])
def test_a_tilted_particle_is_light_and_view_tilted_back(tilt_deg):
    """In free space, of the lopsided particle of the file: all |F|^2 over both polarisations stay."""
    tilt, layer = np.radians(tilt_deg), dimers(1.0, mmax=5)
    tilted = AlignedLayer(layer.mean, tool.tilted_full(layer.full, tilt))
    a = vectors(6, 8)
    b = about_y(a, tilt)
    keep = b[:, 2] > 0.05
    a, b = a[keep], b[keep]
    assert len(a) >= 2

    def sent(of, w):
        """From the first direction to the others; the light's wavevector runs the other way."""
        phi = np.arctan2(w[:, 1], w[:, 0])
        f = _alone(of, w[0, 2], w[1:, 2], phi[0] + np.pi, phi[1:])
        return np.sum(np.abs(f) ** 2, axis=(0, 2))

    expected = sent(layer, a)
    assert np.abs(sent(tilted, b) - expected).max() <= SAME * expected.max()
    assert np.abs(sent(layer, b) - expected).max() > 0.05 * expected.max()


@pytest.mark.parametrize("turn_deg", [90.0, 30.0])
def test_a_turned_particle_is_the_material_turned(turn_deg, monkeypatch):
    monkeypatch.setattr(aligned_compile, "LEFT_OUT", 0.0)
    monkeypatch.setattr(aligned_compile, "MOST_TERMS", 500)
    turn = np.radians(turn_deg)
    films = ((1.46, 120.0),)
    straight, turned = dimers(4.3 + 0.07j, films=films), dimers(4.3 + 0.07j, films=films)
    phase = np.exp(-1j * multipole_index(full_order(turned.full)).m * turn)
    turned = AlignedLayer(turned.mean, phase[:, None] * turned.full * phase.conj())
    mirror, diffuse = lobes(straight, 10)
    mirror_turned, diffuse_turned = lobes(turned, 10)
    a, b = vectors(1000, 2), vectors(1000, 3)
    expected = diffuse.evaluate(about_z(a, -turn), about_z(b, -turn))
    assert np.abs(diffuse_turned.evaluate(a, b) - expected).max() <= SINGLE * expected.max()
    assert np.abs(diffuse.evaluate(a, b) - expected).max() > 0.05 * expected.max()  # a turn does count
    by_number = dataclasses.replace(diffuse, rotation=turn)
    assert np.abs(by_number.evaluate(a, b) - expected).max() <= SINGLE * expected.max()
    phi = np.arctan2(a[:, 1], a[:, 0])
    of = [
        lobe.specular_at(a[:, 2], at).reflectance
        for lobe, at in ((mirror, phi - turn), (mirror_turned, phi), (dataclasses.replace(mirror, rotation=turn), phi))
    ]
    assert np.abs(of[1] - of[0]).max() <= SAME and np.abs(of[2] - of[0]).max() <= SAME
    assert np.ptp(mirror.specular_at(np.full(8, 0.8), azimuth_nodes(8)).reflectance) > 1e-3


def test_mirror_light_at_many_azimuths_is_summed_over_lobes_of_every_sort():
    """One that depends on the azimuth, its diffuse one, one of its methods alone, and all of them in a mask."""
    made = lobes(dimers(4.3 + 0.07j), 10)
    nm, phi = made[0].wavelengths_nm, azimuth_nodes(5)

    class OfMethodsAlone:
        wavelengths_nm = nm

        def specular(self, cos_i, uv=None):
            return SpecularResponse(np.full((*np.shape(cos_i), 1), 0.1), np.zeros((*np.shape(cos_i), 1)))

    expected = made[0].specular_at(np.full(5, np.cos(0.5)), phi).reflectance
    found = Bsdf((*made, OfMethodsAlone())).specular(0.5, phi_rad=phi)
    assert np.abs(found.reflectance - expected - 0.1).max() <= SAME and np.ptp(expected) > 1e-3
    half = Texture(0.0, 1.0, image=np.full((2, 2), 0.25))
    masked = Bsdf(tuple(MaskedLobe(nm, lobe, half) for lobe in made)).specular(0.5, phi_rad=phi)
    assert np.abs(masked.reflectance - 0.25 * expected).max() <= SAME
    assert np.abs(Bsdf(made).specular(0.5).reflectance - expected[0]).max() <= SAME


def _alone(layer, light, views, wave, away, is_lit_from_below=False):
    """Return F of one particle without neighbours, `[q, view, p]`, nm: light and views by cosine, waves' azimuths."""
    sphere = layer.mean.spheres[0]
    lit = sphere.directions(np.array([light]), is_lit_from_below)
    v = with_negative_orders(lit.excitation, layer.index)[:, :, 0]
    u = with_negative_orders(sphere.directions(views).emission, layer.index)
    m = layer.index.m
    b = layer.dressed @ (np.exp(-1j * m * wave)[:, None] * v.T)
    return np.einsum("qnv,nv,np->qvp", u, np.exp(1j * np.outer(m, away)), b) / layer.mean.surface.inner_wavenumber


def test_the_mean_over_turns_is_the_averaged_particle(monkeypatch):
    """Its field exactly, alone in space; the power that it leaves out is what the file's reader says."""
    layer = dimers(1.0, mmax=5)
    averaged = AlignedLayer(layer.mean, spread_blocks(known().blocks[0], multipole_index(known().lmax)))
    views, away = np.array([0.3, 0.9]), np.array([0.5, 2.0])
    turns = azimuth_nodes(16)
    fields = np.stack([_alone(layer, 0.6, views, 0.2 - t, away - t) for t in turns])
    expected = _alone(averaged, 0.6, views, 0.2, away)
    assert np.abs(fields.mean(axis=0) - expected).max() <= SAME * np.abs(fields).max()
    # |F|^2 summed over all light and views: u and v of both sides at the nodes of a product rule
    mu, weights = hemisphere_rule(8)
    sphere, m, around = layer.mean.spheres[0], layer.index.m, azimuth_nodes(24)
    sums = np.zeros((2, len(m), len(m)), dtype=complex)
    for below in (False, True):
        made = sphere.directions(mu, below)
        for k, (vectors_of, sign) in enumerate(((made.emission, 1), (made.excitation, -1))):
            w = (
                with_negative_orders(vectors_of, layer.index)[..., None]
                * np.exp(sign * 1j * np.outer(m, around))[:, None]
            )
            sums[k] += np.einsum("pnaf,pkaf,a->nk", w, w.conj(), weights, optimize=True)
    powers = [
        np.einsum("nk,nj,ji,ki->", sums[0], one.dressed, sums[1], one.dressed.conj(), optimize=True).real
        for one in (layer, averaged)
    ]
    with pytest.raises(TMatrixFileError, match=r"5\.1 % of what it scatters"):
        read_tmatrices(FILE)
    monkeypatch.setattr(tmatrix_file, "TURN_TOLERANCE", 0.1)
    left_out = read_tmatrices(FILE).turn_loss  # at 500 nm, which is the more
    assert left_out > 0.01 and 1 - powers[1] / powers[0] == pytest.approx(left_out, rel=1e-6)


# -- other codes ------------------------------------------------------------------------------------------


def test_one_particle_in_free_space_scatters_as_treams_says():
    treams = pytest.importorskip("treams.io").treams

    layer = dimers(1.0, wavelength=600.0, mmax=5)
    matrix = treams.io.load_hdf5(str(FILE))[1]
    light, wave = 0.7, 0.4
    theta, away = np.radians([10.0, 40.0, 75.0]), np.array([0.3, 2.0, 4.5])
    found = _alone(layer, np.cos(light), np.cos(theta), wave, away)
    phi = np.array([np.cos(wave), np.sin(wave)])
    for pol in range(2):
        vector = layer.mean.surface.wavenumber * np.array([*(np.sin(light) * phi), -np.cos(light)])
        field = [-phi[1], phi[0], 0.0] if pol == 0 else [*(-np.cos(light) * phi), -np.sin(light)]
        sent = matrix @ treams.plane_wave(vector, field, k0=float(matrix.k0), material=1, poltype="parity").expand(
            matrix.basis
        )
        for i, (t, p) in enumerate(zip(theta, away, strict=True)):
            place = 1e9 * np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
            theirs = np.sum(np.abs(np.asarray(sent.efield(place))) ** 2) * 1e18
            assert np.sum(np.abs(found[:, i, pol]) ** 2) == pytest.approx(theirs, rel=OTHER_CODE)


def _two_spheres(below, centre, theta_i, wave, theta_s, away, is_lit_from_below=False):
    """Return F of the two spheres, each solved as a sphere over the stack, `[q, view, view azimuth, p]`."""
    order = 6
    pair = [Particle(1.0, centre, t_matrix(order, below.wavenumber * r, INDEX)) for r in RADII]
    coupling, kinds = Coupling.build(below, pair[0], APART, APART + 1.0, pair[1]), np.array([0, 1])
    places = np.array([[-APART / 2, 0.0], [APART / 2, 0.0]])

    def waves(theta, azimuths, is_below=False):
        made = Directions.build(below, centre, order, order, np.cos(theta), is_below)
        return plane_waves(made, np.asarray(azimuths), order, below.wavenumber, made)

    light, views = waves(np.array([theta_i]), [wave], is_lit_from_below), waves(theta_s, away)
    found = coupling.far_field(places, coupling.solve(places, light, kinds), views, kinds)
    return found.reshape(2, len(theta_s), len(away), 2)


@pytest.mark.parametrize(("substrate", "films"), [(1.5, ()), (4.3 + 0.07j, ((1.46, 120.0),))])
def test_one_particle_over_a_stack_scatters_as_the_two_spheres_that_it_is(substrate, films):
    layer = dimers(substrate, films=films)
    theta, away, wave = np.radians([5.0, 35.0, 70.0]), np.array([0.2, 1.9, 3.3, 5.0]), 0.6
    expected = _two_spheres(layer.mean.surface, HEIGHT / 2 + 60.0, 0.8, wave, theta, away)
    at, around = np.repeat(np.cos(theta), 4), np.tile(away, 3)
    found = _alone(layer, np.cos(0.8), at, wave, around).reshape(2, 3, 4, 2)
    assert np.abs(found - expected).max() <= EXPANDED * np.abs(expected).max()


@pytest.mark.parametrize("is_lit_from_below", [False, True])
def test_one_particle_inside_a_layer_scatters_as_the_two_spheres_that_it_is(is_lit_from_below):
    """Between a film of high index above, which sends much back, and what is below; the layer has the file's index."""
    last = 1.5 if is_lit_from_below else 4.3 + 0.07j
    within = Embedded(500.0, np.array([1.0, 2.1, 1.0, last], complex), np.array([70.0, 330.0]), 2)
    layer, centre = _inside(within), 180.0
    theta, away, wave = np.radians([5.0, 35.0, 70.0]), np.array([0.2, 1.9, 3.3, 5.0]), 0.6
    light = np.cos(0.5 if is_lit_from_below else 0.8)
    expected = _two_spheres(within, centre, np.arccos(light), wave, theta, away, is_lit_from_below)
    at, around = np.repeat(np.cos(theta), 4), np.tile(away, 3)
    found = _alone(layer, light, at, wave, around, is_lit_from_below).reshape(2, 3, 4, 2)
    assert np.abs(found - expected).max() <= EXPANDED * np.abs(expected).max()
    over = dimers(last, gap=centre - HEIGHT / 2)  # without the film it is another answer
    assert np.abs(np.abs(_alone(over, 0.7, at, wave, around)) - np.abs(_alone(layer, 0.7, at, wave, around))).max() > (
        0.1 * np.abs(expected).max()
    )


def test_where_nothing_absorbs_and_nothing_guides_all_light_comes_out_of_a_layer():
    """The energy of the whole monolayer inside, at each azimuth; a layer no denser than its sides guides no light."""
    within = Embedded(500.0, np.array([1.0, 1.0, 1.5], complex), np.array([330.0]), 1)
    layer = _inside(within, whole=_lossless())
    over = dimers(1.5, gap=180.0 - HEIGHT / 2, whole=_lossless())
    cosines = np.cos(np.radians([0.0, 30.0, 55.0]))
    for azimuth in (0.0, 0.7):
        parts = np.stack(aligned_powers(layer, cosines, azimuth))
        assert np.abs(parts.sum(axis=0) - 1.0).max() <= QCA_ENERGY
        assert np.abs(parts - np.stack(aligned_powers(over, cosines, azimuth))).max() <= SAME


def _inside(within, centre=180.0, whole=None):
    mean = dimers(1.5).mean
    structure = hard_disk_structure(mean.structure.density_per_nm2, 0.4, 4.5 * within.wavenumber * 1.5)
    inner = Monolayer(within, (dataclasses.replace(mean.particles[0], centre_nm=centre),), structure)
    return AlignedLayer(inner, known().full[0] if whole is None else whole)


@pytest.mark.parametrize("turn_deg", [0.0, 40.0])
def test_a_thin_layer_sends_what_its_particles_do_alone(turn_deg):
    """The whole way to a value of the lobe, against spheres over the stack, at azimuths of both directions."""
    films, density = ((1.46, 120.0),), 1e-9
    coverage = density * np.pi * (LENGTH / 2) ** 2
    layer = dimers(4.3 + 0.07j, coverage, coverage, films)
    lobe = lobes(layer, 48, turn=np.radians(turn_deg))[1]
    theta, away = np.radians([12.0, 40.0, 66.0]), np.array([0.2, 1.1, 1.9, 3.3, 5.0])
    for theta_i, phi_i in ((0.3, 0.0), (0.8, 1.2), (1.2, 2.5)):
        turn = np.radians(turn_deg)
        # the light's wavevector runs from phi_i away; all azimuths count from the particles' long axis
        fields = _two_spheres(layer.mean.surface, HEIGHT / 2 + 60.0, theta_i, phi_i + np.pi - turn, theta, away - turn)
        cosines = np.cos(theta)[:, None] * np.cos(theta_i)
        expected = density * 0.5 * np.sum(np.abs(fields) ** 2, axis=(0, 3)) / cosines
        wo = direction(theta[:, None], away)
        found = lobe.evaluate(np.broadcast_to(direction(theta_i, phi_i), wo.shape), wo)[..., 0]
        assert np.sqrt(np.mean((found - expected) ** 2)) <= LINES * np.sqrt(np.mean(expected**2))


# -- energy and reciprocity -------------------------------------------------------------------------------


def _lossless():
    """Return the file's T without its absorption: the unitary matrix next to 1 + 2 T."""
    u, _, vh = np.linalg.svd(np.eye(known().full.shape[-1]) + 2 * known().full[0])
    return 0.5 * (u @ vh - np.eye(len(u)))


@pytest.mark.parametrize(("substrate", "coverage", "packing"), [(1.0, 0.1, 0.4), (1.0, 0.2, 0.4), (1.5, 0.1, 0.4)])
def test_where_nothing_absorbs_all_light_comes_back(substrate, coverage, packing):
    """At each azimuth, though R, T and what is scattered change with it: the mean field's own balance of energy."""
    layer = dimers(substrate, coverage, packing, whole=_lossless())
    assert np.abs(reversed_full(layer.full) - layer.full).max() <= SAME
    cosines = np.cos(np.radians([0.0, 30.0, 55.0]))
    parts = np.stack([np.stack(aligned_powers(layer, cosines, a)) for a in (0.0, 0.5, np.pi / 2)])
    assert np.abs(parts.sum(axis=1) - 1.0).max() <= QCA_ENERGY
    assert np.ptp(parts[:, 2:], axis=0).max() > 0.01  # the diffuse part changes with the azimuth


@pytest.mark.parametrize("below", [None, PolarGrid(16, 10, 1.5)])
def test_lobes_are_reciprocal_and_keep_energy(below):
    layer = dimers(4.3 + 0.07j, films=((1.46, 120.0),)) if below is None else dimers(1.5, whole=_lossless())
    made = lobes(layer, 24, below, turn=0.7)
    both = below is not None
    a, b = vectors(2000, 4, both), vectors(2000, 5, both)
    index = [np.where(w[:, 2:] > 0, 1.0, made[1].eta) for w in (a, b)]
    forth, back = made[1].evaluate(a, b) / index[1] ** 2, made[1].evaluate(b, a) / index[0] ** 2
    assert np.abs(forth - back).max() <= SAME * forth.max() and forth.min() >= 0.0
    light = np.concatenate([direction(np.radians([0.0, 20.0, 50.0, 75.0, 86.0]), 0.3), vectors(10, 6, both)])
    reflected, passed = directional_hemispherical(Bsdf(made), light)
    assert np.all(reflected + passed <= 1.0 + 2e-3)  # a quadrature of 64 nodes over the critical angle's kink
    turned = light * [-1.0, -1.0, 1.0]
    for one, way in zip(light, turned, strict=True):
        phi, opposite = (np.arctan2(w[1], w[0]) for w in (one, way))
        mirror = [made[0].specular_at(one[2], p).reflectance for p in (phi, opposite)]
        assert np.abs(mirror[0] - mirror[1]).max() <= 1e-6  # mirror light takes its way back


def test_a_file_is_written_and_read_the_same(tmp_path):
    write_tmatrices(tmp_path / "again.tmat.h5", known())
    again = read_tmatrices(tmp_path / "again.tmat.h5", is_aligned=True)
    assert np.abs(again.full - known().full).max() <= 1e-15
    treams = pytest.importorskip("treams.io").treams
    theirs, ours = (treams.io.load_hdf5(str(p))[0] for p in (FILE, tmp_path / "again.tmat.h5"))
    assert np.abs(np.asarray(theirs) - np.asarray(ours)).max() <= 1e-15


# -- the example ------------------------------------------------------------------------------------------


def test_the_rods_of_the_example_lie_along_u_until_they_are_turned():
    """At the normal the light that swings along them, p of the plane of u, meets their long resonance; s does not."""
    rods = nacre.load(EXAMPLE)
    seen = {
        (turn, pol): rods.vary({"particle.turn_deg": turn}).model.spectrum([0.0], np.array([640.0]), pol)
        for turn in (0.0, 90.0)
        for pol in "sp"
    }
    mirror = {key: float(one.specular_reflectance[0, 0]) for key, one in seen.items()}
    assert mirror[0.0, "p"] > 2 * mirror[0.0, "s"]
    assert mirror[90.0, "s"] == pytest.approx(mirror[0.0, "p"], abs=SAME)
    assert mirror[90.0, "p"] == pytest.approx(mirror[0.0, "s"], abs=SAME)


def test_a_few_values_of_the_example_are_those_of_its_tables():
    rods, nm = nacre.load(EXAMPLE).vary({"particle.turn_deg": 25.0}), np.array([560.0, 640.0])
    wi, wo = direction(np.radians([45.0, 45.0]), 0.0), direction(np.radians([30.0, 20.0]), [np.pi, 0.0])
    expected = rods.bsdf(nm).evaluate(wi, wo)
    few = rods.model.values_at(wi, wo, nm)
    assert np.abs(few - expected).max() <= LINES * expected.max()
    assert rods.model.values_at(*(2 * [direction(np.radians(np.linspace(0, 80, 30)))]), nm) is None


def test_the_example_s_file_is_what_its_tool_writes_and_a_turned_upright_rod():
    nm = np.array([640.0])
    again = tool.lying_spheroid(tool.LENGTH_NM, tool.WIDTH_NM, "Ag", tool.FILM_INDEX, nm, tool.ORDER)
    held = read_tmatrices(EXAMPLE.with_name("silver_rods.tmat.h5"), is_aligned=True)
    at = int(np.argmin(np.abs(held.wavelengths_nm - 640.0)))
    assert np.abs(held.full[at] - again.full[0]).max() <= 2 * tool.KEPT * np.abs(held.full).max()
    upright = spread_blocks(again.blocks[0], multipole_index(tool.ORDER))
    assert np.abs(tool.tilted_full(again.full[0], -np.pi / 2) - upright).max() <= 1e-7 * np.abs(upright).max()
