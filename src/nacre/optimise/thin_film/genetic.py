"""Genetic operators of stacks, compiled: random stacks, mutation, crossover, and refinement of the offspring.

Each generation creates offspring of the population and improves each by descents (memetic algorithm). Offspring that
stay far behind the population are dropped early. An individual is a random stack, or a parent with some mutations:
another material, a layer more or less, swapped layers, changed thicknesses, a crossover with another parent, another
substrate.

Hand-written and compiled because one evaluation takes microseconds, less than a call of a library.
"""

# ruff: noqa: NPY002  (in compiled code these are numba's own generators, one per thread, seeded by each batch)
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.matter.stack.thickness_gradient import spectra_and_gradients
from nacre.optimise.thin_film.levenberg_marquardt import descend, keep_total
from nacre.optimise.thin_film.merit_kernel import failure_share, lab_of

FIRST_STEPS, FULL_STEPS, WORST_STEPS = 5, 14, 14  # steps in the three descents of an individual
WORST_POWER = 8.0  # exponent of the last descent, which lowers the worst term
MAX_RATIO, MAX_FULL_RATIO = 1.6, 1.12  # largest score over the population's worst, after two descents
SHIFT_SHARE = 0.4  # share of individuals with shifted thicknesses only, in a search for yield
NOMINAL_SHARE = 0.03  # weight of the nominal objective in the score of a search for yield
DRAWS = 6  # random stacks of which the best becomes an individual


class Space(NamedTuple):
    """Allowed stacks. Media are numbered as in the tables: 0 is the ambient, then palette and substrates.

    Attributes:
        choices: `[slot, k]`, media of a slot, from the top; all slots of an open stack are alike.
        choice_count: `[slot]`.
        low, high: `[slot, medium]`, bounds, nm.
        is_metal: `[medium]`; metals are drawn thin.
        substrates: `[k]`.
        is_open: `[1]`, whether number and order of layers vary; otherwise each slot is a layer.
        total: `[1]`, largest total thickness, nm.
        relative, absolute: `[slot]`, manufacturing standard deviations: relative, and in nm.
        draws: `[draw, slot]`, standard normal numbers for the yield; empty without tolerances.
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
    """Return arrays for `size` stacks."""
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
    """Copy a stack by loops: for a slice numba would also compile the text of its shape error."""
    for j in range(len(d)):
        to_media[j] = media[j]
        to_d[j] = d[j]


@compiled(error_model="numpy")
def _pick(space: Any, slot: int) -> int:
    return space.choices[slot, np.random.randint(space.choice_count[slot])]


@compiled(error_model="numpy")
def _pick_substrate(space: Any) -> int:
    return space.substrates[np.random.randint(space.substrates.shape[0])]


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
    """Draw a random stack into `media` and `d`; return layer count and substrate."""
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
    return layers, _pick_substrate(space)


@compiled(error_model="numpy")
def tidy(space: Any, media: Any, d: Any, layers: int) -> int:
    """Merge equal neighbours of an open stack and clip to the bounds; return the layer count."""
    if space.is_open[0]:
        count = 0
        for j in range(layers):
            if count > 0 and media[count - 1] == media[j]:
                d[count - 1] += d[j]
            else:
                media[count] = media[j]
                d[count] = d[j]
                count += 1
        layers = min(count, space.choices.shape[0])
    for j in range(layers):
        d[j] = min(max(d[j], space.low[j, media[j]]), space.high[j, media[j]])
    return layers


@compiled(error_model="numpy")
def fill_bounds(space: Any, media: Any, layers: int, low: Any, high: Any) -> None:
    """Fill the layer bounds."""
    for j in range(layers):
        low[j] = space.low[j, media[j]]
        high[j] = space.high[j, media[j]]


@compiled(error_model="numpy")
def _mutate_order(space: Any, media: Any, d: Any, layers: int, operator: int) -> int:
    """Insert, split, remove or swap layers of an open stack; return the layer count, -1 if not applicable."""
    slots = space.choices.shape[0]
    if operator == 1 and layers < slots:  # insert
        at = np.random.randint(layers + 1)
        for j in range(layers, at, -1):
            media[j] = media[j - 1]
            d[j] = d[j - 1]
        media[at] = _pick(space, 0)
        d[at] = _thickness(space, 0, media[at])
        if np.random.random() < 0.5:
            d[at] = min(d[at], space.low[0, media[at]] + 5.0)
        return layers + 1
    if operator == 2 and layers + 2 <= slots:  # split by a thin layer of another material
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
        return layers + 2
    if operator == 3 and layers > 1:  # remove
        at = np.random.randint(layers)
        for j in range(at, layers - 1):
            media[j] = media[j + 1]
            d[j] = d[j + 1]
        return layers - 1
    if operator == 4 and layers > 1:  # swap
        at = np.random.randint(layers - 1)
        media[at], media[at + 1] = media[at + 1], media[at]
        d[at], d[at + 1] = d[at + 1], d[at]
        return layers
    return -1


@compiled(error_model="numpy")
def _cross(space: Any, media: Any, d: Any, layers: int, mate_media: Any, mate_d: Any, mate_layers: int) -> int:
    """Crossover: place the upper part of a mate on the lower part of a stack; return the layer count."""
    if space.is_open[0]:
        slots = space.choices.shape[0]
        cut = 1 + np.random.randint(layers)  # layers from below
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
    return layers


@compiled(error_model="numpy")
def _mutate_layer(space: Any, media: Any, d: Any, layers: int, operator: int) -> None:
    """Redraw one thickness, perturb all thicknesses, or draw another material."""
    if layers == 0:
        return
    if operator == 7:
        size = 0.05 * math.exp(2.3 * np.random.random())
        for j in range(layers):
            d[j] *= math.exp(size * np.random.normal())
        return
    at = np.random.randint(layers)
    if operator != 6:
        media[at] = _pick(space, at)
    if operator == 6 or np.random.random() < 0.5 or space.is_metal[media[at]]:
        d[at] = _thickness(space, at, media[at])


@compiled(error_model="numpy")
def _mutate(
    space: Any, media: Any, d: Any, layers: int, substrate: int, mate_media: Any, mate_d: Any, mate_layers: int
) -> tuple[int, int]:
    """Apply one random operator; `media` and `d` have two slots more than the space. Return layers and substrate."""
    operator = np.random.randint(10)
    if operator == 0 and space.substrates.shape[0] > 1:
        return layers, _pick_substrate(space)
    if 1 <= operator <= 4 and space.is_open[0]:
        count = _mutate_order(space, media, d, layers, operator)
        if count >= 0:
            return count, substrate
    if operator == 5 and mate_layers > 0:
        return _cross(space, media, d, layers, mate_media, mate_d, mate_layers), substrate
    _mutate_layer(space, media, d, layers, operator)
    return layers, substrate


@compiled(error_model="numpy", inline="always")
def _inherit(space: Any, population: Any, size: int, media: Any, d: Any) -> tuple[int, int, bool]:
    """Fill a mutated copy of a parent; return layers, substrate, and whether only its thicknesses are shifted."""
    share = np.random.random()
    parent = int(size * share * share)
    mate = np.random.randint(size)
    layers, substrate = population.layers[parent], population.substrate[parent]
    for j in range(layers):
        media[j] = population.media[parent, j]
        d[j] = population.d[parent, j]
    if space.draws.shape[0] > 0 and population.score[parent] < 1.5 and np.random.random() < SHIFT_SHARE:
        # without a descent, which does not know the yield
        width = 0.003 * math.exp(3.0 * np.random.random())
        for j in range(layers):
            d[j] *= math.exp(width * np.random.normal())
        return layers, substrate, True
    mutations = 1
    while mutations < 4 and np.random.random() < 0.45:
        mutations += 1
    for _ in range(mutations):
        layers, substrate = _mutate(
            space, media, d, layers, substrate, population.media[mate], population.d[mate], population.layers[mate]
        )
        layers = tidy(space, media, d, layers)
    return layers, substrate, False


@compiled(error_model="numpy")
def _descent(stage: int) -> tuple[int, float, float]:
    """Return steps, power and the largest ratio to the population's worst, for a refinement stage."""
    if stage == 0:
        return FIRST_STEPS, 2.0, MAX_RATIO
    if stage == 1:
        return FULL_STEPS, 2.0, MAX_FULL_RATIO
    if stage == 2:
        return WORST_STEPS, WORST_POWER, np.inf
    return (-1 if stage == 3 else 0), 2.0, np.inf  # gradients only; evaluation of a random stack


@compiled(error_model="numpy")
def _score_with_yield(space: Any, merit: Any, s: Any, nominal: float, d: Any, layers: int, sigma: Any) -> float:
    """Return the failure share; 1 plus the nominal objective for a stack out of tolerance."""
    for j in range(layers):
        sigma[j] = math.hypot(space.relative[j] * d[j], space.absolute[j])
    failed = failure_share(merit, s.r, s.jacobian, layers, sigma, space.draws)
    return 1.0 + nominal if nominal > 1.0 else failed + NOMINAL_SHARE * nominal


class Scratch(NamedTuple):
    """Working memory of an individual: the trial and the best random stack; bounds and deviations."""

    media: Any
    d: Array


@compiled(error_model="numpy", nogil=True, inline="always")
def _individual(
    tables: Any, merit: Any, space: Any, population: Any, size: int, fresh_share: float, target: float, s: Any,
    media: Any, d: Any, work: Any,
) -> tuple[float, int, int]:  # fmt: skip
    """Fill a new individual into `media` and `d`, refined; return score (infinite if dropped), layers and substrate."""
    is_robust = space.draws.shape[0] > 0
    last = population.score[size - 1] if size > 0 else np.inf
    if is_robust:
        last = max(last - 1.0, 1.0)  # nominal objective, see `_score_with_yield`
    draws = DRAWS if size < 4 or np.random.random() < fresh_share else 0
    score = best = np.inf
    layers, substrate, best_layers, best_substrate = 0, 0, 0, 0
    first = -draws
    if draws == 0:
        layers, substrate, is_shifted = _inherit(space, population, size, media, d)
        first = 3 if is_shifted else 0
    # a single call of the descent for random stacks (no steps), every stage and the gradients: numba compiles each call
    is_done = False
    for stage in range(first, 4 if is_robust else 3):
        if is_done and stage < 3:
            continue
        steps, p, max_ratio = _descent(stage)
        if stage < 0:
            n, base = draw(space, work.media[0], work.d[0])
        else:
            if stage == 0 and draws > 0:
                _copy(work.media[1], work.d[1], media, d)
                layers, substrate = best_layers, best_substrate
            n, base = layers, substrate
            _copy(media, d, work.media[0], work.d[0])
        fill_bounds(space, work.media[0], n, work.d[2], work.d[3])
        score = descend(
            tables, merit, work.media[0], work.d[0], work.d[2], work.d[3], n, base, space.total[0], steps, p, s
        )
        if stage < 0:
            if score < best:
                best, best_layers, best_substrate = score, n, base
                _copy(work.media[0], work.d[0], work.media[1], work.d[1])
            continue
        _copy(work.media[0], work.d[0], media, d)
        if stage < 3 and (score < target or (stage == 1 and merit.kind.shape[0] == 1)):
            is_done = True
        elif stage < 2 and size >= 4 and score > max_ratio * last:
            return np.inf, layers, substrate
    if is_robust:
        score = _score_with_yield(space, merit, s, score, d, layers, work.d[4])
    return score, layers, substrate


@compiled(error_model="numpy", nogil=True)
def evolve(
    tables: Any, merit: Any, space: Any, population: Any, size: int, count: int, fresh_share: float, target: float,
    seed: int, s: Any, out: Any,
) -> int:  # fmt: skip
    """Create and refine offspring of the first `size` stacks of a population (best first); return how many remain.

    Args:
        count: individuals to begin.
        fresh_share: share of random stacks.
        target: objective at which the batch ends at once.
        seed: batch seed.
        s: `Workspace` for `slots + 2` layers.
        out: `Population` for `count` stacks; filled from its start.
    """
    np.random.seed(seed)
    slots = space.choices.shape[0] + 3
    media, d = np.zeros(slots, dtype=np.int64), np.zeros(slots)
    work = Scratch(np.zeros((2, slots), dtype=np.int64), np.zeros((5, slots)))
    kept = 0
    for _ in range(count):
        score, layers, substrate = _individual(
            tables, merit, space, population, size, fresh_share, target, s, media, d, work
        )
        if score == np.inf:
            continue
        out.score[kept] = score
        out.layers[kept] = layers
        out.substrate[kept] = substrate
        for j in range(layers):
            out.media[kept, j] = media[j]
            out.d[kept, j] = d[j]
        kept += 1
        if score < target:
            break
    return kept


@compiled(error_model="numpy", nogil=True)
def draw_many(tables: Any, merit: Any, space: Any, seed: int, s: Any, out: Any, labs: Any) -> None:
    """Fill a `Brood` with draws, and `labs[k, term, 3]` with the colours for its terms."""
    np.random.seed(seed)
    slots = space.choices.shape[0]
    media, d, low, high = np.zeros(slots + 3, dtype=np.int64), np.zeros(slots + 3), np.zeros(slots + 3), np.zeros(slots)
    for k in range(out.score.shape[0]):
        layers, substrate = draw(space, media, d)
        fill_bounds(space, media, layers, low, high)
        keep_total(d, low, layers, space.total[0])
        with_gradients = layers < 0  # a literal False would be another type, compiled once more
        spectra_and_gradients(tables, media, d, layers, substrate, with_gradients, s.w, s.spectra, s.slopes)
        for t in range(merit.kind.shape[0]):
            l, a, b = lab_of(merit, s.spectra[merit.row[t]], merit.lamp[t])
            labs[k, t, 0], labs[k, t, 1], labs[k, t, 2] = l, a, b
        out.layers[k], out.substrate[k] = layers, substrate
        for j in range(layers):
            out.media[k, j] = media[j]
            out.d[k, j] = d[j]


@compiled(error_model="numpy", fastmath={"contract", "reassoc"}, nogil=True)
def nearest(labs: Any, wanted: Any, metric: Any, scale: Any, best: Any, at: Any) -> None:
    """Find the draws whose worst term is nearest, by the local colour metric.

    Args:
        labs: `[k, term, 3]`.
        wanted: `[term, 3]`.
        metric: `[term, 3, 3]`: its product with a difference has the length of dE00.
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
