"""Datasets and attributes of HDF5 files, in the forms that Python, R, MATLAB and Julia write; no links are followed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.core.files import plain, why_unreadable

if TYPE_CHECKING:
    import h5py

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
MAX_BYTES = 512 << 20  # size of one dataset
PROBE_TIMEOUT_S = 60.0
PROBE = """
import sys, h5py
def see(name, thing):
    list(thing.attrs.items())
    if isinstance(thing, h5py.Dataset) and not (thing.external or thing.is_virtual) and thing.nbytes < int(sys.argv[2]):
        thing[()]
try:
    with h5py.File(sys.argv[1], "r") as file:
        see("", file)
        file.visititems(see)
except Exception:
    pass
"""


class Hdf5Error(NacreError):
    """An HDF5 file cannot be used; the message ends a sentence that begins with the file."""


@contextmanager
def opened(path: str | Path, script: str = PROBE, timeout_s: float = PROBE_TIMEOUT_S) -> Iterator[h5py.File]:
    """Open a file after a subprocess has read it: the HDF5 library hangs or crashes on some damaged files.

    Args:
        script: the subprocess's script.
        timeout_s: its time limit.

    Raises:
        Hdf5Error: not readable, or damaged.
    """
    import h5py

    try:
        plain(path)
    except OSError as error:
        raise Hdf5Error(why_unreadable(error)) from None
    status = os.stat(path)
    probe(os.path.abspath(path), (status.st_mtime_ns, status.st_size, status.st_ino), script, timeout_s)
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise Hdf5Error("is not a readable HDF5 file") from None
    with file:
        yield file


@lru_cache(maxsize=64)
def probe(path: str, state: object, script: str, timeout_s: float) -> None:
    """Read all datasets in a subprocess; `state` identifies the content.

    Raises:
        Hdf5Error: the library hung or crashed.
    """
    try:
        # -P: do not import from the working folder
        done = subprocess.run(
            [sys.executable, "-P", "-c", script, path, str(MAX_BYTES)], timeout=timeout_s, capture_output=True
        )
    except subprocess.TimeoutExpired:
        raise Hdf5Error(f"is damaged: HDF5 is not done with it after {timeout_s:g} s") from None
    if done.returncode < 0:  # ended by a signal; Python errors are reported by the reader
        raise Hdf5Error("is damaged: HDF5 crashes on it")


def node(file: h5py.Group, name: str) -> Any:
    """Return a group or dataset in the file itself, or None.

    Raises:
        Hdf5Error: the path contains an external or a soft link.
    """
    import h5py

    where: Any = file
    for part in name.split("/"):
        if not isinstance(where, h5py.Group):
            return None
        if not (part in where or where.id.links.exists(part.encode())):  # a link may lead nowhere
            return None
        link = where.get(part, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise Hdf5Error(f'leads to another file at "{name}"')
        if isinstance(link, h5py.SoftLink):
            raise Hdf5Error(f'holds a soft link at "{name}"; store the data there itself')
        where = where[part]
    return where


def dataset(file: h5py.Group, name: str) -> Any:
    """Return a dataset in the file itself, or None.

    Raises:
        Hdf5Error: a link, or data in another file.
    """
    import h5py

    stored = node(file, name)
    if not isinstance(stored, h5py.Dataset):
        return None
    if stored.external or stored.is_virtual:
        raise Hdf5Error(f'keeps "{name}" in another file')
    return stored


def refuse_links(file: h5py.File) -> None:
    """Refuse external links, soft links and data in other files anywhere in a file.

    Raises:
        Hdf5Error: the file contains one.
    """
    import h5py

    def visit(group: h5py.Group, prefix: str) -> None:
        for name in group.id:
            text = name.decode("utf-8", "replace")
            member = node(group, text)
            if isinstance(member, h5py.Group) and prefix.count("/") < 20:
                visit(member, f"{prefix}{text}/")
            elif isinstance(member, h5py.Dataset):
                dataset(group, text)

    visit(file, "")


def text_of(value: Any) -> str:
    """Return a text from str, bytes, arrays of one of them (R), or arrays of characters or their codes (MATLAB)."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").rstrip("\0")
    if isinstance(value, str):
        return value.rstrip("\0")
    cells = np.ravel(value)
    if cells.dtype.kind in "ui" and cells.size:
        codes = cells if 0 < int(cells.min()) and int(cells.max()) < 0x110000 else cells[:0]
        return "".join(chr(int(c)) for c in codes)
    words = [c.decode("utf-8", "replace") if isinstance(c, bytes) else str(c) for c in cells]
    if len(words) > 1 and all(len(w) <= 1 for w in words):
        return "".join(words)
    return words[0].rstrip("\0") if words else ""


def attribute(attributes: Mapping[str, Any], *names: str) -> str:
    """Return the first attribute of these names as text, or ""."""
    return next((text_of(attributes[name]) for name in names if name in attributes), "")
