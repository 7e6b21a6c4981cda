"""Commands that show a material: render, demo, studio."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from nacre.cli import common
from nacre.cli.common import STATUS_INTERRUPTED, stopped_line
from nacre.core.errors import NacreError
from nacre.core.files import check_writable, short_name

MOVIES = (".gif", ".mp4")
SCENES = (
    "sphere|probe|speedshape|panel|butterfly|beetle|bottle|knob|body|ring|bubble|feather|cuff|card|strip|lens|banknote|pass|"
    "screen|SCENE.xml"
)


@click.command()
@click.argument("recipe", metavar="RECIPE|FILE.nacre|DESIGN_DIR")
@click.option("--scene", default="sphere", show_default=True, metavar=SCENES)
@click.option(
    "--shape",
    default=None,
    metavar="MESH",
    help=(
        "Another object: a scene's name, or a mesh file (obj, ply, stl, gltf). Textures and formulas use its uv: "
        "u runs to the right of an image and v up. A mesh without uv is wrapped: u once round the vertical axis, "
        "v from its lowest point up. Formulas also take its x, y and z, in radii of its bounding sphere."
    ),
)
@click.option("--up", type=click.Choice(["x", "y", "z"]), default=None, help="Upward axis of the mesh file.")
@click.option("--turn", type=float, default=0.0, metavar="DEG", help="Turn the object, counter-clockwise from above.")
@click.option(
    "--view",
    default=None,
    metavar="AZIMUTH,ELEVATION",
    help="Camera direction in degrees: azimuth 0 is the front and 90 the right; its distance is that of the scene.",
)
@click.option("--fov", type=float, default=None, metavar="DEG", help="Angle of view across; the object keeps its size.")
@click.option("--zoom", type=float, default=None, metavar="FACTOR", help="Magnification.")
@click.option(
    "--light",
    default=None,
    metavar="NAME|ENVMAP[:STRENGTH][@TURN],...",
    help="studio, line, sun, sky, directional, interior, street, garden, or a map; several: studio:0.5,sun@120.",
)
@click.option("--light-layers", is_flag=True, help="Write each light's contribution as a layer of the EXR.")
@click.option("--illuminant", default="D65", show_default=True, help="Spectrum of the light sources.")
@click.option(
    "--background",
    default="scene",
    show_default=True,
    metavar="scene|transparent|COLOUR",
    help="Cut the object out: on nothing, or on a colour such as grey or #30343a.",
)
@click.option("--size", default=None, metavar="WxH", help="Pixels; default: the scene's own.")
@click.option(
    "--noise",
    type=float,
    default=None,
    metavar="SHARE",
    help="Render until the object's median pixel has this relative noise; default: 0.02, with at most 1024 "
    "samples per pixel.",
)
@click.option("--spp", type=int, default=None, help="In place of --noise: samples per pixel.")
@click.option("--seconds", type=float, default=None, metavar="S", help="Render for S seconds, instead of to a noise.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option(
    "--quality", type=click.Choice(["reference", "fast"]), default=None, help="Pearls: random walk or fast tables."
)
@click.option(
    "--polariser", default=None, metavar="left|right|DEG",
    help="Filter before the camera: circular, or linear with its axis at an angle from the horizontal.",
)  # fmt: skip
@click.option("--light-polarisation", default=None, metavar="left|right|DEG", help="The same for the light.")
@click.option(
    "--layers",
    type=click.Choice(["stokes"]),
    default=None,
    help="Further layers of the EXR: the Stokes images S0 to S3.",
)
@click.option("--components", type=click.Choice(["sum", "specular", "diffuse"]), default="sum", show_default=True)
@click.option("--exposure", default="auto", show_default=True, help='"auto", or stops.')
@click.option(
    "--tone",
    type=click.Choice(["srgb", "filmic"]),
    default="srgb",
    show_default=True,
    help="filmic: highlights roll off by the display curve of ACES (Narkowicz), so colours are not colorimetric.",
)
@click.option("--denoise/--no-denoise", default=True, show_default=True, help="Denoise the picture.")
@click.option(
    "--animate", default=None, metavar="light|view|time|PATH=A:B", help="Rotate light or view, or vary a number."
)
@click.option("--frames", type=click.IntRange(2, 100_000), default=48, show_default=True)
@click.option(
    "-o", "output", default=None, metavar="FILE", help="png, jpg, webp, exr, gif, mp4. Default: RECIPE.png, .gif."
)
@common.recipe_options
@common.cluster_options
def render(
    recipe: str, animate: str | None, frames: int, output: str | None, changes: tuple[str, ...], exposure: str,
    workers: Any, **settings: Any,
) -> None:  # fmt: skip
    """Render a material on an object."""
    from nacre.picture.images import STILL_SUFFIXES
    from nacre.picture.interrupt import leaving_at_once

    suffixes = MOVIES if animate else STILL_SUFFIXES
    path = Path(output) if output else Path(f"{short_name(recipe)}{suffixes[0]}")
    if path.suffix.lower() not in suffixes:
        what = "an animation" if animate else "a picture"
        raise NacreError(f"-o {path}: {what} is written as {', '.join(suffixes[:-1])} or {suffixes[-1]}")
    check_writable(path)
    if settings["light_layers"] and path.suffix.lower() != ".exr":
        raise NacreError(f"-o {path}: --light-layers are layers of an EXR; write .exr")
    if settings["tone"] != "srgb" and path.suffix.lower() == ".exr":
        raise NacreError(f"-o {path}: --tone is for pictures in sRGB; an EXR holds the light itself, without a curve")
    if settings["layers"] and (animate or path.suffix.lower() != ".exr"):
        raise NacreError(f"-o {path}: --layers {settings['layers']} are layers of an EXR; write .exr")
    if animate:
        del settings["light_layers"], settings["layers"]
        settings["workers"] = workers
        workers = type(workers)()
    options: dict[str, Any] = {**settings, "exposure": _exposure(exposure)}
    with leaving_at_once(STATUS_INTERRUPTED, stopped_line):
        material = common.load_material(recipe, changes)
        with common.solving_on(workers, material):
            _render(material, path, animate, frames, options)


def _render(material: Any, path: Path, animate: str | None, frames: int, options: dict[str, Any]) -> None:
    if animate:
        from nacre.render.pictures import animate as render_animation

        if render_animation(material, animate, path, frames=frames, **options).interrupted:
            raise KeyboardInterrupt
        common.note(str(path))
        return
    from nacre.render import render as render_picture

    result = render_picture(material, output=path, **options)
    common.note(_summary(path, result.stats))
    if result.stats.get("interrupted"):
        raise KeyboardInterrupt


def _exposure(text: str) -> Any:
    if text == "auto":
        return "auto"
    try:
        return float(text)
    except ValueError:
        raise NacreError(f'--exposure = "{text}" should be "auto" or a number of stops') from None


def _summary(path: Path, stats: Mapping[str, Any]) -> str:
    width, height = stats.get("size", ("?", "?"))
    line = f"{path}: {width}x{height}, {stats.get('spp', '?')} samples a pixel, {stats.get('illuminant', '?')}"
    clipped = stats.get("clipped_pixels", 0)
    if "cannot be imported" in str(stats.get("raw_because", "")):
        line += f"; not denoised: {stats['raw_because']}"
    return line + (f", {clipped} pixels clipped into sRGB (brighter or purer than the screen shows)" if clipped else "")


@click.command()
@click.option("--out", default="demo", show_default=True, metavar="DIR")
@click.option("--quick", is_flag=True, help="Small pictures of a few recipes, in about a minute.")
@common.jobs_option
def demo(out: str, quick: bool) -> None:
    """Make pictures, figures and animations of every example recipe, and a contact sheet."""

    def show(item: Any, number: int, total: int, seconds: float, rest: float) -> None:
        common.note(f"[{number:2d}/{total}] {_clock(seconds)} spent, about {_clock(rest)} left: {item.title}")

    from nacre.cli.gallery import run_demo

    files = run_demo(Path(out), quick, show)
    common.note(f"{len(files)} files in {out}; begin with {files[0]}")


def _clock(seconds: float) -> str:
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}"


@click.command()
@click.argument("what", metavar="[RECIPE|FOLDER]", required=False)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=None, metavar="N",
    help="Listen on this port, 0 for any that is free; default: 8642, or any.",
)  # fmt: skip
@click.option("--no-browser", is_flag=True, help="Only print the address, and open nothing.")
@common.jobs_option
def studio(what: str | None, port: int | None, no_browser: bool) -> None:
    """Open a live page on a RECIPE, or on a FOLDER of recipes, in the browser.

    Prints one address with a secret token and serves until Ctrl-C. Recipes are read from and saved to the folder;
    default: the current one. Needs no network.
    """
    from nacre.studio.folder import OpenedFolder

    opened = OpenedFolder.of(what)
    from nacre.studio.server import serve

    serve(opened, port, not no_browser)
