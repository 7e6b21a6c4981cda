"""Sweeps: a material over many values of its numbers, resumable at any moment.

The store is a Zarr group with labelled axes and one chunk per point, which xarray opens. The status of a point is
written after its values, and every write is an atomic rename. A killed sweep keeps all finished points; the next run
computes the missing ones. `read_sweep` reads a store, `sweep_figure` draws it.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.analysis.sweep_plan import AT_GEOMETRIES, Sweep, SweepSpec, load_sweep, measurement_from, point_seed
from nacre.analysis.ties import tied_maker
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import check_writable, plain, stored, temporary_prefix
from nacre.core.jobs import Workers, run_jobs
from nacre.core.lazy import require
from nacre.material.material import Material, material

if TYPE_CHECKING:
    from nacre.plot import Figure


logger = logging.getLogger("nacre")

MISSING, DONE, FAILED = 0, 1, 2
KEY_SEPARATOR = "."  # chunks lie directly in the folder of their array; creating folders costs more than the values
Result = dict[str, NDArray[np.float64]] | str
Progress = Callable[[int, int, int], None]  # done, failed, total


def lock_file(store: Path) -> Path:
    """Return a store's lock; it lies beside the store, since Zarr warns of unknown files."""
    return store.with_name(store.name + ".lock")


@contextlib.contextmanager
def locked(store: Path, report: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold a store's lock, after waiting for another process that writes it.

    The operating system releases the lock when its process ends.

    Args:
        store: the Zarr folder, which may not exist yet.
        report: called once with a message if the lock has to be waited for.

    Raises:
        NacreError: the folder cannot be written.
    """
    from filelock import FileLock, Timeout

    path = lock_file(store)
    check_writable(path)
    lock = FileLock(path)
    try:
        try:
            lock.acquire(timeout=0)
        except Timeout:
            if report:
                report(f"{store}: waiting for another process, which writes it")
            lock.acquire()
    except (OSError, NotImplementedError) as error:
        raise NacreError(f"{path}: cannot be locked: {error}") from None
    try:
        yield
    finally:
        lock.release()


def errors_file(store: Path) -> Path:
    """Return the file with the errors of failed points, one JSON object per line, beside the store."""
    return store.with_suffix(".errors.jsonl")


class Store:
    """The Zarr group of a sweep: values, status and errors of its points."""

    def __init__(self, path: Path, sweep: Sweep) -> None:
        self.path = path
        self._shape = sweep.points.shape
        for leftover in path.rglob("*.partial"):  # files of a killed run, which were never renamed
            with contextlib.suppress(OSError):
                leftover.unlink()
        if _fingerprint_of(path) != sweep.fingerprint:
            raise NacreError(
                f"{path}: holds another sweep, or its recipe, a file that this names, or the optics of nacre have "
                "changed since; choose another -o, or remove it to start again"
            )
        layout = sweep.measurement.layout()
        self._trailing = {name: len(shape) for name, (_, shape) in layout.items()}
        self._bytes = {name: 8 * int(np.prod(shape)) for name, (_, shape) in layout.items()}

    @classmethod
    def open(cls, path: Path, sweep: Sweep) -> Store:
        """Open a sweep's store, creating it if needed.

        Raises:
            NacreError: the folder cannot be written, or the path holds something else.
        """
        if not path.exists():
            check_writable(path)
            with _empty_store(path, sweep) as temporary:
                os.replace(temporary, path)
        elif not (path / "zarr.json").exists():
            raise NacreError(f"{path}: exists and is not a sweep; choose another -o")
        else:
            store = cls(path, sweep)
            _restore(path, sweep)
            return store
        return cls(path, sweep)

    def missing(self) -> list[int]:
        """Return the unfinished points' numbers, failed and damaged ones included."""
        is_done = self._status() == DONE
        for name, size in self._bytes.items():
            is_done &= self._sizes(name) == size
        return [int(i) for i in np.flatnonzero(~is_done)]

    def counts(self) -> tuple[int, int]:
        """Return the numbers of finished and of failed points."""
        status = self._status()
        return int(np.sum(status == DONE)), int(np.sum(status == FAILED))

    def write(self, number: int, result: Result) -> None:
        """Store a point's values, or its error; the status comes last.

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
            stored.set()
        except OSError as error:
            raise NacreError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def _write_chunk(self, name: str, place: tuple[int, ...], content: bytes) -> None:
        """Write one chunk as a file: Zarr 3 with flat keys and no compression stores exactly these bytes.

        The library takes 1 ms per chunk, more than a point of a film takes to compute.
        """
        path = f"{self.path}/{name}/{KEY_SEPARATOR.join(('c', *map(str, place)))}"
        with open(f"{path}.partial", "wb", buffering=0) as file:
            file.write(content)
        os.replace(f"{path}.partial", path)

    def _status(self) -> NDArray[np.uint8]:
        """Return the status of every point, flat."""
        status = np.full(int(np.prod(self._shape)), MISSING, dtype=np.uint8)
        for number, entry in self._chunks("status"):
            content = Path(entry.path).read_bytes()
            if len(content) == 1:
                status[number] = content[0]
        return status

    def _sizes(self, name: str) -> NDArray[np.int64]:
        """Return the file size of every point's chunk, flat; -1 if it is missing."""
        sizes = np.full(int(np.prod(self._shape)), -1, dtype=np.int64)
        for number, entry in self._chunks(name):
            sizes[number] = entry.stat().st_size
        return sizes

    def _chunks(self, name: str) -> Iterator[tuple[int, os.DirEntry[str]]]:
        """Yield point number and file for each stored chunk in an array.

        Raises:
            NacreError: the folder of the array is missing or cannot be read.
        """
        rank = len(self._shape)
        try:
            for entry in os.scandir(self.path / name):
                head, *parts = entry.name.split(KEY_SEPARATOR)
                places, more = parts[:rank], parts[rank:]
                is_chunk = head == "c" and len(places) == rank and all(part.isdigit() for part in places)
                if not is_chunk or more != ["0"] * self._trailing.get(name, 0) or not entry.is_file():
                    continue
                indices = tuple(int(part) for part in places)
                if all(i < n for i, n in zip(indices, self._shape)):
                    yield int(np.ravel_multi_index(indices, self._shape)), entry
        except OSError as error:
            raise _damaged(self.path, error) from None


def _damaged(path: Path, error: Exception) -> NacreError:
    return NacreError(
        f"{path}: cannot be read as a sweep ({type(error).__name__}); choose another -o, or remove it to start again"
    )


def _fingerprint_of(path: Path) -> str:
    """Return the fingerprint in a store.

    Raises:
        NacreError: the store cannot be read.
    """
    try:
        return str(json.loads(plain(path / "zarr.json").read_bytes())["attributes"]["fingerprint"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise _damaged(path, error) from None


def _restore(path: Path, sweep: Sweep) -> None:
    """Write damaged or missing metadata and coordinates of a store again; its values stay.

    Raises:
        NacreError: a file cannot be written.
    """
    with _empty_store(path, sweep) as fresh:
        for file in [each for each in fresh.rglob("*") if each.is_file() and each != fresh / "zarr.json"]:
            place = path / file.relative_to(fresh)
            try:
                is_same = plain(place).read_bytes() == file.read_bytes()
            except OSError:
                is_same = False
            if not is_same:
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, place)


@contextlib.contextmanager
def _empty_store(path: Path, sweep: Sweep) -> Iterator[Path]:
    """Yield an empty store in a temporary folder beside `path`.

    Raises:
        NacreError: the folder cannot be written.
    """
    import zarr

    temporary = path
    try:
        temporary = Path(tempfile.mkdtemp(prefix=temporary_prefix(path), dir=path.parent))
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
        if measurement.geometries:
            _coordinate(group, "geometry", [name for name, _ in measurement.geometries], ["geometry"])
        if measurement.texture:
            _coordinate(group, "quantity", list(measurement.texture), ["quantity"])
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
        yield temporary
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if temporary != path:
            shutil.rmtree(temporary, ignore_errors=True)


def _dimension(path: str) -> str:
    """Convert a recipe path to a dimension name: `layers[0].thickness_nm` to `layers.0.thickness_nm`."""
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
    workers: Workers | None = None,
    progress: Progress | None = None,
    report: Callable[[str], None] = logger.warning,
) -> tuple[int, int]:
    """Compute the missing sweep points and return the numbers of finished and failed points.

    Args:
        sweep: from `load_sweep`.
        output: the Zarr folder; an interrupted run of the same sweep is resumed.
        workers: where points are computed; default: one process per core.
        progress: called with (finished, failed, total) after every point.
        report: called with a message if another process writes the store, which is waited for.

    Raises:
        NacreError: the store holds another sweep or cannot be written, or the cluster cannot be reached.
        MachineError: zarr is not installed.
    """
    require("zarr")
    workers = workers or Workers()
    workers.check()
    with locked(Path(output), report):
        store = Store.open(Path(output), sweep)
        total, missing = sweep.points.count, store.missing()
        finished, failed = total - len(missing), 0
        if progress:
            progress(finished, failed, total)
        shared = {
            "data": json.dumps(dict(sweep.material.data), sort_keys=True),
            "folder": str(sweep.material.context.folder.resolve()),
            "paths": tuple(axis.path for axis in sweep.points.axes),
            "files": tuple(sorted(sweep.files.items())),
            "measurement": asdict(sweep.measurement),
        }
        for index, result in run_jobs(_compute_point, shared, _Changes(sweep, missing), workers):
            store.write(missing[index], result)
            if isinstance(result, str):
                failed += 1
            else:
                finished += 1
            if progress:
                progress(finished, failed, total)
    return finished, failed


class _Changes(Sequence[dict[str, Any]]):
    """The recipe changes of the missing points, computed when a point is sent to a worker."""

    def __init__(self, sweep: Sweep, missing: list[int]) -> None:
        self._points, self._missing = sweep.points, missing

    def __len__(self) -> int:
        return len(self._missing)

    def __getitem__(self, index: Any) -> Any:
        return self._points.changes(self._missing[index])


def _compute_point(shared: Mapping[str, Any], changes: Mapping[str, Any]) -> Result:
    """Return a point's values, or the message of its error; runs in a worker."""
    try:
        varied = _parametrised(shared["folder"], shared["data"], shared["paths"], shared["files"])(changes)
        expected = dict(shared["files"])
        for name, digest in varied.context.files.items():
            if expected.get(name, digest) != digest:
                raise NacreError(f"{name} has changed since the sweep began; remove its folder and start it again")
        return measurement_from(dict(shared["measurement"])).take(varied, point_seed(changes))
    except NacreError as error:
        return str(error)
    except (ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError) as error:
        # one impossible point must not stop the others
        return f"{type(error).__name__}: {error}"


@functools.lru_cache(maxsize=4)
def _parametrised(
    folder: str, data: str, paths: tuple[str, ...], files: tuple[tuple[str, str], ...]
) -> Callable[[Mapping[str, Any]], Material]:
    """Return the parametrised material; `files` are the digests that make another one of changed files."""
    return tied_maker(material(json.loads(data), folder).at_low_fidelity(is_reported=True), paths)


__all__ = ["Store", "Sweep", "SweepSpec", "load_sweep", "run_sweep"]


MAX_POINTS_READ = 2_000_000


@dataclass(frozen=True)
class SweepAxis:
    """One varied number of a stored sweep.

    Attributes:
        path: the recipe path.
        values: grid: `[value]`; random and Sobol: `[point]`. Words have the values 0, 1, 2.
        words: the words in this order, empty for numbers.
    """

    path: str
    values: Array
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class SweepColours:
    """The colours of a stored sweep.

    Attributes:
        axes: the varied numbers.
        is_grid: whether the points form a grid of the axes' values.
        part: spectrum part that gives the colours.
        parts: all parts in the store.
        angles_deg: `[angle]`, incidence.
        xyz, lab: `[axis 0, axis 1, ..., angle, 3]` of a grid, `[point, angle, 3]` otherwise; NaN for missing points.
        illuminant, observer: for the colours.
        recipe: the recipe's text; source: the sweep's file name.
        labels: geometry names rather than angles, which then are their numbers.
    """

    axes: tuple[SweepAxis, ...]
    is_grid: bool
    part: str
    parts: tuple[str, ...]
    angles_deg: Array
    xyz: Array
    lab: Array
    illuminant: str
    observer: str
    recipe: str
    source: str
    labels: tuple[str, ...] = ()

    def parameters(self) -> Array:
        """Return the varied numbers of every point, `[point, axis]`, in the order of the flattened colours."""
        if not self.is_grid:
            return np.stack([axis.values for axis in self.axes], axis=-1)
        mesh = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        return np.stack([m.ravel() for m in mesh], axis=-1)


def read_sweep(path: str | Path, part: str | None = None) -> SweepColours:
    """Read the colours of a sweep's store, finished or not.

    Args:
        path: the Zarr folder that `nacre sweep` wrote.
        part: such as "diffuse_reflectance"; default: the brightest stored part.

    Raises:
        NacreError: the store or part does not exist, it is not a sweep, or it lacks a finished point.
    """
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise NacreError(f"{path}: is not a sweep's store; nacre sweep SWEEP.toml writes one")
    try:
        import zarr
    except ImportError:
        raise NacreError("reading a sweep needs zarr: pip install 'nacre[study]'") from None
    try:
        group: Any = zarr.open_group(str(path), mode="r")
        attributes = dict(group.attrs)
        paths: dict[str, str] = dict(attributes["axes"])
        parts = tuple(name.removeprefix("lab_") for name in sorted(group.array_keys()) if name.startswith("lab_"))
        if math.prod(group["status"].shape) > MAX_POINTS_READ:
            raise NacreError(f"{path}: has more than {MAX_POINTS_READ} points; draw a smaller sweep")
        status = np.asarray(group["status"][...])
        axes = tuple(_axis(group, name, recipe_path) for name, recipe_path in paths.items())
        if part is not None and part not in parts:
            hint = did_you_mean(part, parts)
            raise NacreError(f'{path}: holds no part "{part}".{hint} It holds {", ".join(parts)}')
        colours = {name: np.asarray(group[f"xyz_{name}"][...]) for name in ([part] if part else parts)}
        is_done = status == DONE
        if not is_done.any():
            raise NacreError(f"{path}: has no finished point to draw; run nacre sweep first")
        measured = [name for name in colours if name != AT_GEOMETRIES] or list(colours)
        chosen = part or max(measured, key=lambda name: float(np.nanmax(colours[name][is_done][..., 1])))
        lab = np.asarray(group[f"lab_{chosen}"][...])
        labels = tuple(_axis(group, "geometry", "").words) if chosen == AT_GEOMETRIES else ()
        angles = np.arange(float(len(labels))) if labels else np.asarray(group["angle_deg"][...], dtype=float)
        is_grid = attributes["mode"] == "grid"
        shape = tuple(len(axis.values) for axis in axes) if is_grid else (len(axes[0].values),)
        if lab.shape != (*shape, len(angles), 3) or colours[chosen].shape != lab.shape or status.shape != shape:
            raise ValueError("shapes disagree")
        return SweepColours(
            axes, is_grid, chosen, parts, angles, np.where(is_done[..., None, None], colours[chosen], np.nan),
            np.where(is_done[..., None, None], lab, np.nan), str(attributes["illuminant"]),
            str(attributes["observer"]), str(attributes["recipe"]), str(attributes["sweep"]), labels,
        )  # fmt: skip
    except NacreError:
        raise
    except Exception as error:  # a damaged store can raise any error inside zarr
        raise NacreError(f"{path}: cannot be read as a sweep ({type(error).__name__}: {str(error)[:80]!r})") from None


def _axis(group: Any, name: str, recipe_path: str) -> SweepAxis:
    array = group[name]
    words = tuple(str(word) for word in array.attrs.get("labels", ()))
    return SweepAxis(recipe_path, np.asarray(array[...], dtype=float), words)


SWEEP_KINDS = ("gamut", "colour-map", "parallel")
MAX_MAPS = 4


def save_sweep_figure(
    store: str | Path, kind: str, path: str | Path, angles_deg: Array | None = None, part: str | None = None
) -> None:
    """Draw a stored sweep and write the figure.

    Args:
        store: the Zarr folder of `nacre sweep`, finished or not.
        kind: one of `SWEEP_KINDS`.
        path: a PNG, PDF or SVG.
        angles_deg: stored angles; default: the first one, or up to four.
        part: spectrum part; default: the brightest stored.

    Raises:
        NacreError: not a sweep, an angle that is not stored, or an unsuitable kind.
    """
    from nacre.plot import save_figure

    colours = read_sweep(store, part)
    provenance = {"sweep": colours.source, "recipe": colours.recipe, "illuminant": colours.illuminant}
    save_figure(sweep_figure(colours, kind, angles_deg), path, provenance)


def sweep_figure(colours: SweepColours, kind: str, angles_deg: Array | None = None) -> Figure:
    """Draw one kind of figure; see `save_sweep_figure`."""
    from nacre.plot import sweeps

    chosen = _angles(colours, kind, angles_deg)
    labels = [colours.labels[i] if colours.labels else f"{colours.angles_deg[i]:g}\u00b0" for i in chosen]
    light = (colours.illuminant, colours.observer)
    title = colours.part.replace("_", " ").capitalize()
    flat = colours.xyz.reshape(-1, len(colours.angles_deg), 3)
    if kind == "gamut":
        return sweeps.gamut_figure(np.moveaxis(flat[:, chosen], 1, 0), *light, title=title, labels=labels)
    if kind == "parallel":
        parameters = colours.parameters()
        axes = [sweeps.AxisValues(_short(a.path), parameters[:, i], a.words) for i, a in enumerate(colours.axes)]
        return sweeps.parallel_figure(axes, flat[:, chosen[0]], *light, title=f"{title}, {labels[0]}")
    if kind == "colour-map":
        return _map(colours, chosen, labels, title, sweeps)
    raise NacreError(f'a sweep has no figure of kind "{kind}"; kinds: {", ".join(SWEEP_KINDS)}')


def _angles(colours: SweepColours, kind: str, angles_deg: Array | None) -> list[int]:
    stored = colours.angles_deg
    if angles_deg is not None and colours.labels:
        raise NacreError(f"--angles-deg: these colours are at named geometries: {', '.join(colours.labels)}")
    if angles_deg is not None:
        places = []
        for angle in np.atleast_1d(angles_deg):
            place = int(np.argmin(np.abs(stored - angle)))
            if abs(float(stored[place] - angle)) > 1e-6:
                stored_text = ", ".join(f"{a:g}" for a in stored)
                raise NacreError(f"--angles-deg: the sweep does not hold {angle:g} degrees; it holds {stored_text}")
            places.append(place)
        if kind == "colour-map" and len(places) > MAX_MAPS:
            raise NacreError(f"--angles-deg: a colour map shows {MAX_MAPS} angles at most, not {len(places)}")
        return places
    if kind == "parallel":
        return [0]
    return sorted({int(i) for i in np.linspace(0, len(stored) - 1, min(MAX_MAPS, len(stored))).round()})


def _map(colours: SweepColours, chosen: list[int], labels: list[str], title: str, sweeps: Any) -> Figure:
    """Map the two longest axes, or one axis over the angle; further axes have their first value."""
    if not colours.is_grid:
        raise NacreError("a colour map needs a grid sweep; draw random points with --kind gamut or parallel")
    light = (colours.illuminant, colours.observer)
    axes = [sweeps.AxisValues(_short(a.path), a.values, a.words) for a in colours.axes]
    lengths = [len(a.values) for a in colours.axes]
    if sum(length > 1 for length in lengths) < 2:
        long = int(np.argmax(lengths))
        values = np.moveaxis(colours.xyz, long, 0).reshape(lengths[long], len(colours.angles_deg), 3)
        over = sweeps.AxisValues("Angle of incidence (degrees)", colours.angles_deg)
        values = np.swapaxes(values, 0, 1)[None]
        figure: Figure = sweeps.sweep_map_figure(axes[long], over, values, *light, titles=[title])
        return figure
    first, second = sorted(np.argsort([-length for length in lengths], kind="stable")[:2])
    # words have more room along y
    x, y = (second, first) if axes[first].words and not axes[second].words else (first, second)
    place: list[Any] = [0] * len(axes)
    place[x] = place[y] = slice(None)
    values = colours.xyz[tuple(place)]  # [first, second, angle, 3]
    values = np.moveaxis(values[:, :, chosen], 2, 0)
    if x == first:
        values = np.swapaxes(values, 1, 2)
    fixed = [
        f"{axes[i].label} = {axes[i].words[0] if axes[i].words else f'{axes[i].values[0]:g}'}"
        for i in range(len(axes)) if i not in (x, y) and lengths[i] > 1
    ]  # fmt: skip
    titles = [f"{title}, {label}" if number == 0 else label for number, label in enumerate(labels)]
    figure = sweeps.sweep_map_figure(axes[x], axes[y], values, *light, titles=titles, note=", ".join(fixed))
    return figure


def _short(path: str) -> str:
    """Return a label of a recipe path: its last name, unit and index."""
    head, _, last = path.rpartition(".")
    stem, _, unit = last.rpartition("_")
    name = f"{stem.replace('_', ' ')} ({unit})" if unit in ("nm", "um", "mm", "deg") else last.replace("_", " ")
    number = head[head.rfind("[") :] if head.endswith("]") else ""
    return f"{name} {number}".strip()
