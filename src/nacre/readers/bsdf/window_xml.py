"""BSDF matrices of WINDOW and Radiance (`<WindowElement>` XML) in a basis of patches such as Klems'.

A block gives a matrix, a row for each outgoing and a column for each incident patch, in 1/sr. Directions are those of
the patches' centres, with azimuths as the basis counts them.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement, pairs_of, read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead


@dataclass(frozen=True)
class Basis:
    """Centres of a basis' patches in degrees, each `[patch]`."""

    theta: Array
    phi: Array


def sniff(head: FileHead) -> float:
    """Recognise the root element, which a line of a log may precede."""
    return CERTAIN if b"<WindowElement" in head.data else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read every block of every wavelength range.

    Raises:
        NacreError: not valid XML, a basis of another kind (tensor trees), or a matrix that does not fit its basis.
    """
    text = read_text(path)
    text = text[max(text.find("<?xml"), 0) :]
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise NacreError(f"{path}: holds a document type declaration, which this format does not use")
    try:
        # the default namespace differs between versions
        root = ET.fromstring(re.sub(r'\sxmlns="[^"]*"', "", text, count=1))
    except ET.ParseError:
        raise NacreError(f"{path}: is not valid XML, or is damaged") from None
    bases = {_text(node, "AngleBasisName"): _basis(path, node) for node in root.iter("AngleBasis")}
    structure = next((node.text or "" for node in root.iter("IncidentDataStructure")), "Columns").strip()
    if structure not in ("Columns", "Rows") or not bases:
        raise NacreError(
            f"{path}: IncidentDataStructure = {structure or 'none'} is not a matrix of patches; "
            "convert a tensor tree by Radiance's bsdf2klems"
        )
    name = next((node.text or "" for node in root.iter("Name")), "").strip()
    found = []
    for data in root.iter("WavelengthData"):
        label = _text(data, "Wavelength")
        for block in data.iter("WavelengthDataBlock"):
            found.append(_block(path, name, label, block, bases, structure == "Columns"))
    if not found:
        raise NacreError(f"{path}: holds no block of scattering data")
    return found


def _text(node: ET.Element, name: str) -> str:
    return (node.findtext(name) or "").strip()


def _basis(path: Path, node: ET.Element) -> Basis:
    theta, phi = [], []
    try:
        for ring in node.iter("AngleBasisBlock"):
            low, high = (float(ring.findtext(f"ThetaBounds/{end}Theta") or "") for end in ("Lower", "Upper"))
            count = int(ring.findtext("nPhis") or "")
            theta += [0.0 if count == 1 and low == 0 else 0.5 * (low + high)] * count
            phi += [360.0 * k / count for k in range(count)]
    except ValueError:
        raise NacreError(f"{path}: an angle basis is incomplete") from None
    return Basis(np.array(theta), np.array(phi))


def _block(
    path: Path, name: str, label: str, block: ET.Element, bases: dict[str, Basis], has_columns: bool
) -> Measurement:
    side = _text(block, "WavelengthDataDirection")
    try:
        columns, rows = (bases[_text(block, f"{end}AngleBasis")] for end in ("Column", "Row"))
        words = re.split(r"[,\s]+", _text(block, "ScatteringData").strip(", \n"))
        matrix = np.array([float(word) for word in words]).reshape(len(rows.theta), len(columns.theta))
    except (KeyError, ValueError):
        raise NacreError(f"{path}: block {label} {side} does not fit its angle basis") from None
    incident, out = (columns, rows) if has_columns else (rows, columns)
    values = matrix if has_columns else matrix.T
    is_through = "transmission" in side.lower()
    theta_o = 180.0 - out.theta if is_through else out.theta
    angles = pairs_of(incident.theta[None], incident.phi[None], theta_o[:, None], out.phi[:, None])
    metadata = {"scatter": "btdf" if is_through else "brdf", "direction": side, "wavelength_range": label,
                "shape": values.shape}  # fmt: skip
    assumed = ["azimuths of incident and outgoing patches are as the basis counts them",
               f"the values are means over the range {label or 'of the file'}"]  # fmt: skip
    return measurement(path, "window_xml", angles, None, values.reshape(-1, 1), metadata,
                       name=f"{name} {label} {side}".strip(), assumed=assumed)  # fmt: skip
