"""Interface reflectance and transmittance as smooth tables over angle, from both sides.

Both sides are tabulated over the cosine in the RARER medium, called outside: over the cosine in the denser medium the
square-root kink at the critical angle costs up to 655 %. Beyond the critical angle the coordinate is
`x = (2/pi) acos(cos_inside / cos_critical)` in [0, 1], smooth at both ends.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.texture import ParameterAxis, places
from nacre.core.arrays import Array, gauss_legendre, interpolate, node_coordinate, take_at

SIDES = "reflectance_inside", "reflectance", "transmittance"
ROUNDING = 1e-9  # largest rounding below 0
TABLES = ("reflectance", "transmittance", "reflectance_inside", "total")
FINEST_LEVEL = 16  # smallest interval of irregular nodes over angle: 2^-16


@dataclass(frozen=True)
class InterfaceResponse:
    """Power tables of one interface; leading axes are the parameter axes, if any.

    All axes have ascending nodes including both ends, with linear interpolation. Nodes over angle are uniform, or they
    bound dyadic intervals [i, i + 1] / 2^level, which both the arrays and the renderer locate exactly.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        cos_outside: `[cos]`, ascending nodes from 0 to 1.
        reflectance: `[*params, cos, wavelength]`, light from outside, unpolarised power.
        transmittance: same shape, power to the other side (equal from either side at conjugate angles);
            zeros for an opaque interface.
        reflectance_inside: same shape, light from inside at the conjugate angle; zeros for an opaque interface.
        total: `[*params, x, wavelength]`, reflectance from inside beyond the critical angle, over
            `x = (2/pi) acos(cos_inside / cos_critical)` from 0 (critical) to 1 (grazing); empty `x` axis for eta = 1.
        eta: n_inside/n_outside >= 1, one number for the refraction of all wavelengths (dispersion would split
            rays); 1 for a free film.
        transmits: whether light is transmitted to the other side.
        flipped: False: outside is on the +z side (the ambient); True: the ambient is the denser medium and outside
            is on the -z side. Users of the tables then negate the z of all directions first.
        parameters: the texture-driven axes, in the order of the leading axes.
        total_nodes: `[x]`, the ascending nodes of `total`; unset: uniform.
        relative_index: `[wavelength]`, n_inside/n_outside at each wavelength; unset: `eta` at all of them.
    """

    wavelengths_nm: Array
    cos_outside: Array
    reflectance: Array
    transmittance: Array
    reflectance_inside: Array
    total: Array
    eta: float
    transmits: bool
    flipped: bool = False
    parameters: tuple[ParameterAxis, ...] = ()
    total_nodes: Array | None = None
    relative_index: Array | None = None

    OMITTED_UNSET: ClassVar[tuple[str, ...]] = ("total_nodes", "relative_index")
    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "cos_outside": "cos",
        "reflectance": "*params cos wavelength",
        "transmittance": "*params cos wavelength",
        "reflectance_inside": "*params cos wavelength",
        "total": "*params x wavelength",
        "total_nodes": "x",
        "relative_index": "wavelength",
    }

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        check_wavelengths(self.wavelengths_nm)
        leading = check_parameters(self.parameters)
        full = (*leading, len(self.cos_outside), len(self.wavelengths_nm))
        for name in ("reflectance", "transmittance", "reflectance_inside"):
            if getattr(self, name).shape != full:
                raise ValueError(f"{name} has the shape {getattr(self, name).shape}, not {full}")
            if np.any(getattr(self, name) < -ROUNDING):
                raise ValueError(f"{name} holds values below 0")
        if (
            self.cos_outside.ndim != 1
            or len(self.cos_outside) < 2
            or self.total.shape[:-2] != leading
            or self.total.shape[-1] != full[-1]
        ):
            raise ValueError("cos_outside or total has a wrong shape")
        check_angle_nodes("cos_outside", self.cos_outside)
        if self.total_nodes is not None:
            if self.total_nodes.shape != self.total.shape[-2:-1]:
                raise ValueError("total_nodes has a wrong shape")
            check_angle_nodes("total_nodes", self.total_nodes)
        if self.relative_index is not None:
            if self.relative_index.shape != full[-1:]:
                raise ValueError("relative_index has a wrong shape")
            if not np.all((self.relative_index > 0.01) & (self.relative_index < 100.0)):
                raise ValueError("relative_index holds values that are not indices")
            if self.eta == 1.0:
                raise ValueError("relative_index needs an eta above 1")
        if not 1.0 <= self.eta < 100.0 or (self.eta > 1.0 and self.total.shape[-2] < 2):
            raise ValueError("eta is below 1, or total has no nodes")

    @property
    def size(self) -> int:
        """Wavelength count."""
        return len(self.wavelengths_nm)

    @property
    def nodes_beyond(self) -> Array:
        """Nodes of `total`, `[x]`, from the critical angle (0) to grazing incidence (1)."""
        return np.linspace(0.0, 1.0, self.total.shape[-2]) if self.total_nodes is None else self.total_nodes

    def over_cosine(self, table: Array, cos: Array) -> Array:
        """Interpolate one of the tables over the outside cosine at cosines `[n]`: `[*params, n, wavelength]`."""
        return take_at(table, self.cos_outside, cos, -2)

    @property
    def cos_critical(self) -> float:
        """Cosine of the critical angle inside; 0 for a free film."""
        return float(np.sqrt(max(0.0, 1.0 - 1.0 / self.eta**2)))

    def outside_cosine(self, cos_inside: Array) -> Array:
        """Return the conjugate cosine outside; 0 beyond the critical angle."""
        return np.sqrt(np.maximum(0.0, 1.0 - self.eta**2 * (1.0 - np.square(cos_inside))))

    def lookup(self, cos: Array, inside: NDArray[np.bool_], uv: Array | None = None) -> tuple[Array, Array]:
        """Interpolate reflectance and transmittance for light at `cos` (> 0) in its own medium.

        Args:
            cos: `[...]` cosine between the light and the (micro-)normal, in the light's medium.
            inside: `[...]` whether that medium is the inside.
            uv: `[..., 2]`, only for texture-driven parameters.

        Returns:
            `(R, T)`, each `[..., wavelength]`.
        """
        shape = np.broadcast_shapes(np.shape(cos), np.shape(inside))
        return self.lookup_at(cos, inside, parameter_coordinates(self.parameters, uv, shape))

    def lookup_at(self, cos: Array, inside: NDArray[np.bool_], coords: tuple[Array, ...]) -> tuple[Array, Array]:
        """As `lookup`, at node coordinates of the leading axes, each with the shape of `cos`."""
        cos, inside = np.broadcast_arrays(np.clip(np.abs(cos), 0.0, 1.0), inside)
        outer = np.where(inside, self.outside_cosine(cos), cos)
        at = (*coords, node_coordinate(self.cos_outside, outer))
        transmitted = interpolate(self.transmittance, at) if self.transmits else np.zeros((*cos.shape, self.size))
        reflected = interpolate(self.reflectance, at)
        if np.any(inside):
            behind = interpolate(self.reflectance_inside, at)
            if self.eta > 1.0:
                x = 2.0 / np.pi * np.arccos(np.clip(cos / self.cos_critical, 0.0, 1.0))
                beyond = interpolate(self.total, (*coords, node_coordinate(self.nodes_beyond, x)))
                is_total = (inside & (cos < self.cos_critical))[..., None]
                behind = np.where(is_total, beyond, behind)
                transmitted = np.where(is_total, 0.0, transmitted)
            reflected = np.where(inside[..., None], behind, reflected)
        return reflected, transmitted

    def resolved(self, cos: Array, inside: NDArray[np.bool_], uv: Array | None = None) -> tuple[Array, Array]:
        """As `lookup`, with the refraction and critical angle of each wavelength, which rays of one `eta` lack."""
        if self.relative_index is None or not np.any(inside):
            return self.lookup(cos, inside, uv)
        cos, inside = np.broadcast_arrays(np.clip(np.abs(cos), 0.0, 1.0), inside)
        eta, is_inside, own = self.relative_index, inside[..., None], cos[..., None]
        critical = np.sqrt(np.maximum(0.0, 1.0 - 1.0 / eta**2)) * (eta > 1.0)
        is_total = is_inside & (own < critical)
        outer = np.where(is_inside, np.sqrt(np.maximum(0.0, 1.0 - eta**2 * (1.0 - own**2))), own)
        x = 2.0 / np.pi * np.arccos(np.clip(own / np.maximum(critical, 1e-12), 0.0, 1.0))
        leading = [c[..., None] for c in parameter_coordinates(self.parameters, uv, cos.shape)]

        def at(table: Array, nodes: Array, where: Array) -> Array:
            each = (*leading, node_coordinate(nodes, where), np.arange(self.size))
            return interpolate(table, tuple(np.broadcast_to(c, where.shape) for c in each))

        behind, front, passed = (at(getattr(self, name), self.cos_outside, outer) for name in SIDES)
        reflected = np.where(is_total, at(self.total, self.nodes_beyond, x), np.where(is_inside, behind, front))
        return reflected, np.where(is_total, 0.0, passed)

    @cached_property
    def hemispherical(self) -> tuple[Array, Array, Array, Array]:
        """Cosine-weighted means `(R, T)` from outside and `(R, T)` from inside, each `[*params, wavelength]`."""
        nodes, weights = gauss_legendre(64)
        cos, weights = 0.5 * (nodes + 1), weights * 0.5
        outside = [
            np.einsum("c,...cl->...l", 2 * weights * cos, self.over_cosine(table, cos))
            for table in (self.reflectance, self.transmittance)
        ]
        # mu_in dmu_in = mu_out dmu_out / eta^2 below the critical angle
        inside = [
            np.einsum("c,...cl->...l", 2 * weights * cos, self.over_cosine(table, cos)) / self.eta**2
            for table in (self.reflectance_inside, self.transmittance)
        ]
        if self.eta > 1.0:
            mu = cos * self.cos_critical
            beyond = take_at(self.total, self.nodes_beyond, 2.0 / np.pi * np.arccos(cos), -2)
            inside[0] = inside[0] + np.einsum("c,...cl->...l", 2 * weights * mu * self.cos_critical, beyond)
        return outside[0], outside[1], inside[0], inside[1]


def check_over_azimuth(response: InterfaceResponse) -> None:
    """Check tables with the azimuth as leading axis: uniform nodes from 0 to 2 pi, both included.

    Raises:
        ValueError: names the inconsistent table.
    """
    counts = {getattr(response, name).shape[0] for name in TABLES}
    dimensions = {getattr(response, name).ndim for name in TABLES}
    if dimensions != {3} or len(counts) != 1 or len(response.reflectance) < 2 or response.parameters:
        raise ValueError("an aligned interface needs two or more azimuths, equal for all its tables")
    if response.flipped:
        raise ValueError("an aligned interface is flipped")
    for node in range(len(response.reflectance)):
        dataclasses.replace(response, **{name: getattr(response, name)[node] for name in TABLES}).check()


def mean_over_azimuth(response: InterfaceResponse) -> InterfaceResponse:
    """Return `check_over_azimuth` tables averaged over the azimuth."""
    return dataclasses.replace(response, **{name: getattr(response, name)[:-1].mean(axis=0) for name in TABLES})


class ResponseLobe(Lobe):
    """A lobe that is described by the tables of an interface.

    Attributes:
        response: the tables.
    """

    response: InterfaceResponse

    @property
    def wavelengths_nm(self) -> Array:  # type: ignore[override]  # the base declares a plain attribute
        """The tables' wavelength grid."""
        return self.response.wavelengths_nm

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.response.transmits

    @property
    def parameters(self) -> tuple[ParameterAxis, ...]:
        """The texture-driven axes."""
        return self.response.parameters


def check_wavelengths(wavelengths_nm: Array) -> None:
    """Check a wavelength grid: one axis, positive, ascending.

    Raises:
        ValueError: an invalid grid.
    """
    if wavelengths_nm.ndim != 1 or not len(wavelengths_nm) or wavelengths_nm[0] <= 0:
        raise ValueError("wavelengths_nm must be a list of positive wavelengths")
    if np.any(np.diff(wavelengths_nm) <= 0):
        raise ValueError("wavelengths_nm must ascend")


def is_uniform(nodes: Array) -> bool:
    """Whether nodes on [0, 1] are equidistant."""
    return bool(np.allclose(nodes, np.linspace(0.0, 1.0, len(nodes)), rtol=0.0, atol=1e-9))


def dyadic_levels(nodes: Array) -> NDArray[np.intp]:
    """Return the level of each interval `[i, i + 1] / 2^level` between irregular nodes on [0, 1].

    Raises:
        ValueError: an interval is not dyadic, or smaller than 2^-`FINEST_LEVEL`.
    """
    width = np.diff(nodes)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.rint(-np.log2(width))
        index = nodes[:-1] * 2.0**level
    if not np.all((width == 2.0**-level) & (index == np.rint(index)) & (level <= FINEST_LEVEL)):
        raise ValueError("irregular nodes over angle must bound dyadic intervals")
    return level.astype(np.intp)


def check_angle_nodes(name: str, nodes: Array) -> None:
    """Check nodes over angle: from 0 to 1, uniform or dyadic.

    Raises:
        ValueError: names the invalid axis.
    """
    if not len(nodes):
        return
    if nodes[0] != 0.0 or nodes[-1] != 1.0 or np.any(np.diff(nodes) <= 0.0):
        raise ValueError(f"{name} must ascend from 0 to 1")
    if not is_uniform(nodes):
        dyadic_levels(nodes)


def check_parameters(parameters: tuple[ParameterAxis, ...]) -> tuple[int, ...]:
    """Check the parameter axes and return their lengths.

    Raises:
        ValueError: more than two axes, or nodes that do not ascend.
    """
    if len(parameters) > 2:
        raise ValueError("at most two numbers may vary over the surface")
    for axis in parameters:
        if axis.values.ndim != 1 or not len(axis.values) or np.any(np.diff(axis.values) <= 0):
            raise ValueError(f"the nodes of {axis.name} must ascend")
    return tuple(len(axis.values) for axis in parameters)


def parameter_coordinates(
    parameters: tuple[ParameterAxis, ...], uv: Array | None, shape: tuple[int, ...]
) -> tuple[Array, ...]:
    """Return each parameter's node coordinate (0 at the first value) at `uv`, broadcast to `shape`.

    The default `uv` is the surface's middle, (0.5, 0.5).
    """
    if not parameters:
        return ()
    where = places(uv, shape)
    return tuple(axis.coordinate(axis.texture(where)) for axis in parameters)
