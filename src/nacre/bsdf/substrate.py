"""The substrate below strata, and strata of one material on strata of another.

Depths are in units of each stratum and indices are relative to the ambient, so strata are concatenated; tables on
different nodes are resampled to the finer nodes.
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.compensation import interface_losses
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.layered import Layered
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError, UnsupportedError
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.stack.solve import powers


class Strata(abc.ABC):
    """A material solved by random walks in strata, on which strata of any family can lie."""

    @abc.abstractmethod
    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the strata and the base, also if the material's Bsdf has a noise-free form."""


def join_strata(upper: Layered, lower: Layered) -> Layered:
    """Place strata on other strata; the interface between them is the lower strata's upper interface.

    Args:
        upper: its own substrate is discarded.
        lower: on the same wavelengths, with its substrate.

    Raises:
        UnsupportedError: the lower strata have glints.
    """
    if lower.glint_numbers is not None:
        raise UnsupportedError("has glints; only the uppermost stratum may have glints: leave them out")
    index = np.concatenate([upper.index, lower.index])
    alpha = np.concatenate([upper.alpha[:-1], lower.alpha])
    beckmann = np.concatenate([upper.is_beckmann[:-1], lower.is_beckmann])
    phase, quantile = _dye_tables(upper, lower)
    dye = None
    if upper.dye is not None or lower.dye is not None:
        dye = np.concatenate([_zeros_unless(part) for part in (upper, lower)])
    joined = replace(
        upper,
        index=index,
        alpha=alpha,
        is_beckmann=beckmann,
        flake_stratum=np.concatenate([upper.flake_stratum, lower.flake_stratum + upper.strata]),
        flake_number=np.concatenate([upper.flake_number, lower.flake_number]),
        flake_axes=np.concatenate([upper.flake_axes, lower.flake_axes]),
        flake_frame=np.concatenate([upper.flake_frame, lower.flake_frame]),
        flake_response=_joined(upper.flake_response, lower.flake_response, (1,)),
        flake_extinction=_joined(upper.flake_extinction, lower.flake_extinction, (1, 2)),
        base=lower.base,
        base_reflectance=lower.base_reflectance,
        base_lobes=lower.base_lobes,
        loss=interface_losses(_faces(upper, lower, alpha, beckmann), index, lower.base == "none"),
        dye=dye,
        dye_phase=phase,
        dye_quantile=quantile,
    )
    joined.check()
    return joined


def _faces(upper: Layered, lower: Layered, alpha: Array, beckmann: NDArray[np.int64]) -> list[Roughness]:
    """Return the interfaces with their compensation flags; only compensated interfaces have a loss."""
    flags: list[bool] = []
    for lobe in (upper, lower):
        known = np.zeros(lobe.strata + 1, dtype=bool) if lobe.loss is None else np.any(lobe.loss > 0, axis=(1, 2))
        flags.extend(bool(flag) for flag in (known[:-1] if lobe is upper else known))
    return [
        Roughness("beckmann" if beckmann[i] else "ggx", float(alpha[i, 0]), float(alpha[i, 1]), compensate=flag)
        for i, flag in enumerate(flags)
    ]


def _joined(first: Array, second: Array, axes: tuple[int, ...]) -> Array:
    """Concatenate flake tables on the finer nodes of the two."""
    if not len(first) or not len(second):
        return second if not len(first) else first
    for axis in axes:
        most = max(first.shape[axis], second.shape[axis])
        first, second = _resampled(first, axis, most), _resampled(second, axis, most)
    return np.concatenate([first, second])


def _resampled(table: Array, axis: int, count: int) -> Array:
    """Resample an axis of uniform nodes to `count` nodes."""
    have = table.shape[axis]
    if have == count:
        return table
    if have == 1:
        return np.repeat(table, count, axis=axis)
    place = np.linspace(0.0, have - 1.0, count)
    low = np.minimum(place.astype(int), have - 2)
    part = (place - low).reshape(-1, *([1] * (table.ndim - axis - 1)))
    below, above = np.take(table, low, axis=axis), np.take(table, low + 1, axis=axis)
    return np.asarray(below * (1 - part) + above * part)


def _zeros_unless(lobe: Layered) -> Array:
    return np.zeros((lobe.strata, len(lobe.wavelengths_nm), 2)) if lobe.dye is None else lobe.dye


def _dye_tables(upper: Layered, lower: Layered) -> tuple[Array | None, Array | None]:
    """Return phase functions and quantiles for all strata; a stratum without scattering gets isotropic, unused ones."""
    known = [lobe for lobe in (upper, lower) if lobe.dye_phase is not None and lobe.dye_quantile is not None]
    if not known:
        return None, None
    nodes = max(lobe.dye_phase.shape[1] for lobe in known if lobe.dye_phase is not None)
    draws = max(lobe.dye_quantile.shape[1] for lobe in known if lobe.dye_quantile is not None)
    phases, quantiles = [], []
    for lobe in (upper, lower):
        if lobe.dye_phase is None or lobe.dye_quantile is None:
            count = len(lobe.wavelengths_nm)
            phases.append(np.full((lobe.strata, nodes, count), 0.25 / np.pi))
            flat = np.linspace(-1.0, 1.0, draws)[None, :, None]
            quantiles.append(np.broadcast_to(flat, (lobe.strata, draws, count)))
            continue
        phase = _resampled(lobe.dye_phase, 1, nodes)
        # normalised as the random walk reads it: linear between nodes
        total = (phase.sum(axis=1) - 0.5 * (phase[:, 0] + phase[:, -1])) * 4 * np.pi / (nodes - 1)
        phases.append(phase / np.maximum(total, 1e-300)[:, None])
        quantiles.append(_resampled(lobe.dye_quantile, 1, draws))
    return np.concatenate(phases), np.concatenate(quantiles)


BASE_NODES = 129


@dataclass(frozen=True)
class Substrate:
    """The substrate below strata: diffuse, specular, lobes of another material, further strata, or open.

    Attributes:
        kind: "none", "diffuse", "specular", "lobes" or "strata".
        albedo: for "diffuse": a number, or (wavelengths_nm, albedo).
        metal: material for "specular".
        film: a solved opaque film for "specular": (wavelengths_nm, cos, reflectance[cos, wavelength]).
        surface: roughness of a specular substrate, or of the lower interface of an open stack.
        other: for "lobes", an opaque material of any family, built with the last resin as its ambient; for "strata", a
            material whose strata and substrate continue below.
        refuse: converts the reason why `other` is unusable to an error.
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
        """The other material's lobes on its own wavelengths."""
        return self.lobes(None)

    def known_in(self, grid: Array) -> Array:
        """Return a wavelength grid clipped to the other material's range."""
        if self.other is None:
            return grid
        known = self.other.model.wavelengths_nm if self.kind == "strata" else self.default_lobes[0].wavelengths_nm
        low, high = max(float(known[0]), grid[0]), min(float(known[-1]), grid[-1])
        return np.concatenate([[low], grid[(grid > low + 1e-6) & (grid < high - 1e-6)], [high]])

    def reflectance(self, wavelengths_nm: Array, medium: Callable[[Array], ComplexArray]) -> Array:
        """Return `Layered.base_reflectance`, `[cos, wavelength]`: one row of a diffuse albedo, or R.

        Args:
            wavelengths_nm: ascending.
            medium: index of the medium above as a function of wavelength; its absorption is ignored.
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
        """The `Layered.base` value; strata count as open until `continued` adds them."""
        return "none" if self.kind == "strata" else self.kind

    def continued(self, strata: Layered) -> Layered:
        """Return the strata, followed by the other material's strata if the substrate is "strata".

        Raises:
            NacreError: the other strata are unusable below these.
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
            NacreError: it transmits, or is itself a random walk.
        """
        if self.other is None or self.kind == "strata":
            return ()
        lobes: tuple[Lobe, ...] = self.other.bsdf(wavelengths_nm).lobes
        if any(is_strata(lobe) for lobe in lobes):
            raise self.refuse(
                "contains a pearl or another walk, which cannot be a base: write its strata below these instead"
            )
        if any(lobe.transmits for lobe in lobes):
            raise self.refuse("lets light through; a base should be opaque, on a metal or with a base of its own")
        return lobes


def is_strata(lobe: Lobe) -> bool:
    """Whether a lobe, masked or not, consists of strata (a pearl, a photonic glass)."""
    inner = getattr(lobe, "inner", None)
    return lobe.kind in ("layered", "platelet-layer") or (inner is not None and is_strata(inner))
