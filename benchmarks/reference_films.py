"""The reference of bench_design_films: colours of stacks by `tmm` and colour-science, never by nacre's own optics.

A process of its own that serves requests (`common.serve`). Of nacre it takes only the optical constants, by name.
"""

from __future__ import annotations

import functools
from typing import Any

import colour
import numpy as np
import tmm
from common import serve
from reach_lamps import reach

from nacre.matter.indices.library import index

LOW_NM, HIGH_NM = 380, 780


@functools.cache
def indices(name: str, step_nm: int) -> np.ndarray:
    """A material's n + ik in steps over the evaluated range of 380-780 nm."""
    return index(name).n_complex(np.arange(LOW_NM, HIGH_NM + 1.0, step_nm))


def reflectance(stack: dict[str, Any], angle_deg: float, step_nm: int) -> np.ndarray:
    """Unpolarised reflectance of a stack, by `tmm`."""
    wavelengths = np.arange(LOW_NM, HIGH_NM + 1.0, step_nm)
    media = [indices(name, step_nm) for name in (*stack["materials"], stack["substrate"])]
    d = [np.inf, *stack["thicknesses_nm"], np.inf]
    angle = np.radians(angle_deg)
    seen = np.empty(len(wavelengths))
    for i, wavelength in enumerate(wavelengths):
        n = [1.0, *(m[i] for m in media)]
        kinds = ("s", "p") if angle_deg > 0.0 else ("s",)
        seen[i] = np.mean([tmm.coh_tmm(kind, n, d, angle, wavelength)["R"] for kind in kinds])
    return seen


@functools.cache
def weights(lamp: str, step_nm: int) -> np.ndarray:
    """Weights for XYZ of colour-science's own tables, `[wavelength, 3]`, Y = 1 for white; 10 degrees."""
    shape = colour.SpectralShape(LOW_NM, HIGH_NM, step_nm)
    matching = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"].copy().align(shape).values
    power = colour.SDS_ILLUMINANTS[lamp].copy().align(shape).values
    product = matching * power[:, None]
    return product / product[:, 1].sum()


def lab_of(seen: np.ndarray, lamp: str, step_nm: int) -> np.ndarray:
    """CIELAB against the lamp's white, by colour-science."""
    w = weights(lamp, step_nm)
    return colour.XYZ_to_Lab(seen @ w, colour.XYZ_to_xy(w.sum(axis=0)))


def labs(stack: dict[str, Any], angles_deg: list[float], lamps: list[str]) -> list[list[list[float]]]:
    """CIELAB at each angle under each lamp, in steps of 1 nm."""
    spectra = [reflectance(stack, angle, 1) for angle in angles_deg]
    return [[lab_of(seen, lamp, 1).tolist() for lamp in lamps] for seen in spectra]


def differences(stack: dict[str, Any], angles_deg: list[float], lamps: list[str], lab: list[float]) -> list[float]:
    """dE00 to one colour at each angle and lamp."""
    found = np.array(labs(stack, angles_deg, lamps)).reshape(-1, 3)
    return [float(colour.delta_E(one, np.array(lab), method="CIE 2000")) for one in found]


def made(
    stack: dict[str, Any],
    angles_deg: list[float],
    lab: list[float],
    relative: float,
    tolerance: float,
    draws: int,
    seed: int,
) -> float:
    """Share of made samples whose colour is within a dE00 at all angles, D65; in steps of 10 nm."""
    rng = np.random.default_rng(seed)
    d = np.array(stack["thicknesses_nm"])
    good = 0
    for _ in range(draws):
        sample = {**stack, "thicknesses_nm": list(d * (1.0 + relative * rng.normal(size=len(d))))}
        good += all(
            colour.delta_E(lab_of(reflectance(sample, a, 10), "D65", 10), np.array(lab), method="CIE 2000") <= tolerance
            for a in angles_deg
        )
    return good / draws


def rms(stack: dict[str, Any], angle_deg: float, wavelengths_nm: list[float], wanted: list[float]) -> float:
    """Rms difference in per cent of the unpolarised reflectance from a wanted one, by `tmm`."""
    nm, d = np.array(wavelengths_nm), [np.inf, *stack["thicknesses_nm"], np.inf]
    media = [index(name).n_complex(nm) for name in (*stack["materials"], stack["substrate"])]
    seen = [
        tmm.unpolarized_RT([1.0, *(m[i] for m in media)], d, np.radians(angle_deg), w)["R"] for i, w in enumerate(nm)
    ]
    return float(100.0 * np.sqrt(np.mean((np.array(seen) - np.array(wanted)) ** 2)))


if __name__ == "__main__":
    serve({"labs": labs, "differences": differences, "made": made, "reach": reach, "rms": rms})
