"""Worker of the stack benchmarks: tmm_fast and pyElli in their own environment. Started by `common.Worker`."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from common import serve

STATE: dict[str, Any] = {}


def load(path: str) -> None:
    """Read the stacks: n[stack, medium, wavelength], thicknesses_nm[stack, layer], wavelengths_nm, theta_rad."""
    with np.load(path) as file:
        STATE.update({key: file[key] for key in file.files})


def _thick(count: int) -> np.ndarray:
    d = STATE["thicknesses_nm"][:count]
    infinite = np.full((len(d), 1), np.inf)
    return np.concatenate([infinite, d, infinite], axis=1)


def tmm_fast(count: int, save: str = "") -> tuple[float, float]:
    """Time R, T of s and p of the first `count` stacks."""
    import torch
    from tmm_fast import coh_tmm

    n, d = torch.tensor(STATE["n"][:count]), torch.tensor(_thick(count))
    theta, lam = torch.tensor(STATE["theta_rad"]), torch.tensor(STATE["wavelengths_nm"])
    wall, cpu = time.perf_counter(), time.process_time()
    with torch.no_grad():
        s, p = (coh_tmm(pol, n, d, theta, lam) for pol in "sp")
    spent = time.perf_counter() - wall, time.process_time() - cpu
    if save:
        np.savez(save, R_s=s["R"].numpy(), R_p=p["R"].numpy(), T_s=s["T"].numpy(), T_p=p["T"].numpy())
    return spent


def elli(count: int, save: str = "") -> tuple[float, float]:
    """The same with pyElli's 2x2 solver, one evaluation a stack and angle (it batches over wavelengths)."""
    import elli

    lam = STATE["wavelengths_nm"]
    structures = []
    for n, d in zip(STATE["n"][:count], STATE["thicknesses_nm"][:count]):
        materials = [elli.IsotropicMaterial(elli.Table(lam, row)) for row in n]
        films = [elli.Layer(m, float(x)) for m, x in zip(materials[1:-1], d)]
        structures.append(elli.Structure(materials[0], films, materials[-1]))
    degrees = np.degrees(STATE["theta_rad"])
    reflected = np.empty((2, count, len(degrees), len(lam)))
    wall, cpu = time.perf_counter(), time.process_time()
    for i, structure in enumerate(structures):
        for j, degree in enumerate(degrees):
            result = structure.evaluate(lam, degree, solver=elli.Solver2x2)
            reflected[0, i, j], reflected[1, i, j] = result.R_ss, result.R_pp
            _ = result.T_ss, result.T_pp
    spent = time.perf_counter() - wall, time.process_time() - cpu
    if save:
        np.savez(save, R_s=reflected[0], R_p=reflected[1])
    return spent


def tmm_fast_gradient(save: str = "", calls: int = 1) -> tuple[float, float]:
    """Time value and gradient of the colour loss of bench_stack_gradient, by torch's autograd: seconds a call."""
    import torch
    from tmm_fast import coh_tmm

    n, theta = torch.tensor(STATE["n"]), torch.tensor(STATE["theta_rad"])
    lam, weights = torch.tensor(STATE["wavelengths_nm"]), torch.tensor(STATE["weights"])
    white, wanted = torch.tensor(STATE["white"]), torch.tensor(STATE["wanted"])
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(calls):
        d = torch.tensor(_thick(1), requires_grad=True)
        reflectance = 0.5 * sum(coh_tmm(pol, n, d, theta, lam)["R"] for pol in "sp")[0]
        ratio = (reflectance @ weights) / white
        f = torch.where(ratio > (6 / 29) ** 3, ratio ** (1 / 3), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
        lab = torch.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], dim=-1)
        loss = ((lab - wanted) ** 2).sum()
        loss.backward()
    spent = (time.perf_counter() - wall) / calls, (time.process_time() - cpu) / calls
    if save:
        np.savez(save, value=loss.detach().numpy(), gradient=d.grad.numpy()[0, 1:-1])
    return spent


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve({"load": load, "tmm_fast": tmm_fast, "elli": elli, "tmm_fast_gradient": tmm_fast_gradient})
