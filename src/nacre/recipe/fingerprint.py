"""Fingerprints: hashes of a recipe, the content of its files, the versions of its models, and options.

Stored results (sweep points, frames, solved optics, search states) carry the fingerprint of their input and are
used only while it is the same. A change of code that changes no numbers changes no fingerprint. Raise `Model.version`
when the numbers of one family change, and `OPTICS_VERSION` when those of the shared optics (`matter`, `bsdf`, `light`,
`measure`), or intermediate results that a family caches, change.

The files that a Mitsuba scene or a glTF names are found in its parsed content, as the loaders see it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nacre.core.files import real

OPTICS_VERSION = 2
MAX_HASHED_BYTES = 4 << 30  # larger files, which no reader takes, are identified by size and time


def fingerprint(data: Any, files: Mapping[str, str], **options: Any) -> str:
    """Return a hash that is equal only if the results are.

    Args:
        data: the recipe as a dictionary, or anything that JSON can hold.
        files: digest of each dependency by its path relative to the recipe's folder.
        options: everything else that changes the result, such as a model's version.
    """
    what = {"optics": OPTICS_VERSION, "recipe": data, "files": files, "options": options}
    return hashlib.sha256(json.dumps(what, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


def file_digest(path: str | Path, holders: frozenset[Path] = frozenset()) -> str:
    """Return a hash of a file's content and of the files that a scene or glTF names; "" if it is not a file."""
    path = Path(path)
    try:
        if not path.is_file():
            return ""
        status = path.stat()
        if status.st_size > MAX_HASHED_BYTES:
            return f"{status.st_size}:{status.st_mtime_ns}"
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        here = real(path)
        for other in named_files(path):
            if other not in holders:
                digest.update(file_digest(other, holders | {here}).encode())
        return digest.hexdigest()
    except OSError:  # an invalid name or a file without read permission; the reader reports it
        return ""


def file_stamp(path: str | Path | None) -> tuple[tuple[str, int, int], ...]:
    """Return path, time and size of a file and of the files that a scene or glTF names; empty if it is not a file.

    Faster than `file_digest`, for caches within one process.
    """
    stamps: dict[Path, tuple[str, int, int]] = {}
    todo = [] if path is None else [Path(path)]
    while todo:
        file = todo.pop()
        with contextlib.suppress(OSError, ValueError):  # see `file_digest`
            if real(file) in stamps or not file.is_file():
                continue
            status = file.stat()
            stamps[real(file)] = (str(real(file)), status.st_mtime_ns, status.st_size)
            todo += named_files(file)
    return tuple(stamps[file] for file in sorted(stamps))


NAMING_SUFFIXES = (".xml", ".gltf", ".glb")
MAX_NAMING_BYTES = 64 << 20
MAX_NAME = 4096
MAX_INCLUDES = 64
_PARAMETER = re.compile(r"\$(\w+)")
_GLB_JSON = 20  # offset of the JSON chunk's content


def named_files(path: Path) -> list[Path]:
    """Return the paths of files that a file may name, sorted; they need not exist.

    Scenes: every attribute after substitution of `<default>` parameters and entities, in the scene's folder and in
    those of `<path>`, also of included scenes, and the files of recipes. glTF: every URI.
    """
    if path.suffix.lower() not in NAMING_SUFFIXES or path.stat().st_size > MAX_NAMING_BYTES:
        return []
    here = real(path)
    files = _of_scene(here) if path.suffix.lower() == ".xml" else _of_gltf(here)
    return sorted(files - {here})


def _of_gltf(path: Path) -> set[Path]:
    content = path.read_bytes()
    if content[:4] == b"glTF":
        content = content[_GLB_JSON : _GLB_JSON + int.from_bytes(content[12:16], "little")]
    try:
        tree = json.loads(content)
    except (ValueError, RecursionError):
        return _quoted(path)
    names = [text for text in _strings(tree) if not text.startswith("data:")]
    return _joined({path.parent}, {*names, *map(unquote, names)})


def _of_scene(path: Path) -> set[Path]:
    """Return a scene's files and those that it includes, which share parameters and folders."""
    names: set[str] = set()
    folders, parameters, read = {path.parent}, dict[str, str](), set[Path]()
    todo = [path]
    while todo and len(read) < MAX_INCLUDES:
        scene = todo.pop()
        if scene in read or not scene.is_file():
            continue
        read.add(scene)
        folders.add(scene.parent)
        try:
            root = ET.fromstring(scene.read_bytes())
        except (ET.ParseError, ValueError, LookupError):
            return _quoted(path)
        for node in root.iter("default"):
            parameters.setdefault(node.get("name", ""), node.get("value", ""))
        texts = [_substituted(value, parameters) for node in root.iter() for value in node.attrib.values()]
        for node in root.iter("path"):
            folder = _substituted(node.get("value", ""), parameters)
            folders |= {real(each / folder) for each in (path.parent, scene.parent)}
        names |= set(texts)
        for node in root.iter("include"):
            name = _substituted(node.get("filename", ""), parameters)
            todo += [real(folder / name) for folder in folders if name]
    files = _joined(folders, names)
    for recipe in [file for file in files if file.suffix.lower() == ".toml" and file.is_file()]:
        with contextlib.suppress(OSError, ValueError, RecursionError):  # no valid recipe
            files |= _joined({recipe.parent}, set(_strings(tomllib.loads(recipe.read_text("utf-8")))))
    return files


def _substituted(text: str, parameters: dict[str, str]) -> str:
    """Replace `$name` by the parameter's value, as Mitsuba does; values may name parameters themselves."""
    for _ in range(4):
        text = _PARAMETER.sub(lambda match: parameters.get(match[1], match[0]), text)
    return text


def _strings(tree: Any) -> Iterator[str]:
    """Yield all texts in JSON or TOML data."""
    if isinstance(tree, str):
        yield tree
    elif isinstance(tree, dict | list):
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from _strings(value)


def _joined(folders: set[Path], names: set[str]) -> set[Path]:
    """Return each name in each folder."""
    usable = [name for name in names if 0 < len(name) <= MAX_NAME and "\0" not in name and "\n" not in name]
    return {real(folder / name) for folder in folders for name in usable}


def _quoted(path: Path) -> set[Path]:
    """Return every quoted word of a file that cannot be parsed."""
    text = path.read_text("utf-8", "replace")
    # match from every quote to the next, since an apostrophe in a comment opens no string
    quoted = {name for q in "\"'" for name in re.findall(f"(?={q}([^{q}\0\n]{{1,255}}){q})", text)}
    return _joined({path.parent}, quoted | {unquote(name) for name in quoted if "%" in name})
