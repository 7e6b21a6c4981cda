"""What the tests of photonic glass share: the reference data, and slabs built from its rows."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.families.glass.composite import bruggeman
from nacre.families.glass.medium import Spheres

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "glass" / "photonic_glass_open.npz"
CASES = range(15)


@cache
def reference() -> dict[str, Any]:
    """The arrays of the reference file, lengths in um as it has them."""
    if not REFERENCE.exists():
        pytest.skip("../shared/reference/glass is absent")
    with np.load(REFERENCE) as data:
        return {name: data[name] for name in data.files}


def effective_index(case: int) -> Any:
    data = reference()
    layers, phi = int(data["n_layers"][case]), float(data["volume_fraction"][case])
    radii = data["radius_nm"][case]
    core = phi if layers == 1 else phi * (radii[0] / radii[1]) ** 3
    fractions = [core, 1 - phi] if layers == 1 else [core, phi - core, 1 - phi]
    indices = np.vstack([data["n_particle"][case].T[:layers], data["n_matrix"][case][None]])
    return bruggeman(indices, np.array(fractions))


def spheres(case: int) -> Spheres:
    """The spheres of a row of the reference data."""
    data = reference()
    layers = int(data["n_layers"][case])
    radii = data["radius_nm"][case][:layers]
    return Spheres(
        data["wavelength_nm"],
        radii,
        data["n_particle"][case].T[:layers],
        effective_index(case),
        float(data["volume_fraction"][case]),
        float(data["pdi"][case]) * float(radii[-1]),
    )


def plain_spheres(
    radius_nm: float,
    n_sphere: complex,
    n_matrix: complex,
    fraction: float,
    wavelengths_nm: Any,
    deviation_nm: float = 0,
) -> Spheres:
    """Spheres of one material at wavelengths where nothing disperses."""
    lam = np.asarray(wavelengths_nm, dtype=float)
    indices = np.repeat(np.array([[n_sphere], [n_matrix]], dtype=complex), len(lam), axis=1)
    found = bruggeman(indices, np.array([fraction, 1 - fraction]))
    return Spheres(lam, np.array([radius_nm]), indices[:1], found, fraction, deviation_nm)
