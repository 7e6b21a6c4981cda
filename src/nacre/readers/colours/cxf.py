"""CxF/X-3 (ISO 17972-1): L*a*b*, XYZ, sRGB and reflectance spectra of objects, with their specifications."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from nacre.core.errors import NacreError
from nacre.light import lch_to_lab, xyy_to_xyz
from nacre.readers.colours.lab import SRGB, colours, illuminant_in, observer_in, spectra_scale
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

CXF3 = "CxF3-core"
USUAL_GRIDS = {36: 380.0, 31: 400.0}  # value count -> first wavelength, nm, of X-Rite's instruments
MAX_BYTES = 256 << 20


@dataclass(frozen=True)
class Specification:
    """Illuminant, observer and wavelengths of a ColorSpecification."""

    illuminant: str | None = None
    observer: str | None = None
    start_nm: float | None = None
    step_nm: float | None = None


def sniff_cxf(head: FileHead) -> float:
    """Return 1 for XML with an element CxF."""
    start = head.text[:2000]
    return CERTAIN if "<" in start and ("CxF>" in start or ":CxF" in start or "<CxF" in start) else 0.0


def read_cxf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the objects, grouped by what they hold: names, colours and spectra under one specification.

    Raises:
        NacreError: an older version of CxF, or no colour of a surface.
    """
    data = path.read_bytes()
    if len(data) > MAX_BYTES:
        raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise NacreError(f"{path}: declares entities, which CxF does not have")
    root = Xml.fromstring(data)
    if CXF3 not in root.tag:
        raise NacreError(f"{path}: is not of version 3 of CxF; export CxF/X-3 or CGATS")
    specifications = {
        node.get("Id", ""): _specification(node) for node in root.iter() if _local(node) == "ColorSpecification"
    }
    groups: dict[tuple[object, ...], list[tuple[str, dict[str, list[float]]]]] = {}
    left_out: dict[str, int] = {}
    for node in root.iter():
        if _local(node) != "Object":
            continue
        values, light, grid = _values(path, node, specifications, left_out)
        if values:
            key = (light, grid, tuple(sorted(values)))
            groups.setdefault(key, []).append((node.get("Name", ""), values))
    skipped = [f"{count} x {kind}" for kind, count in left_out.items()]
    if not groups:
        raise NacreError(
            f"{path}: CxF without L*a*b*, XYZ, sRGB or reflectance; it holds {', '.join(skipped) or 'no colours'}"
        )
    states_grid = b"Increment" in data
    return [_measurement(path, key, entries, skipped, states_grid) for key, entries in groups.items()]


def _measurement(
    path: Path,
    key: tuple[object, ...],
    entries: list[tuple[str, dict[str, list[float]]]],
    skipped: list[str],
    states_grid: bool,
) -> Measurement:
    specification, grid, kinds = key
    assert isinstance(specification, Specification)
    table = {kind: np.array([values[kind] for _, values in entries]) for _, kind in enumerate(sorted(entries[0][1]))}
    data: dict[str, np.ndarray] = {}
    for kind, names in (("lab", "Lab"), ("xyz", "XYZ")):
        if kind in table:
            data |= {name: table[kind][:, place] for place, name in enumerate(names)}
    if "srgb" in table:
        data["srgb"] = table["srgb"]
    if "spectra" in table:
        data["wavelength_nm"] = np.asarray(grid)
    assumed = [SRGB] if kinds == ("srgb",) else []
    if "spectra" in table:
        data["spectra"] = table["spectra"] * spectra_scale(table["spectra"], assumed)
        if not states_grid:
            assumed.append("wavelengths in steps of 10 nm by the number of values; the file states no increment")
    return colours(
        path, "cxf", [name for name, _ in entries], data, illuminant=specification.illuminant,
        observer=specification.observer, assumed=assumed, left_out=skipped,
    )  # fmt: skip


def _values(
    path: Path, node: Xml.Element, specifications: dict[str, Specification], left_out: dict[str, int]
) -> tuple[dict[str, list[float]], Specification, tuple[float, ...]]:
    """Return an object's colours by kind, their specification and the wavelengths of its spectrum."""
    values: dict[str, list[float]] = {}
    light = Specification()
    grid: tuple[float, ...] = ()
    for parent in node.iter():
        if _local(parent) not in ("ColorValues", "DeviceColorValues"):
            continue
        for colour in parent:
            kind = _local(colour)
            specification = specifications.get(colour.get("ColorSpecification", ""), Specification())
            parts = {_local(child): float(child.text or "nan") for child in colour if (child.text or "").strip()}
            found: list[float] | None = None
            if kind == "ColorCIELab":
                name, found = "lab", [parts["L"], parts["A"], parts["B"]]
            elif kind == "ColorCIELCh":
                if parts["C"] < 0:
                    raise NacreError(f"{path}: C = {parts['C']:g} is a negative chroma; allowed: 0 or more")
                name, found = "lab", lch_to_lab([parts["L"], parts["C"], parts["H"]]).tolist()
            elif kind == "ColorCIEXYZ":
                name, found = "xyz", [parts["X"], parts["Y"], parts["Z"]]
            elif kind == "ColorCIExyY":
                name, found = "xyz", xyy_to_xyz([parts["x"], parts["y"], parts["Y"]]).tolist()
            elif kind == "ColorSRGB":
                largest = float(colour.get("MaxRange", "255"))
                name, found = "srgb", [parts[letter] / largest for letter in "RGB"]
            elif kind == "ReflectanceSpectrum":
                name, found = "spectra", [float(word) for word in (colour.text or "").split()]
                grid = _grid(path, colour, specification, len(found))
            if found is None:
                left_out[kind] = left_out.get(kind, 0) + 1
                continue
            values.setdefault(name, found)
            if kind != "ColorSRGB" and (specification.illuminant or light == Specification()):
                light = Specification(specification.illuminant, specification.observer)
    return values, light, grid


def _grid(path: Path, node: Xml.Element, specification: Specification, count: int) -> tuple[float, ...]:
    start = float(node.get("StartWL") or specification.start_nm or 0.0)
    step = float(node.get("Increment") or specification.step_nm or 0.0)
    usual = USUAL_GRIDS.get(count, 0.0)
    if step <= 0 and usual and start in (0.0, usual):  # X-Rite's .mxf states neither
        start, step = usual, 10.0
    if start <= 0 or step <= 0:
        raise NacreError(f"{path}: a reflectance spectrum without start or increment of its wavelengths")
    return tuple(start + step * place for place in range(count))


def _specification(node: Xml.Element) -> Specification:
    texts = {_local(child): (child.text or "").strip() for child in node.iter()}
    ranges = [child for child in node.iter() if _local(child) == "WavelengthRange"]
    start, step = (
        (float(ranges[0].get(key) or 0.0) or None for key in ("StartWL", "Increment")) if ranges else (None, None)
    )
    return Specification(
        illuminant_in(texts.get("Illuminant", "")), observer_in(texts.get("Observer", "")), start, step
    )


def _local(node: Xml.Element) -> str:
    return str(node.tag).rpartition("}")[2]
