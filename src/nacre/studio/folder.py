"""The opened folder: its recipes, and the fence around it that no recipe of the page reaches across."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import atomic_path, check_writable, read_text, real
from nacre.material.examples import examples, examples_folder
from nacre.material.material import MAX_NESTED_RECIPES, Material, material_from_data
from nacre.recipe.model import RecipeContext
from nacre.recipe.toml import parse_toml

MAX_TEXT = 300_000  # characters of a recipe
MAX_LISTED = 500
DEEPEST = 3  # folders below the opened one
OF_TARGETS = ("target", "want", "recipe")  # keys of files of other kinds, of which some give a family too
EXAMPLE = "example:"  # what the names of shipped recipes begin with
# one of each kind of look, the first thing that a visitor sees
STARTS = ("jewel-beetle", "bragg-mirror", "blue-oxide", "morpho-film", "metasurface/silver_on_oxide", "pearl/bottle3")


@dataclass(frozen=True)
class FencedContext(RecipeContext):
    """Where a recipe of the page stands; files outside `fence` are refused.

    Attributes:
        fence: the folder that all paths of the recipe must lie in.
        depth: of recipes inside recipes.
    """

    fence: Path = dataclasses.field(default_factory=Path)
    depth: int = 0

    def path(self, name: str) -> Path:
        """Resolve a path of the recipe, links included.

        Raises:
            RecipeError: it leads outside the fence.
        """
        try:
            inside = (self.folder / name).resolve().is_relative_to(self.fence)
        except (OSError, ValueError, RuntimeError):
            inside = False
        if not inside:
            raise RecipeError(f'{self.source}: the file "{str(name)[:80]}" is outside the opened folder')
        return super().path(name)


def build(text: str, source: str, folder: Path, fence: Path, depth: int = 0, ambient: Any = None) -> Material:
    """Build a recipe's text as it would be built from a file in `folder`.

    Raises:
        RecipeError: naming key, value and what is allowed, or a file outside the fence.
    """
    if depth > MAX_NESTED_RECIPES:
        raise RecipeError(f"{source}: recipes are nested more than {MAX_NESTED_RECIPES} deep; is there a circle?")
    context: FencedContext

    def load_recipe(other: str | Mapping[str, Any], ambient: Any = ambient) -> Material:
        if isinstance(other, Mapping):
            return material_from_data(other, dataclasses.replace(context, text="", ambient=ambient))
        path = real(context.path(other))
        if path.suffix != ".toml":
            raise RecipeError(f'{source}: the recipe "{other[:80]}" should end in .toml')
        return build(read_text(path, "recipe"), str(path), path.parent, fence, depth + 1, ambient)

    context = FencedContext(source, folder, text, load_recipe, ambient, fence=fence, depth=depth)
    return material_from_data(parse_toml(text, source), context)


@dataclass(frozen=True)
class Opened:
    """What `nacre studio` was started with.

    Attributes:
        folder: resolved; recipes are read from it and saved into it.
        first: name of the recipe that is shown first, or "" for the choice of starting points.
    """

    folder: Path
    first: str = ""

    @classmethod
    def of(cls, path: str | None) -> Opened:
        """Open a recipe or a folder; None: the current folder, of which no recipe is asked.

        Raises:
            NacreError: no such file, or a folder without recipes.
        """
        if path is None:
            return cls(Path.cwd().resolve())
        given = Path(path)
        if given.is_dir():
            opened = cls(given.resolve())
            if not opened.names():
                raise NacreError(f"{path}: holds no recipe (.toml with a family); nacre examples -o {path} brings some")
            return opened
        if given.suffix not in (".toml", "") or (given.suffix == "" and given.exists()):
            raise NacreError(f"{path}: is no recipe; the studio opens a .toml file or a folder of them")
        if given.is_file():
            read_text(given, "recipe")
            return cls(given.resolve().parent, given.name)
        if any(example.name == path.removesuffix(".toml") for example in examples()):
            return cls(Path.cwd().resolve(), EXAMPLE + path.removesuffix(".toml"))
        raise NacreError(f"{path}: no such file or folder, and no example of that name")

    def names(self) -> list[str]:
        """Return the recipes of the folder by their names from it: .toml files that give a family."""
        found = []
        for path in sorted(self.folder.rglob("*.toml")):
            inner = path.relative_to(self.folder)
            if len(inner.parts) > DEEPEST + 1 or any(part.startswith(".") for part in inner.parts):
                continue
            if _gives_family(path):
                found.append(inner.as_posix())
            if len(found) == MAX_LISTED:
                break
        return found

    def place(self, name: str) -> tuple[Path, Path]:
        """Return a recipe's file and the fence that holds for it.

        Raises:
            NacreError: a name that leads outside the folder, or is no recipe's.
        """
        fence = self.folder
        if name.startswith(EXAMPLE):
            fence, name = examples_folder().resolve(), f"{name.removeprefix(EXAMPLE)}.toml"
        try:
            path = (fence / name).resolve()
        except (OSError, ValueError, RuntimeError):
            raise NacreError(f'"{name[:80]}" is no name of a recipe') from None
        if not path.is_relative_to(fence) or path.suffix != ".toml" or not name or "\0" in name:
            raise NacreError(f'"{name[:80]}" is no recipe in the opened folder')
        return path, fence

    def read(self, name: str) -> str:
        """Return a recipe's text.

        Raises:
            NacreError: it cannot be read.
        """
        path, _ = self.place(name)
        return read_text(path, "recipe")

    def is_readable(self, name: str) -> bool:
        """Whether a recipe of the folder is TOML; what it says may still be wrong."""
        try:
            parse_toml(self.read(name), name)
        except NacreError:
            return False
        return True

    def material(self, text: str, name: str) -> Material:
        """Build a recipe's text as the file of that name.

        Raises:
            NacreError: as `build`.
        """
        path, fence = self.place(name)
        return build(text, path.name, path.parent, fence)

    def save(self, name: str, text: str, known: str) -> str:
        """Write a recipe into the folder, whole or not at all; return its mark.

        Args:
            name: from the folder; examples are not written to.
            text: TOML; it need not be a valid recipe yet.
            known: the mark of what the page last read or wrote there; "" for a file that should not be there yet.

        Raises:
            NacreError: it cannot be written, or another program has changed it since.
        """
        if name.startswith(EXAMPLE):
            raise NacreError("an example cannot be changed; save it under a name of your own")
        path, _ = self.place(name)
        if path.exists() and mark_of(read_text(path, "recipe")) != known:
            raise NacreError(f"{name}: is there already, or was changed by another program; choose another name")
        if not path.parent.is_dir():
            raise NacreError(f"{name}: there is no such folder")
        check_writable(path)
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return mark_of(text)


def mark_of(text: str) -> str:
    """Return a mark by which two versions of a file are told apart."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _gives_family(path: Path) -> bool:
    try:
        if path.stat().st_size > MAX_TEXT:
            return False
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    try:
        data = parse_toml(text, path.name)
        return isinstance(data.get("family"), str) and not any(key in data for key in OF_TARGETS)
    except RecipeError:
        return "family" in text  # broken, and to be shown with its line
