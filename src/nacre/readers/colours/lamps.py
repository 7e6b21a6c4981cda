"""Spectra of lamps: IES TM-27 `.spdx`, UPRtek and Sekonic text."""

import re
from pathlib import Path
from xml.etree import ElementTree as Xml

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_ROW = re.compile(r'\s*"?(?:Spectral Data )?(\d{3,4})\s*(?:\[?nm\]?)"?\s*[\t,;]\s*"?([-+\d.eE]+)"?')
_MAKERS = re.compile(r"MK350|UPRtek|Model Name|Sekonic|Illuminance|CCT", re.IGNORECASE)
_QUANTITIES = {
    "reflectance": "reflectance", "r-factor": "reflectance", "transmittance": "transmittance",
    "t-factor": "transmittance", "absorptance": "absorptance",
}  # fmt: skip
LAMP = "the spectrum of a lamp: an illuminant, no reflectance"


def sniff_lamp(head: FileHead) -> float:
    """Return 1 for the element IESTM2714, or for rows `380nm` below the keys of a spectrometer of lamps."""
    if "IESTM2714" in head.text[:3000]:
        return CERTAIN
    rows = sum(bool(_ROW.match(line)) for line in head.lines)
    return CERTAIN if rows >= 20 and _MAKERS.search(head.text) else 0.0


def read_lamp(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read wavelengths and relative power (`irradiance`), or the quantity that TM-27 states."""
    data = path.read_bytes()
    if b"IESTM2714" in data[:3000]:
        return [_tm27(path, data, options)]
    text = common.read_text(path)
    pairs = [match.groups() for line in text.lines if (match := _ROW.match(line))]
    metadata = common.key_values([line for line in text.lines if not _ROW.match(line)], "\t,;")
    return [_lamp(path, [float(nm) for nm, _ in pairs], [float(value) for _, value in pairs], metadata, options)]


def _lamp(
    path: Path, nm: list[float], values: list[float], metadata: dict[str, str], options: ReadOptions
) -> Measurement:
    notes = Notes(assumed=[LAMP])
    label = Label("irradiance", 1.0)
    return common.spectrum(path, "lamp", nm, values, label, options, metadata=metadata, notes=notes)


def _tm27(path: Path, data: bytes, options: ReadOptions) -> Measurement:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise NacreError(f"{path}: declares entities, which TM-27 does not have")
    root = Xml.fromstring(data)
    nodes = {str(node.tag).rpartition("}")[2]: (node.text or "").strip() for node in root.iter()}
    rows = [node for node in root.iter() if str(node.tag).endswith("SpectralData")]
    nm = [float(node.get("wavelength") or "nan") for node in rows]
    values = [float(node.text or "nan") for node in rows]
    keys = ("Manufacturer", "CatalogNumber", "Description", "Laboratory", "ReportNumber", "ReflectionGeometry")
    metadata = {key.lower(): nodes[key] for key in keys if nodes.get(key)}
    stated = nodes.get("SpectralQuantity", "")
    metadata["spectral_quantity"] = stated
    quantity = _QUANTITIES.get(stated.lower())
    if quantity is None:
        return _lamp(path, nm, values, metadata, options)
    return common.spectrum(path, "lamp", nm, values, Label(quantity, 1.0), options, metadata=metadata)
