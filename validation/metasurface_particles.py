"""Discs, rods and spheroids: cross-sections alone, and scattering over glass and a film, against other methods.

References (`particles_open.npz`): extended-precision null fields (spheroids) and finite elements (discs, and all over
the stacks). The T-matrices here are nacre's own, a boundary integral of revolution, solved up to l = 10.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.families.metasurface.tmatrix.particle_on_stack import (
    ParticleOnStack,
    amplitude,
    wavenumber_cutoff,
)
from nacre.families.metasurface.tmatrix.particle_shapes import SolvedBody
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.indices.spec import IndexSpec
from validation._film import canvas
from validation._metasurface_helpers import cross_sections
from validation._rows import finish, row

REFERENCE = Path(__file__).resolve().parents[1] / ".." / "shared" / "reference" / "metasurface" / "particles_open.npz"
FIGURE = "metasurface_particles.png"
BARS = {"spheroids": 1e-4, "silicon discs": 5e-3, "metal discs": 2e-2}
OVER = {"spheroids": 2e-3, "discs": 1e-2}
CLOSE = 2e-2
ORDER, AZIMUTHS = 10, 6


def body(data: Any, i: int) -> SolvedBody:
    """A particle of the reference, solved to its order."""
    n = complex(data["n_particle"][i])
    core, air = (IndexSpec.model_validate({"n": v.real, "k": v.imag}).build() for v in (n, 1 + 0j))
    made = SolvedBody(str(data["shape"][i]), data["radius_nm"][i], data["height_nm"][i], core, air, "reference")
    made.__dict__["lmax"] = ORDER
    return made


def kind(data: Any, i: int) -> str:
    """Which bar is for it."""
    if data["shape"][i] == "spheroid":
        return "spheroids"
    return "silicon discs" if data["n_particle"][i].real > 1 else "metal discs"


def alone_error(data: Any, i: int, t: NDArray[np.complex128]) -> float:
    """The largest relative error of extinction and scattering at 0, 45 and 90 degrees."""
    air = Substrate(float(data["wavelength_nm"][i]), np.ones(2, complex), np.zeros(0))
    found = cross_sections(ParticleOnStack(air, 200.0, t, AZIMUTHS), np.cos(np.radians([0.0, 45.0, 89.999])))
    scattered = (found.scattered_up + found.scattered_down).T
    errors = found.extinction.T / data["sigma_ext_nm2"][i] - 1, scattered / data["sigma_sca_nm2"][i] - 1
    return float(np.max(np.abs(errors)))


def over_stack(data: Any, which: str, line: int, made: SolvedBody) -> tuple[Any, Any]:
    """d sigma/d Omega of ours and of finite elements, `[pol, theta, phi]`, um^2/sr."""
    lam = float(data["wavelength_nm"][data[f"{which}_particle"][line]])
    film = data[f"{which}_substrate"][line] != "glass"
    indices = np.array([1.0, *([data["n_film"]] if film else []), data[f"{which}_n_substrate"][line]], complex)
    stack = Substrate(lam, indices, np.array([data[f"{which}_film_h_nm"][line]] if film else []))
    cut = wavenumber_cutoff(ORDER, stack.wavenumber, made.circumscribing_nm) if which == "near" else None
    centre = made.height_nm / 2 + float(data[f"{which}_gap_nm"][line])
    alone = ParticleOnStack(stack, centre, made.azimuthal(lam, AZIMUTHS), AZIMUTHS, cut)
    light = alone.directions([np.cos(np.radians(data[f"{which}_theta_i_deg"][line]))])
    f = amplitude(alone.harmonics(alone.directions(np.cos(data["sub_theta_s_rad"])), light), data["sub_phi_rad"])
    return np.abs(f[:, :, int(data[f"{which}_pol_in"][line]), 0]) ** 2 * 1e-6, data[f"{which}_dsigma_fem_um2_per_sr"][
        line
    ]


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    if not REFERENCE.is_file():
        return [row("reference data", "present", "../shared/reference is absent", False, "")]
    data = np.load(REFERENCE)
    count = len(data["wavelength_nm"])
    bodies = [body(data, i) for i in range(count)]
    solved = [b.azimuthal(float(w), AZIMUTHS) for b, w in zip(bodies, data["wavelength_nm"])]
    rows = []
    for name, bar in BARS.items():
        worst = max(alone_error(data, i, solved[i]) for i in range(count) if kind(data, i) == name)
        claim = f"{name} alone: worst relative error of extinction and scattering"
        code = "extended-precision null fields" if name == "spheroids" else "finite elements"
        rows.append(row(claim, f"at most {bar:g}", f"{worst:.1e}", worst <= bar, FIGURE) | {"code": code})
    errors: dict[str, float] = {}
    for which in ("sub", "near"):
        for line, i in enumerate(data[f"{which}_particle"]):
            ours, theirs = over_stack(data, which, line, bodies[i])
            name = ("spheroids" if data["shape"][i] == "spheroid" else "discs") if which == "sub" else "close"
            errors[name] = max(errors.get(name, 0.0), float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)))
    for name, bar in {**OVER, "close": CLOSE}.items():
        where = "any, the sphere around it cut by the stack" if name == "close" else f"{name} over glass and a film"
        claim = f"{where}: worst relative L2 of d sigma/d Omega at l = {ORDER}"
        verdict = row(claim, f"at most {bar:g}", f"{errors[name]:.1e}", errors[name] <= bar, FIGURE)
        rows.append(verdict | {"code": "finite elements"})
    figure, axes = canvas(1, 3, 10.0, 3.4)
    theta = np.degrees(data["sub_theta_s_rad"])
    back = int(np.argmin(np.abs(data["sub_phi_rad"] - np.pi)))
    for each, (which, line) in zip(axes.flat, (("sub", 3), ("sub", 11), ("near", 3))):
        i = int(data[f"{which}_particle"][line])
        ours, theirs = over_stack(data, which, line, bodies[i])
        for side, sign in ((0, 1.0), (back, -1.0)):
            marks = {} if side else {"label": "finite elements"}
            each.plot(sign * theta, theirs.sum(axis=0)[:, side], "k.", markersize=3, **marks)
            each.plot(sign * theta, ours.sum(axis=0)[:, side], "C1", **({} if side else {"label": "nacre"}))
        name = f"{data['shape'][i]} {2 * data['radius_nm'][i]:g} x {data['height_nm'][i]:g} nm"
        gap = float(data[f"{which}_gap_nm"][line])
        each.set(xlabel="viewing angle (degrees)", title=f"{name}, {gap:g} nm over {data[f'{which}_substrate'][line]}")
        each.title.set_fontsize(8)
    axes.flat[0].set_ylabel("d sigma/d Omega (um$^2$/sr), p at 40 degrees")
    axes.flat[0].legend(fontsize=7, frameon=False)
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
