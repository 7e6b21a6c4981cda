"""What lies below strata that are walked through: a diffuse or a specular ground, other lobes, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.bsdf.contract import Lobe
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.roughness import Roughness
from nacre.bsdf.strata import join_strata
from nacre.errors import NacreError, UnsupportedError
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.stack.solve import powers

BASE_NODES = 129


@dataclass(frozen=True)
class Base:
    """What lies below.

    Attributes:
        kind: "none", "diffuse", "specular", "lobes" or "strata".
        albedo: of a diffuse base: a number, or (wavelengths_nm, albedo) of a coloured one.
        metal: material of a specular base.
        film: a solved opaque film as base: (wavelengths_nm, cos, reflectance[cos, wavelength]).
        surface: roughness of a specular base, or of the lower interface of an open stack.
        other: of "lobes", an opaque material of any family, built with the last resin as its ambient; of "strata", a
            material whose own strata, and base, go on below these ones.
        refuse: makes the error of an `other` that cannot be a base, from the reason.
    """

    kind: str = "diffuse"
    albedo: float | tuple[Array, Array] = 0.0
    metal: OpticalConstant | None = None
    film: tuple[Array, Array, Array] | None = None
    surface: Roughness = Roughness()
    other: Any = None
    refuse: Callable[[str], NacreError] = UnsupportedError

    @cached_property
    def default_lobes(self) -> tuple[Lobe, ...]:
        """The other material's lobes on wavelengths of its own choice."""
        return self.lobes(None)

    def known_in(self, grid: Array) -> Array:
        """Return a grid of wavelengths with its ends set by another material that is known in less, as measured."""
        if self.other is None:
            return grid
        known = self.other.model.wavelengths_nm if self.kind == "strata" else self.default_lobes[0].wavelengths_nm
        low, high = max(float(known[0]), grid[0]), min(float(known[-1]), grid[-1])
        return np.concatenate([[low], grid[(grid > low + 1e-6) & (grid < high - 1e-6)], [high]])

    def reflectance(self, wavelengths_nm: Array, medium: Callable[[Array], ComplexArray]) -> Array:
        """Return what a walk takes for `base_reflectance`, `[cos, wavelength]`: one row of a diffuse albedo, or R.

        Args:
            wavelengths_nm: ascending.
            medium: index of what lies on the base, by the wavelength; its absorption does not count.
        """
        lam = wavelengths_nm
        if self.kind in ("none", "lobes", "strata"):
            return np.zeros((1, len(lam)))
        if self.kind == "diffuse":
            if isinstance(self.albedo, tuple):
                return np.interp(lam, *self.albedo)[None]
            return np.full((1, len(lam)), float(self.albedo))
        cos = np.linspace(0.0, 1.0, BASE_NODES)
        if self.film is not None:
            wavelengths, nodes, reflectance = self.film
            rows = np.stack([np.interp(lam, wavelengths, row) for row in reflectance])
            return np.stack([np.interp(cos, nodes, rows[:, i]) for i in range(len(lam))], axis=1)
        assert self.metal is not None
        n = np.stack([medium(lam).real + 0j, self.metal.n_complex(lam)])
        return powers(n, np.zeros(0), lam, cos_i=cos).reflectance

    @property
    def walk_kind(self) -> str:
        """What a walk is told of it: strata that go on are open until `continued` has laid them on."""
        return "none" if self.kind == "strata" else self.kind

    def continued(self, strata: Layered) -> Layered:
        """Return the strata with those of another material below them, if that is what the base is.

        Raises:
            NacreError: the other ones cannot go on below others.
        """
        if self.kind != "strata":
            return strata
        below = self.other.model.strata_at(strata.wavelengths_nm)
        try:
            return join_strata(strata, below)
        except UnsupportedError as error:
            raise self.refuse(str(error)) from None

    def lobes(self, wavelengths_nm: Array | None) -> tuple[Lobe, ...]:
        """Return the other material's lobes at given wavelengths.

        Raises:
            NacreError: it transmits, or is a random walk itself.
        """
        if self.other is None or self.kind == "strata":
            return ()
        lobes: tuple[Lobe, ...] = self.other.bsdf(wavelengths_nm).lobes
        if any(is_strata(lobe) for lobe in lobes):
            raise self.refuse(
                "holds a pearl or another walk; that cannot be a base: write its strata below these ones instead"
            )
        if any(lobe.transmits for lobe in lobes):
            raise self.refuse("lets light through; a base should be opaque, on a metal or with a base of its own")
        return lobes


def is_strata(lobe: Lobe) -> bool:
    """Tell whether a lobe is one of strata (a pearl, a photonic glass), masked or not."""
    inner = getattr(lobe, "inner", None)
    return lobe.kind in ("layered", "flaked") or (inner is not None and is_strata(inner))
