"""Ocean Optics `.ProcSpec`: a zip archive with one XML in a broken encoding."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.spectra.ocean import RATIO

MAX_XML_BYTES = 64 << 20
_MEMBER = re.compile(r"(?:^|/)ps_\d+\.xml$")
_DOUBLE = re.compile(r"<double>\s*([^<]*?)\s*</double>")


def sniff(head: FileHead) -> float:
    """Return 1 for a zip archive with a member `ps_N.xml`."""
    is_zip = head.data.startswith(b"PK\x03\x04")
    if not is_zip:
        return 0.0
    try:
        with zipfile.ZipFile(head.path) as archive:
            return CERTAIN if any(_MEMBER.search(name) for name in archive.namelist()) else 0.0
    except (zipfile.BadZipFile, OSError):
        return CERTAIN if re.search(rb"ps_\d+\.xml", head.data) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
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
