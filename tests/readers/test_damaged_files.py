"""Damaged and relabelled copies of instrument files: another answer needs another word."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement
from nacre.readers.registry import CUT, open_file

FILES = Path(__file__).parents[2] / ".." / "shared" / "reference" / "instruments"
KINDS = ("ellipsometry", "nk", "spectra", "colours", "heights", "bsdf", "tmatrix")
MAX_BYTES = 250_000
COPIES = 3000
Damage = Callable[[bytes, random.Random], bytes]


def truncated(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(1, len(data))]


def other_encoding(data: bytes, chance: random.Random) -> bytes:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data
    kind = chance.choice(["utf-16", "utf-8-sig", "cp1252", "CR", "CRLF"])
    if kind in ("CR", "CRLF"):
        return re.sub("\r\n|\n|\r", "\r" if kind == "CR" else "\r\n", text).encode()
    try:
        return text.encode(kind)
    except UnicodeEncodeError:
        return data


def same(data: bytes, chance: random.Random) -> bytes:
    return data


def columns_swapped(data: bytes, chance: random.Random) -> bytes:
    """Exchange two columns with their headings and units, where all rows of a table have as many cells."""
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return data
    for mark in ("\t", ";", ","):
        width = max((line.count(mark) for line in lines), default=0) + 1
        is_row = [line.count(mark) + 1 == width for line in lines]
        headed = any(is_row[place] and re.search("[A-Za-z]{2}", lines[place]) for place in range(min(len(lines), 80)))
        if width < 3 or sum(is_row) < 5 or not headed or '"' in data.decode("utf-8-sig")[:2000]:
            continue
        first, second = chance.sample(range(width), 2)
        for place in np.flatnonzero(is_row):
            cells = lines[place].split(mark)
            cells[first], cells[second] = cells[second], cells[first]
            lines[place] = mark.join(cells)
        return "\n".join(lines).encode() + b"\n"
    return data


def in_micrometres(data: bytes, chance: random.Random) -> bytes:
    """Replace the unit nm by um, but for remarks that a program writes about its instrument."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data
    return re.sub(r"(?<=[(\[ \t])nm(?=[)\]\t ])|(?m:^nm(?= ?$))", "um", text).encode()


SUFFIXES = (".txt", ".csv", ".dat", ".bin", ".xyz", ".spc", "", ".TRM", ".json")
DAMAGES: dict[str, Damage] = {
    "truncated": truncated,
    "encoding": other_encoding,
    "suffix": same,
    "columns": columns_swapped,
    "unit": in_micrometres,
}


def files() -> list[Path]:
    found = []
    for kind in KINDS:
        index = FILES / kind / "index.json"
        if index.exists():
            found += [FILES / kind / entry["file"] for entry in json.loads(index.read_text(encoding="utf-8"))]
    return [path for path in found if path.stat().st_size <= MAX_BYTES]


def contents(path: Path) -> list[Measurement] | None:
    try:
        return open_file(path)
    except NacreError:
        return None


def sentences(found: list[Measurement]) -> set[str]:
    return {sentence for each in found for sentence in (*each.assumed, *each.left_out)}


def agrees(original: list[Measurement], damaged: list[Measurement], is_cut: bool) -> bool:
    """Whether each array of the damaged copy is that of the original, or its beginning where the copy is cut."""
    names = [each.name for each in damaged]
    if len(set(names)) == len(names):  # columns may have another order
        damaged = sorted(damaged, key=lambda each: each.name)
        original = sorted((each for each in original if not is_cut or each.name in names), key=lambda each: each.name)
    for one, other in zip(original, damaged, strict=False):
        if set(one.data) != set(other.data) or one.kind != other.kind:
            return False
        for name, wanted in one.data.items():
            values = np.asarray(other.data[name])
            wanted = np.asarray(wanted)
            if is_cut and values.ndim and len(values) <= len(wanted):
                # sorted spectra may lose either end
                ends = [wanted[: len(values)], wanted[len(wanted) - len(values) :]]
            else:
                ends = [wanted]
            if not any(
                end.shape == values.shape and np.allclose(end, values, rtol=1e-9, atol=0, equal_nan=True)
                for end in ends if end.dtype.kind in "fiubc"
            ) and wanted.dtype.kind in "fiubc":  # fmt: skip
                return False
    return is_cut or len(original) == len(damaged)


def in_units_of(read: list[Measurement], original: list[Measurement], factor: float) -> bool:
    """Whether all wavelengths and heights are those of the original times a factor."""
    for one, other in zip(original, read, strict=True):
        for name in ("wavelength_nm", "height_um"):
            if name in one.data and not np.allclose(one.data[name] * factor, other.data.get(name, np.nan)):
                return False
    return True


def wrong(path: Path, damage: str, copies: int, folder: Path) -> list[str]:
    """Return the copies of a file that are read as something else without another sentence."""
    original = contents(path)
    data = path.read_bytes()
    found = []
    for number in range(copies):
        chance = random.Random(f"{path.name} {damage} {number}")
        suffix = chance.choice(SUFFIXES) if damage == "suffix" else path.suffix
        copy = folder / f"{path.stem.split('.')[0]}{suffix}"
        copy.write_bytes(DAMAGES[damage](data, chance))
        read = contents(copy)
        if read is None or (original is None and damage == "suffix"):
            continue
        if original is None:
            continue  # another cut of a refused file: nothing to compare
        if damage == "unit" and all(
            in_units_of(read, original, factor) for factor in (1.0, 1e3)[copy.read_bytes() != data :][:1]
        ):
            continue
        if not agrees(original, read, damage == "truncated") and sentences(read) <= sentences(original) - {CUT}:
            found.append(
                f"{path.name}: {damage} {number} {len(copy.read_bytes())} of {len(data)} bytes, {read[0].format}"
            )
    return found


@pytest.mark.parametrize("damage", list(DAMAGES))
def test_a_damaged_copy_is_never_another_measurement_in_silence(damage: str, tmp_path: Path) -> None:
    if not files():
        pytest.skip("../shared/reference/instruments is absent")
    assert [line for path in files()[::6] for line in wrong(path, damage, 2, tmp_path)] == []


@pytest.mark.full
@pytest.mark.parametrize("damage", list(DAMAGES))
def test_three_thousand_damaged_copies(damage: str, tmp_path: Path) -> None:
    if not files():
        pytest.skip("../shared/reference/instruments is absent")
    paths = files()
    copies = -(-COPIES // (len(paths) * len(DAMAGES)))
    assert [line for path in paths for line in wrong(path, damage, copies, tmp_path)] == []
