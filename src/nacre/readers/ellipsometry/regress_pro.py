"""Text of in-line tools and of regress-pro: rows after `SE`.

`SE PSI DELTA` with a line `AOI 75.7`: the numbers are tan Psi and cos Delta. `SE ALPHA BETA` with a line `A 33`:
Fourier coefficients of a rotating element with the other one at that azimuth: alpha = (t^2 - a^2) / (t^2 + a^2) and
beta = 2 t a cos Delta / (t^2 + a^2), with t = tan Psi and a = tan A.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, numbers, same_length, text_lines, to_nm, within
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAX_DEGREES = 5.0  # cos Delta stays within -1 .. 1; Delta in degrees does not


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    words = head.lines[0].upper().split() if head.lines else []
    return CERTAIN if words in (["SE", "PSI", "DELTA"], ["SE", "ALPHA", "BETA"]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return tan Psi and cos Delta with Psi and Delta; the Delta sign is unknown.

    Raises:
        NacreError: rows that are not three numbers, or impossible values.
        AmbiguousFileError: a missing angle or azimuth.
    """
    lines = text_lines(path)
    is_fourier = "ALPHA" in lines[0].upper()
    stated: dict[str, float] = {}
    rows = []
    for number, line in enumerate(lines[1:], 2):
        words = line.split()
        if not words:
            continue
        text = words[1].replace(",", ".") if len(words) == 2 else " ".join(words[1:])
        values = numbers(text)
        if values is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
        if words[0].upper() == "SE":
            rows.append((number, values))
        else:
            stated[words[0].upper()] = values[0]
    table = same_length(path, rows)
    if table.shape[1] != 3:
        raise NacreError(f"{path}: rows have {table.shape[1]} numbers; allowed: 3 (wavelength and two quantities)")
    columns = {"wavelength_nm": to_nm(table[:, 0], options.unit or "nm", str(path))}
    if "AOI" in stated:
        columns["angle_of_incidence_deg"] = np.full(len(table), stated["AOI"])
    notes = []
    if is_fourier:
        if "A" not in stated:
            raise AmbiguousFileError(f"{path}: the azimuth A of the analyser is missing; add a line A 45", "angle_deg")
        alpha, beta = table[:, 1], table[:, 2]
        within(path, "alpha", alpha, -1.0, 1.0)
        within(path, "beta", beta, -1.05, 1.05)
        root = np.sqrt(np.maximum(1.0 - alpha**2, 1e-300))
        columns |= {"alpha": alpha, "beta": beta}
        columns["tan_psi"] = np.abs(np.tan(np.radians(stated["A"]))) * np.sqrt(
            (1 + alpha) / np.maximum(1 - alpha, 1e-300)
        )
        columns["cos_delta"] = beta / root
        notes.append(f"alpha and beta are converted with the azimuth A = {stated['A']:g} degrees")
    elif np.max(np.abs(table[:, 2])) > MAX_DEGREES:
        columns |= {"psi_deg": table[:, 1], "delta_deg": table[:, 2]}
        notes.append("the numbers exceed those of tan Psi and cos Delta: they are taken as degrees")
    else:
        columns |= {"tan_psi": table[:, 1], "cos_delta": table[:, 2]}
        notes.append("the columns PSI and DELTA hold tan Psi and cos Delta: no cosine exceeds 1")
    metadata = {"unit_in_file": "nm", **{key.lower(): value for key, value in stated.items()}}
    return [ellipsometry(path, "regress-pro", columns, options, metadata=metadata, assumed=notes)]
