"""Worker of the grating benchmark: grcwa, fmmax, torcwa and meent in their own environment. Started by `common.Worker`.

All answer R and T of the zero order for s and p light in the classical mounting, with one thread.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import time
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np  # noqa: E402  # reads the number of threads above
from common import serve  # noqa: E402

SAMPLES = {1: 4096, 2: 256}  # of the cell along each period
CODES = ("grcwa", "fmmax", "torcwa", "meent")
CACHE: dict[Any, Any] = {}


def versions() -> dict[str, str | None]:
    """Return each code's version, or nothing for a missing one."""
    return {c: importlib.metadata.version(c) if importlib.util.find_spec(c) else None for c in CODES}


def _cell(case: dict[str, Any]) -> np.ndarray:
    """Return the permittivity of the patterned layer, `[x, y]`; the ridge begins at x = y = 0."""
    count = SAMPLES[1 if case["height"] is None else 2]
    epsilon = complex(*case["epsilon"])
    along_x = np.arange(count) < round(case["width"] / case["period"] * count)
    if case["height"] is None:
        return np.where(along_x, epsilon, 1.0 + 0j)[:, None]
    along_y = np.arange(count) < round(case["height"] / case["period"] * count)
    return np.where(along_x[:, None] & along_y, epsilon, 1.0 + 0j)


def grcwa(case: dict[str, Any], size: int) -> list[float]:
    """Solve with grcwa, `size` orders to each side."""
    import grcwa as code

    code.set_backend("numpy")
    is_line = case["height"] is None
    period = case["period"]
    found = []
    for s, p in ((1.0, 0.0), (0.0, 1.0)):
        vectors = [period, 0], [0, 1e-3 * period if is_line else period]
        count = 2 * size + 1 if is_line else int(np.pi * size**2)
        made = code.obj(count, *vectors, 1.0 / case["wavelength"], case["theta"], 0.0, verbose=0)
        made.Add_LayerUniform(0.0, 1.0)
        cell = _cell(case)
        cell = np.repeat(cell, 8, axis=1) if is_line else cell
        made.Add_LayerGrid(case["depth"], *cell.shape)
        made.Add_LayerUniform(0.0, case["substrate"] ** 2)
        made.Init_Setup()
        made.GridLayer_geteps(cell.ravel())
        made.MakeExcitationPlanewave(p, 0.0, s, 0.0, order=0)
        reflected, transmitted = made.RT_Solve(normalize=1, byorder=1)
        zero = int(np.flatnonzero(np.all(made.G == 0, axis=1))[0])
        found += [float(np.real(reflected[zero])), float(np.real(transmitted[zero]))]
    return found


def torcwa(case: dict[str, Any], size: int) -> list[float]:
    """Solve with torcwa, `size` orders to each side."""
    import torch
    import torcwa as code

    torch.set_num_threads(1)
    is_line = case["height"] is None
    made = code.rcwa(
        freq=1.0 / case["wavelength"], order=[size, 0 if is_line else size], L=[case["period"], case["period"]],
        dtype=torch.complex128, device=torch.device("cpu"),
    )  # fmt: skip
    made.add_input_layer(eps=1.0)
    made.add_output_layer(eps=case["substrate"] ** 2)
    made.set_incident_angle(inc_ang=case["theta"], azi_ang=0.0)
    made.add_layer(thickness=case["depth"], eps=torch.as_tensor(_cell(case), dtype=torch.complex128))
    made.solve_global_smatrix()
    found = []
    for light in "sp":
        for port in ("reflection", "transmission"):
            amplitude = made.S_parameters([0, 0], port=port, polarization=2 * light)
            found.append(float(np.abs(np.asarray(amplitude)).ravel()[0] ** 2))
    return found


def meent(case: dict[str, Any], size: int) -> list[float]:
    """Solve with meent, `size` orders to each side, with the exact Fourier series of its edges."""
    import meent as code

    is_line = case["height"] is None
    step = SAMPLES[1 if is_line else 2] // 64
    # n - ik in this code; the series of the edges is exact
    index = np.sqrt(_cell(case)[::step, :: 1 if is_line else step]).conj().T[None]
    found = []
    for polarisation in (0, 1):
        azimuth = {} if is_line else {"phi": 0.0}
        made = code.call_mee(
            backend=0, pol=polarisation, n_top=1.0, n_bot=case["substrate"], theta=case["theta"],
            fto=[size, 0 if is_line else size], wavelength=case["wavelength"],
            period=[case["period"], case["period"]], ucell=index, thickness=[case["depth"]],
            type_complex=np.complex128, fourier_type=1, **azimuth,
        )  # fmt: skip
        result = made.conv_solve()
        for efficiency in (np.asarray(result.de_ri), np.asarray(result.de_ti)):
            middle = tuple(n // 2 for n in efficiency.shape)
            found.append(float(efficiency[middle].real))
    return found


def fmmax(case: dict[str, Any], size: int) -> list[float]:
    """Solve with fmmax and its default vector formulation, compiled; `size` orders to each side."""
    import jax
    import jax.numpy as jnp
    from fmmax import basis, fields, fmm, scattering

    jax.config.update("jax_enable_x64", True)
    is_line = case["height"] is None
    vectors = basis.LatticeVectors(u=case["period"] * basis.X, v=case["period"] * basis.Y)
    if is_line:
        numbers = np.array(sorted(range(-size, size + 1), key=abs))
        expansion = basis.Expansion(basis_coefficients=np.stack([numbers, 0 * numbers], axis=-1))
    else:
        expansion = basis.generate_expansion(vectors, int(np.pi * size**2))
    cell = _cell(case)
    cell = np.repeat(cell, 4, axis=1) if is_line else cell

    def solve(wavelength: Any, epsilon: Any) -> Any:
        along = jnp.stack([jnp.sin(case["theta"]), 0.0]) * 2 * jnp.pi / wavelength
        layers = [
            fmm.eigensolve_isotropic_media(wavelength, along, vectors, each, expansion)
            for each in (jnp.ones((1, 1), complex), epsilon, jnp.full((1, 1), case["substrate"] ** 2, complex))
        ]
        depths = [jnp.zeros(()), jnp.asarray(case["depth"]), jnp.zeros(())]
        matrix = scattering.stack_s_matrix(layers, depths)
        count = expansion.num_terms
        wave = jnp.zeros((2 * count, 2), complex).at[0, 0].set(1.0).at[count, 1].set(1.0)
        up, down = matrix.s21 @ wave, matrix.s11 @ wave
        flux_in, flux_up = fields.amplitude_poynting_flux(wave, up, layers[0])
        flux_down, _ = fields.amplitude_poynting_flux(down, jnp.zeros_like(down), layers[-1])
        return flux_in, flux_up, flux_down

    key = ("fmmax", is_line, size)
    if key not in CACHE:
        CACHE[key] = jax.jit(solve)
    arrays = [np.asarray(a) for a in CACHE[key](jnp.asarray(case["wavelength"]), jnp.asarray(cell))]
    count = expansion.num_terms

    def zero(flux: np.ndarray, light: int) -> float:
        return float(flux[0, light] + flux[count, light])

    incident, up, down = arrays
    found = []
    for light in (0, 1):
        found += [abs(zero(side, light) / zero(incident, light)) for side in (up, down)]
    return found


def solve(code: str, cases: list[dict[str, Any]], size: int) -> dict[str, Any]:
    """Return `[case][R s, T s, R p, T p]` and the CPU seconds of one case, after one run that compiles."""
    run = {"grcwa": grcwa, "fmmax": fmmax, "torcwa": torcwa, "meent": meent}[code]
    if code == "fmmax":
        run(cases[0], size)
    start = time.process_time()
    values = [run(case, size) for case in cases]
    return {"values": values, "cpu": (time.process_time() - start) / len(cases)}


if __name__ == "__main__":
    serve({"versions": versions, "solve": solve})
