"""Zemax tabular BSDF files: scatter about the specular direction, monochrome or XYZ.

`AngleOfIncidence` is the angle of the specular ray; radial angles are counted from it, azimuth 0 points from it
towards the surface normal and grows counter-clockwise (Radiant's BSDF data interchange format). Files written
here are plane-symmetrical: azimuths 0 to 180 degrees, one sample rotation.
"""

from pathlib import Path

import numpy as np

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import atomic_path
from nacre.formats.export_formats import refuse_unsuitable
from nacre.light import spectrum_to_xyz
from nacre.readers.bsdf.ray_tracers import CHANNELS, ZemaxBsdf, scatter_direction


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
