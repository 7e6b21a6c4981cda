"""Speos files as text: scattering surfaces (parameters) and measured BSDFs (`.brdf`, `.anisotropicbsdf`).

Scattering surfaces give, for each incidence and wavelength, reflected and transmitted shares in per cent: specular,
Lambertian, Gaussian, and the Gaussian's two full widths in degrees. Measured BSDFs have their mirror direction at
azimuth 0. BSDF180 holds two files, of the front and of the back; binary and encrypted files are refused.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import axis, measurement, numbers, pairs_of, read_bytes
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

ROWS = ("specular", "lambertian", "gaussian", "gaussian_fwhm_x", "gaussian_fwhm_y")
FIRST = "OPTIS - "


def sniff_speos(head: FileHead) -> float:
    """Recognise the first line."""
    line = head.data[:200].lstrip(b"\xef\xbb\xbf").decode("latin-1").split("\n")[0].lower()
    known = ("scattering", "brdf", "bsdf", "coated")
    return CERTAIN if line.startswith("optis") and any(word in line for word in known) else 0.0


def read_speos(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a text file of one of the kinds.

    Raises:
        NacreError: the file is binary, compressed, of another kind, or damaged.
    """
    data = read_bytes(path, 8.0)
    if b"\0" in data:
        raise NacreError(f"{path}: is a binary or encrypted Speos file; save it as text in the BSDF viewer")
    lines = data.decode("latin-1").splitlines()
    title = lines[0].lower()
    try:
        if "bsdf180" in title or "bsdf 180" in title:
            return _both_sides(path, lines)
        return [*_part(path, lines)]
    except (ValueError, IndexError, StopIteration):
        raise NacreError(f"{path}: the Speos file is damaged, or of a version that is not known") from None


def _part(path: Path, lines: list[str]) -> list[Measurement]:
    title = lines[0].lower()
    if "simple" in title and "scattering" in title:
        return [_simple(path, lines)]
    if "anisotropic" in title:
        return _anisotropic(path, lines)
    if "scattering" in title:
        return [_scattering(path, lines)]
    if "brdf" in title:
        return _measured(path, lines)
    raise NacreError(f'{path}: "{lines[0].strip()[:60]}" is a Speos file of a kind that is not read')


def _scattering(path: Path, lines: list[str]) -> Measurement:
    words = iter(" ".join(lines[2:]).split())
    incidences, waves = int(next(words)), int(next(words))
    wavelengths = axis(words, waves)
    theta, table = [], []
    for _ in range(incidences):
        theta.append(float(next(words)))
        table.append(numbers(words, len(ROWS) * waves * 2).reshape(len(ROWS), waves, 2))
    if next(words, None) is not None or np.any(np.diff(theta) <= 0):
        raise ValueError("more numbers than announced")
    return _model(path, "scattering", lines, np.array(theta), wavelengths, np.array(table))


def _simple(path: Path, lines: list[str]) -> Measurement:
    """Read the wavelength-independent form: rows of reflected and transmitted shares as in the full form."""
    found = [float(word) for word in " ".join(lines[2:]).split()]
    if len(found) != 2 * len(ROWS):
        raise NacreError(
            f"{path}: a simple scattering file holds {2 * len(ROWS)} numbers below its two lines; this has {len(found)}"
        )
    table = np.reshape(found, (1, len(ROWS), 1, 2))
    return _model(path, "simple_scattering", lines, np.zeros(1), None, table)


def _model(
    path: Path, form: str, lines: list[str], theta: Array, wavelengths: Array | None, table: Array
) -> Measurement:
    """Return the parameters as a table: one row per incidence and wavelength.

    Args:
        table: `[incidence, row, wavelength, (reflected, transmitted)]`, per cent and degrees.
    """
    waves = table.shape[2]
    data: dict[str, Array] = {"theta_i_deg": np.repeat(theta, waves)}
    if wavelengths is not None:
        data["wavelength_nm"] = np.tile(wavelengths, len(theta))
    for row, name in enumerate(ROWS):
        is_angle = name.startswith("gaussian_fwhm")
        for side, word in enumerate(("reflectance", "transmittance")):
            column = table[:, row, :, side].reshape(-1)
            key = f"{name}_{word}_deg" if is_angle else f"{name}_{word}"
            data[key] = column if is_angle else column / 100.0
    left = ("parameters of a model, not samples of a BSDF",)
    metadata = {"scatter": "model", "title": lines[0].strip(), "comment": lines[1].strip(),
                "incidences": len(theta), "wavelengths_nm": wavelengths}  # fmt: skip
    return Measurement(path, "speos", "bsdf", data, lines[1].strip(), metadata | {"form": form}, (), left)


def _head(lines: list[str]) -> tuple[list[str], str]:
    """Return the lines after mode, comment and measurement description, and the description."""
    if lines[1].strip() != "0":
        raise ValueError("binary")
    count, place, text = int(lines[3].split()[0]), 4, lines[4] if len(lines) > 4 else ""
    while len(text) < count and place + 1 < len(lines):
        place += 1
        text += "\n" + lines[place]
    return lines[place + 1 :], text


def _blocks(words: Iterator[str]) -> tuple[Array, Array, Array]:
    """Return theta, phi and values `[theta, phi]` of one table."""
    thetas, phis = int(next(words)), int(next(words))
    phi = axis(words, phis)
    rows = numbers(words, thetas * (phis + 1)).reshape(thetas, phis + 1)
    return rows[:, 0], phi, rows[:, 1:]


def _scaled(theta: Array, phi: Array, values: Array, percent: float, is_bsdf: bool) -> Array:
    """Return the BSDF whose hemispherical integral is the stated share.

    Values are proportional to the BSDF, or to the intensity (BSDF times cosine).
    """
    f = values if is_bsdf else _over_cosine(theta[:, None], values)
    total = hemispherical_share(theta, phi, f)
    return np.asarray(f * (percent / 100.0 / total)) if total > 0 else f


def _over_cosine(theta: Array, intensity: Array) -> Array:
    """Return the BSDF of an intensity; at grazing directions, where the cosine is 0, no finite BSDF follows: 0."""
    cosine = np.abs(np.cos(np.radians(theta)))
    return np.asarray(np.where(cosine > 1e-6, intensity / np.maximum(cosine, 1e-6), 0.0))


def hemispherical_share(theta_deg: Array, phi_deg: Array, f: Array) -> float:
    """Integrate f cos over a hemisphere by trapezia; azimuths from 0 to 180 degrees stand for both sides.

    Args:
        f: `[theta, phi]`, 1/sr.
    """
    from scipy.integrate import trapezoid

    angle = np.radians(theta_deg)
    order = np.argsort(angle)
    weight = np.abs(np.cos(angle)) * np.sin(angle)
    power = trapezoid((f * weight[:, None])[order], angle[order], axis=0)
    if len(phi_deg) == 1:
        return float(power[0] * 2 * np.pi)
    is_half = abs(phi_deg[-1] - 180.0) < 1e-6 and phi_deg[0] == 0
    return float(trapezoid(power, np.radians(phi_deg))) * (2.0 if is_half else 1.0)


def _measurement(
    path: Path, form: str, rotation: float, incidence: float, block: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Return direction pairs `[pair, 4]` (mirror at 180 degrees) and values `[pair]`."""
    theta, phi, values = block
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return pairs_of(np.full(t.shape, incidence), np.full(t.shape, rotation), t, (p + 180.0 + rotation) % 360.0), (
        values.reshape(-1)
    )


def _measured(path: Path, lines: list[str]) -> list[Measurement]:
    rest, text = _head(lines)
    words = iter(" ".join(rest).split())
    sides, is_bsdf = [int(next(words)), int(next(words))], int(next(words)) == 1
    count, waves = int(next(words)), int(next(words))
    incidence, wavelengths = axis(words, count), axis(words, waves)
    found = []
    for scatter, has in zip(("brdf", "btdf"), sides, strict=True):
        if not has:
            continue
        angles, values = [], []
        for at in incidence:
            columns = []
            for _ in range(waves):
                percent = float(next(words))
                theta, phi, table = _blocks(words)
                scaled = _scaled(theta, phi, table, percent, is_bsdf)
                columns.append(_measurement(path, "", 0.0, float(at), (theta, phi, scaled)))
            if any(not np.array_equal(c[0], columns[0][0]) for c in columns):
                raise ValueError("angles differ between wavelengths")
            angles.append(columns[0][0])
            values.append(np.stack([c[1] for c in columns], axis=-1))
        found.append(_made(path, "brdf", scatter, np.concatenate(angles), wavelengths, np.concatenate(values),
                           {"title": lines[0].strip(), "description": text}))  # fmt: skip
    return found


def _made(
    path: Path, form: str, scatter: str, angles: Array, waves: Array | None, values: Array, metadata: dict[str, Any]
) -> Measurement:
    assumed = ["values are scaled to the file's share of reflected or transmitted light"]
    return measurement(
        path, "speos", angles, waves, values, metadata | {"scatter": scatter, "form": form}, assumed=assumed
    )


def _anisotropic(path: Path, lines: list[str]) -> list[Measurement]:
    rest, text = _head(lines)
    words = iter(" ".join(rest).split())
    vector = numbers(words, 3)
    sides, is_bsdf = [int(next(words)), int(next(words))], int(next(words)) == 1
    grids: dict[str, list[tuple[float, Array]]] = {}
    for scatter, has in zip(("brdf", "btdf"), sides, strict=True):
        if has:
            rotations = axis(words, int(next(words)))
            grids[scatter] = [(float(turn), axis(words, int(next(words)))) for turn in rotations]
    spectra = {}
    for scatter in grids:
        at = numbers(words, 2)
        rows = numbers_after_text(words)
        spectra[scatter] = (at, rows)
    found = []
    for scatter, turns in grids.items():
        (_, spectrum), angles, values = spectra[scatter], [], []
        for turn, incidences in turns:
            for at in incidences:
                block = _blocks(words)
                pair, value = _measurement(path, "", turn, float(at), block)
                angles.append(pair)
                values.append(value)
        value = np.concatenate(values)
        theta = np.concatenate(angles)[:, 2]
        f = value if is_bsdf else _over_cosine(theta, value)
        share = spectrum[:, 1] / max(float(spectrum[:, 1].max()), 1e-300)
        metadata = {"title": lines[0].strip(), "description": text, "anisotropy_vector": vector,
                    "reference_spectrum_percent": spectrum[:, 1], "scatter": scatter}  # fmt: skip
        assumed = ["the file's spectrum at one direction, relative to its maximum, multiplies all directions"]
        found.append(measurement(path, "speos", np.concatenate(angles), spectrum[:, 0],
                                 f[:, None] * share, metadata, assumed=assumed))  # fmt: skip
    return found


def numbers_after_text(words: Iterator[str]) -> Array:
    """Return a spectrum `[row, 2]`: a description (words), the row count, then wavelength and per cent."""
    word = next(words)
    while not word.isdigit():
        word = next(words)
    return numbers(words, 2 * int(word)).reshape(-1, 2)


def _both_sides(path: Path, lines: list[str]) -> list[Measurement]:
    """Read a BSDF180: the text of the front's file, then that of the back's."""
    starts = [i for i, line in enumerate(lines) if i and line.strip().startswith(FIRST)]
    if len(starts) != 2:
        raise NacreError(f"{path}: the BSDF180 does not hold two text files; it names or compresses them")
    ends = [starts[1], len(lines)]
    found = []
    for side, start, end in zip(("front", "back"), starts, ends, strict=True):
        for part in _part(path, lines[start:end]):
            found.append(Measurement(part.path, "speos", part.kind, part.data, f"{side} {part.name}".strip(),
                                     dict(part.metadata) | {"side": side}, part.assumed, part.left_out))  # fmt: skip
    return found
