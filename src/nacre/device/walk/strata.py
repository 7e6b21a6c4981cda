"""A layered lobe's arrays on the device, the walk's look-ups, and the base lobes."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.compensation import returns
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.layered import MATCHED, Layered
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.device.facet_distributions import Beckmann, DeviceGlints, Facets, Ggx
from nacre.device.lobe_sum import bsdf_class, update_lobes
from nacre.device.plugin import MIN_COS, MakePlugin, cell_at, device_array, opaque, with_wi
from nacre.device.tables import DeviceTable, Located, WavelengthAxis

MAX_FLIGHTS = 8  # free paths before a boundary event; 6 to 12 have equal speed, 1 costs up to 50 % more
# Limits for delta tracking: light fraction removed by a flake, and rise of the weights' second moment over a stratum.
# Measured on 22 recipes, whose total rise is ten times as large.
MAX_TAKEN, MAX_RISE = 0.6, 0.06
NORMALS = 512  # test normals, each with two typical directions
TYPICAL = np.array([[0.35, 0.15, 0.925], [0.5, 0.6, 0.624]])
TOGETHER = 4  # wavelengths per walk
# flake row: number, three axes, nine frame components, three inverse axes, 1 / (pi times the axes' product)
FLAKE_ROW, PER_AXES, DENSITY = 17, slice(13, 16), 16


class Rows:
    """Rows of numbers read by index; a single row is stored as opaque numbers, without memory access."""

    def __init__(self, values: Array) -> None:
        self.rows, self.width = values.shape
        self.update(values)

    def update(self, values: Array) -> None:
        """Replace the numbers by others with the same shape."""
        if values.shape != (self.rows, self.width):
            raise UnsupportedError(f"rows of shape {(self.rows, self.width)} cannot be updated with {values.shape}")
        if self.rows == 1:
            self.single = [opaque(v) for v in values[0]]
        else:
            self.flat = device_array(values)

    def read(self, row: Any, active: Any = True) -> list[Any]:
        """Return a row."""
        if self.rows == 1:
            return self.single
        start = mi.UInt32(row) * self.width
        return [dr.gather(mi.Float, self.flat, start + i, active) for i in range(self.width)]


class MixedFacets(Facets):
    """GGX or Beckmann, chosen per lane."""

    def __init__(self, alpha_x: Any, alpha_y: Any, is_beckmann: Any) -> None:
        super().__init__(alpha_x, alpha_y)
        self.ggx, self.beckmann, self.is_beckmann = Ggx(alpha_x, alpha_y), Beckmann(alpha_x, alpha_y), is_beckmann

    def sample(self, wi: Any, sample: Any) -> Any:
        """Draw a visible normal."""
        return dr.select(self.is_beckmann, self.beckmann.sample(wi, sample), self.ggx.sample(wi, sample))

    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return D G1(wi)/cos_i."""
        return dr.select(self.is_beckmann, self.beckmann.spread(wi, m, wi_m), self.ggx.spread(wi, m, wi_m))

    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return G1(wo)."""
        return dr.select(
            self.is_beckmann, self.beckmann.weight(wi, wo, m, wi_m, wo_m), self.ggx.weight(wi, wo, m, wi_m, wo_m)
        )


class Strata:
    """A layered lobe on the device.

    The structure (numbers of strata and species, rough interfaces, base type) is Python and determines the kernel; all
    numbers are data, so other materials with the same structure reuse the kernel. `make_plugin` creates the base lobes'
    plugins.
    """

    def __init__(self, lobe: Layered, make_plugin: MakePlugin | None = None) -> None:
        self.uses_delta_tracking = uses_delta_tracking(lobe)
        self.structure = (*structure(lobe), self.uses_delta_tracking)
        self.count = lobe.strata
        self.base = lobe.base
        self.base_rough = lobe.base == "specular" and bool(np.any(lobe.alpha[-1] > 0))
        self.lobes: BaseLobes | None = None
        if lobe.base_lobes:
            assert make_plugin is not None
            self.lobes = BaseLobes(lobe.base_lobes, make_plugin)
        self.base_mirrors = lobe.base == "specular" and not self.base_rough
        self.base_scatters = lobe.base == "diffuse" or self.base_rough
        if self.lobes is not None:
            self.base_mirrors, self.base_scatters = self.lobes.has_mirror, self.lobes.scatters
        rough = roughness(lobe)
        self.is_rough = [bool(r) for r in rough]
        self.any_rough = any(self.is_rough)
        self.all_rough = all(self.is_rough[: self.count + (lobe.base == "none")])
        self.beckmann = [bool(b) for b, r in zip(lobe.is_beckmann, rough, strict=True) if r]
        self.kinds_of = [[int(k) for k in np.flatnonzero(lobe.flake_stratum == s)] for s in range(self.count)]
        self.slots = max(len(k) for k in self.kinds_of)
        self.kinds = lobe.kinds
        self.flights = MAX_FLIGHTS if lobe.kinds or lobe.dye is not None else 1
        self.upright = bool(np.all(lobe.flake_frame == np.eye(3)))
        self.isotropic = lobe.flake_extinction.shape[1] == 1
        self.has_dye = lobe.dye is not None
        self.dye_scatters = lobe.dye_phase is not None
        self.compensates = lobe.loss is not None
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.glints: DeviceGlints | None = None
        self._set(lobe)

    def update(self, lobe: Layered) -> None:
        """Replace the data by another lobe's with the same structure.

        Raises:
            UnsupportedError: the structure differs.
        """
        if (*structure(lobe), uses_delta_tracking(lobe)) != self.structure:
            raise UnsupportedError("the structure of strata, flakes, interfaces or base changed; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        if self.lobes is not None:
            self.lobes.update(lobe.base_lobes)
        self._set(lobe)

    def locate(self, si: Any, active: Any) -> Located:
        """Locate an interaction's wavelengths; store the interaction if the base or glints need it."""
        where = self.axis.locate(si.wavelengths, active)
        if self.lobes is not None or self.glints is not None:
            where.site = si
        return where

    def _set(self, lobe: Layered) -> None:
        rough = roughness(lobe)
        n = np.concatenate([[1.0], lobe.index, [1.0]])
        interface = np.zeros((self.count + 1, 5))
        interface[:, 0], interface[:, 1] = n[:-1], n[1:]  # above, below
        interface[:, 2:4] = np.where(rough[:, None], np.maximum(lobe.alpha, 1e-4), 0.0)
        interface[:, 4] = lobe.is_beckmann
        self.interfaces = Rows(interface)
        self.indices = [opaque(v) for v in n]
        flakes = np.zeros((max(1, self.count * self.slots), FLAKE_ROW))
        self.row_kind = np.zeros(len(flakes), dtype=int)
        flakes[:, 1:4] = 1.0
        flakes[:, 4:13] = np.eye(3).ravel()
        for s, kinds in enumerate(self.kinds_of):
            for slot, k in enumerate(kinds):
                row = s * self.slots + slot
                self.row_kind[row] = k
                flakes[row, :13] = [lobe.flake_number[k], *lobe.flake_axes[k], *lobe.flake_frame[k].ravel()]
        flakes[:, PER_AXES] = 1.0 / flakes[:, 1:4]
        flakes[:, DENSITY] = 1.0 / (np.pi * np.prod(flakes[:, 1:4], axis=1))
        self.flakes = Rows(flakes)
        self.kind_of_row = Rows(self.row_kind[:, None].astype(float))
        if self.kinds:
            _, cos, count, _ = lobe.flake_response.shape
            self.cos_cells, self.response_rows = opaque(cos - 1), cos
            self.response = DeviceTable(lobe.flake_response.reshape(-1, count, 2), as_cells=False)
            _, azimuths, elevations, _ = lobe.flake_extinction.shape
            self.azimuths, self.elevations = azimuths, elevations
            above = np.concatenate([lobe.flake_extinction[:, :, 1:], lobe.flake_extinction[:, :, -1:]], axis=2)
            pairs = np.stack([lobe.flake_extinction, above], axis=-1)  # both ends of a cell in one read
            self.extinction = DeviceTable(pairs.reshape(-1, count, 2), as_cells=False)
        self.base_cells = opaque(max(len(lobe.base_reflectance), 2) - 1)
        self.base_table = DeviceTable(lobe.base_reflectance[..., None])
        if lobe.dye is not None:
            self.dye = DeviceTable(np.concatenate([lobe.dye, lobe.dye[-1:]]))  # one more row for the cell above
            self.dye_majorant = Rows(lobe.dye[..., 0].max(axis=1)[:, None])
        if lobe.dye_phase is not None and lobe.dye_quantile is not None:
            self.phase_rows, self.quantile_rows = lobe.dye_phase.shape[1], lobe.dye_quantile.shape[1]
            count = len(lobe.wavelengths_nm)
            self.phase = DeviceTable(lobe.dye_phase.reshape(-1, count, 1))
            self.quantile = DeviceTable(lobe.dye_quantile.reshape(-1, count, 1))
        if lobe.loss is not None:
            self._set_loss(lobe.loss, n)
        self.glints = DeviceGlints.of(lobe)

    def _set_loss(self, loss: Array, n: Array) -> None:
        """Prepare the compensation: exit directions are independent of the incidence.

        A fraction n_b^2 k_b / (n_a^2 k_a + n_b^2 k_b) leaves on side b, with the cosine-weighted mean loss k, and its
        directions follow loss(cos) cos: lost light returns completely and reciprocally.
        """
        mean, quantile = returns(loss)
        up = n[:-1] ** 2 * mean[:, 0]
        total = up + n[1:] ** 2 * mean[:, 1]
        share = np.divide(up, total, out=np.zeros_like(up), where=total > 0)
        with np.errstate(divide="ignore"):
            inverse = np.where(mean > 0, 1 / mean, 0.0)
        self.back = Rows(np.stack([share, inverse[:, 0], inverse[:, 1], (total > 0).astype(float)], axis=1))
        self.loss_nodes, self.quantile_nodes = loss.shape[-1], quantile.shape[-1]
        self.loss_values, self.loss_quantile = device_array(loss), device_array(quantile)

    # -- interfaces --------------------------------------------------------------------------------------

    def facets(self, row: list[Any]) -> Facets:
        """Return an interface row's facet distribution."""
        x, y = dr.maximum(row[2], 1e-4), dr.maximum(row[3], 1e-4)
        if all(self.beckmann):
            return Beckmann(x, y)
        if not any(self.beckmann):
            return Ggx(x, y)
        return MixedFacets(x, y, row[4] > 0.5)

    def loss_at(self, interface: Any, above: Any, cos: Any, active: Any) -> Any:
        """Return the single-scattering loss of light from `above` (or below) at `cos`."""
        position = dr.sqrt(dr.clip(cos, 0.0, 1.0)) * (self.loss_nodes - 1)
        return self._read_side(self.loss_values, interface, above, position, self.loss_nodes, active)

    def back_cos(self, interface: Any, above: Any, u: Any, active: Any) -> Any:
        """Draw the cosine of light returning on a side."""
        position = u * (self.quantile_nodes - 1)
        root = self._read_side(self.loss_quantile, interface, above, position, self.quantile_nodes, active)
        return dr.square(root)

    def _read_side(self, source: Any, interface: Any, above: Any, position: Any, nodes: int, active: Any) -> Any:
        low, part = cell_at(position, nodes - 2)
        start = (mi.UInt32(interface) * 2 + dr.select(above, mi.UInt32(0), mi.UInt32(1))) * nodes + low
        return dr.lerp(dr.gather(mi.Float, source, start, active), dr.gather(mi.Float, source, start + 1, active), part)

    # -- the medium --------------------------------------------------------------------------------------

    def flake_row(self, stratum: Any, slot: int, active: Any) -> list[Any]:
        """Return number, axes and frame of a stratum's flake species."""
        return self.flakes.read(mi.UInt32(stratum) * self.slots + slot, active)

    def flake_axes(self, slot: Any, active: Any) -> Any:
        """Return the semi-axes of a species in the uppermost stratum."""
        row = self.flakes.read(slot, active)
        return mi.Vector3f(row[1], row[2], row[3])

    def into_flake(self, row: list[Any], w: Any) -> Any:
        """Transform a direction to the flake frame."""
        if self.upright:
            return w
        f = row[4:]
        return mi.Vector3f(*[f[i] * w.x + f[i + 3] * w.y + f[i + 6] * w.z for i in range(3)])

    def from_flake(self, row: list[Any], w: Any) -> Any:
        """Transform a direction from the flake frame."""
        if self.upright:
            return w
        f = row[4:]
        return mi.Vector3f(*[f[3 * i] * w.x + f[3 * i + 1] * w.y + f[3 * i + 2] * w.z for i in range(3)])

    def kind_at(self, stratum: Any, slot: Any, active: Any) -> Any:
        """Return the index of a stratum's flake species."""
        if self.kinds == 1:
            return mi.UInt32(0)
        return mi.UInt32(self.kind_of_row.read(mi.UInt32(stratum) * self.slots + slot, active)[0] + 0.5)

    def flake_response(self, kind: Any, cos: Any, u: Any, where: Located, active: Any) -> list[Any]:
        """Return a flake's R and T at |cos|, each a Spectrum, at one of the two neighbouring nodes.

        `u` in [0, 1) chooses the node by its weight. The estimate is linear in R and T, and both come from one node, so
        their sum is at most 1.
        """
        position = dr.sqrt(dr.clip(cos, 0.0, 1.0)) * self.cos_cells
        row = dr.minimum(mi.UInt32(position + u), self.response_rows - 1)
        return self.response.at_nodes(kind * self.response_rows + row, where, active)

    def medium_extinction(self, stratum: int, w: Any, where: Located, active: Any) -> Any:
        """Return the extinction of a stratum (Python index) along `w`, across its thickness, as a Spectrum."""
        total = mi.UnpolarizedSpectrum(0.0)
        for slot, kind in enumerate(self.kinds_of[stratum]):
            row = self.flake_row(mi.UInt32(stratum), slot, active)
            local = self.into_flake(row, w)
            total += self.shown_area(row, local) * self.mean_extinction(mi.UInt32(kind), local, where, active)
        if self.has_dye:
            total += self.dye_at(mi.UInt32(stratum), where, active)[0]
        return total

    def shown_area(self, row: list[Any], local: Any) -> Any:
        """Return the projected area of a row's flakes in their frame: the flake count on the ray."""
        return row[0] * dr.norm(mi.Vector3f(row[1] * local.x, row[2] * local.y, row[3] * local.z))

    def mean_extinction(self, kind: Any, local: Any, where: Located, active: Any) -> Any:
        """Return the mean light fraction removed by a flake along `local`, in its frame, as a Spectrum."""
        position = dr.sqrt(dr.clip(dr.abs(local.z), 0.0, 1.0)) * (self.elevations - 1)
        low, part = cell_at(position, self.elevations - 2)
        start = kind * (self.azimuths * self.elevations) + low
        if self.azimuths == 1:
            return dr.lerp(*self.extinction.at_nodes(start, where, active), part)
        turn = dr.atan2(dr.abs(local.y), dr.maximum(dr.abs(local.x), 1e-12)) * (2 / dr.pi * (self.azimuths - 1))
        azimuth, fraction = cell_at(turn, self.azimuths - 2)
        start += azimuth * self.elevations
        near = dr.lerp(*self.extinction.at_nodes(start, where, active), part)
        far = dr.lerp(*self.extinction.at_nodes(start + self.elevations, where, active), part)
        return dr.lerp(near, far, fraction)

    def dye_at(self, stratum: Any, where: Located, active: Any) -> list[Any]:
        """Return extinction and scattering of a stratum's dye."""
        return self.dye.look_up(mi.UInt32(stratum), mi.Float(0.0), where, None, active)

    def dye_phase(self, stratum: Any, cos: Any, where: Located, active: Any) -> Any:
        """Return the dye's phase function, 1/sr."""
        position = dr.clip(0.5 * (cos + 1.0), 0.0, 1.0) * (self.phase_rows - 1)
        low, part = cell_at(position, self.phase_rows - 2)
        return self.phase.look_up(mi.UInt32(stratum) * self.phase_rows + low, part, where, None, active)[0]

    def dye_cos(self, stratum: Any, u: Any, where: Located, active: Any) -> Any:
        """Draw the dye's scattering cosine for each of the four wavelengths from one number."""
        position = dr.clip(u, 0.0, 1.0) * (self.quantile_rows - 1)
        low, part = cell_at(position, self.quantile_rows - 2)
        return self.quantile.look_up(mi.UInt32(stratum) * self.quantile_rows + low, part, where, None, active)[0]

    def base_mirror(self, cos: Any, where: Located, active: Any) -> Any:
        """Return the reflectance of the base's specular part at a cosine."""
        return self.base_at(cos, where, active) if self.lobes is None else self.lobes.mirror(cos, where, active)

    def base_at(self, cos: Any, where: Located, active: Any) -> Any:
        """Return the base's reflectance at a cosine."""
        position = dr.clip(cos, 0.0, 1.0) * self.base_cells
        low = dr.minimum(dr.floor(position), self.base_cells - 1.0)
        return self.base_table.look_up(mi.UInt32(low), position - low, where, None, active)[0]


def roughness(lobe: Layered) -> NDArray[np.bool_]:
    """Return which interfaces scatter: those with roughness and index contrast."""
    n = np.concatenate([[1.0], lobe.index, [1.0]])
    rough = np.any(lobe.alpha > 0, axis=1)
    contrast = np.abs(np.diff(n)) > MATCHED
    if lobe.base in ("diffuse", "lobes"):
        contrast[-1] = False
    if lobe.base == "specular":
        contrast[-1] = True
    return np.asarray(rough & contrast)


def uses_delta_tracking(lobe: Layered) -> bool:
    """Whether delta tracking (`delta_tracking.py`) is the better form of the walk.

    It is better if most flakes transmit the light, and if the reflectances of the normals, whose ratio to the mean is a
    weight, are similar.
    """
    if not lobe.kinds or lobe.dye is not None:
        return False
    turn = 2.399963 * np.arange(NORMALS)
    height = 1.0 - (2.0 * np.arange(NORMALS) + 1.0) / NORMALS
    point = np.stack([np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height], axis=-1)
    nodes = np.linspace(0.0, 1.0, lobe.flake_response.shape[1])
    rise = np.zeros(len(TYPICAL))
    for axes, number, response in zip(lobe.flake_axes, lobe.flake_number, lobe.flake_response, strict=True):
        for i, v in enumerate(TYPICAL):
            axis = v * axes
            m = (axis / np.linalg.norm(axis) + point) * axes
            at = np.sqrt(np.abs(m @ v) / np.linalg.norm(m, axis=-1))
            row = np.minimum((at * (len(nodes) - 1) + 0.5).astype(int), len(nodes) - 1)
            absorbed = float(np.mean(1.0 - response[row, :, 1]))
            if absorbed > MAX_TAKEN:
                return False
            reflect = response[row, :, 0]
            spread = np.var(reflect.mean(axis=1)) + np.mean(np.var(reflect, axis=0)) / TOGETHER
            rise[i] += number * spread / max(absorbed, 1e-6)
    return bool(np.max(rise) <= MAX_RISE)


def structure(lobe: Layered) -> tuple[Any, ...]:
    """Return everything that determines a kernel, except the form of its free paths."""
    shapes = (lobe.flake_response.shape, lobe.flake_extinction.shape, lobe.base_reflectance.shape)
    return (
        lobe.strata, lobe.base, tuple(roughness(lobe).tolist()), tuple(lobe.is_beckmann.tolist()),
        tuple(lobe.flake_stratum.tolist()), bool(np.all(lobe.flake_frame == np.eye(3))), shapes,
        lobe.dye is not None, lobe.dye_phase is not None, lobe.loss is not None,
        lobe.glint_numbers is not None,
        tuple(inner.kind for inner in lobe.base_lobes),
    )  # fmt: skip


class BaseLobes:
    """The base lobes on the device.

    They were computed with the last resin as their ambient, so directions inside that resin are their own. Their
    specular part is treated like the mirrors between the strata; the rest is a vertex of the walk.

    Attributes:
        has_mirror: whether a part is specular.
        scatters: whether a part is not specular.
    """

    def __init__(self, lobes: tuple[Lobe, ...], make_plugin: MakePlugin) -> None:
        self.bsdf = bsdf_class(mi.variant())(mi.Properties(), [make_plugin(lobe) for lobe in lobes], False)
        self._mirrors = [plugin for plugin, delta in zip(self.bsdf.plugins, self.bsdf.delta, strict=True) if delta]
        self.has_mirror = bool(self._mirrors)
        self.scatters = len(self._mirrors) < len(self.bsdf.plugins)
        self._context = mi.BSDFContext()

    def update(self, lobes: tuple[Lobe, ...]) -> None:
        """Replace the data by other lobes' with the same kinds and shapes.

        Raises:
            UnsupportedError: the structure differs.
        """
        update_lobes(self.bsdf, lobes)

    def sample(self, v: Any, rng: Any, where: Located, active: Any) -> tuple[Any, Any, Any]:
        """Draw a direction for light from `v`; return it, its spectral weight, and whether it is specular."""
        first = rng.next_float32(active)
        point = mi.Point2f(rng.next_float32(active), rng.next_float32(active))
        bs, weight = self.bsdf.sample(self._context, with_wi(where.site, v), first, point, active)
        up = active & (bs.wo.z > MIN_COS) & (bs.pdf > 0.0)
        mirror = (bs.sampled_type & int(mi.BSDFFlags.Delta)) != 0
        direction = dr.select(up, bs.wo, mi.Vector3f(0.0, 0.0, 1.0))
        return direction, _finite(weight, up), mirror

    def eval(self, v: Any, to: Any, where: Located, active: Any) -> Any:
        """Return value * |cos to| of the non-specular part, for light from `v` to `to`."""
        if not self.scatters:
            return mi.UnpolarizedSpectrum(0.0)
        value = self.bsdf.eval(self._context, with_wi(where.site, v), to, active & (to.z > MIN_COS))
        return _finite(value, active)

    def pdf(self, v: Any, to: Any, where: Located, active: Any) -> Any:
        """Return the density of the non-specular part of `sample` at `to`."""
        density = self.bsdf.pdf(self._context, with_wi(where.site, v), to, active)
        return dr.select(dr.isfinite(density), density, 0.0)

    def mirror(self, cos: Any, where: Located, active: Any) -> Any:
        """Return the specular reflectance at a cosine."""
        si = with_wi(where.site, mi.Vector3f(dr.safe_sqrt(1.0 - cos * cos), 0.0, cos))
        total = mi.UnpolarizedSpectrum(0.0)
        for plugin in self._mirrors:
            every = tuple(True for _ in plugin.components)
            total += plugin.sample(self._context, si, mi.Float(0.0), mi.Point2f(0.0), active, every)[1]
        return _finite(total, active)


def _finite(value: Any, active: Any) -> Any:
    """Return the Spectrum, or zero if any number is not finite."""
    return mi.UnpolarizedSpectrum(
        dr.select(mi.Bool(active) & dr.all(dr.isfinite(value)), mi.UnpolarizedSpectrum(value), 0.0)
    )
