"""Dot-matrix holograms: a picture seen under a lamp becomes maps of grating azimuth and period.

Each pixel is three adjacent dots, one for each of three wavelengths; two pictures alternate by rows. A dot diffracts
one wavelength to the viewer: its wave vector is g = q / lambda, with q the sum over the transverse directions to
the light and to the viewer. A dot is dimmed by a small lattice rotation, which moves its order away from the viewer:
an order with angular width w falls to a share s at the distance w sqrt(-2 ln s) of q from the line of its lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.core.files import atomic_path
from nacre.core.jit import clock
from nacre.families.contract import Diffracting, Pixels
from nacre.formats.layouts import write_pixel_field
from nacre.light import delta_e_2000, lab_to_xyz, smooth_weights, white_xyz, xyz_to_lab
from nacre.material.material import Material, load
from nacre.optimise.checkpoint import Checkpointer
from nacre.optimise.evaluation import TargetResult
from nacre.optimise.image.files import ParameterMap, screen_rgb, srgb_lab, write_maps
from nacre.optimise.solutions import Design, DesignProgress, Solution, claim, clear_solutions, conclude, write_recipe
from nacre.optimise.targets import Target
from nacre.optimise.task import PERIOD, TURN, DesignTask

PRIMARIES_NM = (612.0, 545.0, 464.0)  # wavelengths whose mixtures contain sRGB
LEVELS = 64  # dot brightnesses
DARK = 1e-5  # share at which a dot counts as dark
FIELD = "hologram"
APART = 8.0  # least distance between two pictures' wave vectors, in order widths


@dataclass(frozen=True, eq=False)
class Channel:
    """One picture and the dots that show it.

    Attributes:
        target: the picture and its geometry.
        turn_deg: rotation of a bright dot's grating.
        length: |q|.
        periods_nm: `[3]`.
        primaries: `[3, 3]`, XYZ of a bright dot by wavelength, in arbitrary units.
        shares: `[row, column, 3]`, dot brightness.
        reached: `[row, column, 3]`, XYZ, on the picture's scale.
    """

    target: Target
    turn_deg: float
    length: float
    periods_nm: Array
    primaries: Array
    shares: Array
    reached: Array


def directions(target: Target, azimuth_deg: float) -> tuple[Array, Array]:
    """Return the unit vectors to the light and to the viewer, turned about the normal by the light's azimuth."""
    theta, turn = np.radians(target.geometry.theta_deg), np.radians(azimuth_deg)
    light, eye = np.array([np.sin(theta), 0.0, np.cos(theta)]), target.geometry.wo
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return matrix @ light, matrix @ eye


def make_channel(task: DesignTask, number: int) -> Channel:
    """Find the dots for one picture.

    Raises:
        RecipeError: the geometry needs a period or a turn outside the bounds, or gives the viewer no light.
    """
    target, entry = task.targets[number], task.spec.target[number]
    source = task.context.source
    if target.geometry.kind != "aspecular":
        raise RecipeError(
            f'{target.key}.geometry = "{target.geometry}" is not a pair of lamp and viewer; allowed: IasA, as 45as45'
        )
    light, eye = directions(target, entry.light_azimuth_deg)
    q = (light + eye)[:2]
    length = float(np.hypot(*q))
    bounds = {p.path: (p.low, p.high) for p in task.parameters}
    low, high = bounds[PERIOD]
    periods = np.array(PRIMARIES_NM) / max(length, 1e-9)
    if periods.min() < low or periods.max() > high:
        raise RecipeError(
            f'{source}: parameters."{PERIOD}" = [{low:g}, {high:g}]: "{target.geometry}" needs periods from '
            f"{periods.min():.0f} to {periods.max():.0f} nm; allowed: bounds that contain them, or another angle"
        )
    least, most = bounds[TURN]
    azimuth = float(np.degrees(np.arctan2(q[1], q[0])))
    turns = [t for t in (azimuth + 180.0 * np.arange(-3, 4)) if least <= t <= most]
    if not turns:
        raise RecipeError(
            f'{source}: parameters."{TURN}" = [{least:g}, {most:g}]: the picture needs a turn of {azimuth:.1f} degrees '
            "or half a turn more; allowed: bounds that contain it"
        )
    efficiencies = [(_efficiencies(task.material, light, periods, turn, q), turn) for turn in turns[:2]]
    efficiency, turn = max(efficiencies, key=lambda pair: float(np.min(pair[0])))
    if not np.all(efficiency > 0.0):
        raise RecipeError(f'{target.key}.geometry = "{target.geometry}": the grating sends no light to the viewer')
    # an order is Gaussian over the wavelength, w times as wide as the period
    assert isinstance(task.material.model, Diffracting)
    density = _line_colours(task, task.material.model.order_width_rad * periods)
    primaries = density * (efficiency * periods)[:, None]
    shares, reached = _shares(task, target, primaries)
    return Channel(target, turn, length, periods, primaries, shares, reached)


def _efficiencies(material: Material, light: Array, periods_nm: Array, turn_deg: float, q: Array) -> Array:
    """Return the efficiency `[3]` of the order that leads to the viewer, for unpolarised light."""
    efficiencies = []
    for period, wavelength in zip(periods_nm, PRIMARIES_NM, strict=True):
        model = material.vary({PERIOD: float(period), TURN: float(turn_deg)}).model
        assert isinstance(model, Diffracting)
        orders = model.diffraction_orders(
            np.array([np.arccos(light[2])]), float(np.arctan2(light[1], light[0])), np.array([wavelength])
        )
        along = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])
        sign = 1 if float(along @ q) > 0.0 else -1
        at = np.flatnonzero((orders.numbers[:, 0] == sign) & (orders.numbers[:, 1] == 0))
        efficiencies.append(float(np.nan_to_num(orders.reflected[0, 0, at]).mean()) if at.size else 0.0)
    return np.array(efficiencies)


def _line_colours(task: DesignTask, widths_nm: Array) -> Array:
    """Return XYZ `[3, 3]` of Gaussian lines about each wavelength in the lamp's light, for equal power."""
    grid = np.arange(380.0, 781.0, 1.0)
    weights = smooth_weights(grid, task.spec.light.illuminants[0], task.spec.light.observer)
    bells = np.exp(-0.5 * ((grid - np.array(PRIMARIES_NM)[:, None]) / widths_nm[:, None]) ** 2)
    return np.asarray(bells @ weights / widths_nm[:, None])


def _shares(task: DesignTask, target: Target, primaries: Array) -> tuple[Array, Array]:
    """Return the brightness of the dots of each pixel, the brightest of white at 1, and XYZ reached."""
    assert target.image is not None
    white = white_xyz(task.spec.light.illuminants[0], task.spec.light.observer)
    wanted = np.asarray(lab_to_xyz(srgb_lab(target.image), white))
    exposure = float(np.linalg.solve(primaries.T, white).max())
    shares = np.clip(np.einsum("ij,rcj->rci", np.linalg.inv(primaries.T), wanted) / exposure, 0.0, 1.0)
    shares = (np.round(np.sqrt(shares) * (LEVELS - 1)) / (LEVELS - 1)) ** 2  # finer steps in the dark
    return shares, exposure * shares @ primaries


def dot_maps(task: DesignTask, channels: Sequence[Channel]) -> tuple[Array, Array]:
    """Return the turns in degrees and the periods in nm of all dots, `[row, column]`, first row on top."""
    model = task.material.model
    assert isinstance(model, Diffracting)
    rows, columns = channels[0].shares.shape[:2]
    turns = np.zeros((rows * len(channels), columns * 3))
    periods = np.zeros_like(turns)
    # neighbours turn to opposite sides
    sign = np.where((np.arange(rows)[:, None] + np.arange(3 * columns)[None, :]) % 2, 1.0, -1.0)
    least, most = next((p.low, p.high) for p in task.parameters if p.path == TURN)
    for k, channel in enumerate(channels):
        distance = model.order_width_rad * np.sqrt(-2.0 * np.log(np.maximum(channel.shares, DARK)))
        away = np.degrees(np.arcsin(np.clip(distance / channel.length, 0.0, 1.0)))
        turned = channel.turn_deg + sign * away.reshape(rows, -1)
        is_out = (turned < least) | (turned > most)
        turned = np.where(is_out, 2.0 * channel.turn_deg - turned, turned)
        turns[k :: len(channels)] = np.clip(turned, least, most)
        periods[k :: len(channels)] = np.tile(channel.periods_nm, columns)
    return turns, periods


def design_hologram(
    task: DesignTask, checkpointer: Checkpointer, begun: float, progress: Callable[[DesignProgress], None] | None
) -> Design:
    """Design a hologram, and write its maps, recipe, mask and previews.

    Args:
        checkpointer: in the folder of the design, which exists.
        progress: called after each picture.

    Raises:
        RecipeError: a geometry is out of reach, or a file would overwrite a picture.
        NacreError: the material cannot be computed, or the folder cannot be written.
    """
    folder = checkpointer.folder
    task.check_overwriting(folder, _preview_names(len(task.targets)))
    channels = []
    for number in range(len(task.targets)):
        channels.append(make_channel(task, number))
        if progress is not None:
            description = f"picture {number + 1} of {len(task.targets)}"
            progress(DesignProgress(np.inf, clock() - begun, np.inf, description=description))
    _check_apart(task, channels)
    turns, periods = dot_maps(task, channels)
    claim(folder)
    clear_solutions(folder, 0)
    bounds = {p.path: (p.low, p.high) for p in task.parameters}
    span = float(periods.min()), float(periods.max())
    maps = [ParameterMap(PERIOD, periods, *span, None), ParameterMap(TURN, turns, *bounds[TURN], None)]
    files = write_maps(folder, maps, {"nacre": __version__, "target": task.fingerprint})
    changes: dict[str, Any] = {m.path: m.texture for m in maps}
    path, copied = write_recipe(folder, task.material, changes, {})
    files = [*copied, *files, *_write_mask(task, folder, turns, periods), *_write_previews(task, folder, channels)]
    white = white_xyz(task.spec.light.illuminants[0], task.spec.light.observer)
    results, entries = [], []
    for channel in channels:
        target_lab = srgb_lab(channel.target.image)  # type: ignore[arg-type]  # a picture
        picture_lab = np.asarray(xyz_to_lab(channel.reached, white))
        distance = np.asarray(delta_e_2000(target_lab, picture_lab))
        mean, target_mean = (part.mean(axis=(0, 1)) for part in (picture_lab, target_lab))
        results.append(
            TargetResult(channel.target, task.spec.light.illuminants[0], mean, target_mean, float(np.median(distance)))
        )
        entries.append(
            {
                "geometry": str(channel.target.geometry), "asked": channel.target.asked,
                "de00_median": float(np.median(distance)), "de00_largest": float(distance.max()),
                "turn_deg": channel.turn_deg, "periods_nm": channel.periods_nm.tolist(),
                "wavelengths_nm": list(PRIMARIES_NM),
            }
        )  # fmt: skip
    facts = {"dots": list(turns.shape), "dot_um": task.spec.limits.dot_um, "channels": entries, "files": files}
    solution = Solution(path, load(path), changes, results, facts)
    status = "met" if all(r.is_met for r in results) else "out of reach"
    worst = max(results, key=lambda r: r.distance)
    message = (
        f"{turns.shape[1]} x {turns.shape[0]} dots of {task.spec.limits.dot_um:g} um; median dE00 "
        f"{worst.distance:.2f} of the picture farther off"
    )
    summary: dict[str, Any] = {
        "status": status, "message": message, "seconds": round(clock() - begun, 3),
        "solutions": [{"recipe": str(path), "worst": solution.worst.scaled, "changes": changes} | facts],
        "light": task.spec.light.model_dump(), "target": task.fingerprint, "nacre": __version__,
    }  # fmt: skip
    return conclude(folder, summary, [solution])


def _preview_names(count: int) -> list[str]:
    return ["reached.png"] if count == 1 else [f"reached-{k}.png" for k in range(1, count + 1)]


def _check_apart(task: DesignTask, channels: Sequence[Channel]) -> None:
    """Refuse two pictures whose dots shine to each other's viewer."""
    model = task.material.model
    assert isinstance(model, Diffracting)
    if len(channels) < 2:
        return
    one, other = (
        c.length * np.array([np.cos(np.radians(c.turn_deg)), np.sin(np.radians(c.turn_deg))]) for c in channels
    )
    if min(np.hypot(*(one - other)), np.hypot(*(one + other))) < APART * model.order_width_rad:
        raise RecipeError(
            f"{channels[1].target.key}: both pictures would be seen at once; allowed: another light_azimuth_deg or "
            "geometry for the second"
        )


def _write_previews(task: DesignTask, folder: Path, channels: Sequence[Channel]) -> list[str]:
    """Write each picture as its viewer sees it."""
    from PIL import Image

    white = white_xyz(task.spec.light.illuminants[0], task.spec.light.observer)
    names = _preview_names(len(channels))
    for name, channel in zip(names, channels, strict=True):
        with atomic_path(folder / name) as temporary:
            pixels = np.round(255.0 * screen_rgb(channel.reached, white)).astype(np.uint8)
            Image.fromarray(pixels).save(temporary, format="PNG")
    return names


def _write_mask(task: DesignTask, folder: Path, turns: Array, periods: Array) -> list[str]:
    """Write the lines of all dots as GDSII and OASIS; dots of equal lines share a cell."""
    kinds, index = np.unique(
        np.stack([np.round(turns, 4).ravel(), periods.ravel()], axis=1), axis=0, return_inverse=True
    )
    side = 1e3 * task.spec.limits.dot_um
    cells = []
    for turn, period in kinds:
        model = task.material.vary({PERIOD: float(period)}).model
        shapes = model.pixel_polygons() if isinstance(model, Pixels) else []
        lines = [(layer, float(c[:, 0].min()), float(c[:, 0].max())) for layer, c in shapes]
        # the raised half period of a continuous profile
        cells.append(_lines(lines or [(1, -0.25 * period, 0.25 * period)], float(period), float(turn), side))
    numbers: NDArray[np.int64] = index.reshape(turns.shape).astype(np.int64)
    for suffix in (".gds", ".oas"):
        write_pixel_field(folder / f"{FIELD}{suffix}", numbers, cells, (side, side), 1)
    return [f"{FIELD}.gds", f"{FIELD}.oas"]


def _lines(
    lines: list[tuple[int, float, float]], period_nm: float, turn_deg: float, side_nm: float
) -> list[tuple[int, Array]]:  # fmt: skip
    """Return turned lines, clipped to a square dot about the origin, as layer and corners in nm."""
    import gdstk

    half, c, s = 0.5 * side_nm, np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    square = gdstk.rectangle((-half, -half), (half, half))
    count = int(np.ceil(np.sqrt(2.0) * half / period_nm)) + 1
    parts = []
    for layer, low, high in lines:
        drawn = []
        for k in range(-count, count + 1):
            x = np.array([low, high, high, low]) + k * period_nm
            y = 2.0 * half * np.array([-1.0, -1.0, 1.0, 1.0])
            drawn.append(gdstk.Polygon(np.column_stack([c * x - s * y, s * x + c * y]).tolist()))
        clipped = gdstk.boolean(drawn, square, "and", precision=0.1)
        parts += [(layer, np.asarray(polygon.points)) for polygon in clipped]
    return parts
