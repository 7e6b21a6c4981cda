"""Ocean Optics: text of OOIBase32, SpectraSuite, OceanView and Jaz, and ProcSpec archives."""

import re
import zipfile
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

# Ocean Optics and Ocean Insight text: OOIBase32, SpectraSuite, OceanView and Jaz, in any language of the program.

_MARK = re.compile(r">>>>>.*<<<<<")
_PIXELS = re.compile(r"pixel", re.IGNORECASE)
_NO = re.compile(
    r"(dark|reference|oscur\w+|referenc\w+|dunkel\w*|referenz\w*|noir\w*|r[ée]f[ée]rence).*:\s*(no|nein|non)\b",
    re.IGNORECASE,
)
JAZ = {"W": "wavelength_nm", "D": "dark", "R": "reference", "S": "sample", "P": "processed"}
_VIEW = re.compile(r"\s*Data from (.*?)(?:\.txt)? Node", re.IGNORECASE)
# words of the view of OceanView that a file was saved from, as in "Data from Absorbance_10-12-30.txt Node"
VIEWS = {
    "absorbance": Label("absorbance", 1.0), "reflection": Label("reflectance"), "reflectance": Label("reflectance"),
    "transmission": Label("transmittance"), "transmittance": Label("transmittance"),
    "relative": Label("irradiance", 1.0), "relativeirradiance": Label("irradiance", 1.0),
    "subt": Label("counts", 1.0), "quickview": Label("counts", 1.0),
}  # fmt: skip
RATIO = (
    'the processed values are the ratio to the reference and were read as reflectance; quantity = "transmittance" '
    "states otherwise"
)


def sniff_ocean_text(head: FileHead) -> float:
    """Return 1 if a line `>>>>>Begin ...<<<<<` in any language precedes numbers."""
    for place, line in enumerate(head.lines):
        if _MARK.match(line.strip()):
            after = [text for text in head.lines[place + 1 : place + 6] if text.strip()]
            return CERTAIN if any(common.numeric_row(text, common.delimiter(text)) for text in after) else 0.0
    return 0.0


def read_ocean_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the columns after the mark: wavelength and processed values, or those of Jaz (W D R S P)."""
    text = common.read_text(path)
    lines = text.lines
    marks = [place for place, line in enumerate(lines) if _MARK.match(line.strip())]
    begin = marks[0]
    found = common.blocks(lines[begin + 1 : marks[1] if len(marks) > 1 else None], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers after {lines[begin].strip()}")
    table = max(found, key=lambda block: len(block.table))
    common.complete(path, table)
    preamble = lines[:begin]
    metadata = common.key_values(preamble, ":")
    notes = Notes()
    if len(found) > 1:
        notes.left_out.append(f"{len(found) - 1} further tables")
    stated = next((value for key, value in metadata.items() if _PIXELS.search(key)), "")
    if stated.isdigit() and int(stated) != len(table.table):
        notes.assumed.append(f"the preamble states {stated} pixels; all {len(table.table)} rows were read")
    letters = lines[begin + 1 + table.start - 1].split() if table.start > 0 else []
    if letters and set(letters) <= set(JAZ) and len(letters) == table.table.shape[1]:
        columns = {JAZ[letter]: table.table[:, place] for place, letter in enumerate(letters)}
    else:
        columns = {"wavelength_nm": table.table[:, 0], "processed": table.table[:, -1]}
        if table.table.shape[1] > 2:
            raise NacreError(f"{path}: has {table.table.shape[1]} columns without a heading; 2 are expected")
    return [_measurement(path, columns, "\n".join(preamble), metadata, notes, options)]


def _measurement(
    path: Path,
    columns: dict[str, np.ndarray],
    preamble: str,
    metadata: dict[str, str],
    notes: Notes,
    options: ReadOptions,
) -> Measurement:
    nm = columns["wavelength_nm"]
    values = columns.get("processed", columns.get("sample"))
    if values is None:
        raise NacreError(f"{path}: has neither a processed spectrum nor counts of a sample")
    label = common.option_label(path, options) or _label(path, preamble, nm, values, "processed" in columns, notes)
    parts = ("sample", "dark", "reference")
    if label.quantity in ("reflectance", "transmittance") and all(part in columns for part in parts):
        expected = common.ratio(*(columns[part] for part in parts)) / (label.factor or 1.0)
        visible = (nm > 450) & (nm < 650) & np.isfinite(expected)
        if visible.any() and np.median(np.abs(values - expected)[visible]) > 0.05 * np.median(np.abs(values[visible])):
            notes.assumed.append("the processed column differs from (sample - dark) / (reference - dark); it was read")
    more = {f"{part}_counts": columns[part] for part in parts if part in columns and label.quantity != "counts"}
    return common.spectrum(
        path, "ocean-text", nm, values, label, options, metadata=metadata, notes=notes,
        more=more if "processed" in columns else None,
    )  # fmt: skip


def _view(preamble: str) -> Label | None:
    """Return the quantity of the view of OceanView that the first line names, or None."""
    match = _VIEW.match(preamble)
    words = re.split(r"[^a-z]+", match[1].lower()) if match else []
    return next((label for word, label in VIEWS.items() if word in words), None)


def _label(path: Path, preamble: str, nm: np.ndarray, values: np.ndarray, is_processed: bool, notes: Notes) -> Label:
    """Return the quantity of the processed values from the preamble, the mode's name or the size of the values."""
    if "irradiance" in preamble.lower():
        return Label("irradiance", 1.0)
    if not is_processed or len(_NO.findall(preamble)) >= 2:
        return Label("counts", 1.0)
    view = _view(preamble)
    if view is not None:
        notes.assumed.append(f"{view.quantity}, because the name of the view in the first line says so")
        if view.factor is not None:
            return view
    mode = next((label for word in path.name.split(".")[1:] if (label := common.label_of(word))), None)
    if mode is not None and mode.quantity in ("absorbance", "irradiance", "counts"):
        return mode
    size = common.typical(nm, values)
    if size > 1000:
        notes.assumed.append(f"counts, because the values are up to {size:.4g}")
        return Label("counts", 1.0)
    if view is not None:
        return common.by_size(path, nm, values, notes, f"{view.quantity} without a unit", likely=view.quantity)
    if size < 1.5:
        choices = ("reflectance (%)", *common.QUANTITIES)
        raise AmbiguousFileError(f"{path}: no quantity, and values up to {size:.3g}", "quantity", choices)
    notes.assumed.append(RATIO)
    return Label("reflectance", 0.01)


# Ocean Optics `.ProcSpec`: a zip archive with one XML in a broken encoding.

MAX_XML_BYTES = 64 << 20
_MEMBER = re.compile(r"(?:^|/)ps_\d+\.xml$")
_DOUBLE = re.compile(r"<double>\s*([^<]*?)\s*</double>")


def sniff_ocean_procspec(head: FileHead) -> float:
    """Return 1 for a zip archive with a member `ps_N.xml`."""
    is_zip = head.data.startswith(b"PK\x03\x04")
    if not is_zip:
        return 0.0
    try:
        with zipfile.ZipFile(head.path) as archive:
            return CERTAIN if any(_MEMBER.search(name) for name in archive.namelist()) else 0.0
    except (zipfile.BadZipFile, OSError):
        return CERTAIN if re.search(rb"ps_\d+\.xml", head.data) else 0.0


def read_ocean_procspec(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the processed spectrum in per cent; without one, compute it from the counts."""
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if _MEMBER.search(name)]
        if archive.getinfo(names[0]).file_size > MAX_XML_BYTES:
            raise NacreError(f"{path}: its {names[0]} is larger than {MAX_XML_BYTES >> 20} MiB")
        xml = archive.read(names[0]).decode("ascii", errors="ignore")
    notes = Notes(left_out=[f"{name}: a further spectrum" for name in names[1:]])
    nm = _numbers(xml, "channelWavelengths")
    values = _numbers(xml, "processedPixels")
    reference, dark = _inside(xml, "referenceSpectrum"), _inside(xml, "darkSpectrum")
    outside = xml.replace(reference, "").replace(dark, "") if reference or dark else xml
    parts = [_numbers(piece, "pixelValues") for piece in (outside, dark, reference)]
    if nm is None:
        raise NacreError(f"{path}: has no wavelengths (channelWavelengths)")
    if values is None or not len(values):
        if any(part is None for part in parts):
            raise NacreError(f"{path}: has neither processed values nor the counts of sample, dark and reference")
        values = 100.0 * common.ratio(*(part for part in parts if part is not None))
        notes.assumed.append("reflectance = (sample - dark) / (reference - dark)")
    if len(values) != len(nm):
        raise NacreError(f"{path}: has {len(nm)} wavelengths and {len(values)} values")
    label = common.option_label(path, options)
    if label is None:
        size = common.typical(nm, values)
        label = Label("counts", 1.0) if size > 1000 else Label("reflectance", 0.01)
        notes.assumed.append(
            RATIO if label.quantity == "reflectance" else f"counts, because values are up to {size:.4g}"
        )
    keys = ("spectrometerSerialNumber", "userName", "integrationTime", "scansToAverage", "boxcarWidth")
    metadata = {key: found[1] for key in keys if (found := re.search(rf"<{key}>([^<]*)</{key}>", xml))}
    return [common.spectrum(path, "ocean-procspec", nm, values, label, options, metadata=metadata, notes=notes)]


def _inside(xml: str, tag: str) -> str:
    found = re.search(rf"<{tag}\b[^>]*>.*?</{tag}>", xml, re.DOTALL)
    return found[0] if found else ""


def _numbers(xml: str, tag: str) -> Array | None:
    inside = _inside(xml, tag)
    return np.array([float(text) for text in _DOUBLE.findall(inside)]) if inside else None
