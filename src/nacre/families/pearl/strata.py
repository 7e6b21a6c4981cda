"""A pearl's parts: resin strata with flakes and dye. Dye is dissolved, or small scattering spheres (Mie)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from nacre.bsdf.facet_distributions import Roughness
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.pearl.platelet import FlakeNormals, Platelet
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.mie import default_order, mie_amplitudes, mie_coefficients, mie_efficiencies


@dataclass(frozen=True)
class Flakes:
    """One pigment in a stratum.

    Attributes:
        platelet: its layers.
        volume_fraction: in the stratum.
        normals: normal distribution in the surface frame.
        diameter_um: median diameter, for glints.
    """

    platelet: Platelet
    volume_fraction: float
    normals: FlakeNormals
    diameter_um: float | None = None

    @property
    def key(self) -> tuple[object, ...]:
        """Hashable field values without the volume fraction."""
        return (*self.platelet.key, self.normals.deviation.tobytes(), self.normals.frame.tobytes(), self.diameter_um)


@dataclass(frozen=True)
class Stratum:
    """A resin layer with flakes and dye; `surface` is its upper interface."""

    resin: OpticalConstant
    thickness_nm: float
    surface: Roughness = Roughness()
    flakes: tuple[Flakes, ...] = ()
    dye: Dye | None = None

    @cached_property
    def kinds(self) -> tuple[Flakes, ...]:
        """The pigments, equal ones joined: a pigment entered in two parts then draws the same random walks."""
        joined: dict[tuple[object, ...], list[Flakes]] = {}
        for flakes in self.flakes:
            joined.setdefault(flakes.key, []).append(flakes)
        return tuple(
            replace(same[0], volume_fraction=math.fsum(f.volume_fraction for f in same)) for same in joined.values()
        )


PHASE_NODES = 181  # uniform in cos
QUANTILE_NODES = 129
RADIUS_PANELS = 2
MAX_SIZE_PARAMETER = 400.0


@dataclass(frozen=True)
class Dye:
    """Pigment particles or a dissolved colorant.

    Attributes:
        material: dye index.
        volume_fraction: in the resin.
        radius: particle radius distribution; default: dissolved, without scattering.
    """

    material: OpticalConstant
    volume_fraction: float
    radius: Thickness | None = None


@dataclass(frozen=True)
class DyeResponse:
    """Dye across a stratum.

    Attributes:
        extinction, scattering: `[wavelength]`, optical thickness along the normal.
        phase: `[cos, wavelength]`, 1/sr, on uniform nodes over the scattering cosine in [-1, 1].
        quantile: `[u, wavelength]`, scattering cosine's quantiles.
    """

    extinction: Array
    scattering: Array
    phase: Array | None = None
    quantile: Array | None = None


def dye_response(dye: Dye, resin_n: Array, thickness_nm: float, wavelengths_nm: Array) -> DyeResponse:
    """Solve the dye.

    A dissolved dye absorbs 4 pi k C t / lambda. Spheres with radius a: number per volume C / <4/3 pi a^3>, so the
    optical thickness is t C <Q pi a^2> / <4/3 pi a^3>, averaged over the radii.

    Args:
        dye: in the resin.
        resin_n: `[wavelength]`, real resin index.
        thickness_nm: stratum thickness.
        wavelengths_nm: `[wavelength]`, vacuum.

    Raises:
        NacreError: particles too large for a Mie series.
    """
    n = dye.material.n_complex(wavelengths_nm)
    if dye.radius is None:
        absorbed = 4 * np.pi * n.imag * dye.volume_fraction * thickness_nm / wavelengths_nm
        return DyeResponse(absorbed, np.zeros_like(absorbed))
    radii, weights = dye.radius.nodes(RADIUS_PANELS)
    volume = float(np.sum(weights * 4 / 3 * np.pi * radii**3))
    number = dye.volume_fraction / volume * thickness_nm  # per face area, 1/nm^2
    largest = float(2 * np.pi * radii.max() * np.max(resin_n / wavelengths_nm))
    if largest > MAX_SIZE_PARAMETER:
        raise NacreError(f"dye particles of {radii.max():.0f} nm radius are too large; at most a few um are solved")
    mu = np.linspace(-1, 1, PHASE_NODES)
    extinction, scattering = np.zeros(len(wavelengths_nm)), np.zeros(len(wavelengths_nm))
    phase = np.zeros((PHASE_NODES, len(wavelengths_nm)))
    for radius, weight in zip(radii, weights, strict=True):
        x = 2 * np.pi * radius * resin_n / wavelengths_nm
        a, b = mie_coefficients(default_order(float(x.max())), x[None], (n / resin_n)[None])
        q = mie_efficiencies(a, b, x)
        area = number * weight * np.pi * radius**2
        extinction += area * q.extinction
        scattering += area * q.scattering
        s1, s2 = mie_amplitudes(a, b, mu)
        # dC/dOmega = (|S1|^2 + |S2|^2) / (2 k^2)
        k = 2 * np.pi * resin_n / wavelengths_nm
        phase += number * weight * ((np.abs(s1) ** 2 + np.abs(s2) ** 2).T / (2 * k**2))
    step = mu[1] - mu[0]
    cumulative = np.zeros_like(phase)
    cumulative[1:] = np.cumsum((phase[1:] + phase[:-1]) / 2, axis=0) * step
    total = cumulative[-1]
    # normalised for linear interpolation, which conserves energy between nodes
    phase = phase / (2 * np.pi * total)
    u = np.linspace(0, 1, QUANTILE_NODES)
    quantile = np.stack([np.interp(u, cumulative[:, i] / total[i], mu) for i in range(len(total))], axis=1)
    return DyeResponse(extinction, np.minimum(scattering, extinction), phase, quantile)
