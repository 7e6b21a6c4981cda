"""The demo's plan: every recipe and target of the gallery exists and is allowed; the sheet holds every picture."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from nacre.cli import run
from nacre.cli.gallery import (
    FULL_CELL,
    FULL_FRAME,
    FULL_FRAMES,
    FULL_SIZE,
    QUICK_CELL,
    contact_sheet,
    load_gallery,
    plan,
    tile,
)
from nacre.material.examples import examples_folder
from nacre.material.material import load
from nacre.optimise.run import read_target
from nacre.picture.scenes import SCENE_NAMES

FAMILIES = ("film", "pearl", "metasurface", "relief")
IMAGES = Path(__file__).parents[2] / "docs" / "images" / "gallery"


def test_every_entry_of_the_gallery_can_be_made() -> None:
    folder = examples_folder()
    gallery = load_gallery(folder)
    designs = {Path(d.target).stem for d in gallery.design}
    for entry in [*gallery.picture, *gallery.animation, *gallery.plot]:
        assert entry.recipe in designs or load(folder / entry.recipe)
    for entry in [*gallery.picture, *gallery.animation]:
        assert entry.scene in SCENE_NAMES
    for row in gallery.row:
        assert row.scene in SCENE_NAMES
        assert all(load(folder / recipe) for recipe in row.recipes)
    for design in gallery.design:
        assert read_target(folder / design.target).name


@pytest.mark.parametrize("is_quick", [True, False])
def test_the_demo_shows_every_family(tmp_path: Path, is_quick: bool) -> None:
    folder = examples_folder()
    gallery = load_gallery(folder)
    recipes = [folder / p.recipe for p in gallery.picture if (p.quick or not is_quick) and p.recipe.endswith(".toml")]
    shown = {load(recipe).family for recipe in recipes}
    shown |= {"relief"} if any(d.quick or not is_quick for d in gallery.design) else set()
    assert shown >= set(FAMILIES)
    items = plan(folder, tmp_path, is_quick)
    assert len({item.path for item in items}) == len(items)


def test_the_whole_demo_is_as_large_as_it_says(tmp_path: Path) -> None:
    """24 pictures of 1,024 pixels, 6 animations of 24 frames and 512 pixels, a sheet of 3,000 pixels."""
    folder = examples_folder()
    gallery = load_gallery(folder)
    assert len(gallery.picture) >= 24 and FULL_SIZE >= 1024
    items = plan(folder, tmp_path, False)
    assert len([item for item in items if item.path.suffix == ".mp4"]) >= 6
    assert FULL_FRAMES >= 24 and FULL_FRAME >= 512
    assert all(row.cell[0] * row.columns >= 512 for row in gallery.row)
    dot = tmp_path / "dot.png"
    Image.new("RGB", (8, 8)).save(dot)
    stills = [(item.title, dot) for item in items if item.path.suffix == ".png"]
    contact_sheet(stills, tmp_path / "sheet.png", FULL_CELL)
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.width >= 3000


def test_the_documentation_has_a_picture_of_each_entry_and_no_other() -> None:
    entries = {p.name or Path(p.recipe).stem: p.ratio for p in load_gallery(examples_folder()).picture}
    shown = {path.stem: path for path in IMAGES.glob("*.jpg")}
    assert set(shown) == set(entries)
    for name, ratio in entries.items():
        with Image.open(shown[name]) as picture:
            # of the scene as it is now: its own height over its width
            assert picture.height == pytest.approx(ratio * picture.width, abs=2), name


def test_the_contact_sheet_holds_every_picture(tmp_path: Path) -> None:
    pictures = []
    for number, colour in enumerate(("red", "lime", "blue")):
        path = tmp_path / f"{number}.png"
        Image.new("RGB", (64, 48), colour).save(path)
        pictures.append((f"A title that is long enough to need a second line, number {number}", path))
    contact_sheet(pictures, tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as sheet:
        counts = {colour: count for count, colour in sheet.convert("RGB").getcolors(1 << 22)}
    for colour in ((255, 0, 0), (0, 255, 0), (0, 0, 255)):
        assert counts[colour] > 0.6 * QUICK_CELL * QUICK_CELL


def test_pictures_are_tiled_row_by_row(tmp_path: Path) -> None:
    files = []
    for number, colour in enumerate(("red", "lime", "blue")):
        files.append(tmp_path / f"{number}.png")
        Image.new("RGB", (6, 4), colour).save(files[-1])
    tile(files, 2, tmp_path / "tiled.png")
    with Image.open(tmp_path / "tiled.png") as sheet:
        assert sheet.size == (12, 8)
        seen = [sheet.getpixel(place) for place in ((3, 2), (9, 2), (3, 6), (9, 6))]
    assert seen == [(255, 0, 0), (0, 255, 0), (0, 0, 255), (0, 0, 0)]


def test_an_out_folder_that_cannot_be_made_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert run(["demo", "--quick", "--out", str(tmp_path / "file" / "demo")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("is_late", [False, True])
def test_an_interrupt_in_one_of_its_pictures_ends_the_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_late: bool
) -> None:
    """A picture ends early with what it has; the demo had gone on with the next."""
    from nacre.picture import interrupt, picture

    drawn: list[object] = []

    def render(material: object, **options: object) -> SimpleNamespace:
        drawn.append(material)
        interrupt.begin_picture()
        if is_late:
            interrupt.note_late()
        return SimpleNamespace(stats={"interrupted": not is_late})

    monkeypatch.setattr(picture, "render", render)
    film = next(picture for picture in load_gallery(examples_folder()).picture if picture.quick)
    name = f"{film.name or Path(film.recipe).stem}.png"
    still = next(item for item in plan(examples_folder(), tmp_path, True) if item.path.name == name)
    with pytest.raises(KeyboardInterrupt):
        still.make()
    assert len(drawn) == 1
