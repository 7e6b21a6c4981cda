"""The ensemble against another code's discs by as many spheres: what an endless layer cannot have, their edges do."""

import numpy as np
import pytest
from helpers_metasurface import reference
from validation import metasurface_ensembles as ensembles
from validation.metasurface_ensembles import BAR, MEAN_BAR, NAMES, WITHIN_BAR, System, disc_places

PATTERNS = 24


def systems():
    reference("ensemble_C.npz")  # skips where they are absent
    return [System.read(name) for name in NAMES]


def test_discs_have_as_many_spheres_as_theirs_on_the_mean():
    """Their count in a disc of so large an area varies by less than its root: sixty of them, to a per cent."""
    for theirs in systems():
        places, kinds = disc_places(theirs.layer, 60, theirs.spheres)
        counts = [len(xy) for xy in places]
        assert np.mean(counts) == pytest.approx(theirs.spheres, rel=0.02)
        assert [len(which) for which in kinds] == counts


@pytest.mark.full
def test_the_ensemble_s_way_meets_finite_discs_by_finite_discs():
    """At all angles, light at 75 degrees too; `validation/metasurface_ensembles.py` takes twice the patterns."""
    distances, shares = zip(*(theirs.like_for_like(PATTERNS) for theirs in systems()), strict=True)
    assert max(distances) <= BAR, distances
    assert np.mean(distances) <= MEAN_BAR, distances
    assert np.mean(shares) >= WITHIN_BAR, shares


@pytest.mark.full
def test_edges_are_what_discs_have_more_than_an_endless_layer():
    """Discs of few spheres, lit at 75 degrees, send up more than those of many, in proportion of edge to area."""
    theirs = systems()[NAMES.index(ensembles.DENSE)]
    graze, sine = theirs.theta_i[-1:], np.sin(theirs.theta_s)
    sent = [
        ensembles.disc_by_disc(theirs.layer, theirs.theta_s, graze, 16, spheres)[..., 0, 0] @ sine
        for spheres in (40, 100)
    ]
    few, many = (float(each.mean()) for each in sent)
    noise = [float(each.mean(axis=1).std(ddof=1)) / 4 for each in sent]
    assert few - many >= 3 * np.hypot(*noise)
