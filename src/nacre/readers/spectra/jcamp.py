"""JCAMP-DX 4.24 to 6: tables of pairs, evenly spaced ordinates in all compressed forms, and linked blocks."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_RECORD = re.compile(r"^\s*##\s*([^=]*?)\s*=(.*)$")
_SQZ = {letter: str(value) for value, letter in enumerate("@ABCDEFGHI")} | {
    letter: f"-{value}" for value, letter in enumerate("abcdefghi", start=1)
}
_DIF = {letter: str(value) for value, letter in enumerate("%JKLMNOPQR")} | {
    letter: f"-{value}" for value, letter in enumerate("jklmnopqr", start=1)
}
_DUP = {letter: str(value) for value, letter in enumerate("STUVWXYZ", start=1)} | {"s": "9"}
_TOKEN = re.compile(r"[@A-Ia-i%J-Rj-rS-Zs][\d.]*|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]\d+)?|\?")


@dataclass
class Block:
    """One block of a file: its records by normalised label, and the lines of its table."""

    records: dict[str, str] = field(default_factory=dict)
    table: list[str] = field(default_factory=list)
    form: str = ""
    kind: str = ""
    ended: bool = False


def sniff_jcamp(head: FileHead) -> float:
    """Return 1 if the first line is `##TITLE=`."""
    first = next((line for line in head.lines if line.strip()), "")
    return CERTAIN if re.match(r"\s*##\s*TITLE\s*=", first, re.IGNORECASE) else 0.0


def read_jcamp(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a file's spectra; three linked blocks of counts give (sample - dark) / (reference - dark)."""
    found = [block for block in _blocks(common.read_text(path).lines) if block.table]
    if not found:
        raise NacreError(f"{path}: JCAMP-DX without XYDATA or XYPOINTS")
    roles = {_role(block): block for block in found}
    if {"sample", "dark", "reference"} <= set(roles):
        return [_reflectance(path, roles, options)]
    notes = Notes()
    readable = []
    for block in found:
        units = block.records.get("YUNITS", "")
        label = common.label_of(units)
        if label is not None and label.quantity == "error":
            notes.left_out.append(f"a block of {units}")
        else:
            readable.append((block, label))
    if not readable:
        raise NacreError(f"{path}: has no block of a spectrum")
    return common.choose(path, [_spectrum(path, block, label, options, notes) for block, label in readable], options)


def _blocks(lines: list[str]) -> list[Block]:
    """Return the blocks that have a table; comments `$$` are dropped."""
    open_blocks: list[Block] = []
    done: list[Block] = []
    for raw in lines:
        line = raw.split("$$")[0]
        record = _RECORD.match(line)
        if record is None:
            if open_blocks and open_blocks[-1].kind:
                open_blocks[-1].table.append(line)
            continue
        label, value = re.sub(r"[\s_/-]", "", record[1]).upper(), record[2].strip()
        if label == "TITLE":
            open_blocks.append(Block())
        if not open_blocks:
            continue
        block = open_blocks[-1]
        if label == "END":
            block.ended = True
            done.append(open_blocks.pop())
        elif label in ("XYDATA", "XYPOINTS", "PEAKTABLE"):
            block.kind, block.form = label, value.replace(" ", "").upper()
        elif not block.kind or label not in block.records:
            block.records[label] = value
    done += reversed(open_blocks)
    return [block for block in done if block.kind]


def _role(block: Block) -> str:
    title = (block.records.get("SAMPLEDESCRIPTION", "") + " " + block.records.get("TITLE", "")).upper()
    if "DARK" in title:
        return "dark"
    if "REFERENCE" in title or "WHITE" in title:
        return "reference"
    return "sample" if re.search(r"PROCESSED|SCOPE|SAMPLE", title) else ""


def _reflectance(path: Path, roles: dict[str, Block], options: ReadOptions) -> Measurement:
    """Return the ratio of three blocks of counts, or the processed block if it already is a ratio."""
    tables = {role: _xy(path, roles[role]) for role in ("sample", "dark", "reference")}
    nm = tables["sample"][0]
    if any(len(x) != len(nm) or not np.allclose(x, nm) for x, _ in tables.values()):
        raise NacreError(f"{path}: its blocks of sample, dark and reference have different wavelengths")
    sample, dark, reference = (tables[role][1] for role in ("sample", "dark", "reference"))
    block = roles["sample"]
    notes = Notes()
    unit = _unit(path, block, options)
    label = common.label_of(block.records.get("YUNITS", "")) or Label("reflectance", 0.01)
    if common.typical(nm, sample) < 0.05 * common.typical(nm, reference):
        values = sample
    else:
        values = 100.0 * common.ratio(sample, dark, reference)
        notes.assumed.append(
            f"{block.records.get('YUNITS', 'the quantity')} stands above counts; reflectance = (sample - dark) / "
            "(reference - dark)"
        )
        label = Label("reflectance", 0.01)
    counts = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
    return common.spectrum(
        path, "jcamp", nm, values, label, options, unit=unit, name=block.records.get("TITLE", ""),
        metadata=_metadata(block), notes=notes, more=counts,
    )  # fmt: skip


def _spectrum(path: Path, block: Block, label: Label | None, options: ReadOptions, shared: Notes) -> Measurement:
    notes = Notes(list(shared.assumed), list(shared.left_out))
    x, y = _xy(path, block)
    unit = _unit(path, block, options)
    nm = common.nanometres(x, unit)
    label = common.option_label(path, options) or label
    units = block.records.get("YUNITS", "")
    if label is None:
        label = common.named_quantity(path, options, units, nm, y, notes)
    if label.quantity in ("reflectance", "transmittance") and label.factor is None:
        # JCAMP-DX 4.24, sec. 4.2: TRANSMITTANCE and REFLECTANCE are factors; some programs write per cent
        label = common.Label(label.quantity, 0.01 if common.typical(nm, y) > 2 else 1.0)
        if label.factor == 0.01:
            notes.assumed.append("per cent, because the values are above 2")
    elif label.factor == 0.01 and common.typical(nm, y) > 1000:
        raise NacreError(f"{path}: YUNITS = {units}, but the values are counts up to {common.typical(nm, y):.5g}")
    name = block.records.get("TITLE", "")
    return common.spectrum(
        path, "jcamp", x, y, label, options, unit=unit, name=name, metadata=_metadata(block), notes=notes
    )


def _metadata(block: Block) -> dict[str, str]:
    keys = ("ORIGIN", "OWNER", "DATE", "TIME", "SPECTROMETER", "SPECTROMETERDATASYSTEM", "INSTRUMENTPARAMETERS",
            "DATAPROCESSING", "DATATYPE", "SAMPLEDESCRIPTION", "YUNITS")  # fmt: skip
    return {key.lower(): value for key, value in block.records.items() if key in keys and value}


def _unit(path: Path, block: Block, options: ReadOptions) -> str:
    unit = common.option_unit(path, options) or common.unit_named(block.records.get("XUNITS", ""))
    if unit is None:
        raise NacreError(f'{path}: XUNITS = "{block.records.get("XUNITS", "")}" is no unit of a spectrum')
    return unit


def _number(block: Block, key: str) -> float | None:
    text = block.records.get(key)
    return None if text is None or not text.split() else common.number(text.split()[0], comma=True)


def _xy(path: Path, block: Block) -> tuple[Array, Array]:
    """Return abscissa and ordinate of a block, and check their number.

    Raises:
        NacreError: a table of peaks, a damaged line, or another point count than NPOINTS.
    """
    if block.kind == "PEAKTABLE":
        raise NacreError(f"{path}: JCAMP-DX with a table of peaks, which is no spectrum")
    x_factor, y_factor = (
        value if (value := _number(block, key)) is not None else 1.0 for key in ("XFACTOR", "YFACTOR")
    )
    if block.form.startswith("(XY"):
        pairs = _pairs(path, block.table, "," in block.records.get("FIRSTX", "") + block.records.get("MAXY", ""))
        x, y = pairs[:, 0] * x_factor, pairs[:, 1] * y_factor
    elif block.form.startswith("(X++"):
        y = np.array(_ordinates(path, block.table)) * y_factor
        first, last = _number(block, "FIRSTX"), _number(block, "LASTX")
        step = _number(block, "DELTAX")
        if last is None and first is not None and step is not None:
            last = first + step * (len(y) - 1)
        if first is None or last is None:
            raise NacreError(f"{path}: JCAMP-DX without FIRSTX and LASTX or DELTAX")
        x = np.linspace(first, last, len(y))
        _check_abscissa(path, block.table, x, x_factor)
    else:
        raise NacreError(
            f'{path}: the form "{block.form}" of {block.kind} is not known; allowed: (XY..XY), (X++(Y..Y))'
        )
    common.check_count(path, block.records.get("NPOINTS"), len(y), "NPOINTS")
    return x, y


def _check_abscissa(path: Path, lines: list[str], x: Array, factor: float) -> None:
    """Refuse abscissas of FIRSTX and LASTX that the begin of the last line contradicts by 5 % of the range.

    Raises:
        NacreError: points are missing, or LASTX is that of another spectrum.
    """
    rows = [line for line in lines if line.strip()]
    stated = common.number(_TOKEN.findall(rows[-1])[0]) if len(rows) > 1 else None
    if stated is None:
        return
    expected = x[min(len(_ordinates(path, rows[:-1])), len(x) - 1)]
    if min(abs(stated * factor - expected), abs(stated - expected)) > 0.05 * np.ptp(x) + 2.0 * np.ptp(x) / len(x):
        raise NacreError(
            f"{path}: the last line begins at {stated * factor:g}, and FIRSTX with LASTX give {expected:g}; points are "
            "missing or LASTX is wrong"
        )


def _pairs(path: Path, lines: list[str], comma: bool) -> Array:
    """Return pairs of numbers with commas, semicolons or blanks between them.

    Args:
        comma: whether the comma is the decimal point, as the records of the block show.
    """
    rows: list[list[float]] = []
    for line in filter(str.strip, lines):
        words = re.split(r",\s+|[;\s]+" if comma else r"[,;\s]+", line.strip().strip(";,"))
        values = [value for word in words if word and (value := common.number(word, comma)) is not None]
        if len(values) % 2 or len(values) < len([word for word in words if word]):
            raise NacreError(f'{path}: "{line.strip()[:60]}" holds no pairs of numbers')
        rows += [values[at : at + 2] for at in range(0, len(values), 2)]
    return np.array(rows, dtype=float).reshape(-1, 2)


def _ordinates(path: Path, lines: list[str]) -> list[float]:
    """Return the ordinates of (X++(Y..Y)) in the forms AFFN, PAC, SQZ, DIF and DUP (JCAMP-DX 4.24, sec. 5).

    Raises:
        NacreError: a word is not a number, or the check value of a line of differences disagrees.
    """
    values: list[float] = []
    check = False  # whether the first ordinate of the next line repeats the last of this one
    rows = [line for line in lines if line.strip()]
    for number, line in enumerate(rows, start=1):
        tokens = _TOKEN.findall(line)
        if re.sub(r"[\s,;]", "", line) != "".join(tokens):
            raise NacreError(f'{path}: "{line.strip()[:60]}" is not in a form of JCAMP-DX')
        difference: float | None = None
        is_first = True
        for token in tokens[1:]:
            lead = token[0]
            if lead in _DUP:
                for _ in range(int(_DUP[lead] + token[1:]) - 1):
                    values.append(values[-1] + (difference or 0.0))
                continue
            if lead in _DIF:
                difference = float(_DIF[lead] + token[1:])
                values.append(values[-1] + difference)
                is_first = False
                continue
            difference = None
            value = float("nan") if token == "?" else float(_SQZ[lead] + token[1:] if lead in _SQZ else token)
            if is_first and check:
                # some programs end the table with a line of one zero in place of the check value
                is_end = number == len(rows) and len(tokens) == 2 and value == 0.0
                if values[-1] != value and not is_end:
                    raise NacreError(f"{path}: a check value of its differences is {value:g}, not {values[-1]:g}")
            else:
                values.append(value)
            is_first = False
        check = difference is not None
    return values
