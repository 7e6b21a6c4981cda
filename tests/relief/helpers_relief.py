"""Shared by the relief's tests: small reliefs, a direct sum, the published designs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.plane_cut import CutGeometry
from nacre.families.relief.surface import Tile

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "relief"


def published(name: str) -> dict[str, np.ndarray]:
    """Return a reference file, or skip the test where it is absent."""
    path = REFERENCE / name
    if not path.exists():
        pytest.skip(f"reference data {path.name} is absent")
    with np.load(path) as data:
        return {key: data[key] for key in data.files}


def random_tile(
    seed: int, features: int = 8, feature_nm: float = 900.0, blur: float = 0.3, height: float = 600.0
) -> Tile:
    """Return a tile of random heights."""
    generator = np.random.default_rng(seed)
    return Tile(height * generator.random((features, features)), feature_nm, blur * feature_nm)


def random_slice(seed: int, count: int = 5, incidences: int = 2, half_range: float = 0.35) -> CutGeometry:
    """Return a few random directions, incidences and wavelengths."""
    generator = np.random.default_rng(seed)
    theta, phi = generator.uniform(0, 0.6, incidences), generator.uniform(0, 6.3, incidences)
    wi = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    psi = generator.uniform(-half_range, half_range, (2, count))
    return CutGeometry(psi[0], psi[1], wi, np.array([430.0, 520.0, 610.0]))


def direct_sum(
    surface: np.ndarray, sample_nm: float, coherence: Coherence, u: float, v: float, xi: float, nm: float
) -> float:
    """Return the mean over all window positions of |A|^2 / lambda^2, by summing samples one by one.

    The periodic surface is laid out as far as the window reaches; nothing of the product's code is used.
    """
    width = coherence.width_in_wavelengths * nm
    samples = surface.shape[0]
    reach = int(np.ceil(9.0 * width / sample_nm)) // samples + 2
    offset = np.arange(-reach * samples, (reach + 1) * samples)
    total = 0.0
    index = offset % samples
    reflected = np.exp(-2j * np.pi * xi / nm * surface)
    turn_x = np.exp(-2j * np.pi * u / nm * offset * sample_nm)
    turn_y = np.exp(-2j * np.pi * v / nm * offset * sample_nm)
    for cx in range(samples):
        window_x = np.exp(-(((offset - cx) * sample_nm) ** 2) / (2 * width**2)) * turn_x
        rows = np.zeros(samples, dtype=complex)
        np.add.at(rows, index, window_x)
        for cy in range(samples):
            window_y = np.exp(-(((offset - cy) * sample_nm) ** 2) / (2 * width**2)) * turn_y
            columns = np.zeros(samples, dtype=complex)
            np.add.at(columns, index, window_y)
            amplitude = rows @ reflected @ columns * sample_nm**2 / (np.sqrt(np.pi) * width)
            total += abs(amplitude) ** 2
    return total / samples**2 / nm**2
