"""A few directions without tables: the same light as the whole term and the Bsdf."""

import warnings

import numpy as np
import pytest

from nacre.core.arrays import direction
from nacre.families.metasurface.material import MetasurfaceWarning
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.evaluation import direct_powers, direct_values
from nacre.families.metasurface.tmatrix.particle_on_stack import hemisphere_rule
from nacre.material.material import material

INTERPOLATION = 3e-4  # of the neighbours' table, in power
TABLES = 5e-3  # of the Bsdf's harmonics, of the largest value; what they are known to keep
QUADRATURE = 2e-3  # of the sums over cells of 120 angles, in power


def _made(substrate="Si", **particle):
    return material(
        {
            "family": "metasurface",
            "substrate": substrate,
            "layers": [{"material": "SiO2", "thickness_nm": 150.0}],
            "particle": {"material": "Ag", "radius_nm": 70.0, "gap_nm": 2.0, **particle},
            "monolayer": {"coverage": 0.1, "packing": 0.3},
            "model": {"correction": "qca-balanced"},
        }
    )


@pytest.mark.parametrize(
    ("substrate", "particle"), [("Si", {}), ("glass", {}), ("glass", {"deviation_nm": 7.0}), ("Al", {})]
)
def test_a_few_directions_send_what_the_balanced_term_sends(substrate, particle):
    model = _made(substrate, **particle).model
    layer = model.monolayer(520.0)
    cos = np.cos(np.radians([0.0, 30.0, 60.0]))
    mu, weights = hemisphere_rule(24)
    sides = [(layer.illuminate(np.concatenate([mu, cos])), np.concatenate([weights, np.zeros(3)]))]
    if model.transmits:
        below, below_weights = hemisphere_rule(20, layer.surface.index_below)
        sides.append((layer.illuminate(below, True), below_weights))
    term = diffuse_term(layer, sides, 1)
    whole = (*layer.specular_above(cos), term.above[:, 24:27] / cos, term.below[:, 24:27] / cos)
    for ours, theirs in zip(direct_powers(layer, cos), whole, strict=True):
        assert np.max(np.abs(ours - theirs)) <= INTERPOLATION


def test_values_at_a_few_pairs_are_those_of_the_bsdf():
    made, grid = _made(), np.array([450.0, 600.0])
    wi = direction(np.radians([45.0, 45.0, 20.0, 0.0]))
    wo = direction(np.radians([10.0, -30.0, 65.0, 40.0]))
    tables = made.model.bsdf(grid).evaluate(wi, wo)
    few = made.model.values_at(wi, wo, grid)
    assert np.max(np.abs(few - tables)) <= TABLES * tables.max()


def test_pairs_near_grazing_or_of_many_angles_are_left_to_the_tables():
    made, grid = _made(), np.array([550.0])
    grazing = direction(np.radians([88.0]))
    many = direction(np.radians(np.linspace(0.0, 80.0, 60)))
    assert made.model.values_at(grazing, grazing, grid) is None
    assert made.model.values_at(many, many, grid) is None
    assert made.model.values_at(-many[:1], many[:1], grid) is None


def test_values_are_reciprocal():
    layer = _made().model.monolayer(500.0)
    one, other = direction(np.radians([25.0])), direction(np.radians([55.0]))
    forth, back = direct_values(layer, one, other), direct_values(layer, other, one)
    assert abs(forth / back - 1.0).max() <= 1e-9


@pytest.mark.full
def test_the_spectrum_is_that_of_the_integrated_bsdf():
    from nacre.measure.evaluate import bsdf_spectrum

    grid, angles = np.array([450.0, 600.0]), np.radians([0.0, 30.0, 60.0])
    for substrate in ("Si", "glass"):
        made = _made(substrate)
        tables, ours = bsdf_spectrum(made.model.bsdf(grid), angles), made.model.spectrum(angles, grid)
        assert np.abs(ours.diffuse_reflectance - tables.diffuse_reflectance).max() <= QUADRATURE
        assert np.abs(ours.specular_reflectance - tables.specular_reflectance).max() <= QUADRATURE


def test_a_candidate_with_a_memory_is_the_model_itself_to_a_thousandth():
    memory: dict = {}
    near = _made(radius_nm=68.0).model.search_model(memory)
    grid, angles = np.array([500.0, 600.0]), np.radians([0.0, 60.0])
    near.spectrum(angles, grid)
    made = _made(radius_nm=70.0).model
    kept, own = made.search_model(memory).spectrum(angles, grid), made.spectrum(angles, grid)
    assert len(memory) == 2
    assert np.abs(kept.diffuse_reflectance - own.diffuse_reflectance).max() <= 1e-3


def test_a_rough_candidate_leaves_the_near_fields_of_neighbours_out():
    made = _made().model
    grid, angles = np.array([500.0]), np.radians([30.0])
    rough = made.search_model({}, True).spectrum(angles, grid).diffuse_reflectance
    own = made.spectrum(angles, grid).diffuse_reflectance
    # near fields change the light, but not so much that the order of first draws is lost
    assert 1e-4 < abs(rough / own - 1.0).max() < 1.0


def test_coverage_beyond_what_was_tested_is_reported_for_a_few_pairs_too():
    made = _made().vary({"monolayer.coverage": 0.3})
    wi = direction(np.radians([30.0]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made.model.values_at(wi, wi, np.array([550.0]))
    assert any(issubclass(entry.category, MetasurfaceWarning) for entry in caught)
