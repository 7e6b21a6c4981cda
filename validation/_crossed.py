"""Rigorous solvers of our own for smooth reliefs periodic in x and y, under vacuum: two that share no step.

`by_coordinates` is the coordinate-transformation method for crossed gratings (Granet, Pure Appl. Opt. 4, 777 (1995)):
the surface becomes the plane u = z - h(x, y) = 0, and the waves of each side are eigenvectors of Maxwell's equations
there. `by_plane_waves` takes plane waves that leave the surface on both sides all the way to it (Rayleigh) and meets
the continuity of the tangential fields in least squares (Ikuno and Yasuura, IEEE Trans. Antennas Propag. 21, 657
(1973)): no coordinates, no eigenvalues, no series of the profile. It is for slopes up to about .45, to which Rayleigh's
assumption holds for sinusoids (Millar, Proc. Camb. Phil. Soc. 69, 217 (1971)).

Time goes as exp(-i omega t), an index is n + ik, lengths are in micrometres; the plane of incidence is that of x and z.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from validation._gratings import normal_parts

Array = NDArray[Any]


def kept(radius: float, shift: float = 0.0) -> Array:
    """The orders `[order, 2]` in a circle about (-shift, 0), which leaves along the normal, the nearest first."""
    reach = np.arange(-int(radius + abs(shift)), int(radius + abs(shift)) + 1)
    all_orders = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = np.hypot(all_orders[:, 0] + shift, all_orders[:, 1])
    rank = np.argsort(distance, kind="stable")
    return np.asarray(all_orders[rank][distance[rank] <= radius])


def _kept(radius: float, period: float, wavelength: float, angle_deg: float) -> Array:
    return kept(radius, float(np.sin(np.radians(angle_deg))) * period / wavelength)


def _lateral(orders: Array, period: float, wavelength: float, angle_deg: float) -> Array:
    return np.array([np.sin(np.radians(angle_deg)), 0.0]) + orders * wavelength / period


def _states(lateral: Array, gamma: Array, index: complex) -> tuple[Array, Array]:
    """E and H `[wave, 3]` of plane waves, s and then p of each, where the wave vector is (lateral, gamma) k0."""
    size = np.hypot(*lateral.T)
    along = np.where(size[:, None] > 1e-12, lateral / np.maximum(size, 1e-12)[:, None], [1.0, 0.0])
    wave = np.concatenate([lateral, gamma[:, None]], axis=1)
    s = np.stack([-along[:, 1], along[:, 0], np.zeros(len(size))], axis=1).astype(complex)
    p = np.cross(s, wave) / index  # unit E where nothing decays
    electric = np.concatenate([s, p])
    return electric, np.cross(np.concatenate([wave, wave]), electric)


def _incident(angle_deg: float) -> tuple[Array, Array]:
    """E and H `[state, 3]` of light of power 1 that comes down: s, p."""
    sine, cosine = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    return _states(np.array([[sine, 0.0]]), np.array([-cosine + 0j]), 1.0)


def _answer(orders: Array, lateral: Array, angle_deg: float, amplitudes: Array) -> tuple[Array, dict[str, Array]]:
    """Orders that propagate and their efficiencies, of amplitudes `[wave, incident state]`, all s before all p."""
    goes = np.hypot(*lateral.T) < 1.0
    cosine = np.sqrt(1 - np.sum(lateral[goes] ** 2, axis=1)) / np.cos(np.radians(angle_deg))
    power = np.abs(amplitudes.reshape(2, -1, 2)) ** 2
    return orders[goes], {which: (power[:, goes, k].sum(axis=0)) * cosine for k, which in enumerate("sp")}


def by_plane_waves(
    period: float, heights: Array, slopes: Array, n: complex, wavelength: float, angle_deg: float, radius: float
) -> tuple[Array, dict[str, Array]]:
    """Return the orders that propagate and, for "s" and "p", their efficiencies.

    Args:
        heights: `[x, y]` in um on an even grid of one period, at whole steps from 0.
        slopes: `[2, x, y]`, dh/dx and dh/dy.
        radius: of the circle of orders that are kept.
    """
    k0, orders = 2 * np.pi / wavelength, _kept(radius, period, wavelength, angle_deg)
    lateral = _lateral(orders, period, wavelength, angle_deg)
    square = np.sum(lateral**2, axis=1)
    up, down = normal_parts(1.0, np.sqrt(square)), -normal_parts(n, np.sqrt(square))
    x = np.arange(len(heights)) / len(heights) * period
    place = np.stack([each.ravel() for each in (*np.meshgrid(x, x, indexing="ij"), heights)])

    def on_surface(electric: Array, magnetic: Array, wave: Array) -> Array:
        """Fields along the surface `[4 point, wave]`."""
        repeats = len(electric) // len(wave)
        phase = np.tile(np.exp(1j * k0 * place.T @ wave.T), repeats)
        h_x, h_y = (each.ravel()[:, None] for each in slopes)
        parts = [f[:, axis] + h * f[:, 2] for f in (electric, magnetic) for axis, h in ((0, h_x), (1, h_y))]
        return np.concatenate([part * phase for part in parts])

    above = np.concatenate([lateral, up[:, None]], axis=1)
    below = np.concatenate([lateral, down[:, None]], axis=1)
    to = np.array([[np.sin(np.radians(angle_deg)), 0.0, -np.cos(np.radians(angle_deg))]])
    system = np.hstack([on_surface(*_states(lateral, up, 1.0), above), -on_surface(*_states(lateral, down, n), below)])
    size = np.linalg.norm(system, axis=0)
    system /= size
    # the normal equations of well-scaled columns would lose half of the digits: a triangular factor keeps them
    found = scipy.linalg.lstsq(system, -on_surface(*_incident(angle_deg), to), cond=1e-13, lapack_driver="gelsy")[0]
    amplitudes = (found / size[:, None])[: 2 * len(orders)]
    goes = np.hypot(*lateral.T) < 1.0
    return _answer(orders, lateral, angle_deg, np.where(np.tile(goes, 2)[:, None], amplitudes, 0.0))


def by_coordinates(
    period: float, heights: Array, slopes: Array, n: complex, wavelength: float, angle_deg: float, radius: float
) -> tuple[Array, dict[str, Array]]:
    """The same by the coordinate-transformation method."""
    k0, orders = 2 * np.pi / wavelength, _kept(radius, period, wavelength, angle_deg)
    lateral = _lateral(orders, period, wavelength, angle_deg)
    count = len(orders)
    difference = orders[:, None, :] - orders[None, :, :]
    h_x, h_y = (_series(each)[difference[..., 0], difference[..., 1]] for each in slopes)
    metric = np.linalg.inv(np.eye(count) + h_x @ h_x + h_y @ h_y)
    a, b, zero, one = np.diag(lateral[:, 0]), np.diag(lateral[:, 1]), np.zeros((count, count)), np.eye(count)

    def leaving(index: complex, sign: int) -> Array:
        """Fields (E_x, E_y, H_x, H_y) along the surface `[4 order, wave]` that leave it, slowest decay first."""
        epsilon = index**2
        # the components along u, as rows over the four others
        e_u = metric @ np.hstack([h_x, h_y, b / epsilon, -a / epsilon])
        h_u = metric @ np.hstack([-b, a, h_x, h_y])
        rows = [
            a @ e_u - h_y @ h_u + np.hstack([zero, zero, zero, one]),
            b @ e_u + h_x @ h_u - np.hstack([zero, zero, one, zero]),
            a @ h_u + epsilon * h_y @ e_u - epsilon * np.hstack([zero, one, zero, zero]),
            b @ h_u - epsilon * h_x @ e_u + epsilon * np.hstack([one, zero, zero, zero]),
        ]
        values, vectors = scipy.linalg.eig(np.vstack(rows), overwrite_a=True, check_finite=False)
        is_real = np.abs(values.imag) < 1e-7 * np.maximum(1.0, np.abs(values.real))
        leaves = np.where(is_real, sign * values.real > 0, sign * values.imag > 0)
        chosen = np.argsort(np.where(leaves, np.abs(values.imag), np.inf), kind="stable")[: 2 * count]
        return np.asarray(vectors[:, chosen])

    def plane(electric: Array, magnetic: Array, numbers: Array, gamma: Array) -> Array:
        """Plane waves in the coordinates that follow the surface, `[4 order, wave]`."""
        columns = []
        for e, h, number, normal in zip(electric, magnetic, numbers, gamma):
            phase = np.exp(1j * k0 * normal * heights)
            parts = [f[axis] + slopes[axis] * f[2] for f in (e, h) for axis in (0, 1)]
            rank = orders - number
            columns.append(np.concatenate([_series(part * phase)[rank[:, 0], rank[:, 1]] for part in parts]))
        return np.stack(columns, axis=1)

    goes = np.flatnonzero(np.hypot(*lateral.T) < 1.0)
    gamma = normal_parts(1.0, np.sqrt(np.sum(lateral[goes] ** 2, axis=1)))
    waves = plane(*_states(lateral[goes], gamma, 1.0), np.tile(orders[goes], (2, 1)), np.tile(gamma, 2))
    cosine = np.full(2, -np.cos(np.radians(angle_deg)))
    incident = plane(*_incident(angle_deg), np.zeros((2, 2), dtype=int), cosine)
    system = np.hstack([waves, leaving(1.0, 1)[:, 2 * len(goes) :], -leaving(n, -1)])
    found = np.linalg.solve(system, -incident)
    amplitudes = np.zeros((2, count, 2), dtype=complex)
    amplitudes[:, goes] = found[: 2 * len(goes)].reshape(2, len(goes), 2)
    return _answer(orders, lateral, angle_deg, amplitudes.reshape(2 * count, 2))


def _series(samples: Array) -> Array:
    """Fourier coefficients over a period in x and y."""
    return np.asarray(np.fft.fft2(samples) / samples.size)
