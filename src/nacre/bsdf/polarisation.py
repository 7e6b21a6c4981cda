"""Mueller matrices of smooth interfaces, tabulated for the renderer, in the frames (s, k x s) of each wave.

An interface without polarisation conversion has the matrix

    [[a, b, 0, 0], [b, a, 0, 0], [0, 0, c, -d], [0, 0, d, c]],  a = (S + P) / 2, b = (S - P) / 2, c + i d = s p*,

with the amplitudes s and p (r_p = -r_s at normal incidence) and their powers S and P. Its tables hold a, b, c and d;
the renderer uses their ratios to a. Tables of an anisotropic interface hold the 16 elements by row over the azimuth of
the direction to the light, relative to the azimuthal mean of the first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.response import InterfaceResponse, ResponseLobe, is_uniform
from nacre.bsdf.tabulate import SLICE_SHARE, AnisotropicTables, StackTables, in_plane_beyond
from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack import solve as solver

COS_NODES = 1025
TOTAL_NODES = 1025
ANISOTROPIC_TOTAL_NODES = 33
AZIMUTHS = (8, 16, 32)
AZIMUTH_ERROR = 0.03  # error of an element midway between azimuths, relative to the largest first element
LEAST_COS = 1e-5  # no wave runs exactly along the surface
MOST_STORED = 1_000_000  # values in a file
PROBE_COSINES = np.array([0.35, 0.6, 0.85])
PROBE_WAVELENGTHS = 8
REGIONS = ("reflected", "reflected_inside", "total", "transmitted", "transmitted_inside")
# Stokes components of the frame (s, k x s) from those of (p, s)
_FRAME = np.array([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class InterfacePolarisation:
    """Mueller elements of an interface; see the module.

    The coordinates are those of `InterfaceResponse`: `outside` is the rarer medium.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        reflected: `[azimuth, cos, wavelength, element]`: uniform azimuths from 0 to 2 pi with both ends (one, if there
            is no anisotropy), uniform cosines from 0 to 1 in the rarer medium, light from there; 4 or 16 elements.
        reflected_inside: the same for light from the denser medium at the conjugate angle; None if opaque.
        total: `[azimuth, x, wavelength, element]` beyond the critical angle; None if there is none.
        transmitted: light from outside; without anisotropy relative to an unknown common factor; None if opaque.
        transmitted_inside: light from inside.
        eta, flipped: as in `InterfaceResponse`.
        response: R and T on the same cosines, finer than those of the lobes; None for anisotropic tables.
    """

    wavelengths_nm: Array
    reflected: Array
    reflected_inside: Array | None
    total: Array | None
    transmitted: Array | None
    transmitted_inside: Array | None
    eta: float
    flipped: bool
    response: InterfaceResponse | None = None

    def __post_init__(self) -> None:
        """Check the shapes, since tables may come from a file.

        Raises:
            ValueError: names the inconsistent table.
        """
        azimuths, _, waves, elements = self.reflected.shape
        if waves != len(self.wavelengths_nm) or (azimuths > 1, elements) not in ((False, 4), (True, 16)):
            raise ValueError(f"reflected has the shape {self.reflected.shape}")
        for name in REGIONS[1:]:
            table = getattr(self, name)
            if table is not None and (table.shape[0], *table.shape[2:]) != (azimuths, waves, elements):
                raise ValueError(f"{name} has the shape {table.shape}")
        if not self.eta >= 1.0 or (self.reflected_inside is None) != (self.transmitted is None):
            raise ValueError("eta or the transmitted part is inconsistent")

    def compact(self) -> InterfacePolarisation:
        """Return the tables for storage: single precision as in the renderer, without the refined R and T.

        Large tables for isotropic interfaces are thinned to every second, fourth or eighth cosine.
        """
        tables = {name: getattr(self, name) for name in REGIONS}
        size, step = sum(0 if table is None else table.size for table in tables.values()), 1
        while self.reflected.shape[-1] == 4 and size > step * MOST_STORED and step < 8:
            step *= 2
        single: dict[str, Any] = {
            n: None if table is None else table[:, ::step].astype(np.float32) for n, table in tables.items()
        }
        return dataclasses.replace(self, **single, response=None)

    def arrays(self) -> dict[str, Array]:
        """Return all numbers by name, for `from_arrays`."""
        tables = {name: getattr(self, name) for name in REGIONS}
        numbers = np.array([self.eta, float(self.flipped)])
        return {
            "wavelengths_nm": self.wavelengths_nm,
            "numbers": numbers,
            **{name: table for name, table in tables.items() if table is not None},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> InterfacePolarisation:
        """Return the tables that `arrays` describes.

        Raises:
            ValueError, KeyError: the arrays are damaged.
        """
        eta, flipped = arrays["numbers"]
        tables = {name: arrays.get(name) for name in REGIONS}
        return cls(arrays["wavelengths_nm"], **tables, eta=float(eta), flipped=bool(flipped))  # type: ignore[arg-type]  # checked there

    def refined(self, lobe: Lobe) -> Lobe:
        """Return a lobe with the finer tables of R and T if its own have uniform nodes over angle.

        Linear interpolation between the 1025 cosines has an error below 1e-5 for bare metals and dielectrics.
        """
        if self.response is None or not isinstance(lobe, ResponseLobe) or lobe.response.parameters:
            return lobe
        coarse = lobe.response.cos_outside
        if len(coarse) >= len(self.response.cos_outside) or not is_uniform(coarse):
            return lobe
        fine: Any = dataclasses.replace(cast("Any", lobe), response=self.response)
        return cast("Lobe", fine)


def interface_polarisation(tables: StackTables, thicknesses_nm: Array) -> InterfacePolarisation | None:
    """Tabulate a stack's Mueller matrices; None for incoherent isotropic layers: the renderer then depolarises.

    Args:
        tables: the stack.
        thicknesses_nm: `[layer]`.
    """
    if isinstance(tables, AnisotropicTables):
        return _anisotropic(tables)
    if any(tables.incoherent):
        return None
    d = np.asarray(thicknesses_nm, dtype=float)
    n, d = (tables.n[::-1], d[::-1]) if tables.flipped else (tables.n, d)
    cos, lam = np.linspace(0.0, 1.0, COS_NODES), tables.wavelengths_nm
    outside = solver.amplitudes(n, d, lam, cos_i=cos)
    reflected = _elements(outside.r_s, outside.r_p)
    behind = total = transmitted = None
    if tables.transmits:
        rare, dense = n[0].real, n[-1].real
        transmitted = _elements(outside.t_s, outside.t_p)
        transmitted[0] = transmitted[1]  # nothing enters at grazing incidence; the ratio is continuous
        back_n, back_d = n[::-1], d[::-1]
        inside = solver.amplitudes(back_n, back_d, lam, kappa=np.sqrt(1.0 - cos * cos)[:, None] * rare)
        behind = _elements(inside.r_s, inside.r_p)
        if tables.eta > 1.0:
            kappa = in_plane_beyond(rare, dense, np.linspace(0.0, 1.0, TOTAL_NODES))
            beyond = solver.amplitudes(back_n, back_d, lam, kappa=kappa)
            total = _elements(beyond.r_s, beyond.r_p)
    regions = [None if region is None else region[None] for region in (reflected, behind, total, transmitted)]
    assert regions[0] is not None
    return InterfacePolarisation(
        lam,
        regions[0],
        regions[1],
        regions[2],
        regions[3],
        regions[3],
        tables.eta,
        tables.flipped,
        tables.build(np.asarray(thicknesses_nm, dtype=float), COS_NODES),
    )


def _anisotropic(tables: AnisotropicTables) -> InterfacePolarisation:
    """Tabulate all elements over the azimuth."""
    lam = tables.wavelengths_nm
    outside, inside = _Side(tables, lit_from_above=not tables.flipped), _Side(tables, lit_from_above=tables.flipped)
    azimuths = outside.azimuths()
    cos = np.linspace(0.0, 1.0, tables.cos_nodes)
    theta = np.arccos(np.maximum(cos, LEAST_COS))
    reflected, transmitted = outside.elements(theta, azimuths)
    behind = total = returned = None
    if tables.transmits:
        rare = (tables.n[-1] if tables.flipped else tables.n[0]).real
        dense = (tables.n[0] if tables.flipped else tables.n[-1]).real
        conjugate = np.arcsin(np.clip(np.sin(theta)[:, None] * rare / dense, 0.0, 1.0))
        behind, returned = inside.elements(conjugate, azimuths)
        if tables.eta > 1.0:
            kappa = in_plane_beyond(rare, dense, np.linspace(0.0, 1.0, ANISOTROPIC_TOTAL_NODES))
            kappa = np.maximum(kappa, rare * np.sqrt(1.0 + LEAST_COS**2))
            total, _ = inside.elements(np.arcsin(np.clip(kappa / dense, 0.0, 1.0)), azimuths)
    passed = transmitted if tables.transmits else None
    return InterfacePolarisation(lam, reflected, behind, total, passed, returned, tables.eta, tables.flipped)


class _Side:
    """Mueller elements of an anisotropic stack for light from one side."""

    def __init__(self, tables: AnisotropicTables, *, lit_from_above: bool) -> None:
        self.waves = tables.wavelengths_nm
        self.stack = tables.lit(tables.stack.thicknesses_nm, from_above=lit_from_above)
        self.sign = 1.0 if lit_from_above else -1.0  # a stack lit from below is turned about u

    def solve(self, theta: Array, azimuth: float, waves: Array) -> tuple[Array, Array]:
        """Return reflected and transmitted matrices `[angle, wavelength, 16]`; zeros for an unknown transmission."""
        response = self.stack.polarised(theta, waves, self.sign * azimuth, slice_share=SLICE_SHARE)
        parts = []
        for matrix in (response.mueller_reflected, response.mueller_transmitted):
            matrix = np.zeros_like(response.mueller_reflected) if matrix is None else matrix
            turned = _FRAME[:, None] * matrix * _FRAME
            parts.append(turned.reshape(*turned.shape[:-2], 16))
        return parts[0], parts[1]

    def azimuths(self) -> Array:
        """Return uniform azimuths, fine enough for linear interpolation."""
        waves, theta = self.waves[:: max(len(self.waves) // PROBE_WAVELENGTHS, 1)], np.arccos(PROBE_COSINES)
        nodes = np.linspace(0.0, 2.0 * np.pi, AZIMUTHS[0] + 1)
        values = np.stack([self.solve(theta, float(a), waves)[0] for a in nodes[:-1]])
        for _ in AZIMUTHS:
            middle = 0.5 * (nodes[1:] + nodes[:-1])
            exact = np.stack([self.solve(theta, float(a), waves)[0] for a in middle])
            between = 0.5 * (values + np.roll(values, -1, axis=0))
            if np.max(np.abs(exact - between)) < AZIMUTH_ERROR * np.max(values[..., 0]) or len(middle) >= AZIMUTHS[-1]:
                break
            nodes = np.linspace(0.0, 2.0 * np.pi, 2 * len(middle) + 1)
            values = np.stack([values, exact], axis=1).reshape(-1, *values.shape[1:])
        return nodes

    def elements(self, theta: Array, azimuths: Array) -> tuple[Array, Array]:
        """Return `[azimuth, angle, wavelength, 16]` of both parts, relative to the mean of their first elements."""
        solved = [self.solve(theta, float(a), self.waves) for a in azimuths[:-1]]
        parts = []
        for part in (0, 1):
            values = np.stack([one[part] for one in solved])
            mean = values[..., :1].mean(axis=0)
            values = np.where(mean > 0.0, values / np.where(mean > 0.0, mean, 1.0), 0.0)
            parts.append(np.concatenate([values, values[:1]]))
        return parts[0], parts[1]


def _elements(s: ComplexArray, p: ComplexArray) -> Array:
    """Return a, b, c and d `[..., 4]`."""
    cross = s * np.conj(p)
    power_s, power_p = np.abs(s) ** 2, np.abs(p) ** 2
    return np.stack([0.5 * (power_s + power_p), 0.5 * (power_s - power_p), cross.real, cross.imag], axis=-1)
