"""The diffuse light of monolayers on the device: azimuthal series times the sharp structure factor.

Look-up time is bound by cache lines, then by arithmetic. The harmonics of an angle pair at one wavelength are
therefore packed in two or four words (`EncodedSeries`), next to those of the next wavelength. S is read at each
wavelength's exact |q|. Directions are drawn from a coarse exit table (`bilinear_sampling`). For aligned particles
this table depends only on the azimuth difference and is averaged over the rotation; the weights contain the rest.
"""

import abc
import dataclasses
import math
from typing import Any, ClassVar, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.monolayer import DARKEST, PACKET, SHARED, WORD, Aligned, Harmonic, MonolayerLobe, encode
from nacre.core.arrays import Array, SingleArray, direction, rotation_about_z
from nacre.core.errors import UnsupportedError
from nacre.device import plugin
from nacre.device.tables import WavelengthAxis


class PackedSeries:
    """Series coefficients `[row, number, wavelength]`, packed in integers `[row, wavelength, packet, word]`.

    Attributes:
        words: 32-bit words per packet.
        units: quantisation step of each coefficient; its harmonic is multiplied by it.
    """

    def __init__(self, rows: NDArray[np.float32], packets: int) -> None:
        if rows.shape[2] == 1:
            rows = np.repeat(rows, 2, axis=2)
        if math.prod((rows.shape[0], rows.shape[2], packets, 4)) >= 2**32:
            raise UnsupportedError("the harmonic table is too large for rendering; use fewer wavelengths")
        made = encode(rows, packets)
        self.words = made.words.shape[3]
        self.packets = packets
        self.units = [plugin.opaque(unit) for unit in made.units]
        self.places = [word for word, _, _ in made.fields]
        self.on_device = dr.is_jit_v(mi.Float)
        shifts = [WORD - low - bits for _, low, bits in made.fields]
        # fields at the top of a word, known from the layout, need no shift
        tops = [members[0] for members in SHARED[self.words]]
        self.shifts: list[Any] = [
            None if k % PACKET in tops else dr.opaque(mi.UInt32, s) if self.on_device else s
            for k, s in enumerate(shifts)
        ]
        flat = made.words.reshape(-1, self.words)
        self.values = mi.UInt32(plugin.aligned(flat, np.uint32)) if self.on_device else flat

    def read(self, index: Any, packet: int, active: Any) -> tuple[list[Any], Any]:
        """Return a packet's numbers, in `units`, and their common factor.

        Args:
            index: (row * wavelengths + wavelength) * packets + packet.
            packet: number of the packet within the series.
            active: mask.
        """
        here = slice(PACKET * packet, PACKET * (packet + 1))
        fields = list(zip(self.places[here], self.shifts[here], strict=True))
        if not self.on_device:
            if not active:
                return [0.0] * PACKET, 1.0
            words = [int(word) for word in self.values[int(index)]]
            numbers = [_signed((words[at] << (shift or 0)) & 0xFFFFFFFF) for at, shift in fields]
            return numbers, 2.0 ** -(words[0] & DARKEST)
        words = dr.gather(mi.ArrayXu, self.values, index, active, shape=(self.words, dr.width(index)))
        factor = dr.reinterpret_array(mi.Float, (127 - (words[0] & DARKEST)) << 23)  # a power of two from its bits
        return [mi.Float(mi.Int32(words[at] if shift is None else words[at] << shift)) for at, shift in fields], factor

    def sum(self, place: Any, harmonics: list[Any], active: Any) -> Any:
        """Return the sum of a series.

        Args:
            place: row * wavelengths + wavelength.
            harmonics: the harmonics, times `units`.
            active: mask.
        """
        total = mi.Float(0.0)
        for j in range(self.packets):
            numbers, factor = self.read(place * self.packets + j, j, active)
            part = mi.Float(0.0)
            for number, harmonic in zip(numbers, harmonics[PACKET * j : PACKET * (j + 1)], strict=True):
                part = dr.fma(number, harmonic, part)
            total = dr.fma(part, factor, total)
        return total


def _signed(word: int) -> float:
    return float(word - 2**WORD if word >= 2 ** (WORD - 1) else word)


HALF = 0xFFFF  # the largest 16-bit number
COSINE_SHARE = 0.1  # fraction of the samples: covers all directions and bounds the weights
# mean square weight below which an opaque lobe uses cosine-weighted sampling: 10 % more variance in a sixth of the time
BROAD = 1.1
VIEW_NODES, EXIT_NODES, AZIMUTH_NODES = 12, 9, 9  # nodes on each side; more do not reduce the noise

AnyMonolayer = TypeVar("AnyMonolayer", bound=MonolayerLobe)


class MonolayerPlugin(plugin.LobePlugin[AnyMonolayer]):
    """Common part of both monolayer plugins: polar angles, S, and sampling from an exit table.

    Attributes:
        tables: names of the lobe's tables.
        is_turned: whether values depend on both azimuths rather than only on their difference.
    """

    tables: ClassVar[tuple[str, ...]]
    is_turned: ClassVar[bool] = False
    values: PackedSeries
    free: PackedSeries | None = None
    packets: int

    def __init__(self, lobe: AnyMonolayer) -> None:
        sides: tuple[str, ...] = ("FrontSide", "BackSide") if lobe.transmits else ("FrontSide",)
        sides = ("Anisotropic", *sides) if self.is_turned else sides
        self.transmits = lobe.transmits
        self.components = (plugin.flag("GlossyReflection", *sides),)
        if lobe.transmits:
            self.components += (plugin.flag("GlossyTransmission", *sides),)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.has_constant_index = _has_constant_index(lobe)
        self._set(lobe)

    @abc.abstractmethod
    def _set_tables(self, lobe: AnyMonolayer) -> None:
        """Copy the series to the device."""

    def _thinned(self, lobe: AnyMonolayer) -> AnyMonolayer:
        """Return the lobe at about a dozen wavelengths, enough for sampling."""
        step = max(1, len(lobe.wavelengths_nm) // 12)
        names = (*self.tables, "wavelengths_nm", "wavenumbers", "index_below")
        thinned: dict[str, Any] = {name: np.ascontiguousarray(getattr(lobe, name)[..., ::step]) for name in names}
        return dataclasses.replace(lobe, **thinned)

    @abc.abstractmethod
    def _pair(self, light: Any, eye: Any, sines: tuple[Any, Any], places: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return harmonics, the triangle's three rows, and the larger and the smaller fraction of a direction pair.

        Args:
            light, eye: the directions.
            sines: their sines.
            places: their lower nodes and fractions.
        """

    def _look_up(self, si: Any, light: Any, eye: Any, active: Any) -> Any:
        """Interpolate f at the four wavelengths."""
        sin_l = dr.sqrt(light.x * light.x + light.y * light.y)
        sin_e = dr.sqrt(eye.x * eye.x + eye.y * eye.y)
        places = (*self._coordinate(light, sin_l), *self._coordinate(eye, sin_e))
        harmonics, rows, upper, lower = self._pair(light, eye, (sin_l, sin_e), places)
        up_l, up_e = light.z > 0.0, eye.z > 0.0
        squares = self._squares(sin_l, sin_e, light.x * eye.x + light.y * eye.y, up_l, up_e)
        tables = [self.values] if self.free is None else [self.values, self.free]
        series = [[wave * unit for wave, unit in zip(harmonics, table.units, strict=True)] for table in tables]
        where = self.axis.locate(si.wavelengths, active)
        result = mi.UnpolarizedSpectrum(0.0)
        for k, (node, part) in enumerate(zip(where.low, where.fraction, strict=True)):
            corners = tetrahedron([row * self.nodes + node for row in rows], upper, lower, part)
            value = interpolated(self.values, corners, series[0], active)
            value = value * self._structure(si.wavelengths[k], node, part, squares, active)
            if self.free is not None:
                value = value + interpolated(self.free, corners, series[1], active)
            result[k] = value
        return result * (self._fall(light, up_l, 1.0) * self._fall(eye, up_e, self.eta * self.eta))

    def _mean(self, lobe: AnyMonolayer, light: Array, eye: Array) -> Array:
        """Return f averaged over wavelengths, `[...]`, for directions `[..., 3]`."""
        return np.asarray(lobe.evaluate(light, eye).mean(axis=-1))

    def _shape(self, lobe: AnyMonolayer) -> list[tuple[int, ...]]:
        """Return the table shapes, which are constant in updates."""
        return [getattr(lobe, name).shape for name in self.tables]

    def _set(self, lobe: AnyMonolayer) -> None:
        self.shape = self._shape(lobe)
        self.axis.update(lobe.wavelengths_nm)
        self.nodes = plugin.opaque_int(max(2, len(lobe.wavelengths_nm)))
        self._set_tables(lobe)
        self.count_above = plugin.opaque_int(lobe.count_above)
        self.edge_above, self.top_above = plugin.opaque(lobe.count_above - 0.5), plugin.opaque(lobe.count_above - 1)
        if lobe.transmits:
            size = lobe.count_below + lobe.count_beyond
            self.edge_below, self.top_below = plugin.opaque(lobe.count_below - 0.5), plugin.opaque(size - 1)
            self.beyond = plugin.opaque(lobe.count_beyond)
            critical = lobe.grid_below.critical_rad
            self.cos_critical, self.sin_critical = plugin.opaque(math.cos(critical)), plugin.opaque(math.sin(critical))
            self.per_beyond = plugin.opaque(1.0 / max(math.pi / 2 - critical, 1e-6))
        self.per_last = [plugin.opaque(1.0 / cosine) for cosine in lobe.last_cosines]
        self.eta = plugin.opaque(lobe.eta)
        # wavenumber over the table's step, and the index below, at both ends of each wavelength interval
        self.per_step = None
        if _has_constant_index(lobe):
            self.steps_nm = plugin.opaque(lobe.wavenumbers[0] * lobe.wavelengths_nm[0] / lobe.q_step)
            self.shortest, self.longest = plugin.opaque(lobe.wavelengths_nm[0]), plugin.opaque(lobe.wavelengths_nm[-1])
        else:
            self.per_step = plugin.device_array(_pairs(lobe.wavenumbers / lobe.q_step))
        self.index = plugin.device_array(_pairs(lobe.index_below))
        self.s_values, self.s_unit = _halves(lobe.structure)
        self.s_last = plugin.opaque(len(lobe.structure) - 1)
        self._set_sampling(lobe)

    def _set_sampling(self, lobe: AnyMonolayer) -> None:
        """Tabulate the wavelength-averaged f on (theta_i; side, |dphi|, sin^2 theta_o), for sampling by |cos_o| f."""
        hemispheres = 2 if self.transmits else 1
        views = VIEW_NODES * hemispheres
        # uniform in the cosine, which avoids an arc function
        depth = 2.0 if self.transmits else 1.0
        ti = np.arccos(np.clip(1.0 - np.linspace(0.0, depth, views), 1e-3 - (depth - 1.0), 1.0 - 1e-6))
        square = np.clip(np.linspace(0.0, 1.0, EXIT_NODES), 1e-6, 1.0 - 1e-5)
        dphi = np.linspace(0.0, math.pi, AZIMUTH_NODES)
        up = direction(np.arcsin(np.sqrt(square)), dphi[:, None])  # azimuth, exit
        wo = np.stack([up * [1.0, 1.0, sign] for sign in (1.0, -1.0)[:hemispheres]])
        thin = self._thinned(lobe)
        means = np.empty((views, hemispheres, AZIMUTH_NODES, EXIT_NODES))
        for k, angle in enumerate(ti):
            # on the device `wi` is the camera and `wo` the light; the roles differ only by a factor
            means[k] = self._mean(thin, wo, np.broadcast_to(direction(angle, 0.0), wo.shape))
        # equal areas of the square are equal cosine-weighted solid angles
        inner = np.ones((AZIMUTH_NODES, EXIT_NODES))
        inner[[0, -1]] *= 0.5
        inner[:, [0, -1]] *= 0.5
        inner /= inner.sum()
        albedo = math.pi * np.einsum("vsae,ae->v", means, inner)
        squares = math.pi**2 * np.einsum("vsae,ae->v", means**2, inner)
        self.is_broad = not self.transmits and bool(np.all(squares <= BROAD * albedo**2))
        self.exits: Any = None
        if not self.is_broad:
            level = (albedo / math.pi / hemispheres)[:, None, None, None]
            self.exits = BilinearDensity((1.0 - COSINE_SHARE) * means + COSINE_SHARE * level + 1e-9)
        self.per_depth = plugin.opaque((views - 1) / depth)
        self.albedo = plugin.device_array(_pairs(albedo))
        self.view_max = plugin.opaque(views - 2)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw from the exit table; a broad lobe cosine-weighted."""
        active = active & self._visible(si.wi)
        if self.is_broad:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            value, pdf = self.eval_pdf(ctx, si, wo, active, enabled)
        else:
            wo, place = self._drawn(si, sample1, sample2, active)
            active = active & self._enabled_exit(si, wo, enabled)
            value = self._value(ctx, si, wo, active) & active
            pdf = self._density(si, wo, *place, active)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = wo, pdf, mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        if self.transmits:
            reflects = si.wi.z * wo.z > 0.0
            plugin.set_transmission(bs, reflects, dr.select(si.wi.z > 0.0, self.eta, 1.0 / self.eta))
        return bs, (value * dr.rcp(plugin.larger(pdf, 1e-20))) & (active & (pdf > 0.0))

    def _drawn(self, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple[Any, tuple[Any, Any, Any]]:
        """Return a direction from the exit table, and its table coordinates."""
        row, part = self._view(si.wi)
        face, square, turn, rest = self.exits.sample(row, part, sample1, sample2, active)
        azimuth = dr.select(rest < 0.5, -turn, turn) * math.pi
        sin_theta, cos_theta = dr.sqrt(square), dr.sqrt(1.0 - square)
        sin_phi, cos_phi = dr.sincos(azimuth)
        x, y = plugin.unit_azimuth(si.wi)
        wo = mi.Vector3f(
            sin_theta * (cos_phi * x - sin_phi * y),
            sin_theta * (cos_phi * y + sin_phi * x),
            dr.select(face == 0, cos_theta, -cos_theta),
        )
        return wo, (face, square, turn)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(f |cos wo|, pdf)`."""
        active = active & self._visible(si.wi) & self._enabled_exit(si, wo, enabled)
        value = self._value(ctx, si, wo, active) & active
        if self.is_broad:
            return value, dr.select(active, wo.z * dr.inv_pi, 0.0)
        cross = si.wi.x * wo.y - si.wi.y * wo.x
        azimuth = dr.abs(dr.atan2(cross, si.wi.x * wo.x + si.wi.y * wo.y))
        face = dr.select(wo.z > 0.0, mi.UInt32(0), mi.UInt32(1))
        square = plugin.smaller(wo.x * wo.x + wo.y * wo.y, 1.0)
        return value, self._density(si, wo, face, square, azimuth * dr.inv_pi, active)

    def _value(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        light, eye = (wo, si.wi) if plugin.is_radiance(ctx) else (si.wi, wo)
        return self._look_up(si, light, eye, active) * dr.abs(wo.z)

    def _density(self, si: Any, wo: Any, face: Any, square: Any, turn: Any, active: Any) -> Any:
        """Return the density at table coordinates: side, sin^2 theta and azimuth / pi."""
        row, part = self._view(si.wi)
        density = self.exits.density(row, part, face, square, turn, active)
        # unit square -> sin^2 theta, dphi in [-pi, pi] -> solid angle
        return dr.select(active, density * dr.abs(wo.z) * dr.inv_pi, 0.0)

    def _enabled_exit(self, si: Any, wo: Any, enabled: tuple[bool, ...]) -> Any:
        """Whether an exit direction is visible and its component enabled."""
        if not self.transmits:
            return self._visible(wo) & enabled[0]
        return self._visible(wo) & dr.select(si.wi.z * wo.z > 0.0, mi.Bool(enabled[0]), mi.Bool(enabled[1]))

    def _visible(self, w: Any) -> Any:
        return dr.abs(w.z) > plugin.MIN_COS if self.transmits else w.z > plugin.MIN_COS

    def _view(self, wi: Any) -> tuple[Any, Any]:
        """Return the view direction's lower row, and the fraction to the next."""
        position = plugin.larger(1.0 - wi.z, 0.0) * self.per_depth
        low = plugin.smaller(dr.floor(position), self.view_max)
        return mi.UInt32(low), position - low

    def _coordinate(self, w: Any, sine: Any) -> tuple[Any, Any]:
        """Return a polar angle's lower node (nodes below follow those above) and fraction; see `PolarGrid`."""
        if not self.transmits:
            x = dr.atan2(sine, w.z) * (2.0 / math.pi) * self.edge_above
            top = self.top_above
        else:
            # one arc tangent for three angles: to the normal above, of the refracted ray below, and to the critical
            # angle beyond it
            cosine, up = dr.abs(w.z), w.z > 0.0
            outer = self.eta * sine
            past = plugin.negated(up) & (outer >= 1.0)
            outer_cosine = dr.sqrt(plugin.larger(1.0 - outer * outer, 0.0))
            y = dr.select(up, sine, dr.select(past, sine * self.cos_critical - cosine * self.sin_critical, outer))
            z = dr.select(
                up, cosine, dr.select(past, sine * self.sin_critical + cosine * self.cos_critical, outer_cosine)
            )
            angle = dr.atan2(y, z)
            below = dr.select(
                past,
                dr.fma(dr.sqrt(plugin.larger(angle, 0.0) * self.per_beyond), self.beyond, self.edge_below),
                angle * (2.0 / math.pi) * self.edge_below,
            )
            top = dr.select(up, self.top_above, self.top_below)
            x = dr.select(up, angle * (2.0 / math.pi) * self.edge_above, below)
        x = plugin.smaller(x, top)
        low = plugin.smaller(dr.floor(x), top - 1.0)
        node = mi.UInt32(low)
        return (node + dr.select(up, 0, self.count_above) if self.transmits else node), x - low

    def _fall(self, w: Any, up: Any, below: Any) -> Any:
        """Return 1 above, or `below`; beyond the last node of the side the value decreases to zero like the cosine."""
        fall = plugin.smaller(dr.abs(w.z) * self.per_last[0], 1.0)
        if not self.transmits:
            return fall
        return dr.select(up, fall, plugin.smaller(dr.abs(w.z) * self.per_last[1], 1.0) * below)

    def _squares(self, sin_l: Any, sin_e: Any, dot: Any, up_l: Any, up_e: Any) -> list[Any]:
        """Return |q|^2 over k^2 as a polynomial in the index below: terms of two, one and zero directions above."""
        light, eye, both = sin_l * sin_l, sin_e * sin_e, 2.0 * dot
        if not self.transmits:
            return [light + eye + both]
        above = dr.select(up_l, light, 0.0) + dr.select(up_e, eye, 0.0) + dr.select(up_l & up_e, both, 0.0)
        across = dr.select(up_l ^ up_e, both, 0.0)
        return [above, across, light + eye + both - above - across]

    def _structure(self, wavelength: Any, low: Any, part: Any, squares: list[Any], active: Any) -> Any:
        """Read S at |q| of a wavelength."""
        if self.per_step is None:
            scale = self.steps_nm / plugin.larger(plugin.smaller(wavelength, self.longest), self.shortest)
        else:
            ends = plugin.read2(self.per_step, low, active)
            scale = dr.lerp(ends[0], ends[1], part)
        square = squares[0]
        if self.transmits:
            # nodes are always within the table: without a mask, `eval` and `sample` share the read
            ends = plugin.read2(self.index, low)
            index = dr.lerp(ends[0], ends[1], part)
            square = dr.fma(dr.fma(squares[2], index, squares[1]), index, square)
        x = scale * dr.sqrt(plugin.larger(square, 0.0))
        inside = x < self.s_last
        x = plugin.smaller(x, self.s_last - 1e-3)
        at = dr.floor(x)
        word = _word(self.s_values, mi.UInt32(at), active)
        value = dr.lerp(mi.Float(word & HALF), mi.Float(word >> 16), x - at) * self.s_unit
        return dr.select(inside, value, 1.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the wavelength-averaged albedo for this direction."""
        row, part = self._view(si.wi)
        ends = plugin.read2(self.albedo, row, active)
        return dr.select(self._visible(si.wi), dr.lerp(ends[0], ends[1], part), 0.0)

    def update(self, lobe: AnyMonolayer) -> None:
        """Replace the data by another monolayer's.

        Raises:
            UnsupportedError: the table shapes differ.
        """
        if _has_constant_index(lobe) != self.has_constant_index:
            raise UnsupportedError("only one of the ambients is dispersive; build the scene again")
        if self._shape(lobe) != self.shape:
            raise UnsupportedError("the harmonic tables changed their shape; build the scene again")
        self._set(lobe)


class HarmonicPlugin(MonolayerPlugin[Harmonic]):
    """Broad reflection, and transmission if the lobe transmits."""

    kind = "harmonic"
    tables = ("above", "below", "across", "above_free", "below_free", "across_free")

    def _set_tables(self, lobe: Harmonic) -> None:
        self.packets = -(-lobe.above.shape[1] // PACKET)
        self.values = PackedSeries(_one_triangle(lobe.above, lobe.below, lobe.across), self.packets)
        if lobe.above_free.shape[0]:
            free = _one_triangle(lobe.above_free, lobe.below_free, lobe.across_free)
            self.free = PackedSeries(free, self.packets)

    def _pair(self, light: Any, eye: Any, sines: tuple[Any, Any], places: tuple[Any, ...]) -> tuple[Any, ...]:
        low_l, part_l, low_e, part_e = places
        size = sines[0] * sines[1]
        dot = light.x * eye.x + light.y * eye.y
        cos_phi = dr.select(
            size > 1e-12, plugin.larger(plugin.smaller(-dot / plugin.larger(size, 1e-12), 1.0), -1.0), 1.0
        )
        cosines = [mi.Float(1.0), cos_phi]
        for _ in range(2, PACKET * self.packets):
            cosines.append(2.0 * cos_phi * cosines[-1] - cosines[-2])
        rows = [_row(low_l + to_l, low_e + to_e) for to_l, to_e in _triangle(part_l > part_e)]
        return cosines, rows, plugin.larger(part_l, part_e), plugin.smaller(part_l, part_e)


def _one_triangle(above: SingleArray, below: SingleArray, across: SingleArray) -> SingleArray:
    """Return all node pairs (nodes below follow those above) as one triangle: row a (a + 1) / 2 + b, b <= a."""
    count = int(round(math.sqrt(2.0 * len(below) + 0.25) - 0.5))
    lines = [above]
    for node in range(count):
        first, each = node * (node + 1) // 2, len(across) // count
        lines += [across[node * each : (node + 1) * each], below[first : first + node + 1]]
    return np.concatenate(lines)


def _row(a: Any, b: Any) -> Any:
    """Return the row of a pair of nodes."""
    high, low = dr.maximum(a, b), dr.minimum(a, b)
    return ((high * (high + 1)) >> 1) + low


def _triangle(first: Any) -> list[tuple[Any, Any]]:
    """Return the node steps to the corners of a cell's triangle; `first`: the first fraction is the larger one."""
    one, other = dr.select(first, mi.UInt32(1), mi.UInt32(0)), dr.select(first, mi.UInt32(0), mi.UInt32(1))
    return [(0, 0), (one, other), (1, 1)]


def tetrahedron(rows: list[Any], upper: Any, lower: Any, part: Any) -> list[tuple[Any, Any]]:
    """Return the corners and weights of the point's tetrahedron in the two angles and the wavelength.

    From the lowest corner of the cell to the highest, coordinates increase one after the other, in the order of
    decreasing fractions: four reads rather than three at each wavelength. At a wavelength node it is the triangle.

    Args:
        rows: positions of the triangle's three corners, from lowest to highest, at the lower wavelength.
        upper, lower: the larger and the smaller angle fraction.
        part: the wavelength fraction.
    """
    is_first, is_last = part > upper, part <= lower
    one, two = plugin.larger(upper, part), plugin.smaller(lower, part)
    middle = plugin.larger(lower, plugin.smaller(upper, part))
    return [
        (rows[0], 1.0 - one),
        (dr.select(is_first, rows[0] + 1, rows[1]), one - middle),
        (dr.select(is_last, rows[2], rows[1] + 1), middle - two),
        (rows[2] + 1, two),
    ]


def interpolated(source: PackedSeries, corners: list[tuple[Any, Any]], harmonics: list[Any], active: Any) -> Any:
    """Return the weighted sum of the series at the corners."""
    total = mi.Float(0.0)
    for place, weight in corners:
        total = dr.fma(weight, source.sum(place, harmonics, active), total)
    # a truncated series may be slightly negative at low light
    return plugin.larger(total, 0.0)


def _has_constant_index(lobe: Any) -> bool:
    """Whether the ambient is dispersionless: the wavenumber is then a constant over the wavelength."""
    product = lobe.wavenumbers * lobe.wavelengths_nm
    return bool(np.allclose(product, product[0], rtol=1e-7, atol=0.0))


def _pairs(values: Array) -> Array:
    """Return `[i, 2]`: each value and the next, for one load."""
    return np.stack([values[:-1], values[1:]], axis=1) if len(values) > 1 else np.stack([values, values], axis=1)


def _halves(values: Array) -> tuple[Any, Any]:
    """Return words with 16 bits for each value and 16 for the next, and the unit."""
    top = max(float(values.max()), 1e-30)
    steps = np.rint(values * (HALF / top)).astype(np.uint32)
    words = steps[:-1] | steps[1:] << np.uint32(16)
    return (mi.UInt32(plugin.aligned(words, np.uint32)) if dr.is_jit_v(mi.Float) else words), plugin.opaque(top / HALF)


def _word(words: Any, index: Any, active: Any) -> Any:
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.UInt32, words, index, active)
    return int(words[int(index)]) if active else 0


TURNS = 8  # light azimuths in the average for the exit table


class AlignedPlugin(MonolayerPlugin[Aligned]):
    """Broad reflection, and transmission if the lobe transmits."""

    kind = "aligned"
    tables = ("table",)
    is_turned = True

    def _set_tables(self, lobe: Aligned) -> None:
        self.orders = np.asarray(np.rint(lobe.orders), dtype=int)
        self.packets = -(-lobe.table.shape[1] // PACKET)
        self.values = PackedSeries(lobe.table, self.packets)
        self.cos_turn, self.sin_turn = plugin.opaque(math.cos(lobe.rotation)), plugin.opaque(math.sin(lobe.rotation))

    def _mean(self, lobe: Aligned, light: Array, eye: Array) -> Array:
        """Return f averaged over wavelengths, rotations and mirror images, `[...]`, for directions `[..., 3]`."""
        total = np.zeros(light.shape[:-1])
        for turn in np.arange(TURNS) * (2 * math.pi / TURNS):
            about = rotation_about_z(turn)
            for mirror in ([1.0, 1.0, 1.0], [1.0, -1.0, 1.0]):
                total += lobe.evaluate(light * mirror @ about.T, eye * mirror @ about.T).mean(axis=-1)
        return total / (2 * TURNS)

    def _waves(self, one: list[tuple[Any, Any]], two: list[tuple[Any, Any]]) -> list[Any]:
        """Return cos or sin(a phi_1 + b phi_2) for each term (a, b) in `orders`, by the addition theorems.

        Args:
            one, two: cosine and sine at each multiple of the azimuth of the first and second direction.
        """
        waves = []
        for a, b, is_sine in self.orders.tolist():
            (cos_a, sin_a), (cos_b, sin_b) = one[abs(a)], two[abs(b)]
            sin_a, sin_b = (sin_a if a >= 0 else -sin_a), (sin_b if b >= 0 else -sin_b)
            if is_sine:
                waves.append(dr.fma(sin_a, cos_b, cos_a * sin_b))
            else:
                waves.append(dr.fma(cos_a, cos_b, -sin_a * sin_b))
        return waves + [mi.Float(0.0)] * (PACKET * self.packets - len(waves))

    def _powers(self, w: Any, sine: Any) -> list[tuple[Any, Any]]:
        """Return cosine and sine of the multiples (from 0) of an azimuth relative to the particles."""
        inverse = dr.rcp(plugin.larger(sine, 1e-12))
        x = dr.select(sine > 1e-12, w.x * inverse, 1.0)
        y = dr.select(sine > 1e-12, w.y * inverse, 0.0)
        cos, sin = dr.fma(x, self.cos_turn, y * self.sin_turn), dr.fma(y, self.cos_turn, -x * self.sin_turn)
        powers = [(mi.Float(1.0), mi.Float(0.0)), (cos, sin)]
        for _ in range(2, int(np.abs(self.orders[:, :2]).max()) + 1):
            before, now = powers[-2], powers[-1]
            powers.append((2.0 * cos * now[0] - before[0], 2.0 * cos * now[1] - before[1]))
        return powers

    def _pair(self, light: Any, eye: Any, sines: tuple[Any, Any], places: tuple[Any, ...]) -> tuple[Any, ...]:
        low_l, part_l, low_e, part_e = places
        # the first direction of a pair is the one with the higher node
        is_first = (low_l > low_e) | ((low_l == low_e) & (part_l >= part_e))
        powers_l, powers_e = self._powers(light, sines[0]), self._powers(eye, sines[1])
        one = [tuple(dr.select(is_first, a, b) for a, b in zip(p, q)) for p, q in zip(powers_l, powers_e)]
        two = [tuple(dr.select(is_first, b, a) for a, b in zip(p, q)) for p, q in zip(powers_l, powers_e)]
        high, low = dr.select(is_first, low_l, low_e), dr.select(is_first, low_e, low_l)
        part_h, part_w = dr.select(is_first, part_l, part_e), dr.select(is_first, part_e, part_l)
        rows = [_row(high + to_h, low + to_w) for to_h, to_w in _triangle(part_h > part_w)]
        return self._waves(one, two), rows, plugin.larger(part_h, part_w), plugin.smaller(part_h, part_w)

    def update(self, lobe: Aligned) -> None:
        """Replace the data by another monolayer's.

        Raises:
            UnsupportedError: the table shapes, or the terms of the series, differ.
        """
        if not np.array_equal(np.rint(lobe.orders), self.orders):
            raise UnsupportedError("the azimuthal series changed its terms; build the scene again")
        super().update(lobe)


# Exact sampling of bilinearly interpolated densities on unit squares, with one table read.
#
# A density that is bilinear between nodes is a sum of tent functions. The alias method (Walker 1977, Vose 1991) chooses
# a node, then a point is drawn from its tent; tents at an edge are folded inwards.

CHANCES = 65535  # the largest 16-bit probability


class BilinearDensity:
    """Densities on the unit squares of several faces, tabulated for several rows and mixed between rows.

    Args:
        weights: node values, `[row, face, y, x]`, > 0, with any normalisation.
    """

    def __init__(self, weights: Array) -> None:
        rows, faces, height, width = weights.shape
        share = _edge_halves(height)[:, None] * _edge_halves(width)  # part of each tent inside
        chance = weights * share
        total = chance.sum(axis=(1, 2, 3), keepdims=True)
        density = weights / total * (height - 1) * (width - 1)
        near_far = [density[:, :, y : height - 1 + y, x : width - 1 + x] for y in (0, 1) for x in (0, 1)]
        self.cells = plugin.device_array(np.stack(near_far, axis=-1))
        self.columns = _columns((chance / total).reshape(rows, -1))
        self.rows, self.size = rows, (faces, height, width)

    def sample(self, row: Any, part: Any, number: Any, square: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Draw a unit square and a point in it.

        Returns the index of the square, x and y in [0, 1], and a uniform number that is made from the unused bits of
        `number`, with lower precision.

        Args:
            row: the lower of the two mixed rows, at most `rows - 2`.
            part: weight of the upper row, in [0, 1].
            number: uniform in [0, 1), for the square and the node.
            square: two uniform numbers, for the point about the node.
            active: mask.
        """
        faces, height, width = self.size
        nodes = faces * height * width
        upper = number < part
        number = dr.select(upper, number / plugin.larger(part, 1e-6), (number - part) / plugin.larger(1.0 - part, 1e-6))
        at = plugin.larger(plugin.smaller(number * nodes, nodes - 0.01), 0.0)
        column = mi.UInt32(at)
        number = at - mi.Float(column)
        word = self._column((row + dr.select(upper, mi.UInt32(1), 0)) * nodes + column, active)
        chance = mi.Float(word & CHANCES) * (1.0 / CHANCES)
        is_column = number < chance
        number = dr.select(
            is_column, number / plugin.larger(chance, 1e-6), (number - chance) / plugin.larger(1.0 - chance, 1e-6)
        )
        node = dr.select(is_column, column, word >> 16)
        face, rest = node // (height * width), node % (height * width)
        x = _folded(mi.Float(rest % width) + _tent(square.x), width - 1)
        y = _folded(mi.Float(rest // width) + _tent(square.y), height - 1)
        return face, x, y, number

    def density(self, row: Any, part: Any, face: Any, x: Any, y: Any, active: Any) -> Any:
        """Return the density, whose integral over all faces is one."""
        faces, height, width = self.size
        u, v = x * (width - 1), y * (height - 1)
        i = plugin.larger(plugin.smaller(dr.floor(u), width - 2.0), 0.0)
        j = plugin.larger(plugin.smaller(dr.floor(v), height - 2.0), 0.0)
        cells = (height - 1) * (width - 1)
        cell = (row * faces + face) * cells + mi.UInt32(j) * (width - 1) + mi.UInt32(i)
        u, v = u - i, v - j
        densities = []
        for step in (0, faces * cells):
            c = plugin.read4(self.cells, cell + step, active)
            densities.append(dr.lerp(dr.lerp(c[0], c[1], u), dr.lerp(c[2], c[3], u), v))
        return dr.lerp(densities[0], densities[1], part)

    def _column(self, index: Any, active: Any) -> Any:
        if dr.is_jit_v(mi.Float):
            return dr.gather(mi.UInt32, self.columns, index, active)
        return int(self.columns[int(index)]) if active else 0


def _edge_halves(count: int) -> Array:
    share = np.ones(count)
    share[[0, -1]] = 0.5
    return share


def _tent(number: Any) -> Any:
    """Return a number in (-1, 1) with a tent density."""
    low = dr.sqrt(2.0 * number) - 1.0
    return dr.select(number < 0.5, low, 1.0 - dr.sqrt(plugin.larger(2.0 - 2.0 * number, 0.0)))


def _folded(x: Any, top: float) -> Any:
    """Fold numbers beyond either end back, and map [0, top] to [0, 1]."""
    x = dr.abs(x)
    return plugin.smaller(x, 2.0 * top - x) * (1.0 / top)


def _columns(chances: Array) -> Any:
    """Return each row's alias table, `[row, column]`: the column's probability in 16 bits, the alias above."""
    rows, count = chances.shape
    words = np.empty((rows, count), dtype=np.uint32)
    for row in range(rows):
        words[row] = _alias(chances[row] * count)
    flat = words.ravel()
    return mi.UInt32(flat) if dr.is_jit_v(mi.Float) else flat


def _alias(heights: Array) -> NDArray[np.uint32]:
    """Return Vose's alias table for probabilities times their number."""
    heights = heights.copy()
    keep, other = np.ones(len(heights)), np.arange(len(heights))
    small, large = list(np.nonzero(heights < 1.0)[0]), list(np.nonzero(heights >= 1.0)[0])
    while small and large:
        low, high = small.pop(), large[-1]
        keep[low], other[low] = heights[low], high
        heights[high] -= 1.0 - heights[low]
        if heights[high] < 1.0:
            small.append(large.pop())
    return np.asarray(np.rint(keep * CHANCES).astype(np.uint32) | (other.astype(np.uint32) << 16), dtype=np.uint32)
