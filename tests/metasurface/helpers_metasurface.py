"""Monolayers from plain numbers, and the reference data, for the metasurface tests."""

from pathlib import Path

import numpy as np
import pytest

from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.tmatrix.particle_on_stack import ParticleOnStack
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.mie import mie_coefficients

REFERENCE = Path(__file__).parents[2] / ".." / "shared" / "reference" / "metasurface"


def reference(name):
    if not REFERENCE.is_dir():
        pytest.skip("../shared/reference is absent")
    return np.load(REFERENCE / name)


def t_matrix(lmax, x, m):
    a, b = mie_coefficients(lmax, [x], [m])
    return np.concatenate([-b, -a])


def surface(wavelength, substrate, films=()):
    return Substrate(
        wavelength, np.array([1.0, *(n for n, _ in films), substrate], complex), np.array([d for _, d in films], float)
    )


def sphere(wavelength, radius, m, substrate, films=(), lmax=8, gap=0.0, mmax=4):
    below = surface(wavelength, substrate, films)
    t = t_matrix(lmax, below.wavenumber * radius, m)
    return ParticleOnStack(below, radius + gap, t, min(mmax, lmax))


def monolayer(wavelength, radius, m, substrate, coverage, packing, films=(), lmax=6, correction="qca-balanced", **more):
    below = surface(wavelength, substrate, films)
    density = coverage / np.pi / radius**2
    structure = hard_disk_structure(density, packing, 4.5 * below.wavenumber * max(1.0, below.index_below))
    particle = Particle(1.0, radius, t_matrix(lmax, below.wavenumber * radius, m))
    return Monolayer(below, (particle,), structure, correction, **more)
