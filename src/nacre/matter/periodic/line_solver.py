"""Orders of structures of one period: lamellar layers and continuous profiles."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.lamellar_modes import LineModes, layer_modes, line_modes
from nacre.matter.periodic.lamellar_solver import flat_orders, is_patterned, values_at
from nacre.matter.periodic.line_basis import (
    LineBasis,
    LineMesh,
    assemble,
    gauss_values,
    line_basis,
    line_mesh,
    regions,
)
from nacre.matter.periodic.line_elements import axial
from nacre.matter.periodic.profile_coordinates import (
    Ports,
    aligned,
    lossless_amplitudes,
    operators,
    profile_modes,
    scatter_profile,
    state,
)
from nacre.matter.periodic.scattering_matrix import Modes, respond, scatter, uniform_modes
from nacre.matter.periodic.structure import (
    OrderSet,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Profile,
    Rectangle,
    check_unknowns,
    empty_orders,
    incident_wave,
    order_set,
    propagating,
    transverse_axes,
)
from nacre.matter.periodic.types import Array

GRADING = 0.18
SINGULAR = 1e-6  # modes with smaller kappa^2 are parallel to others in conical light, by its inverse


def solve_lines(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, level: int) -> OrderSolution:
    """Return the orders of lamellar layers by the piecewise-polynomial modal method."""
    transverse, k_z, incident = incident_wave(stack, theta_rad, phi_rad)
    if not any(is_patterned(layer) for layer in stack.layers):
        return flat_orders(stack, k0, theta_rad, phi_rad)
    basis, layers = _basis_and_layers(stack, k0, transverse, level)
    alpha = basis.alpha
    beta = np.full_like(alpha, transverse[1])
    size = len(alpha)
    zero = int(np.flatnonzero(basis.numbers[: basis.resolved] == 0)[0])
    wave = np.zeros((2 * size, 2), dtype=complex)
    wave[zero], wave[size + zero] = incident
    up, down = scatter(
        uniform_modes(stack.cover**2, alpha, beta),
        layers,
        [layer.thickness_nm * k0 for layer in stack.layers],
        uniform_modes(stack.substrate**2, alpha, beta),
        wave,
    )
    places = {int(m): k for k, m in enumerate(basis.numbers[: basis.resolved])}

    def side(amplitudes: Array, index: float, is_up: bool) -> OrderSet:
        numbers, waves = propagating(stack, k0, transverse, index)
        at = np.array([places[int(m)] for m in numbers[:, 0]], dtype=int)
        fields = np.stack([amplitudes[at], amplitudes[size + at]], axis=1)
        return order_set(numbers, waves, fields, index, is_up, (phi_rad, k_z))

    reflected = side(up, stack.cover, True)
    transmitted = side(down, stack.substrate.real, False) if stack.is_clear else empty_orders()
    return OrderSolution(reflected, transmitted, np.inf, size, "lines")


def _basis_and_layers(
    stack: PeriodicStack, k0: float, transverse: Array, level: int, reach: float = 0.0
) -> tuple[LineBasis, list[Modes]]:  # fmt: skip
    """Return the functions, and the modes of each layer in them; orders to `reach` are plane waves."""
    mesh = _mesh_of(stack, [layer for layer in stack.layers if is_patterned(layer)], k0, level)
    check_unknowns(2 * mesh.size, k0)
    basis = line_basis(mesh, transverse[0], max(1.001 * stack.reach, reach))
    alpha = basis.alpha
    beta = np.full_like(alpha, transverse[1])
    solved: dict[PatternLayer, Modes] = {}
    layers = []
    for layer in stack.layers:
        key = PatternLayer(0.0, layer.epsilon, layer.shapes)
        if key not in solved:
            solved[key] = (
                layer_modes(_line_modes(basis, _element_values(basis, layer, k0), transverse[1]), transverse[1])
                if is_patterned(layer)
                else uniform_modes(layer.epsilon, alpha, beta)
            )
        layers.append(solved[key])
    return basis, layers


def _line_modes(basis: LineBasis, values: Array, k_y: float) -> LineModes:
    """Return the modes of a layer; where conical light would lose digits, with a slightly larger permittivity."""
    matrices = basis.permittivity(values)
    modes = line_modes(basis.alpha, *matrices)
    if k_y and min(np.abs(modes.lse_squared).min(), np.abs(modes.lsm_squared).min()) < SINGULAR:
        modes = line_modes(basis.alpha, *((1.0 + 2.0 * SINGULAR) * matrix for matrix in matrices))
    return modes


def line_response(
    stack: PeriodicStack, k0: float, transverse: Array, level: int, upper: Array, lower: Array
) -> Array:  # fmt: skip
    """Return the response of `order_responses` of lines."""
    numbers = upper[:, 0], lower[:, 0]
    waves = transverse[0] + np.concatenate(numbers) * (2.0 * np.pi / (k0 * stack.cell.period_x))
    basis, layers = _basis_and_layers(stack, k0, transverse, level, 1.001 * float(np.abs(waves).max()))
    size, beta = len(basis.alpha), np.full_like(basis.alpha, transverse[1])
    places = {int(m): k for k, m in enumerate(basis.numbers[: basis.resolved])}
    channels = [np.array([places[int(m)] for m in side], dtype=int) for side in numbers]
    indices = stack.cover, stack.substrate.real
    outside = [
        uniform_modes(index**2, basis.alpha, beta, channels=(at, real))
        for index, at, real in zip((stack.cover, stack.substrate), channels, indices, strict=True)
    ]
    one = np.eye(2 * size, dtype=complex)
    drives = [one[:, np.concatenate([at, size + at])] for at in channels]
    depths = [layer.thickness_nm * k0 for layer in stack.layers]
    return respond(outside[0], layers, depths, outside[1], (drives[0], drives[1]), indices)


def _mesh_of(stack: PeriodicStack, patterned: list[PatternLayer], k0: float, level: int) -> LineMesh:
    """Return the mesh for the walls of all layers; each region uses its largest index."""
    period = stack.cell.period_x
    lines = [shape for layer in patterned for shape, _ in layer.shapes if isinstance(shape, Rectangle)]
    starts, middles = regions(period, np.array([x for line in lines for x in (line.x_0, line.x_1)]))
    numbers = np.full(len(starts), stack.reach)
    for layer in patterned:
        numbers = np.maximum(numbers, np.sqrt(values_at(layer, middles, period).astype(complex)).real)
    return line_mesh(period * k0, starts * k0, numbers, level)


def _element_values(basis: LineBasis, layer: PatternLayer, k0: float) -> Array:
    values = values_at(layer, basis.mesh.centers / k0, basis.mesh.period / k0)
    return values.real if np.all(values.imag == 0.0) else values


def solve_profile(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, level: int) -> OrderSolution:
    """Return the orders of a continuous profile, with films that follow it, by coordinate transformation."""
    profile = stack.profile
    assert profile is not None
    transverse, k_z, _ = incident_wave(stack, theta_rad, phi_rad)
    alpha_0, k_y = float(transverse[0]), float(transverse[1])
    period, depth = stack.cell.period_x * k0, profile.depth_nm * k0
    mesh = _profile_mesh(stack, profile, period, k0, level)
    check_unknowns(2 * mesh.size, k0)
    phase = complex(np.exp(1j * alpha_0 * period))
    parts = operators(mesh, lambda x: depth / period * profile.slope(x / period % 1.0), phase)
    numbers = np.array([layer.epsilon for layer in stack.layers])
    cover, substrate = stack.cover**2, stack.substrate**2
    above, below = profile_modes(parts, cover - k_y**2), profile_modes(parts, substrate - k_y**2)
    size = mesh.size

    def plane_waves(index: float, sign: float) -> tuple[Array, Array, Array, Array]:
        orders, waves = propagating(stack, k0, transverse, index)
        beta = sign * np.sqrt(index**2 - np.sum(waves**2, axis=1))
        return orders, waves, beta, _projected(mesh, parts.mass, profile, depth, waves[:, 0], beta, phase)

    orders_up, waves_up, beta_up, shape_up = plane_waves(stack.cover, 1.0)
    up_field, up_flux, up_at = aligned(above.up, above.up_field, above.up_flux, shape_up, beta_up, parts.mass)
    orders_in, _, beta_in, shape_in = plane_waves(stack.cover, -1.0)
    in_field, in_flux, in_at = aligned(above.down, above.down_field, above.down_flux, shape_in, beta_in, parts.mass)
    out_field, out_flux = below.down_field, below.down_flux
    if stack.is_clear:
        orders_out, waves_out, beta_out, shape_out = plane_waves(stack.substrate.real, -1.0)
        out_field, out_flux, out_at = aligned(below.down, out_field, out_flux, shape_out, beta_out, parts.mass)
    films = []
    for layer, epsilon in zip(stack.layers, numbers, strict=True):
        modes = profile_modes(parts, epsilon - k_y**2)
        films.append(
            (
                state(modes.up_field, modes.up_flux, epsilon, k_y, parts),
                state(modes.down_field, modes.down_flux, epsilon, k_y, parts),
                np.tile(np.exp(1j * modes.up * layer.thickness_nm * k0), 2),
                np.tile(np.exp(-1j * modes.down * layer.thickness_nm * k0), 2),
            )
        )
    zero = in_at[int(np.flatnonzero(orders_in[:, 0] == 0)[0])]
    wave = np.zeros((2 * size, 2), dtype=complex)
    cosine, sine = np.array([np.cos(phi_rad)]), np.array([np.sin(phi_rad)])
    wave[zero], wave[size + zero] = axial(cosine, sine, -k_z, stack.cover)[0]
    cover_states = state(up_field, up_flux, cover, k_y, parts), state(in_field, in_flux, cover, k_y, parts)
    substrate_down = state(out_field, out_flux, substrate, k_y, parts)
    if stack.is_clear and all(np.imag(value) == 0.0 for value in (*numbers, substrate)):
        _, _, beta_back, shape_back = plane_waves(stack.substrate.real, 1.0)
        back_field, back_flux, back_at = aligned(
            below.up, below.up_field, below.up_flux, shape_back, beta_back, parts.mass
        )  # fmt: skip
        back_states = state(back_field, back_flux, substrate, k_y, parts)
        ports = [
            Ports(cover_states[1], in_at, _power(in_field, in_flux, in_at), cover, k_y),
            Ports(back_states, back_at, _power(back_field, back_flux, back_at), substrate, k_y),
            Ports(cover_states[0], up_at, _power(up_field, up_flux, up_at), cover, k_y),
            Ports(substrate_down, out_at, _power(out_field, out_flux, out_at), substrate, k_y),
        ]  # fmt: skip
        amplitudes_up, amplitudes_down = lossless_amplitudes(ports, films, wave)
    else:
        amplitudes_up, amplitudes_down = scatter_profile(
            cover_states, films, substrate_down, wave, np.zeros((4 * size, wave.shape[1]))
        )  # fmt: skip
    incident_power = _power(in_field, in_flux, np.array([zero]))[0]

    def side(
        amplitudes: Array, at: Array, orders: Array, waves: Array, beta: Array, index: float, powers: Array,
        shift: float,
    ) -> OrderSet:  # fmt: skip
        """Convert E_y and H_y of the orders to s and p."""
        t_x, t_y = transverse_axes(waves, phi_rad)
        fields = np.stack([amplitudes[at], amplitudes[size + at]], axis=1)
        jones = np.linalg.solve(axial(t_x, t_y, beta, index), fields) * np.exp(1j * np.abs(beta) * shift)[:, None, None]
        # the discrete power of a mode, with which energy is conserved exactly; equal to |beta| in the limit
        ratio = np.abs(powers / incident_power)
        efficiency = np.sum(np.abs(jones) ** 2, axis=1) * ratio[:, None]
        return OrderSet(orders, np.column_stack([waves, beta]), jones, efficiency)

    reflected = side(
        amplitudes_up, up_at, orders_up, waves_up, beta_up, stack.cover, _power(up_field, up_flux, up_at), 0.0
    )
    transmitted = empty_orders()
    if stack.is_clear:
        transmitted = side(
            amplitudes_down, out_at, orders_out, waves_out, beta_out, stack.substrate.real,
            _power(out_field, out_flux, out_at), depth,
        )  # fmt: skip
    return OrderSolution(reflected, transmitted, np.inf, size, "profile")


def _power(field: Array, flux: Array, at: Array) -> Array:
    return np.einsum("ij,ij->j", field[:, at].conj(), flux[:, at]).imag


def _profile_mesh(stack: PeriodicStack, profile: Profile, period: float, k0: float, level: int) -> LineMesh:
    """Return elements that end at the corners, graded towards each; even ones for a smooth profile."""
    films = [np.sqrt(complex(layer.epsilon)).real for layer in stack.layers]
    index = max([stack.reach, *films])
    slope = profile.depth_nm / stack.cell.period_x
    if not profile.corners:
        count = max(3, int(np.ceil(period * index / 4.0)))
        degree = int(np.ceil(0.5 * period * index / count) + 5 + 2 * level) + int(2.0 * slope)
        return assemble(period, np.linspace(0.0, period, count + 1), (degree,) * count)
    corners = np.array(profile.corners)
    edges, degrees, layers = [corners[0]], [], 1 + level
    steps = 0.5 * GRADING ** np.arange(layers, 0, -1)
    inner = np.concatenate([steps, 1.0 - steps[::-1], [1.0]])
    for a, b in zip(corners, np.append(corners[1:], corners[0] + 1.0), strict=True):
        sizes = np.diff(np.concatenate([[0.0], inner])) * (b - a)
        for k, size in enumerate(sizes):
            near = min(k, len(sizes) - 1 - k)
            turns = 0.5 * index * size * period
            waves = turns + 1.5 * turns ** (1.0 / 3.0) + (1 + level) * min(1.0, turns)
            degrees.append(max(2 + near + level // 2, int(np.ceil(waves))) + (3 + level if near == layers else 0))
        edges.extend(a + inner * (b - a))
    return assemble(period, np.array(edges) * period, tuple(degrees))


def _projected(
    mesh: LineMesh, mass: Array, profile: Profile, depth: float, alpha: Array, beta: Array, phase: complex
) -> Array:  # fmt: skip
    """Return the coefficients of plane waves on the profile, `[function, wave]`."""
    total = np.zeros((mesh.size + 1, len(alpha)), dtype=complex)
    for k, degree in enumerate(mesh.degrees):
        a, h = mesh.edges[k], mesh.edges[k + 1] - mesh.edges[k]
        x, w = gauss_legendre(degree + 20)
        at = a + 0.5 * h * (x + 1.0)
        height = depth * profile.height(at / mesh.period % 1.0)
        waves = np.exp(1j * (np.outer(at, alpha) + np.outer(height, beta))) * (0.5 * h * w)[:, None]
        total[mesh.places[k]] += gauss_values(degree, degree + 20)[0] @ waves
    last = len(mesh.edges) - 1
    total[0] += np.conj(phase) * total[last]
    return np.asarray(np.linalg.solve(mass, np.delete(total, last, axis=0)))
