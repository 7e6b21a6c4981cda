"""Particles that are no spheres over a stack: finite elements, another code, reciprocity, energy, refusals."""

import dataclasses

import numpy as np
import pytest
from helpers_metasurface import REFERENCE, reference, surface
from validation._metasurface_helpers import cross_sections, plane_waves

import nacre
from nacre.families.metasurface.ensemble import same_order
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.species import convergence_error, place
from nacre.families.metasurface.supercells import Coupling
from nacre.families.metasurface.tmatrix.axisymmetric import TabulatedBody, as_blocks, truncated
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    NODES,
    Directions,
    ParticleOnStack,
    amplitude,
    hemisphere_rule,
    reflection_operator,
    truncated_reflection_operator,
    wavenumber_cutoff,
)
from nacre.families.metasurface.tmatrix.tmatrix_file import read_tmatrices

FEM_SPHEROID, FEM_DISC, FEM_NEAR = 2e-3, 1e-2, 2e-2  # relative L2 of d sigma/d Omega at l = 10: the bars
SAME_TRUNCATION = 2e-6  # against SMUTHI at the same orders; its own contour leaves 1e-7 of the whole, 1e-6 of one row
RECIPROCITY = 1e-10


def _known(i):
    path = REFERENCE / "tmat" / f"tmat_open_{i:02d}.h5"
    if not path.is_file():
        pytest.skip("../shared/reference is absent")
    return read_tmatrices(path)


def _row(data, kind, row):
    known = _known(int(data[f"{kind}_particle"][row]))
    films = []
    if data[f"{kind}_substrate"][row] != "glass":
        films = [(complex(data["n_film"]), float(data[f"{kind}_film_h_nm"][row]))]
    below = surface(known.wavelengths_nm[0], data[f"{kind}_n_substrate"][row], films)
    return known, below, float(data[f"{kind}_gap_nm"][row])


def _pattern(alone, data, kind, row):
    light = alone.directions([np.cos(np.radians(data[f"{kind}_theta_i_deg"][row]))])
    f = amplitude(alone.harmonics(alone.directions(np.cos(data["sub_theta_s_rad"])), light), data["sub_phi_rad"])
    return np.abs(f[:, :, int(data[f"{kind}_pol_in"][row]), 0]) ** 2 * 1e-6


def _error(found, truth):
    return np.linalg.norm(found - truth) / np.linalg.norm(truth)


def test_over_glass_and_film_spheroids_and_discs_scatter_as_finite_elements_say():
    data = reference("particles_open.npz")
    for row in range(len(data["sub_particle"])):
        known, below, gap = _row(data, "sub", row)
        body = TabulatedBody(known, known.radius_nm, known.height_nm, known.circumscribing_nm, "x")
        placed = place(body, below, gap)
        assert not placed.is_near and placed.change <= 0.02
        alone = ParticleOnStack(below, placed.particle.centre_nm, placed.particle.t_matrix, int(data["sub_mmax"]))
        found = _pattern(alone, data, "sub", row)
        bar = FEM_SPHEROID if "spheroid" in known.name else FEM_DISC
        assert _error(found, data["sub_dsigma_fem_um2_per_sr"][row]) <= bar, (row, known.name)
        assert _error(found, data["sub_dsigma_um2_per_sr"][row]) <= SAME_TRUNCATION, (row, known.name)


def test_close_to_the_stack_flat_particles_scatter_as_finite_elements_say():
    data = reference("particles_open.npz")
    for row in range(len(data["near_particle"])):
        known, below, gap = _row(data, "near", row)
        body = TabulatedBody(known, known.radius_nm, known.height_nm, known.circumscribing_nm, "x")
        placed = place(body, below, gap)
        assert placed.is_near and placed.change <= 0.02
        p = placed.particle
        found = _pattern(ParticleOnStack(below, p.centre_nm, p.t_matrix, 6, p.cut), data, "near", row)
        assert _error(found, data["near_dsigma_fem_um2_per_sr"][row]) <= FEM_NEAR, (row, known.name)


def test_where_two_cuts_disagree_the_least_gap_is_named_and_works():
    known = _known(1)
    low = dataclasses.replace(known, blocks=truncated(known.blocks[0], 4)[None])
    body = TabulatedBody(low, known.radius_nm, known.height_nm, known.circumscribing_nm, "disc.toml")
    below = surface(620.0, 4.0 + 0.03j)
    placed = place(body, below, 1.0)
    assert placed.is_near and placed.change > 0.02
    line = str(convergence_error(body, below, 1.0, placed, 0.02, None, "particle.second"))
    assert "the least particle.second.gap_nm that works" in line
    gap = float(line.rsplit(" ", 1)[1])
    assert 1.0 < gap < known.circumscribing_nm and place(body, below, gap).change <= 0.02


def test_a_cut_far_out_is_no_cut():
    below = surface(600.0, 1.5)
    whole = reflection_operator(below, 120.0, 3, 3)
    found = truncated_reflection_operator(below, 120.0, 3, 3, 30.0, nodes=800)
    assert np.abs(found - whole).max() <= 1e-7 * np.abs(whole).max()
    usual, fine = (truncated_reflection_operator(below, 40.0, 10, 4, 7.0, nodes=n) for n in (NODES, 900))
    assert np.abs(usual - fine).max() <= 1e-7 * np.abs(fine).max()
    assert wavenumber_cutoff(10, 0.01, 72.0) == pytest.approx(6.0 / 0.72)


def test_blocks_of_a_sphere_are_dressed_as_its_diagonal_is():
    t = np.array([-0.3 + 0.4j, -0.02 + 0.1j, 1e-3j - 1e-6, -0.5 + 0.4j, -0.1 + 0.2j, 2e-3j - 4e-6])
    below = surface(500.0, 4.0 + 0.05j)
    diagonal = ParticleOnStack(below, 80.0, t, 3).dressed
    whole = ParticleOnStack(below, 80.0, as_blocks(t), 3).dressed
    l = np.tile(np.arange(1, 4), 2)
    seen = (l >= np.arange(4)[:, None])[:, :, None] & (l >= np.arange(4)[:, None])[:, None]
    assert np.abs(np.where(seen, whole - diagonal, 0.0)).max() < 1e-13


@pytest.mark.parametrize("substrate", [1.5, 4.3 + 0.07j])
@pytest.mark.parametrize(("particle", "gap"), [(3, 12.0), (5, 8.0)])
def test_one_disc_is_reciprocal(substrate, particle, gap):
    known = _known(particle)
    body = TabulatedBody(known, known.radius_nm, known.height_nm, known.circumscribing_nm, "x")
    below = surface(known.wavelengths_nm[0], substrate, [(1.46, 200.0)])
    p = place(body, below, gap).particle
    alone = ParticleOnStack(below, p.centre_nm, p.t_matrix, 4, p.cut)
    sides = [alone.directions(np.cos([0.1, 0.7, 1.3]))]
    if substrate == 1.5:
        sides.append(alone.directions(np.cos([0.2, 0.8, 1.4]), below=True))
    for a in sides:
        for b in sides:
            there = np.abs(alone.harmonics(a, b)) ** 2
            back = np.abs(alone.harmonics(b, a)) ** 2
            assert np.abs(there - back.transpose(0, 3, 4, 1, 2)).max() <= RECIPROCITY * there.max()


def test_a_disc_on_glass_absorbs_what_it_does_not_scatter():
    """Extinction (two interferences) and scattering (an integral) share no formula; the index says how much is lost."""
    known = _known(3)
    p = Particle(1.0, known.height_nm / 2 + 12.0, known.blocks[0])
    alone = ParticleOnStack(surface(600.0, 1.5), p.centre_nm, p.t_matrix, 6)
    found = cross_sections(alone, np.cos([0.0, 0.6, 1.1]))
    lost = found.absorption / found.extinction
    assert np.all(lost > 0.0) and np.all(lost < 0.2)
    free = ParticleOnStack(surface(600.0, 1.0), p.centre_nm, p.t_matrix, 6)
    data = reference("particles_open.npz")
    there = cross_sections(free, np.cos(np.radians([0.0, 45.0])))
    assert there.extinction.T == pytest.approx(data["sigma_ext_nm2"][3, :2], rel=2e-4)
    scattered = (there.scattered_up + there.scattered_down).T
    assert scattered == pytest.approx(data["sigma_sca_nm2"][3, :2], rel=2e-4)


def _layer(particle, gap, coverage=0.06, substrate=1.5, **more):
    known = _known(particle)
    body = TabulatedBody(known, known.radius_nm, known.height_nm, known.circumscribing_nm, "x")
    below = surface(known.wavelengths_nm[0], substrate)
    density = coverage / np.pi / known.radius_nm**2
    packing = max(0.12, 1.01 * coverage * (known.circumscribing_nm / known.radius_nm) ** 2)
    structure = hard_disk_structure(density, packing, 4.5 * below.wavenumber * max(1.0, below.index_below))
    return Monolayer(below, (place(body, below, gap).particle,), structure, "qca-balanced", **more)


@pytest.mark.parametrize(("particle", "gap"), [(3, 12.0), (1, 5.0), (9, 60.0)])
def test_the_mean_field_of_discs_is_reciprocal_and_keeps_energy(particle, gap):
    layer = _layer(particle, gap)
    mu, weights = hemisphere_rule(16)
    below_mu, below_weights = hemisphere_rule(14, 1.5)
    sides = [(layer.illuminate(mu), weights), (layer.illuminate(below_mu, True), below_weights)]
    term = diffuse_term(layer, sides, 8)
    swapped = term.coherent.transpose(1, 0, 3, 2, 4)
    assert np.abs(term.coherent - swapped).max() <= RECIPROCITY * np.abs(term.coherent).max()
    reflected, passed = layer.specular_above(mu)
    count = mu.size
    total = reflected + passed + (term.above + term.below)[:, :count] / mu
    assert np.all(total[:, mu > 0.1] <= 1.0)
    assert np.all(total > 0.0)


def test_the_mean_fields_power_is_what_independent_discs_extinguish_where_they_are_rare():
    layer = _layer(3, 12.0, coverage=1e-4)
    cosines = np.cos([0.0, 0.7])
    reflected, passed = layer.specular_above(cosines)
    bare = layer.spheres[0].directions(cosines)
    r = np.abs(bare.reflection) ** 2
    loss = (1.0 - reflected - passed) * cosines  # the bare glass loses nothing
    wanted = layer.structure.density_per_nm2 * cross_sections(layer.spheres[0], cosines).extinction
    assert np.all(r < 1) and loss == pytest.approx(wanted, rel=5e-3)


@pytest.mark.parametrize("gap", [40.0, 3.0])
def test_one_disc_of_an_ensemble_is_the_disc_on_the_stack(gap):
    known = _known(1)
    below = surface(620.0, 1.5)
    layer = _layer(1, gap)
    particle = same_order(layer, 2, layer.particles[0]).particles[0]
    assert known.lmax == 10 and particle.lmax == 2 and (particle.cut is not None) == (gap < 10)
    coupling = Coupling.build(below, particle, 200.0, 400.0)
    light = Directions.build(below, particle.centre_nm, 2, 2, np.cos([0.3, 0.9]))
    azimuths = 2 * np.pi * np.arange(8) / 8
    waves = plane_waves(light, np.array([0.0]), 2, below.wavenumber)
    views = plane_waves(light, azimuths, 2, below.wavenumber)
    place_nm = np.array([[0.0, 0.0]])
    f = coupling.far_field(place_nm, coupling.solve(place_nm, waves), views).reshape(2, 2, 8, 2, 2)
    alone = ParticleOnStack(below, particle.centre_nm, particle.t_matrix, 2, particle.cut)
    wanted = amplitude(alone.harmonics(light, light), azimuths)
    assert np.abs(f.transpose(0, 1, 3, 4, 2) - wanted).max() <= 2e-5 * np.abs(wanted).max()


@pytest.mark.full
def test_an_ensemble_of_discs_refines_the_mean_field(tmp_path):
    import shutil

    _known(3)
    shutil.copy(REFERENCE / "tmat" / "tmat_open_03.h5", tmp_path / "rod.tmat.h5")
    (tmp_path / "rod.toml").write_text(
        'family = "metasurface"\nsubstrate = {n = 1.5}\n[particle]\ntmatrix = "rod.tmat.h5"\ngap_nm = 12\n'
        "[monolayer]\ncoverage = 0.03\npacking = 0.2\n"
        '[model]\ncorrection = "ensemble"\nensemble = {spheres = 40, realisations = 8}\n'
    )
    model = nacre.load(tmp_path / "rod.toml").model
    direction = np.array([[0.5, 0.0, np.sqrt(0.75)]])
    corrected = model.values_at(direction, direction[:, [1, 0, 2]], np.array([600.0]))
    plain = dataclasses.replace(model, correction="qca-balanced").values_at(
        direction, direction[:, [1, 0, 2]], np.array([600.0])
    )
    # the mean field of dilute discs was not measured; of spheres it holds to 12 %, and small patches are noisy
    assert corrected == pytest.approx(plain, rel=0.3) and corrected != pytest.approx(plain, rel=1e-6)
