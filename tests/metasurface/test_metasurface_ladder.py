"""The light that neighbours pass on: against pair integrals in space, energy, reciprocity, mixtures, refusals."""

import dataclasses

import numpy as np
import pytest
from helpers_metasurface import monolayer, surface, t_matrix

import nacre
from nacre.core.errors import UnsupportedError
from nacre.families.metasurface.monolayer import diffuse
from nacre.families.metasurface.monolayer import qca as ladder_module
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.qca import Modes
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.supercells import direct_coupling, reflected_coupling
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index, spread_blocks
from nacre.families.metasurface.tmatrix.particle_on_stack import hemisphere_rule

FAINT = 1e-3  # of M: what is passed on twice is then nothing
# at a wavenumber of 40 over the least distance: the jump of g at contact leaves some 3/kappa
PAIR_BAR = 0.08
ENERGY_BAR = 0.06  # half of the 12 % up to which a mean field is taken
DARK_BAR = 0.08  # S(0) = 1 - 4 p of the places, p = .02, in all vertices
SILVER = 0.05 + 3.1j


def ladder(*args, **more):
    return monolayer(*args, correction="qca-ladder", **more)


def _whole(layer, x):
    mu, w = hemisphere_rule(20)
    mu_b, w_b = hemisphere_rule(16, layer.surface.index_below)
    sides = [
        (layer.illuminate(np.concatenate([mu, x])), np.concatenate([w, 0 * x])),
        (layer.illuminate(mu_b, True), w_b),
    ]
    term = diffuse_term(layer, sides, 11)
    return sum(layer.specular_above(x)) + (term.above + term.below)[:, 20 : 20 + x.size] / x, term


@pytest.mark.parametrize("packing", [0.1, 0.4])
def test_what_neighbours_send_back_is_a_sum_over_pairs_in_space(packing, monkeypatch):
    """To first order 2 pi rho int g^2 W(-R) M W(R) R dR, of equal azimuthal orders; what is left falls as 1/kappa."""
    layer = monolayer(600.0, 75.0, 3.9, 1.5, 0.1, packing, lmax=2)
    faint = FAINT * spread_blocks(layer.spheres[0].dressed, multipole_index(2))
    k, a = layer.surface.wavenumber, layer.structure.diameter_nm
    x, weight = np.polynomial.legendre.leggauss(400)
    edge, end = a * k, 60.0
    r = edge + (end - edge) * ((1 + x) / 2) ** 2
    weight = weight * (end - edge) * (1 + x) / 2
    g = 1.0 + layer.structure.pair_excess(r / k)
    w = direct_coupling(2, r) + reflected_coupling(layer.surface, 75.0, 2, r)
    m = multipole_index(2).m
    there = w * (-1.0) ** (m[None, :] - m[:, None])[..., None]  # seen from the other side
    pairs = np.einsum("abr,bc,cdr,r->ad", there, faint, w, weight * r * g**2)
    expected = 2 * np.pi * layer.structure.density_per_nm2 / k**2 * np.where(m[:, None] == m, pairs, 0.0)
    left = []
    for steep, nodes in ((20.0, 20), (40.0, 32)):
        monkeypatch.setattr(ladder_module, "STEEP", steep)
        monkeypatch.setattr(ladder_module, "NEAR_NODES", nodes)
        modes = Modes.build(layer.surface, 75.0, layer.structure, faint[None], np.ones(1))
        left.append(np.abs(modes.back - expected).max() / np.abs(expected).max())
    assert left[1] <= PAIR_BAR and left[1] <= 0.7 * left[0]


@pytest.mark.parametrize("index, wavelength", [(3.1j + 1e-9, 500.0), (3.85, 650.0)])
def test_the_ladder_gives_out_what_a_lossless_layer_takes(index, wavelength):
    total, _ = _whole(ladder(wavelength, 80.0, index, 1.5, 0.1, 0.1, lmax=3), np.cos([0.05, 0.6, 1.0, 1.3]))
    assert np.abs(total - 1).max() <= ENERGY_BAR


def test_emission_through_the_neighbours_is_their_light_backwards():
    """u D M_i D_i v of one way and of the other: the same to rounding, before anything is made symmetric."""
    layer = ladder(550.0, 80.0, SILVER, 1.5, 0.1, 0.3, lmax=3)
    lit = layer.illuminate(np.cos(np.array([0.1, 0.5, 0.9, 1.3])))
    first = lit.directions[0]
    x = layer.fields([first.emission + diffuse.neighbour_emission(lit.added)], lit.response)[0]  # m, q, s, p, i
    there, back = np.abs(x), np.abs(x.transpose(0, 3, 4, 1, 2))
    assert np.abs(there - back).max() <= 1e-9 * there.max()


def test_passed_on_light_is_reciprocal_between_its_nodes_already():
    """Before the mean of both ways is taken single precision alone distinguishes them."""
    layer = ladder(550.0, 80.0, SILVER, 1.5, 0.1, 0.3, lmax=2)
    modes = layer.modes
    mu = np.cos(np.array([0.2, 0.7, 1.2]))
    lit = layer.illuminate(mu)
    order = 2
    met = diffuse._lights([diffuse._low(b, order) for b in lit.response])
    kappa = lit.directions[0].inner
    found = modes.ladder_power(met, np.tile(kappa, 2), diffuse._low(diffuse._leaving(layer, lit), order), kappa, 8)
    power = found.reshape(3, 2, 2, 3, 8)  # s, q, p, i, k
    swapped = power.transpose(3, 2, 1, 0, 4)
    assert np.abs(power - swapped).max() <= 1e-4 * np.abs(power).max()


@pytest.mark.parametrize(
    "substrate, films", [(4.1 + 0.04j, ((1.46, 400.0),)), (1.5, ()), (1.0, ())], ids=["oxide", "glass", "alone"]
)
def test_the_nodes_of_passed_on_light_are_enough(substrate, films, monkeypatch):
    """Also of the radiance towards grazing, where the power falls as the cosine."""
    layer = ladder(500.0, 90.0, SILVER, substrate, 0.1, 0.1, films=films, lmax=2)
    mu = np.cos(np.radians([0.5, 40.0, 70.0, 86.0, 89.0]))
    lit = layer.illuminate(mu)
    few = diffuse.ladder_power(layer, [(lit, mu)], 8)
    monkeypatch.setattr(diffuse, "NODES", (24, 12, 14))
    many = diffuse.ladder_power(layer, [(lit, mu)], 8)
    steep = np.outer(mu, mu)[..., None, None, None]
    assert np.abs(few - many).max() <= 0.01 * np.abs(many).max()
    assert np.abs((few - many) / steep).max() <= 0.02 * np.abs(many / steep).max()


def test_a_mixture_of_two_equal_kinds_is_one_kind():
    one = ladder(550.0, 75.0, SILVER, 1.5, 0.1, 0.2, lmax=2)
    particle = one.particles[0]
    halves = (dataclasses.replace(particle, share=0.5), dataclasses.replace(particle, share=0.5, species=1))
    two = dataclasses.replace(one, particles=halves)
    x = np.cos([0.1, 0.8, 1.3])
    alone, both = (_whole(layer, x)[1].above for layer in (one, two))
    assert np.abs(alone - both).max() <= 1e-4 * alone.max()


def test_a_mixture_with_a_dark_kind_passes_on_by_chance_of_who_is_who():
    """Half of the places hold next to nothing: a layer of half the density is left, with half of the order."""
    below = surface(550.0, 1.5)
    density = 0.02 / np.pi / 75.0**2
    t = t_matrix(2, below.wavenumber * 75.0, SILVER)
    whole, half = (hard_disk_structure(n * density, n * 0.02, 4.5 * below.wavenumber * 1.5) for n in (1.0, 0.5))
    mixed = Monolayer(below, (Particle(0.5, 75.0, t), Particle(0.5, 75.0, 1e-3 * t, species=1)), whole, "qca-ladder")
    alone = Monolayer(below, (Particle(1.0, 75.0, t),), half, "qca-ladder")
    mu, w = hemisphere_rule(12)
    passed = []
    for layer in (mixed, alone):
        part = diffuse.ladder_power(layer, [(layer.illuminate(mu), w)], 1)
        passed.append(part * layer.structure.density_per_nm2)
    assert np.abs(passed[0] - passed[1]).max() <= DARK_BAR * passed[1].max()


RECIPE = {
    "family": "metasurface", "substrate": {"n": 1.5},
    "particle": {"material": {"n": 4.0}, "radius_nm": 75}, "monolayer": {"coverage": 0.1},
    "model": {"correction": "qca-ladder", "multipole_order": 3},
}  # fmt: skip


def test_a_recipe_takes_the_ladder_and_keeps_energy_and_reciprocity():
    bsdf = nacre.material(RECIPE).bsdf([600.0])
    assert bsdf.provenance["correction"] == "qca-ladder"
    rng = np.random.default_rng(1)
    wi, wo = rng.normal(size=(2, 40, 3))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]) + 0.1, np.abs(wo[:, 2]) + 0.1
    wi, wo = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (wi, wo))
    there, back = nacre.evaluate(bsdf, wi, wo), nacre.evaluate(bsdf, wo, wi)
    assert np.abs(there - back).max() <= 1e-10 * there.max()


@pytest.mark.parametrize(
    "change, said",
    [
        ({"layers": [{"material": {"n": 2.2}, "thickness_nm": 300}]}, "guides light"),
        ({"substrate": {"n": 0.05, "k": 3.1}}, "guides light"),
        (
            {"monolayer": {"coverage": 0.1, "structure": {"name": "lattice", "jitter": 0.02}}},
            "whose S peaks",
        ),
    ],
)
def test_what_the_ladder_does_not_model_is_refused_in_one_line(change, said):
    with pytest.raises(UnsupportedError, match=said) as raised:
        nacre.material({**RECIPE, **change}).bsdf([600.0])
    assert "\n" not in str(raised.value)
