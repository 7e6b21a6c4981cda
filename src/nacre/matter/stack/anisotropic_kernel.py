"""The numba kernel of anisotropic stacks.

Tangential fields psi = (Ex, Hy, Ey, -Hx) obey d psi/dz = i k0 D psi (Berreman 1972), with z into the stack. With
E = (Ex, Ey) and H = (Hy, -Hx) the kernel uses the waves a = (E + H)/2 (down) and b = (E - H)/2 (up), which are those
of a medium of index 1 at normal incidence. A stack is solved from the substrate upwards as its reflection b = g a.

Homogeneous layers: the characteristic polynomial of D is factorised into the quadratics of the downward and the upward
modes, q^2 - s q + p. D^2 - s D + p vanishes on one pair and maps onto the other, which gives the two invariant
subspaces without eigenvectors: b = Y a (down) and a = Z b (up). Degenerate modes need no special case. On each
subspace propagation is the exponential of a 2 x 2 matrix, which decays.

If the two pairs nearly coincide (a mode at its cut-off), and for slices of helical layers, the layer is a scattering
matrix instead: the Taylor series of exp(i k0 h D) for a thin slice, and m doublings for 2^m slices. No exponential
grows in either method: both are stable for opaque, thick and evanescent layers.

A 2 x 2 matrix is a tuple (m00, m01, m10, m11). A scattering matrix is (t, r, t', r'): transmission and reflection of
light from above, then from below; t and t' are stored less the identity.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from nacre.core.jit import compiled

# norm of the generator of a slice: the ninth power over 9! leaves 5e-16 of the first
SLICE_NORM = 0.06
# least resultant of the two quadratic factors, over the fourth power of the modes' size: digits lost are its inverse
SEPARATION = 1e-3
_GAUSS = 0.28867513459481287  # half the distance of the two Gauss nodes in a step of 1: sqrt(3)/6


@compiled(nogil=True)
def _mul(a, b):
    return (
        a[0] * b[0] + a[1] * b[2],
        a[0] * b[1] + a[1] * b[3],
        a[2] * b[0] + a[3] * b[2],
        a[2] * b[1] + a[3] * b[3],
    )


@compiled(nogil=True)
def _add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])


@compiled(nogil=True)
def _one_plus(a):
    return (1.0 + a[0], a[1], a[2], 1.0 + a[3])


@compiled(nogil=True)
def _scaled(a, factor):
    return (a[0] * factor, a[1] * factor, a[2] * factor, a[3] * factor)


@compiled(nogil=True)
def _inverse(a):
    over = 1.0 / (a[0] * a[3] - a[1] * a[2])
    return (a[3] * over, -a[1] * over, -a[2] * over, a[0] * over)


@compiled(nogil=True)
def _excess(k):
    """Return (1 - k)^-1 - 1 = (1 - k)^-1 k."""
    return _mul(_inverse((1.0 - k[0], -k[1], -k[2], 1.0 - k[3])), k)


@compiled(nogil=True)
def doubled(t, r, u, s):
    """Return the scattering matrix of a slice on an identical one."""
    full_t, full_u = _one_plus(t), _one_plus(u)
    y = _excess(_mul(s, r))
    z = _excess(_mul(r, s))
    yt = _mul(y, full_t)
    zu = _mul(z, full_u)
    new_t = _add(_add(_scaled(t, 2.0), _mul(t, t)), _mul(full_t, yt))
    new_u = _add(_add(_scaled(u, 2.0), _mul(u, u)), _mul(full_u, zu))
    new_r = _add(r, _mul(full_u, _mul(r, _add(full_t, yt))))
    new_s = _add(s, _mul(full_t, _mul(s, _add(full_u, zu))))
    return new_t, new_r, new_u, new_s


@compiled(nogil=True)
def joined(t1, r1, u1, s1, t2, r2, u2, s2):
    """Return the scattering matrix of the first slice above the second (Redheffer star product)."""
    full_t1, full_u1, full_t2, full_u2 = _one_plus(t1), _one_plus(u1), _one_plus(t2), _one_plus(u2)
    yt = _mul(_excess(_mul(s1, r2)), full_t1)
    zu = _mul(_excess(_mul(r2, s1)), full_u2)
    t = _add(_add(_add(t1, t2), _mul(t2, t1)), _mul(full_t2, yt))
    u = _add(_add(_add(u1, u2), _mul(u1, u2)), _mul(full_u1, zu))
    r = _add(r1, _mul(full_u1, _mul(r2, _add(full_t1, yt))))
    s = _add(s2, _mul(full_t2, _mul(s1, _add(full_u2, zu))))
    return t, r, u, s


@compiled(nogil=True)
def generator(eps, kx, factor, out):
    """Write `factor` D in the basis (a, b) to `out[4, 4]`; `eps[3, 3]` is symmetric, in the incidence frame."""
    over = 1.0 / eps[2, 2]
    d11 = -kx * eps[2, 0] * over
    d12 = 1.0 - kx * kx * over
    d13 = -kx * eps[2, 1] * over
    d21 = eps[0, 0] - eps[0, 2] * eps[2, 0] * over
    d22 = -kx * eps[0, 2] * over
    d23 = eps[0, 1] - eps[0, 2] * eps[2, 1] * over
    d41 = eps[1, 0] - eps[1, 2] * eps[2, 0] * over
    d42 = -kx * eps[1, 2] * over
    d43 = eps[1, 1] - eps[1, 2] * eps[2, 1] * over - kx * kx
    # E' = P E + Q H, H' = R E + S H
    half = 0.5 * factor
    p00, p01 = half * d11, half * d13
    q00, q11 = half * d12, half
    r00, r01, r10, r11 = half * d21, half * d23, half * d41, half * d43
    s00, s10 = half * d22, half * d42
    out[0, 0] = p00 + r00 + q00 + s00
    out[0, 1] = p01 + r01
    out[1, 0] = r10 + s10
    out[1, 1] = r11 + q11
    out[0, 2] = p00 + r00 - q00 - s00
    out[0, 3] = p01 + r01
    out[1, 2] = r10 - s10
    out[1, 3] = r11 - q11
    out[2, 0] = p00 - r00 + q00 - s00
    out[2, 1] = p01 - r01
    out[3, 0] = -r10 - s10
    out[3, 1] = q11 - r11
    out[2, 2] = p00 - r00 - q00 + s00
    out[2, 3] = p01 - r01
    out[3, 2] = -r10 + s10
    out[3, 3] = -r11 - q11


@compiled(nogil=True)
def _product(a, b, out):
    for i in range(4):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j] + a[i, 3] * b[3, j]


@compiled(nogil=True)
def scattering(m, work):
    """Return the scattering matrix of a layer with the transfer matrix exp(m), `m[4, 4]` in the basis (a, b).

    Args:
        m: is overwritten.
        work: scratch, `[5, 4, 4]`.
    """
    norm = 0.0
    for j in range(4):
        column = abs(m[0, j]) + abs(m[1, j]) + abs(m[2, j]) + abs(m[3, j])
        norm = max(norm, column)
    doublings, scale = 0, 1.0
    while norm * scale > SLICE_NORM:
        scale *= 0.5
        doublings += 1
    m2, m3, m4, tail, last = work[0], work[1], work[2], work[3], work[4]
    for i in range(4):
        for j in range(4):
            m[i, j] *= scale
    _product(m, m, m2)
    _product(m2, m, m3)
    _product(m2, m2, m4)
    for i in range(4):
        for j in range(4):
            tail[i, j] = m[i, j] / 120.0 + m2[i, j] / 720.0 + m3[i, j] / 5040.0 + m4[i, j] / 40320.0
    _product(m4, tail, last)
    for i in range(4):
        for j in range(4):
            last[i, j] += m[i, j] + m2[i, j] / 2.0 + m3[i, j] / 6.0 + m4[i, j] / 24.0
    e11 = (last[0, 0], last[0, 1], last[1, 0], last[1, 1])
    e12 = (last[0, 2], last[0, 3], last[1, 2], last[1, 3])
    e21 = (last[2, 0], last[2, 1], last[3, 0], last[3, 1])
    e22 = (last[2, 2], last[2, 3], last[3, 2], last[3, 3])
    inverse = _inverse(_one_plus(e22))
    r = _scaled(_mul(inverse, e21), -1.0)
    u = _scaled(_mul(inverse, e22), -1.0)
    s = _mul(e12, inverse)
    t = _add(e11, _mul(e12, r))
    for _ in range(doublings):
        t, r, u, s = doubled(t, r, u, s)
    return t, r, u, s


@compiled(nogil=True)
def _turned(eps, cosine, sine, out):
    """Write the tensor `eps` turned about z to `out`."""
    xx, xy, xz = eps[0, 0], eps[0, 1], eps[0, 2]
    yy, yz, zz = eps[1, 1], eps[1, 2], eps[2, 2]
    c, s = cosine, sine
    out[0, 0] = c * c * xx - 2.0 * c * s * xy + s * s * yy
    out[0, 1] = c * s * (xx - yy) + (c * c - s * s) * xy
    out[1, 1] = s * s * xx + 2.0 * c * s * xy + c * c * yy
    out[0, 2] = c * xz - s * yz
    out[1, 2] = s * xz + c * yz
    out[2, 2] = zz
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@compiled(nogil=True)
def helix_slice(eps, kx, phase, start, turn, tensor, work):
    """Return the scattering matrix of a slice in which the tensor turns by `turn`, by a fourth-order Magnus step.

    Args:
        eps: the tensor at angle 0, in the incidence frame.
        phase: i k0 h of the slice.
        start: angle at its upper face.
        tensor: scratch `[3, 3]`.
        work: scratch `[8, 4, 4]`.
    """
    first, second, m = work[5], work[6], work[7]
    angle = start + turn * (0.5 - _GAUSS)
    _turned(eps, np.cos(angle), np.sin(angle), tensor)
    generator(tensor, kx, phase, first)
    angle = start + turn * (0.5 + _GAUSS)
    _turned(eps, np.cos(angle), np.sin(angle), tensor)
    generator(tensor, kx, phase, second)
    ab, ba = work[0], work[1]
    _product(second, first, ab)
    _product(first, second, ba)
    for i in range(4):
        for j in range(4):
            m[i, j] = 0.5 * (first[i, j] + second[i, j]) + 0.5 * _GAUSS * (ab[i, j] - ba[i, j])
    return scattering(m, work)


@compiled(nogil=True)
def helix(eps, kx, k0_thickness, turn, slices_per_half_turn, tensor, work):
    """Return the scattering matrix of a helical layer: N equal half turns by repeated squaring, then the rest.

    The permittivity tensor has the period of half a turn if the helix turns a tensor whose principal axis lies in the
    layer; a tilted axis (xz or yz components) has the period of a full turn, which is then the unit.
    """
    tilted = abs(eps[0, 2]) + abs(eps[1, 2]) > 0.0
    unit = 2.0 * np.pi if tilted else np.pi
    slices = slices_per_half_turn * (2 if tilted else 1)
    direction = 1.0 if turn >= 0.0 else -1.0
    units = int(abs(turn) / unit + 1e-12)
    rest = abs(turn) - units * unit
    zero = (0j, 0j, 0j, 0j)
    t, r, u, s = zero, zero, zero, zero
    if units > 0:
        phase = 1j * k0_thickness * unit / abs(turn) / slices
        step = direction * unit / slices
        bt, br, bu, bs = zero, zero, zero, zero
        for i in range(slices):
            a = helix_slice(eps, kx, phase, i * step, step, tensor, work)
            bt, br, bu, bs = joined(bt, br, bu, bs, a[0], a[1], a[2], a[3])
        count = units
        while count > 0:
            if count % 2 == 1:
                t, r, u, s = joined(t, r, u, s, bt, br, bu, bs)
            count //= 2
            if count > 0:
                bt, br, bu, bs = doubled(bt, br, bu, bs)
    if rest > 1e-12 or units == 0:
        share = rest / abs(turn) if turn != 0.0 else 1.0
        pieces = max(int(np.ceil(slices * rest / unit)), 1)
        phase = 1j * k0_thickness * share / pieces
        step = direction * rest / pieces
        for i in range(pieces):
            a = helix_slice(eps, kx, phase, direction * units * unit + i * step, step, tensor, work)
            t, r, u, s = joined(t, r, u, s, a[0], a[1], a[2], a[3])
    return t, r, u, s


@compiled(nogil=True)
def _factorised(d, d2, s, p):
    """Refine the factor q^2 - s q + p of the characteristic polynomial of `d` by Newton's method (Bairstow).

    Returns (s, p) of the given and of the complementary factor, and whether the iteration converged.
    """
    t1 = d[0, 0] + d[1, 1] + d[2, 2] + d[3, 3]
    t2 = d2[0, 0] + d2[1, 1] + d2[2, 2] + d2[3, 3]
    t3, t4 = 0j, 0j
    for i in range(4):
        for j in range(4):
            t3 += d2[i, j] * d[j, i]
            t4 += d2[i, j] * d2[j, i]
    c3 = -t1
    c2 = 0.5 * (t1 * t1 - t2)
    c1 = -(t1 * t1 * t1 - 3.0 * t1 * t2 + 2.0 * t3) / 6.0
    c0 = (t1 * t1 * t1 * t1 - 6.0 * t1 * t1 * t2 + 3.0 * t2 * t2 + 8.0 * t1 * t3 - 6.0 * t4) / 24.0
    scale = abs(s) + np.sqrt(abs(p))
    for _ in range(8):
        other_s = -c3 - s
        other_p = c2 - p - s * other_s
        f1 = c1 + s * other_p + other_s * p
        f2 = c0 - p * other_p
        gap = s - other_s
        j11, j12 = other_p - p + s * gap, -gap
        j21, j22 = -p * gap, p - other_p
        det = j11 * j22 - j12 * j21
        if abs(det) < SEPARATION * scale**4:
            return s, p, other_s, other_p, False
        step_s, step_p = (f1 * j22 - f2 * j12) / det, (f2 * j11 - f1 * j21) / det
        s, p = s - step_s, p - step_p
        if abs(step_s) <= 1e-14 * scale and abs(step_p) <= 1e-14 * scale * scale:
            other_s = -c3 - s
            return s, p, other_s, c2 - p - s * other_s, True
    return s, p, s, p, False


@compiled(nogil=True)
def _first_factor(d):
    """Return (s, p) of the downward pair of modes, by decay if a mode decays and by its flux |a|^2 - |b|^2 if not."""
    values, vectors = np.linalg.eig(d)
    rank = np.empty(4)
    for i in range(4):
        if abs(values[i].imag) > 1e-9 * abs(values[i]):
            rank[i] = 2.0 if values[i].imag > 0.0 else -2.0
        else:
            down = abs(vectors[0, i]) ** 2 + abs(vectors[1, i]) ** 2
            rank[i] = 2.0 * down / (down + abs(vectors[2, i]) ** 2 + abs(vectors[3, i]) ** 2) - 1.0
    order = np.argsort(-rank)
    first, second = values[order[0]], values[order[1]]
    return first + second, first * second


@compiled(nogil=True)
def _is_passive(y):
    """Whether the reflection of a half-space has no singular value above 1."""
    total = abs(y[0]) ** 2 + abs(y[1]) ** 2 + abs(y[2]) ** 2 + abs(y[3]) ** 2
    det = abs(y[0] * y[3] - y[1] * y[2]) ** 2
    return total * 0.5 + np.sqrt(max(total * total * 0.25 - det, 0.0)) <= 1.0 + 1e-6


@compiled(nogil=True)
def _subspaces(d, d2, s, p, other_s, other_p):
    """Return Y and Z of the two invariant subspaces of `d`: b = Y a of the pair (s, p), a = Z b of the other."""
    n11 = (
        d2[0, 0] - other_s * d[0, 0] + other_p, d2[0, 1] - other_s * d[0, 1],
        d2[1, 0] - other_s * d[1, 0], d2[1, 1] - other_s * d[1, 1] + other_p,
    )  # fmt: skip
    n21 = (
        d2[2, 0] - other_s * d[2, 0], d2[2, 1] - other_s * d[2, 1],
        d2[3, 0] - other_s * d[3, 0], d2[3, 1] - other_s * d[3, 1],
    )  # fmt: skip
    n12 = (d2[0, 2] - s * d[0, 2], d2[0, 3] - s * d[0, 3], d2[1, 2] - s * d[1, 2], d2[1, 3] - s * d[1, 3])
    n22 = (d2[2, 2] - s * d[2, 2] + p, d2[2, 3] - s * d[2, 3], d2[3, 2] - s * d[3, 2], d2[3, 3] - s * d[3, 3] + p)
    return _mul(n21, _inverse(n11)), _mul(n12, _inverse(n22))


@compiled(nogil=True)
def _exponent(m):
    """Return mean, half difference and traceless part of a 2 x 2 matrix, from which `_exp` is computed."""
    mean = 0.5 * (m[0] + m[3])
    half = 0.5 * (m[0] - m[3])
    return mean, np.sqrt(half * half + m[1] * m[2]), (half, m[1], m[2], -half)


@compiled(nogil=True)
def _exp(mean, difference, rest, factor):
    """Return exp(factor m) for a 2 x 2 matrix m, given by its three parts from `_exponent`."""
    x, y = factor * mean, factor * difference
    if abs(y) < 0.02:
        e, y2 = np.exp(x), y * y
        cosh = e * (1.0 + y2 * (0.5 + y2 * (1.0 / 24.0 + y2 / 720.0)))
        sinh = e * factor * (1.0 + y2 * (1.0 / 6.0 + y2 * (1.0 / 120.0 + y2 / 5040.0)))
    else:
        e1, e2 = np.exp(x + y), np.exp(x - y)
        cosh, sinh = 0.5 * (e1 + e2), 0.5 * (e1 - e2) / difference
    return (cosh + sinh * rest[0], sinh * rest[1], sinh * rest[2], cosh + sinh * rest[3])


@compiled(nogil=True)
def solve_stacks(stack, light, bottom, outputs, first, last):
    """Solve a stack at angles `first` to `last` - 1 and all wavelengths.

    Args:
        stack: tensors `[layer, wavelength, 3, 3]` in the incidence frame (of a helical layer at its upper face),
            thicknesses `[layer]` in nm, turns `[layer]` (total rotation of a helical layer, rad; 0: homogeneous), and
            slices of half a turn of a helix `[layer]`.
        light: vacuum wave numbers k0 `[wavelength]`, 1/nm, and in-plane wave numbers over k0 `[angle, wavelength]`.
        bottom: b = bottom a in the substrate, `[angle, wavelength, 2, 2]`.
        outputs: b = gamma a at the top `[angle, wavelength, 2, 2]`; a in the substrate = entering a at the top
            `[angle, wavelength, 2, 2]`; absorbed `[layer, angle, wavelength, 2, 2]`, Hermitian: flux lost in a layer
            = a^H absorbed a (not computed if it lacks layers).
    """
    tensors, thicknesses, turns, slices = stack
    k0, kx = light
    gamma, entering, absorbed = outputs
    layers = thicknesses.shape[0]
    d = np.empty((4, 4), np.complex128)
    work = np.empty((8, 4, 4), np.complex128)
    tensor = np.empty((3, 3), np.complex128)
    states = np.empty((layers + 1, 2, 4), np.complex128)
    factors = np.zeros((layers, 2), np.complex128)
    modes = np.empty((layers, 20), np.complex128)
    status = np.zeros(layers, np.int64)  # 0: no factor known; 1: modes valid; 2: use doubling
    for angle in range(first, last):
        status[:] = 0
        for w in range(k0.shape[0]):
            x = kx[angle, w]
            below = bottom[angle, w]
            g = (below[0, 0], below[0, 1], below[1, 0], below[1, 1])
            through = (1.0 + 0j, 0j, 0j, 1.0 + 0j)
            _store(states[layers], g, through)
            for layer in range(layers - 1, -1, -1):
                phase = 1j * k0[w] * thicknesses[layer]
                if turns[layer] != 0.0:
                    t, r, u, s = helix(
                        tensors[layer, w], x, k0[w] * thicknesses[layer], turns[layer], slices[layer], tensor, work
                    )
                    g, down = _over_scattering(g, t, r, u, s)
                else:
                    known = w > 0 and status[layer] > 0 and x == kx[angle, w - 1]
                    if not (known and _is_same(tensors[layer, w], tensors[layer, w - 1])):
                        generator(tensors[layer, w], x, 1.0, d)
                        _product(d, d, work[0])
                        status[layer] = _find_modes(d, work[0], factors[layer], modes[layer], status[layer] == 1)
                    if status[layer] == 1:
                        g, down = _over_modes(g, modes[layer], phase)
                    else:
                        generator(tensors[layer, w], x, phase, d)
                        t, r, u, s = scattering(d, work)
                        g, down = _over_scattering(g, t, r, u, s)
                through = _mul(through, down)
                _store(states[layer], g, down)
            for k in range(4):
                gamma[angle, w, k // 2, k % 2] = g[k]
                entering[angle, w, k // 2, k % 2] = through[k]
            if absorbed.shape[0] > 0:
                _absorption(states, absorbed[:, angle, w])


@compiled(nogil=True)
def _store(state, g, down):
    for k in range(4):
        state[0, k] = g[k]
        state[1, k] = down[k]


@compiled(nogil=True)
def _is_same(one, other):
    same = one[0, 0] == other[0, 0] and one[1, 1] == other[1, 1] and one[2, 2] == other[2, 2]
    return same and one[0, 1] == other[0, 1] and one[0, 2] == other[0, 2] and one[1, 2] == other[1, 2]


@compiled(nogil=True)
def _over_scattering(g, t, r, u, s):
    """Return the reflection above a layer, and the map of a from its upper to its lower face, given that below it."""
    full_t = _one_plus(t)
    down = _add(full_t, _mul(_excess(_mul(s, g)), full_t))
    return _add(r, _mul(_one_plus(u), _mul(g, down))), down


@compiled(nogil=True)
def _over_modes(g, m, phase):
    """Return the same for a layer with the modes of `_find_modes`."""
    y, z = (m[0], m[1], m[2], m[3]), (m[4], m[5], m[6], m[7])
    e_down = _exp(m[8], m[9], (m[10], m[11], m[12], m[13]), phase)
    e_up = _exp(m[14], m[15], (m[16], m[17], m[18], m[19]), -phase)
    gz = _mul(g, z)
    rho = _mul(
        _inverse((1.0 - gz[0], -gz[1], -gz[2], 1.0 - gz[3])), (g[0] - y[0], g[1] - y[1], g[2] - y[2], g[3] - y[3])
    )
    rho_top = _mul(e_up, _mul(rho, e_down))
    over = _inverse(_one_plus(_mul(z, rho_top)))
    return _mul(_add(y, rho_top), over), _mul(_one_plus(_mul(z, rho)), _mul(e_down, over))


@compiled(nogil=True)
def _absorption(states, absorbed):
    """Write the flux lost in each layer from the reflections and maps of all layers."""
    into = (1.0 + 0j, 0j, 0j, 1.0 + 0j)
    before = _flux(into, (states[0, 0, 0], states[0, 0, 1], states[0, 0, 2], states[0, 0, 3]))
    for layer in range(absorbed.shape[0]):
        step, below = states[layer, 1], states[layer + 1, 0]
        into = _mul((step[0], step[1], step[2], step[3]), into)
        after = _flux(into, (below[0], below[1], below[2], below[3]))
        for k in range(4):
            absorbed[layer, k // 2, k % 2] = before[k] - after[k]
        before = after


@compiled(nogil=True)
def _find_modes(d, d2, factor, modes, has_guess):
    """Write the invariant subspaces and exponents of a layer to `modes`; return 1, or 2 if doubling must be used.

    The factor of the previous wavelength is the first guess. A result that is not passive is another branch; the
    factor then comes from the eigenvalues.
    """
    for attempt in range(2):
        if attempt == 1 or not has_guess:
            factor[0], factor[1] = _first_factor(d)
        s, p, other_s, other_p, converged = _factorised(d, d2, factor[0], factor[1])
        if converged:
            y, z = _subspaces(d, d2, s, p, other_s, other_p)
            if _is_passive(y) and _is_passive(z):
                factor[0], factor[1] = s, p
                q_down = _add((d[0, 0], d[0, 1], d[1, 0], d[1, 1]), _mul((d[0, 2], d[0, 3], d[1, 2], d[1, 3]), y))
                q_up = _add((d[2, 2], d[2, 3], d[3, 2], d[3, 3]), _mul((d[2, 0], d[2, 1], d[3, 0], d[3, 1]), z))
                mean, difference, rest = _exponent(q_down)
                modes[8], modes[9] = mean, difference
                other_mean, other_difference, other_rest = _exponent(q_up)
                modes[14], modes[15] = other_mean, other_difference
                for k in range(4):
                    modes[k], modes[4 + k], modes[10 + k], modes[16 + k] = y[k], z[k], rest[k], other_rest[k]
                return 1
    return 2


@compiled(nogil=True)
def _flux(down, g):
    """Return down^H (1 - g^H g) down, the flux matrix for incident waves a."""
    up = _mul(g, down)
    a, b = _adjoint_product(down), _adjoint_product(up)
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3])


@compiled(nogil=True)
def _adjoint_product(m):
    c00, c01, c10, c11 = np.conj(m[0]), np.conj(m[1]), np.conj(m[2]), np.conj(m[3])
    return (c00 * m[0] + c10 * m[2], c00 * m[1] + c10 * m[3], c01 * m[0] + c11 * m[2], c01 * m[1] + c11 * m[3])
