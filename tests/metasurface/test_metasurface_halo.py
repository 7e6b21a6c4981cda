"""Haloes of jittered lattices in closed form, energy and reciprocity at random, and samples that cannot be made."""

import numpy as np
import pytest
from validation import metasurface_critical_packing as critical

NOISE = 0.02  # of S: twice what the number of modes in a ring leaves


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("jitter", [0.05, 0.2])
def test_between_its_orders_a_jittered_lattice_has_the_halo_of_independent_moves(kind, jitter):
    _, s, wanted, free = critical.halo(kind, jitter)
    assert free.sum() > 50 and np.sqrt(np.mean((s[free] - wanted[free]) ** 2)) <= NOISE
    assert wanted[free].max() > 0.3  # there is a halo to speak of


def test_orders_of_a_lattice_lie_where_its_pattern_scatters():
    q, s, _, free = critical.halo("hexagonal", 0.02)
    assert s[~free].max() > 10 and s[free].max() < 0.2
    assert critical.orders("square", 500.0, 0.02)[1:3] == pytest.approx(2 * np.pi / 500 * np.array([1, np.sqrt(2)]))


def _within(seeds):
    energy, departure = np.array([critical.limits(seed) for seed in seeds]).max(axis=0)
    assert energy <= critical.ENERGY_BAR + 1e-9 and departure <= critical.RECIPROCITY_BAR


def test_some_monolayers_of_any_kind_keep_energy_and_reciprocity():
    _within(range(8))


@pytest.mark.full
def test_many_monolayers_of_any_kind_keep_energy_and_reciprocity():
    """The validation script takes 500."""
    _within(range(8, 60))


def test_nineteen_published_samples_can_be_discs_and_eight_are_refused():
    made, refused = critical.made_and_refused()
    assert len(made) == 19 and len(refused) == 8
    assert all(critical.can_be(*key) for key in made) and not any(critical.can_be(*key) for key in refused)
