"""Tabulated BRDFs on the device: multilinear look-up, sampled from an exit table for each incidence.

Nearly Lambertian tables use cosine-weighted sampling instead, at half the cost and equal noise.
"""

import dataclasses
import itertools
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.table import TableLobe
from nacre.core.arrays import direction
from nacre.core.errors import UnsupportedError
from nacre.device import plugin
from nacre.device.tables import DeviceTable, WavelengthAxis

COSINE_SHARE = 0.1  # fraction of the samples: covers all directions and bounds the weights
BROAD = 1.05  # mean square weight below which cosine-weighted sampling is as good; 1 for a Lambertian surface
VIEW_NODES, EXIT_NODES, AZIMUTH_NODES = 48, 96, 96
MAX_TABLE_VALUES = 1 << 27
TURNS = 8  # light azimuths over which the density of an anisotropic table is averaged


class TablePlugin(plugin.LobePlugin[TableLobe]):
    """f over three angles; channels with spectra, or one channel per wavelength."""

    kind = "table"

    def __init__(self, lobe: TableLobe) -> None:
        self.components = (plugin.flag("GlossyReflection", "FrontSide"),)
        self.coordinates = lobe.coordinates
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self._set(lobe)

    def _set(self, lobe: TableLobe) -> None:
        values, basis = np.asarray(lobe.values, dtype=float), np.asarray(lobe.basis, dtype=float)
        self.shape = values.shape
        self.is_spectral = values.shape[-1] > 4 or bool(
            basis.shape[0] == basis.shape[1] and np.array_equal(basis, np.eye(len(basis)))
        )
        if self.is_spectral:
            if not np.array_equal(basis, np.eye(len(basis))):
                values = values @ basis
            if values.shape[-1] == 1:
                values = np.repeat(values, 2, axis=-1)
            if 2 * values.size > MAX_TABLE_VALUES:
                raise UnsupportedError(
                    f"a table with {values.size} values is too large for rendering; use fewer angles or channels"
                )
            self.channels = plugin.opaque_int(values.shape[-1] - 1)
            # adjacent wavelengths in one load
            self.values = plugin.device_array(np.stack([values[..., :-1], values[..., 1:]], axis=-1))
        else:
            self.colours = values.shape[-1]
            self.values = plugin.device_array(values)
            self.basis = [DeviceTable(row[None, :, None]) for row in basis]
        sizes = values.shape[:-1]
        self.is_signed, self.has_turn = lobe.is_signed, lobe.nodes_turn is not None
        own = lobe.nodes if lobe.nodes_turn is None else (lobe.nodes_turn, *lobe.nodes)
        self.nodes = [None if nodes is None else plugin.device_array(nodes) for nodes in own]
        self.tops = [plugin.opaque(n - 1) for n in sizes]
        self.max_lows = [plugin.opaque(max(n - 2, 0)) for n in sizes]
        self.sizes = [plugin.opaque_int(n) for n in sizes]
        self._set_sampling(lobe)

    def _set_sampling(self, lobe: TableLobe) -> None:
        """Tabulate the wavelength-averaged f cos_o sin_o on (theta_i; theta_o, |dphi|)."""
        # slightly below 90 degrees, at which the half vector is undefined
        ti = np.linspace(0.0, 1.0, VIEW_NODES) * (math.pi / 2 - 1e-4)
        to = np.linspace(0.0, 1.0, EXIT_NODES) * (math.pi / 2 - 1e-4)
        dphi = np.linspace(0.0, math.pi, AZIMUTH_NODES)
        weight = np.cos(to) * np.sin(to)
        densities = np.empty((VIEW_NODES, AZIMUTH_NODES, EXIT_NODES), dtype=np.float32)
        means, squares = np.empty(VIEW_NODES), np.empty(VIEW_NODES)
        turns = np.arange(TURNS) * (2 * math.pi / TURNS) if lobe.nodes_turn is not None else np.zeros(1)
        lobe = _averaged(lobe)
        # directions are drawn on both sides with equal probability
        sides = (1.0, -1.0) if lobe.is_signed else (1.0,)
        for k, angle in enumerate(ti):
            parts = []
            for turn in turns:
                for side in sides:
                    wo = direction(to[None, :], side * dphi[:, None] + turn)  # [azimuth, exit, 3]
                    wi = np.broadcast_to(direction(angle, turn), wo.shape)
                    parts.append(lobe.evaluate(wi, wo).mean(axis=-1))
            mean = np.mean(parts, axis=0)
            # a positive density everywhere
            densities[k] = np.maximum(mean, 1e-4 * mean.max() + 1e-9) * weight
            means[k] = math.pi**2 * float(np.mean(mean * weight))
            squares[k] = math.pi**3 * float(np.mean(mean**2 * weight))
        self.is_broad = bool(np.all(squares <= BROAD * means**2))
        self.exits: Any = None
        if not self.is_broad:
            self.exits = mi.MarginalContinuous2D1(densities, [np.linspace(0.0, 1.0, VIEW_NODES).tolist()], True, True)
        self.albedo = plugin.device_array(means)
        self.view_top, self.view_max = plugin.opaque(VIEW_NODES - 1), plugin.opaque(VIEW_NODES - 2)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw from the exit table or cosine-weighted; a broad lobe always cosine-weighted."""
        active = active & enabled[0] & (si.wi.z > plugin.MIN_COS)
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        if not self.is_broad:
            wo = self._drawn(si, sample1, sample2, wo, active)
        value, pdf = self.eval_pdf(ctx, si, wo, active, enabled)
        return plugin.glossy_sample(wo, value, pdf, active)

    def _drawn(self, si: Any, sample1: Any, sample2: Any, cosine: Any, active: Any) -> Any:
        """Return a direction from the exit table, or `cosine` with probability `COSINE_SHARE`."""
        by_cosine = sample1 < COSINE_SHARE
        rest = dr.clip((sample1 - COSINE_SHARE) / (1.0 - COSINE_SHARE), 0.0, 1.0)
        place, _ = self.exits.sample(sample2, [_view(si.wi)], active)
        theta = place[0] * (0.5 * math.pi)
        # |dphi| from the table, its sign from the unused part of the first number
        azimuth = dr.select(rest < 0.5, -place[1], place[1]) * math.pi
        sin_theta, cos_theta = dr.sincos(theta)
        sin_phi, cos_phi = dr.sincos(azimuth)
        x, y = plugin.unit_azimuth(si.wi)
        drawn = mi.Vector3f(sin_theta * (cos_phi * x - sin_phi * y), sin_theta * (cos_phi * y + sin_phi * x), cos_theta)
        return dr.select(by_cosine, cosine, drawn)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(f cos wo, pdf)`."""
        active = active & enabled[0] & (si.wi.z > plugin.MIN_COS) & (wo.z > plugin.MIN_COS)
        value = self._look_up(si, wo, active) * wo.z
        if self.is_broad:
            return value & active, dr.select(active, wo.z * dr.inv_pi, 0.0)
        theta = dr.acos(dr.clip(wo.z, 0.0, 1.0))
        cross = si.wi.x * wo.y - si.wi.y * wo.x
        azimuth = dr.abs(dr.atan2(cross, si.wi.x * wo.x + si.wi.y * wo.y))
        place = mi.Point2f(theta * (2.0 / math.pi), azimuth * dr.inv_pi)
        density = self.exits.eval(place, [_view(si.wi)], active)
        sin_theta = dr.sqrt(dr.maximum(1.0 - wo.z * wo.z, 1e-12))
        # unit square -> theta in [0, pi/2], dphi in [-pi, pi] -> solid angle
        pdf = dr.lerp(density / (math.pi**2 * sin_theta), wo.z * dr.inv_pi, COSINE_SHARE)
        return value & active, dr.select(active, pdf, 0.0)

    def _look_up(self, si: Any, wo: Any, active: Any) -> Any:
        """Interpolate f at the four wavelengths."""
        # the light is the first argument, as in the arrays; the table is only as symmetric as the data
        lows, parts = [], []
        for coordinate, top, most, nodes in zip(
            self._place(wo, si.wi), self.tops, self.max_lows, self.nodes, strict=True
        ):
            if nodes is None:
                x = dr.clip(coordinate, 0.0, 1.0) * top
                low = dr.minimum(dr.floor(x), most)
                lows.append(mi.UInt32(low))
                parts.append(x - low)
            else:
                at, part = _between(nodes, coordinate, most, active)
                lows.append(at)
                parts.append(part)
        where = self.axis.locate(si.wavelengths, active)
        totals = [mi.Float(0.0) for _ in range(self.colours)] if not self.is_spectral else []
        result = mi.UnpolarizedSpectrum(0.0)
        corners = []
        for offsets in itertools.product((0, 1), repeat=len(lows)):
            index = lows[0] + offsets[0]
            for low, offset, size in zip(lows[1:], offsets[1:], self.sizes[1:], strict=True):
                index = index * size + low + offset
            corners.append(index)
        if self.is_spectral:
            starts = [corner * self.channels for corner in corners]
            for k, (low, part) in enumerate(zip(where.low, where.fraction, strict=True)):
                pairs = (plugin.read2(self.values, start + low, active) for start in starts)
                result[k] = _multilinear([dr.lerp(pair[0], pair[1], part) for pair in pairs], parts)
        else:
            starts = [corner * self.colours for corner in corners]
            for j in range(self.colours):
                totals[j] = _multilinear([plugin.read(self.values, start + j, active) for start in starts], parts)
        for total, basis in zip(totals, [] if self.is_spectral else self.basis, strict=True):
            result = result + total * basis.look_up(mi.UInt32(0), mi.Float(0.0), where, None, active)[0]
        return dr.maximum(result, 0.0)

    def _place(self, light: Any, viewer: Any) -> tuple[Any, ...]:
        """Return the coordinates in [0, 1], as `TableLobe.coordinates_of`, led by the light's azimuth if it counts."""
        turn: tuple[Any, ...] = ()
        if self.has_turn:
            x, y = plugin.unit_azimuth(light)
            azimuth = dr.atan2(y, x) * (0.5 * dr.inv_pi)
            turn = (dr.select(azimuth < 0.0, azimuth + 1.0, azimuth),)
        if self.coordinates == "half":
            return *turn, *_to_half(light, viewer)
        to_place = _to_direction if self.coordinates == "direction" else _to_specular
        a, b, azimuth = to_place(light, viewer)
        return *turn, a, b, azimuth * 0.5 + 0.5 if self.is_signed else dr.abs(azimuth)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the wavelength-averaged albedo for this direction."""
        position = _view(si.wi) * self.view_top
        low = dr.minimum(dr.floor(position), self.view_max)
        at = mi.UInt32(low)
        value = dr.lerp(plugin.read(self.albedo, at, active), plugin.read(self.albedo, at + 1, active), position - low)
        return dr.select(si.wi.z > 0.0, value, 0.0)

    def update(self, lobe: TableLobe) -> None:
        """Replace the values.

        Raises:
            UnsupportedError: coordinates or shape differ.
        """
        if (
            lobe.coordinates != self.coordinates
            or np.shape(lobe.values) != self.shape
            or lobe.is_signed != self.is_signed
        ):
            raise UnsupportedError("the table changed its coordinates or its shape; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        self._set(lobe)


def _multilinear(corners: list[Any], parts: list[Any]) -> Any:
    """Interpolate between the corners of a cell; the last coordinate varies fastest."""
    for part in reversed(parts):
        corners = [dr.lerp(near, far, part) for near, far in zip(corners[::2], corners[1::2], strict=True)]
    return corners[0]


def _averaged(lobe: TableLobe) -> TableLobe:
    """Return the table of the wavelength-averaged f, in one channel; the table itself if f may be clamped at zero."""
    if lobe.values.min() < 0.0 or lobe.basis.min() < 0.0:
        return lobe
    values = (lobe.values @ lobe.basis.mean(axis=1))[..., None]
    return dataclasses.replace(lobe, wavelengths_nm=lobe.wavelengths_nm[:1], values=values, basis=np.ones((1, 1)))


def _view(wi: Any) -> Any:
    """Return theta_i in units of 90 degrees."""
    return dr.acos(dr.clip(wi.z, 0.0, 1.0)) * (2.0 / math.pi)


def _to_direction(wi: Any, wo: Any) -> tuple[Any, Any, Any]:
    """Return the "direction" coordinates, as `nacre.bsdf.lobes.table.to_direction`."""
    (x, y), (cos_o, sin_o) = plugin.unit_azimuth(wi), plugin.unit_azimuth(wo)
    return _view(wi), _view(wo), dr.atan2(x * sin_o - y * cos_o, x * cos_o + y * sin_o) * dr.inv_pi


def _to_specular(wi: Any, wo: Any) -> tuple[Any, Any, Any]:
    """Return the "specular" coordinates, as `nacre.bsdf.lobes.table.to_specular`."""
    sin_i = dr.sqrt(dr.maximum(wi.x * wi.x + wi.y * wi.y, 0.0))
    cos_p, sin_p = plugin.unit_azimuth(wi)
    x, y = wo.x * cos_p + wo.y * sin_p, wo.y * cos_p - wo.x * sin_p
    along, to_normal = wi.z * wo.z - sin_i * x, wi.z * x + sin_i * wo.z
    radial = dr.atan2(dr.sqrt(to_normal * to_normal + y * y), along)
    return _view(wi), radial * dr.inv_pi, dr.atan2(-y, to_normal) * dr.inv_pi


def _between(nodes: Any, coordinate: Any, most: Any, active: Any) -> tuple[Any, Any]:
    """Return the lower node and the upper node's weight, clamped beyond the ends."""
    above = dr.binary_search(0, dr.width(nodes), lambda i: plugin.read(nodes, mi.UInt32(i), active) <= coordinate)
    low = mi.UInt32(dr.minimum(mi.Float(dr.maximum(mi.UInt32(above), 1) - 1), most))
    first, last = plugin.read(nodes, low, active), plugin.read(nodes, low + 1, active)
    return low, dr.clip((coordinate - first) / (last - first), 0.0, 1.0)


def _to_half(wi: Any, wo: Any) -> tuple[Any, Any, Any]:
    """Return the "half" coordinates in [0, 1], as `nacre.bsdf.lobes.table.to_half`."""
    h = dr.normalize(wi + wo)
    sin_h = dr.sqrt(dr.maximum(h.x * h.x + h.y * h.y, 0.0))
    cos_p, sin_p = plugin.unit_azimuth(h)
    x, y = wi.x * cos_p + wi.y * sin_p, wi.y * cos_p - wi.x * sin_p
    dx, dz = h.z * x - sin_h * wi.z, sin_h * x + h.z * wi.z
    phi = dr.atan2(y, dx)
    phi = dr.select(phi < 0.0, phi + math.pi, phi)
    # atan2, since acos loses half of the digits near the pole
    theta_h = dr.atan2(sin_h, h.z)
    theta_d = dr.atan2(dr.sqrt(dx * dx + y * y), dz)
    return dr.sqrt(theta_h * (2.0 / math.pi)), theta_d * (2.0 / math.pi), phi * dr.inv_pi
