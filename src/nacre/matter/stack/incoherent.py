"""Stacks with incoherent layers, too thick for interference: a window pane, a plastic foil.

Coherent groups (at least one bare interface) separate the incoherent layers, in which only intensities propagate. With
reflectance R, R' of a group from above and from below, transmittance T, T' and the intensity P = exp(-2 Im x) after
one passage,

    R_total = R + T T' P^2 R_next / (1 - R' P^2 R_next),  T_total = T P T_next / (1 - R' P^2 R_next),

from the bottom upward (Katsidis & Siapkas 2002; Byrnes, arXiv 1603.02720, section 9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack.inputs import Powers, StackArrays, kernel_powers, normal_component, part_of, prepare, run_kernel

EXCESS = 0.02  # excess of R + T over 1 beyond which intensities do not add


@dataclass(frozen=True)
class _Group:
    """A coherent group between two thick media; powers are `[s or p, batch, angle, wavelength]`.

    Attributes:
        down, up: the group as a stack, lit from above and from below (unset for the lowest group).
        down_r, down_t, up_r, up_t: its powers.
        passage: intensity after one passage through the thick medium above (1 in the ambient).
        first: index of its upper medium; its layers are first .. first + count - 1 (from 0).
    """

    down: StackArrays
    up: StackArrays | None
    down_r: Array
    down_t: Array
    up_r: Array
    up_t: Array
    passage: Array
    first: int


def incoherent_powers(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    incoherent: Sequence[bool],
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    kappa: ArrayLike | None = None,
    jobs: int | None = None,
) -> Powers:
    """Return R and T of a stack with incoherent layers.

    Args:
        n, thicknesses_nm, wavelengths_nm, theta_rad, cos_i, kappa, jobs: as in `nacre.matter.stack.solve.powers`,
            including batches.
        incoherent: `[layer]`, flags.

    R + T + A = 1 is exact if the incoherent layers absorb little over a wavelength (k << n), the condition under which
    intensities add.

    Raises:
        NacreError: as `solve`; a wrong number of flags; a layer outside that condition, with R + T > 1.
    """
    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa)
    groups = _groups(stack, incoherent, jobs)
    totals = _reflected(groups)
    total_r, total_t = totals[0], groups[-1].down_t
    for group, below, reflected in zip(groups[:-1], groups[1:], totals[1:]):
        total_t = total_t * _gain(group, below, reflected) * below.passage
    if float(np.max(total_r + total_t)) > 1.0 + EXCESS:
        raise NacreError(
            "an incoherent layer absorbs too much over a wavelength for intensities to add (R + T = "
            f"{float(np.max(total_r + total_t)):.4g}): set incoherent = false for thin metals"
        )
    shape = (*stack.batch, *stack.angle_shape, stack.shape[2])
    return Powers(*(part.reshape(shape) for part in (*total_r, *total_t)))


def incoherent_coherence(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    incoherent: Sequence[bool],
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike,
) -> ComplexArray:
    """Return the mean of r_p r_s* over the phases of the incoherent layers, `[..., angle, wavelength]`.

    The reflections that differ in the passages through an incoherent layer add without interference, but each keeps the
    phase between p and s; with the mean X of the stack below a group and the products of its amplitudes (r from above,
    r' from below, t t' through it),

        X_total = r_p r_s* + (t t')_p (t t')_s* P^2 X / (1 - r'_p r'_s* P^2 X).

    Arguments and errors as in `incoherent_powers`.
    """
    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad)
    groups = _groups(stack, incoherent, None)
    total: ComplexArray | None = None
    passage: Array = np.ones(1)
    for group in reversed(groups):
        r_s, r_p, t_s, t_p = run_kernel(group.down, True, False, None)[0]
        coherence = r_p * r_s.conj()
        if total is not None:
            assert group.up is not None
            up_s, up_p, back_s, back_p = run_kernel(group.up, True, False, None)[0]
            below = passage**2 * total
            coherence = coherence + t_p * back_p * (t_s * back_s).conj() * below / (1.0 - up_p * up_s.conj() * below)
        total, passage = coherence, group.passage
    assert total is not None
    return np.asarray(total.reshape(*stack.batch, *stack.angle_shape, stack.shape[2]))


def incoherent_absorption(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    incoherent: Sequence[bool],
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike,
    *,
    jobs: int | None = None,
) -> Array:
    """Return each layer's absorbed power over incident power, `[s or p, layer, ..., angle, wavelength]`.

    Arguments, errors and the limit k << n as in `incoherent_powers`. A thick layer absorbs the net flux difference
    between its interfaces; a thin one absorbs its share of the light incident on its group from above and from below.
    """
    from nacre.matter.stack.field import absorbed_power

    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad)
    groups = _groups(stack, incoherent, jobs)
    totals = _reflected(groups)
    absorbed = np.zeros((2, stack.n.shape[1] - 2, *stack.shape))
    arriving: Array = np.ones((2, *stack.shape))  # on the group from above
    for i, group in enumerate(groups):
        count = group.down.n.shape[1] - 2
        own = slice(group.first, group.first + count)
        if count:
            absorbed[:, own] += absorbed_power(group.down, jobs).reshape(2, count, *stack.shape) * arriving[:, None]
        if group.up is None:
            break
        below, total = groups[i + 1], totals[i + 1]
        leaving = arriving * _gain(group, below, total)  # light entering the thick medium below the group
        returning = below.passage**2 * total * leaving
        if count:
            from_below = absorbed_power(group.up, jobs).reshape(2, count, *stack.shape)[:, ::-1]
            absorbed[:, own] += from_below * returning[:, None]
        arriving = below.passage * leaving
        absorbed[:, group.first + count] = leaving - returning - arriving * (1.0 - total)
    return absorbed.reshape(2, -1, *stack.batch, *stack.angle_shape, stack.shape[2])


def _reflected(groups: list[_Group]) -> list[Array]:
    """Return each group's reflectance including the stack below it, from the top downward."""
    totals = [groups[-1].down_r]
    for group, below in zip(groups[-2::-1], groups[:0:-1]):
        echoes = _gain(group, below, totals[0]) * group.up_t * below.passage**2 * totals[0]
        totals.insert(0, group.down_r + echoes)
    return totals


def _gain(group: _Group, below: _Group, total_r: Array) -> Array:
    """Return the downward light below a group over the light incident on it, with all reflections."""
    bounce = group.up_r * below.passage**2 * total_r
    # 1 - bounce vanishes only for trapped light, which cannot enter: down_t is 0
    return np.where(group.down_t > 0, group.down_t / np.where(bounce < 1, 1 - bounce, 1.0), 0.0)


def _groups(stack: StackArrays, incoherent: Sequence[bool], jobs: int | None) -> list[_Group]:
    """Return the coherent groups from the top downward."""
    layers = stack.n.shape[1] - 2
    if len(incoherent) != layers:
        raise NacreError(f"incoherent must hold one flag for each of the {layers} layers, not {len(incoherent)}")
    n02 = stack.n[:, 0][:, None, :] ** 2
    kz0sq = (stack.normal * stack.n[:, :1] if stack.times_n0 else stack.normal) ** 2  # [batch or 1, angle, wavelength]
    edges = [0, *(j + 1 for j in range(layers) if incoherent[j]), layers + 1]
    groups = []
    for top, bottom in zip(edges[:-1], edges[1:]):
        media, d = stack.n[:, top : bottom + 1], stack.thicknesses_nm[:, top : bottom - 1]
        normal = normal_component(stack.n[:, top, None, :] ** 2, n02, kz0sq)
        thickness = 0.0 if top == 0 else stack.thicknesses_nm[:, top - 1][:, None, None]
        passage = np.exp(-4 * np.pi * normal.imag * thickness / stack.wavelengths_nm)
        down = part_of(stack, media, d, normal)
        down_r, down_t = kernel_powers(down, jobs)
        up, up_r, up_t = None, down_r, down_t
        if bottom <= layers:
            back = normal_component(stack.n[:, bottom, None, :] ** 2, n02, kz0sq)
            up = part_of(stack, media[:, ::-1], d[:, ::-1], back)
            up_r, up_t = kernel_powers(up, jobs)
        groups.append(_Group(down, up, down_r, down_t, up_r, up_t, passage, top))
    return groups
