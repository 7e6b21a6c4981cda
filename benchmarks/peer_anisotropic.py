"""Worker of the anisotropic benchmark: pyElli's 4 x 4 solver in its own environment. Started by `common.Worker`."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from common import serve

STATE: dict[str, Any] = {}


def load(path: str) -> None:
    """Read n[layer, 3], euler_deg[layer, 3], thicknesses_nm, wavelengths_nm, degrees, and the helix's numbers."""
    with np.load(path) as file:
        STATE.update({key: file[key] for key in file.files})


def _axes(euler_deg: np.ndarray) -> np.ndarray:
    a, b, c = np.radians(euler_deg)

    def about_z(t: float) -> np.ndarray:
        return np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]])

    tilt = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return about_z(a) @ tilt @ about_z(c)


def _isotropic(n: float) -> Any:
    import elli

    return elli.IsotropicMaterial(elli.ConstantRefractiveIndex(n))


def _biaxial(indices: np.ndarray) -> Any:
    import elli

    return elli.BiaxialMaterial(*(elli.ConstantRefractiveIndex(float(x)) for x in indices))


def _evaluate(structure: Any, degrees: np.ndarray, save: str) -> tuple[float, float]:
    import elli

    lam = STATE["wavelengths_nm"]
    reflected = []
    wall, cpu = time.perf_counter(), time.process_time()
    for degree in degrees:
        found = structure.evaluate(lam, float(degree), solver=elli.Solver4x4)
        reflected.append([found.R_pp, found.R_ps, found.R_sp, found.R_ss])
    spent = time.perf_counter() - wall, time.process_time() - cpu
    if save:
        np.savez(save, R=np.moveaxis(np.array(reflected), 1, -1).reshape(len(reflected), len(lam), 2, 2))
    return spent


def stack(save: str = "") -> tuple[float, float]:
    """Time the reflected powers of the biaxial layers."""
    import elli

    layers = []
    for n, euler, d in zip(STATE["n"], STATE["euler_deg"], STATE["thicknesses_nm"]):
        material = _biaxial(n)
        material.set_rotation(_axes(euler))
        layers.append(elli.Layer(material, float(d)))
    return _evaluate(elli.Structure(_isotropic(1.0), layers, _isotropic(1.5)), STATE["degrees"], save)


def helix(slices: int, save: str = "") -> tuple[float, float]:
    """Time the reflected powers of a helix with the axis in the layer, by `TwistedLayer`."""
    import elli

    n_o, n_e, pitch, turns = (float(x) for x in STATE["helix"])
    layer = elli.TwistedLayer(_biaxial(np.array([n_e, n_o, n_o])), pitch * turns, slices, 360.0 * turns)
    return _evaluate(elli.Structure(_isotropic(1.0), [layer], _isotropic(1.5)), STATE["helix_degrees"], save)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve({"load": load, "stack": stack, "helix": helix})
