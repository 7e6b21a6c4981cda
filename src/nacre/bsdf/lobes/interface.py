"""The interface, smooth or rough, with isotropic or azimuthal tables, and the diffuse base, bare or below a film."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import DISTRIBUTIONS, exits, masking, normal_density, normal_quadrature
from nacre.bsdf.lobe import Lobe, SpecularResponse, product_rule
from nacre.bsdf.response import (
    InterfaceResponse,
    ResponseLobe,
    check_over_azimuth,
    check_parameters,
    check_wavelengths,
    mean_over_azimuth,
    parameter_coordinates,
)
from nacre.bsdf.texture import ParameterAxis, Texture, places
from nacre.core.arrays import Array, interpolate
from nacre.core.errors import UnsupportedError


class InterfaceLobe(ResponseLobe):
    """A smooth interface: mirror reflection, and refraction with one relative index `response.eta`.

    `eta = 1` (a free film) transmits light undeviated. Both sides may be lit; the tables of an opaque interface are
    zero inside.
    """

    @property
    def is_delta(self) -> bool:
        """Always True."""
        return True

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return zeros `[..., wavelength]`: the lobe is a delta distribution."""
        shape = np.broadcast_shapes(np.shape(wi), np.shape(wo))[:-1]
        return np.zeros((*shape, len(self.wavelengths_nm)))


@dataclass(frozen=True)
class Specular(InterfaceLobe):
    """A smooth interface that is isotropic about its normal.

    Attributes:
        response: the tables, which may be flipped.
    """

    kind: ClassVar[str] = "specular"
    response: InterfaceResponse

    def check(self) -> None:
        """Check the tables; see `InterfaceResponse.check`."""
        self.response.check()

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance `[..., wavelength]` for light at `cos_i` (< 0: from behind)."""
        cos_i = np.asarray(cos_i, dtype=float)
        inside = (cos_i < 0) != self.response.flipped
        return SpecularResponse(*self.response.resolved(np.abs(cos_i), inside, uv))


@dataclass(frozen=True)
class AlignedSpecular(InterfaceLobe):
    """Reflection and refraction as in `Specular`, with azimuth-dependent powers.

    Attributes:
        response: the tables, with the light's azimuth as a leading axis: uniform nodes from 0 to 2 pi, both ends
            included; for light from inside, the azimuth of the exit direction.
        rotation: the surface's rotation about the normal, rad, from +x to +y.
    """

    kind: ClassVar[str] = "aligned-specular"
    response: InterfaceResponse
    rotation: float

    @property
    def azimuths(self) -> int:
        """Number of azimuth nodes."""
        return len(self.response.reflectance)

    def check(self) -> None:
        """Check the tables.

        Raises:
            ValueError: names the inconsistent table.
        """
        check_over_azimuth(self.response)
        if not np.isfinite(self.rotation):
            raise ValueError("the rotation of an aligned interface is not finite")

    def mean(self) -> Specular:
        """Return the lobe with the means over the azimuth."""
        return Specular(mean_over_azimuth(self.response))

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance for light from azimuth 0; see `specular_at`."""
        return self.specular_at(cos_i, 0.0, uv)

    def specular_at(self, cos_i: Array, phi_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance, `[..., wavelength]`; cos_i < 0: light from behind."""
        cos_i, phi = np.broadcast_arrays(np.asarray(cos_i, dtype=float), np.asarray(phi_rad, dtype=float))
        inside = cos_i < 0
        turns = np.mod((phi - self.rotation) / (2 * np.pi) + np.where(inside, 0.5, 0.0), 1.0)
        return SpecularResponse(*self.response.lookup_at(np.abs(cos_i), inside, (turns * (self.azimuths - 1),)))


@dataclass(frozen=True)
class Microfacet(ResponseLobe):
    """Facets with the reflectance and transmittance of the smooth interface `response`.

    With h the facet normal, h_z > 0, and D, G from `nacre.bsdf.facet_distributions`:

    - reflection, both directions on one side: h = normalize(wi + wo), with the sign of h_z > 0;
      f = R(|wi.h|) D(h) G / (4 |cos_i cos_o|);
    - transmission: h = normalize(n_i wi + n_o wo), with the sign of h_z > 0, n = 1 outside and eta inside;
      f = T(|wi.h|) D(h) G |wi.h| |wo.h| n_o^2 / (|cos_i cos_o| (n_i wi.h + n_o wo.h)^2),
      the radiance BTDF: f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2. For eta = 1 this transmission is zero: a rough
      free film does not refract, and its material adds a `Specular` lobe that transmits light undeviated.
      - plus, if `loss` is given, the light scattered between facets:
      f = exchange[side_i, side_o](lambda) loss[side_i](wi, lambda) loss[side_o](wo, lambda),
      side 0 outside, 1 inside; reciprocal like the rest.

    If `response.flipped`, the z of both directions is negated first. Then directions are rotated by -rotation
    about z, which makes x the axis of alpha_x.

    Attributes:
        response: smooth-interface tables.
        distribution: "ggx", "beckmann", "blinn" or "ashikhmin-shirley".
        alpha_x, alpha_y: widths along the two axes; exponents are e = 2/alpha^2 - 2.
        alpha_texture: optional factor on both widths (>= 0.001). Excludes `loss`.
        rotation: optional angle of the roughness x axis about the normal, rad, from +x to +y.
        loss: `[side, s, t, wavelength or 1]` over uniform nodes in s = sqrt(|cos|) and
            t = w_x^2/(w_x^2 + w_y^2), each in [0, 1]; one side for an opaque interface, one t if isotropic; only
            with compensation.
        exchange: `[*params, side, side, wavelength]`, 1/sr; only with `loss`.
    """

    kind: ClassVar[str] = "microfacet"
    response: InterfaceResponse
    distribution: str
    alpha_x: float
    alpha_y: float
    alpha_texture: Texture | None = None
    rotation: Texture | None = None
    loss: Array | None = None
    exchange: Array | None = None

    AXES: ClassVar[dict[str, str]] = {"loss": "side s t wavelength", "exchange": "*params side side wavelength"}

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        self._check_response()
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(f'distribution "{self.distribution}" is not one of {", ".join(DISTRIBUTIONS)}')
        if not (0 < self.alpha_x <= 1 and 0 < self.alpha_y <= 1):
            raise ValueError("alpha_x and alpha_y must lie in (0, 1]")
        if (self.loss is None) != (self.exchange is None):
            raise ValueError("loss and exchange come together")
        if self.loss is not None and self.exchange is not None:
            sides, count = self.loss.shape[0], len(self.wavelengths_nm)
            lead = tuple(len(axis.values) for axis in self.parameters)
            if self.loss.ndim != 4 or sides not in (1, 2) or self.loss.shape[3] not in (1, count):
                raise ValueError(f"loss has the shape {self.loss.shape}")
            if self.exchange.shape != (*lead, sides, sides, count):
                raise ValueError(f"exchange has the shape {self.exchange.shape}")

    def _check_response(self) -> None:
        self.response.check()

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.response.transmits and self.response.eta > 1.0

    def local_frame(self, w: Array, uv: Array | None) -> Array:
        """Transform directions `[..., 3]` to the roughness frame: side flipped, x along alpha_x."""
        if self.response.flipped:
            w = w * np.array([1.0, 1.0, -1.0])
        if self.rotation is None:
            return w
        angle = self.rotation(places(uv, w.shape[:-1]))
        cos, sin = np.cos(angle), np.sin(angle)
        x, y = w[..., 0], w[..., 1]
        return np.stack([cos * x + sin * y, cos * y - sin * x, w[..., 2]], axis=-1)

    def _widths(self, uv: Array | None, shape: tuple[int, ...]) -> tuple[Array | float, Array | float]:
        factor = 1.0 if self.alpha_texture is None else self.alpha_texture(places(uv, shape))
        return self.alpha_x * factor, self.alpha_y * factor

    def facet_powers(self, w: Array, h: Array, uv: Array | None = None) -> tuple[Array, Array]:
        """Return R and T `[..., wavelength]` of facets.

        Args:
            w: `[..., 3]` directions to the light, in the roughness frame.
            h: `[..., 3]` facet normals, h_z >= 0.
            uv: `[..., 2]`, only for textures.
        """
        return self.response.lookup(np.abs(np.sum(w * h, axis=-1)), w[..., 2] < 0, uv)

    def smooth_powers(self, w: Array, uv: Array | None = None) -> tuple[Array, Array]:
        """Return R and T `[..., wavelength]` of the smooth interface for light along `w`, as in `facet_powers`."""
        return self.response.resolved(np.abs(w[..., 2]), w[..., 2] < 0, uv)

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr, light arriving along `wi` and leaving along `wo`."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        wi, wo = self.local_frame(wi, uv), self.local_frame(wo, uv)
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        inside_i, inside_o = cos_i < 0, cos_o < 0
        is_reflection = inside_i == inside_o
        alpha_x, alpha_y = self._widths(uv, cos_i.shape)
        n_i = np.where(is_reflection, 1.0, np.where(inside_i, self.response.eta, 1.0))[..., None]
        n_o = np.where(is_reflection, 1.0, np.where(inside_o, self.response.eta, 1.0))[..., None]
        h = n_i * wi + n_o * wo
        length = np.linalg.norm(h, axis=-1, keepdims=True)
        h = h / np.maximum(length, 1e-12)
        h = h * np.where(h[..., 2:] < 0, -1.0, 1.0)
        i_h, o_h = np.sum(wi * h, axis=-1), np.sum(wo * h, axis=-1)

        grazing = (np.abs(cos_i) < 1e-9) | (np.abs(cos_o) < 1e-9) | (length[..., 0] < 1e-9)
        cosines = np.where(grazing, 1.0, np.abs(cos_i * cos_o))
        spread = normal_density(self.distribution, h, alpha_x, alpha_y)
        spread = spread * masking(self.distribution, wi, wo, h, alpha_x, alpha_y) / cosines
        reflected, transmitted = self.facet_powers(wi, h, uv)
        value = reflected * (0.25 * spread)[..., None]
        if self.transmits:
            stretch = np.square(n_i[..., 0] * i_h + n_o[..., 0] * o_h)
            bent = spread * np.abs(i_h * o_h) * np.square(n_o[..., 0]) / np.maximum(stretch, 1e-30)
            value = np.where(is_reflection[..., None], value, transmitted * bent[..., None])
        else:
            value = np.where(is_reflection[..., None], value, 0.0)
        if self.loss is not None:
            value = value + self._between_facets(wi, wo, inside_i, inside_o, uv)
        return np.where(grazing[..., None], 0.0, value)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits, for light along one `wi[3]`; see `Lobe.hemispherical`.

        Exits follow the facet normals: narrow and wide lobes then need equal node counts.
        """
        w = self.local_frame(np.asarray(wi, dtype=float), uv)
        inside = bool(w[2] < 0)
        alpha_x, alpha_y = map(float, self._widths(uv, ()))
        w = w * np.array([1.0, 1.0, -1.0]) if inside else w
        m, measure = normal_quadrature(self.distribution, alpha_x, alpha_y, nodes)
        is_visible = m @ w > 0
        m, measure = m[is_visible], measure[is_visible]
        w_m = m @ w
        side = np.array([-1.0, -1.0, 1.0]) if inside else np.ones(3)  # w and m are mirrored
        reflected, transmitted = self.facet_powers(np.broadcast_to(-side * w if inside else w, m.shape), side * m, uv)
        back, through = exits(
            w, m, 1.0 if not self.transmits else 1 / self.response.eta if inside else self.response.eta
        )
        base = measure * w_m / w[2]
        ways = np.broadcast_to(w, m.shape)
        total = []
        for power, wo in ((reflected, back), (transmitted, through)):
            total.append((base * masking(self.distribution, ways, wo, m, alpha_x, alpha_y)) @ power)
        if not self.transmits:
            total[1] = np.zeros_like(total[1])
        if self.loss is not None:
            local = self.local_frame(np.asarray(wi, dtype=float), uv)

            def between(wo: Array) -> Array:
                w_o = self.local_frame(wo, uv)
                return self._between_facets(
                    np.broadcast_to(local, w_o.shape), w_o, np.full(len(w_o), inside), w_o[:, 2] < 0, uv
                )

            more = product_rule(between, np.asarray(wi, dtype=float), nodes, self.transmits)
            total = [total[0] + more[0], total[1] + more[1]]
        return total[0], total[1]

    def _between_facets(
        self, wi: Array, wo: Array, inside_i: NDArray[np.bool_], inside_o: NDArray[np.bool_], uv: Array | None
    ) -> Array:
        assert self.loss is not None and self.exchange is not None
        sides = self.loss.shape[0]
        coords = parameter_coordinates(self.parameters, uv, inside_i.shape)
        exchange = self.exchange.reshape(*self.exchange.shape[: len(coords)], -1)
        exchange = interpolate(exchange, coords) if coords else exchange
        exchange = exchange.reshape(*exchange.shape[:-1], sides, sides, -1)
        total = np.zeros((*inside_i.shape, len(self.wavelengths_nm)))
        for side_i in range(sides):
            for side_o in range(sides):
                here = ((inside_i == bool(side_i)) & (inside_o == bool(side_o)))[..., None]
                product = self.lost_towards(wi, side_i) * self.lost_towards(wo, side_o)
                product = product * exchange[..., side_i, side_o, :]
                total = np.where(here, product, total)
        return total

    def lost_towards(self, w: Array, side: int) -> Array:
        """Return one side's `loss` at directions `[..., 3]` in the roughness frame, `[..., wavelength or 1]`.

        Raises:
            UnsupportedError: the interface is not compensated.
        """
        if self.loss is None:
            raise UnsupportedError("this rough interface is not compensated: it has no loss table")
        s = np.sqrt(np.clip(np.abs(w[..., 2]), 0.0, 1.0))
        x2, y2 = np.square(w[..., 0]), np.square(w[..., 1])
        t = np.where(x2 + y2 > 1e-20, x2 / np.maximum(x2 + y2, 1e-20), 0.5)
        shape = self.loss.shape
        return interpolate(self.loss[side], (s * (shape[1] - 1), t * (shape[2] - 1)))


@dataclass(frozen=True)
class AlignedMicrofacet(Microfacet):
    """Facets of an anisotropic film: as `Microfacet`, with powers that depend on the azimuth.

    The azimuth is that of the light in the facet's frame, which the smallest rotation carries from the surface's frame,
    relative to u. The roughness axis may turn; the film's axes do not. The reflectance of unpolarised light is equal
    for opposite azimuths and a transmittance holds for both senses of a path, so the values are reciprocal.

    Attributes:
        response: the tables, as of `AlignedSpecular`.
        loss, exchange: values for the azimuthal mean.
    """

    kind: ClassVar[str] = "aligned-microfacet"

    @property
    def azimuths(self) -> int:
        """Number of azimuth nodes."""
        return len(self.response.reflectance)

    def _check_response(self) -> None:
        check_over_azimuth(self.response)

    def facet_powers(self, w: Array, h: Array, uv: Array | None = None) -> tuple[Array, Array]:
        """Return R and T `[..., wavelength]` of facets; see `Microfacet.facet_powers`."""
        inside = w[..., 2] < 0
        phi = local_azimuth(w, h) + np.where(inside, np.pi, 0.0)
        if self.rotation is not None:
            phi = phi + self.rotation(places(uv, phi.shape))
        place = np.mod(phi / (2.0 * np.pi), 1.0) * (self.azimuths - 1)
        return self.response.lookup_at(np.sum(w * h, axis=-1), inside, (place,))

    def smooth_powers(self, w: Array, uv: Array | None = None) -> tuple[Array, Array]:
        """Return R and T of the smooth interface; see `Microfacet.smooth_powers`."""
        return self.facet_powers(w, np.broadcast_to([0.0, 0.0, 1.0], w.shape), uv)

    def mean(self) -> Microfacet:
        """Return the lobe with the means over the azimuth."""
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return Microfacet(**{**own, "response": mean_over_azimuth(self.response)})


def local_azimuth(w: Array, h: Array) -> Array:
    """Return the azimuths `[...]` of directions in facet frames, rad.

    Args:
        w: `[..., 3]` directions.
        h: `[..., 3]` unit normals, h_z > -1; the smallest rotation carries the z axis to each.
    """
    x, y = w[..., 0], w[..., 1]
    along = w[..., 2] + (x * h[..., 0] + y * h[..., 1]) / (1.0 + h[..., 2])
    return np.asarray(np.arctan2(y - h[..., 1] * along, x - h[..., 0] * along))


@dataclass(frozen=True)
class Diffuse(Lobe):
    """Lambertian reflection, weighted by the film's transmittance on the way in and out; lit from +z only.

    f = scale(p, lambda) entry(p, cos_i, lambda) entry(p, cos_o, lambda) / pi, zero unless both directions have
    z > 0. A bare base has entry = 1 and scale = albedo. Below a film with relative index eta, entry is the
    transmittance over the ambient's cosine, and scale = albedo / (eta^2 (1 - albedo R_inside)) sums the
    round trips between base and film (R_inside: the film's hemispherical reflectance from below).

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        scale: `[*params, wavelength]`.
        entry: `[*params, cos, wavelength]` over uniform nodes in the ambient's cosine from 0 to 1, linear;
            one node (constant 1) for a bare base.
        parameters: the texture-driven axes.
        under_smooth: `[*params, cos, wavelength]`, the base's total reflection through the smooth film, over the
            ambient's cosine. Spectra add it to the smooth film's specular values, since `entry` is averaged over the
            facets of a rough film; unset if the two agree.
    """

    kind: ClassVar[str] = "diffuse"
    wavelengths_nm: Array
    scale: Array
    entry: Array
    parameters: tuple[ParameterAxis, ...] = ()
    under_smooth: Array | None = None

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "scale": "*params wavelength",
        "entry": "*params cos wavelength",
        "under_smooth": "*params cos wavelength",
    }

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        check_wavelengths(self.wavelengths_nm)
        leading, count = check_parameters(self.parameters), len(self.wavelengths_nm)
        if self.scale.shape != (*leading, count):
            raise ValueError(f"scale has the shape {self.scale.shape}, not {(*leading, count)}")
        if self.entry.shape[:-2] != leading or self.entry.shape[-1] != count or self.entry.shape[-2] < 1:
            raise ValueError(f"entry has the shape {self.entry.shape}")
        smooth = self.under_smooth
        if smooth is not None and (smooth.shape[:-2] != leading or smooth.shape[-1] != count or smooth.shape[-2] < 1):
            raise ValueError(f"under_smooth has the shape {smooth.shape}")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        coords = parameter_coordinates(self.parameters, uv, cos_i.shape)
        nodes = self.entry.shape[-2] - 1
        way_in = interpolate(self.entry, (*coords, np.maximum(cos_i, 0) * nodes))
        way_out = interpolate(self.entry, (*coords, np.maximum(cos_o, 0) * nodes))
        scale = interpolate(self.scale, coords) if coords else self.scale
        is_visible = ((cos_i > 0) & (cos_o > 0))[..., None]
        return np.where(is_visible, scale * way_in * way_out / np.pi, 0.0)

    def smooth_albedo(self, cos_i: Array, uv: Array | None = None) -> Array:
        """Return `under_smooth` at cosines `[...]` in the ambient, `[..., wavelength]`.

        Raises:
            UnsupportedError: without a film or with a smooth one, for which `hemispherical` is equal.
        """
        if self.under_smooth is None:
            raise UnsupportedError("a base without a rough film above it has no albedo under the smooth one")
        cos = np.asarray(cos_i, dtype=float)
        coords = parameter_coordinates(self.parameters, uv, cos.shape)
        return interpolate(self.under_smooth, (*coords, np.maximum(cos, 0) * (self.under_smooth.shape[-2] - 1)))
