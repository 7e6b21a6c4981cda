"""Individual flakes of a pearl, for sparkle and graininess: number, size, slope, brightness and shading from above.

Under a small lamp, light reflected by one flake with the normal slope s_j, the half vector's slope s in the resin and
the kernel k has, with the cosines mu inside and the transmittances t of the interfaces (compare
`nacre.bsdf.lobes.platelet_layer`),

    f = t_i t_o (1 + |s|^2)^2 / (4 n^2 mu_i mu_o)  R k(s - s_j) T^m exp(-a z);

its mean over the flakes is the analytic single scattering. m is the number of other flakes that light crosses on both
ways, Poisson-distributed with a mean proportional to the depth, T their mean transmittance, a the absorption.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from nacre.bsdf.facet_distributions import fresnel
from nacre.bsdf.glints import DiffuseFlakes, LitFlakes, glint_species, mean_square, radius_quantiles
from nacre.core.arrays import Array, direction
from nacre.core.errors import UnsupportedError
from nacre.families.pearl.platelet import FlakeNormals, Platelet, optical_number, orthonormal_basis, platelet_response
from nacre.families.pearl.strata import Flakes, Stratum, dye_response
from nacre.families.pearl.surrogate import TRUNCATION

DEPTH_NODES = 17
COS_NODES = 257
NORMALS = 32  # squared: visible normals in a mean
FACING_NODES = 1025
LEAST = 1e-3  # share of the brightest flake, below which crossings are not tabulated
MOST_CROSSINGS = 200
INDEX_NM = 550.0
RESOLUTION = 0.51 / 2.3548  # standard deviation of an image point, half width at half maximum 0.51 wavelengths / NA


MOST_TABLES = 128  # cached tables, about 130 kB each
_tables: dict[tuple[object, ...], tuple[Array, Array]] = {}
_tables_lock = Lock()


def _table(platelet: Platelet, container_n: Array, wavelengths_nm: Array) -> tuple[Array, Array]:
    """Return a flake's unpolarised R and T `[cos, wavelength]`; recent ones are cached, as candidates share them."""
    key = (*platelet.key, container_n.tobytes(), wavelengths_nm.tobytes())
    table = _tables.get(key)
    if table is None:
        cos = np.linspace(0.0, 1.0, COS_NODES)
        table = platelet_response(platelet, container_n, cos, wavelengths_nm, TRUNCATION).unpolarised()
        with _tables_lock:
            while len(_tables) >= MOST_TABLES:
                _tables.pop(next(iter(_tables)))
            _tables[key] = table
    return table


def visible_normals(normals: FlakeNormals, w: Array, nodes: int = NORMALS) -> tuple[Array, float]:
    """Return normals `[node^2, 3]` with the distribution of the area visible along `w[3]`, and that area.

    The area is relative to the same flakes lying flat. With the root M of the SGGX matrix, m is along M y, with y
    cosine-distributed about M w (Heitz et al. 2015, section 4).
    """
    root = normals.frame @ np.diag(normals.axes) @ normals.frame.T
    axis = root @ w
    area = float(np.linalg.norm(axis))
    axis = axis / area
    share, turn = np.meshgrid((np.arange(nodes) + 0.5) / nodes, (np.arange(nodes) + 0.5) / nodes * 2 * np.pi)
    tangent, bitangent = orthonormal_basis(axis)
    radius = np.sqrt(share)[..., None]
    y = radius * (np.cos(turn)[..., None] * tangent + np.sin(turn)[..., None] * bitangent)
    y = (y + np.sqrt(1.0 - share)[..., None] * axis).reshape(-1, 3)
    m = y @ root
    return m / np.linalg.norm(m, axis=1, keepdims=True), area


class FlakeTexture:
    """The flakes of a pearl at given wavelengths.

    Args:
        strata: the pearl's strata from the light inward; each pigment has a diameter.
        glints: spread of the diameters and flatness of the flakes, or None for the defaults.
        wavelengths_nm: `[wavelength]`, vacuum.
        weights: `[wavelength]`; the weighted sum of a reflectance factor is the luminance factor.

    Raises:
        UnsupportedError: a pigment has no diameter, or the pearl has no pigment.
    """

    def __init__(self, strata: Sequence[Stratum], glints: Glints | None, wavelengths_nm: Array, weights: Array) -> None:
        self.strata, self.wavelengths_nm, self.weights = strata, wavelengths_nm, weights
        for i, stratum in enumerate(strata):
            for j, flakes in enumerate(stratum.flakes):
                if flakes.diameter_um is None:
                    raise UnsupportedError(f"strata[{i}].platelets[{j}].diameter_um is missing; texture needs it")
        if not any(stratum.flakes for stratum in strata):
            raise UnsupportedError("the pearl has no platelets, and so no texture")
        self.scales = glints or Glints((1.0, 1.0))
        at = np.array([INDEX_NM])
        self.index = [float(stratum.resin.n_complex(at)[0].real) for stratum in strata]
        self.absorption = [self._absorption(stratum) for stratum in strata]
        self.cos = np.linspace(0.0, 1.0, COS_NODES)
        self.tables = [
            [_table(f.platelet, s.resin.n_complex(wavelengths_nm).real, wavelengths_nm)
             for f in s.kinds]
            for s in strata
        ]  # fmt: skip

    def _absorption(self, stratum: Stratum) -> Array:
        lam = self.wavelengths_nm
        n = stratum.resin.n_complex(lam)
        absorption = 4 * np.pi * n.imag * stratum.thickness_nm / lam
        if stratum.dye is not None:
            absorption = absorption + dye_response(stratum.dye, n.real, stratum.thickness_nm, lam).extinction
        return np.asarray(absorption)

    def _number(self, stratum: Stratum, flakes: Flakes) -> float:
        return optical_number(flakes.volume_fraction, stratum.thickness_nm, flakes.platelet.height_nm)

    def _read(self, table: Array, cos: Array) -> Array:
        at = np.clip(np.abs(cos), 0.0, 1.0) * (COS_NODES - 1)
        low = np.minimum(at.astype(int), COS_NODES - 2)
        part = (at - low)[..., None]
        return np.asarray((1.0 - part) * table[low] + part * table[low + 1])

    def _crossings(self, i: int, w: Array) -> tuple[float, Array]:
        """Return the flakes crossed by light along `w[3]` in a stratum, and their optical thickness `[wavelength]`."""
        stratum, crossed, depth = self.strata[i], 0.0, np.zeros(len(self.wavelengths_nm))
        for flakes, (_, transmit) in zip(stratum.kinds, self.tables[i], strict=True):
            m, area = visible_normals(flakes.normals, w)
            count = self._number(stratum, flakes) * area / abs(w[2])
            crossed += count
            depth = depth + count * np.mean(1.0 - self._read(transmit, m @ w), axis=0)
        return crossed, depth

    def _inside(self, w: Array, i: int) -> tuple[Array, float]:
        """Return a direction `[3]` refracted into a stratum, and the transmittance of all interfaces above it."""
        passed, cos, outer = 1.0, float(w[2]), 1.0
        for index in self.index[: i + 1]:
            eta = index / outer
            passed *= 1.0 - float(fresnel(np.array(cos), eta))
            cos, outer = math.sqrt(max(1.0 - (1.0 - cos * cos) / (eta * eta), 0.0)), index
        sine = w[:2] / self.index[i]
        return np.array([*sine, math.sqrt(max(1.0 - float(sine @ sine), 1e-12))]), passed

    def lit(self, theta_rad: float, lamp_rad: float, camera_rad: float) -> list[LitFlakes]:
        """Return the flakes under a lamp at an angle from the normal, seen along the normal.

        Args:
            theta_rad: angle between the normal and the lamp, in the ambient.
            lamp_rad, camera_rad: half angles of the cones to the lamp and to the entrance pupil of the camera.
        """
        wi, wo = direction(theta_rad), np.array([0.0, 0.0, 1.0])
        flakes_lit: list[LitFlakes] = []
        above_um, above_depth = 0.0, np.zeros(len(self.wavelengths_nm))
        for i, stratum in enumerate(self.strata):
            (inner_i, passed_i), (inner_o, passed_o) = self._inside(wi, i), self._inside(wo, i)
            ways = [self._crossings(i, inner) for inner in (inner_i, inner_o)]
            slant = 1.0 / inner_i[2] + 1.0 / inner_o[2]
            crossed = ways[0][0] + ways[1][0]
            shade = 1.0 - (ways[0][1] + ways[1][1]) / crossed if crossed > 0 else np.ones(len(self.wavelengths_nm))
            tall = self.index[i] * (inner_i[2] + inner_o[2])
            half = (wi + wo)[:2] / tall
            scale = passed_i * passed_o * (1.0 + float(half @ half)) ** 2 / (
                4.0 * self.index[i] ** 2 * inner_i[2] * inner_o[2]
            )  # fmt: skip
            facing = math.sqrt(0.5 * (1.0 + float(inner_i @ inner_o)))
            variance = self._variance(i, theta_rad, lamp_rad, camera_rad, tall)
            reach_um = above_um + stratum.thickness_nm / 1e3 * _mean_depth(crossed * (1.0 - float(np.mean(shade))))
            for flakes, (reflect, _) in zip(stratum.kinds, self.tables[i], strict=True):
                spectrum = self.weights * np.pi * scale * self._read(reflect, np.array(facing)) * np.exp(-above_depth)
                radii = radius_quantiles(float(flakes.diameter_um or 0.0), self.scales.diameter_spread)
                flakes_lit.append(LitFlakes(
                    number=self._number(stratum, flakes) / (math.pi * mean_square(radii) * 1e-6),
                    radii_um=radii,
                    blur_um=self._blur_um(i, reach_um, camera_rad),
                    half=half,
                    variance=variance,
                    diffraction_um=DIFFRACTION * MIDDLE_UM / self.index[i],
                    density=_slope_density(flakes.normals),
                    brightness=_brightness(spectrum, self.absorption[i] * slant, shade, crossed),
                    crossings=crossed,
                ))  # fmt: skip
            above_um += stratum.thickness_nm / 1e3
            above_depth = above_depth + ways[0][1] + ways[1][1] + self.absorption[i] * slant
        return flakes_lit

    def _variance(self, i: int, theta_rad: float, lamp_rad: float, camera_rad: float, tall: float) -> Array:
        """Return the variance of the slope between half vector and normal, without diffraction, `[2]`.

        A cone of half angle a has the variance a^2 / 4 along each axis; a lamp at an angle is foreshortened.
        """
        bends = [
            interface_bend(self._alpha(k), self.index[k] / (self.index[k - 1] if k else 1.0)) for k in range(i + 1)
        ]
        own = math.tan(math.radians(self.scales.flatness_deg)) ** 2 + sum(b * b for b in bends)
        lamp = 0.25 * lamp_rad**2 * np.array([math.cos(theta_rad) ** 2, 1.0])
        return np.asarray(own + (lamp + 0.25 * camera_rad**2) / tall**2)

    def _alpha(self, i: int) -> float:
        surface = self.strata[i].surface
        return math.sqrt(max(surface.alpha_x * surface.alpha_y, 0.0))

    def _blur_um(self, i: int, reach_um: float, camera_rad: float) -> float:
        """Return the standard deviation of an image point on the surface.

        Contributions: diffraction at the entrance pupil; defocus, as the camera is focused on the outer surface; and
        refraction at the rough outer interface for light from `reach_um` below.
        """
        pupil = RESOLUTION * MIDDLE_UM / math.sin(camera_rad)
        defocus = 0.5 * reach_um * math.tan(camera_rad) / self.index[i]
        bend = reach_um * interface_bend(self._alpha(0), self.index[0])
        return math.hypot(pupil, defocus, bend)

    def diffuse(self) -> list[DiffuseFlakes]:
        """Return the flakes under uniform diffuse light, seen along the normal.

        A flake reflects the light of one direction to the viewer; beyond the critical angle it reflects none.
        """
        flakes_lit: list[DiffuseFlakes] = []
        normal = np.array([0.0, 0.0, 1.0])
        depth = np.linspace(0.0, 1.0, DEPTH_NODES)
        tilt = np.arccos(self.cos)
        above: Array = np.zeros((COS_NODES, len(self.wavelengths_nm)))
        for i, stratum in enumerate(self.strata):
            sine = np.sin(np.minimum(2.0 * tilt, np.pi / 2)) * self.index[i]
            is_lit = (2.0 * tilt < np.pi / 2) & (sine < 1.0)
            outside = [direction(float(np.arcsin(s))) if lit else normal for s, lit in zip(sine, is_lit, strict=True)]
            inner, passed = zip(*(self._inside(w, i) for w in outside), strict=True)
            _, view = self._inside(normal, i)
            slant = np.array([1.0 / w[2] for w in inner])
            coarse = np.linspace(0, COS_NODES - 1, 17).astype(int)
            down = np.stack([self._crossings(i, inner[k])[1] for k in coarse])
            crossed = np.stack([np.interp(np.arange(COS_NODES), coarse, row) for row in down.T], axis=1)
            way = crossed + self.absorption[i] * (slant[:, None] + 1.0)
            for flakes, (reflect, transmit) in zip(stratum.kinds, self.tables[i], strict=True):
                m, area = visible_normals(flakes.normals, normal, 2 * NORMALS)
                first = reflect * (is_lit * np.array(passed) * view)[:, None] * np.exp(-above) * self.weights
                luminance = np.stack([np.sum(first * np.exp(-way * z), axis=1) for z in depth])
                flakes_lit.append(DiffuseFlakes(
                    stratum=i,
                    coverage=self._number(stratum, flakes) * area,
                    radii_um=radius_quantiles(float(flakes.diameter_um or 0.0), self.scales.diameter_spread),
                    facing=np.quantile(np.abs(m[:, 2]), np.linspace(0.0, 1.0, FACING_NODES)),
                    luminance=luminance,
                    transmittance=(transmit @ self.weights) / np.sum(self.weights),
                ))  # fmt: skip
            above = above + way
        return flakes_lit


def _mean_depth(depth: float) -> float:
    """Return the mean relative depth of visible flakes, weighted by exp(-depth z)."""
    if depth < 1e-3:
        return 0.5
    return 1.0 / depth - 1.0 / math.expm1(min(depth, 500.0))


def _slope_density(normals: FlakeNormals) -> Callable[[Array], Array]:
    def density(slopes: Array) -> Array:
        m = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)
        length = np.linalg.norm(m, axis=-1, keepdims=True)
        return np.asarray(normals.density(m / length) / length[..., 0] ** 4)

    return density


def _brightness(spectrum: Array, absorbed: Array, shade: Array, crossed: float) -> Array:
    """Return the luminance times unit slope area `[depth, crossings]`."""
    clear = float(np.max(shade))
    most = crossed + 6.0 * math.sqrt(crossed) + 6.0
    if clear < 1.0:
        most = min(most, math.log(LEAST) / math.log(max(clear, 1e-9)) + 1.0)
    powers = np.maximum(shade, 0.0)[:, None] ** np.arange(math.ceil(min(most, MOST_CROSSINGS)) + 1)
    depth = np.linspace(0.0, 1.0, DEPTH_NODES)
    return np.asarray((spectrum * np.exp(-np.outer(depth, absorbed))) @ powers)


# Resolved flakes in the uppermost stratum: number, apparent size and flatness.

MIDDLE_UM = 0.55
# Airy disc half width for a flake with diameter d in the resin, 0.51 lambda / (n d), as a Gaussian standard deviation
# (over sqrt(2 ln 2)), halved: a normal turns by half the light's angle
DIFFRACTION = 0.51 / 1.1774 / 2.0
SEED_STEP = 7919  # seed difference between two pigments


@dataclass(frozen=True)
class Glints:
    """Resolved flakes.

    Attributes:
        surface_mm: length on the object per unit of u and v.
        diameter_spread: standard deviation, log diameter.
        flatness_deg: normal's standard deviation over one flake.
        seed: seed for the positions.
    """

    surface_mm: tuple[float, float]
    diameter_spread: float = 0.3
    flatness_deg: float = 0.5
    seed: int = 0


def interface_bend(alpha: float, index: float) -> float:
    """Return the half vector's spread inside, as a slope, by two passages through a rough interface near the normal."""
    return alpha * abs(index - 1.0) / (math.sqrt(2.0) * index)


def glint_arrays(
    glints: Glints, stratum: Stratum, index: float, number: Array, extinct: Array
) -> tuple[Array, Array, Array]:
    """Return numbers, radii and ratios of `nacre.bsdf.glints` for a stratum's pigments.

    Light reflected by a flake is attenuated on its way in and out: among `number` flakes,
    number (1 - exp(-2 tau)) / (2 tau) are visible, with the extinction tau along the normal.

    Args:
        glints: scale and flake spread.
        stratum: its flakes have diameters.
        index: resin over ambient.
        number: `[kind]`, flakes met along the normal.
        extinct: `[kind]`, flake extinction along the normal.
    """
    depth = 2.0 * float(np.sum(number * extinct))
    reach = -math.expm1(-depth) / depth if depth > 1e-9 else 1.0
    alpha = math.sqrt(max(stratum.surface.alpha_x * stratum.surface.alpha_y, 0.0))
    bend = interface_bend(alpha, index)
    species = []
    for k, flakes in enumerate(stratum.kinds):
        assert flakes.diameter_um is not None
        diffraction = DIFFRACTION * MIDDLE_UM / (index * flakes.diameter_um)
        own = math.hypot(math.tan(math.radians(glints.flatness_deg)), diffraction, bend)
        deviation = float(np.sqrt(flakes.normals.axes[0] * flakes.normals.axes[1]))
        seed = (glints.seed + SEED_STEP * k) % (1 << 24)
        species.append(
            glint_species(
                glints.surface_mm, flakes.diameter_um, glints.diameter_spread, float(number[k]) * reach,
                own / deviation, seed,
            )
        )  # fmt: skip
    numbers, radii, ratio = (np.stack(part) for part in zip(*species, strict=True))
    return numbers, radii, ratio
