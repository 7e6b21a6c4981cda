"""Material gamut: colours that parameters reach at one geometry, with their structures.

Shares count colours: among those in a solid (sRGB, or all optimal colours under the lamp), distributed evenly over
its volume in CIELAB, the share that lies within a dE00 from a reached colour.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.html import render_page
from nacre.core.jit import clock
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
from nacre.material.material import Material, MaterialLike, as_material
from nacre.matter.stack.solve import powers
from nacre.measure.colours import recipe_geometries
from nacre.measure.geometry import Geometry
from nacre.optimise.evaluation import lab_hex
from nacre.optimise.measurement import check_answers, search_wavelengths, simulate_measurement
from nacre.optimise.methods.least_squares import sobol_points
from nacre.optimise.parameters import (
    Parameter,
    combinations,
    nominal_point,
    read_parameters,
    refuse_ties,
    trial_materials,
    values_at,
)
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import check_light
from nacre.optimise.task import DesignTask
from nacre.optimise.thin_film.adapter import ThinFilmSearch, thin_film_search
from nacre.recipe.model import RecipeContext

if TYPE_CHECKING:
    from nacre.plot import Figure

EVEN_SHARE = 0.5  # evenly drawn points; the others are drawn near the most extreme colours
RIM_STEP = 0.12  # step standard deviation near an extreme colour, relative to the bounds
HUES = 36  # hue directions for extremes
SOLID_POINTS, BATCH = 1200, 2048
NEIGHBOURS = 12
EDGE_STEP_NM = 10.0  # step between edge wavelengths in optimal colours
OTHER_GEOMETRIES = ("45as15", "45as45", "transmitted 0")  # alternatives, in this order, if the default does not apply
MIN_POINTS, MAX_POINTS = 8, 1_000_000
STACKS, REPORT_POINTS = 800, 400  # gamut points in a report: thin films, other materials
THIN_SHARE = 0.3  # thicknesses drawn near the lower bound: thin metals transmit

Light = tuple[str, str]  # illuminant and observer


@dataclass(frozen=True, eq=False)
class Gamut:
    """Colours that a family reaches within bounds.

    Attributes:
        geometry: measurement geometry.
        illuminant, observer: colour conditions.
        lab: `[point, 3]`.
        xyy: `[point, 3]`, chromaticity and luminance (white has 1).
        structures: parameter values per point, by path.
        tolerance: dE00 within which a colour counts as reached.
        share_of_srgb: reached share, sRGB colours.
        share_of_optimal: reached share, optimal colours (MacAdam limits).
        failed: points that could not be computed.
        possible: combination count if all parameters are discrete; None otherwise.
    """

    geometry: str
    illuminant: str
    observer: str
    lab: Array
    xyy: Array
    structures: list[dict[str, Any]]
    tolerance: float
    share_of_srgb: float
    share_of_optimal: float
    failed: int
    possible: int | None = None

    @property
    def light(self) -> Light:
        """Illuminant and observer."""
        return self.illuminant, self.observer

    def document(self) -> dict[str, Any]:
        """Return the gamut as JSON data."""
        white = white_xyz(*self.light)
        points = [
            {"lab": lab.tolist(), "xyY": xyy.tolist(), "colour": lab_hex(lab, white), "structure": structure}
            for lab, xyy, structure in zip(self.lab, self.xyy, self.structures, strict=True)
        ]
        keys = ("geometry", "illuminant", "observer", "tolerance", "share_of_srgb", "share_of_optimal", "failed")
        return {**{key: getattr(self, key) for key in keys}, "count": len(points), "points": points}


def parse_parameters(options: Iterable[str]) -> dict[str, Any]:
    """Read `PATH=A:B` (bounds) and `PATH=a,b,c` (choices) into a parameter table.

    Raises:
        RecipeError: an option has another form.
    """
    table: dict[str, Any] = {}
    for option in options:
        path, equals, text = (part.strip() for part in option.rpartition("="))
        if not equals or not path or not text:
            raise RecipeError(
                f'--parameter "{option}" cannot be read; write it like layers[0].thickness_nm=50:400 or substrate=Al,Ag'
            )
        if path in table:
            raise RecipeError(f"--parameter {path} is given twice; keep one")
        ends = [_number_or_text(end) for end in text.split(":")]
        if len(ends) == 2 and all(isinstance(end, float) for end in ends):
            table[path] = ends
        else:
            table[path] = {"choices": [_number_or_text(word) for word in text.split(",")]}
    return table


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def find_gamut(
    thing: MaterialLike,
    parameters: Iterable[str] | Mapping[str, Any] = (),
    geometry: str | None = None,
    *,
    points: int = 1000,
    seconds: float | None = None,
    illuminant: str = "D65",
    observer: str = "10deg",
    tolerance: float = 2.0,
    samples: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Gamut:
    """Return the colours that a material's parameters reach at a geometry.

    One half is drawn evenly, the other near each hue's most extreme colours.

    Args:
        thing: a material or a path.
        parameters: such as "layers[0].thickness_nm=50:400" or "substrate=Al,Ag"; or a table as a design's
            `[parameters]`.
        geometry: "specular 0", "45as15" and so on, as in a target; None: the family's default geometry (mirror
            direction for a film, 45 degrees for a photonic glass, near the mirror direction for a pearl or a relief),
            or another one that applies.
        points: material count. The same count and seed give the same result.
        seconds: time limit, after which the colours found so far are returned; default: unlimited.
        illuminant, observer: for the colours.
        tolerance: dE00 within which a colour counts as reached.
        samples, seed: random-walk settings; the seed also determines the materials.
        progress: called with (done, points).

    Raises:
        NacreError: the geometry or a path is not known, or all points fail.

    Example:
        >>> film = {"family": "film", "substrate": "Ti", "layers": [{"material": "TiO2", "thickness_nm": 100}]}
        >>> 0 < nacre.gamut(film, ["layers[0].thickness_nm=0:400"], points=20).share_of_srgb < 1
        True
    """
    material = as_material(thing)
    table = parameters if isinstance(parameters, Mapping) else parse_parameters(parameters)
    source = material.context.source
    if not MIN_POINTS <= points <= MAX_POINTS:
        raise NacreError(f"--points = {points} must lie in [{MIN_POINTS}, {MAX_POINTS}]")
    if not tolerance > 0:
        raise NacreError(f"--tolerance = {tolerance:g} must be above 0")
    check_light(LightSpec(illuminants=[illuminant], observer=observer), RecipeContext(source))
    material = material.at_low_fidelity().with_parts_loaded(table)
    free = read_parameters(dict(table), material, source)
    refuse_ties(material, [number.path for number in free], source)
    if not free:
        raise RecipeError(f"{source}: nothing is free; use --parameter PATH=LOW:HIGH")
    at = applicable_geometry([material, *trial_materials(free, material)], geometry, f"{source}: geometry")
    draws = (points, seconds, seed)
    return _parameter_gamut(material, free, at, (illuminant, observer), draws, tolerance, samples, progress)


def applicable_geometry(materials: Sequence[Material], geometry: str | None, where: str) -> Geometry:
    """Return the given geometry; default: the family's, or the first other one that applies.

    The default geometry may not apply to a recipe: a blend between two pearls lacks a specular part.

    Raises:
        RecipeError: the geometry is not known or does not apply.
    """
    usual = materials[0].model.traits.default_geometry
    others = [other for other in OTHER_GEOMETRIES if other != usual]
    refused: list[RecipeError] = []
    for text in [usual, *others] if geometry is None else [geometry]:
        candidate = Geometry.read(text, where, recipe_geometries(materials[0]))
        try:
            check_answers(materials, [candidate], [where])
        except RecipeError as error:
            refused.append(error)
        else:
            return candidate
    raise refused[0]


def target_gamut(task: DesignTask, seconds: float) -> tuple[Gamut, Array] | None:
    """Return the gamut at the first target colour, and the target colours there `[target, 3]` (CIELAB), for a report.

    None if all targets are spectra or texture, or if all points fail.

    Args:
        seconds: time limit, unless the material is a thin film.
    """
    colours = [target for target in task.targets if target.spectrum is None and target.texture is None]
    if not colours:
        return None
    at, light = colours[0].geometry, (task.spec.light.illuminants[0], task.spec.light.observer)
    labs = [target.target_lab(white_xyz(*light)) for target in colours if target.geometry == at]
    marks = np.array([lab for lab in labs if lab is not None]).reshape(-1, 3)
    seed = task.spec.search.seed
    try:
        search = thin_film_search(task, 0)
        if search is not None:
            return _stack_gamut(search, at, light, seed), marks
        draws = (REPORT_POINTS, seconds, seed)
        return _parameter_gamut(task.material, task.parameters, at, light, draws), marks
    except NacreError:
        return None


def _parameter_gamut(
    material: Material,
    parameters: Sequence[Parameter],
    at: Geometry,
    light: Light,
    draws: tuple[int, float | None, int],
    tolerance: float = 2.0,
    samples: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Gamut:
    """Draw points evenly, then near the most extreme colours.

    Args:
        draws: point count, time limit in seconds if there is one, seed.

    Raises:
        NacreError: all points fail.
    """
    count, seconds, seed = draws
    start = clock()
    grid = search_wavelengths([material, *trial_materials(parameters, material)][-1], [light[0]])
    weights, white = xyz_weights(grid, *light), white_xyz(*light)
    possible = _combinations(parameters, count)
    if possible:
        planned, count = possible, len(possible)
    else:
        even = max(MIN_POINTS, int(EVEN_SHARE * count)) if len(parameters) > 1 else count
        planned = list(sobol_points(len(parameters), even, seed)[:even])
        nominal = nominal_point(parameters, material)
        planned[:0] = [nominal] if nominal is not None else []
    generator = np.random.default_rng([seed, 4])
    make = material.parametrise([parameter.path for parameter in parameters])
    cache: dict[Any, Any] = {}
    points: list[Array] = []
    factors: list[Array] = []
    labs: list[Array] = []
    failed = done = 0
    while done < count and (seconds is None or clock() - start < seconds or done < MIN_POINTS):
        if done == len(planned) and not points:
            break
        point = planned[done] if done < len(planned) else _near_extreme(points, np.array(labs), done, generator)
        done += 1
        try:
            variant = make(values_at(parameters, point))
            factor = simulate_measurement(variant, [at], grid, samples=samples, seed=seed, memory=cache).factors[0]
            factors.append(factor)
            labs.append(np.asarray(xyz_to_lab(factor @ weights, white)))
            points.append(point)
        except NacreError:
            failed += 1
        if progress is not None:
            progress(done, count)
    if not points:
        raise NacreError(f"{material.context.source}: no point of the gamut can be computed")
    structures = [values_at(parameters, point) for point in points]
    gamut = _spectra_gamut(np.array(factors), grid, structures, at, light, tolerance)
    return replace(gamut, failed=failed, possible=len(possible) or None)


def _combinations(parameters: Sequence[Parameter], most: int) -> list[Array]:
    """Return all discrete parameter combinations; empty if a parameter is continuous, or if they are too many."""
    if not all(p.choices or p.is_whole for p in parameters):
        return []
    count, points = combinations(parameters)
    return list(points) if count <= most else []


def _near_extreme(points: Sequence[Array], labs: Array, turn: int, generator: np.random.Generator) -> Array:
    """Return a point near the most extreme one in a hue and lightness direction."""
    hue = 2.0 * np.pi * (turn % HUES) / HUES
    tilt = (-0.5, 0.0, 0.5)[turn // HUES % 3]
    extent = labs[:, 1] * np.cos(hue) + labs[:, 2] * np.sin(hue) + tilt * labs[:, 0]
    point = points[int(np.argmax(extent))]
    return np.asarray(np.clip(point + RIM_STEP * generator.standard_normal(len(point)), 0.0, 1.0))


def _stack_gamut(search: ThinFilmSearch, at: Geometry, light: Light, seed: int) -> Gamut:
    """Draw stacks that a target allows, computed in batches."""
    problem = search.problem
    generator = np.random.default_rng([seed, 5])
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
            slots = [None] * count if problem.slots is None else problem.slots
            palettes = [list(media) if slot is None else slot.materials for slot in slots]
            names = [str(palette[int(generator.integers(len(palette)))]) for palette in palettes]
            below = problem.substrates[int(generator.integers(len(problem.substrates)))]
            n[k, 1:-1] = [media[name] for name in names] if names else np.zeros((0, len(grid)))
            n[k, -1] = below.n
            for j, (name, slot) in enumerate(zip(names, slots)):
                low, high = problem.bounds_of(name) if slot is None else (slot.low_nm, slot.high_nm)
                unit = generator.random() * (THIN_SHARE if generator.random() < THIN_SHARE else 1.0)
                d[k, j] = low + unit * (min(high, 1e5) - low)
            d[k] *= min(1.0, problem.max_total_nm / max(float(d[k].sum()), 1e-9))
            layers = [{"material": name, "thickness_nm": float(t)} for name, t in zip(names, d[k])]
            structures.append({"layers": layers, "substrate": below.name})
        reflected = powers(n, d, grid, np.radians([at.theta_deg]))
        part = reflected.reflectance if at.kind == "specular" else reflected.transmittance
        factors.append(np.asarray(part[..., 0, :]))
    return _spectra_gamut(np.concatenate(factors), grid, structures, at, light)


def _spectra_gamut(
    factors: Array,
    wavelengths_nm: Array,
    structures: list[dict[str, Any]],
    at: Geometry,
    light: Light,
    tolerance: float = 2.0,
) -> Gamut:
    """Return the gamut from spectra `[point, wavelength]`."""
    xyz = np.asarray(spectrum_to_xyz(factors, wavelengths_nm, *light))
    lab = np.asarray(xyz_to_lab(xyz, white_xyz(*light)))
    shares = [share_within(lab, solid(*light), tolerance) for solid in (srgb_colours, optimal_colours)]
    xyy = np.asarray(xyz_to_xyy(xyz))
    return Gamut(str(at), *light, lab, xyy, structures, tolerance, shares[0], shares[1], failed=0)


def share_within(lab: Array, solid: Array, tolerance: float) -> float:
    """Return the share in a solid `[n, 3]` that lies within a dE00 from the points `[m, 3]`."""
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(lab))
    _, nearest = cKDTree(lab).query(solid, k=count)
    near = lab[np.reshape(nearest, (len(solid), count))]
    return float(np.mean(np.min(delta_e_2000(solid[:, None], near), axis=1) <= tolerance))


@functools.lru_cache(maxsize=16)
def srgb_colours(illuminant: str, observer: str) -> Array:
    """Return sRGB colours, distributed evenly over the volume in CIELAB, adapted to the lamp, `[n, 3]`."""
    white = white_xyz(illuminant, observer)

    def is_inside(xyz: Array) -> Any:
        rgb = xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ))
        return np.all((rgb >= 0.0) & (rgb <= 1.0), axis=-1)

    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return _fill(is_inside, _srgb_to_lab(corners, white), white)


@functools.lru_cache(maxsize=16)
def srgb_limits(illuminant: str, observer: str) -> Array:
    """Return points on the boundary of the sRGB gamut, adapted to the illuminant, in CIELAB `[n, 3]`."""
    face = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 33) ** 2.2] * 2), axis=-1).reshape(-1, 2)
    faces = [np.insert(face, axis, end, axis=1) for axis in range(3) for end in (0.0, 1.0)]
    return _srgb_to_lab(np.concatenate(faces), white_xyz(illuminant, observer))


def _srgb_to_lab(linear: Array, white: Array) -> Array:
    return np.asarray(xyz_to_lab(adapt_xyz(srgb_linear_to_xyz(linear), SRGB_WHITE_XYZ, white), white))


@functools.lru_cache(maxsize=16)
def optimal_limits(illuminant: str, observer: str) -> Array:
    """Return XYZ for the optimal colours, `[n, 3]`: reflectances 0 and 1 with at most two edges.

    They limit all non-fluorescent surfaces (Schroedinger 1920, MacAdam 1935).
    """
    weights = xyz_weights(table_wavelengths_nm(), illuminant, observer)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(weights, axis=0)])
    edges = total[:: int(EDGE_STEP_NM)]
    first, second = np.triu_indices(len(edges), 1)
    bands = edges[second] - edges[first]
    return np.concatenate([bands, total[-1] - bands])


@functools.lru_cache(maxsize=16)
def optimal_colours(illuminant: str, observer: str) -> Array:
    """Return colours inside the MacAdam limits, distributed evenly over their volume in CIELAB, `[n, 3]`."""
    from scipy.spatial import ConvexHull

    white = white_xyz(illuminant, observer)
    limits = optimal_limits(illuminant, observer)
    planes = ConvexHull(limits).equations

    def is_inside(xyz: Array) -> Any:
        return np.all(xyz @ planes[:, :3].T + planes[:, 3] <= 1e-9, axis=-1)

    return _fill(is_inside, np.asarray(xyz_to_lab(limits, white)), white)


def _fill(is_inside: Callable[[Array], Any], rim: Array, white: Array) -> Array:
    """Return Halton points inside a solid."""
    from scipy.stats import qmc

    low, high = rim.min(axis=0) - 1.0, rim.max(axis=0) + 1.0
    sequence = qmc.Halton(3, scramble=False)
    inside = np.zeros((0, 3))
    while len(inside) < SOLID_POINTS:
        labs = low + sequence.random(BATCH) * (high - low)
        inside = np.concatenate([inside, labs[is_inside(np.asarray(lab_to_xyz(labs, white)))]])
    return inside[:SOLID_POINTS]


def colour_chart(xyz: Array, light: Light, title: str, note: str, marks: ArrayLike | None = None) -> Figure:
    """Draw colours XYZ `[point, 3]` within the sRGB and optimal colour limits.

    Args:
        marks: `[n, 3]`, CIELAB, drawn as crosses.
    """
    from nacre.plot import gamut_limits_figure

    white = white_xyz(*light)
    lab, limits = (np.asarray(xyz_to_lab(each, white)) for each in (xyz, optimal_limits(*light)))
    return gamut_limits_figure(lab, np.asarray(xyz_to_xyy(xyz)), srgb_limits(*light), limits, white, title, note, marks)


def gamut_chart(gamut: Gamut, marks: ArrayLike | None = None, title: str = "") -> Figure:
    """Return the gamut figure; `marks` `[n, 3]` (CIELAB) are drawn as crosses."""
    note = (
        f"{gamut.illuminant}, {gamut.observer} observer; within dE00 {gamut.tolerance:g} of {len(gamut.lab)} points: "
        f"{100 * gamut.share_of_srgb:.2g} % of sRGB, {100 * gamut.share_of_optimal:.2g} % of the optimal colours"
    )
    xyz = np.asarray(lab_to_xyz(gamut.lab, white_xyz(*gamut.light)))
    return colour_chart(xyz, gamut.light, title or gamut.geometry, note, marks)


def gamut_svg(gamut: Gamut, marks: ArrayLike | None = None) -> str:
    """Return the a*b* plane as SVG; a point shows its colour and structure as a tooltip."""
    white = white_xyz(*gamut.light)
    outlines = np.asarray(xyz_to_lab(optimal_limits(*gamut.light), white)), srgb_limits(*gamut.light)
    scale = 300 / (1.05 * max(float(np.abs(solid[:, 1:]).max()) for solid in outlines))
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    directions = np.stack([np.cos(turn), np.sin(turn)])
    return render_page(
        "gamut_svg.html",
        scale=scale,
        outlines=[solid[np.argmax(solid[:, 1:] @ directions, axis=0)] for solid in outlines],
        points=[
            (lab, lab_hex(lab, white), _lines(structure))
            for lab, structure in zip(gamut.lab, gamut.structures, strict=True)
        ],
        marks=[] if marks is None else np.reshape(np.asarray(marks, float), (-1, 3)),
    )


def _lines(structure: Mapping[str, Any]) -> list[str]:
    lines = []
    for path, value in structure.items():
        if isinstance(value, list):
            lines += [f"{layer.get('material')} {layer.get('thickness_nm', 0.0):.4g} nm" for layer in value]
        else:
            lines.append(f"{path} = {value:.5g}" if isinstance(value, float) else f"{path} = {value}")
    return lines


def gamut_page(gamut: Gamut, name: str) -> str:
    """Return a gamut as a self-contained HTML page: shares, and a chart with tooltips."""
    title = f"{name}: {gamut.geometry}, {gamut.illuminant}"
    return render_page("gamut.html", title=title, gamut=gamut, svg=gamut_svg(gamut))
