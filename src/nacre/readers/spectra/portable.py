"""Text files of portable and small spectrometers: ASD, LI-COR, Spectra Vista, StellarNet, CRAIC."""

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

# ASD FieldSpec: ViewSpec text; the binary files are refused by name.

_BINARY = re.compile(rb"(ASD|as[2-8])\0*", re.DOTALL)


def sniff_asd_text(head: FileHead) -> float:
    """Return 1 for the prose of ViewSpec or the magic of the binary file."""
    if _BINARY.match(head.data) and not head.is_text:
        return CERTAIN
    prose = "\n".join(head.lines[:60])
    return CERTAIN if "ASD spectrum file" in prose or "Text conversion of header file" in prose else 0.0


def read_asd_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the columns below the heading `Wavelength  name.asd`; the values are factors.

    Raises:
        NacreError: a binary file, or a file of raw counts or radiance.
    """
    with path.open("rb") as file:
        if _BINARY.match(file.read(8)):
            raise NacreError(f"{path}: is a binary file of ASD; export text (ViewSpec Pro: Process, ASCII export)")
    text = common.read_text(path)
    found = [block for block in common.blocks(text.lines, least_columns=2) if len(block.table) > 20]
    if not found:
        raise NacreError(f"{path}: has no table of a spectrum")
    block = found[0]
    prose = [line for line in text.lines[: block.start] if line.strip()]
    names = [cell for cell in re.split(r"\t", prose[-1]) if cell.strip()] if prose else []
    words = " ".join(prose[:-1]).lower()
    metadata: dict[str, str] = {}
    for key, pattern in (("instrument", r"instrument number was\s+(\S+)"), ("date", r"Spectrum saved:\s*(.+)"),
                         ("white_reference", r"white reference (?:taken )?(.+)")):  # fmt: skip
        match = next((match for line in prose if (match := re.search(pattern, line, re.IGNORECASE))), None)
        if match:
            metadata[key] = match[1].strip()
    kind = re.search(r"spectrum file is (radiance|irradiance) data", words)
    is_raw = "white reference" not in words and bool(re.search(r"raw data|raw dn|radiance", words))
    spectra = []
    for column in range(1, block.table.shape[1]):
        notes = Notes()
        values = common.complete(path, block)[:, column]
        label = Label("counts", 1.0) if is_raw else Label("reflectance", 1.0)
        size = common.typical(block.table[:, 0], values)
        if kind is not None:
            label = Label("irradiance", 1.0)
            notes.assumed.append(f"{kind[1]}, as the preamble states")
        elif size > 20:
            label = Label("counts", 1.0)
            notes.assumed.append(f"counts, because the values are up to {size:.4g}")
        elif not is_raw:
            notes.assumed.append("reflectance as a factor, as ViewSpec exports it")
        name = names[column].strip() if column < len(names) else ""
        spectra.append(
            common.spectrum(
                path, "asd-text", block.table[:, 0], values, label, options, name=name, metadata=metadata, notes=notes
            )
        )
    return common.choose(path, spectra, options)


# LI-COR LI-1800 `.PRN`: quoted lines `FILE:`, `REM:`, `LIMS:`, `INT:`, then wavelength and a factor.


def sniff_licor_prn(head: FileHead) -> float:
    """Return 1 if the preamble has the keys FILE, LIMS and INT."""
    keys = {match[1] for line in head.lines[:12] if (match := re.match(r'\s*"?(FILE|REM|LIMS|INT|DATE)\s*:', line))}
    return CERTAIN if {"FILE", "LIMS", "INT"} <= keys else 0.0


def read_licor_prn(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns between the stated limits.

    Raises:
        NacreError: fewer points than the limits and the interval state.
        AmbiguousFileError: the remark names no quantity.
    """
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, found[0])
    metadata = {
        key.lower(): value.strip(' "') for key, value in common.key_values(text.lines[: found[0].start], ":").items()
    }
    limits = re.match(r"\s*([\d.]+)\s*-\s*([\d.]+)", metadata.get("lims", ""))
    interval = re.match(r"\s*([\d.]+)", metadata.get("int", ""))
    if limits and interval:
        count = round((float(limits[2]) - float(limits[1])) / float(interval[1])) + 1
        common.check_count(path, count, len(table), "LIMS with INT")
    label = common.option_label(path, options)
    notes = Notes()
    if label is None:
        named = next((label for word in metadata.get("rem", "").split() if (label := common.label_of(word))), None)
        if named is None or named.quantity not in ("reflectance", "transmittance", "absorptance"):
            size = common.typical(table[:, 0], table[:, 1])
            raise AmbiguousFileError(f"{path}: no quantity, values up to {size:.4g}", "quantity", common.QUANTITIES)
        label = Label(named.quantity, 1.0)
        notes.assumed.append(f'{named.quantity} as a factor, from the remark "{metadata["rem"]}"')
    return [
        common.spectrum(
            path, "licor-prn", table[:, 0], table[:, 1], label, options, name=metadata.get("file", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip


# Spectra Vista `.sig`: keys, `data=`, then wavelength, radiances of reference and target, their ratio in per cent.


def sniff_svc_sig(head: FileHead) -> float:
    """Return 1 for the first line of the format."""
    first = next((line for line in head.lines if line.strip()), "")
    return CERTAIN if "Spectra Vista SIG Data" in first else 0.0


def read_svc_sig(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the fourth column, target / reference.

    Raises:
        NacreError: no rows of four numbers after `data=`.
    """
    lines = common.read_text(path).lines
    begin = next((place for place, line in enumerate(lines) if line.strip().startswith("data=")), None)
    found = common.blocks(lines[begin + 1 :], least_columns=4) if begin is not None else []
    if not found or found[0].table.shape[1] != 4:
        raise NacreError(f"{path}: has no rows of wavelength, reference, target and ratio after data=")
    table = common.complete(path, found[0])
    metadata = common.key_values(lines[:begin], "=")
    notes = Notes(left_out=["the radiances of reference and target"])
    label = Label("reflectance", 0.01)
    return [
        common.spectrum(
            path, "svc-sig", table[:, 0], table[:, 3], label, options, name=metadata.get("name", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip


# StellarNet SpectraWiz text (.SSM, .TRM, .ABS, .IRR): two lines that begin with a quotation mark, then nm and value.
#
# The first line names the file, the second the view of SpectraWiz (`SCOPE->  Wave:632.47nm ...`). The suffixes are
# those of the maker's list of files: SSM scope, TRM transmission, ABS absorbance, IRR irradiance.

_FILE = re.compile(r'\s*"\s*File\s*:', re.IGNORECASE)
_VIEW = re.compile(r'\s*"\s*([A-Za-z][A-Za-z /%]*?)\s*-+>\s*Wave\s*:', re.IGNORECASE)
_KEY = re.compile(r"(Wave|Pix|Val|Time|Avg|Sm|Sg|Tc|Xt|Ch)\s*:\s*(\S+)")
_MEANINGS = {"Time": "integration_time", "Avg": "scans_averaged", "Sm": "smoothing", "Tc": "temperature_compensation",
             "Xt": "xtiming", "Ch": "channel"}  # fmt: skip
# the first letters of a view; transmission and reflection share one view of SpectraWiz
_VIEWS = (("scope", "counts"), ("abs", "absorbance"), ("trans", "transmittance"), ("refl", "reflectance"),
          ("irr", "irradiance"))  # fmt: skip
_SUFFIXES = {".ssm": "counts", ".trm": "transmittance", ".abs": "absorbance", ".irr": "irradiance"}
RATIOS = ("transmittance", "reflectance")


def sniff_stellarnet(head: FileHead) -> float:
    """Return 1 if the first two lines begin with a quotation mark and name the file and the view."""
    lines = [line for line in head.lines[:6] if line.strip()]
    return CERTAIN if len(lines) > 1 and _FILE.match(lines[0]) and _VIEW.match(lines[1]) else 0.0


def read_stellarnet(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the two columns; the view decides the quantity, and the suffix where the view is another.

    Raises:
        NacreError: no rows of two numbers.
        AmbiguousFileError: neither names a quantity, or they contradict each other.
    """
    lines = common.read_text(path).lines
    found = common.blocks(lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, found[0])
    if table.shape[1] != 2 or found[0].ragged:
        raise NacreError(f"{path}: its rows must have two numbers each; the file is damaged")
    head = [line for line in lines[: found[0].start] if line.strip()]
    matched = _VIEW.match(head[1]) if len(head) > 1 else None
    view = matched[1] if matched else ""
    notes = Notes()
    label = common.option_label(path, options) or _label(path, view, options, notes)
    metadata = {_MEANINGS[key]: value for key, value in _KEY.findall(" ".join(head[1:2])) if key in _MEANINGS}
    name = re.split(r"[\\/]", head[0].split(":", 1)[1].strip())[-1] if head and ":" in head[0] else ""
    metadata["view"] = view
    return [
        common.spectrum(
            path, "stellarnet", table[:, 0], table[:, 1], label, options, name=name, metadata=metadata, notes=notes
        )
    ]


def _label(path: Path, view: str, options: ReadOptions, notes: Notes) -> Label:
    of_view = next((quantity for word, quantity in _VIEWS if view.lower().startswith(word)), None)
    of_suffix = _SUFFIXES.get(path.suffix.lower())
    known = {quantity for quantity in (of_view, of_suffix) if quantity}
    if len(known - set(RATIOS)) > 1 or (len(known) > 1 and not known <= set(RATIOS)):
        raise common.undecided(path, f'its head names {of_view} ("{view}") and its suffix {of_suffix}', options)
    quantity = of_view or of_suffix
    if quantity is None:
        raise common.undecided(path, f'neither "{view}" nor the suffix is a known view of SpectraWiz', options)
    if quantity not in RATIOS:
        return Label(quantity, 1.0)
    if of_view != "reflectance" and options.assumed_quantity == "reflectance":
        notes.assumed.append("SpectraWiz has one view of transmission and reflection; a reflectance is taken")
        return Label("reflectance")
    if of_view != "reflectance":
        notes.assumed.append("SpectraWiz has one view of transmission and reflection; a transmittance is taken")
    return Label(quantity)


# CRAIC MicroSpec text: sample, quantity, settings, then wavelength and per cent of the reference.

_SETTINGS = re.compile(r"SciMode\s*:|\bIT1\s*=.*\bObj\s*=")


def sniff_craic_text(head: FileHead) -> float:
    """Return 1 if a quantity stands in the second line and the microscope's settings in the third."""
    lines = [line for line in head.lines[:8] if line.strip()]
    return CERTAIN if len(lines) > 3 and any(_SETTINGS.search(line) for line in lines[:4]) else 0.0


def read_craic_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns; MicroSpec writes reflectance and transmittance in per cent."""
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    head = [line.strip() for line in text.lines[: found[0].start] if line.strip()]
    label = next((label for line in head[1:3] if (label := common.label_of(line)) is not None), None)
    notes = Notes()
    nm, values = common.complete(path, found[0])[:, :2].T
    if label is None:
        label = common.by_size(path, nm, values, notes, "no quantity")
    elif label.quantity in ("reflectance", "transmittance"):
        label = Label(label.quantity, 0.01)
        notes.assumed.append(f"{label.quantity} in per cent, as the program writes it")
    settings = next((line for line in head if _SETTINGS.search(line)), "")
    metadata = {"settings": settings}
    return [
        common.spectrum(
            path, "craic-text", nm, values, label, options, name=head[0] if head else "", metadata=metadata, notes=notes
        )
    ]
