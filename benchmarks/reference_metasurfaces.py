"""The reference of bench_design_metasurfaces: colours from the tables of the Bsdf, which no search builds.

A process of its own that serves requests (`common.serve`). The mirror colours come from the specular lobe, the diffuse
ones from the harmonic lobe integrated over the hemisphere; colours by colour-science. All by the mean field, which a
design takes: a hidden recipe that took an ensemble would cost minutes and ask for another model's colours.
"""

from __future__ import annotations

import warnings
from typing import Any

import colour
import numpy as np
from common import serve
from reference_films import weights

import nacre
from nacre.core.errors import NacreError
from nacre.material.material import Material
from nacre.measure.evaluate import bsdf_spectrum

FINE_NM = np.arange(380.0, 781.0, 1.0)


def _labs(made: Material, geometries: list[str]) -> np.ndarray:
    angles = sorted({float(geometry.split()[1]) for geometry in geometries})
    seen = bsdf_spectrum(made.model.bsdf(), np.radians(angles))
    w = weights("D65", 1)
    found = []
    for geometry in geometries:
        kind, angle = geometry.split()
        part = seen.specular_reflectance if kind == "specular" else seen.diffuse_reflectance
        assert part is not None
        fine = np.interp(FINE_NM, seen.wavelengths_nm, part[angles.index(float(angle))])
        found.append(colour.XYZ_to_Lab(fine @ w, colour.XYZ_to_xy(w.sum(axis=0))))
    return np.array(found)


def labs(data: dict[str, Any], changes: dict[str, Any], geometries: list[str]) -> list[list[float]] | None:
    """CIELAB of a recipe at mirror and diffuse geometries; None where it cannot be computed."""
    try:
        return _labs(nacre.material(data).vary(changes).at_low_fidelity(is_reported=True), geometries).tolist()
    except NacreError:
        return None


def differences(recipe: str, geometries: list[str], labs: list[list[float]]) -> list[float]:
    """dE00 of the answer to the target."""
    found = _labs(nacre.load(recipe).at_low_fidelity(is_reported=True), geometries)
    return [float(d) for d in colour.delta_E(found, np.array(labs), method="CIE 2000")]


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve({"labs": labs, "differences": differences})
