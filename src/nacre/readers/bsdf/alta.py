"""ALTA text (`#DIM`, `#PARAM_IN`, `#PARAM_OUT`): angles in radians, cosines, or unit vectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, angles_deg
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement as as_measurement
from nacre.readers.bsdf.samples import pairs_of, pairs_of_half_angles, read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

OUTPUTS = {"INV_STERADIAN": None, "RGB_COLOR": "rgb", "XYZ_COLOR": "xyz"}


def sniff(head: FileHead) -> float:
    """Recognise the line of dimensions."""
    return CERTAIN if any(line.startswith(("#DIM", "#PARAM_IN")) for line in head.lines[:200]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a table with values for single directions or a slice.

    A one-dimensional slice over the half angle has no direction pairs; its columns are `cos_theta_half` and the values.

    Raises:
        NacreError: parameters or values that are not known, or rows that do not fit.
    """
    head: dict[str, list[str]] = {}
    table: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if words[0].startswith("#"):
            head.setdefault(words[0].lstrip("#").upper(), words[1:])
            continue
        try:
            table.append([float(word) for word in words])
        except ValueError:
            raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None
    parameters, output = (head.get(key, ["?"])[0].upper() for key in ("PARAM_IN", "PARAM_OUT"))
    try:
        inputs, outputs = (int(word) for word in head["DIM"][:2])
    except (KeyError, ValueError):
        raise NacreError(f"{path}: has no line #DIM with two numbers") from None
    if not table or any(len(row) < inputs + outputs for row in table):
        raise NacreError(f"{path}: rows should hold {inputs} + {outputs} numbers, as #DIM says")
    if output not in OUTPUTS:
        raise NacreError(f"{path}: PARAM_OUT = {output} is not one of {', '.join(OUTPUTS)}")
    numbers = np.array([row[: inputs + outputs] for row in table])
    x, values = numbers[:, :inputs], numbers[:, inputs:]
    metadata = {"parameters": parameters, "output": output}
    if parameters in ("COS_TH", "RUSIN_TH"):
        cosine = x[:, 0] if parameters == "COS_TH" else np.cos(x[:, 0])
        data = {"cos_theta_half": cosine}
        data |= {"bsdf_rgb": values} if values.shape[1] == 3 else {"bsdf": values[:, 0]}
        lost = "a one-dimensional slice over the half angle: it determines no BRDF by itself"
        return [Measurement(path, "alta", "bsdf", data, "", metadata | {"scatter": "brdf"}, (), (lost,))]
    colour = OUTPUTS[output]
    if (3 if colour else 1) != outputs:
        raise NacreError(f"{path}: PARAM_OUT = {output} does not fit the {outputs} values of #DIM")
    assumed = ["the file names no wavelength; one value stands for all"] if colour is None else []
    return [as_measurement(path, "alta", _angles(path, parameters, x), None, values, metadata, colour=colour,
                           assumed=assumed)]  # fmt: skip


def _angles(path: Path, parameters: str, x: Array) -> Array:
    """Return direction pairs in degrees."""
    zero = np.zeros(len(x))
    if parameters == "CARTESIAN" and x.shape[1] == 6:
        light, viewer = angles_deg(x[:, :3]), angles_deg(x[:, 3:])
        return pairs_of(light[:, 0], light[:, 1], viewer[:, 0], viewer[:, 1])
    if parameters == "SPHERICAL_TL_PL_TV_PV" and x.shape[1] == 4:
        return np.degrees(x) % 360.0
    if parameters == "ISOTROPIC_TV_TL_DPHI" and x.shape[1] == 3:
        return pairs_of(np.degrees(x[:, 1]), zero, np.degrees(x[:, 0]), np.degrees(x[:, 2]) % 360.0)
    if parameters == "ISOTROPIC_TV_TL" and x.shape[1] == 2:
        return pairs_of(np.degrees(x[:, 1]), zero, np.degrees(np.abs(x[:, 0])), np.where(x[:, 0] < 0, 0.0, 180.0))
    if parameters == "RUSIN_TH_PH_TD_PD" and x.shape[1] == 4:
        return pairs_of_half_angles(*x.T)
    if parameters == "RUSIN_TH_TD_PD" and x.shape[1] == 3:
        return pairs_of_half_angles(x[:, 0], zero, x[:, 1], x[:, 2])
    raise NacreError(f"{path}: PARAM_IN = {parameters} with {x.shape[1]} numbers does not give direction pairs")
