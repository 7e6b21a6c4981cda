"""Interface tables of an anisotropic stack for unpolarised light, over the azimuth or as means over it."""

from __future__ import annotations

import copy
import dataclasses
import math
from typing import Any

import numpy as np

from nacre.bsdf.angle_nodes import AngleErrors
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.tabulate import COLOUR_ERROR, StackTables, reflected_lab
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array
from nacre.light import delta_e_2000
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.stack.stack import Medium, Stack, permittivity_of

COS_NODES = 65
COS_NODES_SPREAD = 33  # a pitch spread averages the fringes out
SLICE_SHARE = 0.25  # of helices; the error grows to some 3e-4
LOSSLESS_K = 1e-9
AZIMUTHS = (3, 5, 9, 17)  # odd: even counts repeat the same values, as half a turn changes little
AZIMUTH_ERROR = 4e-3  # of the mean reflectance, by the next count
CHECKED_COSINES = (np.array([12.0, 30.0, 47.0]) + 0.5) / 64  # midway between nodes
PROBE_COSINES = np.array([0.8, 0.45])
PROBE_WAVELENGTHS = 12
MOST_THETA, BESIDE_GRAZING = 0.5 * np.pi - 1e-6, 1e-10  # no wave runs exactly along the surface
PROBED_AZIMUTHS = 4  # in half a turn
LEAST_AZIMUTHS, MOST_AZIMUTHS = 8, 32  # with 32, cos(2 phi) is wrong by at most 0.02 of the amplitude


class AnisotropicTables(StackTables):
    """One stack with anisotropic layers, solved from both sides, with the mean over the azimuth.

    The mean of unpolarised light is reciprocal, since the powers of a path and of its reverse are equal. Light from an
    anisotropic substrate arrives from an isotropic medium of its mean permittivity.
    """

    def __init__(self, stack: Stack, wavelengths_nm: Array, transmits: bool, depends_on_azimuth: bool) -> None:
        lam = np.asarray(wavelengths_nm, dtype=float)
        below = stack.substrate
        self._below = below.isotropic() if isinstance(below, AnisotropicConstant) else below
        super().__init__(
            Stack(stack.ambient, [], self._below).indices(lam),
            [layer.incoherent for layer in stack.layers],
            lam,
            transmits,
        )
        self.stack = stack
        self._absorbs_nothing = all(_is_lossless(layer.material, lam) for layer in stack.layers)
        self.azimuths_rad = self._azimuths() if depends_on_azimuth else np.zeros(1)
        self._azimuths_inside = self.azimuths_rad

    def outside(self, thicknesses_nm: Array, cos_outside: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, cos, wavelength]` for light in the rarer medium."""
        theta = np.minimum(np.arccos(np.clip(cos_outside, 0.0, 1.0)), MOST_THETA)
        shape = (*thicknesses_nm.shape[:-1], len(theta), len(self.wavelengths_nm))
        rows = thicknesses_nm.reshape(math.prod(thicknesses_nm.shape[:-1]), thicknesses_nm.shape[-1])
        found = [self._mean(self.lit(row, from_above=not self.flipped), theta) for row in rows]
        reflected, passed = (np.stack([one[k] for one in found]).reshape(shape) for k in (0, 1))
        return reflected, passed if self.transmits else np.zeros_like(passed)

    def inside(self, thicknesses_nm: Array, in_plane: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, angle, wavelength]` in the denser medium, at kx/k0 `[angle, wavelength]`."""
        rows = thicknesses_nm.reshape(math.prod(thicknesses_nm.shape[:-1]), thicknesses_nm.shape[-1])
        rare, dense = (self.n[-1], self.n[0]) if self.flipped else (self.n[0], self.n[-1])
        rare, dense = rare.real, dense.real
        in_plane = np.where(np.abs(in_plane / rare - 1.0) < BESIDE_GRAZING, rare * (1.0 + BESIDE_GRAZING), in_plane)
        theta = np.minimum(np.arcsin(np.clip(in_plane / dense, 0.0, 1.0)), MOST_THETA)
        stack_of = [self.lit(row, from_above=self.flipped) for row in rows]
        found = [self._mean(stack, theta, self._azimuths_inside) for stack in stack_of]
        shape = (*thicknesses_nm.shape[:-1], *in_plane.shape)
        return np.reshape([one[0] for one in found], shape), np.reshape([one[1] for one in found], shape)

    def _behind(self, d: Array, cos: Array, reflected: Array) -> Array:
        """Return R from inside at the conjugate angles, `[*params, cos, wavelength]`; equal to R without losses."""
        return reflected if self._absorbs_nothing else super()._behind(d, cos, reflected)

    def _beyond(self, d: Array, x: Array) -> Array:
        """Return R from inside beyond the critical angle, `[x, *params, wavelength]`; 1 without losses."""
        if self._absorbs_nothing:
            return np.ones((len(x), *d.shape[:-1], len(self.wavelengths_nm)))
        return super()._beyond(d, x)

    @property
    def cos_nodes(self) -> int:
        """Number of tabulated cosines."""
        has_spread = any(layer.helix is not None and layer.helix.deviation_nm > 0 for layer in self.stack.layers)
        return COS_NODES_SPREAD if has_spread else COS_NODES

    def lit(self, thicknesses_nm: Array, *, from_above: bool) -> Stack:
        """Return the stack with these thicknesses as light meets it; from below, it is turned about u."""
        layers = [
            dataclasses.replace(e, thickness_nm=float(d))
            for e, d in zip(self.stack.layers, thicknesses_nm, strict=True)
        ]
        if from_above:
            return Stack(self.stack.ambient, layers, self.stack.substrate)
        return Stack(self.stack.ambient, layers, self._below).reversed()

    def _mean(self, stack: Stack, theta: Array, azimuths: Array | None = None) -> tuple[Array, Array]:
        """Return the means of R and T `[angle, wavelength]`."""
        chosen = self.azimuths_rad if azimuths is None else azimuths
        waves, share = self.wavelengths_nm, SLICE_SHARE
        found = [stack.polarised(theta, waves, float(a), slice_share=share) for a in chosen]
        reflected = np.mean([one.mueller_reflected[..., 0, 0] for one in found], axis=0)
        return reflected, np.mean([one.entering[..., 0] for one in found], axis=0)

    def varies_visibly(self, thicknesses_nm: Array) -> bool:
        """Whether the colour of the reflected light at some azimuth differs from that of the mean by dE00 0.5."""
        if len(self.azimuths_rad) == 1:
            return False
        stack, theta = self.lit(thicknesses_nm, from_above=not self.flipped), np.arccos(PROBE_COSINES)
        azimuths = np.linspace(0.0, np.pi, PROBED_AZIMUTHS, endpoint=False)
        found = np.stack([self._mean(stack, theta, np.array([a]))[0] for a in azimuths])
        each, mean = (reflected_lab(r, self.wavelengths_nm) for r in (found, found.mean(axis=0)))
        return bool(np.max(delta_e_2000(each, np.broadcast_to(mean, each.shape))) > COLOUR_ERROR)

    def over_azimuth(self, thicknesses_nm: Array) -> InterfaceResponse:
        """Tabulate with the azimuth as a leading axis, as `AlignedSpecular` has it.

        Uniform azimuths from 0 to 2 pi, both included, halved until the colour of the reflected light midway between
        them is exact to dE00 0.5 at a few angles, or there are `MOST_AZIMUTHS` intervals.

        Args:
            thicknesses_nm: `[layer]`.
        """
        d = np.asarray(thicknesses_nm, dtype=float)
        stack, theta = self.lit(d, from_above=not self.flipped), np.arccos(PROBE_COSINES)
        count = LEAST_AZIMUTHS
        while count < MOST_AZIMUTHS:
            at = np.linspace(0.0, np.pi, count + 1)  # nodes and the middles between them, in half a turn
            found = np.stack([self._mean(stack, theta, np.array([a]))[0] for a in at])
            between = 0.5 * (found[:-2:2] + found[2::2])
            exact, linear = (reflected_lab(r, self.wavelengths_nm) for r in (found[1::2], between))
            if float(np.max(delta_e_2000(linear, exact))) < COLOUR_ERROR:
                break
            count *= 2
        turn = count // 2 if self._is_even else count
        parts = [self._at_azimuth(a).build(d, self.cos_nodes) for a in 2.0 * np.pi * np.arange(turn) / count]
        parts = [*parts * (count // turn), parts[0]]
        names = ("reflectance", "transmittance", "reflectance_inside", "total")
        tables: dict[str, Any] = {name: np.stack([getattr(p, name) for p in parts]) for name in names}
        return dataclasses.replace(parts[0], **tables)

    def _at_azimuth(self, azimuth: float) -> AnisotropicTables:
        """Return the tables of one light azimuth outside; light from inside leaves towards it.

        A stack lit from below is turned about u, which reverses the azimuth.
        """
        one = copy.copy(self)
        one.azimuths_rad, one._azimuths_inside = np.array([azimuth]), np.array([-(azimuth + np.pi)])
        return one

    @property
    def _is_even(self) -> bool:
        """Whether opposite azimuths are equal: reflection by reciprocity, transmission then only without losses."""
        return self._absorbs_nothing or not self.transmits

    def _azimuths(self) -> Array:
        """Return uniform azimuths whose mean reflectance has converged."""
        waves = self.wavelengths_nm
        self.wavelengths_nm = waves[:: max(len(waves) // PROBE_WAVELENGTHS, 1)]
        theta, before = np.arccos(PROBE_COSINES), None
        period = np.pi if self._is_even else 2.0 * np.pi
        stack = self.lit(self.stack.thicknesses_nm, from_above=not self.flipped)
        for count in AZIMUTHS:
            azimuths = np.linspace(0.0, period, count, endpoint=False) + 0.25 * np.pi
            mean = self._mean(stack, theta, azimuths)[0]
            if before is not None and np.max(np.abs(mean - before)) < AZIMUTH_ERROR:
                break
            before, enough = mean, azimuths
        self.wavelengths_nm = waves
        return enough

    def with_error(self, thicknesses_nm: Array) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate on uniform cosines, and return the differences of R from the solution at a few angles."""
        d = np.asarray(thicknesses_nm, dtype=float)
        response = self.build(d, self.cos_nodes)
        return response, self.errors_of(response, d)

    def errors_of(self, response: InterfaceResponse, thicknesses_nm: Array) -> AngleErrors:
        """Return the errors in R of tables averaged over the azimuth, at a few angles of light from the ambient.

        Where the ambient is the denser medium, they are those at the conjugate angles in the rarer one.
        """
        exact = self.outside(np.asarray(thicknesses_nm, dtype=float), CHECKED_COSINES)[0]
        found = response.lookup(CHECKED_COSINES, np.zeros(len(CHECKED_COSINES), dtype=bool))[0]
        theta, error = np.arccos(CHECKED_COSINES)[:, None], np.abs(found - exact)
        if not self.flipped:
            return AngleErrors((theta, error))
        return AngleErrors((theta, error), (np.arcsin(np.sin(theta) / self.eta), error))

    def with_parameters(
        self, thicknesses_nm: Array, parameters: tuple[ParameterAxis, ...]
    ) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate varying thicknesses; see `with_error`."""
        d = np.asarray(thicknesses_nm, dtype=float)
        middle = d[tuple(size // 2 for size in d.shape[:-1])]
        return self.build(d, self.cos_nodes, parameters), self.with_error(middle)[1]


def _is_lossless(medium: Medium, wavelengths_nm: Array) -> bool:
    return bool(np.max(np.abs(permittivity_of(medium, wavelengths_nm).imag)) < LOSSLESS_K)
