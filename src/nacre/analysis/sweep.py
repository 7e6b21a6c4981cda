"""One writer for a sweep's store at a time: a small file beside it that names the process."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.analysis.sweep_plan import Sweep, SweepSpec, load_sweep
from nacre.core.errors import NacreError
from nacre.core.files import Process, check_writable, temporary_prefix

POLL_S = 0.2
_held: set[Path] = set()  # by this process; another of its threads waits like another process


def lock_file(store: Path) -> Path:
    """Return the lock of a store; it lies beside it, since Zarr warns of files that it does not know."""
    return store.with_name(store.name + ".lock")


@contextlib.contextmanager
def locked(store: Path, *, break_lock: bool = False, tell: Callable[[str], None] | None = None) -> Iterator[None]:
    """Be the one that writes a store; while another process of this machine does, wait.

    A lock whose process has ended is taken over. Of another machine's process nobody here can tell whether it runs:
    only `break_lock` takes its lock.

    Args:
        store: the Zarr folder, there or not yet.
        break_lock: take the lock of another machine.
        tell: called once, with a line that says who is waited for.

    Raises:
        NacreError: another machine holds the lock, or the folder cannot be written.
    """
    path = lock_file(store)
    check_writable(path)
    waits = False
    while (owner := _take(path, break_lock)) is not None:
        if not owner.is_here:
            machine = owner.host.partition(" ")[0]
            raise NacreError(
                f"{store}: process {owner.pid} of {machine} writes it, or was ended there before it could say so; "
                "if nothing runs there any more, --break-lock takes over"
            )
        if not waits and tell:
            tell(f"{store}: waiting for process {owner.pid}, which writes it")
        waits = True
        time.sleep(POLL_S)
    try:
        yield
    finally:
        with contextlib.suppress(OSError), _guarded(path.parent):
            _held.discard(path.resolve())
            if _owner(path) == Process.this():
                path.unlink()


def _take(path: Path, break_lock: bool) -> Process | None:
    """Take the lock if it is free; if not, return whose it is."""
    this, here = Process.this(), path.resolve()
    try:
        with _guarded(path.parent):
            owner = _owner(path)
            is_left = owner is None or owner.is_dead or (owner == this and here not in _held)
            if not is_left and not (break_lock and owner is not None and not owner.is_here):
                return owner
            path.write_text(json.dumps(asdict(this)), encoding="utf-8")
            _held.add(here)
            return None
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from None


def _owner(path: Path) -> Process | None:
    """Return whose lock it is; None where there is none, or one that was never written whole."""
    try:
        return Process(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


@contextlib.contextmanager
def _guarded(folder: Path) -> Iterator[None]:
    """Keep all others from looking at the lock for a moment; where the system has no such lock, go without."""
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


# Sweeps: a material over many values of its numbers, resumable at any moment.

logger = logging.getLogger("nacre")

MISSING, DONE, FAILED = 0, 1, 2
KEY_SEPARATOR = "."  # chunks lie directly in their array's folder: making folders costs more than their values
Progress = Callable[[int, int, int], None]  # done, failed, total


def errors_file(store: Path) -> Path:
    """Return the file of the failed points' errors, a JSON object a line.

    It lies beside the store, not in it: Zarr warns of files that it does not know.
    """
    return store.with_suffix(".errors.jsonl")


class Store:
    """The Zarr group of a sweep: values, status and errors of its points."""

    def __init__(self, path: Path, sweep: Sweep) -> None:
        self.path = path
        self._shape = sweep.points.shape
        self._clean_leftovers()
        import zarr

        self._group = zarr.open_group(str(path), mode="r+")
        if self._group.attrs.get("fingerprint") != sweep.fingerprint:
            raise NacreError(
                f"{path}: holds another sweep, or its recipe, a file that this names, or nacre itself has changed "
                "since; choose another -o, or remove it to start anew"
            )
        self._trailing = {name: len(shape) for name, (_, shape) in sweep.measurement.layout().items()}

    @classmethod
    def open(cls, path: Path, sweep: Sweep) -> Store:
        """Open the store of a sweep, making it first where there is none.

        Raises:
            NacreError: the folder cannot be written, or the path holds something else.
        """
        if not path.exists():
            _create(path, sweep)
        elif not (path / "zarr.json").exists():
            raise NacreError(f"{path}: exists and is not a sweep; choose another -o")
        return cls(path, sweep)

    def missing(self) -> list[int]:
        """Return the numbers of the points that are not finished, failed ones included."""
        return [int(i) for i in np.flatnonzero(self._status() != DONE)]

    def counts(self) -> tuple[int, int]:
        """Return how many points are finished and how many have failed."""
        status = self._status()
        return int(np.sum(status == DONE)), int(np.sum(status == FAILED))

    def write(self, number: int, result: dict[str, NDArray[np.float64]] | str) -> None:
        """Store one point: its values, or the error that it raised; the status comes last.

        Raises:
            NacreError: the disk is full or not writable.
        """
        place = tuple(int(i) for i in np.unravel_index(number, self._shape))
        try:
            if isinstance(result, str):
                line = json.dumps({"point": number, "error": result[:500]})
                with open(errors_file(self.path), "a", encoding="utf-8") as file:
                    file.write(line + "\n")
            else:
                for name, trailing in self._trailing.items():
                    values = np.ascontiguousarray(result[name], dtype="<f8")
                    self._write_chunk(name, (*place, *(0,) * trailing), values.tobytes())
            self._write_chunk("status", place, bytes([FAILED if isinstance(result, str) else DONE]))
        except OSError as error:
            raise NacreError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def _write_chunk(self, name: str, place: tuple[int, ...], content: bytes) -> None:
        """Write one chunk as a file: Zarr 3 with flat keys and no compression stores just these bytes.

        Through the library the same takes 1 ms a chunk, more than a film's point takes to compute.
        """
        path = f"{self.path}/{name}/{_chunk_name(place)}"
        with open(f"{path}.partial", "wb", buffering=0) as file:
            file.write(content)
        os.replace(f"{path}.partial", path)

    def _status(self) -> NDArray[np.uint8]:
        """Return the status of every point, flat, from the chunks that are there."""
        status = np.full(int(np.prod(self._shape)), MISSING, dtype=np.uint8)
        for entry in os.scandir(self.path / "status"):
            head, *parts = entry.name.split(KEY_SEPARATOR)
            if head != "c" or len(parts) != len(self._shape) or not all(part.isdigit() for part in parts):
                continue
            indices = tuple(int(part) for part in parts)
            content = Path(entry.path).read_bytes()
            if len(content) == 1 and all(i < n for i, n in zip(indices, self._shape)):
                status[np.ravel_multi_index(indices, self._shape)] = content[0]
        return status

    def _clean_leftovers(self) -> None:
        """Remove half-written files of a killed run; they were never renamed, so nothing points to them."""
        for leftover in self.path.rglob("*.partial"):
            with contextlib.suppress(OSError):
                leftover.unlink()


def _create(path: Path, sweep: Sweep) -> None:
    """Make an empty store beside `path` and give it its name when it is whole."""
    import zarr

    folder = check_writable(path)
    temporary = Path(tempfile.mkdtemp(prefix=temporary_prefix(path), dir=folder))
    try:
        group = zarr.open_group(str(temporary), mode="w")
        points, measurement = sweep.points, sweep.measurement
        axis_names = [_dimension(axis.path) for axis in points.axes] if points.mode == "grid" else ["point"]
        attributes: dict[str, Any] = {
            "fingerprint": sweep.fingerprint, "nacre": __version__, "recipe": sweep.material.text,
            "sweep": Path(sweep.source).name, "mode": points.mode, "illuminant": measurement.illuminant,
            "observer": measurement.observer, "axes": {_dimension(a.path): a.path for a in points.axes},
        }  # fmt: skip
        group.attrs.update(attributes)
        for position, axis in enumerate(points.axes):
            name = _dimension(axis.path)
            values = list(axis.values or ()) if points.mode == "grid" else [c[axis.path] for c in points]
            _coordinate(group, name, values, [axis_names[position if points.mode == "grid" else 0]])
        if points.mode != "grid":
            _coordinate(group, "point", list(range(points.count)), ["point"])
        _coordinate(group, "angle_deg", list(measurement.angles_deg), ["angle_deg"])
        _coordinate(group, "lab", ["L*", "a*", "b*"], ["lab"])
        _coordinate(group, "xyz", ["X", "Y", "Z"], ["xyz"])
        if measurement.wavelengths_nm is not None:
            _coordinate(group, "wavelength_nm", list(measurement.wavelengths_nm), ["wavelength_nm"])
        ones = (1,) * len(points.shape)
        flat: Any = {"name": "default", "separator": KEY_SEPARATOR}
        for name, (dimensions, shape) in measurement.layout().items():
            group.create_array(
                name, shape=(*points.shape, *shape), chunks=(*ones, *shape), dtype="f8", fill_value=np.nan,
                dimension_names=[*axis_names, *dimensions], compressors=None, chunk_key_encoding=flat,
            )  # fmt: skip
        status = group.create_array(
            "status", shape=points.shape, chunks=ones, dtype="u1", fill_value=MISSING,
            dimension_names=axis_names, compressors=None, chunk_key_encoding=flat,
        )  # fmt: skip
        status.attrs["meaning"] = "0 missing, 1 done, 2 failed (see the .errors.jsonl file beside the folder)"
        os.replace(temporary, path)
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _chunk_name(place: tuple[int, ...]) -> str:
    """Return the file name of a chunk, such as `c.3.0.0`."""
    return KEY_SEPARATOR.join(("c", *(str(i) for i in place)))


def _dimension(path: str) -> str:
    """Make a dimension name of a recipe path: `layers[0].thickness_nm` is `layers.0.thickness_nm`."""
    return path.replace("[", ".").replace("]", "")


def _coordinate(group: Any, name: str, values: list[Any], dimensions: list[str]) -> None:
    """Store a coordinate; strings become numbers with their labels in the attributes."""
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    data = np.asarray(values, dtype=float) if numeric else np.arange(len(values), dtype=float)
    if not numeric and len({json.dumps(v, default=str) for v in values}) < len(values):
        distinct = list(dict.fromkeys(json.dumps(v, default=str) for v in values))
        data = np.array([distinct.index(json.dumps(v, default=str)) for v in values], dtype=float)
        values = [json.loads(v) for v in distinct]
    array = group.create_array(name, data=data, dimension_names=dimensions, compressors=None)
    if not numeric:
        array.attrs["labels"] = [v if isinstance(v, str) else json.dumps(v, default=str) for v in values]


def run_sweep(
    sweep: Sweep,
    output: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    security: str | Path | None = None,
    progress: Progress | None = None,
    break_lock: bool = False,
    tell: Callable[[str], None] = logger.warning,
) -> tuple[int, int]:
    """Compute what is missing of a sweep and return (finished, failed).

    Args:
        sweep: from `load_sweep`.
        output: the Zarr folder; an earlier, interrupted run of the same sweep goes on.
        workers: processes of the local cluster; 1 computes in this process; default: one a core.
        scheduler: address of a Dask scheduler (`tcp://host:port`) to use instead; its workers must have nacre.
        security: TOML file with `ca`, `cert` and `key`, the PEM files by which such a scheduler (`tls://host:port`)
            knows this sweep. Workers of this machine speak TLS with a key of their own.
        progress: called with (finished, failed, total) after every batch.
        break_lock: take the store's lock from another machine; one of a process ended here is taken anyway.
        tell: called with a line where another process writes the store, which is waited for.

    Raises:
        NacreError: the store holds another sweep, cannot be written or is locked by another machine, or the scheduler
            cannot be reached.
    """
    if security is not None:
        from nacre.analysis.dask_cluster import read_security

        if scheduler is None:
            raise NacreError(
                f"--security {security}: belongs to --scheduler; workers of this machine make their own key"
            )
        read_security(security)
    with locked(Path(output), break_lock=break_lock, tell=tell):
        return _run(sweep, Path(output), workers, (scheduler, security), progress)


def _run(
    sweep: Sweep,
    output: Path,
    workers: int | None,
    elsewhere: tuple[str | None, str | Path | None],
    progress: Progress | None,
) -> tuple[int, int]:
    store = Store.open(output, sweep)
    total = sweep.points.count
    todo = store.missing()
    finished = total - len(todo)
    failed = 0
    if progress:
        progress(finished, failed, total)
    if todo:
        from nacre.analysis.sweep_workers import results

        for number, result in results(sweep, todo, workers, *elsewhere):
            store.write(number, result)
            if isinstance(result, str):
                failed += 1
            else:
                finished += 1
            if progress:
                progress(finished, failed, total)
    return finished, failed


__all__ = ["Store", "Sweep", "SweepSpec", "load_sweep", "run_sweep"]
