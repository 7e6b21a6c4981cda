"""Spectral libraries: USGS (splib07) and ASTER or ECOSTRESS."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

# USGS spectral library 7 (splib07, Kokaly et al. 2017, USGS Data Series 1035): ASCII files of one column.
#
# A spectrum is a title line, such as ` splib07a Record=5932: Kaolinite CM5  BECKb AREF`, and one value a line. Its
# wavelengths, um, stand in a file of the same form beside it, or in the folder above:
# `splib07a_Wavelengths_BECK_Beckman_0.2-3.0_microns.txt`. Deleted channels hold -1.23e34.

DELETED = -1e30  # at most; the library writes -1.23e34
MOST = 2.0  # typical reflectance; the library holds factors
MAX_BYTES = 4 << 20  # of a file of wavelengths; the longest has 4,280 rows
_TITLE = re.compile(r"\s*(splib07\w*|s07_\w+)\s+Record\s*=\s*(\d+)\s*:\s*(.*?)\s*$", re.IGNORECASE)
_KINDS = {"AREF": "absolute reflectance", "RREF": "relative reflectance", "RTGC": "ground-calibrated reflectance",
          "TRAN": "transmittance"}  # fmt: skip
_OTHER = re.compile(r"wavelength|bandpass|fwhm|error ?bar", re.IGNORECASE)
WAY_OUT = (
    'put the library\'s file, such as "splib07a_Wavelengths_ASD_0.35-2.5_microns_2151_ch.txt", beside it, or name it '
    "with --wavelengths"
)


@dataclass(frozen=True)
class Page:
    """One file of the library."""

    path: Path
    library: str
    record: str
    title: str
    values: Array

    @property
    def instrument(self) -> str:
        """Spectrometer and purity code, the last word but one of the title, such as BECKb."""
        words = self.title.split()
        return words[-2] if len(words) > 1 else ""


def sniff_usgs_splib(head: FileHead) -> float:
    """Return 1 for a title of the library."""
    return CERTAIN if head.lines and _TITLE.match(head.lines[0]) else 0.0


def read_usgs_splib(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a spectrum with the wavelengths beside it, or those that the options name.

    Raises:
        NacreError: a file of wavelengths, bandwidths or errors, no wavelengths, or another number of them.
        AmbiguousFileError: a measurement type that names no quantity.
    """
    page = _page(path)
    if _OTHER.search(page.title):
        raise NacreError(
            f'{path}: holds "{page.title[:60]}" of the USGS library and no spectrum; read a spectrum beside it'
        )
    kind = page.title.split()[-1].upper() if page.title else ""
    notes = Notes()
    um, source = _given(page, options.wavelengths) if options.wavelengths else _beside(page)
    label = common.option_label(path, options) or _label(path, kind, options)
    kept = page.values > DELETED
    if not kept.all():
        notes.left_out.append(f"{int((~kept).sum())} deleted channels")
    if kept.sum() < 2:
        raise NacreError(f"{path}: all but {int(kept.sum())} of its channels are deleted")
    typical = common.typical(um[kept] * 1e3, page.values[kept])
    if label.factor == 1.0 and label.quantity in ("reflectance", "transmittance") and typical > MOST:
        raise NacreError(f"{path}: holds values up to {typical:.4g}; the library holds factors. The file is changed")
    notes.assumed.append(f"the wavelengths are those of {source.name}")
    name = " ".join(page.title.split()[:-2])
    metadata = {"library": page.library, "record": page.record, "instrument": page.instrument,
                "measurement": _KINDS.get(kind, kind), "wavelengths": source.name}  # fmt: skip
    return [
        common.spectrum(
            path, "usgs-splib", um[kept], page.values[kept], label, options, unit="um", name=name, metadata=metadata,
            notes=notes,
        )
    ]  # fmt: skip


def _label(path: Path, kind: str, options: ReadOptions) -> Label:
    if kind not in _KINDS:
        raise common.undecided(path, f'the measurement type "{kind}" names no quantity', options)
    return Label("transmittance" if kind == "TRAN" else "reflectance", 1.0)


def _page(path: Path) -> Page:
    """Read a title and one number a line.

    Raises:
        NacreError: no title, or a line that is not one number.
    """
    lines = common.read_text(path).lines
    match = _TITLE.match(lines[0]) if lines else None
    if match is None:
        raise NacreError(f"{path}: its first line is no title of the USGS library")
    values: list[float] = []
    for place, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        value = common.number(line)
        if value is None:
            raise NacreError(f'{path}: line {place} holds "{line.strip()[:40]}" where one number should stand')
        values.append(value)
    if len(values) < 2:
        raise NacreError(f"{path}: has {len(values)} values; at least 2 are needed")
    return Page(path, match[1], match[2], match[3], np.array(values))


def _beside(page: Page) -> tuple[Array, Path]:
    """Return the wavelengths, um, of the file beside a spectrum or above its folder that belongs to it, and the file.

    A file belongs to a spectrum of the same library with as many channels; in the measured library (splib07) also of
    the same spectrometer.

    Raises:
        NacreError: no such file, or several of unlike wavelengths.
    """
    fitting, lengths = [], []
    for other in _wavelength_files(page):
        if len(other.values) == len(page.values):
            fitting.append(other)
        else:
            lengths.append(f"{other.path.name} has {len(other.values)}")
    if not fitting:
        said = f"; {', '.join(lengths)[:160]}" if lengths else ""
        raise NacreError(
            f"{page.path}: holds {len(page.values)} values and no wavelengths, which stand in a separate file of the "
            f"USGS library{said}; {WAY_OUT}"
        )
    if any(not np.array_equal(other.values, fitting[0].values) for other in fitting):
        names = ", ".join(other.path.name for other in fitting)
        raise NacreError(f"{page.path}: several files of wavelengths fit ({names[:200]}); name one with --wavelengths")
    return _um(fitting[0]), fitting[0].path


def _wavelength_files(page: Page) -> Iterator[Page]:
    """Yield the files of wavelengths of a spectrum's library and spectrometer beside it and in the folder above."""
    folder = page.path.absolute().parent
    for place in dict.fromkeys((folder, folder.parent)):
        try:
            paths = sorted(one for one in place.iterdir() if "wavelength" in one.name.lower())
        except OSError:
            continue
        for path in paths:
            try:
                if not path.is_file() or path.stat().st_size > MAX_BYTES:
                    continue
                other = _page(path)
            except (NacreError, OSError):
                continue
            is_same = other.library.lower() == page.library.lower() and "wavelength" in other.title.lower()
            of_spectrometer = page.instrument[:3].lower() in f"{path.stem} {other.title}".lower()
            if is_same and (of_spectrometer or not page.library.lower().startswith("splib")):
                yield other


def _given(page: Page, name: str) -> tuple[Array, Path]:
    """Return the wavelengths, um, of a file that the options name.

    Raises:
        NacreError: unreadable, no title of the library, or another number of channels.
    """
    from nacre.readers.registry import head_of

    path = head_of(name).path
    other = _page(path)
    if len(other.values) != len(page.values):
        raise NacreError(
            f"{page.path}: holds {len(page.values)} values, and {path.name} has {len(other.values)} wavelengths; name "
            "the file of its spectrometer"
        )
    return _um(other), path


def _um(page: Page) -> Array:
    """Return wavelengths in um.

    Raises:
        NacreError: numbers that are no wavelengths in um: not above 0, or above 300 (the library ends at 216).
    """
    if not (np.isfinite(page.values).all() and page.values.min() > 0 and page.values.max() <= 300):
        raise NacreError(f"{page.path}: does not hold wavelengths in um")
    return page.values


# ASTER and ECOSTRESS spectral libraries: text whose preamble states `X Units:` and `Y Units:`.

_KEY = re.compile(r"\s*([XY])\s*Units\s*:\s*(.+)", re.IGNORECASE)


def sniff_aster(head: FileHead) -> float:
    """Return 1 if lines `X Units:` and `Y Units:` precede the numbers."""
    keys = {match[1].upper() for line in head.lines[:120] if (match := _KEY.match(line))}
    return CERTAIN if keys == {"X", "Y"} else 0.0


def read_aster(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the stated units."""
    text = common.read_text(path)
    units = {match[1].upper(): match[2].strip() for line in text.lines[:200] if (match := _KEY.match(line))}
    last = max(place for place, line in enumerate(text.lines[:200]) if _KEY.match(line))
    found = common.blocks(text.lines[last + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, max(found, key=lambda block: len(block.table)))
    metadata = common.key_values(text.lines[:last], ":")
    stated = next(
        (value for key, value in metadata.items() if key.lower() in ("number of x values", "number of points")), None
    )
    common.check_count(path, stated, len(table), "the preamble")
    notes = Notes()
    unit = common.option_unit(path, options) or common.unit_named(units["X"])
    if unit is None:
        raise NacreError(f'{path}: X Units = "{units["X"]}" is no unit of a spectrum')
    nm = common.nanometres(table[:, 0], unit)
    label = common.named_quantity(path, options, units["Y"], nm, table[:, 1], notes)
    return [
        common.spectrum(
            path, "aster", table[:, 0], table[:, 1], label, options, unit=unit, name=metadata.get("Name", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip
