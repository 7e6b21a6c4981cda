"""What can be reached: the colours that a material's free numbers make at one geometry, and the structure under each.

Shares are of colours, not of area: of the colours of a solid (all that sRGB shows, all that a surface can have under
the lamp), spread evenly over its volume in CIELAB, how many lie within a dE00 of one that is reached.
"""

from __future__ import annotations

import functools
import html
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.light import (
    SRGB_WHITE_XYZ,
    adapt_xyz,
    delta_e_2000,
    lab_to_xyz,
    spectrum_to_xyz,
    srgb_linear_to_xyz,
    table_wavelengths_nm,
    white_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
    xyz_to_xyy,
    xyz_weights,
)
from nacre.material.material import Material
from nacre.matter.stack.solve import powers
from nacre.optimise.evaluation import lab_hex
from nacre.optimise.measurement import Geometry, check_answers, search_wavelengths, simulate_measurement
from nacre.optimise.parameters import Parameter, nominal_point, read_parameters, values_at
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import check_light
from nacre.optimise.task import DesignTask
from nacre.optimise.thin_film.adapter import ThinFilmSearch, thin_film_search
from nacre.recipe.model import RecipeContext

if TYPE_CHECKING:
    from nacre.plot import Figure


EVEN_SHARE = 0.5  # of the points are drawn evenly; the others around those at the rim
RIM_STEP = 0.12  # of the bounds: how far a point of the rim is moved
HUES = 36  # directions in which the rim is pushed outward
SOLID_POINTS, BATCH = 1200, 2048
NEIGHBOURS = 12
LIMIT_STEP_NM = 10.0  # of the optimal colours' edges
OTHER_LOOKS = ("45as15", "45as45", "transmitted 0")  # tried in turn where the usual one is not answered
SECONDS = 60.0  # unless told; films are done with in a few
LEAST_POINTS, MOST_POINTS = 8, 1_000_000


@dataclass(frozen=True, eq=False)
class Gamut:
    """The colours that can be reached.

    Attributes:
        at: the geometry.
        illuminant, observer: of the colours.
        lab: `[point, 3]`; xyy: `[point, 3]`, chromaticity and luminance (white has 1).
        structures: the free numbers and words of each point, by path.
        within: the dE00 that counts as reached.
        share_of_srgb: of the colours of sRGB, how many lie within that of a point.
        share_of_optimal: the same of the optimal colours, the limits of MacAdam: all that a reflectance can be.
        failed: points that could not be computed.
        possible: all that there are where only words and whole numbers are free; None: without end.
    """

    at: str
    illuminant: str
    observer: str
    lab: Array
    xyy: Array
    structures: list[dict[str, Any]]
    within: float
    share_of_srgb: float
    share_of_optimal: float
    failed: int
    possible: int | None = None

    def document(self) -> dict[str, Any]:
        """Return it as JSON can hold it."""
        white = white_xyz(self.illuminant, self.observer)
        points = [
            {"lab": lab.tolist(), "xyY": xyy.tolist(), "colour": lab_hex(lab, white), "structure": structure}
            for lab, xyy, structure in zip(self.lab, self.xyy, self.structures, strict=True)
        ]
        return {
            "at": self.at,
            "illuminant": self.illuminant,
            "observer": self.observer,
            "within": self.within,
            "share_of_srgb": self.share_of_srgb,
            "share_of_optimal": self.share_of_optimal,
            "count": len(points),
            "failed": self.failed,
            "points": points,
        }


def parse_parameters(options: Iterable[str]) -> dict[str, Any]:
    """Read `PATH=A:B` (bounds) and `PATH=a,b,c` (choices) into a table as `[free]` has it.

    Raises:
        RecipeError: an option is written otherwise.
    """
    found: dict[str, Any] = {}
    for option in options:
        path, equals, text = option.rpartition("=")
        if not equals or not path.strip() or not text.strip():
            raise RecipeError(
                f'--free "{option}" cannot be read; write it like layers[0].thickness_nm=50:400 or substrate=Al,Ag'
            )
        if path.strip() in found:
            raise RecipeError(f"--free {path.strip()} is given twice; keep one")
        ends = text.split(":")
        try:
            found[path.strip()] = [float(ends[0]), float(ends[1])] if len(ends) == 2 else None
        except ValueError:
            found[path.strip()] = None
        if found[path.strip()] is None:
            found[path.strip()] = {"choices": [_word(word) for word in text.split(",")]}
    return found


def _word(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def find_gamut(
    material: Material,
    free: Mapping[str, Any],
    at: str | None = None,
    *,
    points: int = 1000,
    seconds: float = SECONDS,
    illuminant: str = "D65",
    observer: str = "10deg",
    within: float = 2.0,
    samples: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Gamut:
    """Return the colours that a material's free numbers reach at a geometry.

    Half of the points are drawn evenly, the others around those that lie farthest out, hue by hue.

    Args:
        free: path -> bounds or choices, as the table `[free]` of a design.
        at: "specular 0", "45as15" and so on, as in a want; None: what shows a family's colour, such as the mirror of a
            film, light from 45 degrees that is seen from the normal of a photonic glass, or near the mirror of a pearl
            or a relief; or another that the recipe answers.
        points: number of materials; fewer where the seconds are up.
        seconds: after which what is there is told.
        within: dE00 within which a colour counts as reached.
        samples: of random walks.
        progress: called with (done, points).

    Raises:
        NacreError: the geometry or a path is not known, or no point can be computed.
    """
    source = material.context.source
    if not LEAST_POINTS <= points <= MOST_POINTS:
        raise NacreError(f"--points = {points} must lie in [{LEAST_POINTS}, {MOST_POINTS}]")
    if not within > 0:
        raise NacreError(f"--within = {within:g} must be above 0")
    check_light(LightSpec(illuminants=[illuminant], observer=observer), RecipeContext(source))
    material = material.at_low_fidelity().with_parts_loaded(free)
    numbers = read_parameters(dict(free), material, source)
    if not numbers:
        raise RecipeError(f"{source}: nothing is free; use --free PATH=LOW:HIGH")
    where = _answered([material, *_tried(material, numbers)], at, f"{source}: at")
    return gamut_of_free(
        material,
        numbers,
        where,
        points=points,
        seconds=seconds,
        illuminant=illuminant,
        observer=observer,
        within=within,
        samples=samples,
        seed=seed,
        progress=progress,
    )


def _answered(materials: Sequence[Material], at: str | None, where: str) -> Geometry:
    """Return the geometry asked for; of none the family's usual one, or the first other that is answered.

    What a family usually shows may be missing in one of its recipes: a blend of two pearls has no mirror.

    Raises:
        RecipeError: the geometry is not known or not answered.
    """
    usual = materials[0].model.traits.default_geometry
    asked = [usual, *(look for look in OTHER_LOOKS if look != usual)] if at is None else [at]
    refused: list[RecipeError] = []
    for text in asked:
        found = Geometry.read(text, where)
        try:
            check_answers(materials, [found], [where])
        except RecipeError as error:
            refused.append(error)
        else:
            return found
    raise refused[0]


def gamut_of_free(
    material: Material,
    numbers: Sequence[Parameter],
    at: Geometry,
    *,
    points: int,
    seconds: float = np.inf,
    illuminant: str,
    observer: str,
    within: float = 2.0,
    samples: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Gamut:
    """As `find_gamut`, of numbers and a geometry that are checked already.

    Raises:
        NacreError: no point can be computed.
    """
    grid = search_wavelengths([material, *_tried(material, numbers)][-1], [illuminant])

    memory: dict[Any, Any] = {}

    def look(values: Mapping[str, Any]) -> Array:
        return simulate_measurement(
            material.vary(values), [at], grid, samples=samples, seed=seed, memory=memory
        ).factors[0]

    light = (illuminant, observer)
    places, factors, failed = _draw(numbers, look, material, points, seconds, seed, grid, light, progress)
    if not len(factors):
        raise NacreError(f"{material.context.source}: no point of the gamut can be computed")
    structures = [values_at(numbers, place) for place in places]
    found = gamut_of(factors, grid, structures, str(at), illuminant, observer, within, failed)
    return replace(found, possible=len(every) if (every := _every_place(numbers, points)) else None)


def gamut_of(
    factors: Array,
    wavelengths_nm: Array,
    structures: Sequence[Mapping[str, Any]],
    at: str,
    illuminant: str,
    observer: str,
    within: float = 2.0,
    failed: int = 0,
) -> Gamut:
    """Return the gamut of spectra `[point, wavelength]` that are known already."""
    white = white_xyz(illuminant, observer)
    xyz = np.asarray(spectrum_to_xyz(factors, wavelengths_nm, illuminant, observer))
    lab = np.asarray(xyz_to_lab(xyz, white))
    solids = (srgb_colours(illuminant, observer), optimal_colours(illuminant, observer))
    of_srgb, of_optimal = (share_within(lab, solid, within) for solid in solids)
    return Gamut(
        at,
        illuminant,
        observer,
        lab,
        np.asarray(xyz_to_xyy(xyz)),
        [dict(s) for s in structures],
        within,
        of_srgb,
        of_optimal,
        failed,
    )


def _tried(material: Material, numbers: Sequence[Parameter]) -> list[Material]:
    found = []
    for share in (0.5, 0.99):
        try:
            found.append(material.vary(values_at(numbers, np.full(len(numbers), share))))
        except NacreError:
            continue
    return found


def _draw(
    numbers: Sequence[Parameter],
    look: Callable[[Mapping[str, Any]], Array],
    material: Material,
    points: int,
    seconds: float,
    seed: int,
    grid: Array,
    light: tuple[str, str],
    progress: Callable[[int, int], None] | None,
) -> tuple[list[Array], Array, int]:
    """Draw places evenly, then around those at the rim; return places, factors and how many failed."""
    from scipy.stats import qmc

    begun = time.monotonic()
    even = max(LEAST_POINTS, int(EVEN_SHARE * points)) if len(numbers) > 1 else points
    places = list(qmc.Sobol(len(numbers), scramble=True, rng=np.random.default_rng(seed)).random(_power(even))[:even])
    own = nominal_point(numbers, material)
    places[:0] = [own] if own is not None else []
    if every := _every_place(numbers, points):
        places, points = every, len(every)
    generator = np.random.default_rng([seed, 4])
    white, weights = white_xyz(*light), xyz_weights(grid, *light)
    kept: list[Array] = []
    factors: list[Array] = []
    labs: list[Array] = []
    failed = done = 0
    while done < points and (time.monotonic() - begun < seconds or done < LEAST_POINTS):
        if done < len(places):
            place = places[done]
        else:
            place = _at_the_rim(kept, np.array(labs), done, generator)
        done += 1
        try:
            seen = look(values_at(numbers, place))
            factors.append(seen)
            labs.append(np.asarray(xyz_to_lab(seen @ weights, white)))
            kept.append(place)
        except NacreError:
            failed += 1
        if progress is not None:
            progress(done, points)
    return kept, np.array(factors), failed


def _every_place(numbers: Sequence[Parameter], most: int) -> list[Array]:
    """Return each combination of words and whole numbers once; none where other numbers are free, or of too many."""
    if not all(n.choices or n.is_whole for n in numbers):
        return []
    counts = [len(n.choices) if n.choices else int(n.high - n.low) + 1 for n in numbers]
    if np.prod(counts, dtype=float) > most:
        return []
    return [
        np.array(
            [
                (pick + 0.5) / count if n.choices else pick / max(count - 1, 1)
                for n, pick, count in zip(numbers, picks, counts, strict=True)
            ]
        )
        for picks in np.ndindex(*counts)
    ]


def _power(count: int) -> int:
    return 1 << int(np.ceil(np.log2(max(count, 2))))


def _at_the_rim(places: Sequence[Array], labs: Array, turn: int, generator: np.random.Generator) -> Array:
    """Return a place beside the one that lies farthest out in one direction of hue and lightness."""
    if not len(labs):
        return generator.random(0)
    hue = 2.0 * np.pi * (turn % HUES) / HUES
    tilt = (-0.5, 0.0, 0.5)[turn // HUES % 3]
    out = labs[:, 1] * np.cos(hue) + labs[:, 2] * np.sin(hue) + tilt * labs[:, 0]
    place = places[int(np.argmax(out))]
    return np.asarray(np.clip(place + RIM_STEP * generator.standard_normal(len(place)), 0.0, 1.0))


def share_within(lab: Array, solid: Array, within: float) -> float:
    """Return the share of the colours of a solid `[n, 3]` that lie within a dE00 of one of the points `[m, 3]`."""
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(lab))
    _, nearest = cKDTree(lab).query(solid, k=count)
    near = lab[np.reshape(nearest, (len(solid), count))]
    return float(np.mean(np.min(delta_e_2000(solid[:, None], near), axis=1) <= within))


@functools.lru_cache(maxsize=16)
def srgb_colours(illuminant: str, observer: str) -> Array:
    """Return colours of sRGB, spread evenly over its volume in CIELAB, for an eye adapted to the lamp, `[n, 3]`."""
    white = white_xyz(illuminant, observer)

    def is_inside(xyz: Array) -> Any:
        rgb = xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ))
        return np.all((rgb >= 0.0) & (rgb <= 1.0), axis=-1)

    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    edge = np.asarray(xyz_to_lab(adapt_xyz(srgb_linear_to_xyz(corners), SRGB_WHITE_XYZ, white), white))
    return _fill(is_inside, edge, white)


@functools.lru_cache(maxsize=16)
def srgb_limits(illuminant: str, observer: str) -> Array:
    """Return colours on the surface of sRGB, for an eye adapted to the lamp, CIELAB `[n, 3]`."""
    white = white_xyz(illuminant, observer)
    face = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 33) ** 2.2] * 2), axis=-1).reshape(-1, 2)
    faces = [np.insert(face, axis, end, axis=1) for axis in range(3) for end in (0.0, 1.0)]
    return np.asarray(xyz_to_lab(adapt_xyz(srgb_linear_to_xyz(np.concatenate(faces)), SRGB_WHITE_XYZ, white), white))


@functools.lru_cache(maxsize=16)
def optimal_limits(illuminant: str, observer: str) -> Array:
    """Return XYZ of optimal colours, `[n, 3]`: reflectances of 0 and 1 with two edges at most.

    Source: MacAdam 1935 (Schroedinger 1920): no surface that does not glow has a colour beyond them.
    """
    grid = table_wavelengths_nm()
    weights = xyz_weights(grid, illuminant, observer)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(weights, axis=0)])
    edges = total[:: int(LIMIT_STEP_NM)]
    first, second = np.triu_indices(len(edges), 1)
    bands = edges[second] - edges[first]
    return np.concatenate([bands, total[-1] - bands])


@functools.lru_cache(maxsize=16)
def optimal_colours(illuminant: str, observer: str) -> Array:
    """Return colours inside the limits of MacAdam, spread evenly over their volume in CIELAB, `[n, 3]`."""
    from scipy.spatial import ConvexHull

    white = white_xyz(illuminant, observer)
    limits = optimal_limits(illuminant, observer)
    planes = ConvexHull(limits).equations

    def is_inside(xyz: Array) -> Any:
        return np.all(xyz @ planes[:, :3].T + planes[:, 3] <= 1e-9, axis=-1)

    return _fill(is_inside, np.asarray(xyz_to_lab(limits, white)), white)


def _fill(is_inside: Callable[[Array], Any], rim: Array, white: Array) -> Array:
    """Return the points of a regular sequence inside a solid, drawn in the box about its rim."""
    from scipy.stats import qmc

    low, high = rim.min(axis=0) - 1.0, rim.max(axis=0) + 1.0
    sequence = qmc.Halton(3, scramble=False)
    inside = np.zeros((0, 3))
    while len(inside) < SOLID_POINTS:
        labs = low + sequence.random(BATCH) * (high - low)
        inside = np.concatenate([inside, labs[is_inside(np.asarray(lab_to_xyz(labs, white)))]])
    return inside[:SOLID_POINTS]


def gamut_chart(found: Gamut, wanted: ArrayLike | None = None, title: str = "") -> Figure:
    """Return the figure of a gamut; `wanted` `[n, 3]`, CIELAB, is marked in it."""
    from nacre.plot import reach_figure

    light = (found.illuminant, found.observer)
    white = white_xyz(*light)
    note = (
        f"{found.illuminant}, {found.observer} observer; within dE00 {found.within:g} of {len(found.lab)} points: "
        f"{_percent(found.share_of_srgb)} of sRGB, {_percent(found.share_of_optimal)} of the optimal colours"
    )
    limits = np.asarray(xyz_to_lab(optimal_limits(*light), white))
    return reach_figure(found.lab, found.xyy, srgb_limits(*light), limits, white, title or found.at, note, wanted)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def gamut_svg(found: Gamut, wanted: ArrayLike | None = None) -> str:
    """Return a*b* as SVG in which every point tells its colour and its structure when the pointer rests on it."""
    light = (found.illuminant, found.observer)
    white = white_xyz(*light)
    outlines = (np.asarray(xyz_to_lab(optimal_limits(*light), white)), srgb_limits(*light))
    reach = float(max(np.abs(solid[:, 1:]).max() for solid in outlines)) * 1.05
    marks = [f'<circle r="{round(r * 300 / reach)}" fill="none" stroke="#ddd"/>' for r in (50, 100)]
    marks.append('<path d="M-300 0H300M0 -300V300" stroke="#ddd"/>')
    for solid, dash in zip(outlines, ("", ' stroke-dasharray="5 4"')):
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        rim = solid[np.argmax(solid[:, 1:] @ np.stack([np.cos(turn), np.sin(turn)]), axis=0), 1:] * 300 / reach
        path = " ".join(f"{a:.0f},{-b:.0f}" for a, b in rim)
        marks.append(f'<polyline points="{path}" fill="none" stroke="#999"{dash}/>')
    for lab, structure in zip(found.lab, found.structures, strict=True):
        a, b = lab[1] * 300 / reach, -lab[2] * 300 / reach
        said = html.escape("\n".join([f"Lab {lab[0]:.1f}, {lab[1]:.1f}, {lab[2]:.1f}", *_lines(structure)]))
        colour = lab_hex(lab, white)
        marks.append(
            f'<circle cx="{a:.1f}" cy="{b:.1f}" r="4" fill="{colour}" stroke="#222" stroke-width=".4">'
            f"<title>{said}</title></circle>"
        )
    for lab in np.atleast_2d(np.asarray(wanted, float)) if wanted is not None and len(np.atleast_2d(wanted)) else ():
        a, b = lab[1] * 300 / reach, -lab[2] * 300 / reach
        marks.append(f'<path d="M{a - 6:.1f} {b - 6:.1f}l12 12m0 -12l-12 12" stroke="#000" stroke-width="2"/>')
    return (
        '<svg width="640" height="640" viewBox="-320 -320 640 640" font-family="system-ui" font-size="14">'
        + "".join(marks)
        + '<text x="290" y="-6">a*</text><text x="6" y="-300">b*</text></svg>'
    )


def _lines(structure: Mapping[str, Any]) -> list[str]:
    found = []
    for path, value in structure.items():
        if isinstance(value, list):
            found += [f"{layer.get('material')} {layer.get('thickness_nm', 0.0):.4g} nm" for layer in value]
        else:
            found.append(f"{path} = {value:.5g}" if isinstance(value, float) else f"{path} = {value}")
    return found


def gamut_page(found: Gamut, name: str) -> str:
    """Return a gamut as one HTML file that needs nothing else: the shares, and a chart with structures to point at."""
    facts = (
        f"Within dE00 {found.within:g} of one of {len(found.lab)} reachable colours lie "
        f"{_percent(found.share_of_srgb)} of the colours of sRGB and {_percent(found.share_of_optimal)} of the optimal "
        "colours, which no surface goes beyond. Let the pointer rest on a point to see its structure."
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>nacre: {html.escape(name)}</title></head>'
        f'<body style="font:15px/1.5 system-ui,sans-serif;max-width:900px;margin:2em auto"><h1>{html.escape(name)}: '
        f"{html.escape(found.at)}, {found.illuminant}</h1><p>{facts}</p>{gamut_svg(found)}</body></html>\n"
    )


__all__ = [
    "Gamut",
    "find_gamut",
    "gamut_chart",
    "gamut_of",
    "gamut_of_free",
    "gamut_page",
    "gamut_svg",
    "parse_parameters",
]


# What a design's freedom reaches at its first colour: the gamut behind its report.

STACKS = 800
POINTS = 400
SHORT_SHARE = 0.3  # of thicknesses: drawn near the lower bound, where metals let light through


def reach_of(target: DesignTask, seconds: float) -> tuple[Gamut, Array] | None:
    """Return the gamut at the first colour that is wanted, and the colours wanted there `[want, 3]`, CIELAB.

    None where only spectra are wanted.

    Args:
        seconds: time allowed where a material is computed one by one.

    Raises:
        NacreError: nothing can be computed.
    """
    colours = [want for want in target.targets if want.spectrum is None]
    if not colours:
        return None
    at, light = colours[0].geometry, target.spec.light
    white = white_xyz(light.illuminants[0], light.observer)
    wanted = [want.target_lab(white) for want in colours if want.geometry == at]
    marks = np.array([lab for lab in wanted if lab is not None]).reshape(-1, 3)
    search = thin_film_search(target, 0)
    if search is not None:
        return _of_stacks(search, target, at), marks
    seed = target.spec.search.seed
    found = gamut_of_free(
        target.material,
        target.parameters,
        at,
        points=POINTS,
        seconds=seconds,
        illuminant=light.illuminants[0],
        observer=light.observer,
        seed=seed,
    )
    return found, marks


def _of_stacks(search: ThinFilmSearch, target: DesignTask, at: Geometry) -> Gamut:
    """Draw stacks that the target allows, many at once."""
    problem, light = search.problem, target.spec.light
    generator = np.random.default_rng([target.spec.search.seed, 5])
    grid = problem.merit.wavelengths_nm
    media = {m.name: m.n for m in problem.palette}
    factors: list[Array] = []
    structures: list[dict[str, Any]] = []
    counts = range(1, problem.layers + 1) if problem.slots is None else [problem.layers]
    for count in counts:
        share = max(STACKS // len(counts), 1)
        n = np.empty((share, count + 2, len(grid)), dtype=complex)
        d = np.zeros((share, count))
        n[:, 0] = problem.ambient
        for k in range(share):
            names = [_pick(search, j, generator) for j in range(count)]
            below = problem.substrates[int(generator.integers(len(problem.substrates)))]
            n[k, 1:-1] = [media[name] for name in names] if names else np.zeros((0, len(grid)))
            n[k, -1] = below.n
            for j, name in enumerate(names):
                slot = None if problem.slots is None else problem.slots[j]
                low, high = problem.bounds_of(name) if slot is None else (slot.low_nm, slot.high_nm)
                unit = generator.random() * (SHORT_SHARE if generator.random() < SHORT_SHARE else 1.0)
                d[k, j] = low + unit * (min(high, 1e5) - low)
            d[k] *= min(1.0, problem.max_total_nm / max(float(d[k].sum()), 1e-9))
            structures.append(
                {
                    "layers": [{"material": m, "thickness_nm": float(t)} for m, t in zip(names, d[k])],
                    "substrate": below.name,
                }
            )
        found = powers(n, d, grid, np.radians([at.theta_deg]))
        part = found.reflectance if at.kind == "specular" else found.transmittance
        factors.append(np.asarray(part[..., 0, :]))
    return gamut_of(np.concatenate(factors), grid, structures, str(at), light.illuminants[0], light.observer)


def _pick(search: ThinFilmSearch, slot: int, generator: np.random.Generator) -> str:
    slots = search.problem.slots
    names = [m.name for m in search.problem.palette] if slots is None else slots[slot].materials
    return str(names[int(generator.integers(len(names)))])


def reach_of_or_none(target: DesignTask, seconds: float) -> tuple[Gamut, Array] | None:
    """As `reach_of`; None where it cannot be computed: the report then goes without."""
    try:
        return reach_of(target, seconds)
    except NacreError:
        return None


__all__ = ["reach_of", "reach_of_or_none"]
