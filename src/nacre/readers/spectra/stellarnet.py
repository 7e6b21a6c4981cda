"""StellarNet SpectraWiz text (.SSM, .TRM, .ABS, .IRR): two lines that begin with a quotation mark, then nm and value.

The first line names the file, the second the view of SpectraWiz (`SCOPE->  Wave:632.47nm ...`). The suffixes are those
of the maker's list of files: SSM scope, TRM transmission, ABS absorbance, IRR irradiance.
"""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

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


def sniff(head: FileHead) -> float:
    """Return 1 if the first two lines begin with a quotation mark and name the file and the view."""
    lines = [line for line in head.lines[:6] if line.strip()]
    return CERTAIN if len(lines) > 1 and _FILE.match(lines[0]) and _VIEW.match(lines[1]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
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
