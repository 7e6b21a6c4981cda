"""Zemax tabular BSDF files: scatter about the specular direction, monochrome or XYZ.

`AngleOfIncidence` is the angle of the specular ray; radial angles are counted from it, azimuth 0 points from it
towards the surface normal and grows counter-clockwise (Radiant's BSDF data interchange format). Files written
here are plane-symmetrical: azimuths 0 to 180 degrees, one sample rotation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.formats.export_formats import refuse_unsuitable
from nacre.light import spectrum_to_xyz

CHANNELS = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
MAX_BYTES = 1 << 28


@dataclass(frozen=True)
class ZemaxBsdf:
    """A tabular BSDF.

    Attributes:
        incidence_deg: `[incidence]`; azimuth_deg: `[azimuth]`; radial_deg: `[radial]`.
        values: `[channel, incidence, azimuth, radial]`, 1/sr.
        tis: `[channel, incidence]`, total integrated scatter.
        scatter_type: "BRDF" or "BTDF".
    """

    incidence_deg: Array
    azimuth_deg: Array
    radial_deg: Array
    values: Array
    tis: Array
    scatter_type: str = "BRDF"

    @property
    def spectral_content(self) -> str:
        """ "Monochrome" for one channel, "XYZ" for three."""
        return "Monochrome" if len(self.values) == 1 else "XYZ"


def scatter_direction(incidence_deg: Array, azimuth_deg: Array, radial_deg: Array) -> Array:
    """Return unit vectors `[..., 3]` for scatter angles about the mirror direction; the light comes from +x."""
    theta, phi, rho = np.radians(incidence_deg), np.radians(azimuth_deg), np.radians(radial_deg)
    specular = np.stack([-np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    to_normal = np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    across = np.stack([np.zeros_like(theta), -np.ones_like(theta), np.zeros_like(theta)], axis=-1)
    ring = np.cos(phi)[..., None] * to_normal + np.sin(phi)[..., None] * across
    return np.asarray(np.cos(rho)[..., None] * specular + np.sin(rho)[..., None] * ring)


def zemax_table(bsdf: Bsdf, wavelength_nm: float | None = None, step_deg: float = 5.0) -> ZemaxBsdf:
    """Tabulate the reflected, non-delta part of a Bsdf.

    Args:
        wavelength_nm: one wavelength for a monochrome file; default: XYZ under D65.
        step_deg: step for incidence and azimuth; radial angles are finer near the specular direction.

    Raises:
        UnsupportedError: nothing but deltas, a stochastic lobe, or a wavelength outside the Bsdf's grid.
    """
    refuse_unsuitable(bsdf, "a Zemax table")
    incidence = np.arange(0.0, 85.0 + step_deg / 2, step_deg)
    azimuth = np.arange(0.0, 180.0 + step_deg / 2, step_deg)
    radial = np.concatenate([np.arange(0, 5, 0.5), np.arange(5, 20, 1), np.arange(20, 90, 2.5), np.arange(90, 176, 5)])
    i, a, r = np.meshgrid(incidence, azimuth, radial, indexing="ij")
    wo = scatter_direction(i, a, r)
    wi = np.broadcast_to(_light(i), wo.shape)
    up = wo[..., 2] > 1e-4
    f = bsdf.evaluate(wi[up], wo[up])
    if wavelength_nm is None:
        channels = np.asarray(spectrum_to_xyz(f, bsdf.wavelengths_nm))
    else:
        grid = bsdf.wavelengths_nm
        if not grid[0] <= wavelength_nm <= grid[-1]:
            raise UnsupportedError(f"wavelength {wavelength_nm:g} nm is outside {grid[0]:g} to {grid[-1]:g} nm")
        at = min(int(np.searchsorted(grid, wavelength_nm)), len(grid) - 1)
        share = 0.0 if at == 0 else (wavelength_nm - grid[at - 1]) / (grid[at] - grid[at - 1])
        channels = (f[:, at - 1] * (1 - share) + f[:, at] * share if at else f[:, 0])[:, None]
    values = np.zeros((channels.shape[1], *up.shape))
    values[:, up] = channels.T
    return ZemaxBsdf(incidence, azimuth, radial, values, _total(values, wo[..., 2], azimuth, radial))


def _light(incidence_deg: Array) -> Array:
    theta = np.radians(incidence_deg)
    return np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)


def _total(values: Array, cos_o: Array, azimuth_deg: Array, radial_deg: Array) -> Array:
    """Integrate f cos over half the azimuths and double it."""
    from scipy.integrate import trapezoid

    rho = np.radians(radial_deg)
    rings = trapezoid(values * np.maximum(cos_o, 0.0) * np.sin(rho), rho, axis=-1)
    return np.asarray(2 * trapezoid(rings, np.radians(azimuth_deg), axis=-1))


def write_zemax(path: str | Path, table: ZemaxBsdf, comment: str = "") -> None:
    """Write the table as text, atomically.

    Raises:
        NacreError: the file cannot be written.
    """
    with atomic_path(path) as temporary, open(temporary, "w", encoding="ascii", errors="replace") as file:
        for line in comment.splitlines():
            file.write(f"# {line}\n")
        file.write(f"Source  Measured\nSymmetry  PlaneSymmetrical\nSpectralContent  {table.spectral_content}\n")
        file.write(f"ScatterType  {table.scatter_type}\nSampleRotation  1\n0\n")
        for name, angles in (
            ("AngleOfIncidence", table.incidence_deg),
            ("ScatterAzimuth", table.azimuth_deg),
            ("ScatterRadial", table.radial_deg),
        ):
            file.write(f"{name}  {len(angles)}\n" + "\t".join(f"{a:g}" for a in angles) + "\n")
        for channel, name in enumerate(CHANNELS[table.spectral_content]):
            file.write(f"\n{name}\nDataBegin\n")
            for i in range(len(table.incidence_deg)):
                file.write(f"TIS {table.tis[channel, i]:.6g}\n")
                for row in table.values[channel, i]:
                    file.write("\t".join(f"{v:.7e}" for v in row) + "\n")
            file.write("DataEnd\n")


def read_zemax(path: str | Path) -> ZemaxBsdf:
    """Read a tabular BSDF with one sample rotation.

    Raises:
        NacreError: the file is invalid.
    """
    path = Path(path)
    try:
        if plain(path).stat().st_size > MAX_BYTES:
            raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
        lines = [line.strip() for line in path.read_text(encoding="latin-1").splitlines()]
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    words = iter([w for line in lines if line and not line.startswith("#") for w in line.split()])
    try:
        return _parse(words)
    except (StopIteration, ValueError, KeyError, IndexError, MemoryError):
        raise NacreError(f"{path}: is not a Zemax tabular BSDF, or is damaged") from None


def _parse(words: Iterator[str]) -> ZemaxBsdf:
    header: dict[str, str] = {}
    axes: dict[str, Array] = {}
    for name in ("Source", "Symmetry", "SpectralContent", "ScatterType"):
        header[name] = _named(words, name)
    for name in ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"):
        count = int(_named(words, name))
        if not 1 <= count <= 100_000:
            raise ValueError(name)
        axes[name] = np.array([float(next(words)) for _ in range(count)])
    if len(axes["SampleRotation"]) != 1:
        raise ValueError("only one sample rotation is read")
    incidence, azimuth, radial = (axes[n] for n in ("AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"))
    names = CHANNELS[header["SpectralContent"]]
    values = np.zeros((len(names), len(incidence), len(azimuth), len(radial)))
    tis = np.zeros((len(names), len(incidence)))
    for channel in range(len(names)):
        next(words)
        if next(words) != "DataBegin":
            raise ValueError("DataBegin")
        for i in range(len(incidence)):
            tis[channel, i] = float(_named(words, "TIS"))
            flat = [float(next(words)) for _ in range(len(azimuth) * len(radial))]
            values[channel, i] = np.reshape(flat, (len(azimuth), len(radial)))
        if next(words) != "DataEnd":
            raise ValueError("DataEnd")
    if not np.all(np.isfinite(values)):
        raise ValueError("not finite")
    return ZemaxBsdf(incidence, azimuth, radial, values, tis, header["ScatterType"])


def _named(words: Iterator[str], name: str) -> str:
    if next(words) != name:
        raise ValueError(name)
    return next(words)
