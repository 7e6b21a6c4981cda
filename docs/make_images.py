"""Render the pictures that README and gallery show, and store them small in docs/images.

`python docs/make_images.py` makes all; names after it make some: `hero`, `glass`, `sem`, `afm`, `feather`,
`layer-off`, `car-paint`, `gallery`, or names of the gallery. `--demo DIR` takes the pictures of gallery and hero from
the folder of `make demo OUT=DIR`. The pictures are committed, so the documentation builds in minutes; make them anew
when one has changed.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

import nacre
from nacre.cli.gallery import PictureSpec, load_gallery
from nacre.material.examples import examples_folder

IMAGES = Path(__file__).parent / "images"
THUMBNAIL = 360
PANEL = (400, 320)
HERO_PANEL = (664, 530)  # three of them and their gaps are 2,004 pixels wide
GAP = 6
GROUND = (18, 18, 20)
SPP = 64
MAX_BYTES = 600_000


@dataclass(frozen=True)
class Panel:
    """One picture of a sheet: a recipe (or target) of examples/, or a recipe's table, and how it is shown."""

    recipe: str | dict[str, Any]
    scene: str
    light: str | None = None
    spp: int = SPP
    quality: str | None = None
    shape: str | None = None
    zoom: float = 1.0
    view_turn_deg: float = 0.0
    centre: float = 0.5  # across, of the part that is taken of a demo's picture


# bubbles, a wing, a bottle / jewellery, a metasurface, a foil on a card: all families, no two shapes alike
HERO = (
    Panel("soap.toml", "bubble", spp=96),
    Panel("morpho.toml", "butterfly", centre=1.0),  # its label stands on the right
    Panel("pearl/bottle1.toml", "bottle", spp=96, quality="fast"),
    Panel("anodised-titanium.toml", "cuff"),
    Panel("metasurface/silver_on_oxide.toml", "speedshape", centre=0.3),
    Panel("relief/rainbow.toml", "pass"),
)

# blue where they are lit and seen steeply, as a feather barb is
BLUE_FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 300}],
    "surface": {"roughness": 0.3},
}
BLUE_PEARL: dict[str, Any] = {
    "family": "pearl",
    "strata": [
        {
            "resin": {"n": 1.5},
            "thickness_um": 40,
            "platelets": [
                {
                    "volume_fraction": 0.06,
                    "normal_deviation": 0.12,
                    "substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 90},
                    "coatings": [{"material": "TiO2", "thickness_nm": 112}],
                }
            ],
        }
    ],
    "base": {"albedo": 0.02},
}

# photonic glass as a feather, a paint and a tile; and its colour over the angle beside a film's and a pearl's
GLASS = (
    Panel("glass/feather_barb.toml", "sphere", quality="fast", shape="feather", zoom=1.22, view_turn_deg=-25.0),
    Panel("glass/supraball_paint.toml", "body", light="street", quality="fast"),
    Panel("glass/polystyrene_black.toml", "panel", quality="fast"),
    Panel(BLUE_FILM, "sphere"),
    Panel(BLUE_PEARL, "sphere", quality="fast", spp=2 * SPP),
    Panel("glass/feather_barb.toml", "sphere", quality="fast"),
)


def _pixels(panel: Panel, size: tuple[int, int], folder: Path, scratch: Path) -> Image.Image:
    """Render one panel; a target is designed first."""
    if isinstance(panel.recipe, dict):
        material = nacre.material(panel.recipe)
    else:
        source = folder / panel.recipe
        material = nacre.load(_designed(source, scratch) if panel.recipe.startswith("targets/") else source)
    shape = _feather(folder, scratch) if panel.shape == "feather" else panel.shape
    result = nacre.render(
        material, panel.scene, light=panel.light, size=size, spp=panel.spp, quality=panel.quality,
        shape=shape, up="z" if shape else None, zoom=panel.zoom, view_turn_deg=panel.view_turn_deg, progress=False,
    )  # fmt: skip
    return Image.fromarray(np.asarray(result.srgb8))


def _designed(target: Path, scratch: Path) -> Path:
    design = scratch / target.stem
    if not design.exists():
        nacre.design(target, design)
    return design


def _feather(folder: Path, scratch: Path) -> str:
    """Write the mesh that `examples/feather.py` makes."""
    mesh = scratch / "feather.obj"
    subprocess.run([sys.executable, str(folder / "feather.py"), str(mesh)], check=True)
    return str(mesh)


def make_sheet(
    name: str, panels: tuple[Panel, ...], size: tuple[int, int], folder: Path, scratch: Path, demo: Path | None = None
) -> Path:
    """Set six panels of a size three by two on a dark ground; out of a demo's pictures where there is one."""
    width, height = size
    sheet = Image.new("RGB", (3 * width + 2 * GAP, 2 * height + GAP), GROUND)
    for number, panel in enumerate(panels):
        print(f"{name}: {panel.recipe if isinstance(panel.recipe, str) else panel.recipe['family']}", flush=True)
        kept = scratch / f"{name}-{number}.png"  # so that a stopped run goes on
        if not kept.exists():
            if demo is None:
                _pixels(panel, size, folder, scratch).save(kept)
            else:
                with Image.open(demo / f"{Path(str(panel.recipe)).stem}.png") as made:
                    ImageOps.fit(made.convert("RGB"), size, centering=(panel.centre, 0.5)).save(kept)
        row, column = divmod(number, 3)
        sheet.paste(Image.open(kept), (column * (width + GAP), row * (height + GAP)))
    for kept in scratch.glob(f"{name}-*.png"):
        kept.unlink()
    return _save(sheet, IMAGES / f"{name}.jpg")


def take_thumbnail(picture: PictureSpec, demo: Path) -> Path:
    """Store a picture of a demo small."""
    name = thumbnail_name(picture)
    with Image.open(demo / f"{name}.png") as made:
        size = (THUMBNAIL, 2 * round(0.5 * picture.ratio * THUMBNAIL))
        small = made.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    return _save(small, IMAGES / "gallery" / f"{name}.jpg")


def make_thumbnail(picture: PictureSpec, folder: Path, scratch: Path) -> Path:
    """Render one picture of the gallery, small; a recipe that is a design's name is designed first."""
    target = folder / "targets" / f"{picture.recipe}.toml"
    source = _designed(target, scratch) if target.is_file() else folder / picture.recipe
    result = nacre.render(
        nacre.load(source), picture.scene, shape=picture.shape, light=picture.light, illuminant=picture.illuminant,
        components=picture.components, exposure=picture.exposure, zoom=picture.zoom, spp=int(32 * picture.spp),
        size=(THUMBNAIL, 2 * round(0.5 * picture.ratio * THUMBNAIL)), light_turn_deg=picture.light_turn_deg,
        view_turn_deg=picture.view_turn_deg, quality=picture.quality, progress=False,
    )  # fmt: skip
    return _save(Image.fromarray(np.asarray(result.srgb8)), IMAGES / "gallery" / f"{thumbnail_name(picture)}.jpg")


def thumbnail_name(picture: PictureSpec) -> str:
    """Return the name of a gallery picture: its own, or its recipe's."""
    return picture.name or Path(picture.recipe).stem


def make_sem(scratch: Path) -> Path:
    """Draw the micrograph of the tutorial by its own program, and render its own recipe beside it."""
    recipe = _run_page("from-an-sem-image", "sem.png", scratch)
    return _beside(Image.open(scratch / "sem.png").convert("RGB"), recipe, IMAGES / "sem.jpg")


def make_afm(scratch: Path) -> Path:
    """Draw the scan of the tutorial by its own program, and render its own recipe beside it."""
    recipe = _run_page("from-an-afm-scan", "scan.txt", scratch)
    heights = nacre.load(recipe).model.tile.heights_nm.T[::-1]
    grey = (heights - heights.min()) / np.ptp(heights)
    return _beside(Image.fromarray(np.uint8(255 * grey)).convert("RGB"), recipe, IMAGES / "afm.jpg")


def make_feather(scratch: Path) -> Path:
    """Draw the measured spectrum of the tutorial and that of its fitted film, and render the film beside them."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    from nacre.cli import run

    page = (Path(__file__).parent / "howto" / "feather.md").read_text(encoding="utf-8")
    with contextlib.chdir(scratch):
        Path("barbule.toml").write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
        exec(compile(page.split("```python\n")[1].split("```")[0], "feather.md", "exec"), {})  # the page's own
        if run(["fit", "feather.txt", "barbule.toml", "-o", "fitted.toml"]):
            raise SystemExit("the fit of the page failed")
        measured = nacre.read("feather.txt")
        fitted = nacre.load("fitted.toml")
        nm = np.arange(380.0, 781.0, 2.0)
        computed = 100 * nacre.spectrum(fitted, 0.0, nm).parts()["specular_reflectance"][0]
        figure, axes = pyplot.subplots(figsize=(4.2, 4.2), dpi=PANEL[1] / 4.2, layout="constrained")
        axes.plot(
            measured.data["wavelength_nm"], 100 * measured.data["reflectance"], ".", color="0.6", ms=3, label="file"
        )
        axes.plot(nm, computed, "-", color="C3", lw=1.2, label="fitted film")
        axes.set(xlim=(300, 800), ylim=(0, 25), xlabel="wavelength (nm)", ylabel="reflectance (%)")
        axes.legend(frameon=False)
        figure.savefig("feather.png")
        pyplot.close(figure)
        return _beside(Image.open("feather.png").convert("RGB"), Path("fitted.toml"), IMAGES / "feather.jpg")


def make_layer_off(scratch: Path) -> Path:
    """Draw the page's spectra: of the recipe, the run, and the recipe as made."""
    from nacre.cli import run
    from nacre.plot.style import house_style, new_figure

    page = (Path(__file__).parent / "howto" / "layer-that-was-off.md").read_text(encoding="utf-8")
    with contextlib.chdir(scratch):
        Path("antireflex.toml").write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
        for line in page.split("```bash\n")[1].split("```")[0].strip().splitlines():
            if run(line.split()[1:]):
                raise SystemExit(f"failed: {line}")
        nm = np.arange(380.0, 781.0, 2.0)
        run_data = nacre.read("run.csv").data
        with house_style():
            figure = new_figure(5.2, 2.8)
            axes = figure.subplots()
            for name, style in (("antireflex.toml", "--"), ("as-made.toml", "-")):
                found = nacre.spectrum(nacre.load(name), 0.0, nm).parts()["specular_reflectance"][0]
                axes.plot(nm, 100 * found, style, label={"--": "recipe", "-": "as made, by the diagnosis"}[style])
            axes.plot(run_data["wavelength_nm"], 100 * run_data["reflectance"], ".", color="0.3", ms=3, label="run")
            axes.set(xlim=(380, 780), ylim=(0, None), xlabel="wavelength (nm)", ylabel="reflectance (%)")
            axes.legend(frameon=False)
            figure.savefig("layer-off.png", dpi=140)
        return _save(Image.open("layer-off.png").convert("RGB"), IMAGES / "layer-off.jpg")


def make_car_paint(scratch: Path) -> Path:
    """Draw the camera pictures of the page's two silvers, which differ in flake diameter."""
    from nacre.measure.texture import measure_texture
    from nacre.plot import texture_figure

    page = (Path(__file__).parent / "howto" / "car-paint.md").read_text(encoding="utf-8")
    recipe = scratch / "coarse.toml"
    recipe.write_text(page.split("# coarse.toml\n")[1].split("```")[0], encoding="utf-8")
    coarse = nacre.load(recipe)
    both = [("12 \u00b5m", coarse.vary({"strata[0].platelets[0].diameter_um": 12})), ("34 \u00b5m", coarse)]
    figure = texture_figure([(name, measure_texture(made, method="patch").pictures) for name, made in both])
    figure.savefig(scratch / "car-paint.png", dpi=110)
    return _save(Image.open(scratch / "car-paint.png").convert("RGB"), IMAGES / "car-paint.jpg")


def _run_page(name: str, made: str, scratch: Path) -> Path:
    """Run the program of a page, which writes the file `made`, in `scratch`; return the page's recipe there."""
    page = (Path(__file__).parent / "howto" / f"{name}.md").read_text(encoding="utf-8")
    program = page.split("```python\n")[1].split("```")[0].replace(f'"{made}"', repr(str(scratch / made)))
    exec(compile(program, f"{name}.md", "exec"), {})  # the page's own
    recipe = scratch / f"{Path(made).stem}.toml"
    recipe.write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    return recipe


def _beside(drawn: Image.Image, recipe: Path, path: Path) -> Path:
    """Store a picture with a sphere of a recipe beside it."""
    size = PANEL[1]
    look = nacre.render(nacre.load(recipe), "sphere", size=(size, size), spp=SPP, progress=False)
    sheet = Image.new("RGB", (2 * size + GAP, size), GROUND)
    sheet.paste(drawn.resize((size, size)), (0, 0))
    sheet.paste(Image.fromarray(np.asarray(look.srgb8)), (size + GAP, 0))
    return _save(sheet, path)


def _save(image: Image.Image, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, quality=90, optimize=True)
    if path.stat().st_size > MAX_BYTES:
        raise SystemExit(f"{path} is larger than {MAX_BYTES} bytes")
    print(path, flush=True)
    return path


def main(names: list[str], demo: Path | None = None) -> None:
    """Make the pictures that are named; all, where none is.

    Args:
        demo: folder of a demo, to take the gallery's and the hero's from.
    """
    folder = examples_folder()
    scratch = Path(tempfile.gettempdir()) / "nacre-docs-images"
    scratch.mkdir(exist_ok=True)
    for picture in load_gallery(folder).picture:
        if not names or "gallery" in names or thumbnail_name(picture) in names:
            if demo is None:
                make_thumbnail(picture, folder, scratch)
            else:
                take_thumbnail(picture, demo)
    if not names or "hero" in names:
        make_sheet("families", HERO, HERO_PANEL, folder, scratch, demo)
    if not names or "glass" in names:
        make_sheet("glass", GLASS, PANEL, folder, scratch)
    if not names or "sem" in names:
        make_sem(scratch)
    if not names or "afm" in names:
        make_afm(scratch)
    if not names or "feather" in names:
        make_feather(scratch)
    if not names or "layer-off" in names:
        make_layer_off(scratch)
    if not names or "car-paint" in names:
        make_car_paint(scratch)


if __name__ == "__main__":
    asked = argparse.ArgumentParser()
    asked.add_argument("names", nargs="*")
    asked.add_argument("--demo", type=Path)
    given = asked.parse_args()
    main(given.names, given.demo)
