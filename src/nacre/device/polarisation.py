"""Mueller matrices in Mitsuba's polarised variants.

Mitsuba multiplies Stokes vectors of light that travels along `-L` before and along `V` after the surface, `L` and `V`
being the directions to the light and to the viewer. Each wave has the implicit Stokes frame `mi.mueller.stokes_basis`.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.device.plugin import Facet, is_radiance, larger, opaque, smaller
from nacre.device.tables import DeviceTable, WavelengthAxis

DARKEST = 1e-12  # power below which a matrix is taken as depolarising


def depolarised(value: Any) -> Any:
    """Return a value as a depolarising Mueller matrix in polarised variants, else unchanged."""
    return mi.mueller.depolarizer(value) if mi.is_polarized else value


def scaled(matrix: Any, value: Any) -> Any:
    """Return a Mueller matrix times a spectrum (`*` would be the product of a matrix and a vector)."""
    return mi.Spectrum([[matrix[i, j] * value for j in range(4)] for i in range(4)])


class DevicePolarisation:
    """Normalised Mueller matrices of an interface, from its tables."""

    def __init__(self, tables: InterfacePolarisation) -> None:
        regions = [tables.reflected]
        starts = [0]
        for region in (tables.reflected_inside, tables.total, tables.transmitted):
            starts.append(sum(len(each) for each in regions))
            if region is not None:
                regions.append(region)
        stacked = np.concatenate(regions)
        self.transmits = tables.transmitted is not None
        self.has_total = tables.total is not None
        self.axis = WavelengthAxis(tables.wavelengths_nm)
        self.pairs = [DeviceTable(stacked[..., :2]), DeviceTable(stacked[..., 2:])]
        nodes = len(tables.reflected)
        self.top, self.max_low = opaque(nodes - 1), opaque(nodes - 2)
        self.inside_row, self.total_row, self.transmitted_row = (opaque(start) for start in starts[1:])
        total = 2 if tables.total is None else len(tables.total)
        self.total_scale, self.total_max_low = opaque((total - 1) * 2.0 / math.pi), opaque(total - 2)
        self.eta = opaque(tables.eta)
        critical = math.sqrt(max(0.0, 1.0 - 1.0 / tables.eta**2))
        self.critical, self.inv_critical = opaque(critical), opaque(1.0 / max(critical, 1e-6))

    def matrix(self, ctx: Any, si: Any, wo: Any, facet: Facet, active: Any) -> Any:
        """Return the Mueller matrix with unit transmission of unpolarised light, in the implicit Stokes frames."""
        row, fraction = self._row(facet)
        where = self.axis.locate(si.wavelengths, active)
        (a, b), (c, d) = (table.look_up(row, fraction, where, None, active) for table in self.pairs)
        is_lit = a > DARKEST
        scale = dr.select(is_lit, dr.rcp(larger(a, DARKEST)), 0.0)
        one, zero = mi.UnpolarizedSpectrum(1.0), mi.UnpolarizedSpectrum(0.0)
        b, c, d = b * scale, c * scale, d * scale
        lit = dr.select(is_lit, one, zero)
        matrix = mi.Spectrum([[one, b, zero, zero], [b, lit, zero, zero], [zero, zero, c, -d], [zero, zero, d, c]])
        light, view = (wo, si.wi) if is_radiance(ctx) else (si.wi, wo)
        return in_implicit_frames(matrix, light, view, facet.normal)

    def _row(self, facet: Facet) -> tuple[Any, Any]:
        """Return the tables' row and the fraction above it."""
        cos = smaller(facet.cos, 1.0)
        if not self.transmits:
            position = cos * self.top
            low = smaller(dr.floor(position), self.max_low)
            return mi.UInt32(low), position - low
        outside2 = 1.0 - dr.square(self.eta) * (1.0 - cos * cos)
        position = dr.select(facet.inside, dr.sqrt(larger(outside2, 0.0)), cos) * self.top
        low = smaller(dr.floor(position), self.max_low)
        start = dr.select(facet.reflects, dr.select(facet.inside, self.inside_row, 0.0), self.transmitted_row)
        if self.has_total:
            is_total = facet.inside & (cos < self.critical)
            x = dr.acos(larger(smaller(cos * self.inv_critical, 1.0), 0.0)) * self.total_scale
            position = dr.select(is_total, x, position)
            low = dr.select(is_total, smaller(dr.floor(x), self.total_max_low), low)
            start = dr.select(is_total, self.total_row, start)
        return mi.UInt32(low + start), position - low


def in_implicit_frames(matrix: Any, light: Any, view: Any, normal: Any) -> Any:
    """Return a matrix given in the frames (s, k x s) of a facet in Mitsuba's implicit frames.

    Args:
        matrix: Mueller matrix.
        light, view: local directions to the light and to the viewer.
        normal: the facet's normal.
    """
    incoming = -light
    s_in, s_out = _perpendicular(normal, incoming), _perpendicular(normal, view)
    return mi.mueller.rotate_mueller_basis(
        matrix, incoming, s_in, mi.mueller.stokes_basis(incoming), view, s_out, mi.mueller.stokes_basis(view)
    )


def _perpendicular(normal: Any, k: Any) -> Any:
    """Return the unit vector along `normal x k`, or any vector perpendicular to a parallel normal."""
    s = dr.cross(normal, k)
    length2 = dr.dot(s, s)
    other = mi.Frame3f(normal).s
    return dr.select(length2 > 1e-12, s * dr.rsqrt(larger(length2, 1e-20)), other)
