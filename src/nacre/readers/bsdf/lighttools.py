"""LightTools BSDF text: common scatter angles, then blocks by incidence, side, scatter type and channel.

Angles are polar angles from the normal and azimuths in degrees; the light of a file without incidence azimuths
comes from azimuth 90. Source: the reader of libbsdf (Kimura, MPL 2.0).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import axis, measurement, numbers, pairs_of, read_text, wavelengths_in_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

AXES = ("ScatterAzimuth", "ScatterRadial")
LIGHT_AZIMUTH = 90.0
TRISTIMULUS = {"trisx": 0, "trisy": 1, "trisz": 2}
ALLOWED = {"Side": ("front", "back"), "ScatterType": ("brdf", "btdf")}


@dataclass
class _Block:
    """Values `[azimuth, radial]` of one incidence and channel, and the words of its head."""

    head: dict[str, str] = field(default_factory=dict)
    values: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def series(self) -> tuple[str, str]:
        """Side and scatter type."""
        return self.head.get("Side", "front"), self.head.get("ScatterType", "brdf")


def sniff(head: FileHead) -> float:
    """Return 1 for the keys of a LightTools head with blocks of incidence, which Zemax' tables have not."""
    words = set(head.text[:16000].split())
    return CERTAIN if {*AXES, "AOI", "DataBegin"} <= words and "SampleRotation" not in words else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one measurement per side and scatter type.

    Raises:
        NacreError: the file is damaged, or blocks are missing.
    """
    text = re.sub(r"(?m)^\s*#.*$", "", read_text(path))
    words = iter(text.split())
    try:
        head, azimuth, radial = _head(words)
        blocks = _blocks(words, len(azimuth), len(radial))
    except (ValueError, IndexError, KeyError, StopIteration):
        raise NacreError(f"{path}: the LightTools file is damaged, or of a form that is not known") from None
    if not blocks:
        raise NacreError(f"{path}: holds no block of values")
    is_xyz = head.get("SpectralContent", "").lower() == "xyz"
    found = []
    for series in dict.fromkeys(block.series for block in blocks):
        some = [block for block in blocks if block.series == series]
        found.append(_one(path, series, some, (azimuth, radial), head, is_xyz))
    return found


def _head(words: Iterator[str]) -> tuple[dict[str, str], Array, Array]:
    head: dict[str, str] = {}
    axes: dict[str, Array] = {}
    for word in words:
        if word == "DataBegin":
            break
        if word in AXES:
            axes[word] = axis(words, int(next(words)))
        elif word in ("Symmetry", "SpectralContent", "Source"):
            head[word] = next(words)
    return head, axes[AXES[0]], axes[AXES[1]]


def _blocks(words: Iterator[str], rows: int, columns: int) -> list[_Block]:
    blocks: list[_Block] = []
    block = _Block()
    for word in words:
        if word == "DataEnd":
            return blocks
        value = next(words)
        if word == "TIS":
            block.values = numbers(words, rows * columns).reshape(rows, columns)
            block.head["TIS"] = value
            blocks.append(block)
            block = _Block()
        elif word in ("AOI", "POI", "Side", "Wavelength", "ScatterType", "TristimulusValue"):
            block.head[word] = value.lower()
            if word in ALLOWED and value.lower() not in ALLOWED[word]:
                raise ValueError(word)
        else:
            raise ValueError(word)
    raise ValueError("DataEnd is missing")


def _one(
    path: Path, series: tuple[str, str], blocks: list[_Block], axes: tuple[Array, Array], head: dict[str, str],
    is_xyz: bool,
) -> Measurement:  # fmt: skip
    """Return the measurement for one side and scatter type; channels are wavelengths or X, Y, Z."""
    side, scatter = series
    azimuth, radial = axes
    incidences = sorted({(float(b.head.get("AOI", 0)), float(b.head.get("POI", 0))) for b in blocks})
    channel = "TristimulusValue" if is_xyz else "Wavelength"
    names = sorted({b.head.get(channel, "") for b in blocks}, key=lambda name: (len(name), name))
    if is_xyz and set(names) != set(TRISTIMULUS):
        raise NacreError(f"{path}: holds {', '.join(names)[:60]}; XYZ needs TrisX, TrisY and TrisZ")
    place = TRISTIMULUS if is_xyz else {name: k for k, name in enumerate(sorted(names, key=lambda n: float(n or 0)))}
    values = np.full((len(incidences), len(azimuth), len(radial), len(place)), np.nan)
    for block in blocks:
        at = incidences.index((float(block.head.get("AOI", 0)), float(block.head.get("POI", 0))))
        values[at, ..., place[block.head.get(channel, "")]] = block.values
    if np.isnan(values).any():
        raise NacreError(f"{path}: a block of {scatter.upper()} of the {side} is missing, or a value is not a number")
    theta_i, phi_i = (np.array(column)[:, None, None] for column in zip(*incidences, strict=True))
    polar = 180.0 - radial if scatter == "btdf" else radial
    pairs = pairs_of(theta_i, phi_i, polar[None, None, :], (azimuth[None, :, None] - LIGHT_AZIMUTH + phi_i) % 360.0)
    waves: Array | None = None
    notes: tuple[str, ...] = ()
    if not is_xyz and all(names):
        waves, notes = wavelengths_in_nm(path, np.array(sorted(float(name) for name in names)), None)
    metadata = {"scatter": scatter, "side": side, "symmetry": head.get("Symmetry", ""),
                "tis": [float(b.head["TIS"]) for b in blocks]}  # fmt: skip
    assumed = ["the light comes from azimuth 90, as in LightTools files of isotropic surfaces", *notes]
    return measurement(path, "lighttools", pairs, waves, values.reshape(len(pairs), -1), metadata,
                       name=side, colour="xyz" if is_xyz else None, assumed=assumed)  # fmt: skip
