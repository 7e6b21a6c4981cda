"""Fewer wavelengths for a search to find its way by, where they tell the colours too."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nacre.arrays import Array
from nacre.design.goals import Goals
from nacre.design.wants.geometry import At
from nacre.design.wants.target import Target
from nacre.design.wants.wanted import goals_of
from nacre.light import delta_e_2000, lamp_lines_nm, with_lamp_lines

FEW_NM = np.linspace(400.0, 700.0, 14)  # enough for the colours of flakes of spread thickness, at half the time
CHECKED, OFF = 3, 1.0  # places where they are compared with all wavelengths; of `within`: what they may be off


def within_of(target: Target, rows: Sequence[At]) -> Array:
    """Return `[row]`, the least `within` over weight of the wants at each geometry."""
    return np.array([min(w.within / w.weight for w in target.wants if w.at == at) for at in rows])


def fewer_wavelengths(
    target: Target, rows: Sequence[At], whole: tuple[Array, Goals], places: Sequence[Array],
    spectra: Callable[[Array, Array], Array | None],
) -> tuple[Array, Goals]:  # fmt: skip
    """Return wavelengths and the goals on them: few where their colours are near those of all.

    Args:
        target: what is wanted.
        rows: its geometries.
        whole: all wavelengths, and the goals on them.
        places: that are looked at to find out, the first of them.
        spectra: of a place on wavelengths, `[row, wavelength]`; None where it cannot be computed.
    """
    grid, goals = whole
    if FEW_NM[0] < grid[0] or FEW_NM[-1] > grid[-1] or any(want.spectrum is not None for want in target.wants):
        return whole  # a wanted spectrum is compared on all of its wavelengths
    few, light = FEW_NM, target.spec.light
    for lamp in light.illuminants:
        few = with_lamp_lines(few, lamp) if len(lamp_lines_nm(lamp)) else few
    if len(few) >= len(grid):
        return whole
    of_few = goals_of(target.wants, rows, light, few)
    for place in places[:CHECKED]:
        here, there = spectra(place, few), spectra(place, grid)
        if here is None or there is None:
            return whole
        if np.any(delta_e_2000(of_few.labs(here), goals.labs(there)).max(axis=-1) > OFF * within_of(target, rows)):
            return whole
    return few, of_few


__all__ = ["fewer_wavelengths", "within_of"]
