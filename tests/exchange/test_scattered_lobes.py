"""Scattered light as rough mirrors and a diffuser: widths, strengths and the power about the mirror direction."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import nacre
from nacre.core.arrays import direction
from nacre.measure.colours import ALPHAS, fit_gloss, fit_lobes

Values = NDArray[np.float64]
THETA = np.radians([0.0, 30.0, 60.0, 80.0])
WITHIN = 0.12  # of the scattered light, within any tilt


def mirror(alpha: float, wi: Values, wo: Values) -> Values:
    """White GGX mirror with height-correlated masking (Heitz 2014, eq. 99), 1/sr."""
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    tan2 = 1.0 / half[:, 2] ** 2 - 1.0
    density = 1.0 / (np.pi * alpha**2 * half[:, 2] ** 4 * (1.0 + tan2 / alpha**2) ** 2)
    smith = [0.5 * np.sqrt(1.0 + alpha**2 * (1.0 / w[:, 2] ** 2 - 1.0)) - 0.5 for w in (wi, wo)]
    return np.asarray(density / (1.0 + smith[0] + smith[1]) / (4.0 * wi[:, 2] * wo[:, 2]))


def power(values_at: object, theta: float, tilt_rad: float) -> float:
    """Reflected power within a tilt of the half vector, by midpoints."""
    assert callable(values_at)
    tilt, phi = np.meshgrid((np.arange(120) + 0.5) / 120 * tilt_rad, (np.arange(24) + 0.5) / 24 * np.pi)
    half = np.stack([np.sin(tilt) * np.cos(phi), np.sin(tilt) * np.sin(phi), np.cos(tilt)], axis=-1).reshape(-1, 3)
    wo = direction(theta, 0.0)
    towards = half @ wo
    wi = 2.0 * towards[:, None] * half - wo
    measure = 4.0 * towards * np.sin(tilt).ravel() * (2.0 * np.pi / 24) * tilt_rad / 120 * wi[:, 2]
    seen = (towards > 0.0) & (wi[:, 2] > 1e-3)
    return float(np.sum(values_at(wi[seen], np.broadcast_to(wo, (seen.sum(), 3))) * measure[seen]))


def test_two_mirrors_and_a_diffuser_are_separated() -> None:
    narrow, wide = ALPHAS[1], ALPHAS[6]

    def values(wi: Values, wo: Values) -> Values:
        both = 0.2 * mirror(narrow, wi, wo) + 0.1 * mirror(wide, wi, wo) + 0.3 / np.pi
        return np.stack([both, 2.0 * both], axis=-1)

    whole = np.array([[power(lambda i, o: values(i, o)[:, 0], t, np.pi / 2)] for t in THETA]) * [1.0, 2.0]
    found = {round(one.alpha, 6): one.reflectance for one in fit_lobes(values, THETA, whole)}
    assert set(found) == {round(narrow, 6), round(wide, 6)}
    assert found[round(narrow, 6)] == pytest.approx(np.full((4, 1), 0.2) * [1.0, 2.0], rel=0.02)
    assert found[round(wide, 6)] == pytest.approx(np.full((4, 1), 0.1) * [1.0, 2.0], rel=0.05)


def test_a_diffuser_has_no_mirror() -> None:
    assert fit_lobes(lambda wi, wo: np.full((len(wi), 1), 0.3 / np.pi), THETA, np.full((4, 1), 0.3)) == []


def test_mirrors_hold_the_light_of_a_pearl_within_each_tilt() -> None:
    bsdf = nacre.load("pearl/bottle3").vary({"quality": "fast"}).bsdf(np.array([500.0, 600.0]))
    values = lambda wi, wo: np.nan_to_num(bsdf.evaluate(wi, wo))
    whole = np.array([[power(lambda i, o, b=b: values(i, o)[:, b], t, np.pi / 2) for b in (0, 1)] for t in THETA])
    lobes, one = fit_lobes(values, THETA, whole), fit_gloss(values, THETA, whole)
    assert one is not None
    errors = np.zeros((2, len(THETA), 3))
    for i, theta in enumerate(THETA):
        for k, tilt in enumerate(np.radians([3.0, 6.0, 12.0])):
            light = power(lambda w, o: values(w, o)[:, 1], theta, tilt)
            for row, parts in enumerate((lobes, [one])):
                held = sum(
                    part.reflectance[i, 1] * power(lambda w, o, a=part.alpha: mirror(a, w, o), theta, tilt)
                    for part in parts
                )
                errors[row, i, k] = abs(held - light) / whole[i, 1]
    assert errors[0].max() < WITHIN < errors[1].max()
