"""Particles inside a layer: limits, energy, reciprocity, a dipole's decay by the published integral, refusals."""

import dataclasses

import numpy as np
import pytest
from helpers_metasurface import surface, t_matrix
from validation._metasurface_helpers import cross_sections

import nacre
from nacre.core.errors import NacreError
from nacre.families.metasurface.ensemble import Ensemble, EnsembleSettings
from nacre.families.metasurface.monolayer.arrangement import Arrangement
from nacre.families.metasurface.monolayer.evaluation import direct_powers
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.supercells import (
    BEYOND_IN_A_LAYER,
    lift,
    orders,
    reflected_coupling,
    supercells,
    with_species,
)
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    ParticleOnStack,
    amplitude,
    reflection_operator,
)
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored, plane_wave_vectors
from nacre.families.metasurface.tmatrix.substrate import Embedded, StackReflection

WAVELENGTH, RADIUS = 550.0, 75.0
SAME, ENERGY_ALONE, RECIPROCITY = 1e-12, 1e-8, 1e-10
ENERGY = 1e-2  # the physics note's bar for a mean field
SINGLE = 1e-5  # what single precision leaves of a matrix of 300 unknowns
CARRIED = 1e-5  # what multipoles beyond the ninth leave, at 45 nm of 200 to the nearest mirror
INTERPOLATED = 1e-4  # of the neighbours' sums over the angle, as over a stack
LIGHT, VIEWS = np.cos(np.radians([0.0, 20.0, 50.0, 75.0])), np.cos(np.radians([3.0, 30.0, 60.0, 85.0]))


def inside(indices, thicknesses, host=1):
    return Embedded(WAVELENGTH, np.array(indices, complex), np.array(thicknesses, float), host)


def alone(below, centre, index, lmax=8):
    x = below.inner_wavenumber * RADIUS
    return ParticleOnStack(below, centre, t_matrix(lmax, x, index / below.inner_index), min(4, lmax))


def fields(sphere, lit_below=False, seen_below=False):
    seen, lit = sphere.directions(VIEWS, seen_below), sphere.directions(LIGHT, lit_below)
    return amplitude(sphere.harmonics(seen, lit), [0.0, 1.0, 2.5])


def layer(below, centre, index, lmax=5):
    density = 0.1 / np.pi / RADIUS**2
    q = 4.5 * below.wavenumber * max(1.0, below.index_below)
    t = t_matrix(lmax, below.inner_wavenumber * RADIUS, index / below.inner_index)
    return Monolayer(below, (Particle(1.0, centre, t),), hard_disk_structure(density, 0.3, q))


def test_in_a_layer_of_the_ambient_s_index_they_are_as_in_a_gap():
    over, within = surface(WAVELENGTH, 1.5), inside([1.0, 1.0, 1.5], [400.0])
    a, b = alone(over, 150.0, 2.5), alone(within, 150.0, 2.5)
    for sides in ((False, False), (False, True), (True, False), (True, True)):
        f, g = np.abs(fields(a, *sides)), np.abs(fields(b, *sides))  # the phase counts from the top of each stack
        assert np.abs(f - g).max() <= SAME * f.max()
    for f, g in zip(direct_powers(layer(over, 150.0, 2.5), LIGHT), direct_powers(layer(within, 150.0, 2.5), LIGHT)):
        assert np.abs(f - g).max() <= SAME


@pytest.mark.parametrize("below", [1.5, 4.1 + 0.05j])
@pytest.mark.parametrize("cut", [(100.0, 300.0, 2, 150.0, 150.0), (240.0, 160.0, 1, 250.0, 90.0)])
def test_cutting_their_layer_in_two_changes_nothing(cut, below):
    first, second, host, whole_height, height = cut
    whole = inside([1.0, 1.46, below], [first + second])
    parts = inside([1.0, 1.46, 1.46, below], [first, second], host)
    f, g = fields(alone(whole, whole_height, 2.5)), fields(alone(parts, height, 2.5))
    assert np.abs(f - g).max() <= 1e-11 * np.abs(f).max()
    for a, b in zip(
        direct_powers(layer(whole, whole_height, 2.5), LIGHT), direct_powers(layer(parts, height, 2.5), LIGHT)
    ):
        # a search takes few nodes, 1e-4 at the worst of stacks, and another number of them for the cut layer
        assert np.abs(a - b).max() <= 1e-9


@pytest.mark.parametrize("from_below", [False, True])
def test_a_lossless_sphere_sends_out_what_it_takes_where_no_light_is_guided(from_below):
    sphere = alone(inside([1.0, 1.33, 1.5], [300.0]), 100.0, 2.5)
    c = cross_sections(sphere, LIGHT, below=from_below)
    assert np.abs(c.absorption / c.extinction).max() <= ENERGY_ALONE


def test_a_layer_denser_than_both_sides_keeps_light():
    """Of a weak isotropic source in a slab of index n the share between the cones to both sides is guided."""
    sphere = alone(inside([1.0, 1.8, 1.0], [2000.0]), 1000.0, 1.85)
    c = cross_sections(sphere, LIGHT)
    assert np.all(c.absorption > 0.0) and np.all(c.absorption < c.extinction)


@pytest.mark.parametrize("host", [1.33, 1.7])
def test_a_dipole_in_a_layer_decays_as_the_published_integral_says(host):
    """Chance, Prock and Silbey; Novotny and Hecht, sec. 10.9: on another path and with Fresnel's formulas."""
    below, height, thickness = 1.5, 110.0, 300.0
    w_blocks = reflection_operator(inside([1.0, host, below], [thickness]), height, 1, 1)
    k = 2 * np.pi * host / WAVELENGTH
    x, weight = np.polynomial.legendre.leggauss(600)
    x, weight = 6.0 * (x + 1), 6.0 * weight
    kappa = x - 0.2j * np.sin(np.pi * x / 12.0)
    slope = 1.0 - 0.2j * np.pi / 12.0 * np.cos(np.pi * x / 12.0)

    def normal(index):
        root = np.sqrt((index / host) ** 2 - kappa**2 + 0j)
        return np.where(root.imag < 0, -root, root)

    w = normal(host)

    def mirrors(index, distance):
        other, ratio = normal(index), (index / host) ** 2
        phase = np.exp(2j * k * distance * w)
        return (w - other) / (w + other) * phase, (ratio * w - other) / (ratio * w + other) * phase

    (s_a, p_a), (s_b, p_b) = mirrors(1.0, thickness - height), mirrors(below, height)
    upright = kappa**3 / w * (p_a + p_b + 2 * p_a * p_b) / (1 - p_a * p_b)
    lying = kappa / w * (
        (s_a + s_b + 2 * s_a * s_b) / (1 - s_a * s_b) + w**2 * (2 * p_a * p_b - p_a - p_b) / (1 - p_a * p_b)
    )  # fmt: skip
    assert abs(w_blocks[0, 1, 1] - 1.5 * np.sum(weight * slope * upright)) <= 1e-7
    assert abs(w_blocks[1, 1, 1] - 0.75 * np.sum(weight * slope * lying)) <= 1e-7


@pytest.mark.parametrize(("host", "below", "guides"), [(1.33, 1.5, False), (1.5, 1.5, False), (1.7, 1.5, True)])
def test_a_layer_of_lossless_spheres_sends_out_what_arrives_less_what_is_guided(host, below, guides):
    total = sum(direct_powers(layer(inside([1.0, host, below], [400.0]), 150.0, 2.5), LIGHT))
    assert total.max() <= 1.0 + ENERGY
    assert (total.max() < 1.0) if guides else (total.min() >= 1.0 - ENERGY)


def test_the_table_of_neighbours_serves_angles_on_both_sides_of_a_layer():
    made = layer(inside([1.0, 1.7, 1.5], [400.0]), 150.0, 2.5)
    for below in (False, True):
        cosines = np.cos(np.radians([2.0, 33.0, 61.0, 84.0]))
        table, direct = made.illuminate(cosines, below), made.illuminate(cosines, below, untabulated=True)
        size = np.abs(direct.response[0]).max()
        assert np.abs(table.response[0] - direct.response[0]).max() <= INTERPOLATED * size


def test_both_forms_of_an_echo_are_the_same():
    g = np.random.default_rng(0)
    w = np.array([0.3 + 0.1j, 0.9 + 0j])
    below, above = (0.6 * (g.normal(size=(2, 2)) + 1j * g.normal(size=(2, 2))) for _ in range(2))
    risen, fallen = (g.normal(size=(2, 2)) + 1j * g.normal(size=(2, 2)) for _ in range(2))
    echo, b = StackReflection.between(below, above, risen, fallen), plane_wave_vectors(w, 3, 3)
    sign = mirrored(np.ones((*b.shape[:3], 1), complex)).real[..., 0]
    for m, pol in np.ndindex(4, 2):
        whole = sum(left[m, pol][:, None] * right[m, pol] for left, right in echo.pairs(b))
        factor = np.moveaxis(echo.signed(pol, sign[m, pol], sign[m, pol]), 0, -1)
        assert np.abs(whole - adjoint(b)[m, pol][:, None] * b[m, pol] * factor).max() <= 1e-12


@pytest.mark.parametrize("up", [45.0, -45.0])
def test_what_a_layer_sends_back_to_another_height_is_that_of_one_height_carried_there(up):
    """Regular waves of many orders round a centre at the source's height, seen from one above or below it."""
    stack, source, top = inside([1.0, 1.33, 1.5], [400.0]), 200.0, 9
    r = np.array([1.2, 4.0, 9.0])
    low = multipole_index(top).l <= 2
    level = reflected_coupling(stack, source, top, r)
    carried = np.einsum("ab,bcr->acr", lift(top, stack.inner_wavenumber * up)[low], level[:, low])
    found = reflected_coupling(stack, source + up / 2, 2, r, lift_nm=up)
    assert np.abs(found - carried).max() <= CARRIED * np.abs(found).max()
    # reciprocity: the reverse differs only in the signs of upward and downward waves
    turned = reflected_coupling(stack, source + up / 2, 2, r, lift_nm=-up)
    index = multipole_index(2)
    partner = [int(np.nonzero((index.m == -m) & (index.tau == t) & (index.l == l))[0][0])
               for m, t, l in zip(index.m, index.tau, index.l)]  # fmt: skip
    back = np.swapaxes(turned[partner][:, partner], 0, 1)
    assert np.abs(np.abs(found) - np.abs(back)).max() <= 1e-9 * np.abs(found).max()


def recipe(**particle):
    return {
        "family": "metasurface",
        "substrate": {"n": 1.5},
        "layers": [{"material": {"n": 1.7}, "thickness_nm": 120}, {"material": {"n": 1.4}, "thickness_nm": 300}],
        "particle": {"material": {"n": 0.05, "k": 3.1}, "radius_nm": 60, "depth_nm": 200, **particle},
        "monolayer": {"coverage": 0.1, "packing": 0.3},
        "model": {"multipole_order": 4},
    }


def test_a_recipe_s_light_is_reciprocal_keeps_energy_and_says_what_it_is_known_by():
    made = nacre.material({**recipe(), "model": {"multipole_order": 4, "correction": "qca-balanced"}})
    bsdf = made.bsdf(np.array([500.0]))
    g = np.random.default_rng(0)
    wi, wo = g.normal(size=(2, 64, 3))
    wi, wo = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (wi, wo))
    there, back = nacre.evaluate(bsdf, wi, wo), nacre.evaluate(bsdf, wo, wi)
    index = np.where(np.stack([wi[:, 2], wo[:, 2]]) > 0, 1.0, made.model.eta)[..., None]
    there, back = there / index[1] ** 2, back / index[0] ** 2
    assert np.abs(there - back).max() <= RECIPROCITY * there.max()
    s = made.spectrum(np.radians([0.0, 50.0, 85.0]), np.array([500.0]))
    sent = s.specular_reflectance + s.diffuse_reflectance + s.specular_transmittance + s.diffuse_transmittance
    assert np.all(sent <= 1)
    assert bsdf.provenance["correction"] == "qca-balanced"
    assert "78 % off" in bsdf.provenance["correction_doubt"]


@pytest.mark.parametrize(("coverage", "taken"), [(0.1, "ensemble"), (0.002, "qca-balanced")])
def test_auto_takes_the_ensemble_of_all_but_few_particles_inside_a_layer(coverage, taken):
    model = nacre.material({**recipe(), "monolayer": {"coverage": coverage}}).model
    correction, because = model.chosen_correction
    assert correction == taken and "inside a layer at coverage" in because
    assert not model._doubt


@pytest.mark.parametrize("is_mixture", [False, True])
def test_an_ensemble_in_a_layer_of_the_ambient_s_index_is_that_of_a_gap(is_mixture, monkeypatch):
    """The couplings by way of both faces, the far fields and their units: all of one pattern's light."""
    monkeypatch.setattr(nacre.families.metasurface.supercells, "BEYOND", BEYOND_IN_A_LAYER)  # where both end their sums
    density, found = 0.1 / np.pi / RADIUS**2, []
    made = Arrangement("hard-disk", density, 0.1, 0)
    patterns = supercells(lambda count, _: made.pattern(count), density, 2 * RADIUS, 20, 1, 0)
    for below in (surface(WAVELENGTH, 1.5), inside([1.0, 1.0, 1.5], [400.0])):
        kinds = [Particle(1.0, 150.0, t_matrix(2, below.inner_wavenumber * RADIUS, 3.5))]
        if is_mixture:
            half = dataclasses.replace(kinds[0], share=0.5)
            kinds = [half, dataclasses.replace(half, centre_nm=210.0, species=1)]
        layer_of = Monolayer(below, tuple(kinds), hard_disk_structure(density, 0.1, 7 * below.wavenumber))
        patterns = with_species(patterns, layer_of.shares, 0) if is_mixture else patterns
        one = Ensemble(layer_of, patterns)
        every = orders(patterns[0].period, 0.97 * below.wavenumber)
        solved = one.lattice.solve(patterns[0], one.waves(one.side(every[::5], False), False))
        for under in (False, True):
            view = one.waves(one.side(every, under), True)
            found.append(one.coupling.far_field(patterns[0].xy_nm, solved, view, patterns[0].species))
    for a, b in zip(found[:2], found[2:]):
        assert np.linalg.norm(np.abs(a) - np.abs(b)) <= SINGLE * np.linalg.norm(a)


def test_one_solution_is_not_taken_for_that_of_the_same_stack_seen_from_another_layer():
    from nacre.families.metasurface.ensemble import _key

    density = 0.1 / np.pi / RADIUS**2
    keys = set()
    for host in (1, 2):
        below = inside([1.0, 1.4, 1.4, 1.5], [300.0, 300.0], host)
        particle = Particle(1.0, 150.0, t_matrix(2, below.inner_wavenumber * RADIUS, 3.5))
        one = Monolayer(below, (particle,), hard_disk_structure(density, 0.1, 7 * below.wavenumber))
        keys.add(_key(Ensemble(one, []), EnsembleSettings()))
    assert len(keys) == 2


def test_depth_counts_from_the_top_of_all_layers_to_the_particles_tops():
    model = nacre.material(recipe()).model
    assert (model.host, model.gap_nm) == (2, pytest.approx(420 - 200 - 120))
    deeper = dataclasses.replace(model, gap_nm=50.0)
    assert np.abs(model.powers([1.0], 550.0)[2] - deeper.powers([1.0], 550.0)[2]).max() > 1e-4


def test_candidates_near_either_face_are_given_orders_of_their_own():
    memory = {}
    for depth in (121, 200):
        model = nacre.material({**recipe(depth_nm=depth), "model": {}}).model.search_model(memory)
        model = dataclasses.replace(model, gap_nm=40.0)  # as if the layer were thinner: the lower face stays as near
        surface = model.surface(550.0)
        thinner = np.array([120.0, 40.0 + 120.0 + (depth - 120.0)])
        model.order(dataclasses.replace(surface, thicknesses_nm=thinner))
    assert len(memory) == 2


def test_a_mixture_lies_in_a_layer_level_by_its_own_depths():
    second = {"material": {"n": 3.5}, "radius_nm": 40, "depth_nm": 260, "share": 0.5}
    given = recipe(second=second)
    given["monolayer"] = {"coverage": 0.05, "packing": 0.3}
    given["model"]["correction"] = "qca-balanced"
    mixed = nacre.material(given).model
    assert [kind.gap_nm for kind in mixed.all_species] == [pytest.approx(100), pytest.approx(80)]
    assert sum(mixed.powers([0.9], 550.0)).max() <= 1.0
    assert nacre.material({**given, "model": {}}).model.chosen_correction[0] == "ensemble"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"depth_nm": 430}, "is not inside a layer: the layers end 420 nm below their top"),
        ({"depth_nm": 60}, "across a face of layer 1, which lies 0 to 120 nm deep"),
        ({"depth_nm": 310}, "across a face of layer 2, which lies 120 to 420 nm deep"),
        ({"depth_nm": 121, "deviation_nm": 6}, "and higher across a face of layer 2"),
        ({"gap_nm": 3}, "above the layers or inside one"),
        ({"depth_nm": -3}, "depth_nm"),
        # the sphere around a flat disc needs room as well: multipoles diverge inside it
        (
            {"shape": "cylinder", "diameter_nm": 150, "height_nm": 40, "radius_nm": None, "depth_nm": 130},
            "or the sphere of radius 77.62 nm around them",
        ),
    ],
)
def test_what_no_layer_holds_is_refused_in_one_line(change, said):
    given = recipe(**change)
    given["particle"] = {key: value for key, value in given["particle"].items() if value is not None}
    with pytest.raises(NacreError) as raised:
        nacre.material(given)
    assert said in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("model", {"correction": "qca-ladder"}, "is not modelled for particles inside a layer"),
        ("model", {"correction": "none"}, "is not modelled for particles inside a layer"),
        ("layers", [{"material": "Ag", "thickness_nm": 500}], "absorbs"),
        ("layers", [], "is not inside a layer"),
    ],
)
def test_a_model_or_a_layer_that_cannot_hold_them_is_refused_in_one_line(key, value, said):
    with pytest.raises(NacreError) as raised:
        nacre.material({**recipe(), key: value})
    assert said in str(raised.value) and "\n" not in str(raised.value)
