"""Many spheres solved together: one sphere, another code, energy, reciprocity, the stack's part, single precision."""

import numpy as np
import pytest
from helpers_metasurface import surface, t_matrix
from validation._metasurface_helpers import plane_waves

from nacre.families.metasurface.monolayer.monolayer import Particle
from nacre.families.metasurface.supercells import Coupling, direct_coupling, reflected_coupling
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, multipole_index, reciprocal
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    Directions,
    ParticleOnStack,
    amplitude,
    hemisphere_rule,
    reflection_operator,
)
from nacre.families.metasurface.tmatrix.particle_shapes import Mesh, block_t_matrix, cylinder_panels
from nacre.families.metasurface.tmatrix.tmatrix_file import write_tmatrices

SINGLE = 2e-5  # of the largest amplitude: the matrix is in single precision, its tables good to 1e-5
STACKS = {"glass": (1.5, ()), "oxide": (4.3 + 0.07j, ((1.46, 400.0),))}
AROUND = 2 * np.pi * np.arange(12) / 12
PLACES = np.array([[0.0, 0.0], [190.0, 30.0], [-120.0, 260.0], [900.0, -640.0], [-1500.0, -300.0]])


def _waves(below, centre, order, theta, azimuths, under=False):
    directions = Directions.build(below, centre, order, order, np.cos(theta), under)
    return plane_waves(directions, np.asarray(azimuths), order, below.wavenumber)


def _coupled(below, radius, m, order, places=PLACES):
    t = t_matrix(order, below.wavenumber * radius, m)
    gaps = [np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]] or [2 * radius, 3 * radius]
    return Coupling.build(below, Particle(1.0, radius, t), min(gaps), max(gaps))


@pytest.mark.parametrize("name", STACKS)
def test_one_sphere_alone_is_the_sphere_on_the_stack(name):
    below, theta = surface(500.0, *STACKS[name]), np.array([0.2, 0.9])
    coupling = _coupled(below, 90.0, 0.05 + 3.1j, 3, PLACES[:1])
    light, view = _waves(below, 90.0, 3, theta, [0.4]), _waves(below, 90.0, 3, theta, AROUND)
    found = coupling.far_field(PLACES[:1], coupling.solve(PLACES[:1], light), view).reshape(2, 2, 12, 2, 2)
    alone = ParticleOnStack(below, 90.0, t_matrix(3, below.wavenumber * 90.0, 0.05 + 3.1j), 3)
    directions = alone.directions(np.cos(theta))
    plain = np.moveaxis(amplitude(alone.harmonics(directions, directions), AROUND - 0.4), 4, 2)
    assert np.abs(found - plain).max() <= SINGLE * np.abs(plain).max()


def _disc(order, wavelength):
    """Return T of a flat disc, `[m, n, n']`: full blocks, which mix l and magnetic with electric."""
    n, k = 3.9 + 0.02j, 2 * np.pi / wavelength
    return reciprocal(block_t_matrix(Mesh(cylinder_panels(75.0 * k, 60.0 * k, abs(n))[0]), n, order))


@pytest.mark.parametrize("shape", ["sphere", "disc"])
def test_particles_in_free_space_agree_with_treams(shape, tmp_path):
    treams = pytest.importorskip("treams.io").treams
    radius, m, order, k = 75.0, 3.9 + 0.02j, 3, 2 * np.pi / 600.0
    places = PLACES[:4]
    below = surface(600.0, 1.0)
    if shape == "sphere":
        coupling = _coupled(below, radius, m, order, places)
        one = treams.TMatrix.sphere(order, k, radius, [m**2, 1.0])
    else:
        t = _disc(order, 600.0)
        coupling = Coupling.build(below, Particle(1.0, radius, t), 180.0, 2000.0)
        known = AxialTMatrices(np.array([600.0]), t[None], np.ones(1))
        write_tmatrices(tmp_path / "disc.tmat.h5", known)
        one = treams.io.load_hdf5(str(tmp_path / "disc.tmat.h5"))[0].changepoltype("helicity")
        one = treams.TMatrix(np.asarray(one), k0=k, basis=one.basis, material=1.0, poltype="helicity")
    theta_i, theta_s = 0.7, np.array([0.3, 1.2])
    light, view = (
        _waves(below, radius, order, np.array([theta_i]), [0.5]),
        _waves(below, radius, order, theta_s, AROUND),
    )
    found = coupling.far_field(places, coupling.solve(places, light), view).reshape(2, 2, 12, 2)
    at = np.concatenate([places, np.full((4, 1), radius)], axis=1)
    cluster = treams.TMatrix.cluster([one for _ in places], at).interaction.solve()
    travel = k * np.array([np.sin(theta_i) * np.cos(0.5), np.sin(theta_i) * np.sin(0.5), -np.cos(theta_i)])
    r = np.array([theta_s[:, None] + 0 * AROUND, AROUND + 0 * theta_s[:, None]])
    far = 1e9
    outward = np.stack([np.sin(r[0]) * np.cos(r[1]), np.sin(r[0]) * np.sin(r[1]), np.cos(r[0])], axis=-1)
    azimuthal = np.stack([-np.sin(r[1]), np.cos(r[1]), 0 * r[1]], axis=-1)
    polar = np.stack([np.cos(r[0]) * np.cos(r[1]), np.cos(r[0]) * np.sin(r[1]), -np.sin(r[0])], axis=-1)
    fields = np.array([[-np.sin(0.5), np.cos(0.5), 0.0],
                       [np.cos(theta_i) * np.cos(0.5), np.cos(theta_i) * np.sin(0.5), np.sin(theta_i)]])  # fmt: skip
    for pol, field in enumerate(fields):
        parts = [treams.plane_wave(travel, hand, k0=k, material=1.0, poltype="helicity") for hand in (0, 1)]
        shares = np.linalg.lstsq(
            np.stack([np.asarray(p.efield(np.zeros(3))) for p in parts], axis=1), field, rcond=None
        )[0]
        sent = sum(
            share * np.asarray((cluster @ wave.expand(cluster.basis)).efield(far * outward)) * far
            for share, wave in zip(shares, parts)
        )
        expected = np.stack([(sent * azimuthal).sum(axis=-1), (sent * polar).sum(axis=-1)])
        assert np.abs(np.abs(found[..., pol]) - np.abs(expected)).max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("index", [1.0, 1.5])
def test_a_lossless_cluster_sends_out_what_it_takes_from_both_beams(index):
    """The optical theorem, over nothing and over glass: it sees the stack's part of every coupling."""
    below, order, radius, theta = surface(600.0, index), 2, 75.0, np.array([0.8])
    coupling = _coupled(below, radius, 3.9, order)
    solved = coupling.solve(PLACES, _waves(below, radius, order, theta, [0.3]))
    around = 2 * np.pi * np.arange(96) / 96
    power = 0.0
    for under in (False, True):
        mu, weights = hemisphere_rule(40, index if under else 1.0)
        far = coupling.far_field(PLACES, solved, _waves(below, radius, order, np.arccos(mu), around, under))
        squares = np.abs(far.reshape(2, mu.size, 96, 2)) ** 2
        power = power + (index if under else 1.0) * np.einsum("qsap,s->p", squares, weights) * 2 * np.pi / 96
    inner = np.arcsin(np.sin(theta) / index)
    bare = Directions.build(below, radius, order, order, np.cos(theta)).reflection[:, 0]
    through = Directions.build(below, radius, order, order, np.cos(inner), True).transmission_up[:, 0]
    through = through * np.cos(theta) / (index * np.cos(inner))
    taken = 0.0
    for beam, angle, under in ((bare, theta, False), (through, inner, True)):
        ahead = coupling.far_field(PLACES, solved, _waves(below, radius, order, angle, [0.3], under))
        taken = taken - 4 * np.pi / below.wavenumber * (beam.conj() * np.diagonal(ahead)).real
    assert np.abs(power / taken - 1).max() <= 1e-3


@pytest.mark.parametrize("name", STACKS)
def test_far_fields_are_reciprocal(name):
    """|F_qp(s, i)| = |F_pq(i, s)| with both directions turned about: light sent back the way it came."""
    below = surface(500.0, *STACKS[name])
    coupling = _coupled(below, 90.0, 0.05 + 3.1j, 2)
    theta, azimuths = np.array([0.3, 1.1]), AROUND[:6]
    light, view = _waves(below, 90.0, 2, theta, azimuths), _waves(below, 90.0, 2, theta, azimuths + np.pi)
    f = np.abs(coupling.far_field(PLACES, coupling.solve(PLACES, light), view))
    assert np.abs(f - f.T).max() <= SINGLE * f.max()


@pytest.mark.parametrize("name", STACKS)
def test_the_stack_couples_a_sphere_to_itself_as_its_reflection_operator(name):
    below, index = surface(500.0, *STACKS[name]), multipole_index(2)
    found = reflected_coupling(below, 90.0, 2, np.array([1e-9]))[:, :, 0]
    blocks = reflection_operator(below, 90.0, 2, 2)
    for a, b in np.ndindex(*found.shape):
        expected = 0.0
        if index.m[a] == index.m[b] >= 0:
            expected = blocks[index.m[a], index.block[a], index.block[b]]
        elif index.m[a] == index.m[b]:
            continue
        assert abs(found[a, b] - expected) <= 1e-6 * np.abs(blocks).max()


@pytest.mark.parametrize("name", STACKS)
def test_the_contour_serves_a_patch_of_many_wavelengths(name):
    """At k R = 110 a deep detour would lose every digit to the growth of the Bessel functions."""
    below, far = surface(500.0, *STACKS[name]), np.array([3.0, 40.0, 110.0])
    whole = reflected_coupling(below, 90.0, 2, far)
    longer = reflected_coupling(below, 90.0, 2, far, reach=160.0)
    size = np.abs(direct_coupling(2, far)).max(axis=(0, 1))
    assert np.all(np.abs(whole - longer).max(axis=(0, 1)) <= 1e-6 * size)
