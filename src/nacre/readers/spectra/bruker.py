"""Bruker: OPUS files and data point tables (.dpt)."""

import struct
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

# Bruker OPUS binary files: a directory of blocks, with parameters and evenly spaced values.

MAGIC = b"\x0a\x0a\xfe\xfe"
BlockType = tuple[int, int, int, int, int, int]
# widths in bits of the codes in a block type: complex part, source, parameters, data, derivative, form
_BITS = (2, 2, 6, 7, 2, 3)
_LABELS = {
    4: Label("absorbance", 1.0), 5: Label("transmittance", 1.0), 6: Label("kubelka_munk", 1.0),
    12: Label("reflectance", 1.0), 15: Label("absorbance", 1.0), 16: Label("absorbance", 1.0),
    18: Label("transmittance", 1.0), 19: Label("absorbance", 1.0),
}  # fmt: skip
_DATA = {1: "single-channel spectrum", 2: "interferogram", 3: "phase", 10: "Raman spectrum", 11: "emission spectrum"}
_UNITS = {"WN": "1/cm", "MI": "um", "WL": "um"}
DIRECTORY, PARAMETERS, REPORTS = 13, 1, (2, 5)


def sniff_opus(head: FileHead) -> float:
    """Return 1 for the magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


def read_opus(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the result spectra, or single-channel spectra (counts) if there is none; the others are named."""
    blocks = _directory(path, path.read_bytes())
    parameters = [(kind, _parameters(raw)) for kind, raw in blocks if kind[2] > 0]
    sample = next((str(values["SNM"]) for _, values in parameters if values.get("SNM")), "")
    found: list[Measurement] = []
    notes = Notes()
    labels = _LABELS if any(kind[3] in _LABELS and not kind[2] for kind, _ in blocks) else {1: Label("counts", 1.0)}
    for kind, raw in blocks:
        if kind[2] or kind[3] in (0, DIRECTORY) or kind[5] in REPORTS:
            continue
        status = next(
            (v for k, v in parameters if k[2] == PARAMETERS and k[:2] == kind[:2] and k[3:] == kind[3:]), None
        )
        label = labels.get(kind[3])
        unit = _UNITS.get(str((status or {}).get("DXU", "WN")))
        if status is None or label is None or unit is None or kind[4] or (kind[1] == 2 and 1 not in labels):
            notes.left_out.append(_DATA.get(kind[3], f"a block of type {kind}"))
            continue
        count = int(status["NPT"])
        if len(raw) < 4 * count:
            raise NacreError(f"{path}: an OPUS block has {len(raw) // 4} values of {count}; the file is cut or damaged")
        used = raw[-4 * count :] if kind[5] == 4 else raw[: 4 * count]
        values = np.frombuffer(used, "<f4").astype(float) * float(status.get("CSF", 1.0))
        x = np.linspace(float(status["FXV"]), float(status["LXV"]), count)
        metadata = {"date": str(status.get("DAT", "")), "time": str(status.get("TIM", ""))}
        found.append(
            common.spectrum(
                path, "opus", x, values, label, options, unit=unit, name=sample, metadata=metadata,
                notes=Notes(left_out=notes.left_out),
            )
        )  # fmt: skip
    if not found:
        raise NacreError(
            f"{path}: an OPUS file without a result spectrum; it holds: {', '.join(notes.left_out) or 'nothing'}"
        )
    return common.choose(path, found, options)


def _directory(path: Path, data: bytes) -> list[tuple[BlockType, bytes]]:
    """Return the blocks with their types. The head holds, from byte 12: offset, capacity and number of entries."""
    start, capacity, count = struct.unpack_from("<3i", data, 12)
    found: list[tuple[BlockType, bytes]] = []
    for number in range(min(count, capacity)):
        code, size, offset = struct.unpack_from("<3I", data, start + 12 * number)
        if offset == 0:
            continue
        if offset + 4 * size > len(data):
            raise NacreError(f"{path}: an OPUS block ends behind the file; it is cut")
        parts = []
        for bits in _BITS:
            parts.append(code & ((1 << bits) - 1))
            code >>= bits
        found.append(((parts[0], parts[1], parts[2], parts[3], parts[4], parts[5]), data[offset : offset + 4 * size]))
    return found


def _parameters(raw: bytes) -> dict[str, int | float | str]:
    """Return a block's parameters: name, type (0 integer, 1 float, else text), size in words, value."""
    found: dict[str, int | float | str] = {}
    at = 0
    while at + 8 <= len(raw):
        key = raw[at : at + 3].decode("latin-1")
        if key == "END":
            break
        kind, words = struct.unpack_from("<2h", raw, at + 4)
        value = raw[at + 8 : at + 8 + 2 * words]
        if words <= 0 or len(value) < 2 * words:
            break
        if kind == 0:
            found[key] = struct.unpack_from("<i", value)[0]
        elif kind == 1:
            found[key] = struct.unpack_from("<d", value)[0]
        else:
            found[key] = value.split(b"\0")[0].decode("latin-1").strip()
        at += 8 + 2 * words
    return found


# Bruker data point tables `.dpt`: two columns with commas or tabs, without units and quantity.


def sniff_bruker_dpt(head: FileHead) -> float:
    """Return 0.6 for two columns without a heading in a file `.dpt`."""
    if head.path.suffix.lower() != ".dpt" or not head.is_text:
        return 0.0
    rows = [common.numeric_row(line, common.delimiter(line)) for line in head.lines[:20] if line.strip()]
    return LIKELY if rows and all(row is not None and len(row) == 2 for row in rows) else 0.0


def read_bruker_dpt(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the unit and quantity that the options state.

    Raises:
        AmbiguousFileError: unit or quantity is not stated; the program writes nm or 1/cm, R, T or absorbance.
    """
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, found[0])
    unit = common.option_unit(path, options)
    reach = f"{table[:, 0].min():g} to {table[:, 0].max():g}"
    if unit is None:
        raise AmbiguousFileError(f"{path}: no unit of the abscissa ({reach}) in a .dpt", "unit", ("nm", "1/cm", "um"))
    label = common.option_label(path, options)
    if label is None:
        size = common.typical(common.nanometres(table[:, 0], unit), table[:, 1])
        choices = ("reflectance", "transmittance", "absorbance", "counts")
        raise AmbiguousFileError(f"{path}: no quantity in a .dpt, values up to {size:.4g}", "quantity", choices)
    notes = Notes()
    return [common.spectrum(path, "bruker-dpt", table[:, 0], table[:, 1], label, options, unit=unit, notes=notes)]
