"""The gallery of `nacre demo`: pictures, figures, animations, a design and a contact sheet.

`examples/gallery.toml` lists the recipes and scenes.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, read_text
from nacre.material.examples import examples_folder
from nacre.recipe.model import RecipeContext, RecipeModel, validate
from nacre.recipe.toml import parse_toml

FULL_SIZE, QUICK_SIZE = 1024, 224
FULL_FRAME, QUICK_FRAME = 512, 128
FULL_FRAMES, QUICK_FRAMES = 24, 8
# samples per pixel, sufficient for the denoiser; fixed, so that pictures are equal on all machines
FULL_SPP, QUICK_SPP = 12, 24
FULL_FRAME_SPP, QUICK_FRAME_SPP = 6, 12
RANDOM_WALK_SPP = 3  # factor on the samples of a pearl by random walks, which is noisier than its tables
# seconds of a still, a frame, and twelve further samples on two cores, for the remaining time
STILL_S = {False: 10.0, True: 3.0}
FRAME_S = {False: 3.0, True: 0.4}
SAMPLES_S = {False: 8.0, True: 1.0}
# contact sheet: cell sizes of full and quick runs, cells per row; other sizes for cells of 320
FULL_CELL, QUICK_CELL, MOST_COLUMNS = 480, 320, 6
GAP, CAPTION, LINE, FONT = 16, 46, 19, 15
Report = Callable[["Item", int, int, float, float], None]  # item, number, total, seconds spent, seconds left


class PictureSpec(RecipeModel):
    """A still of the gallery."""

    recipe: str = Field(description="file of the recipe that is shown")
    title: str = Field(description="caption on the contact sheet")
    scene: str = Field(default="sphere", description="scene, as for `nacre render --scene`")
    shape: str | None = Field(
        default=None, description="shape, as for `nacre render --shape`; the scene's own if not given"
    )
    light: str | None = Field(
        default=None, description="light, as for `nacre render --light`; the scene's own if not given"
    )
    illuminant: str = Field(default="D65", description="spectrum of the light, such as D65 or A")
    components: str = Field(
        default="sum", description="parts of the reflection that are shown, as for `nacre render --components`"
    )
    exposure: float | Literal["auto"] = Field(default="auto", description="exposure in stops, or auto")
    view_turn_deg: float = Field(default=0.0, description="turns the view round the object")
    light_turn_deg: float = Field(default=0.0, description="turns the light round the object")
    ratio: float = Field(default=1.0, gt=0, le=1, description="height of the picture over its width")
    zoom: float | None = Field(default=None, description="magnification, as for `nacre render --zoom`")
    spp: float = Field(default=1.0, description="factor on the default number of samples")
    quick: bool = Field(default=False, description="whether it is part of `nacre demo --quick`")
    name: str | None = Field(default=None, description="name of the picture's file; the recipe's if not given")
    quality: Literal["reference", "fast"] | None = Field(
        default=None, description="quality of a pearl, in place of the recipe's own"
    )


class AnimationSpec(PictureSpec):
    """An animation."""

    animate: str = Field(description="what moves: light, view, or PATH=A:B of a number of the recipe")


class RowSpec(RecipeModel):
    """An animation of several materials in rows, with one light and one exposure."""

    recipes: list[str] = Field(min_length=1, description="files of the recipes that are shown together")
    columns: Annotated[int, Field(ge=1)] = Field(description="number of materials in a row")
    title: str = Field(description="caption on the contact sheet")
    name: str = Field(description="name of the animation's file")
    scene: str = Field(description="scene, as for `nacre render --scene`")
    animate: Literal["light", "view"] = Field(description="what moves")
    cell: tuple[int, int] = Field(description="width and height of one material's picture, in pixels")
    spp: float = Field(default=1.0, description="factor on the default number of samples")
    quick: bool = Field(default=False, description="whether it is part of `nacre demo --quick`")
    quality: Literal["reference", "fast"] | None = Field(
        default=None, description="quality of a pearl, in place of the recipe's own"
    )


class PlotSpec(RecipeModel):
    """A figure of the gallery."""

    recipe: str = Field(description="file of the recipe that is drawn")
    title: str = Field(description="caption on the contact sheet")
    kind: str = Field(description="kind of the figure, as for `nacre plot --kind`")
    quick: bool = Field(default=False, description="whether it is part of `nacre demo --quick`")


class DesignSpec(RecipeModel):
    """A design: target file and time limit in seconds."""

    target: str = Field(description="file of the target")
    title: str = Field(description="caption on the contact sheet")
    seconds: float = Field(default=15.0, description="time that the search may take")
    quick: bool = Field(default=False, description="whether it is part of `nacre demo --quick`")


class GallerySpec(RecipeModel):
    """The items of `nacre demo`, as in examples/gallery.toml."""

    picture: list[PictureSpec] = Field(default=[], description="the stills")
    animation: list[AnimationSpec] = Field(default=[], description="the animations of one material")
    row: list[RowSpec] = Field(default=[], description="the animations of several materials at once")
    plot: list[PlotSpec] = Field(default=[], description="the figures")
    design: list[DesignSpec] = Field(default=[], description="the designs")


@dataclass(frozen=True)
class Item:
    """One item: title, file, cost in arbitrary units, and the function that makes it."""

    title: str
    path: Path
    cost: float
    make: Callable[[], None] = field(repr=False)


def load_gallery(folder: Path) -> GallerySpec:
    """Read `gallery.toml` of a folder of recipes.

    Raises:
        RecipeError: it is not valid.
    """
    path = folder / "gallery.toml"
    text = read_text(path, "gallery")
    gallery: GallerySpec = validate(GallerySpec, parse_toml(text, str(path)), RecipeContext(str(path), folder, text))
    return gallery


def plan(folder: Path, out: Path, is_quick: bool) -> list[Item]:
    """Return the items in order."""
    gallery = load_gallery(folder)
    items = [_design(folder, out, d, is_quick) for d in gallery.design if d.quick or not is_quick]
    items += [_picture(folder, out, p, is_quick) for p in gallery.picture if p.quick or not is_quick]
    items += [_plot(folder, out, p) for p in gallery.plot if p.quick or not is_quick]
    items += [_animation(folder, out, a, is_quick) for a in gallery.animation if a.quick or not is_quick]
    items += [_row(folder, out, r, is_quick) for r in gallery.row if r.quick or not is_quick]
    return items


def run_demo(out: Path, is_quick: bool, report: Report) -> list[Path]:
    """Create all items and the contact sheet; return the files.

    Args:
        out: folder, created if needed.
        is_quick: small pictures of the quick items only.
        report: called before each item with (item, number, total, seconds spent, seconds left).

    Raises:
        NacreError: an item cannot be made, or the folder cannot be written.
    """
    folder = examples_folder()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{out}: cannot be made: {error.strerror}") from None
    items = plan(folder, out, is_quick)
    start = time.monotonic()
    spent, total = 0.0, sum(item.cost for item in items)
    for number, item in enumerate(items):
        seconds = time.monotonic() - start
        # before the first item is finished, cost units are seconds of a two-core machine
        seconds_left = (total - spent) * (seconds / spent if spent > 0 else 1.0)
        report(item, number + 1, len(items), seconds, seconds_left)
        item.make()
        spent += item.cost
    sheet = out / "contact-sheet.png"
    stills = [item for item in items if item.path.suffix == ".png"]
    cell = QUICK_CELL if is_quick else FULL_CELL
    contact_sheet([(item.title, item.path) for item in stills], sheet, cell)
    return [sheet, *(item.path for item in items)]


def _picture(folder: Path, out: Path, spec: PictureSpec, is_quick: bool) -> Item:
    side = QUICK_SIZE if is_quick else FULL_SIZE
    # the tables of a pearl take longer than a small picture by random walks
    is_random_walk = is_quick and spec.quality == "fast"
    samples = spec.spp * (RANDOM_WALK_SPP if is_random_walk else 1)
    spp = max(4, round((QUICK_SPP if is_quick else FULL_SPP) * samples))
    seconds = STILL_S[is_quick] + SAMPLES_S[is_quick] * samples
    path = out / f"{spec.name or Path(spec.recipe).stem}.png"

    def make() -> None:
        bsdf = _solved(folder, out, spec.recipe, "reference" if is_random_walk else spec.quality)
        look = {**_appearance(spec), "view_turn_deg": spec.view_turn_deg, "light_turn_deg": spec.light_turn_deg}
        _rendered(bsdf, output=path, size=_size(side, spec.ratio), spp=spp, progress=False, **look)

    return Item(spec.title, path, seconds, make)


def _animation(folder: Path, out: Path, spec: AnimationSpec, is_quick: bool) -> Item:
    side = QUICK_FRAME if is_quick else FULL_FRAME
    frames = QUICK_FRAMES if is_quick else FULL_FRAMES
    spp = max(4, round((QUICK_FRAME_SPP if is_quick else FULL_FRAME_SPP) * spec.spp))
    path = out / f"{spec.name or Path(spec.recipe).stem}-moving.mp4"

    def make() -> None:
        from nacre.render.pictures import animate

        moving = spec.animate in ("light", "view")
        material = _solved(folder, out, spec.recipe, spec.quality) if moving else _find(folder, out, spec.recipe)
        size = _size(side, spec.ratio)
        animate(material, spec.animate, path, frames=frames, size=size, spp=spp, progress=False, **_appearance(spec))

    return Item(spec.title, path, FRAME_S[is_quick] * frames, make)


def _row(folder: Path, out: Path, spec: RowSpec, is_quick: bool) -> Item:
    frames = QUICK_FRAMES if is_quick else FULL_FRAMES
    path = out / f"{spec.name}-moving.mp4"
    half = 2 if is_quick else 1
    size = (spec.cell[0] // half, spec.cell[1] // half)
    spp = max(4, round((QUICK_FRAME_SPP if is_quick else FULL_FRAME_SPP) * spec.spp))

    def make() -> None:
        from nacre.picture.images import read_provenance
        from nacre.render.pictures import animate, join

        exposure: Any = "auto"
        parts = []
        for recipe in spec.recipes:
            bsdf = _solved(folder, out, recipe, spec.quality)
            look: dict[str, Any] = {"scene": spec.scene}
            part = path.with_name(f"{spec.name}-parts") / f"{Path(recipe).stem}.mp4"
            part.parent.mkdir(exist_ok=True)
            made = animate(
                bsdf, spec.animate, part, frames=frames, size=size, spp=spp, exposure=exposure, progress=False, **look
            )
            if made.interrupted:
                raise KeyboardInterrupt
            # one exposure for all, for comparison
            exposure = float(read_provenance(made.frames[0])["exposure_stops"])
            parts.append(made.frames)
        folder_of_frames = path.with_name(f"{path.stem}_frames")
        folder_of_frames.mkdir(exist_ok=True)
        frame_files = tuple(folder_of_frames / f"frame_{index:04d}.png" for index in range(frames))
        for index, name in enumerate(frame_files):
            tile([part[index] for part in parts], spec.columns, name)
        join(frame_files, path)

    return Item(spec.title, path, FRAME_S[is_quick] * frames, make)


def tile(pictures: Sequence[Path], columns: int, path: Path) -> None:
    """Arrange pictures of equal size in rows.

    Raises:
        NacreError: the file cannot be written.
    """
    from PIL import Image

    loaded = []
    for file in pictures:
        with Image.open(file) as picture:
            loaded.append(picture.convert("RGB"))
    width, height = loaded[0].size
    sheet = Image.new("RGB", (min(columns, len(loaded)) * width, -(-len(loaded) // columns) * height))
    for index, part in enumerate(loaded):
        sheet.paste(part, (index % columns * width, index // columns * height))
    with atomic_path(path) as temporary:
        sheet.save(temporary, format="PNG")


def _size(width: int, ratio: float) -> tuple[int, int]:
    """Return width and height, both even, as video formats require."""
    return width, 2 * round(0.5 * ratio * width)


def _rendered(material: Any, **options: Any) -> None:
    """Render one picture; an interrupt ends the whole run."""
    from nacre.picture import interrupt
    from nacre.picture.picture import render

    if render(material, **options).stats["interrupted"] or interrupt.came_late():
        raise KeyboardInterrupt


def _plot(folder: Path, out: Path, spec: PlotSpec) -> Item:
    path = out / f"{Path(spec.recipe).stem}-{spec.kind}.png"

    def make() -> None:
        from nacre.plot import save_material

        save_material(_find(folder, out, spec.recipe), spec.kind, path)

    return Item(spec.title, path, 2.0, make)


def _design(folder: Path, out: Path, spec: DesignSpec, is_quick: bool) -> Item:
    path = out / Path(spec.target).stem
    seconds = spec.seconds / (3 if is_quick else 1)
    from nacre.optimise.task import is_relief_task

    data = parse_toml(read_text(folder / spec.target, "target"), spec.target)

    def make() -> None:
        from nacre.optimise.run import read_target, run

        run(read_target(folder / spec.target).within_seconds(seconds), path)

    return Item(spec.title, path if is_relief_task(data) else path / "report.png", seconds + 3, make)


def _find(folder: Path, out: Path, recipe: str) -> Any:
    """Load an example recipe, or a design of this run."""
    from nacre.material.material import load

    made = out / recipe
    return load(made if (made / "recipe.toml").is_file() else folder / recipe)


@functools.lru_cache(maxsize=4)
def _solved(folder: Path, out: Path, recipe: str, quality: str | None) -> Any:
    """Return the Bsdf of a recipe; few are cached, to save memory."""
    material = _find(folder, out, recipe)
    return (material.vary({"quality": quality}) if quality else material).bsdf()


def _appearance(spec: PictureSpec) -> dict[str, Any]:
    return {
        "scene": spec.scene, "shape": spec.shape, "light": spec.light, "illuminant": spec.illuminant,
        "components": spec.components, "exposure": spec.exposure, "zoom": spec.zoom,
    }  # fmt: skip


def contact_sheet(pictures: list[tuple[str, Path]], path: Path, cell: int = QUICK_CELL) -> None:
    """Arrange pictures with titles in rows; the longer side of each has `cell` pixels.

    Raises:
        NacreError: the file cannot be written.
    """
    from PIL import Image, ImageDraw, ImageFont

    gap, caption, line, size = (round(each * cell / QUICK_CELL) for each in (GAP, CAPTION, LINE, FONT))
    columns = max(1, min(MOST_COLUMNS, round(len(pictures) ** 0.5 + 0.5)))
    rows = -(-len(pictures) // columns)
    width, height = columns * (cell + gap) + gap, rows * (cell + caption + gap) + gap
    sheet = Image.new("RGB", (width, height), (250, 250, 249))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=size)
    for index, (title, file) in enumerate(pictures):
        x = gap + (index % columns) * (cell + gap)
        y = gap + (index // columns) * (cell + caption + gap)
        with Image.open(file) as picture:
            small = picture.convert("RGB")
        scale = cell / max(small.size)
        small = small.resize((round(small.width * scale), round(small.height * scale)), Image.Resampling.LANCZOS)
        sheet.paste(small, (x + (cell - small.width) // 2, y + (cell - small.height) // 2))
        for number, words in enumerate(_wrapped(title, lambda words: draw.textlength(words, font=font) <= cell)[:2]):
            place = x, y + cell + round(0.3 * line) + line * number
            draw.text(place, words, fill=(60, 60, 60), font=font)
    with atomic_path(path) as temporary:
        sheet.save(temporary, format="PNG")


def _wrapped(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Break a caption into lines that fit."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if fits(longer) or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
