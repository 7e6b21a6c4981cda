"""A material's answer to light: a sum of lobes on one wavelength grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe, SpecularResponse, specular_at
from nacre.bsdf.file import describe_lobes, read_lobes, write_lobes
from nacre.recipe.identity import identity


@dataclass(frozen=True)
class Bsdf:
    """A material's BSDF: a sum of lobes on one wavelength grid.

    Attributes:
        lobes: the terms of the sum, all on the same wavelengths.
        provenance: recipe text, nacre version, seed, notes; stored with every output.
    """

    lobes: tuple[Lobe, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Say what it is in a line: its lobes hold whole tables."""
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
    def identity(self) -> str:
        """A hash of the lobes' numbers, whatever they come from; see `nacre.recipe.identity`."""
        trees, arrays, _ = describe_lobes(self.lobes, "Bsdf")
        return identity(trees, {}, arrays={name: sha256(array.tobytes()).hexdigest() for name, array in arrays.items()})

    def save(self, path: str | Path, *, is_packed: bool = True) -> None:
        """Write one `.nacre` file, whole or not at all.

        Args:
            path: of the file.
            is_packed: deflated, for a file that is sent; else larger by a tenth or more, written and read quickly.

        Raises:
            NacreError: the file cannot be written.
        """
        write_lobes(path, self.lobes, self.provenance, is_packed)

    @classmethod
    def load(cls, path: str | Path) -> Bsdf:
        """Read a `.nacre` file.

        Raises:
            NacreError: in one line, if it is missing, damaged, too large or of a newer format.
        """
        return cls(*read_lobes(path))

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Sum the lobes' non-delta values: `[..., wavelength]`, 1/sr, without the cosine, never NaN."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        total = self.lobes[0].evaluate(wi, wo, uv)
        for lobe in self.lobes[1:]:
            total = total + lobe.evaluate(wi, wo, uv)
        return total

    def specular(
        self, theta_rad: Array | float, uv: Array | None = None, phi_rad: Array | float = 0.0
    ) -> SpecularResponse:
        """Sum the lobes' delta parts at incidence `theta_rad` (beyond pi/2: light from behind), azimuth `phi_rad`."""
        cos_i, phi = np.broadcast_arrays(np.cos(np.asarray(theta_rad, dtype=float)), np.asarray(phi_rad, dtype=float))
        parts = [specular_at(lobe, cos_i, phi, uv) for lobe in self.lobes]
        return SpecularResponse(
            np.sum([p.reflectance for p in parts], axis=0), np.sum([p.transmittance for p in parts], axis=0)
        )
