"""A tabulated BRDF: measurements, imported files, tabulated materials.

Three coordinate systems, each with uniform nodes in transformed angles unless nodes are given:

- "direction": theta_i, theta_o and the azimuth difference, for broad lobes and goniometer data;
- "half": Rusinkiewicz' half and difference angles, with sqrt(theta_half), for sharp lobes;
- "specular": theta_i, and the radial angle and azimuth about the mirror direction, as in Zemax files.

The nodes of a measurement are kept, so that the table has the measured values at the measured directions.

Values are per wavelength, or per channel with a spectrum for each channel (an RGB measurement).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.bsdf.lobe import Lobe
from nacre.core.arrays import Array, from_half_difference, interpolate

COORDINATES = ("direction", "half", "specular")
HALF_PI = np.pi / 2


@dataclass(frozen=True)
class TableLobe(Lobe):
    """A BRDF tabulated over three angles, interpolated linearly, zero below the surface.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        values: `[a, b, c, channel]`, 1/sr, uniform nodes that include both ends of [0, 1] in each coordinate:
            "direction": a = theta_i/(pi/2), b = theta_o/(pi/2), c = |dphi|/pi with |dphi| in [0, pi], where
            dphi = 0 is retroreflection;
            "half": a = sqrt(theta_half/(pi/2)), b = theta_diff/(pi/2), c = phi_diff/pi, periodic.
            "specular": a as for "direction", b = radial/pi, c = azimuth/pi with azimuth 0 towards the normal.
        basis: `[channel, wavelength]`, the channels' spectra.
        coordinates: "direction", "half" or "specular".
        nodes_a, nodes_b, nodes_c: the nodes' coordinates, ascending, where they are not uniform; values beyond the
            first and the last are held.
        is_signed: whether c distinguishes the sides of the plane of incidence: c = (azimuth + pi)/(2 pi); the azimuth
            runs from the light to the viewer, counter-clockwise from above ("direction"), or as in Zemax files.
        nodes_turn: light azimuths over 2 pi, ascending, for an anisotropic sample; then values have the shape
            `[turn, a, b, c, channel]`.
    """

    wavelengths_nm: Array
    values: Array
    basis: Array
    coordinates: str = "direction"
    nodes_a: Array | None = None
    nodes_b: Array | None = None
    nodes_c: Array | None = None
    is_signed: bool = False
    nodes_turn: Array | None = None

    kind: ClassVar[str] = "table"
    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "values": "a b c channel",
        "basis": "channel wavelength",
        "nodes_a": "a",
        "nodes_b": "b",
        "nodes_c": "c",
        "nodes_turn": "turn",
    }
    OMITTED_UNSET: ClassVar[tuple[str, ...]] = ("nodes_a", "nodes_b", "nodes_c", "is_signed", "nodes_turn")

    @property
    def nodes(self) -> tuple[Array | None, Array | None, Array | None]:
        """The nodes of the three coordinates; None: uniform."""
        return self.nodes_a, self.nodes_b, self.nodes_c

    def check(self) -> None:
        """Check that the arrays are consistent.

        Raises:
            ValueError: names the inconsistent array.
        """
        if self.coordinates not in COORDINATES:
            raise ValueError(f'coordinates = "{self.coordinates}" is not one of {COORDINATES}')
        if self.values.ndim != (4 if self.nodes_turn is None else 5) or min(self.values.shape[-4:-1]) < 2:
            raise ValueError(f"values has the shape {self.values.shape}")
        if self.basis.shape != (self.values.shape[-1], len(self.wavelengths_nm)):
            raise ValueError(f"basis has the shape {self.basis.shape}")
        if self.is_signed and self.coordinates == "half":
            raise ValueError("half-angle coordinates have no signed azimuth")
        axes = [*zip("abc", self.nodes, self.values.shape[-4:-1], strict=True)]
        axes += [("turn", self.nodes_turn, self.values.shape[0])]
        for name, nodes, count in axes:
            if nodes is not None and (nodes.shape != (count,) or count < 2 or np.any(np.diff(nodes) <= 0)):
                raise ValueError(f"nodes_{name} must hold {count} ascending numbers")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, for unit vectors `[..., 3]`; uv is ignored."""
        up = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        turn = None if self.nodes_turn is None else _turn(wi)
        channels = self._fetch(*self.coordinates_of(wi, wo), turn)
        return np.asarray(np.where(up[..., None], np.maximum(channels @ self.basis, 0.0), 0.0))

    def coordinates_of(self, wi: Array, wo: Array) -> tuple[Array, Array, Array]:
        """Return the table's coordinates of directions `[..., 3]`, each `[...]` in [0, 1]."""
        if self.coordinates == "half":
            return to_half(wi, wo)
        a, b, azimuth = to_direction(wi, wo) if self.coordinates == "direction" else to_specular(wi, wo)
        return a, b, (azimuth + 1.0) / 2.0 if self.is_signed else np.abs(azimuth)

    def _fetch(self, a: Array, b: Array, c: Array, turn: Array | None) -> Array:
        """Interpolate linearly at coordinates in [0, 1]: `[..., channel]`."""
        places = [
            x * (n - 1) if nodes is None else np.interp(x, nodes, np.arange(n))
            for x, n, nodes in zip((a, b, c), self.values.shape[-4:-1], self.nodes, strict=True)
        ]
        if turn is not None and self.nodes_turn is not None:
            places.insert(0, np.interp(turn, self.nodes_turn, np.arange(len(self.nodes_turn))))
        return interpolate(self.values, tuple(np.broadcast_arrays(*places)))


def _turn(w: Array) -> Array:
    """Return the azimuth over 2 pi in [0, 1)."""
    cosine, sine = _azimuth(w)
    return np.asarray(np.arctan2(sine, cosine) / (2 * np.pi) % 1.0)


def to_direction(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return the "direction" coordinates: a, b in [0, 1], and the signed azimuth difference over pi in [-1, 1]."""
    a = np.arccos(np.clip(wi[..., 2], -1, 1)) / HALF_PI
    b = np.arccos(np.clip(wo[..., 2], -1, 1)) / HALF_PI
    x, y = _azimuth(wi)
    cos_o, sin_o = _azimuth(wo)
    return a, b, np.arctan2(x * sin_o - y * cos_o, x * cos_o + y * sin_o) / np.pi


def _azimuth(w: Array) -> tuple[Array, Array]:
    """Return cosine and sine of the azimuth; (1, 0) at the normal."""
    sine = np.hypot(w[..., 0], w[..., 1])
    flat = sine < 1e-9
    safe = np.where(flat, 1.0, sine)
    return np.where(flat, 1.0, w[..., 0] / safe), np.where(flat, 0.0, w[..., 1] / safe)


def to_specular(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return the "specular" coordinates: a, b in [0, 1], and the signed azimuth over pi in [-1, 1]."""
    cos_i = np.clip(wi[..., 2], -1, 1)
    sin_i = np.sqrt(1 - cos_i**2)
    cos_p, sin_p = _azimuth(wi)
    x = wo[..., 0] * cos_p + wo[..., 1] * sin_p
    y = wo[..., 1] * cos_p - wo[..., 0] * sin_p
    along = cos_i * wo[..., 2] - sin_i * x
    to_normal = cos_i * x + sin_i * wo[..., 2]
    radial = np.arctan2(np.hypot(to_normal, y), along)
    return np.arccos(cos_i) / HALF_PI, radial / np.pi, np.arctan2(-y, to_normal) / np.pi


def to_half(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff as table coordinates, each in [0, 1]."""
    theta_half, theta_diff, phi_diff = half_difference(wi, wo)
    return np.sqrt(theta_half / HALF_PI), theta_diff / HALF_PI, phi_diff / np.pi


def half_difference(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff (radians), phi_diff in [0, pi) by reciprocity.

    Source: Rusinkiewicz 1998: the half vector's polar angle, and `wi` in the half vector's frame.
    """
    h = wi + wo
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    cos_h = np.clip(h[..., 2], -1.0, 1.0)
    sin_h = np.sqrt(1 - cos_h**2)
    cos_p, sin_p = _azimuth(h)
    x = wi[..., 0] * cos_p + wi[..., 1] * sin_p
    y = -wi[..., 0] * sin_p + wi[..., 1] * cos_p
    dx, dz = cos_h * x - sin_h * wi[..., 2], sin_h * x + cos_h * wi[..., 2]
    return np.arccos(cos_h), np.arccos(np.clip(dz, -1.0, 1.0)), np.mod(np.arctan2(y, dx), np.pi)


def directions_of(coordinates: str, shape: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return wi and wo at all table nodes, each `[a, b, c, 3]`, to fill a table."""
    a, b, c = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    if coordinates == "half":
        return from_half_difference(a**2 * HALF_PI, b * HALF_PI, c * np.pi)
    ti, to, phi = a * HALF_PI, b * HALF_PI, c * np.pi
    wi = np.stack([np.sin(ti), np.zeros_like(ti), np.cos(ti)], axis=-1)
    return wi, np.stack([np.sin(to) * np.cos(phi), np.sin(to) * np.sin(phi), np.cos(to)], axis=-1)
