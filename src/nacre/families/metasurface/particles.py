"""The particles of a recipe: their sizes and their coating."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import ComplexArray
from nacre.families.metasurface.substrate import Substrate
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.mie import mie_coefficients

SIZE_NODES = 5


@dataclass(frozen=True)
class Shell:
    """A coating round the core."""

    material: OpticalConstant
    thickness_nm: float


@dataclass(frozen=True)
class Sizes:
    """Radii of the cores of spheres, or whole ones of other particles, and their shares in number."""

    radii_nm: tuple[float, ...]
    shares: tuple[float, ...]

    def larger_by(self, coat_nm: float) -> Sizes:
        """Return the sizes with a coat."""
        return Sizes(tuple(r + coat_nm for r in self.radii_nm), self.shares)

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


def sphere_t_matrix(
    core: OpticalConstant, shell: Shell | None, radius_nm: float, lmax: int, surface: Substrate
) -> ComplexArray:
    """Return the diagonal T of one sphere at the wavelength of `surface`, `[n]`: -b_l, then -a_l (Mie)."""
    lam = np.array([surface.wavelength_nm])
    radii, indices = [radius_nm], [complex(core.n_complex(lam)[0])]
    if shell is not None:
        radii.append(radius_nm + shell.thickness_nm)
        indices.append(complex(shell.material.n_complex(lam)[0]))
    x = surface.inner_wavenumber * np.array(radii)
    a, b = mie_coefficients(lmax, x, np.array(indices) / surface.inner_index)
    return np.concatenate([-b, -a])
