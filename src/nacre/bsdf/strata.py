"""Strata on strata: the walks of two materials, of whatever families, as one.

Depths are counted in units of each stratum and indices in those of the ambient, so lists are put one below the other;
tables that the two hold on different nodes are carried over to the finer ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf.interface_loss import interface_losses
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.roughness import Roughness
from nacre.errors import UnsupportedError


def join_strata(upper: Layered, lower: Layered) -> Layered:
    """Lay strata on others: the face between is the lower ones' own upper face.

    Args:
        upper: whatever lies below it is taken away.
        lower: on the same wavelengths; with its base.

    Raises:
        UnsupportedError: the lower ones hold flakes that are seen one by one.
    """
    if lower.glint_numbers is not None:
        raise UnsupportedError("has glints; only flakes of the uppermost stratum are seen one by one: leave them out")
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
    """Return the faces as they were asked for: a loss is known only of what is compensated."""
    flags: list[bool] = []
    for lobe in (upper, lower):
        known = np.zeros(lobe.strata + 1, dtype=bool) if lobe.loss is None else np.any(lobe.loss > 0, axis=(1, 2))
        flags.extend(bool(flag) for flag in (known[:-1] if lobe is upper else known))
    return [
        Roughness("beckmann" if beckmann[i] else "ggx", float(alpha[i, 0]), float(alpha[i, 1]), compensate=flag)
        for i, flag in enumerate(flags)
    ]


def _joined(first: Array, second: Array, axes: tuple[int, ...]) -> Array:
    """Put tables of kinds one below the other, on the finer nodes of both."""
    if not len(first) or not len(second):
        return second if not len(first) else first
    for axis in axes:
        most = max(first.shape[axis], second.shape[axis])
        first, second = _resampled(first, axis, most), _resampled(second, axis, most)
    return np.concatenate([first, second])


def _resampled(table: Array, axis: int, count: int) -> Array:
    """Carry an axis of uniform nodes over to more of them."""
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
    """Return phase functions and quantiles of all strata; isotropic ones, never used, where nothing scatters."""
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
        # as the walk reads it: linear between nodes, of integral one
        total = (phase.sum(axis=1) - 0.5 * (phase[:, 0] + phase[:, -1])) * 4 * np.pi / (nodes - 1)
        phases.append(phase / np.maximum(total, 1e-300)[:, None])
        quantiles.append(_resampled(lobe.dye_quantile, 1, draws))
    return np.concatenate(phases), np.concatenate(quantiles)
