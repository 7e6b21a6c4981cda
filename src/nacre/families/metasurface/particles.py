"""The particles of a recipe: their sizes and their coating."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.matter.indices.constant import OpticalConstant

SIZE_NODES = 5


@dataclass(frozen=True)
class Shell:
    """A coating round the core."""

    material: OpticalConstant
    thickness_nm: float


@dataclass(frozen=True)
class Sizes:
    """Radii of the cores and their shares in number."""

    radii_nm: tuple[float, ...]
    shares: tuple[float, ...]

    @classmethod
    def of(cls, radius_nm: float, deviation_nm: float = 0.0, distribution: str = "gaussian") -> Sizes:
        """Quadrature nodes of a size distribution with the given mean and standard deviation."""
        if deviation_nm == 0.0:
            return cls((radius_nm,), (1.0,))
        x, w = np.polynomial.hermite_e.hermegauss(SIZE_NODES)
        if distribution == "lognormal":
            variance = np.log1p((deviation_nm / radius_nm) ** 2)
            radii = radius_nm * np.exp(np.sqrt(variance) * x - variance / 2)
        else:
            radii = radius_nm + deviation_nm * x
        return cls(tuple(float(r) for r in radii), tuple(float(v) for v in w / w.sum()))
