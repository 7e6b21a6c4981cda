"""Example recipes of the package: find, list and copy."""

import os
import re
import shutil
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import atomic_path, check_writable, read_text
from nacre.recipe.toml import parse_toml

NO_RECIPES = ("gallery.toml",)


@dataclass(frozen=True)
class Example:
    """A recipe or design target: name ("soap", "pearl/foil"), family or "target", description and file."""

    name: str
    family: str
    about: str
    path: Path
    is_recipe: bool  # False for a design target


def examples_folder() -> Path:
    """Return the folder of the example recipes in the checkout or the installed package.

    Raises:
        NacreError: the folder is missing in both.
    """
    roots = (sys.prefix, sysconfig.get_path("data"), sysconfig.get_path("data", f"{os.name}_user"))
    installed = [Path(root) / "share" / "nacre" / "examples" for root in dict.fromkeys(roots)]
    places = [Path(__file__).resolve().parents[3] / "examples", *installed]
    for place in places:
        if (place / "gallery.toml").is_file():
            return place
    raise NacreError(f"the example recipes are not installed; looked in {', '.join(map(str, places))}")


def examples() -> list[Example]:
    """Return all shipped recipes and targets, by name.

    Raises:
        NacreError: the examples are not installed.
    """
    folder = examples_folder()
    named = []
    for path in sorted(folder.rglob("*.toml")):
        if path.name in NO_RECIPES:
            continue
        text = read_text(path, "example")
        name = path.relative_to(folder).with_suffix("").as_posix()
        family = parse_toml(text, str(path)).get("family")
        named.append(Example(name, str(family or "target"), _about(text), path, is_recipe=family is not None))
    return sorted(named, key=lambda example: ("/" in example.name, example.name))


def find_example(name: str) -> Path | None:
    """Return an example's file by its name, with or without folder and suffix, or None."""
    try:
        folder = examples_folder()
    except NacreError:
        return None
    requested = Path(name)
    if requested.is_absolute() or ".." in requested.parts or requested.suffix not in ("", ".toml"):
        return None
    requested = requested if requested.suffix == ".toml" else Path(f"{name}.toml")
    if requested.name in NO_RECIPES or not requested.name:
        return None
    places = [folder, *sorted(place for place in folder.iterdir() if place.is_dir())]
    return next((place / requested for place in places if (place / requested).is_file()), None)


def resolve_recipe_path(path: str | Path) -> Path:
    """Return a path if it exists, else the path of the example of that name.

    Raises:
        NacreError: neither exists, but an example or a file has a similar name.
    """
    if os.path.lexists(path):
        return Path(path)
    example = find_example(str(path))
    beside = f"{path}.toml"
    if example is None and os.path.isfile(beside):
        raise NacreError(f'{path}: does not exist, as a file or as an example. Did you mean "{beside}"?')
    if example is None and not Path(path).suffix and (meant := did_you_mean(str(path), _words())):
        raise NacreError(f"{path}: does not exist, as a file or as an example.{meant}")
    return example or Path(path)


def _words() -> set[str]:
    """Return the names of all examples, with and without folder."""
    try:
        folder = examples_folder()
    except NacreError:
        return set()
    paths = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.toml") if path.name not in NO_RECIPES]
    return {word for path in paths for word in (path.as_posix(), path.name)}


def copy_examples(names: list[str], to: Path) -> list[Path]:
    """Copy examples and the files that they name to a folder, with the same relative paths.

    Args:
        names: names for `find_example`; empty: all.

    Returns:
        The files written.

    Raises:
        NacreError: an unknown name, or a file with other content exists.
    """
    folder = examples_folder()
    known = {example.name: example for example in examples()}
    paths = []
    for name in names or list(known):
        path = find_example(name)
        if path is None:
            raise NacreError(f'example "{name}" is not known.{did_you_mean(name, known)} nacre examples lists them')
        paths += [path, *_named_files(path)]
    pairs = [(path, to / path.relative_to(folder)) for path in dict.fromkeys(paths)]
    for source, target in pairs:
        if target.exists() and target.read_bytes() != source.read_bytes():
            raise NacreError(f"{target}: exists and differs from the example; move it away or choose another folder")
    if not to.exists():
        check_writable(to)
    for source, target in pairs:
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
    return [target for _, target in pairs]


def _named_files(path: Path) -> list[Path]:
    """Return the files that an example names, recursively."""
    files: list[Path] = []

    def walk(value: object) -> None:
        if isinstance(value, dict):
            for inner in value.values():
                walk(inner)
        elif isinstance(value, list):
            for inner in value:
                walk(inner)
        elif isinstance(value, str) and "\n" not in value and len(value) < 200:
            beside = path.parent / value
            if beside.suffix and beside.is_file() and beside not in files:
                files.append(beside)
                if beside.suffix == ".toml":
                    files.extend(_named_files(beside))

    walk(parse_toml(read_text(path, "example"), str(path)))
    return [place.resolve() for place in files]


def _about(text: str) -> str:
    """Return the first sentence of the comment at the top."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").strip())
    return re.split(r"\. (?=[A-Z])", " ".join(lines))[0].rstrip(".")
