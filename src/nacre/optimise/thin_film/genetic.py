"""Drawing stacks, and breeding better ones from good ones: changed, cut, crossed, then refined. Compiled.

A search is a series of litters: `breed` makes children of a pool, gives each a few steps of descent, drops those that
stay far behind the pool, and refines the rest to the end. A child is a new draw, or a parent with a few of these: a
layer of another material, one more layer, one less, two layers swapped, thicknesses shaken, one drawn anew, the upper
part of one parent on the lower part of another, another substrate.
"""

# ruff: noqa: NPY002  (inside compiled code these are numba's own generators, one a thread, seeded by each litter)
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.matter.stack.thickness_gradient import spectra_and_gradients
from nacre.optimise.thin_film.levenberg_marquardt import descend, keep_total
from nacre.optimise.thin_film.merit_kernel import lab_of, share_outside

QUICK_STEPS = 5
FULL_STEPS = 14
WORST_STEPS = 14  # with p = 8, on those that are worth it
WORST_POWER = 8.0
SETTLING = 0.4  # share of children that only shift a good stack's thicknesses, where the yield counts
NOMINAL_SHARE = 0.03  # of the nominal distance in the rank by yield
DRAWS = 6  # looked at for one that is refined
BEHIND = 1.6  # times the pool's last: a child further behind after the quick steps is dropped
STRANDED = 1.12  # the same after the full steps


class Space(NamedTuple):
    """What a stack may be made of. Media are numbered as in the tables: 0 is the ambient, then palette and substrates.

    Attributes:
        choices: `[slot, k]`, media that may stand in a slot (from the top); of an open stack all slots are alike.
        choice_count: `[slot]`.
        low, high: `[slot, medium]`, bounds, nm.
        is_metal: `[medium]`: drawn thin rather than thick.
        substrates: `[k]`.
        is_open: `[1]`, whether count and order are free; if not, each slot is a layer.
        total: `[1]`, bound of the sum of thicknesses, nm.
        relative, absolute: `[slot]`, standard deviations in manufacture: share of a thickness, and nm.
        draws: `[draw, slot]`, standard normal numbers for the yield, none where it is not asked for.
    """

    choices: Any
    choice_count: Any
    low: Array
    high: Array
    is_metal: Any
    substrates: Any
    is_open: Any
    total: Array
    relative: Array
    absolute: Array
    draws: Array


class Population(NamedTuple):
    """Stacks in arrays: `media[k, slot]`, `d[k, slot]` in nm, `layers[k]`, `substrate[k]`, `score[k]`."""

    media: Any
    d: Array
    layers: Any
    substrate: Any
    score: Array


def empty_population(size: int, slots: int) -> Population:
    """Return room for so many stacks."""
    n = max(slots, 1)
    return Population(
        np.zeros((size, n), dtype=np.int64),
        np.zeros((size, n)),
        np.zeros(size, dtype=np.int64),
        np.zeros(size, dtype=np.int64),
        np.full(size, np.inf),
    )


@compiled(error_model="numpy")
def _copy(media: Any, d: Any, to_media: Any, to_d: Any) -> None:
    """Copy a stack by loops: of a slice numba would compile the words of its shape error too."""
    for j in range(len(d)):
        to_media[j] = media[j]
        to_d[j] = d[j]


@compiled(error_model="numpy")
def _pick(space: Any, slot: int) -> int:
    return space.choices[slot, np.random.randint(space.choice_count[slot])]


@compiled(error_model="numpy")
def _thickness(space: Any, slot: int, medium: int) -> float:
    low, high = space.low[slot, medium], space.high[slot, medium]
    if high <= low:
        return low
    if space.is_metal[medium] or np.random.random() < 0.25:
        start = max(low, 1.0)
        return min(max(start * math.exp(np.random.random() * math.log(max(high, start) / start)), low), high)
    return low + (high - low) * np.random.random()


@compiled(error_model="numpy")
def draw(space: Any, media: Any, d: Any) -> tuple[int, int]:
    """Draw a stack into `media` and `d`; return how many layers and which substrate."""
    slots = space.choices.shape[0]
    layers = slots
    if space.is_open[0]:
        # more layers reach more colours: the larger of two draws
        layers = max(1 + np.random.randint(slots), 1 + np.random.randint(slots))
    before = -1
    for j in range(layers):
        medium = _pick(space, j)
        if space.is_open[0] and space.choice_count[j] > 1:
            while medium == before:
                medium = _pick(space, j)
        media[j] = medium
        d[j] = _thickness(space, j, medium)
        before = medium
    return layers, space.substrates[np.random.randint(space.substrates.shape[0])]


@compiled(error_model="numpy")
def tidy(space: Any, media: Any, d: Any, layers: int) -> int:
    """Merge equal neighbours of an open stack and keep all bounds; return the number of layers left."""
    if space.is_open[0]:
        kept = 0
        for j in range(layers):
            if kept > 0 and media[kept - 1] == media[j]:
                d[kept - 1] += d[j]
            else:
                media[kept] = media[j]
                d[kept] = d[j]
                kept += 1
        layers = min(kept, space.choices.shape[0])
    for j in range(layers):
        d[j] = min(max(d[j], space.low[j, media[j]]), space.high[j, media[j]])
    return layers


@compiled(error_model="numpy")
def bounds_of(space: Any, media: Any, layers: int, low: Any, high: Any) -> None:
    """Fill the bounds of a stack's layers."""
    for j in range(layers):
        low[j] = space.low[j, media[j]]
        high[j] = space.high[j, media[j]]


@compiled(error_model="numpy")
def _change(
    space: Any, media: Any, d: Any, layers: int, substrate: int, mate_media: Any, mate_d: Any, mate_layers: int
) -> tuple[int, int]:
    """Change a stack in one way; `media` and `d` have two slots more than the space."""
    slots = space.choices.shape[0]
    is_open = space.is_open[0]
    way = np.random.randint(10)
    if way == 0 and space.substrates.shape[0] > 1:
        return layers, space.substrates[np.random.randint(space.substrates.shape[0])]
    if way == 1 and is_open and layers < slots:  # one more
        at = np.random.randint(layers + 1)
        for j in range(layers, at, -1):
            media[j] = media[j - 1]
            d[j] = d[j - 1]
        media[at] = _pick(space, 0)
        d[at] = _thickness(space, 0, media[at])
        if np.random.random() < 0.5:
            d[at] = min(d[at], space.low[0, media[at]] + 5.0)
        return layers + 1, substrate
    if way == 2 and is_open and layers + 2 <= slots:  # split a layer by another material
        at = np.random.randint(layers)
        for j in range(layers + 1, at + 1, -1):
            media[j] = media[j - 2]
            d[j] = d[j - 2]
        share = np.random.random()
        media[at + 1] = _pick(space, 0)
        d[at + 1] = min(_thickness(space, 0, media[at + 1]), 20.0)
        media[at + 2] = media[at]
        d[at + 2] = (1.0 - share) * d[at]
        d[at] *= share
        return layers + 2, substrate
    if way == 3 and is_open and layers > 1:  # one less
        at = np.random.randint(layers)
        for j in range(at, layers - 1):
            media[j] = media[j + 1]
            d[j] = d[j + 1]
        return layers - 1, substrate
    if way == 4 and is_open and layers > 1:  # swap
        at = np.random.randint(layers - 1)
        media[at], media[at + 1] = media[at + 1], media[at]
        d[at], d[at + 1] = d[at + 1], d[at]
        return layers, substrate
    if way == 5 and mate_layers > 0:  # the mate's upper part on this lower part
        if is_open:
            cut = 1 + np.random.randint(layers)  # layers kept from below
            take = min(1 + np.random.randint(mate_layers), slots - min(cut, slots - 1))
            cut = min(cut, slots - take)
            first = layers - cut
            if first < take:
                for j in range(cut - 1, -1, -1):
                    media[take + j] = media[first + j]
                    d[take + j] = d[first + j]
            else:
                for j in range(cut):
                    media[take + j] = media[first + j]
                    d[take + j] = d[first + j]
            layers = take + cut
        else:
            take = 1 + np.random.randint(layers)
        for j in range(take):
            media[j] = mate_media[j]
            d[j] = mate_d[j]
        return layers, substrate
    if way == 6 and layers > 0:  # one thickness anew
        at = np.random.randint(layers)
        d[at] = _thickness(space, at, media[at])
        return layers, substrate
    if way == 7 and layers > 0:  # all thicknesses shaken
        size = 0.05 * math.exp(2.3 * np.random.random())
        for j in range(layers):
            d[j] *= math.exp(size * np.random.normal())
        return layers, substrate
    if layers > 0:  # another material
        at = np.random.randint(layers)
        media[at] = _pick(space, at)
        if np.random.random() < 0.5 or space.is_metal[media[at]]:
            d[at] = _thickness(space, at, media[at])
    return layers, substrate


@compiled(error_model="numpy")
def _with_yield(nominal: float, missed: float) -> float:
    """Rank by what is missed in manufacture; a nominal stack out of tolerance counts 1 and how far out it is."""
    return 1.0 + nominal if nominal > 1.0 else missed + NOMINAL_SHARE * nominal


@compiled(error_model="numpy", nogil=True)
def evolve(
    tables: Any,
    looks: Any,
    space: Any,
    pool: Any,
    pool_size: int,
    children: int,
    fresh: float,
    target: float,
    seed: int,
    s: Any,
    out: Any,
) -> int:
    """Make children of the first `pool_size` stacks of `pool` (best first) and refine them; return how many are kept.

    Args:
        children: how many are begun.
        fresh: share of them drawn anew.
        target: an objective at which the litter ends at once.
        seed: of this litter.
        s: `Workspace` for `slots + 2` layers.
        out: `Brood` with room for `children`; filled from its start.
    """
    np.random.seed(seed)
    slots = space.choices.shape[0]
    media, d = np.zeros(slots + 3, dtype=np.int64), np.zeros(slots + 3)
    trial_media, trial_d = np.zeros(slots + 3, dtype=np.int64), np.zeros(slots + 3)
    best_media, best_d = np.zeros(slots + 3, dtype=np.int64), np.zeros(slots + 3)
    best_layers, best_substrate = 0, 0
    low, high = np.zeros(slots + 3), np.zeros(slots + 3)
    total = space.total[0]
    last = pool.score[pool_size - 1] if pool_size > 0 else np.inf
    is_many, is_robust = looks.kind.shape[0] > 1, space.draws.shape[0] > 0
    if is_robust:
        last = max(last - 1.0, 1.0)  # of the nominal stack: see `_with_yield`
    sigma = np.zeros(slots + 3)
    kept = 0
    for _ in range(children):
        tries = DRAWS if pool_size < 4 or np.random.random() < fresh else 0
        found = best = np.inf
        layers, substrate = 0, 0
        first = -tries
        if tries == 0:
            share = np.random.random()
            parent = int(pool_size * share * share)
            mate = np.random.randint(pool_size)
            layers, substrate = pool.layers[parent], pool.substrate[parent]
            for j in range(layers):
                media[j] = pool.media[parent, j]
                d[j] = pool.d[parent, j]
            if is_robust and pool.score[parent] < 1.5 and np.random.random() < SETTLING:
                # a step of its own, not of the descent, which knows nothing of the yield
                first = 3
                size = 0.003 * math.exp(3.0 * np.random.random())
                for j in range(layers):
                    d[j] *= math.exp(size * np.random.normal())
            else:
                changes = 1
                while changes < 4 and np.random.random() < 0.45:
                    changes += 1
                for _ in range(changes):
                    layers, substrate = _change(
                        space, media, d, layers, substrate, pool.media[mate], pool.d[mate], pool.layers[mate]
                    )
                    layers = tidy(space, media, d, layers)
        # one place that calls the descent, for looking at draws (no steps), for each stage of refinement and for the
        # slopes: numba compiles what it calls anew at every call
        is_done = False
        for stage in range(first, 4 if is_robust else 3):
            if is_done and stage < 3:
                continue
            steps, p, limit = 0, 2.0, np.inf
            if stage < 0:
                n, base = draw(space, trial_media, trial_d)
            else:
                if stage == 0 and tries > 0:
                    _copy(best_media, best_d, media, d)
                    layers, substrate = best_layers, best_substrate
                n, base = layers, substrate
                _copy(media, d, trial_media, trial_d)
                # fall first, then, of many goals, lower the worst
                if stage == 0:
                    steps, limit = QUICK_STEPS, BEHIND
                elif stage == 1:
                    steps, limit = FULL_STEPS, STRANDED
                elif stage == 2:
                    steps, p = WORST_STEPS, WORST_POWER
                else:
                    steps = -1
            bounds_of(space, trial_media, n, low, high)
            found = descend(tables, looks, trial_media, trial_d, low, high, n, base, total, steps, p, s)
            if stage < 0:
                if found < best:
                    best, best_layers, best_substrate = found, n, base
                    _copy(trial_media, trial_d, best_media, best_d)
                continue
            _copy(trial_media, trial_d, media, d)
            if stage < 3 and (found < target or (stage == 1 and not is_many)):
                is_done = True
            elif stage < 2 and pool_size >= 4 and found > limit * last:
                found = np.inf
                break
        if found == np.inf:
            continue
        if is_robust:
            for j in range(layers):
                sigma[j] = math.hypot(space.relative[j] * d[j], space.absolute[j])
            found = _with_yield(found, share_outside(looks, s.r, s.jacobian, layers, sigma, space.draws))
        out.score[kept] = found
        out.layers[kept] = layers
        out.substrate[kept] = substrate
        for j in range(layers):
            out.media[kept, j] = media[j]
            out.d[kept, j] = d[j]
        kept += 1
        if found < target:
            break
    return kept


@compiled(error_model="numpy", nogil=True)
def draw_many(tables: Any, looks: Any, space: Any, seed: int, s: Any, out: Any, labs: Any) -> None:
    """Fill a `Brood` with draws, and `labs[k, term, 3]` with the colours that its terms look at."""
    np.random.seed(seed)
    slots = space.choices.shape[0]
    media, d, low, high = np.zeros(slots + 3, dtype=np.int64), np.zeros(slots + 3), np.zeros(slots + 3), np.zeros(slots)
    for k in range(out.score.shape[0]):
        layers, substrate = draw(space, media, d)
        bounds_of(space, media, layers, low, high)
        keep_total(d, low, layers, space.total[0])
        wants_slopes = layers < 0  # a literal False would be another type, and all of it compiled once more
        spectra_and_gradients(tables, media, d, layers, substrate, wants_slopes, s.w, s.spectra, s.slopes)
        for t in range(looks.kind.shape[0]):
            l, a, b = lab_of(looks, s.spectra[looks.row[t]], looks.lamp[t])
            labs[k, t, 0], labs[k, t, 1], labs[k, t, 2] = l, a, b
        out.layers[k], out.substrate[k] = layers, substrate
        for j in range(layers):
            out.media[k, j] = media[j]
            out.d[k, j] = d[j]


@compiled(error_model="numpy", fastmath={"contract", "reassoc"}, nogil=True)
def nearest(labs: Any, wanted: Any, metric: Any, scale: Any, best: Any, at: Any) -> None:
    """Find the draws whose worst goal is nearest, by the local metric of each.

    Args:
        labs: `[k, term, 3]`.
        wanted: `[term, 3]`.
        metric: `[term, 3, 3]`: its product with a difference has the length of the dE00.
        scale: `[term]`.
        best, at: outputs, squared distances and numbers of the nearest, ascending.
    """
    best[:] = np.inf
    last = len(best) - 1
    for k in range(labs.shape[0]):
        worst = 0.0
        for t in range(labs.shape[1]):
            l, a, b = labs[k, t, 0] - wanted[t, 0], labs[k, t, 1] - wanted[t, 1], labs[k, t, 2] - wanted[t, 2]
            x = metric[t, 0, 0] * l + metric[t, 0, 1] * a + metric[t, 0, 2] * b
            y = metric[t, 1, 0] * l + metric[t, 1, 1] * a + metric[t, 1, 2] * b
            z = metric[t, 2, 0] * l + metric[t, 2, 1] * a + metric[t, 2, 2] * b
            worst = max(worst, scale[t] * scale[t] * (x * x + y * y + z * z))
        if worst < best[last]:
            i = last
            while i > 0 and best[i - 1] > worst:
                best[i] = best[i - 1]
                at[i] = at[i - 1]
                i -= 1
            best[i] = worst
            at[i] = k
