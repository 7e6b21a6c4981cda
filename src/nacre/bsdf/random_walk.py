# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
# mypy: disable-error-code="no-untyped-def"
"""Compiled random-walk steps through a stratum: rough interface, flight, platelet, diffuse base, phase function.

All wavelengths share one path. Each event is drawn with probabilities averaged over the throughputs `f[wavelength]`;
these are then weighted by the event's spectrum and rescaled to an unchanged sum. Downward flights have dz < 0.
The device versions are in `nacre.device.walk`.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.lobes.platelet_layer import masking, reflected
from nacre.core.jit import compiled

MAX_EVENTS = 20_000
ABSORBED, REFLECTED, TRANSMITTED = 0, 1, 2
FAINT_WEIGHT = 1e-3  # single-wavelength paths survive with probability 1/2 below this weight
# additive recurrence with the root from x^8 = x + 1: a rank-1 lattice with any length
_ROOT = 1.0969815577985598
LATTICE = np.array([_ROOT ** -(j + 1) % 1.0 for j in range(7)])


@compiled(nogil=True)
def lattice_point(number, shift, u):
    """Write a point on the shifted lattice."""
    for j in range(u.size):
        at = (number + 0.5) * LATTICE[j] + shift[j]
        u[j] = at - math.floor(at)


@compiled(nogil=True)
def sample_facet(x, y, z, alpha, u1, u2):
    """Draw a GGX facet visible from a direction (z > 0); the normal itself if the interface is smooth."""
    if alpha <= 0.0:
        return 0.0, 0.0, 1.0
    hx, hy, hz = alpha * x, alpha * y, z
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    c = (1.0 - u2) * (1.0 + hz) - hz
    s = math.sqrt(max(0.0, 1.0 - c * c))
    phi = 2.0 * math.pi * u1
    mx, my, mz = alpha * (hx + s * math.cos(phi)), alpha * (hy + s * math.sin(phi)), max(hz + c, 1e-9)
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@compiled(nogil=True)
def refract(x, y, z, eta, alpha, u1, u2):
    """Refract light from a direction (z > 0) through a facet: its flight beyond (z < 0) and the transmitted share."""
    mx, my, mz = sample_facet(x, y, z, alpha, u1, u2)
    cos = x * mx + y * my + z * mz
    share, cos_t = reflected(min(cos, 1.0), eta)
    if share >= 1.0:
        return 0.0, 0.0, -1.0, 0.0
    a = cos / eta - cos_t
    wx, wy, wz = a * mx - x / eta, a * my - y / eta, a * mz - z / eta
    if wz >= -1e-6:
        return 0.0, 0.0, -1.0, 0.0
    passed = 1.0 - share
    if alpha > 0.0:
        passed *= masking(-wz, alpha)
    return wx, wy, wz, passed


@compiled(nogil=True)
def sample_inner_facet(dx, dy, dz, index, alpha):
    """Draw the facet met by a flight from inside, dz > 0: m, the cosine on it, the reflected share, the cosine outside.

    The facet is mirrored in the interface, so that the inside lies above it.
    """
    mx, my, mz = sample_facet(-dx, -dy, dz, alpha, np.random.random(), np.random.random())
    cos = -dx * mx - dy * my + dz * mz
    share, cos_t = reflected(min(cos, 1.0), 1.0 / index)
    return mx, my, mz, cos, share, cos_t


@compiled(nogil=True)
def reflect_inside(dx, dy, dz, mx, my, mz, cos, share, alpha):
    """Reflect a flight at the facet from `sample_inner_facet`: its direction down; z = 0 if it leaves or is masked."""
    if np.random.random() >= share:
        return 0.0, 0.0, 0.0
    ex, ey, ez = 2.0 * cos * mx + dx, 2.0 * cos * my + dy, 2.0 * cos * mz - dz
    if ez <= 1e-6 or (alpha > 0.0 and np.random.random() >= masking(ez, alpha)):
        return 0.0, 0.0, 0.0
    return ex, ey, -ez


@compiled(nogil=True)
def sample_diffuse():
    """Draw a diffuse flight from the base."""
    z = math.sqrt(max(np.random.random(), 1e-12))
    phi = 2.0 * math.pi * np.random.random()
    side = math.sqrt(1.0 - z * z)
    return side * math.cos(phi), side * math.sin(phi), z


@compiled(nogil=True)
def sample_normal(x, y, z, sigma, u1, u2):
    """Draw a platelet normal visible from a direction."""
    hx, hy, hz = sigma * x, sigma * y, z
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    c = 2.0 * u2 - 1.0
    s = math.sqrt(max(0.0, 1.0 - c * c))
    phi = 2.0 * math.pi * u1
    grown = (1.0 + 1e-9) / length
    mx, my, mz = sigma * (hx * grown + s * math.cos(phi)), sigma * (hy * grown + s * math.sin(phi)), hz * grown + c
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@compiled(nogil=True)
def projected_area(z, sigma):
    """Return the projected platelet area along a cosine, relative to lying flat."""
    return math.sqrt(sigma * sigma * (1.0 - z * z) + z * z)


@compiled(nogil=True)
def normal_density(hx, hy, hz, sigma):
    """Return the SGGX normal density, per steradian on the full sphere."""
    s2 = sigma * sigma
    q = (hx * hx + hy * hy) / s2 + hz * hz
    return 1.0 / (math.pi * s2 * q * q)


@compiled(nogil=True, fastmath=True)
def interpolate_row(table, position, out):
    """Interpolate a table's rows at a position in rows."""
    i = min(int(position), table.shape[0] - 2)
    f = np.float32(position - i)
    for l in range(out.size):
        out[l] = table[i, l] + f * (table[i + 1, l] - table[i, l])


@compiled(nogil=True, fastmath=True)
def attenuate(f, absorb, path):
    """Attenuate the throughputs by the resin, with optical thickness `absorb` along the normal."""
    for l in range(f.size):
        f[l] *= math.exp(-absorb[l] * path)


@compiled(nogil=True)
def collision_rates(x, y, z, number, sigma, areas):
    """Write the platelets met per kind along a direction, per unit depth times |z|; return their sum."""
    total = 0.0
    for k in range(number.size):
        areas[k] = number[k] * math.sqrt(sigma[k] * sigma[k] * (x * x + y * y) + z * z)
        total += areas[k]
    return total


@compiled(nogil=True)
def choose_kind(areas, total):
    """Draw the next platelet's kind."""
    k = 0
    if areas.size > 1:
        left = np.random.random() * total - areas[0]
        while left >= 0.0 and k < areas.size - 1:
            k += 1
            left -= areas[k]
    return k


@compiled(nogil=True, fastmath=True)
def weight(f, share):
    """Multiply the throughputs by shares; return their sums before and after."""
    before, after = np.float32(0.0), np.float32(0.0)
    for l in range(f.size):
        before += f[l]
        f[l] *= share[l]
        after += f[l]
    return before, after


@compiled(nogil=True, fastmath=True)
def survives(f, before, after):
    """End the path by chance, or rescale its throughputs from the sum `after` to the sum `before`."""
    if np.random.random() * before >= after:
        return False
    for l in range(f.size):
        f[l] *= before / after
    return True


@compiled(nogil=True, fastmath=True)
def share_light(f, r, t):
    """Reflect, transmit or absorb the path by chance, with reflectances `r` and transmittances `t`.

    Returns:
        the event, and the summed throughputs that arrive, are reflected and transmitted.
    """
    carried, back, on = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for l in range(f.size):
        carried += f[l]
        back += f[l] * r[l]
        on += f[l] * t[l]
    choice = np.random.random() * carried
    if choice < back:
        scale = carried / back
        for l in range(f.size):
            f[l] *= r[l] * scale
        return REFLECTED, carried, back, on
    if choice < back + on:
        scale = carried / on
        for l in range(f.size):
            f[l] *= t[l] * scale
        return TRANSMITTED, carried, back, on
    return ABSORBED, carried, back, on


@compiled(nogil=True, fastmath=True)
def scatter(dx, dy, dz, sigma, reflect, transmit, f, r, t):
    """Scatter at a platelet; return the event and the new direction.

    Args:
        reflect, transmit: `[cos, wavelength]`, float32, on sqrt(cos) nodes.
        r, t: `[wavelength]`, float32, scratch.
    """
    mx, my, mz = sample_normal(-dx, -dy, -dz, sigma, np.random.random(), np.random.random())
    cos = -(dx * mx + dy * my + dz * mz)
    at = math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[0] - 1)
    interpolate_row(reflect, at, r)
    interpolate_row(transmit, at, t)
    event, _, _, _ = share_light(f, r, t)
    if event == REFLECTED:
        dx, dy, dz = dx + 2.0 * cos * mx, dy + 2.0 * cos * my, dz + 2.0 * cos * mz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        if abs(dz) < 1e-9:
            dz = 1e-9
    return event, dx, dy, dz


@compiled(nogil=True, fastmath=True)
def fly(depth, dz, total, absorb, f):
    """Draw a free flight and attenuate the throughputs on the way; return the depth, beyond [0, 1] at an interface."""
    flight = -math.log(1.0 - np.random.random()) / max(total, 1e-12)
    reached = depth - dz * flight
    if absorb.size:
        attenuate(f, absorb, abs(min(max(reached, 0.0), 1.0) - depth) / max(abs(dz), 1e-6))
    return reached


@compiled(nogil=True, fastmath=True)
def sample_quantile(quantiles):
    """Draw a number from its quantiles at uniform nodes, such as a phase function's cosine."""
    at = np.random.random() * (quantiles.size - 1)
    low = min(int(at), quantiles.size - 2)
    return quantiles[low] + (at - low) * (quantiles[low + 1] - quantiles[low])


@compiled(nogil=True, fastmath=True)
def roulette(carried):
    """Return a single-wavelength path's weight: doubled or zero by chance if it is faint."""
    if carried < FAINT_WEIGHT:
        return 0.0 if np.random.random() < 0.5 else 2.0 * carried
    return carried
