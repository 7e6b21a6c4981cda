"""The `Bsdf` (a lobe sum on one wavelength grid) and the `Spectrum` of a spectrophotometer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.angle_nodes import STATED_FROM
from nacre.bsdf.file import describe_lobes, read_lobes, write_lobes
from nacre.bsdf.lobe import Lobe, SpecularResponse, specular_at
from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.core.arrays import Array, direction
from nacre.recipe.fingerprint import fingerprint


@dataclass(frozen=True)
class Bsdf:
    """A material's BSDF: a lobe sum on one wavelength grid.

    Attributes:
        lobes: the sum's terms, all on the same wavelengths.
        provenance: recipe text, nacre version, seed, notes; stored with every output.
        polarisation: function that tabulates the Mueller interface matrices (or returns None), for polarised
            rendering.
    """

    lobes: tuple[Lobe, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    polarisation: Callable[[], InterfacePolarisation | None] | None = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        """Return a short description without the lobes' tables."""
        waves = self.wavelengths_nm
        kinds = ", ".join(lobe.kind for lobe in self.lobes)
        return f"<Bsdf of {kinds} at {len(waves)} wavelengths, {waves[0]:g} to {waves[-1]:g} nm>"

    @property
    def wavelengths_nm(self) -> Array:
        """The wavelength grid of all lobes, ascending."""
        return self.lobes[0].wavelengths_nm

    @property
    def transmits(self) -> bool:
        """Whether any lobe transmits."""
        return any(lobe.transmits for lobe in self.lobes)

    @property
    def fingerprint(self) -> str:
        """A hash of the lobes' numbers; see `nacre.recipe.fingerprint`."""
        trees, arrays, _ = describe_lobes(self.lobes, "Bsdf")
        return fingerprint(
            trees, {}, arrays={name: sha256(array.tobytes()).hexdigest() for name, array in arrays.items()}
        )

    def save(self, path: str | Path, *, is_packed: bool = True) -> None:
        """Write one `.nacre` file atomically, with the Mueller matrices of an interface that has them.

        Args:
            path: file path.
            is_packed: deflate, for transfer; otherwise the file is 10 % or more larger, but quick to write and read.

        Raises:
            NacreError: the file cannot be written.
        """
        matrices = None if self.polarisation is None else self.polarisation()
        write_lobes(path, self.lobes, self.provenance, is_packed, matrices)

    @classmethod
    def load(cls, path: str | Path) -> Bsdf:
        """Read a `.nacre` file.

        Raises:
            NacreError: the file is missing, damaged, too large, or has a newer format.
        """
        lobes, provenance, matrices = read_lobes(path)
        return cls(lobes, provenance, None if matrices is None else lambda: matrices)

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the sum of the lobes' non-delta values: `[..., wavelength]`, 1/sr, without the cosine, never NaN."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        total = self.lobes[0].evaluate(wi, wo, uv)
        for lobe in self.lobes[1:]:
            total = total + lobe.evaluate(wi, wo, uv)
        return total

    def specular(
        self, theta_rad: Array | float, uv: Array | None = None, phi_rad: Array | float = 0.0
    ) -> SpecularResponse:
        """Return the sum of the delta parts at incidence `theta_rad` (> pi/2: from behind), azimuth `phi_rad`."""
        cos_i, phi = np.broadcast_arrays(np.cos(np.asarray(theta_rad, dtype=float)), np.asarray(phi_rad, dtype=float))
        parts = [specular_at(lobe, cos_i, phi, uv) for lobe in self.lobes]
        return SpecularResponse(
            np.sum([p.reflectance for p in parts], axis=0), np.sum([p.transmittance for p in parts], axis=0)
        )

    def angle_error(self, theta_rad: Array | float) -> Array:
        """Return the stated error of the tables' R and T at incidence `theta_rad` (> pi/2: from behind), or 0."""
        note = self.provenance.get("angle_table", {})
        degrees = np.round(np.degrees(np.asarray(theta_rad, dtype=float)), 9)
        largest = float(note.get("largest_error", 0.0))
        if "ranges" not in note:
            return np.full(degrees.shape, largest)
        error = np.full(degrees.shape, min(largest, STATED_FROM))
        for one in note["ranges"]:
            own = degrees if one["side"] == "ambient" else 180.0 - degrees
            is_within = (own >= one["from_deg"]) & (own <= one["to_deg"])
            error = np.where(is_within, np.maximum(error, one["error"]), error)
        return error

    def error_ranges(self, theta_rad: Array | None = None, least_deg: float = 0.0) -> str:
        """Return the angles with an error above 0.005 in R or T as text; "" if there are none.

        Args:
            theta_rad: only ranges that include one of these incidences; default: all.
            least_deg: only if the ranges together are this wide.
        """
        ranges = self.provenance.get("angle_table", {}).get("ranges", ())
        if theta_rad is not None:
            degrees = np.round(np.degrees(theta_rad), 9)
            own = {"ambient": degrees, "substrate": 180.0 - degrees}
            ranges = [r for r in ranges if np.any((own[r["side"]] >= r["from_deg"]) & (own[r["side"]] <= r["to_deg"]))]
        if not ranges or sum(r["to_deg"] - r["from_deg"] for r in ranges) < least_deg:
            return ""
        named = [f"{r['error']:.2g} from {r['from_deg']:g} to {r['to_deg']:g} degrees ({r['side']})" for r in ranges]
        return "R and T of the table over angle are inexact by up to " + ", ".join(named)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power ratios `[angle, wavelength]` at angles in the ambient medium; inapplicable parts are unset.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        angles_deg: `[angle]`, incidence in the ambient medium.
        specular_reflectance, specular_transmittance: the delta part (for a rough film: its stack's values).
        diffuse_reflectance, diffuse_transmittance: directional-hemispherical, without the specular part.
        mueller_reflected, mueller_transmitted: Mueller matrices of the specular part, `[angle, wavelength, 4, 4]`, if
            requested: right-handed triads (p, s, k), S1 = |p|^2 - |s|^2, S3 > 0 for right circular light.
    """

    wavelengths_nm: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    specular_reflectance: NDArray[np.float64] | None = None
    specular_transmittance: NDArray[np.float64] | None = None
    diffuse_reflectance: NDArray[np.float64] | None = None
    diffuse_transmittance: NDArray[np.float64] | None = None
    mueller_reflected: NDArray[np.float64] | None = None
    mueller_transmitted: NDArray[np.float64] | None = None

    def parts(self) -> dict[str, NDArray[np.float64]]:
        """Return the applicable parts by name, in field order."""
        names = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def matrices(self) -> dict[str, NDArray[np.float64]]:
        """Return the Mueller matrices by name, if there are any."""
        names = ("mueller_reflected", "mueller_transmitted")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def __eq__(self, other: object) -> bool:
        """Whether all arrays are equal."""
        if not isinstance(other, Spectrum):
            return NotImplemented
        pairs = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return all(b is None if a is None else b is not None and np.array_equal(a, b) for a, b in pairs)

    __hash__ = None  # type: ignore[assignment]  # arrays can be written to


def is_isotropic(bsdf: Bsdf) -> bool:
    """Whether the values are invariant under rotation about the normal, tested at a few pairs.

    The lobes of grating orders are too narrow for this test and are never invariant.
    """
    if any(lobe.kind == "orders" for lobe in bsdf.lobes):
        return False
    theta_i, theta_o, dphi = (np.radians(v) for v in ([20.0, 50.0, 70.0], [35.0, 45.0, 60.0], [180.0, 150.0, 90.0]))
    values = [
        bsdf.evaluate(direction(theta_i, turn), direction(theta_o, dphi + turn)) for turn in np.radians([0, 31, 77, 90])
    ]
    scale = max(float(np.max(values)), 1e-30)
    return bool(np.ptp(np.stack(values), axis=0).max() <= 1e-4 * scale)
