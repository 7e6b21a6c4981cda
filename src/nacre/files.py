"""Files of the user: read with clear errors, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from nacre.errors import NacreError, RecipeError

MAX_TOML_BYTES = 4 << 20  # a recipe is a page of text; anything longer is not a recipe


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; it takes the real name only when the block succeeds.

    The temporary name keeps the suffix, since many writers choose the format by it.

    Raises:
        NacreError: the folder does not exist or cannot be written.
    """
    path = Path(path)
    folder = check_writable(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem[:40]}-", suffix=path.suffix, dir=folder)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with contextlib.suppress(OSError):
            # mkstemp makes files private; a finished output has the usual permissions
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_writable(path: str | Path) -> Path:
    """Return the folder of `path` if a file can be made there; call it before long work, not after.

    Raises:
        NacreError: the folder is missing or read-only, or `path` is a folder.
    """
    path = Path(path)
    folder = path.parent if str(path.parent) else Path()
    if not folder.is_dir():
        raise NacreError(f"{path}: the folder {folder} does not exist")
    if path.is_dir():
        raise NacreError(f"{path}: is a folder; give a file name")
    try:
        handle, probe = tempfile.mkstemp(prefix=".nacre-", dir=folder)
    except OSError as error:
        raise NacreError(f"{path}: the folder {folder} cannot be written: {error.strerror}") from None
    os.close(handle)
    os.unlink(probe)
    return folder


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text whole or not at all.

    Raises:
        NacreError: as `atomic_path`.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(path: str | Path) -> Path:
    """Return the path of what is read next, refusing devices and pipes: /dev/zero has size 0 and never ends.

    Raises:
        OSError: so that it joins the reader's own errors of a file that cannot be read.
    """
    path = Path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "is a device or a pipe, not a file", str(path))
    return path


def read_text(path: str | Path, what: str = "file") -> str:
    """Read a small UTF-8 text file.

    Raises:
        RecipeError: missing, unreadable, too large or not text.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            # bounded, since a device such as /dev/zero has size 0 and never ends
            data = file.read(MAX_TOML_BYTES + 1)
        if len(data) > MAX_TOML_BYTES:
            raise RecipeError(f"{path}: is larger than {MAX_TOML_BYTES} bytes, the most that a {what} may have")
        return data.decode("utf-8")
    except FileNotFoundError:
        raise RecipeError(f"{path}: does not exist") from None
    except IsADirectoryError:
        raise RecipeError(f"{path}: is a folder, not a {what}") from None
    except UnicodeDecodeError:
        raise RecipeError(f"{path}: is not UTF-8 text") from None
    except ValueError as error:  # a name that no file system takes
        raise RecipeError(f"{str(path)[:80]!r}: cannot be read: {error}") from None
    except OSError as error:
        raise RecipeError(f"{path}: cannot be read: {error.strerror}") from None
