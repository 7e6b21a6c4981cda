"""Zemax tabular BSDF files: scatter about the specular direction, monochrome or XYZ.

`AngleOfIncidence` is the angle of the specular ray; radial angles are counted from it, azimuth 0 points from it
towards the surface normal and grows counter-clockwise (Radiant's BSDF data interchange format). For a BTDF the
specular ray is the directly transmitted one. The order of values is channel, sample rotation, incidence, azimuth,
radial angle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, angles_deg
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement as as_measurement
from nacre.readers.bsdf.samples import numbers, pairs_of, read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

CHANNELS = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
SYMMETRIES = ("planesymmetrical", "asymmetrical", "asymmetrical4d")
KEYS = ("Source", "Symmetry", "SpectralContent", "ScatterType")
AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")


@dataclass(frozen=True)
class ZemaxBsdf:
    """A tabular BSDF.

    Attributes:
        incidence_deg: `[incidence]`; azimuth_deg: `[azimuth]`; radial_deg: `[radial]`.
        values: `[channel, incidence, azimuth, radial]`, 1/sr; of the first sample rotation.
        tis: `[channel, incidence]`, total integrated scatter.
        scatter_type: "BRDF" or "BTDF".
        symmetry: as in the file.
        rotation_deg: `[rotation]`, sample rotations.
        rotated: `[channel, rotation, incidence, azimuth, radial]`, values of all rotations; None for one rotation.
    """

    incidence_deg: Array
    azimuth_deg: Array
    radial_deg: Array
    values: Array
    tis: Array
    scatter_type: str = "BRDF"
    symmetry: str = "PlaneSymmetrical"
    rotation_deg: Array = field(default_factory=lambda: np.zeros(1))
    rotated: Array | None = None

    @property
    def spectral_content(self) -> str:
        """ "Monochrome" for one channel, "XYZ" for three."""
        return "Monochrome" if len(self.values) == 1 else "XYZ"

    @property
    def is_plane_symmetrical(self) -> bool:
        """Whether the azimuths cover one side of the plane of incidence only."""
        return self.symmetry.lower() == SYMMETRIES[0] or float(self.azimuth_deg[-1]) <= 180.0


def scatter_direction(incidence_deg: Array, azimuth_deg: Array, radial_deg: Array) -> Array:
    """Return unit vectors `[..., 3]` for scatter angles about the mirror direction; the light comes from +x."""
    theta, phi, rho = np.radians(incidence_deg), np.radians(azimuth_deg), np.radians(radial_deg)
    specular = np.stack([-np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    to_normal = np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    across = np.stack([np.zeros_like(theta), -np.ones_like(theta), np.zeros_like(theta)], axis=-1)
    ring = np.cos(phi)[..., None] * to_normal + np.sin(phi)[..., None] * across
    return np.asarray(np.cos(rho)[..., None] * specular + np.sin(rho)[..., None] * ring)


def sniff(head: FileHead) -> float:
    """Recognise the four keys of the head."""
    words = [line.split()[0] for line in head.lines if line.strip() and not line.startswith("#")]
    return CERTAIN if [w.lower() for w in words[:4]] == [k.lower() for k in KEYS] else 0.0


def read_zemax(path: str | Path) -> ZemaxBsdf:
    """Read a tabular BSDF.

    Raises:
        NacreError: the file is invalid.
    """
    path = Path(path)
    lines = [line.strip() for line in read_text(path).splitlines()]
    words = iter([w for line in lines if line and not line.startswith("#") for w in line.split()])
    try:
        return _parse(words)
    except StopIteration:
        raise NacreError(f"{path}: Zemax tabular BSDF ends too early; it is cut") from None
    except (ValueError, KeyError, IndexError, MemoryError) as error:
        cause = str(error)[:100] or "damaged"
        raise NacreError(f"{path}: is not a whole Zemax tabular BSDF: {cause}") from None


def _parse(words: Iterator[str]) -> ZemaxBsdf:
    header = {name: _named(words, name) for name in KEYS}
    axes: dict[str, Array] = {}
    for name in AXES:
        count = int(_named(words, name))
        if not 1 <= count <= 100_000:
            raise ValueError(f"{name} has {count} angles")
        axes[name] = numbers(words, count)
        if np.any(np.diff(axes[name]) <= 0):
            raise ValueError(f"the angles of {name} do not ascend")
    content = _one_of(header, "SpectralContent", tuple(CHANNELS))
    _one_of(header, "Symmetry", SYMMETRIES)
    _one_of(header, "ScatterType", ("BRDF", "BTDF"))
    rotation, incidence, azimuth, radial = (axes[name] for name in AXES)
    shape = (len(CHANNELS[content]), len(rotation), len(incidence))
    values, tis = np.zeros((*shape, len(azimuth), len(radial))), np.zeros(shape)
    for channel in range(shape[0]):
        next(words)
        _named_only(words, "DataBegin")
        for place in np.ndindex(*shape[1:]):
            tis[channel][place] = float(_named(words, "TIS"))
            values[channel][place] = numbers(words, len(azimuth) * len(radial)).reshape(len(azimuth), len(radial))
        _named_only(words, "DataEnd")
    if not np.all(np.isfinite(values)):
        raise ValueError("values are not finite")
    return ZemaxBsdf(
        incidence, azimuth, radial, values[:, 0], tis[:, 0], header["ScatterType"].upper(), header["Symmetry"],
        rotation, values if len(rotation) > 1 else None,
    )  # fmt: skip


def _named(words: Iterator[str], name: str) -> str:
    _named_only(words, name)
    return next(words)


def _named_only(words: Iterator[str], name: str) -> None:
    word = next(words)
    if word.lower() != name.lower():
        raise ValueError(f'"{word[:20]}" stands in the place of {name}')


def _one_of(header: dict[str, str], key: str, allowed: tuple[str, ...]) -> str:
    found = next((name for name in allowed if name.lower() == header[key].lower()), None)
    if found is None:
        raise ValueError(f"{key} = {header[key][:30]}; allowed: {', '.join(allowed)}")
    return found


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all rotations; directions below the surface keep their place in the order, with theta_o above 90."""
    table = read_zemax(path)
    values = table.rotated if table.rotated is not None else table.values[:, None]
    rotation, incidence, azimuth, radial = np.meshgrid(
        table.rotation_deg, table.incidence_deg, table.azimuth_deg, table.radial_deg, indexing="ij"
    )
    out = angles_deg(scatter_direction(incidence, azimuth, radial))
    theta_o = 180.0 - out[..., 0] if table.scatter_type == "BTDF" else out[..., 0]
    angles = pairs_of(incidence, rotation, theta_o, (out[..., 1] + rotation) % 360.0)
    colour = "xyz" if len(values) == 3 else None
    first = float(table.incidence_deg[0])
    metadata = {
        "scatter": table.scatter_type.lower(), "symmetry": table.symmetry,
        "spectral_content": table.spectral_content, "tis": table.tis,
        "sample_rotation_deg": table.rotation_deg, "angle_of_incidence_deg": table.incidence_deg,
        "scatter_azimuth_deg": table.azimuth_deg, "scatter_radial_deg": table.radial_deg,
        "shape": values.shape[1:] if len(table.rotation_deg) > 1 else values.shape[2:],
    }  # fmt: skip
    assumed = [f"below {first:g} degrees nothing was measured"] if first > 0 else []
    assumed += [] if colour else ["the file names no wavelength; one value stands for all"]
    return [
        as_measurement(path, "zemax", angles, None, values.reshape(len(values), -1).T, metadata, colour=colour,
                       assumed=assumed)
    ]  # fmt: skip
