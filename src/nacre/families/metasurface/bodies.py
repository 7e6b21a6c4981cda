"""Particles that are no spheres, put over a stack: their height, how far they are settled, what is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.errors import UnsupportedError
from nacre.families.metasurface.axial import Body, truncated
from nacre.families.metasurface.monolayer import Particle
from nacre.families.metasurface.near_stack import LOWER_CUT, cut_of
from nacre.families.metasurface.sphere import AZIMUTHAL_ORDERS, SphereOnStack, amplitude
from nacre.families.metasurface.substrate import Substrate

PROBED_LIGHT, PROBED_VIEWS = np.radians([0.0, 30.0, 60.0, 80.0]), np.radians(np.arange(5.0, 90.0, 12.0))
GAP_STEPS = 16
TOUCHES = 1e-9  # relative


@dataclass(frozen=True)
class Placed:
    """A particle over a stack at one wavelength, and how much its far field is still in motion.

    Attributes:
        particle: as the monolayer takes it.
        change: relative L2 of the far field: by the highest multipoles, or between two cuts near the stack.
        is_near: whether its circumscribing sphere cuts the stack.
    """

    particle: Particle
    change: float
    is_near: bool


def place(body: Body, surface: Substrate, gap_nm: float, order: int | None = None) -> Placed:
    """Return the particle with the multipoles up to `order`, or all that are known.

    Raises:
        UnsupportedError: the order is not known.
        MaterialRangeError: the wavelength is not.
    """
    if order is not None:
        body.check_order(order)
    t = body.t_matrix(surface.wavelength_nm)
    t = t if order is None else truncated(t, order)
    particle = Particle(1.0, body.height_nm / 2 + gap_nm, t)
    if surface.is_absent or particle.centre_nm >= body.circumscribing_nm * (1 - TOUCHES):
        return Placed(particle, _truncation(surface, particle), False)
    near = replace(particle, cut=cut_of(particle.lmax, surface.wavenumber, body.circumscribing_nm))
    less = replace(particle, cut=cut_of(particle.lmax, surface.wavenumber, body.circumscribing_nm, LOWER_CUT))
    return Placed(near, _difference(_pattern(surface, less), _pattern(surface, near)), True)


def least_gap(
    body: Body, surface: Substrate, gap_nm: float, tolerance: float, order: int | None = None
) -> float | None:
    """Return the least gap, in whole steps to where the circumscribing sphere is clear, that settles; or None."""
    clear = body.circumscribing_nm - body.height_nm / 2
    for gap in np.linspace(gap_nm, max(clear, gap_nm), GAP_STEPS + 1)[1:]:
        rounded = float(np.ceil(10 * gap) / 10)
        if place(body, surface, rounded, order).change <= tolerance:
            return rounded
    return None


def refuse(
    body: Body,
    surface: Substrate,
    gap_nm: float,
    placed: Placed,
    tolerance: float,
    order: int | None,
    key: str = "particle",
) -> UnsupportedError:
    """Return the line that refuses a particle whose far field is not settled, with what to do.

    Args:
        key: of the recipe's table of these particles.
    """
    if not placed.is_near:
        further = f"a larger {key}.gap_nm" if surface.inner_nm == 0.0 else "more room to the faces of the layer"
        return UnsupportedError(
            f"{body.source}: at {surface.wavelength_nm:g} nm its multipoles up to l = {placed.particle.lmax} do not "
            f"settle over this stack (the far field still changes by {placed.change:.2g}, {tolerance:g} is allowed); "
            f"a T-matrix of higher order or {further} is needed"
        )
    gap = least_gap(body, surface, gap_nm, tolerance, order)
    advice = f"the least {key}.gap_nm that works is {gap:g}" if gap is not None else "no gap_nm mends it"
    return UnsupportedError(
        f"{body.source}: at {surface.wavelength_nm:g} nm it lies too close to the stack for multipoles up to l = "
        f"{placed.particle.lmax}: two cuts of the coupling differ by {placed.change:.2g}, {tolerance:g} is allowed; "
        f"{advice}"
    )


def _truncation(surface: Substrate, particle: Particle) -> float:
    """Estimate what the multipoles that are left out change: the last step, falling on as the two last ones do."""
    top = particle.lmax
    if top == 1:
        return 0.0  # a dipole tells nothing of the next order; whoever gives one means a dipole
    patterns = [
        _pattern(surface, replace(particle, t_matrix=truncated(particle.t_matrix, l)))
        for l in range(max(1, top - 2), top + 1)
    ]
    last = _difference(patterns[-2], patterns[-1])
    if len(patterns) < 3:
        return last
    before = _difference(patterns[-3], patterns[-2])
    return last * min(1.0, last / before) if before > 0 else last


def _pattern(surface: Substrate, particle: Particle) -> Array:
    """d sigma/d Omega at a few directions, `[pol_s, s, pol_i, i, phi]`."""
    alone = SphereOnStack(
        surface, particle.centre_nm, particle.t_matrix, min(AZIMUTHAL_ORDERS, particle.lmax), particle.cut
    )
    fields: ComplexArray = amplitude(
        alone.harmonics(alone.directions(np.cos(PROBED_VIEWS)), alone.directions(np.cos(PROBED_LIGHT))),
        np.linspace(0.0, np.pi, 9),
    )
    return np.asarray(np.abs(fields) ** 2)


def _difference(of: Array, to: Array) -> float:
    """The largest relative L2 difference over the incidences."""
    axes = (0, 1, 4)
    return float(np.max(np.sqrt(np.sum((of - to) ** 2, axis=axes) / np.maximum(np.sum(to**2, axis=axes), 1e-300))))
