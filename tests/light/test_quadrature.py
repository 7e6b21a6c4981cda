"""Long Gauss-Legendre rules against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from nacre.core.arrays import EIGENVALUE_NODES, gauss_legendre
from nacre.light import sampling_warning


@pytest.mark.parametrize("count", [3, EIGENVALUE_NODES, EIGENVALUE_NODES + 1, 400, 1999])
def test_rules_integrate_polynomials_and_waves(count: int) -> None:
    x, weight = gauss_legendre(count)
    assert np.all(np.diff(x) > 0) and np.all(weight > 0)
    for power in (0, 2, 4):
        assert weight @ x**power == pytest.approx(2 / (power + 1), rel=1e-12)
    if count > 3:  # four nodes a period and more
        wave = 0.5 * count
        assert weight @ np.cos(wave * x) == pytest.approx(2 * np.sin(wave) / wave, abs=1e-12)


def test_weights_that_all_callers_share_cannot_be_changed() -> None:
    from nacre.light.tristimulus import _cached_weights

    with pytest.raises(ValueError, match="read-only"):
        _cached_weights(np.arange(400.0, 701.0, 10.0).tobytes(), "D65", "2deg")[0] = 0.0


def test_lines_between_wavelengths_give_a_warning_and_smooth_spectra_give_none() -> None:
    grid = np.arange(380.0, 781.0, 10.0)
    line = 1.0 / (1.0 + ((grid - 551.0) / 4.0) ** 2)
    smooth = 0.5 + 0.3 * np.cos(grid / 80.0)
    assert sampling_warning(np.array([smooth, line]), grid)
    assert not sampling_warning(np.array([smooth]), grid)
    assert not sampling_warning(line[::30], grid[::30])  # every second one spans no colour
