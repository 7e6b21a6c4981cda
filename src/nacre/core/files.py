"""Files of the user: clear errors on reading, atomic writing."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import platform
import re
import secrets
import select
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from nacre.core.errors import NacreError, RecipeError

MAX_TOML_BYTES = 4 << 20  # a recipe is a page of text
PROBE_BYTES = 1 << 16
PIPE_WAIT_S, WRITER_WAIT_S = 10.0, 0.3
NUL = "\0"
DESIGN_RECIPE = "recipe.toml"  # file name in a folder that represents a material
HAS_NUL = "holds a NUL character, which no file name has"

_TEMPORARY = re.compile(r"\..*\.nacre-([0-9a-f]{8})-(\d+)-(\d+)-\w{8}(\..*)?")


@dataclass(frozen=True)
class Process:
    """A process, identified by machine, number and start time."""

    host: str
    pid: int
    started: int

    @classmethod
    def this(cls) -> Process:
        """Return the calling process."""
        return cls(_host(), os.getpid(), _started(os.getpid()) or 0)

    @property
    def is_dead(self) -> bool:
        """Whether the process has ended; always False for another machine or container."""
        return self.host == _host() and _started(self.pid) not in (self.started, 0)


def _host() -> str:
    space = ""
    with contextlib.suppress(OSError):  # containers of one machine may share its name
        space = os.readlink("/proc/self/ns/pid")
    return f"{platform.node()} {space}".strip()


def _started(pid: int) -> int | None:
    """Return the start time of a process in system units; 0: runs, time unknown; None: ended."""
    try:
        state, *rest = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        return None if state in (b"Z", b"X") else int(rest[18])
    except (OSError, ValueError):
        if os.name != "posix":
            return 0
    try:
        os.kill(pid, 0)  # sends no signal
    except (ProcessLookupError, OverflowError):
        return None
    except OSError:
        pass
    return 0


def temporary_prefix(path: Path) -> str:
    """Return the prefix of temporary files for `path`: hidden, with the number of this process."""
    this = Process.this()
    host = hashlib.sha256(this.host.encode()).hexdigest()[:8]
    return f".{path.stem[:40]}.nacre-{host}-{this.pid}-{this.started}-"


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of killed processes of this machine from a folder."""
    host = hashlib.sha256(_host().encode()).hexdigest()[:8]
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            match = _TEMPORARY.fullmatch(entry.name) if entry.name.startswith(".") else None
            if match and match[1] == host and Process(_host(), int(match[2]), int(match[3])).is_dead:
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    with contextlib.suppress(OSError):
                        os.unlink(entry.path)


stored = threading.Event()  # set when a result is stored; an interrupted command reports whether it is


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which replaces `path` when the block succeeds.

    The temporary name has the same suffix, since many writers choose the format by it. A link is followed; a device or
    a pipe receives the bytes.

    Raises:
        NacreError: the folder does not exist or cannot be written.
    """
    path = named(path)
    path = Path(os.path.realpath(path)) if path.is_symlink() and not _is_special(path) else path
    folder = check_writable(path)
    is_special = _is_special(path)
    if is_special:
        handle, name = tempfile.mkstemp(prefix=temporary_prefix(path), suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
    else:
        temporary = _created(folder, path)
    try:
        yield temporary
        if is_special:
            with temporary.open("rb") as source, open(path, "wb", opener=_open_with_reader) as sink:
                shutil.copyfileobj(source, sink)
            return
        temporary.replace(path)
        stored.set()
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _created(folder: Path, path: Path) -> Path:
    """Create an empty temporary file with the permissions of a new file.

    Raises:
        NacreError: the folder cannot be written.
    """
    while True:
        temporary = folder / f"{temporary_prefix(path)}{secrets.token_hex(4)}{path.suffix}"
        try:
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        except OSError as error:
            raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from None
        return temporary


@contextlib.contextmanager
def reraise_as_oserror() -> Iterator[None]:
    """Raise a RuntimeError of OpenEXR, such as for a full disk, as an OSError.

    Raises:
        OSError: in place of the RuntimeError.
    """
    try:
        yield
    except RuntimeError as error:
        # "Failed to write ... "/where/.x.exr". No space left on device."
        parts = [part.strip(" .") for part in str(error).split('"') if part.strip(" .")]
        raise OSError(errno.EIO, parts[-1] if parts else "the writer failed") from error


def _open_with_reader(path: str, flags: int) -> int:
    """Open a device, or a pipe once a program reads it; neither is created or truncated.

    Raises:
        OSError: no program reads the pipe within `PIPE_WAIT_S`.
    """
    if not stat.S_ISFIFO(os.stat(path).st_mode):
        return os.open(path, os.O_WRONLY)
    until = time.monotonic() + PIPE_WAIT_S
    while True:
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
            if time.monotonic() > until:
                raise OSError(errno.ENXIO, "is a pipe that no program reads") from None
            time.sleep(0.01)
        else:
            os.set_blocking(descriptor, True)
            return descriptor


def _is_special(path: str | Path) -> bool:
    """Whether a path is an existing device, pipe or socket."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def named(path: str | Path) -> Path:
    """Return a valid path.

    Raises:
        NacreError: it is not a path, contains a NUL character or is too long.
    """
    try:
        name = os.fspath(path)
        if not isinstance(name, str):
            raise TypeError
    except TypeError:
        raise NacreError(f"{path!r:.80} is not a path; give the name of a file") from None
    try:
        os.path.lexists(_nameable(name)) or os.stat(name)
    except (FileNotFoundError, NotADirectoryError):
        pass  # reported on reading or writing
    except OSError as error:
        raise NacreError(f"{name!r:.80}: cannot be the name of a file: {error.strerror}") from None
    return Path(name)


def short_name(path: str | Path) -> str:
    """Return the name for titles and output files of a recipe or a design folder; links are not followed.

    Example: "soap.toml" is soap; the second solution of a design, "sign/2" or "sign/2/recipe.toml", is sign-2.
    """
    absolute = Path(os.path.abspath(path))
    is_of_folder = absolute.name == DESIGN_RECIPE
    folder = absolute.parent if is_of_folder else absolute
    if not (is_of_folder or os.path.isdir(absolute)) or not folder.name:
        return absolute.stem
    return f"{folder.parent.name}-{folder.name}".lstrip("-") if folder.name.isdigit() else folder.name


def real(path: str | Path) -> Path:
    """Return the absolute path with links followed; unlike `Path.resolve`, a link to itself raises no error."""
    return Path(os.path.realpath(path))


def check_writable(path: str | Path) -> Path:
    """Return the folder of `path` if a file can be created there; to be called before long work.

    Temporary files of killed runs are removed.

    Raises:
        NacreError: the folder is missing or read-only, or `path` is a folder, a disk or a socket.
    """
    path = named(path)
    folder = path.parent if str(path.parent) else Path()
    if not folder.is_dir():
        wrong = "is not a folder" if os.path.lexists(folder) else "does not exist"
        raise NacreError(f"{path}: the folder {folder} {wrong}")
    if path.is_dir():
        raise NacreError(f"{path}: is a folder; give a file name")
    if _is_special(path):
        if path.is_block_device() or path.is_socket() or not os.access(path, os.W_OK):
            raise NacreError(f"{path}: is a device that cannot be written as a file; give a file name")
        return folder
    remove_leftovers(folder)
    _probe(path, folder, 0)
    return folder


def _probe(path: Path, folder: Path, size: int) -> None:
    """Write a temporary file of a size into a folder, and remove it.

    Raises:
        NacreError: the folder is read-only, or the disk is full.
    """
    try:
        handle, probe = tempfile.mkstemp(prefix=temporary_prefix(path), dir=folder)
        try:
            with open(handle, "wb") as file:
                file.write(bytes(size))
        finally:
            os.unlink(probe)
    except OSError as error:
        raise NacreError(f"{path}: the folder {folder} cannot be written: {error.strerror}") from None


def check_output(path: str | Path, *suffixes: str, option: str = "-o ") -> None:
    """Check that a file has one of the suffixes and can be written.

    Raises:
        NacreError: another suffix, or as `check_writable`.
    """
    if named(path).suffix not in suffixes:
        *first, last = suffixes
        allowed = f"{', '.join(first)} or {last}" if first else last
        raise NacreError(f"{option}{path}: the suffix must be {allowed}")
    check_writable(path)


def check_room(folder: str | Path, need: int) -> None:
    """Check that a folder, which may not exist yet, can be written.

    Args:
        need: required free bytes of its disk.

    Raises:
        NacreError: the folder or its parent is not a folder or read-only, or the disk is full.
    """
    path = named(folder)
    place = Path(os.path.abspath(path))
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if not place.is_dir():
        inside = "" if place == Path(os.path.abspath(path)) else f"{place} "
        raise NacreError(f"{path}: {inside}is a file; the answers need a folder")
    _probe(path, place, PROBE_BYTES)  # a full disk may still accept a new file name
    try:
        disk = shutil.disk_usage(place)
    except OSError as error:
        raise NacreError(f"{path}: the folder {place} cannot be written: {error.strerror}") from None
    if 0 < disk.total and disk.free < need:
        problem = f"{disk.free / 1e6:.1f} MB are left on its disk, and {need / 1e6:.0f} MB are needed"
        raise NacreError(f"{path}: the folder {place} cannot be written: {problem}")


@contextlib.contextmanager
def output_folder(path: str | Path) -> Iterator[None]:
    """Create a folder and its parents for the `with` block; afterwards remove new folders that are empty.

    Raises:
        NacreError: it cannot be created.
    """
    folder = named(path)
    new = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be made: {error.strerror}") from None
    try:
        yield
    finally:
        for each in new:
            with contextlib.suppress(OSError):  # not empty
                each.rmdir()


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically.

    Raises:
        NacreError: as `atomic_path`.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(path: str | Path) -> Path:
    """Return the path of a regular file.

    Raises:
        OSError: it is a folder, a device or a pipe; see `why_unreadable`.
    """
    mode = os.stat(_nameable(path)).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder, not a file", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "is a device or a pipe, not a file", str(path))
    return Path(path)


@contextlib.contextmanager
def reading(place: str | Path, kind: type[NacreError] = NacreError) -> Iterator[None]:
    """Report a file that cannot be read in one line, which begins with its place.

    Raises:
        NacreError: in place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"{place}: {why_unreadable(error)}") from None


def size_of(path: Path, place: str | Path | None = None, most_bytes: int | None = None) -> int:
    """Return the size of a regular file in bytes.

    Args:
        place: begins the message; default: the path.

    Raises:
        NacreError: missing, unreadable, larger than allowed, or a folder, a device or a pipe.
    """
    place = path if place is None else place
    with reading(place):
        size = plain(path).stat().st_size
    if most_bytes is not None and size > most_bytes:
        raise NacreError(f"{place}: has {size / 1e6:.4g} MB; at most {most_bytes / 1e6:.4g} MB are read")
    return size


def why_unreadable(error: OSError) -> str:
    """Return why a file cannot be read, to follow its name or key in a message.

    Example: `f"{path}: {why_unreadable(error)}"` ends in "does not exist" or "is a folder, not a file".
    """
    if isinstance(error, FileNotFoundError):
        return "does not exist"
    if isinstance(error, IsADirectoryError):
        return "is a folder, not a file"
    reason = error.strerror or str(error)
    return reason if reason.startswith(("is a ", "holds ")) else f"cannot be read: {reason}"


def _nameable(path: str | Path) -> str:
    """Return a path as text; an invalid name raises OSError, not Python's ValueError."""
    name = os.fspath(path)
    try:
        if NUL not in name and os.fsencode(name):
            return name
    except UnicodeError:
        pass
    raise OSError(errno.EINVAL, HAS_NUL if NUL in name else "holds no name of a file", name)


def _opened(path: str | Path) -> BinaryIO:
    """Open a text file, or a pipe with a writer, such as a shell's <(...)."""
    if not stat.S_ISFIFO(os.stat(_nameable(path)).st_mode):
        return open(path, "rb")
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # blocks otherwise if there is no writer
    try:
        return io.BytesIO(_from_pipe(descriptor, str(path)))
    finally:
        os.close(descriptor)


def _from_pipe(descriptor: int, path: str) -> bytes:
    """Read a pipe up to its end or the size limit.

    Raises:
        OSError: it lacks a writer, or the writer writes nothing for `PIPE_WAIT_S`.
    """
    data, begun, has_writer = b"", time.monotonic(), False
    while len(data) <= MAX_TOML_BYTES:
        try:
            piece = os.read(descriptor, PROBE_BYTES)  # no bytes: there is no writer, or no longer
        except BlockingIOError:
            piece, has_writer = None, True
        if piece:
            data, begun, has_writer = data + piece, time.monotonic(), True
        elif piece == b"" and has_writer:
            break
        elif time.monotonic() - begun > (PIPE_WAIT_S if has_writer else WRITER_WAIT_S):
            raise OSError(errno.EINVAL, "is a pipe into which nothing is written", path)
        elif has_writer:
            select.select([descriptor], [], [], PIPE_WAIT_S)
        else:
            time.sleep(0.01)
    return data


def read_text(path: str | Path, what: str = "file") -> str:
    """Read a small UTF-8 text file, with or without a byte order mark.

    Raises:
        RecipeError: missing, unreadable, too large or not text.
    """
    path = Path(path)
    try:
        with reading(path, RecipeError), _opened(path) as file:
            data = file.read(MAX_TOML_BYTES + 1)
        if len(data) > MAX_TOML_BYTES:
            raise RecipeError(f"{path}: is larger than {MAX_TOML_BYTES} bytes, the most that a {what} may have")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RecipeError(f"{path}: is not UTF-8 text") from None
