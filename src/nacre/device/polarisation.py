"""Mueller matrices in Mitsuba's polarised variants.

Mitsuba multiplies Stokes vectors of light that travels along `-L` before and along `V` after the surface, `L` and `V`
being the directions to the light and to the viewer. Each wave has the implicit Stokes frame `mi.mueller.stokes_basis`.
"""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.device.plugin import Facet, UniformNodes, is_radiance, larger, negated, opaque, smaller
from nacre.device.tables import DeviceTable, WavelengthAxis

DARKEST = 1e-12  # power below which a matrix is taken as depolarising


def scaled(matrix: Any, value: Any) -> Any:
    """Return a Mueller matrix times a spectrum (`*` would be the product of a matrix and a vector)."""
    return mi.Spectrum([[matrix[i, j] * value for j in range(4)] for i in range(4)])


class DevicePolarisation:
    """Normalised Mueller matrices of an interface, from its tables.

    Args:
        tables: the tables.
        is_of_azimuth: whether the lobes' values depend on the azimuth; otherwise they are means over it.
    """

    def __init__(self, tables: InterfacePolarisation, is_of_azimuth: bool = False) -> None:
        self.is_of_azimuth = is_of_azimuth
        regions = [tables.reflected]
        starts = [0]
        for region in (tables.reflected_inside, tables.total, tables.transmitted, tables.transmitted_inside):
            starts.append(sum(each.shape[1] for each in regions))
            if region is not None:
                regions.append(region)
        stacked = np.concatenate(regions, axis=1)
        self.transmits = tables.transmitted is not None
        self.has_total = tables.total is not None
        self.is_isotropic = len(stacked) == 1
        self.axis = WavelengthAxis(tables.wavelengths_nm)
        stacked = stacked[0] if self.is_isotropic else stacked
        self.pairs = [DeviceTable(stacked[..., k : k + 2]) for k in range(0, stacked.shape[-1], 2)]
        self.azimuths = None if self.is_isotropic else UniformNodes(len(stacked))
        nodes = tables.reflected.shape[1]
        self.top, self.max_low = opaque(nodes - 1), opaque(nodes - 2)
        self.inside_row, self.total_row, self.transmitted_row, self.returned_row = (opaque(s) for s in starts[1:])
        total = 2 if tables.total is None else tables.total.shape[1]
        self.total_scale, self.total_max_low = opaque((total - 1) * 2.0 / math.pi), opaque(total - 2)
        self.eta = opaque(tables.eta)
        critical = math.sqrt(max(0.0, 1.0 - 1.0 / tables.eta**2))
        self.critical, self.inv_critical = opaque(critical), opaque(1.0 / max(critical, 1e-6))

    def matrix(self, ctx: Any, si: Any, wo: Any, facet: Facet, active: Any) -> Any:
        """Return the Mueller matrix in the implicit Stokes frames, relative to the unpolarised value.

        Where that is a mean over the azimuth, an anisotropic interface is brighter at some azimuths.
        """
        light, view = (wo, si.wi) if is_radiance(ctx) else (si.wi, wo)
        is_crossed = negated(facet.reflects) if is_radiance(ctx) else mi.Bool(False)
        row, fraction = self._row(facet, facet.inside ^ is_crossed)
        where = self.axis.locate(si.wavelengths, active)
        corners = None if self.azimuths is None else self._corners(light, facet.normal)
        elements = [value for table in self.pairs for value in table.look_up(row, fraction, where, corners, active)]
        if self.is_isotropic:
            matrix = _without_conversion(*elements)
        else:
            if self.is_of_azimuth:
                first = elements[0]
                scale = dr.select(first > DARKEST, dr.rcp(larger(first, DARKEST)), 0.0)
                elements = [element * scale for element in elements]
            matrix = mi.Spectrum([elements[k : k + 4] for k in range(0, 16, 4)])
        return in_implicit_frames(matrix, light, view, facet.normal)

    def _corners(self, light: Any, normal: Any) -> list[tuple[Any, Any]]:
        """Return the two nodes around the light's azimuth in the facet's frame, with their weights."""
        assert self.azimuths is not None
        up = dr.select(normal.z < 0.0, -normal, normal)
        shear = dr.rcp(1.0 + up.z)
        x = light.x - up.x * (light.z + (light.x * up.x + light.y * up.y) * shear)
        y = light.y - up.y * (light.z + (light.x * up.x + light.y * up.y) * shear)
        turns = dr.atan2(y, x) * (0.5 * dr.inv_pi)
        last = self.azimuths.last
        low, part = self.azimuths.cell(smaller((turns - dr.floor(turns)) * last, last))
        return [(low, 1.0 - part), (low + 1, part)]

    def _row(self, facet: Facet, lit_inside: Any) -> tuple[Any, Any]:
        """Return the tables' row and the fraction above it; `lit_inside`: the light comes from the denser side."""
        cos = smaller(facet.cos, 1.0)
        if not self.transmits:
            position = cos * self.top
            low = smaller(dr.floor(position), self.max_low)
            return mi.UInt32(low), position - low
        outside2 = 1.0 - dr.square(self.eta) * (1.0 - cos * cos)
        position = dr.select(facet.inside, dr.sqrt(larger(outside2, 0.0)), cos) * self.top
        low = smaller(dr.floor(position), self.max_low)
        through = dr.select(lit_inside, self.returned_row, self.transmitted_row)
        start = dr.select(facet.reflects, dr.select(facet.inside, self.inside_row, 0.0), through)
        if self.has_total:
            is_total = facet.inside & (cos < self.critical)
            x = dr.acos(larger(smaller(cos * self.inv_critical, 1.0), 0.0)) * self.total_scale
            position = dr.select(is_total, x, position)
            low = dr.select(is_total, smaller(dr.floor(x), self.total_max_low), low)
            start = dr.select(is_total, self.total_row, start)
        return mi.UInt32(low + start), position - low


def _without_conversion(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the matrix of an interface without polarisation conversion, relative to its first element."""
    is_lit = a > DARKEST
    scale = dr.select(is_lit, dr.rcp(larger(a, DARKEST)), 0.0)
    one, zero = mi.UnpolarizedSpectrum(1.0), mi.UnpolarizedSpectrum(0.0)
    b, c, d, lit = b * scale, c * scale, d * scale, dr.select(is_lit, one, zero)
    return mi.Spectrum([[one, b, zero, zero], [b, lit, zero, zero], [zero, zero, c, -d], [zero, zero, d, c]])


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
