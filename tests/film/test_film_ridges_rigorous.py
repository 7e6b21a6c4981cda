"""The supercells that check the Morpho preset: their solver against another, and where lamellae stand."""

from __future__ import annotations

import numpy as np
import pytest
from validation._gratings import lamellar
from validation._ridges import RIDGES, Ridge, drawn_heights, faces, reflected

SLAB = Ridge(150.0, 0.0, 1, 300.0, 700.0, 0.0, 1.56 + 0.06j)
STACK = Ridge(70.0, 155.0, 9, 300.0, 700.0, 120.0, 1.56 + 0.0j)


@pytest.mark.parametrize("is_p", [False, True])
def test_level_ridges_are_the_grating_that_modes_give(is_p: bool) -> None:
    """One slab on each ridge, all level: one period of eight, solved by eigenvalues elsewhere with the same orders."""
    numbers, wanted = lamellar(0.7, 0.15, 300 / 700, SLAB.n, 0.5, 5.0, is_p, 6)
    orders, found = reflected(SLAB, np.zeros(RIDGES), 500.0, 5.0, is_p, 7 * RIDGES)
    of_period = orders % RIDGES == 0
    assert (orders[of_period] / RIDGES).tolist() == numbers.tolist()
    np.testing.assert_allclose(found[of_period], wanted, rtol=1e-6)
    assert found[~of_period].max() < 1e-12


@pytest.mark.parametrize("is_p", [False, True])
def test_orders_of_a_supercell_are_reciprocal(is_p: bool) -> None:
    """Light sent back along an order leaves along where it came from, with the same efficiency."""
    heights = drawn_heights(STACK, 3)
    orders, there = reflected(STACK, heights, 460.0, 20.0, is_p, 30)
    back_deg = np.degrees(np.arcsin(-(np.sin(np.radians(20.0)) - 3 * 460.0 / STACK.period_nm)))
    back_orders, back = reflected(STACK, heights, 460.0, back_deg, is_p, 30)
    assert back[back_orders == -3] == pytest.approx(there[orders == -3], rel=0.01)


def test_lamellae_stand_where_the_drawn_heights_put_them() -> None:
    heights = drawn_heights(STACK, 0)
    thicknesses, inside = faces(STACK, heights)
    assert thicknesses.sum() == pytest.approx(heights.max() + 9 * 70.0 + 8 * 155.0)
    # each column holds its pedestal and nine lamellae
    np.testing.assert_allclose(thicknesses @ inside, heights + 9 * 70.0, rtol=1e-9)
