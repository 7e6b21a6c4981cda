"""The numba kernel of stratified media: amplitudes of s and p for many stacks, angles and wavelengths.

Own derivation, as an admittance recursion with scaled exponentials: let `f` be the
tangential E field (s) or H field (p) and `g` its partner, with `g = q f` for a wave that travels inward,
with `q = kz` (s) or `kz / n^2` (p), all wavevectors in units of k0. Start in the substrate with u = 1,
v = q_s and carry (u, v) upward through each layer of phase x = k0 kz d:

    u' = c u - i a v,   v' = c v - i b u,   c = e^{ix} cos x,   a = e^{ix} sin x / q,   b = e^{ix} q sin x

With the factor e^{ix} only decaying exponentials occur and every term is finite. At the top
r = (q_0 u - v) / (q_0 u + v) and t = 2 q_0 prod(e^{ix}) / (q_0 u + v).

A layer has a fast and a robust form with equal results. The fast form works on blocks of wavelengths that fit the
first-level cache, in loops that vectorise; its sine, cosine and exponential are therefore polynomials. Its u and v
come from A = u + v/q and B = (u - v/q) e^{2ix}, which loses digits as q -> 0. A block with a small kz uses the robust
form, which contains q only as q^2 and sin x / x.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from nacre.core.jit import compiled

BLOCK = 64  # wavelengths per block: 20 rows of 64 doubles are 10 kB, a third of a first-level cache
LANES = 8  # rows are padded to a multiple of the widest vector, to avoid a scalar remainder
SMALL_KZ2 = 1e-3  # below this |kz^2| a block uses the robust form; above, the fast one has 14 digits
RESCALE_EVERY = 16  # layers; growth per layer is below (n_high / n_low) < 1e3, so 16 stay far from 1e308
TWO_PI = 2.0 * math.pi
TWO_OVER_LN2 = 2.0 / math.log(2.0)
TWO_PI_OVER_LN2 = 2.0 * math.pi / math.log(2.0)
ROUNDING = 1e-15  # relative rounding of a sum of three terms
ROUNDER = 6755399441055744.0  # 1.5 * 2^52: adding and subtracting it rounds a double to an integer

# Scratch rows, in units of BLOCK.
_ZR, _ZI = 0 * BLOCK, 1 * BLOCK  # the ambient's kz^2
_KR, _KI, _INV = 2 * BLOCK, 3 * BLOCK, 4 * BLOCK  # the layer's kz and 1 / |kz|^2
_ER, _EI = 5 * BLOCK, 6 * BLOCK  # e^{2ix}
_NR, _NI, _JR, _JI = 7 * BLOCK, 8 * BLOCK, 9 * BLOCK, 10 * BLOCK  # the layer's n^2 and 1 / n^2
_US, _VS = 11 * BLOCK, 13 * BLOCK  # u and v for s: real row, imaginary row
_UP, _VP = 15 * BLOCK, 17 * BLOCK  # u and v for p
_TURNS, _DECAY = 19 * BLOCK, 20 * BLOCK  # sum of kz d / wavelength, real and imaginary part
_DL = 21 * BLOCK  # the layer's 2 d / wavelength
_SCALE_S, _SCALE_P = 22 * BLOCK, 23 * BLOCK  # logarithm of the scale removed from u and v
_QS, _QP = 24 * BLOCK, 26 * BLOCK  # the ambient's q, s and p: real row, imaginary row
_OUT = 28 * BLOCK  # the substrate's Re q, s and p; replaced by T, followed by R
ROWS = 32


@intrinsic
def _power_of_two(typing_context: Any, exponent: Any) -> Any:
    """Return 2.0**exponent for an int64 in -1022..1023 from the bits of a double, which vectorises."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        biased = builder.add(arguments[0], ir.Constant(ir.IntType(64), 1023))
        return builder.bitcast(builder.shl(biased, ir.Constant(ir.IntType(64), 52)), ir.DoubleType())

    return numba.float64(numba.int64), generate


@compiled(error_model="numpy", fastmath={"contract"}, inline="always")
def sin_half_turn(f: float, s: float) -> float:
    """Return sin(pi f) for |f| <= 1/2, s = f^2; Chebyshev fit, error 7e-19 before rounding."""
    p = 7.6978267682241906454e-7
    p = p * s - 2.1903497074626017191e-5
    p = p * s + 4.6629981618983938014e-4
    p = p * s - 7.3704305059169434047e-3
    p = p * s + 0.08214588657310289502
    p = p * s - 0.59926452932894468132
    p = p * s + 2.5501640398773004745
    p = p * s - 5.1677127800499696077
    p = p * s + 3.1415926535897932378
    return p * f


@compiled(error_model="numpy", fastmath={"contract"}, inline="always")
def cos_half_turn(s: float) -> float:
    """Return cos(pi f) for |f| <= 1/2, s = f^2; Chebyshev fit, error 4e-18 before rounding."""
    p = 4.1495643539425855122e-6
    p = p * s - 1.0456655338748738169e-4
    p = p * s + 1.9295562724817131482e-3
    p = p * s - 0.02580688873700220327
    p = p * s + 0.23533063012953285391
    p = p * s - 1.3352627688434470934
    p = p * s + 4.0587121264164969995
    p = p * s - 4.9348022005446767673
    return p * s + 1.0


@compiled(error_model="numpy", fastmath={"contract"}, inline="always")
def exp2_minus(y: float) -> float:
    """Return 2^-y with y limited to +-1000, beyond which results are indistinguishable from zero."""
    y = max(min(y, 1000.0), -1000.0)
    k = (y + ROUNDER) - ROUNDER
    g = k - y
    p = 4.455817908336064493e-10
    p = p * g + 7.0741942972885210056e-9
    p = p * g + 1.0178057087733941105e-7
    p = p * g + 1.3215432535912376166e-6
    p = p * g + 1.5252733841556772589e-5
    p = p * g + 1.5403530463724354209e-4
    p = p * g + 1.3333558146406470697e-3
    p = p * g + 9.6181291075872566681e-3
    p = p * g + 0.055504108664821627039
    p = p * g + 0.24022650695910159567
    p = p * g + 0.69314718055994530925
    p = p * g + 1.0
    # numba passes the typing context, unknown to mypy
    return p * _power_of_two(-np.int64(k))  # type: ignore[call-arg]


@compiled(error_model="numpy")
def sqrt_decaying(z: complex) -> complex:
    """Return the square root with Im >= 0, and Re >= 0 if Im = 0: the wave that travels or decays inward."""
    w = np.sqrt(z)
    if w.imag < 0.0 or (w.imag == 0.0 and w.real < 0.0):
        w = -w
    return w


@compiled(error_model="numpy", fastmath={"contract"})
def kz_squared(n2: complex, n02: complex, kz0sq: complex) -> complex:
    """Return a medium's kz^2 = n^2 - n_0^2 + kz_0^2, with rounding of the imaginary part removed.

    Otherwise light from an absorbing medium into glass could have Im kz^2 = -1e-20, and the rule Im kz >= 0 would
    select the wave in the wrong direction.
    """
    z = n2 - n02 + kz0sq
    if abs(z.imag) <= ROUNDING * (abs(n2.imag) + abs(n02.imag) + abs(kz0sq.imag)):
        z = complex(z.real, 0.0)
    return z


@compiled(error_model="numpy")
def robust_factors(kz2: complex, k0d: float) -> tuple[complex, complex, complex]:
    """Return a layer's (c, m, ix): c = e^{ix} cos x, m = k0 d e^{ix} sin x / x; regular at kz = 0 and d = 0.

    a = w m and b = kz^2 m / w, with w = 1 (s) or n^2 (p).
    """
    x = sqrt_decaying(kz2) * k0d
    z = 2j * x
    if abs(z.real) + abs(z.imag) < 0.5:
        # the series of expm1(z)/z; the error after 15 terms is 0.5^15/16! = 1.5e-18
        g = 0.0j
        for j in range(15, 0, -1):
            g = (g + 1.0) * z / (j + 1.0)
        g += 1.0
        c = 1.0 + 0.5 * z * g
    else:
        e = np.exp(z)
        c = 0.5 + 0.5 * e
        g = (e - 1.0) / z
    return c, k0d * g, 0.5 * z


@compiled(error_model="numpy")
def _robust_layer(w: Any, count: int, l0: int, wavelengths: Any, thickness: float, n02r: Any, n02i: Any) -> None:
    for i in range(count):
        n2 = complex(w[_NR + i], w[_NI + i])
        kz2 = kz_squared(n2, complex(n02r[l0 + i], n02i[l0 + i]), complex(w[_ZR + i], w[_ZI + i]))
        c, m, ix = robust_factors(kz2, TWO_PI * thickness / wavelengths[l0 + i])
        u = complex(w[_US + i], w[_US + BLOCK + i])
        v = complex(w[_VS + i], w[_VS + BLOCK + i])
        un = c * u - 1j * m * v
        vn = c * v - 1j * kz2 * m * u
        w[_US + i], w[_US + BLOCK + i], w[_VS + i], w[_VS + BLOCK + i] = un.real, un.imag, vn.real, vn.imag
        u = complex(w[_UP + i], w[_UP + BLOCK + i])
        v = complex(w[_VP + i], w[_VP + BLOCK + i])
        un = c * u - 1j * n2 * m * v
        vn = c * v - 1j * kz2 * m / n2 * u
        w[_UP + i], w[_UP + BLOCK + i], w[_VP + i], w[_VP + BLOCK + i] = un.real, un.imag, vn.real, vn.imag
        w[_TURNS + i] += ix.imag / TWO_PI
        w[_DECAY + i] -= ix.real / TWO_PI


@compiled(error_model="numpy", fastmath={"contract"})
def _wavevector(w: Any, count: int, l0: int, n02r: Any, n02i: Any) -> int:
    """Fill the layer's kz and 1/|kz|^2; return the point count with a small kz."""
    small = 0
    for i in range(count):
        zr = w[_NR + i] - n02r[l0 + i] + w[_ZR + i]
        zi = w[_NI + i] - n02i[l0 + i] + w[_ZI + i]
        rounding = ROUNDING * (abs(w[_NI + i]) + abs(n02i[l0 + i]) + abs(w[_ZI + i]))
        zi = 0.0 if abs(zi) <= rounding else zi  # as in kz_squared
        size = math.sqrt(zr * zr + zi * zi)
        small += size < SMALL_KZ2
        large = math.sqrt(0.5 * (size + abs(zr)))
        other = zi / (2.0 * max(large, 1e-150))
        re = large if zr >= 0.0 else other
        im = other if zr >= 0.0 else large
        sign = -1.0 if im < 0.0 else 1.0
        w[_KR + i] = re * sign
        w[_KI + i] = im * sign
        w[_INV + i] = 1.0 / max(size, 1e-300)
    return small


@compiled(error_model="numpy", fastmath={"contract"})
def _lossless_wavevector(w: Any, count: int, l0: int, n02r: Any) -> int:
    """As `_wavevector` for real media; return the point count with a small or imaginary kz."""
    small = 0
    for i in range(count):
        zr = w[_NR + i] - n02r[l0 + i] + w[_ZR + i]
        small += zr < SMALL_KZ2
        kz = math.sqrt(max(zr, SMALL_KZ2))
        w[_KR + i] = kz
        w[_INV + i] = 1.0 / kz
    return small


@compiled(error_model="numpy", fastmath={"contract"})
def _carry_lossless(w: Any, i: int, row_u: int, row_v: int, q: float, p: float) -> None:
    """Carry u and v at point i through a layer with real admittance q = 1 / p."""
    er, ei = w[_ER + i], w[_EI + i]
    ur, ui, vr, vi = w[row_u + i], w[row_u + BLOCK + i], w[row_v + i], w[row_v + BLOCK + i]
    br, bi = ur - vr * p, ui - vi * p
    cr, ci = br * er - bi * ei, br * ei + bi * er
    ar, ai = ur + vr * p, ui + vi * p
    w[row_u + i] = 0.5 * (ar + cr)
    w[row_u + BLOCK + i] = 0.5 * (ai + ci)
    w[row_v + i] = 0.5 * q * (ar - cr)
    w[row_v + BLOCK + i] = 0.5 * q * (ai - ci)


@compiled(error_model="numpy", fastmath={"contract"})
def _lossless_layer(w: Any, count: int) -> None:
    for i in range(count):
        kz = w[_KR + i]
        turns = kz * w[_DL + i]
        f = turns - ((turns + ROUNDER) - ROUNDER)
        s = sin_half_turn(f, f * f)
        c = cos_half_turn(f * f)
        w[_ER + i] = c * c - s * s
        w[_EI + i] = 2.0 * s * c
        w[_TURNS + i] += 0.5 * turns
    for i in range(count):
        _carry_lossless(w, i, _US, _VS, w[_KR + i], w[_INV + i])
    for i in range(count):
        _carry_lossless(w, i, _UP, _VP, w[_KR + i] * w[_JR + i], w[_INV + i] * w[_NR + i])


@compiled(error_model="numpy", fastmath={"contract"})
def _carry_lossy(w: Any, i: int, row_u: int, row_v: int, qr: float, qi: float, pr: float, pi: float) -> None:
    """Carry u and v at point i through a layer with complex admittance q = 1 / p."""
    er, ei = w[_ER + i], w[_EI + i]
    ur, ui, vr, vi = w[row_u + i], w[row_u + BLOCK + i], w[row_v + i], w[row_v + BLOCK + i]
    xr, xi = vr * pr - vi * pi, vr * pi + vi * pr
    br, bi = ur - xr, ui - xi
    cr, ci = br * er - bi * ei, br * ei + bi * er
    ar, ai = ur + xr, ui + xi
    dr, di = 0.5 * (ar - cr), 0.5 * (ai - ci)
    w[row_u + i] = 0.5 * (ar + cr)
    w[row_u + BLOCK + i] = 0.5 * (ai + ci)
    w[row_v + i] = qr * dr - qi * di
    w[row_v + BLOCK + i] = qr * di + qi * dr


@compiled(error_model="numpy", fastmath={"contract"})
def _lossy_layer(w: Any, count: int) -> None:
    for i in range(count):
        turns = w[_KR + i] * w[_DL + i]
        decay = w[_KI + i] * w[_DL + i]
        f = turns - ((turns + ROUNDER) - ROUNDER)
        s = sin_half_turn(f, f * f)
        c = cos_half_turn(f * f)
        e = exp2_minus(decay * TWO_PI_OVER_LN2)
        w[_ER + i] = e * (c * c - s * s)
        w[_EI + i] = 2.0 * e * s * c
        w[_TURNS + i] += 0.5 * turns
        w[_DECAY + i] += 0.5 * decay
    for i in range(count):
        kr, ki, inv = w[_KR + i], w[_KI + i], w[_INV + i]
        _carry_lossy(w, i, _US, _VS, kr, ki, kr * inv, -ki * inv)
    for i in range(count):
        kr, ki, inv = w[_KR + i], w[_KI + i], w[_INV + i]
        nr, ni, jr, ji = w[_NR + i], w[_NI + i], w[_JR + i], w[_JI + i]
        qr, qi = kr * jr - ki * ji, kr * ji + ki * jr
        _carry_lossy(w, i, _UP, _VP, qr, qi, inv * (kr * nr + ki * ni), inv * (kr * ni - ki * nr))


@compiled(error_model="numpy")
def _rescale(w: Any, count: int, row_u: int, row_v: int, row_scale: int) -> None:
    for i in range(count):
        size = max(abs(w[row_u + i]) + abs(w[row_u + BLOCK + i]), abs(w[row_v + i]) + abs(w[row_v + BLOCK + i]), 1e-290)
        w[row_scale + i] += math.log(size)
        for row in (row_u, row_u + BLOCK, row_v, row_v + BLOCK):
            w[row + i] /= size


@compiled(error_model="numpy")
def _finish(q0: complex, u: complex, v: complex, turns: float, log_size: float) -> tuple[complex, complex]:
    """Return r and t from the fields at the top; `log_size` is the log of |prod e^{ix}| over the scale."""
    below = q0 * u + v
    if abs(below) == 0.0:
        # grazing incidence on a matched stack: undisturbed wave
        return 0.0j, 1.0 + 0.0j
    size = math.exp(max(log_size, -740.0))
    phase = TWO_PI * (turns - np.rint(turns))
    return (q0 * u - v) / below, 2.0 * q0 * size / below * complex(math.cos(phase), math.sin(phase))


@compiled(error_model="numpy", fastmath={"contract"})
def _power_end(w: Any, count: int, row_u: int, row_v: int, row_q: int, row_scale: int, row_t: int, row_r: int) -> None:
    """Compute a block's R and T as `_finish` does, without phases, in a vectorised loop."""
    for i in range(count):
        qr, qi = w[row_q + i], w[row_q + BLOCK + i]
        ur, ui, vr, vi = w[row_u + i], w[row_u + BLOCK + i], w[row_v + i], w[row_v + BLOCK + i]
        xr, xi = qr * ur - qi * ui, qr * ui + qi * ur
        below = (xr + vr) * (xr + vr) + (xi + vi) * (xi + vi)
        above = (xr - vr) * (xr - vr) + (xi - vi) * (xi - vi)
        over = 1.0 / max(below, 1e-300)
        size = exp2_minus((TWO_PI * w[_DECAY + i] + w[row_scale + i]) * TWO_OVER_LN2)
        passed = 4.0 * (qr * qr + qi * qi) * over * size * max(w[row_t + i], 0.0) / max(qr, 1e-300)
        passed = passed if qr > 0.0 else 0.0
        w[row_r + i] = above * over if below > 0.0 else 0.0
        w[row_t + i] = passed if below > 0.0 else 1.0


@compiled(error_model="numpy")
def _load_medium(w: Any, j: int, l0: int, count: int, n2r: Any, n2i: Any, i2r: Any, i2i: Any) -> None:
    for i in range(count):
        w[_NR + i] = n2r[j, l0 + i]
        w[_NI + i] = n2i[j, l0 + i]
        w[_JR + i] = i2r[j, l0 + i]
        w[_JI + i] = i2i[j, l0 + i]


@compiled(error_model="numpy", fastmath={"contract"})
def _times_ambient(w: Any, count: int, l0: int, n0r: Any, n0i: Any) -> None:
    """Convert cosines to kz = n_0 cos."""
    for i in range(count):
        cr, ci = w[_QS + i], w[_QS + BLOCK + i]
        nr, ni = n0r[l0 + i], n0i[l0 + i]
        w[_QS + i] = cr * nr - ci * ni
        w[_QS + BLOCK + i] = cr * ni + ci * nr


@compiled(error_model="numpy", fastmath={"contract"})
def _enter(w: Any, count: int, l0: int, i2r: Any, i2i: Any) -> int:
    """Fill kz^2 and q_p from the ambient's kz in the rows of q_s, clear the sums, and count complex kz^2."""
    complex_ones = 0
    for i in range(count):
        kr, ki = w[_QS + i], w[_QS + BLOCK + i]
        jr, ji = i2r[0, l0 + i], i2i[0, l0 + i]
        w[_ZR + i] = kr * kr - ki * ki
        w[_ZI + i] = 2.0 * kr * ki
        complex_ones += kr * ki != 0.0
        w[_QP + i] = kr * jr - ki * ji
        w[_QP + BLOCK + i] = kr * ji + ki * jr
        w[_TURNS + i] = w[_DECAY + i] = w[_SCALE_S + i] = w[_SCALE_P + i] = 0.0
    return complex_ones


@compiled(error_model="numpy", fastmath={"contract"})
def _leave(w: Any, count: int) -> None:
    """Start the recursion in the substrate: u = 1, v = q."""
    for i in range(count):
        kr, ki = w[_KR + i], w[_KI + i]
        qr = kr * w[_JR + i] - ki * w[_JI + i]
        w[_US + i] = w[_UP + i] = 1.0
        w[_US + BLOCK + i] = w[_UP + BLOCK + i] = 0.0
        w[_VS + BLOCK + i] = ki
        w[_VP + BLOCK + i] = kr * w[_JI + i] + ki * w[_JR + i]
        w[_VS + i] = w[_OUT + i] = kr
        w[_VP + i] = w[_OUT + BLOCK + i] = qr


@compiled(error_model="numpy")
def _load_stack(n: Any, squares: Any, ambient: Any, lossless: Any) -> None:
    """Fill n^2 and 1 / n^2 of all media, the ambient's index, and flags for real n^2, from n `[medium, wavelength]`."""
    n2r, n2i, i2r, i2i = squares
    n0r, n0i = ambient
    last = n.shape[1] - 1
    for j in range(n.shape[0]):
        lossless[j] = True
        for l in range(n2r.shape[1]):
            value = n[j, min(l, last)]
            square = value * value
            inverse = 1.0 / square
            n2r[j, l], n2i[j, l] = square.real, square.imag
            i2r[j, l], i2i[j, l] = inverse.real, inverse.imag
            if square.imag != 0.0:
                lossless[j] = False
    for l in range(n0r.shape[0]):
        value = n[0, min(l, last)]
        n0r[l], n0i[l] = value.real, value.imag


@compiled(error_model="numpy")
def _solve_block(w, count, l0, squares, ambient, lossless, lam, d, times_n0):
    """Run the recursion for a block of wavelengths, from the normal component in the rows of q_s."""
    n2r, n2i, i2r, i2i = squares
    n02r, n02i = n2r[0], n2i[0]
    layers = d.shape[0]
    if times_n0:
        _times_ambient(w, count, l0, ambient[0], ambient[1])
    is_real = _enter(w, count, l0, i2r, i2i) == 0 and lossless[0]
    _load_medium(w, layers + 1, l0, count, n2r, n2i, i2r, i2i)
    _wavevector(w, count, l0, n02r, n02i)
    _leave(w, count)
    for j in range(layers, 0, -1):
        thickness = d[j - 1]
        if thickness != 0.0:
            _load_medium(w, j, l0, count, n2r, n2i, i2r, i2i)
            for i in range(count):
                w[_DL + i] = 2.0 * thickness / lam[l0 + i]
            if is_real and lossless[j] and _lossless_wavevector(w, count, l0, n02r) == 0:
                _lossless_layer(w, count)
            elif _wavevector(w, count, l0, n02r, n02i) == 0:
                _lossy_layer(w, count)
            else:
                _robust_layer(w, count, l0, lam, thickness, n02r, n02i)
        if j % RESCALE_EVERY == 0:
            _rescale(w, count, _US, _VS, _SCALE_S)
            _rescale(w, count, _UP, _VP, _SCALE_P)


@compiled(error_model="numpy")
def _store_powers(w: Any, count: int, valid: int, powers: Any, b: int, angle: int, l0: int) -> None:
    _power_end(w, count, _US, _VS, _QS, _SCALE_S, _OUT, _OUT + 2 * BLOCK)
    _power_end(w, count, _UP, _VP, _QP, _SCALE_P, _OUT + BLOCK, _OUT + 3 * BLOCK)
    for i in range(valid):
        powers[0, b, angle, l0 + i] = w[_OUT + 2 * BLOCK + i]
        powers[1, b, angle, l0 + i] = w[_OUT + 3 * BLOCK + i]
        powers[2, b, angle, l0 + i] = w[_OUT + i]
        powers[3, b, angle, l0 + i] = w[_OUT + BLOCK + i]


@compiled(error_model="numpy")
def _store_amplitudes(w: Any, valid: int, amplitudes: Any, b: int, angle: int, l0: int) -> None:
    for i in range(valid):
        l = l0 + i
        decay = -TWO_PI * w[_DECAY + i]
        amplitudes[0, b, angle, l], amplitudes[2, b, angle, l] = _finish(
            complex(w[_QS + i], w[_QS + BLOCK + i]),
            complex(w[_US + i], w[_US + BLOCK + i]),
            complex(w[_VS + i], w[_VS + BLOCK + i]),
            w[_TURNS + i],
            decay - w[_SCALE_S + i],
        )
        amplitudes[1, b, angle, l], amplitudes[3, b, angle, l] = _finish(
            complex(w[_QP + i], w[_QP + BLOCK + i]),
            complex(w[_UP + i], w[_UP + BLOCK + i]),
            complex(w[_VP + i], w[_VP + BLOCK + i]),
            w[_TURNS + i],
            decay - w[_SCALE_P + i],
        )


@compiled(error_model="numpy", nogil=True)
def solve_range(
    n, thicknesses, wavelengths, normal, times_n0, start, stop, angle_start, angle_stop, amplitudes, powers
):
    """Solve the stacks start..stop of a batch at the angles angle_start..angle_stop.

    Args:
        n: complex `[batch or 1, medium, wavelength]`, from ambient to substrate.
        thicknesses: `[batch or 1, layer]`, nm.
        wavelengths: `[wavelength]`, nm.
        normal: complex `[batch or 1, angle, wavelength or 1]`, cos in the ambient or kz/k0 there.
        times_n0: whether `normal` is the cosine (then kz = n_0 cos).
        start, stop, angle_start, angle_stop: ranges, by which threads share the work without views.
        amplitudes: output complex `[4, batch, angle, wavelength]`: r_s, r_p, t_s, t_p (t_p of the H field); or
            an empty batch axis.
        powers: output `[4, batch, angle, wavelength]`: R_s, R_p, T_s, T_p; or an empty batch axis.
    """
    media, count_l = n.shape[1], wavelengths.shape[0]
    padded = (count_l + LANES - 1) // LANES * LANES
    shape = (media, padded)
    squares = (np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape))
    ambient = (np.empty(padded), np.empty(padded))
    lossless = np.empty(media, dtype=np.bool_)
    lam = np.empty(padded)
    for l in range(padded):
        lam[l] = wavelengths[min(l, count_l - 1)]
    w = np.zeros(ROWS * BLOCK)
    for b in range(start, stop):
        if b == start or n.shape[0] > 1:
            _load_stack(n[min(b, n.shape[0] - 1)], squares, ambient, lossless)
        d = thicknesses[min(b, thicknesses.shape[0] - 1)]
        for angle in range(angle_start, angle_stop):
            row = normal[min(b, normal.shape[0] - 1), angle]
            last = row.shape[0] - 1
            for l0 in range(0, padded, BLOCK):
                count = min(BLOCK, padded - l0)
                for i in range(count):
                    value = row[min(l0 + i, last)]
                    w[_QS + i], w[_QS + BLOCK + i] = value.real, value.imag
                _solve_block(w, count, l0, squares, ambient, lossless, lam, d, times_n0)
                valid = min(count, count_l - l0)
                if powers.shape[1] > 0:
                    _store_powers(w, count, valid, powers, b, angle, l0)
                if amplitudes.shape[1] > 0:
                    _store_amplitudes(w, valid, amplitudes, b, angle, l0)
