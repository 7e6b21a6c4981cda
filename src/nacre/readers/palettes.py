"""Colours of swatches and palettes, CxF/X-3, and spectra of lamps."""

from __future__ import annotations

import colorsys
import re
import struct
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from nacre.core.errors import NacreError
from nacre.light import hex_to_srgb, lch_to_lab, xyy_to_xyz
from nacre.readers.colour_tables import SRGB, colours, illuminant_in, observer_in, spectra_scale
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes, read_lines

# Palettes of sRGB: GIMP `.gpl`, LibreOffice `.soc`, JASC-PAL, and lists of hexadecimal colours.

_ROW = re.compile(r"\s*(\d{1,3})\s+(\d{1,3})\s+(\d{1,3})(?:\s+(.*\S))?\s*$")
_ALPHA = re.compile(r"\s*(\d{1,3}\s+\d{1,3}\s+\d{1,3})\s+(\d{1,3})(?=\s|$)")
_HEX = re.compile(
    r"\s*(?:(?P<name>[^#;,\t]*?)[\s,;:\t]+)?(?P<mark>#|0x)?(?P<hex>[0-9A-Fa-f]{6}|[0-9A-Fa-f]{8})(?:[\s,;:]+(?P<after>\S.*))?\s*$"
)
LONGEST = 300  # characters of a line
_SOC = re.compile(r"<draw:color\b([^>]*)/?>")
_ATTRIBUTE = re.compile(r'draw:(name|color)\s*=\s*"([^"]*)"')


def sniff_palette(head: FileHead) -> float:
    """Return 1 for the first lines of .gpl and JASC-PAL and the elements of .soc, 0.6 for hexadecimal lines."""
    first = head.text.lstrip()[:20]
    if first.startswith(("GIMP Palette", "JASC-PAL")) or "<draw:color " in head.text:
        return CERTAIN
    lines = [line for line in head.lines[:200] if line.strip() and not _is_remark(line)]
    if not head.is_text or not lines or head.size > 1 << 22 or max(map(len, lines)) > LONGEST:
        return 0.0  # the search for a name is cubic in a line's blanks
    complete_lines = lines[:-1] if head.size > len(head.data) else lines
    matches = [_HEX.fullmatch(line) for line in complete_lines]
    is_hex = all(matches) and any(match["mark"] or re.search("[A-Fa-f]", match["hex"]) for match in matches if match)
    return LIKELY if is_hex else 0.0


def read_palette(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the colours and their names.

    Raises:
        NacreError: a line is not a colour, or a number is above 255.
    """
    lines = read_lines(path)
    joined = "\n".join(lines)
    name = ""
    if "<draw:color " in joined:
        swatches = [_hex_entry(path, dict(_ATTRIBUTE.findall(entry))) for entry in _SOC.findall(joined)]
        format_id = "soc"
    elif joined.lstrip().startswith(("GIMP Palette", "JASC-PAL")):
        swatches, name = _rows(path, lines)
        format_id = "gpl"
    else:
        lines = [line for line in lines if line.strip() and not _is_remark(line)]
        matches = [_HEX.fullmatch(line) if len(line) <= LONGEST else None for line in lines]
        if not all(matches):
            bad = next(line for line, match in zip(lines, matches, strict=True) if not match)
            raise NacreError(f'{path}: "{bad.strip()[:40]}" is not a hexadecimal colour')
        # Paint.NET writes AARRGGBB
        fields = [match.groupdict("") for match in matches if match]
        swatches = [(hex_to_srgb(each["hex"][-6:]), (each["name"] or each["after"]).strip()) for each in fields]
        format_id = "hex"
    names = [own or str(place) for place, (_, own) in enumerate(swatches, start=1)]
    srgb = [rgb for rgb, _ in swatches]
    return [colours(path, names, {"srgb": srgb}, name=name, metadata={"form": format_id}, assumed=[SRGB])]


def _is_remark(line: str) -> bool:
    text = line.strip()
    return text.startswith((";", "//")) or (text.startswith("#") and not re.match(r"#[0-9A-Fa-f]{6}", text))


def _rows(path: Path, lines: list[str]) -> tuple[list[tuple[list[float], str]], str]:
    """Return the colours of .gpl or JASC-PAL (version, count, then rows) and the palette's name."""
    swatches: list[tuple[list[float], str]] = []
    name, stated = "", None
    has_alpha = any(re.match(r"\s*Channels\s*:\s*RGBA\s*$", line) for line in lines[:20])  # Aseprite
    is_jasc = lines[0].strip().startswith("JASC-PAL")
    for number, line in enumerate(lines):
        text = line.strip()
        if is_jasc and number in (1, 2):
            stated = int(text) if number == 2 else stated
            continue
        if not text or number == 0 or text.startswith("#") or re.match(r"(Name|Columns|Channels)\s*:", text):
            name = text.partition(":")[2].strip() if text.startswith("Name") else name
            continue
        match = _ROW.match(_ALPHA.sub(r"\1 ", line) if has_alpha else line)
        if match is None or any(int(match[place]) > 255 for place in (1, 2, 3)):
            raise NacreError(
                f'{path}: line {number + 1}: "{text[:40]}" is not a colour: red, green, blue (0 to 255), name'
            )
        swatches.append(([int(match[place]) / 255.0 for place in (1, 2, 3)], match[4] or ""))
    if stated is not None and stated != len(swatches):
        raise NacreError(f"{path}: states {stated} colours, and {len(swatches)} are there; the file is cut")
    return swatches, name


def _hex_entry(path: Path, attributes: dict[str, str]) -> tuple[list[float], str]:
    value = attributes.get("color", "").lstrip("#")
    if not re.fullmatch("[0-9A-Fa-f]{6}", value):
        raise NacreError(f'{path}: draw:color = "{value}" is not a hexadecimal colour')
    return hex_to_srgb(value), unescape(attributes.get("name", ""))


# Adobe swatches: `.ase` (Swatch Exchange) and `.aco` (Photoshop).

Swatch = tuple[str, str, list[float]]  # name, space ("srgb", "lab" or that of Adobe), values
ASE_MAGIC = b"ASEF"
_ASE_COLOUR, _ASE_GROUP = 0x0001, 0xC001
_ASE_COUNTS = {b"RGB ": 3, b"LAB ": 3, b"CMYK": 4, b"Gray": 1}
_ACO_RGB, _ACO_HSB, _ACO_CMYK, _ACO_LAB, _ACO_GREY = 0, 1, 2, 7, 8
_ACO_SPACES = {_ACO_CMYK: "CMYK", 3: "Pantone", 4: "Focoltone", 5: "Trumatch", 6: "Toyo", 10: "HKS"}
_UNMANAGED = ("srgb", "lab")


def sniff_ase(head: FileHead) -> float:
    """Return 1 for the magic of .ase, or for the head of .aco with the size that its colour count states."""
    if head.data.startswith(ASE_MAGIC):
        return CERTAIN
    if len(head.data) < 14:
        return 0.0
    version, count = struct.unpack_from(">HH", head.data)
    spaces = {struct.unpack_from(">H", head.data, 4 + 10 * place)[0] for place in range(min(count, 20))
              if 6 + 10 * place <= len(head.data)}  # fmt: skip
    end = 4 + 10 * count  # of the first part
    if version != 1 or count == 0 or end > head.size or not spaces <= set(range(16)):
        return 0.0
    has_second = end + 4 <= len(head.data) and struct.unpack_from(">H", head.data, end)[0] == 2
    return CERTAIN if has_second or end == head.size else 0.0


def read_ase(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the swatches once, those of RGB and grey as sRGB, those of Lab as L*a*b* (D50); CMYK is left out."""
    data = path.read_bytes()
    is_ase = data.startswith(ASE_MAGIC)
    swatches = _ase(data) if is_ase else _aco(data)
    others = [f"{name} ({space})" for name, space, _ in swatches if space not in _UNMANAGED]
    left_out = [f"{len(others)} swatches without a colour of a surface: {', '.join(others)[:200]}"] if others else []
    lists = []
    for space in _UNMANAGED:
        names = [name for name, own, _ in swatches if own == space]
        table = [values for _, own, values in swatches if own == space]
        if names and space == "srgb":
            lists.append(colours(path, names, {"srgb": table}, name=space, left_out=left_out, assumed=[SRGB]))
        elif names:
            lab = dict(zip("Lab", zip(*table, strict=True), strict=True))
            lists.append(colours(path, names, lab, name=space, left_out=left_out))
    if not lists:
        raise NacreError(f"{path}: holds no colour of a surface; {left_out[0] if left_out else 'no swatches'}")
    return lists


def _ase(data: bytes) -> list[Swatch]:
    """Return the swatches of .ase: big-endian blocks of type, length, name (UTF-16), space and floats; L is 0 to 1."""
    (count,) = struct.unpack_from(">I", data, 8)
    at, swatches = 12, []
    for _ in range(count):
        kind, size = struct.unpack_from(">HI", data, at)
        body = data[at + 6 : at + 6 + size]
        if len(body) < size:
            raise ValueError("a block ends behind the file")
        at += 6 + size
        if kind != _ASE_COLOUR:
            continue
        (letters,) = struct.unpack_from(">H", body)
        name = body[2 : 2 + 2 * letters].decode("utf-16-be").rstrip("\0")
        space = body[2 + 2 * letters : 6 + 2 * letters]
        values = list(struct.unpack_from(f">{_ASE_COUNTS[space]}f", body, 6 + 2 * letters))
        swatches.append(_swatch(name, space.decode().strip(), values))
    return swatches


def _swatch(name: str, space: str, values: list[float]) -> Swatch:
    if space == "RGB":
        return name, "srgb", values
    if space == "Gray":
        return name, "srgb", values * 3
    if space == "LAB":
        return name, "lab", [100.0 * values[0], values[1], values[2]]
    return name, space, values


def _aco(data: bytes) -> list[Swatch]:
    """Return the swatches of .aco: of version 2 with names if there, else of version 1."""
    (count,) = struct.unpack_from(">H", data, 2)
    first = [_aco_colour(data, 4 + 10 * place, str(place + 1)) for place in range(count)]
    at = 4 + 10 * count
    if at + 4 > len(data):
        return first
    version, count = struct.unpack_from(">HH", data, at)
    if version != 2:
        raise ValueError("the second part is not version 2")
    at += 4
    swatches = []
    for _ in range(count):
        (letters,) = struct.unpack_from(">I", data, at + 10)
        raw = data[at + 14 : at + 14 + 2 * letters]
        if len(raw) < 2 * letters:
            raise ValueError("a name ends behind the file")
        swatches.append(_aco_colour(data, at, raw.decode("utf-16-be").rstrip("\0")))
        at += 14 + 2 * letters
    return swatches


def _aco_colour(data: bytes, at: int, name: str) -> Swatch:
    """Return a colour of five 16-bit words: space and four values."""
    space, *words = struct.unpack_from(">5H", data, at)
    unit = [word / 65535.0 for word in words]
    if space == _ACO_RGB:
        return name, "srgb", unit[:3]
    if space == _ACO_HSB:
        return name, "srgb", list(colorsys.hsv_to_rgb(*unit[:3]))
    if space == _ACO_LAB:
        signed = [word - 65536 if word > 32767 else word for word in words]
        return name, "lab", [words[0] / 100.0, signed[1] / 100.0, signed[2] / 100.0]
    if space == _ACO_GREY:
        return name, "srgb", [words[0] / 10000.0] * 3
    return name, _ACO_SPACES.get(space, f"space {space}"), unit


# CxF/X-3 (ISO 17972-1): L*a*b*, XYZ, sRGB and reflectance spectra of objects, with their specifications.

CXF3 = "CxF3-core"
USUAL_GRIDS = {36: 380.0, 31: 400.0}  # value count -> first wavelength, nm, of X-Rite's instruments
MAX_BYTES = 256 << 20


@dataclass(frozen=True)
class Specification:
    """Illuminant, observer and wavelengths of a ColorSpecification."""

    illuminant: str | None = None
    observer: str | None = None
    start_nm: float = 0.0  # 0: not stated
    step_nm: float = 0.0


def sniff_cxf(head: FileHead) -> float:
    """Return 1 for XML with an element CxF."""
    start = head.text[:2000]
    return CERTAIN if "<" in start and ("CxF>" in start or ":CxF" in start or "<CxF" in start) else 0.0


def read_cxf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the objects, grouped by content: names, colours and spectra under one specification.

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
    groups: dict[
        tuple[Specification, tuple[float, ...], tuple[str, ...]], list[tuple[str, dict[str, list[float]]]]
    ] = {}
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
    key: tuple[Specification, tuple[float, ...], tuple[str, ...]],
    entries: list[tuple[str, dict[str, list[float]]]],
    skipped: list[str],
    states_grid: bool,
) -> Measurement:
    specification, grid, kinds = key
    table = {kind: np.array([values[kind] for _, values in entries]) for kind in kinds}
    data: dict[str, np.ndarray] = {}
    for kind, names in (("lab", "Lab"), ("xyz", "XYZ")):
        if kind in table:
            data |= dict(zip(names, table[kind].T))
    if "srgb" in table:
        data["srgb"] = table["srgb"]
    assumed = [SRGB] if kinds == ("srgb",) else []
    if "spectra" in table:
        data["wavelength_nm"] = np.asarray(grid)
        data["spectra"] = table["spectra"] * spectra_scale(table["spectra"], assumed)
        if not states_grid:
            assumed.append("wavelengths in steps of 10 nm by the number of values; the file states no increment")
    return colours(
        path, [name for name, _ in entries], data, illuminant=specification.illuminant,
        observer=specification.observer, assumed=assumed, left_out=skipped
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
            if kind == "ColorCIELab":
                name, numbers = "lab", [parts[letter] for letter in "LAB"]
            elif kind == "ColorCIELCh":
                if parts["C"] < 0:
                    raise NacreError(f"{path}: C = {parts['C']:g} is a negative chroma; allowed: 0 or more")
                name, numbers = "lab", lch_to_lab([parts[letter] for letter in "LCH"]).tolist()
            elif kind == "ColorCIEXYZ":
                name, numbers = "xyz", [parts[letter] for letter in "XYZ"]
            elif kind == "ColorCIExyY":
                name, numbers = "xyz", xyy_to_xyz([parts[letter] for letter in "xyY"]).tolist()
            elif kind == "ColorSRGB":
                largest = float(colour.get("MaxRange", "255"))
                name, numbers = "srgb", [parts[letter] / largest for letter in "RGB"]
            elif kind == "ReflectanceSpectrum":
                name, numbers = "spectra", [float(word) for word in (colour.text or "").split()]
                grid = _grid(path, colour, specification, len(numbers))
            else:
                left_out[kind] = left_out.get(kind, 0) + 1
                continue
            values.setdefault(name, numbers)
            if kind != "ColorSRGB" and (specification.illuminant or light == Specification()):
                light = Specification(specification.illuminant, specification.observer)
    return values, light, grid


def _grid(path: Path, node: Xml.Element, specification: Specification, count: int) -> tuple[float, ...]:
    start = float(node.get("StartWL") or specification.start_nm)
    step = float(node.get("Increment") or specification.step_nm)
    usual = USUAL_GRIDS.get(count, 0.0)
    if step <= 0 and usual and start in (0.0, usual):  # X-Rite's .mxf states neither
        start, step = usual, 10.0
    if start <= 0 or step <= 0:
        raise NacreError(f"{path}: a reflectance spectrum without start or increment of its wavelengths")
    return tuple(start + step * place for place in range(count))


def _specification(node: Xml.Element) -> Specification:
    texts = {_local(child): (child.text or "").strip() for child in node.iter()}
    ranges = [child.attrib for child in node.iter() if _local(child) == "WavelengthRange"] or [{}]
    start, step = (float(ranges[0].get(key) or 0.0) for key in ("StartWL", "Increment"))
    illuminant, observer = illuminant_in(texts.get("Illuminant", "")), observer_in(texts.get("Observer", ""))
    return Specification(illuminant, observer, start, step)


def _local(node: Xml.Element) -> str:
    return str(node.tag).rpartition("}")[2]


# Spectra of lamps: IES TM-27 `.spdx`, UPRtek and Sekonic text.

_LAMP_ROW = re.compile(r'\s*"?(?:Spectral Data )?(\d{3,4})\s*(?:\[?nm\]?)"?\s*[\t,;]\s*"?([-+\d.eE]+)"?')
_MAKERS = re.compile(r"MK350|UPRtek|Model Name|Sekonic|Illuminance|CCT", re.IGNORECASE)
_QUANTITIES = {"r-factor": "reflectance", "t-factor": "transmittance"}
_QUANTITIES |= {name: name for name in ("reflectance", "transmittance", "absorptance")}
LAMP = "the spectrum of a lamp: an illuminant, no reflectance"


def sniff_lamp(head: FileHead) -> float:
    """Return 1 for the element IESTM2714, or for rows `380nm` below the keys of a spectrometer of lamps."""
    if "IESTM2714" in head.text[:3000]:
        return CERTAIN
    rows = sum(bool(_LAMP_ROW.match(line)) for line in head.lines)
    return CERTAIN if rows >= 20 and _MAKERS.search(head.text) else 0.0


def read_lamp(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read wavelengths and relative power (`irradiance`), or the quantity that TM-27 states."""
    data = path.read_bytes()
    if b"IESTM2714" in data[:3000]:
        return [_tm27(path, data, options)]
    lines = common.read_lines(path)
    matches = [match for line in lines if (match := _LAMP_ROW.match(line))]
    metadata = common.key_values([line for line in lines if not _LAMP_ROW.match(line)], "\t,;")
    nm, values = ([float(match[place]) for match in matches] for place in (1, 2))
    return [_lamp(path, nm, values, metadata, options)]


def _lamp(
    path: Path, nm: list[float], values: list[float], metadata: dict[str, str], options: ReadOptions
) -> Measurement:
    notes = Notes(assumed=[LAMP])
    label = Label("irradiance", 1.0)
    return common.spectrum(path, nm, values, label, options, metadata=metadata, notes=notes)


def _tm27(path: Path, data: bytes, options: ReadOptions) -> Measurement:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise NacreError(f"{path}: declares entities, which TM-27 does not have")
    root = Xml.fromstring(data)
    nodes = {_local(node): (node.text or "").strip() for node in root.iter()}
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
    return common.spectrum(path, nm, values, Label(quantity, 1.0), options, metadata=metadata)
