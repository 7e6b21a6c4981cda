# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""The light that the "published" counting of a platelet loses: R T of what meets a flake, summed over random walks.

What comes in is reflected, transmitted, absorbed (by flakes, resin, dye and base), or lost by the counting:
1 - R - T - A, apart from the little that a rough interface loses by itself.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.lobes.flaked import masking
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.walk_facets import facet, inner_facet, into, turned_back, upward
from nacre.families.pearl.platelet import lost_share
from nacre.families.pearl.walk_steps import MAX_EVENTS, chosen
from nacre.matter.jit import compiled
from nacre.matter.jobs import in_threads

CHUNKS = 8  # sums are taken in this order, whatever the number of threads
WALKS = 32_768  # a standard error of about 0.002
BASES = {"none": 0, "diffuse": 1, "specular": 2}


def why_not_lost(lobe: Layered) -> str | None:
    """Return why the lost light is not known, or None if it is."""
    if lobe.strata > 1:
        return "it has several strata"
    if lobe.base not in BASES:
        return "its base is another material"
    if lobe.dye_phase is not None:
        return "its dye scatters"
    if lobe.loss is not None:
        return "its interface is compensated"
    if np.any(lobe.alpha[:, 0] != lobe.alpha[:, 1]):
        return "its interface is anisotropic"
    if np.any(lobe.is_beckmann[lobe.alpha[:, 0] > 0]):
        return "its interface is of the Beckmann kind"
    return None


def lost_light(lobe: Layered, published: Array, wi: Array, walks: int = WALKS, seed: int = 0) -> Array:
    """Return the share of the light from `wi[3]` that is lost at flakes, `[wavelength]`.

    Args:
        lobe: one for which `why_not_lost` is None; its tables hold R (1 - T) where flakes are counted so.
        published: `[kind]`, bool: which kinds are.
        wi: unit vector to the light, above the surface.
        walks: their number, of all wavelengths together.
        seed: another one gives independent noise.
    """
    reflect, transmit = np.ascontiguousarray(lobe.flake_response[..., 0]), lobe.flake_response[..., 1]
    lose = lost_share(reflect, transmit) * np.asarray(published, dtype=float)[:, None, None]
    absorb = np.zeros(0) if lobe.dye is None else np.ascontiguousarray(lobe.dye[0, :, 0])
    tables = (reflect, np.ascontiguousarray(transmit), np.ascontiguousarray(lose), absorb)
    flakes = (lobe.flake_number, np.ascontiguousarray(lobe.flake_axes), np.ascontiguousarray(lobe.flake_frame))
    base = (BASES[lobe.base], np.ascontiguousarray(lobe.base_reflectance))
    faces = (float(lobe.index[0]), np.ascontiguousarray(lobe.alpha[:, 0]))

    def chunk(i: int) -> Array:
        out = np.zeros(len(lobe.wavelengths_nm))
        _lose((seed * 7919 + i) % (1 << 31), walks // CHUNKS, wi, *faces, *flakes, *tables, *base, out)
        return out

    return np.asarray(np.mean(in_threads(chunk, range(CHUNKS)), axis=0))


@compiled(nogil=True)
def _nodes(table, position, out):  # type: ignore[no-untyped-def]  # numba
    """Interpolate the rows of a table at a position counted in rows; one row serves everywhere."""
    if table.shape[0] == 1:
        out[:] = table[0]
        return
    low = min(int(position), table.shape[0] - 2)
    part = position - low
    for l in range(out.size):
        out[l] = table[low, l] + part * (table[low + 1, l] - table[low, l])


@compiled(nogil=True)
def _kept(f, share):  # type: ignore[no-untyped-def]  # numba
    """Multiply the throughputs by shares; end the walk by chance, or scale them to the sum they had."""
    before, after = 0.0, 0.0
    for l in range(f.size):
        before += f[l]
        f[l] *= share[l]
        after += f[l]
    if after <= 0.0 or np.random.random() * before >= after:
        return False
    for l in range(f.size):
        f[l] *= before / after
    return True


@compiled(nogil=True)
def _inside(dx, dy, dz, index, alpha):  # type: ignore[no-untyped-def]  # numba
    """Meet the interface above from inside, dz > 0: the direction back down, dz = 0 where light left or was masked."""
    mx, my, mz, cos, share, _ = inner_facet(dx, dy, dz, index, alpha)
    return turned_back(dx, dy, dz, mx, my, mz, cos, share, alpha)


@compiled(nogil=True)
def _lose(  # type: ignore[no-untyped-def]  # numba
    seed, count, wi, index, alpha, number, axes, frame, reflect, transmit, lose, absorb, kind, base, out
):
    """Add the mean over `count` walks of what is lost at the flakes that they meet, `out[wavelength]`.

    A walk carries all wavelengths; it is reflected, goes on or ends in proportion to what all of them together do.
    """
    np.random.seed(seed)
    f, share = np.empty(out.size), np.empty(out.size)
    go, gone = np.empty(out.size), np.empty(out.size)
    areas, local, m, d = np.zeros(number.size), np.empty(3), np.empty(3), np.empty(3)
    for _walk in range(count):
        d[0], d[1], d[2], start = into(wi[0], wi[1], wi[2], index, alpha[0], np.random.random(), np.random.random())
        if start == 0.0:
            continue
        f[:] = start / count
        depth = 0.0
        for _event in range(MAX_EVENTS):
            total = 0.0
            for k in range(number.size):
                square = 0.0
                for a in range(3):
                    along = (frame[k, 0, a] * d[0] + frame[k, 1, a] * d[1] + frame[k, 2, a] * d[2]) * axes[k, a]
                    square += along * along
                areas[k] = number[k] * math.sqrt(square)
                total += areas[k]
            before = depth
            depth = min(max(depth + d[2] * math.log(1.0 - np.random.random()) / max(total, 1e-12), 0.0), 1.0)
            if absorb.size:
                for l in range(out.size):
                    share[l] = math.exp(-absorb[l] * abs(depth - before) / max(abs(d[2]), 1e-6))
                if not _kept(f, share):
                    break
            if depth <= 0.0:
                d[0], d[1], d[2] = _inside(d[0], d[1], d[2], index, alpha[0])
                if d[2] == 0.0:
                    break
            elif depth >= 1.0:
                if kind == 0:
                    d[0], d[1], d[2] = _inside(d[0], d[1], -d[2], index, alpha[1])
                    if d[2] == 0.0:
                        break
                    d[2] = -d[2]
                elif kind == 1:
                    if not _kept(f, base[0]):
                        break
                    d[0], d[1], d[2] = upward()
                else:
                    mx, my, mz = facet(-d[0], -d[1], -d[2], alpha[1], np.random.random(), np.random.random())
                    cos = -(d[0] * mx + d[1] * my + d[2] * mz)
                    _nodes(base, min(cos, 1.0) * (base.shape[0] - 1), share)
                    d[0], d[1], d[2] = d[0] + 2.0 * cos * mx, d[1] + 2.0 * cos * my, d[2] + 2.0 * cos * mz
                    if d[2] <= 1e-6 or (alpha[1] > 0.0 and np.random.random() >= masking(d[2], alpha[1])):
                        break
                    if not _kept(f, share):
                        break
            else:
                k = chosen(areas, total)
                # a normal that the light sees: a cosine-distributed vector about S^(1/2) d, mapped by S^(1/2)
                length = 0.0
                for a in range(3):
                    local[a] = (frame[k, 0, a] * d[0] + frame[k, 1, a] * d[1] + frame[k, 2, a] * d[2]) * axes[k, a]
                    length += local[a] * local[a]
                length = math.sqrt(length)
                z, phi = 2.0 * np.random.random() - 1.0, 2.0 * math.pi * np.random.random()
                side = math.sqrt(1.0 - z * z)
                local[0] = axes[k, 0] * (local[0] * (1.0 + 1e-9) / length + side * math.cos(phi))
                local[1] = axes[k, 1] * (local[1] * (1.0 + 1e-9) / length + side * math.sin(phi))
                local[2] = axes[k, 2] * (local[2] * (1.0 + 1e-9) / length + z)
                length, cos = math.sqrt(local[0] ** 2 + local[1] ** 2 + local[2] ** 2), 0.0
                for a in range(3):
                    m[a] = (frame[k, a, 0] * local[0] + frame[k, a, 1] * local[1] + frame[k, a, 2] * local[2]) / length
                    cos += m[a] * d[a]
                at = math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[1] - 1)
                _nodes(reflect[k], at, share)
                _nodes(transmit[k], at, go)
                _nodes(lose[k], at, gone)
                carried, back, on = 0.0, 0.0, 0.0
                for l in range(out.size):
                    carried += f[l]
                    back += f[l] * share[l]
                    on += f[l] * go[l]
                choice = np.random.random() * carried
                if choice < back:
                    for l in range(out.size):
                        f[l] *= share[l] * carried / back
                    for a in range(3):
                        d[a] -= 2.0 * cos * m[a]
                    if abs(d[2]) < 1e-9:
                        d[2] = 1e-9
                elif choice < back + on:
                    for l in range(out.size):
                        f[l] *= go[l] * carried / on
                else:  # counted where walks end, which varies less than a part of each event
                    for l in range(out.size):
                        out[l] += f[l] * gone[l] * carried / (carried - back - on)
                    break
