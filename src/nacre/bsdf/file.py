"""The `.nacre` file: a zip of .npy arrays (never pickles) and a JSON header.

The header contains format and version, the tree of lobes, each array's shape, type, axes and checksum, the units
and the provenance. Declared sizes are checked before memory is allocated, and file content is never executed.
Lobes are checked on loading: field types, invariants, and a trial evaluation.
"""

import dataclasses
import functools
import hashlib
import io
import json
import math
import struct
import types
import typing
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.bsdf.registry import lobe_class
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import ParameterAxis, Texture, at_the_middle, parse_formula
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.core.machine import check_memory

FORMAT = "nacre-bsdf"
VERSION = 1
HEADER = "header.json"
MAX_HEADER_BYTES = 16 << 20
MAX_ARRAYS = 1000
MAX_DEPTH = 12
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
DTYPES = ("<f8", "<f4", "<i8", "<i4", "|u1", "|b1", "<c16", "<c8")
UNITS = {"wavelengths_nm": "nm", "*_nm": "nm", "*_rad": "rad", "bsdf": "1/sr", "power ratios": "1"}
_PARTS: dict[str, type] = {
    "interface-response": InterfaceResponse,
    "parameter-axis": ParameterAxis,
    "texture": Texture,
    "interface-polarisation": InterfacePolarisation,
}


def write_lobes(
    path: str | Path,
    lobes: tuple[Lobe, ...],
    provenance: Mapping[str, Any],
    is_packed: bool = True,
    polarisation: InterfacePolarisation | None = None,
) -> None:
    """Write a Bsdf's lobes and provenance atomically.

    Args:
        is_packed: deflate, which makes tables 10 % or more smaller and takes ten times as long.
        polarisation: Mueller interface matrices; stored in single precision.

    Raises:
        NacreError: the folder is not writable, or a lobe contains an unsupported value.
    """
    trees, arrays, axes = describe_lobes(lobes, str(path))
    matrices = None
    if polarisation is not None:
        matrices = _encode(polarisation.compact(), "polarisation", arrays, axes, str(path))
    described = {
        name: {
            "shape": list(array.shape),
            "dtype": array.dtype.str,
            "sha256": hashlib.sha256(array.tobytes()).hexdigest(),
            **({"axes": axes[name]} if name in axes else {}),
        }
        for name, array in arrays.items()
    }
    header = {
        "format": FORMAT,
        "version": VERSION,
        "nacre": __version__,
        "units": UNITS,
        "provenance": _plain(provenance),
        "lobes": trees,
        "arrays": described,
        **({} if matrices is None else {"polarisation": matrices}),
    }
    text = json.dumps(header, indent=1, allow_nan=False)
    with (
        atomic_path(path) as temporary,
        zipfile.ZipFile(
            temporary, "w", zipfile.ZIP_DEFLATED if is_packed else zipfile.ZIP_STORED, compresslevel=1
        ) as zipped,
    ):
        _write_entry(zipped, HEADER, text.encode())
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, version=(1, 0), allow_pickle=False)
            _write_entry(zipped, f"{name}.npy", buffer.getvalue())


def describe_lobes(lobes: tuple[Lobe, ...], where: str) -> tuple[list[Any], dict[str, NDArray[Any]], dict[str, str]]:
    """Return the lobes as a JSON tree, the arrays that it names, and the arrays' axes.

    Raises:
        NacreError: a lobe contains an unsupported value; the message starts with `where`.
    """
    arrays: dict[str, NDArray[Any]] = {}
    axes: dict[str, str] = {}
    trees = [_encode(lobe, f"lobe{i}", arrays, axes, where) for i, lobe in enumerate(lobes)]
    return trees, arrays, axes


def _write_entry(zipped: zipfile.ZipFile, name: str, content: bytes) -> None:
    # a fixed date: the same material gives the same bytes
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipped.compression
    zipped.writestr(entry, content)


def _encode(value: Any, where: str, arrays: dict[str, NDArray[Any]], axes: dict[str, str], path: str) -> Any:
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        if not math.isfinite(value):
            raise NacreError(f"{path}: {where} is not finite and cannot be stored")
        return float(value)
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        if array.dtype.str not in DTYPES:
            raise NacreError(f"{path}: {where} is an array of {array.dtype}, which cannot be stored")
        if not np.all(np.isfinite(array)):
            raise NacreError(f"{path}: {where} holds values that are not finite and cannot be stored")
        arrays[where] = array.reshape(value.shape)
        return {"array": where}
    if isinstance(value, tuple):
        return {"tuple": [_encode(v, f"{where}.{i}", arrays, axes, path) for i, v in enumerate(value)]}
    own = (name for name, cls in _PARTS.items() if type(value) is cls)
    name = value.kind if isinstance(value, Lobe) else next(own, None)
    if name is None:
        raise NacreError(f"{path}: {where} is a {type(value).__name__}, which cannot be stored")
    fields = {}
    named = getattr(type(value), "AXES", {})
    for field in dataclasses.fields(value):
        inner, at = getattr(value, field.name), f"{where}.{field.name}"
        if isinstance(value, Texture) and field.name == "formula":
            fields[field.name] = None if inner is None else inner.text
            continue
        if isinstance(value, Texture) and field.name == "is_stepped" and not inner:
            continue  # keeps files without such a texture readable for older versions
        if field.name in getattr(type(value), "OMITTED_UNSET", ()) and (inner is None or inner is False):
            continue  # as above
        fields[field.name] = _encode(inner, at, arrays, axes, path)
        if at in arrays and field.name in named:
            axes[at] = named[field.name]
    return {"type": name, "fields": fields}


def _plain(value: Any) -> Any:
    """Return provenance as JSON data."""
    if isinstance(value, dict) or hasattr(value, "items"):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def read_lobes(path: str | Path) -> tuple[tuple[Lobe, ...], Mapping[str, Any], InterfacePolarisation | None]:
    """Read a Bsdf's lobes, its provenance, and the Mueller matrices of its interface if the file has them.

    Raises:
        NacreError: the file is missing, damaged, too large, of another format or too new.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(plain(path)) as zipped:
            return _read(zipped, path)
    except NacreError:
        raise
    # zipfile has many exceptions for damaged files
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError):
        raise NacreError(f"{path}: is not a .nacre file, or it is damaged or cut short") from None
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None


def _read(
    zipped: zipfile.ZipFile, path: Path
) -> tuple[tuple[Lobe, ...], Mapping[str, Any], InterfacePolarisation | None]:
    entries = {entry.filename: entry for entry in zipped.infolist()}
    if HEADER not in entries:
        raise NacreError(f"{path}: is not a .nacre file: it has no {HEADER}")
    if any(entry.compress_type not in PACKINGS for entry in entries.values()):
        raise NacreError(f"{path}: has an unsupported compression; .nacre files are stored or deflated")
    if entries[HEADER].file_size > MAX_HEADER_BYTES or len(entries) > MAX_ARRAYS:
        raise NacreError(f"{path}: its header or its number of arrays is larger than any .nacre file needs")
    try:
        header = json.loads(zipped.read(HEADER).decode(), parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise NacreError(f"{path}: its header is not readable JSON") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise NacreError(f"{path}: is not a .nacre file: its header does not say {FORMAT}")
    version = header.get("version")
    if not isinstance(version, int) or version < 1:
        raise NacreError(f"{path}: its header has no valid format version")
    if version > VERSION:
        made = str(header.get("nacre", "?"))[:40]
        raise NacreError(
            f"{path}: format version {version} (written by nacre {made}) is newer than {VERSION}, "
            f"which nacre {__version__} reads; upgrade nacre"
        )
    try:
        arrays = _read_arrays(zipped, entries, header["arrays"], path)
        lobes = tuple(_decode(lobe, arrays, path, 0) for lobe in header["lobes"])
        if not lobes or not all(isinstance(lobe, Lobe) for lobe in lobes):
            raise NacreError(f"{path}: holds no lobes")
        for lobe in lobes:
            check_lobe(lobe)
            if not np.array_equal(lobe.wavelengths_nm, lobes[0].wavelengths_nm):
                raise ValueError("its lobes have different wavelengths")
        provenance = header.get("provenance")
        matrices = _decode(header.get("polarisation"), arrays, path, 0)
        if matrices is not None:
            check_fields(matrices)
            if not np.array_equal(matrices.wavelengths_nm, lobes[0].wavelengths_nm):
                raise ValueError("its Mueller matrices have other wavelengths than its lobes")
        return lobes, provenance if isinstance(provenance, dict) else {}, matrices
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        reason = " ".join(str(error).split())[:120]
        raise NacreError(f"{path}: its header does not describe a Bsdf: {reason}") from None


def _no_constant(word: str) -> float:
    raise ValueError(f"{word} is not valid JSON")


def _read_arrays(
    zipped: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], described: dict[str, Any], path: Path
) -> dict[str, NDArray[Any]]:
    total, expected = 0, {}
    for name, info in described.items():
        shape, dtype = info["shape"], info["dtype"]
        if dtype not in DTYPES or not all(isinstance(n, int) and 0 <= n < 2**31 for n in shape) or len(shape) > 8:
            raise ValueError(f"array {name[:60]} has an invalid shape or type")
        size = math.prod(shape) * np.dtype(dtype).itemsize
        total += size
        entry = entries.get(f"{name}.npy")
        if entry is None:
            raise NacreError(f"{path}: array {name[:60]} is missing; the file is damaged")
        if not 0 <= entry.file_size - size <= 4096:  # the .npy header
            raise NacreError(f"{path}: array {name[:60]} is not as large as the header says; the file is damaged")
        expected[name] = (tuple(shape), dtype, info["sha256"])
    check_memory(total, f"{path}: unpacked, it")
    arrays = {}
    for name, (shape, dtype, digest) in expected.items():
        with zipped.open(f"{name}.npy") as stream:
            try:
                array = np.lib.format.read_array(stream, allow_pickle=False, max_header_size=4096)
            except Exception:  # numpy's header parser has many exceptions: token, syntax, value, type errors
                raise NacreError(f"{path}: array {name[:60]} is damaged") from None
        if array.shape != shape or array.dtype.str != dtype:
            raise NacreError(f"{path}: array {name[:60]} is not as the header says; the file is damaged")
        if hashlib.sha256(np.ascontiguousarray(array).data).hexdigest() != digest:
            raise NacreError(f"{path}: array {name[:60]} does not match its checksum; the file is damaged")
        if not np.all(np.isfinite(array)):
            raise NacreError(f"{path}: array {name[:60]} holds values that are not finite")
        array.flags.writeable = False
        arrays[name] = array
    return arrays


def _decode(node: Any, arrays: dict[str, NDArray[Any]], path: Path, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise ValueError("its lobes are nested too deep")
    if not isinstance(node, dict):
        if isinstance(node, list):
            raise ValueError("a bare list is not a value")
        return node
    if "array" in node:
        return arrays[node["array"]]
    if "tuple" in node:
        return tuple(_decode(inner, arrays, path, depth + 1) for inner in node["tuple"])
    name = node["type"]
    try:
        cls: Any = _PARTS[name] if name in _PARTS else lobe_class(name)
    except KeyError:
        raise NacreError(f"{path}: holds a {str(name)[:40]}, which nacre {__version__} does not know") from None
    fields = {str(key): _decode(value, arrays, path, depth + 1) for key, value in node["fields"].items()}
    if cls is Texture and fields.get("formula") is not None:
        fields["formula"] = parse_formula(fields["formula"])
    return cls(**fields)


TRIAL_COS = np.array([1.0, 0.7, 0.05])
TRIAL_AZIMUTHS = (0.0, 2.0)
LARGEST = 1e15  # far above any index, height in nm, density or BSDF value
ROUNDING = 1e-6  # relative undershoot below 0 that interpolation may cause


def check_lobe(lobe: Lobe) -> None:
    """Check one lobe.

    Raises:
        ValueError: names the invalid part.
    """
    check_fields(lobe)
    lobe.check()
    try:
        with np.errstate(all="ignore"):
            answers = list(_trial(at_the_middle(lobe)))
    except Exception as error:  # inconsistent tables cause various numpy errors
        raise ValueError(f"its {lobe.kind} lobe cannot be evaluated: {type(error).__name__}") from None
    for answer in answers:
        if answer.shape[-1:] != (len(lobe.wavelengths_nm),):
            raise ValueError(f"its {lobe.kind} lobe has values at other wavelengths than its own")
        if not np.isfinite(answer).all() or answer.min() < -ROUNDING * max(float(answer.max()), ROUNDING):
            raise ValueError(f"its {lobe.kind} lobe has values that are negative or not finite")


def _trial(lobe: Lobe) -> typing.Iterator[Any]:
    """Yield the lobe's values at some directions; random walks are left to the renderer."""
    sides = (1.0, -1.0) if lobe.transmits else (1.0,)
    yield from (part for side in sides for part in dataclasses.astuple(lobe.specular(side * TRIAL_COS)))
    if lobe.is_stochastic:
        return
    sine = np.sqrt(1.0 - TRIAL_COS**2)
    for side in sides:
        for azimuth in TRIAL_AZIMUTHS:
            wi = np.stack([sine, 0.0 * sine, TRIAL_COS], axis=-1)
            wo = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), side * TRIAL_COS], axis=-1)
            yield lobe.evaluate(*map(np.ascontiguousarray, np.broadcast_arrays(wi[:, None], wo[None])))


def check_fields(part: Any) -> None:
    """Check a lobe's field types, or of a part, against the class annotations.

    Raises:
        ValueError: names the field.
    """
    for name, declared in _declared(part.__class__).items():
        value = getattr(part, name)
        if isinstance(value, np.ndarray) and value.size and np.abs(value).max() > LARGEST:
            raise ValueError(f"{name} of its {type(part).__name__} has the value {np.abs(value).max():.3g}: too large")
        if not _fits(value, declared):
            raise ValueError(f"{name} of its {type(part).__name__} is a {type(value).__name__}, an invalid type")
        for inner in value if isinstance(value, tuple) else (value,):
            if dataclasses.is_dataclass(inner):
                check_fields(inner)


@functools.lru_cache(maxsize=256)
def _declared(kind: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _fits(value: Any, declared: Any) -> bool:
    origin, arguments = typing.get_origin(declared), typing.get_args(declared)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, argument) for argument in arguments)
    if origin is np.ndarray:
        kind = np.dtype(typing.get_args(arguments[1])[0] if typing.get_args(arguments[1]) else arguments[1]).kind
        # bytes and integers are accepted as floats; text and complex numbers are not
        return isinstance(value, np.ndarray) and value.dtype.kind in {"f": "fiub", "c": "cfiub"}.get(kind, "iub")
    if origin is tuple:
        return isinstance(value, tuple) and (
            all(_fits(inner, arguments[0]) for inner in value)
            if arguments[-1:] == (Ellipsis,)
            else len(value) == len(arguments) and all(map(_fits, value, arguments))
        )
    if origin is typing.Literal:
        return value in arguments
    if declared is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if declared is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return declared is Any or not isinstance(declared, type) or isinstance(value, declared)
