"""Ridges on the device: a broad diffraction pattern across them, a narrow spread along them.

Sampling works in sines, with cos_o d omega_o = ds_x ds_y: the sine along the ridges from its Gaussian, then the
sine across from a mixture of the envelope sinc^2 and grating orders (the order by the envelope's integral over its
period, the position by the comb of N ridges). The mixture is averaged over the ray's wavelengths, one of which is
drawn. The sine across tabulated ridges is drawn from the table.
"""

import abc
import math
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.ridge import LEAST_CHORD, Ridge, RidgeTable
from nacre.core.errors import UnsupportedError
from nacre.device import plugin
from nacre.device.response import DeviceResponse
from nacre.device.tables import DeviceTable, DeviceTexture, WavelengthAxis

ENVELOPE_CELLS = 4096
COMB_CELLS_PER_RIDGE = 64
MIN_COMB_CELLS = 1024
MAX_COMB_CELLS = 1 << 18
MAX_COMB_SHARE = 0.9


UNIFORM_SHARE = 0.1  # share of samples that are drawn uniformly, not from the table
RidgeT = TypeVar("RidgeT", Ridge, RidgeTable)


class ReflectingRidges(plugin.LobePlugin[RidgeT]):
    """Ridges along y of a frame rotated about the normal, which reflect above the surface only."""

    spread: Any

    def __init__(self, lobe: RidgeT) -> None:
        self.components = (plugin.flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a direction; see the module docstring."""
        frame = plugin.rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        along = self.spread * plugin.normal_number(sample2[1])  # by inversion
        x, y, active = self._draw(
            si, wi, along - wi.y, *plugin.pick_line(sample1), sample2[0], active & enabled[0] & (wi.z > plugin.MIN_COS)
        )
        cos2 = 1.0 - x * x - y * y
        active = active & (cos2 > plugin.MIN_COS)
        wo = mi.Vector3f(x, y, dr.sqrt(dr.maximum(cos2, 0.0)))
        value, pdf = self._eval_pdf(si, wi, wo, active)
        return plugin.glossy_sample(frame(wo, False), value, pdf, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * cos wo, pdf)`."""
        frame = plugin.rotated_frame(self.rotation, si, active)
        wi, wo = frame(si.wi, True), frame(wo, True)
        return self._eval_pdf(si, wi, wo, active & enabled[0] & (wi.z > plugin.MIN_COS) & (wo.z > plugin.MIN_COS))

    def update(self, lobe: RidgeT) -> None:
        """Replace the data.

        Raises:
            UnsupportedError: the rotation texture appeared or vanished, or tables changed shape.
        """
        if (lobe.rotation is None) != (self.rotation is None):
            raise UnsupportedError("the rotation of the ridges appeared or vanished; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)

    @abc.abstractmethod
    def _draw(self, si: Any, wi: Any, y: Any, line: Any, rest: Any, number: Any, active: Any) -> Any:
        """Draw the sine across the ridges at the sine `y` along them; return both and `active`.

        Args:
            line, rest: the chosen wavelength and a uniform number.
            number: another uniform number.
        """

    @abc.abstractmethod
    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]: ...


class RidgePlugin(ReflectingRidges[Ridge]):
    """f = fill R K(u, v) D_y / norm."""

    kind = "ridge"

    def __init__(self, lobe: Ridge) -> None:
        super().__init__(lobe)
        self.response = DeviceResponse(lobe.response)
        self.inverse_norm = DeviceTable(_row(lobe.norm))
        self.deviation: Any = None
        self.fill: Any = None
        self._set_numbers(lobe)

    def _set_numbers(self, lobe: Ridge) -> None:
        self.pitch, self.width = plugin.opaque(lobe.pitch_nm), plugin.opaque(lobe.width_nm)
        self.count, self.spread = plugin.opaque(lobe.count), plugin.opaque(lobe.spread_along)
        self.deviation = plugin.replaced(self.deviation, plugin.opaque(lobe.height_deviation_nm))
        self.fill = plugin.replaced(self.fill, plugin.opaque(lobe.fill))
        # the envelope in t = u b/2, over the range of the renderer's wavelengths (>= 360 nm)
        shortest = min(float(lobe.wavelengths_nm[0]), 360.0)
        self.envelope = StepDensity(
            lambda t: np.square(np.sinc(t / np.pi)), 2.0 * math.pi * lobe.width_nm / shortest, ENVELOPE_CELLS
        )
        # a power of two: similar counts share a kernel
        cell_count = np.clip(COMB_CELLS_PER_RIDGE * lobe.count, MIN_COMB_CELLS, MAX_COMB_CELLS)
        cells = 1 << int(np.ceil(np.log2(cell_count)))
        self.comb = StepDensity(
            lambda x: np.square(lobe.count * np.sinc(lobe.count * x) / np.sinc(x)) / lobe.count, 0.5, cells
        )

    def _draw(self, si: Any, wi: Any, y: Any, line: Any, rest: Any, number: Any, active: Any) -> Any:
        """Draw a direction from a grating order or from the envelope, at one wavelength."""
        limit = dr.sqrt(dr.maximum(1.0 - y * y, 0.0))
        wavelength = self._limited(plugin.of_line(si.wavelengths, line))
        share = self._comb_share(wi, wavelength)
        scale = math.pi * self.width / wavelength  # t per sine
        low, high = self.envelope.cdf((wi.x - limit) * scale), self.envelope.cdf((wi.x + limit) * scale)
        across = self.envelope.invert(dr.lerp(low, high, number), active) / scale
        period = wavelength / self.pitch
        order = dr.round(across / period)
        place = self.comb.invert(dr.clip(rest / dr.maximum(share, 1e-6), 0.0, 1.0), active)
        x = dr.select(rest < share, (order + place) * period, across) - wi.x
        return x, y, active & (limit > plugin.MIN_COS)

    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        psi = wi + wo
        reflected, _ = self.response.look_up(0.5 * dr.norm(psi), mi.Bool(False), si, active)
        where = self.axis.locate(si.wavelengths, active)
        (inverse_norm,) = self.inverse_norm.look_up(mi.UInt32(0), mi.Float(0.0), where, None, active)
        along = psi.y / self.spread
        gauss = dr.exp(-0.5 * along * along) / (self.spread * math.sqrt(2.0 * math.pi))
        limit = dr.sqrt(dr.maximum(1.0 - wo.y * wo.y, 0.0))
        spread, across_pdf = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        for i in range(lines):
            wavelength = self._limited(si.wavelengths[i])
            spread[i] = self._interference(psi, wavelength)
            across_pdf = across_pdf + self._across_pdf(wi, psi.x, limit, wavelength, active) / lines
        value = reflected * spread * inverse_norm * (self.fill * gauss * wo.z)
        return value & active, dr.select(active, across_pdf * gauss * wo.z, 0.0)

    def _interference(self, psi: Any, wavelength: Any) -> Any:
        """Return K(u, v)."""
        k = 2.0 * math.pi / wavelength
        envelope = dr.square(_sinc(0.5 * k * psi.x * self.width))
        chi2 = dr.exp(-dr.square(k * psi.z * self.deviation))
        turns = psi.x * self.pitch / wavelength
        rest = math.pi * (turns - dr.round(turns))
        comb = dr.square(self.count * _sinc(self.count * rest) / _sinc(rest))
        return envelope * (1.0 - chi2 + chi2 * comb / self.count)

    def _across_pdf(self, wi: Any, across: Any, limit: Any, wavelength: Any, active: Any) -> Any:
        """Return the density of the sine across the ridges at one wavelength."""
        scale = math.pi * self.width / wavelength
        low, high = self.envelope.cdf((wi.x - limit) * scale), self.envelope.cdf((wi.x + limit) * scale)
        width = dr.maximum(high - low, 1e-12)
        broad = self.envelope.density(across * scale, active) * scale / width
        period = wavelength / self.pitch
        turns = across / period
        order = dr.round(turns)
        start = dr.maximum((order - 0.5) * period, wi.x - limit) * scale
        end = dr.minimum((order + 0.5) * period, wi.x + limit) * scale
        in_order = dr.maximum(self.envelope.cdf(end) - self.envelope.cdf(start), 0.0) / width
        narrow = in_order * self.comb.density(turns - order, active) / period
        return dr.lerp(broad, narrow, self._comb_share(wi, wavelength))

    def _comb_share(self, wi: Any, wavelength: Any) -> Any:
        """Return the probability of grating orders: the coherence at the most grazing exit, its maximum."""
        chi2 = dr.exp(-dr.square(2.0 * math.pi / wavelength * wi.z * self.deviation))
        return dr.minimum(chi2, MAX_COMB_SHARE)

    def _limited(self, wavelength: Any) -> Any:
        """Limit the wavelength from below, since test harnesses pass 0."""
        return dr.maximum(wavelength, 200.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the stack's reflectance at the ray's angle, times the covered fraction."""
        reflected, _ = self.response.look_up(dr.abs(si.wi.z), mi.Bool(False), si, active)
        return dr.select(si.wi.z > 0.0, dr.mean(reflected) * self.fill, 0.0)

    def update(self, lobe: Ridge) -> None:
        """Replace the data; see `ReflectingRidges.update`."""
        super().update(lobe)
        self.response.update(lobe.response)
        self.inverse_norm.update(_row(lobe.norm))
        self._set_numbers(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the stack's tables and the ridge dimensions."""
        self.response.traverse(callback, prefix)
        if dr.is_jit_v(mi.Float):
            callback.put(f"{prefix}height_deviation_nm", self.deviation, mi.ParamFlags.Differentiable)
            callback.put(f"{prefix}fill", self.fill, mi.ParamFlags.Differentiable)

    def parameters_changed(self) -> None:
        """Repack the tables."""
        self.response.table.repack()


class StepDensity:
    """A piecewise constant density over [-reach, reach], for exactly consistent sampling and density."""

    def __init__(self, function: Any, reach: float, cells: int) -> None:
        edges = np.linspace(-reach, reach, cells + 1)
        # two-point Gauss rule in each cell: positive
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (edges[1] - edges[0])
        mass = function(middle - half / math.sqrt(3.0)) + function(middle + half / math.sqrt(3.0))
        mass = mass + 1e-6 * mass.mean()  # avoids empty cells
        cdf = np.concatenate([[0.0], np.cumsum(mass)])
        cdf /= cdf[-1]
        self.table = plugin.device_array(cdf)
        self.cell_count = cells  # part of the kernel: it sets the number of search steps
        self.edges = plugin.UniformNodes(cells + 1)
        self.per_unit = plugin.opaque(cells / (2.0 * reach))
        self.reach = plugin.opaque(reach)

    def _cell(self, x: Any) -> tuple[Any, Any]:
        return self.edges.cell(dr.clip((x + self.reach) * self.per_unit, 0.0, self.edges.last))

    def cdf(self, x: Any, active: Any = True) -> Any:
        """Return the cumulative probability at `x`."""
        low, fraction = self._cell(x)
        return dr.lerp(plugin.read(self.table, low, active), plugin.read(self.table, low + 1, active), fraction)

    def density(self, x: Any, active: Any = True) -> Any:
        """Return the density at `x`."""
        low, _ = self._cell(x)
        step = plugin.read(self.table, low + 1, active) - plugin.read(self.table, low, active)
        return dr.select(dr.abs(x) <= self.reach, step * self.per_unit, 0.0)

    def invert(self, share: Any, active: Any = True) -> Any:
        """Return the inverse of `cdf`."""
        low = dr.binary_search(0, self.cell_count, lambda i: plugin.read(self.table, i + 1, active) < share)
        low = dr.minimum(mi.UInt32(low), self.edges.max_low)
        start, end = plugin.read(self.table, low, active), plugin.read(self.table, low + 1, active)
        fraction = dr.clip((share - start) / dr.maximum(end - start, 1e-20), 0.0, 1.0)
        return (mi.Float(low) + fraction) / self.per_unit - self.reach


def _row(norm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of `[wavelength]` as `[row, wavelength, channel]`."""
    return 1.0 / np.asarray(norm, dtype=float)[None, :, None]


def _sinc(x: Any) -> Any:
    """Return sin(x)/x: a series below 0.5, since the sine of a GPU is exact to 5e-7 absolute, not relative."""
    near, square = dr.abs(x) < 0.5, x * x
    series = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    return dr.select(near, series, dr.sin(x) / dr.select(near, mi.Float(1.0), x))


class RidgeTablePlugin(ReflectingRidges[RidgeTable]):
    """f = fill D(a, b, c) / sqrt(1 - c^2) D_y."""

    kind = "ridge-table"

    def __init__(self, lobe: RidgeTable) -> None:
        super().__init__(lobe)
        self._set(lobe)

    def _set(self, lobe: RidgeTable) -> None:
        self.shape = lobe.power.shape
        power = lobe.power if lobe.power.shape[3] > 1 else np.repeat(lobe.power, 2, axis=3)
        alongs, sines, _, waves = power.shape
        self.power = plugin.device_array(power)
        self.along_nodes, self.sine_nodes = plugin.UniformNodes(alongs), plugin.UniformNodes(sines)
        self.strides = [plugin.opaque_int(n) for n in (sines * sines * waves, sines * waves, waves)]
        self.half = plugin.opaque(0.5 * (sines - 1))
        self.cells = sines - 1  # part of the kernel: it sets the number of search steps
        self.sine_count, self.wave_count = plugin.opaque_int(sines), plugin.opaque_int(waves)
        self.spread, self.fill = plugin.opaque(lobe.spread_along), plugin.opaque(lobe.fill)
        # density at the exits' nodes and probability of each cell between them, cumulated: [c, a, wavelength, exit]
        rows = np.moveaxis(power, 3, 2).astype(float)
        total = 0.5 * (rows[..., 1:] + rows[..., :-1]).sum(axis=-1, keepdims=True)
        is_dark = total < 1e-12
        shape = np.where(is_dark, 1.0, rows / np.where(is_dark, 1.0, total) * self.cells)
        density = ((1.0 - UNIFORM_SHARE) * shape + UNIFORM_SHARE) / self.cells
        share = 0.5 * (density[..., 1:] + density[..., :-1])
        self.density = plugin.device_array(density)
        self.cumulated = plugin.device_array(np.cumsum(share, axis=-1) / share.sum(axis=-1, keepdims=True))
        self.albedo = plugin.device_array(lobe.fill * total.mean(axis=(2, 3)) * (2.0 / self.cells))

    def _draw(self, si: Any, wi: Any, y: Any, line: Any, rest: Any, number: Any, active: Any) -> Any:
        """Draw from the table at the nodes nearest to the light and to one of the wavelengths."""
        _, chord = _along(wi.y, y)
        where = self.axis.locate(si.wavelengths, active)
        row = self._node(wi) * self.wave_count + _nearest(
            plugin.of_line(where.low, line), plugin.of_line(where.fraction, line)
        )
        start = row * mi.UInt32(self.cells)
        drawn = dr.clip(number, 0.0, 0.9999999)
        cell = dr.binary_search(
            0, self.cells - 1, lambda i: plugin.read(self.cumulated, start + mi.UInt32(i), active) < drawn
        )
        cell = mi.UInt32(cell)
        first = dr.select(cell > 0, plugin.read(self.cumulated, start + dr.maximum(cell, 1) - 1, active), 0.0)
        last = plugin.read(self.cumulated, start + cell, active)
        share = dr.clip((drawn - first) / dr.maximum(last - first, 1e-12), 0.0, 1.0)
        # a linear density in the cell, by inversion
        p_0, p_1 = self._ends(row, cell, active)
        place = share * (p_0 + p_1) / (p_0 + dr.safe_sqrt(dr.lerp(p_0 * p_0, p_1 * p_1, share)))
        return ((mi.Float(cell) + place) / self.half - 1.0) * chord, y, active

    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        c, chord = _along(wi.y, wo.y)
        a, b = wi.x / chord, wo.x / chord
        active = active & (dr.abs(a) <= 1.0) & (dr.abs(b) <= 1.0)
        along = (wi.y + wo.y) / self.spread
        gauss = dr.exp(-0.5 * along * along) / (self.spread * math.sqrt(2.0 * math.pi)) * wo.z / chord
        where = self.axis.locate(si.wavelengths, active)
        k, f_c = self.along_nodes.cell(c * self.along_nodes.last)
        i, f_a = self.sine_nodes.cell((dr.clip(a, -1.0, 1.0) + 1.0) * self.half)
        j, f_b = self.sine_nodes.cell((dr.clip(b, -1.0, 1.0) + 1.0) * self.half)
        start = k * self.strides[0] + i * self.strides[1] + j * self.strides[2]
        node = self._node(wi) * self.wave_count
        value, density = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        for line in range(lines):
            low, part = where.low[line], where.fraction[line]
            planes = []
            for plane in (start + low, start + low + self.strides[0]):
                rows = []
                for row in (plane, plane + self.strides[1]):
                    ends = [
                        dr.lerp(plugin.read(self.power, at, active), plugin.read(self.power, at + 1, active), part)
                        for at in (row, row + self.strides[2])
                    ]
                    rows.append(dr.lerp(ends[0], ends[1], f_b))
                planes.append(dr.lerp(rows[0], rows[1], f_a))
            value[line] = dr.lerp(planes[0], planes[1], f_c)
            p_0, p_1 = self._ends(node + _nearest(low, part), j, active)
            density = density + dr.lerp(p_0, p_1, f_b) / lines
        return value * (self.fill * gauss) & active, dr.select(active, density * self.half * gauss, 0.0)

    def _node(self, wi: Any) -> Any:
        """Return the index of the node nearest to the light direction, mirrored along the ridges."""
        c, chord = _along(wi.y, -wi.y)
        k = mi.UInt32(dr.round(c * self.along_nodes.last))
        return k * self.sine_count + mi.UInt32(dr.round((dr.clip(wi.x / chord, -1.0, 1.0) + 1.0) * self.half))

    def _ends(self, row: Any, cell: Any, active: Any) -> tuple[Any, Any]:
        """Return the density at both ends of a cell."""
        at = row * self.sine_count + cell
        return plugin.read(self.density, at, active), plugin.read(self.density, at + 1, active)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the reflected light, averaged over wavelengths, at the nearest node."""
        wi = plugin.rotated_frame(self.rotation, si, active)(si.wi, True)
        return dr.select(wi.z > 0.0, plugin.read(self.albedo, self._node(wi), active), 0.0)

    def update(self, lobe: RidgeTable) -> None:
        """Replace the data; see `ReflectingRidges.update`."""
        if lobe.power.shape != self.shape:
            raise UnsupportedError("the table of the ridges changed its shape; build the scene again")
        super().update(lobe)
        self._set(lobe)


def _along(y_i: Any, y_o: Any) -> tuple[Any, Any]:
    """Return c and sqrt(1 - c^2)."""
    c = dr.minimum(0.5 * dr.abs(y_i - y_o), 1.0)
    return c, dr.sqrt(dr.maximum(1.0 - c * c, LEAST_CHORD**2))


def _nearest(low: Any, part: Any) -> Any:
    """Return the nearer of a wavelength cell's two nodes."""
    return low + dr.select(part > 0.5, mi.UInt32(1), 0)
