"""Stacks with layers too thick to interfere with themselves: a window pane, a plastic foil.

Between two incoherent layers stands a coherent group (one bare interface at least). Light inside an incoherent
layer is followed as intensity only: with reflectance R, R' of a group from above and from below, transmittance T, T'
and the intensity P = exp(-2 Im x) that one passage leaves,

    R_total = R + T T' P^2 R_next / (1 - R' P^2 R_next),  T_total = T P T_next / (1 - R' P^2 R_next),

from the bottom upward (Katsidis & Siapkas 2002 and Byrnes, arXiv 1603.02720, section 9, give the same sums).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.errors import NacreError
from nacre.matter.stratified import Powers, kernel_powers, normal_component, prepare

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


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
    """R and T of a stack some of whose layers are incoherent.

    Args:
        n, thicknesses_nm, wavelengths_nm, theta_rad, cos_i, kappa, jobs: as in `nacre.matter.stratified.powers`,
            batches included.
        incoherent: `[layer]`, which layers do not interfere.

    R + T + A = 1 is exact where the incoherent layers absorb over their thickness but little over a wavelength
    (k << n), the only case in which intensities add.

    Raises:
        NacreError: as `solve`, or flags that do not fit the layers.
    """
    case = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa)
    layers = case.n.shape[1] - 2
    if len(incoherent) != layers:
        raise NacreError(f"incoherent must hold one flag for each of the {layers} layers, not {len(incoherent)}")
    n02 = case.n[:, 0][:, None, :] ** 2
    kz0sq = (case.normal * case.n[:, :1] if case.times_n0 else case.normal) ** 2  # [batch or 1, angle, wavelength]
    thick = [j + 1 for j in range(layers) if incoherent[j]]
    edges = [0, *thick, layers + 1]

    total_r: Real | None = None
    total_t: Real | None = None
    # from the substrate upward: the group between two incoherent media, then the passage through the upper one
    for top, bottom in reversed(list(zip(edges[:-1], edges[1:]))):
        media = case.n[:, top : bottom + 1]
        d = case.thicknesses_nm[:, top : bottom - 1]
        down_r, down_t = kernel_powers(case, media, d, normal_component(case.n[:, top, None, :] ** 2, n02, kz0sq), jobs)
        if total_r is None or total_t is None:
            total_r, total_t = down_r, down_t
            continue
        back_normal = normal_component(case.n[:, bottom, None, :] ** 2, n02, kz0sq)
        up_r, up_t = kernel_powers(case, media[:, ::-1], d[:, ::-1], back_normal, jobs)
        thickness = case.thicknesses_nm[:, bottom - 1][:, None, None]
        passage = np.exp(-4 * np.pi * back_normal.imag * thickness / case.wavelengths_nm)
        bounce = up_r * passage**2 * total_r
        # 1 - bounce vanishes only for light that is trapped for good, and none of that gets in: down_t is 0 there
        gain = np.where(down_t > 0, down_t / np.where(bounce < 1, 1 - bounce, 1.0), 0.0)
        total_r, total_t = down_r + gain * up_t * passage**2 * total_r, gain * passage * total_t
    assert total_r is not None and total_t is not None  # the loop runs at least once
    shape = (*case.batch, *case.angle_shape, case.shape[2])
    return Powers(*(part.reshape(shape) for part in (*total_r, *total_t)))
