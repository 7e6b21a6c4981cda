"""The Morpho wing against Maxwell's equations: supercells of 8 ridges of drawn heights, mean of 20.

Light falls along the normal; `_ridges.py` draws and solves, `_ridges_make.py` keeps what it found in
`validation/data/ridge_orders.jsonl`, and three drawn cases are solved again here. Two wings: the lamellae of 35 nm that
the preset's numbers describe (*letter*), and those of 70 nm in ridges that fill about half of the width, which the
preset says that it enters in that way (*meant*). What leaves along the mirror direction counts in neither. Power over
the sine across the ridges is compared; a view is 15 degrees wide, both sides together, so that grains of 20 draws
average out. Colours are under D65 with the rigorous solution seen along the normal as white for both; "two standard
errors" are by the bootstrap over draws.

Vector optics are compared with the supercells of the wing *meant*, whose interference, with its known mean, is taken
as a control variate (`steady`): the mean of 20 cells is otherwise as far from the mean of all cells as the bar.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.bsdf.lobes.ridge import Ridge, ridge_interference
from nacre.core.arrays import Array
from nacre.families.film.supercells import SupercellFilm
from nacre.light import delta_e_2000, xyz_to_lab
from nacre.light.tristimulus import white_xyz, xyz_weights
from nacre.matter.periodic.ridge_supercells import solved_case
from validation._film import canvas, film, srgb
from validation._ridges import FARTHEST, RIDGES, drawn_heights
from validation._ridges_make import (
    DRAWS,
    TRUNCATION,
    WAVELENGTHS_NM,
    WINGS,
    read_cells,
    read_check,
    solve,
)
from validation._rows import finish, row

FIGURE = "film_morpho_rcwa.png"
VIEWS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
HALF_VIEW_DEG = 7.5
STRONG, AGREE = 0.05, 0.01
CLASSES = (2.0, 5.0, 10.0)
BLUE = int(np.argmin(np.abs(WAVELENGTHS_NM - 460.0)))
VUKUSIC_NM, VUKUSIC = (450.0, 480.0), (0.6, 0.9)
RESAMPLED = 400
WIDE_NM = 450.0  # of the cure that widens the ridges: the best of 300 to 700
VECTOR_RIDGES, VECTOR_DE00, VECTOR_DEG = 5, 3.0, 1.5
PERIOD_NM = WINGS["letter"].period_nm
WEIGHTS = xyz_weights(WAVELENGTHS_NM, "D65", "2deg")
WHITE = white_xyz("D65", "2deg")
NAMES = {"letter": "lamellae of 35 nm, by the letter", "meant": "lamellae of 70 nm, as meant"}


class Fan:
    """Power over the sine across the ridges, light unpolarised, at each wavelength: sines and `[draw, order]`."""

    def __init__(self, sines: list[Array], values: list[Array]) -> None:
        """Keep the orders' sines and their values, a list over the wavelengths."""
        self.sines, self.values = sines, values

    def mean_of(self, draws: Array) -> Fan:
        """The mean over some draws."""
        return Fan(self.sines, [value[draws].mean(axis=0, keepdims=True) for value in self.values])

    def total(self) -> Array:
        """Reflectance over wavelength but for the mirror direction, `[wavelength]`, mean of all draws."""
        steps = WAVELENGTHS_NM / PERIOD_NM
        return np.array([
            step * value.mean(axis=0)[np.abs(sine) > 0.5 * step].sum()
            for step, sine, value in zip(steps, self.sines, self.values)
        ])  # fmt: skip

    def views(self) -> Array:
        """Power over the sine `[view, wavelength]`, mean of all draws."""
        result = np.empty((len(VIEWS_DEG), len(WAVELENGTHS_NM)))
        for at, (step, sine, value) in enumerate(zip(WAVELENGTHS_NM / PERIOD_NM, self.sines, self.values)):
            for view, angle in enumerate(VIEWS_DEG):
                low, high = (np.sin(np.radians(angle + side)) for side in (-HALF_VIEW_DEG, HALF_VIEW_DEG))
                share = sum(
                    np.clip(np.minimum(sign * sine + step / 2, high) - np.maximum(sign * sine - step / 2, low), 0, None)
                    for sign in (1, -1)
                ) * (np.abs(sine) > 0.5 * step)
                result[view, at] = float(value.mean(axis=0) @ share / share.sum())
        return result

    def half_deg(self, at: int) -> float:
        """The angle to each side of the normal within which half of the light leaves."""
        step, sine, value = WAVELENGTHS_NM[at] / PERIOD_NM, np.abs(self.sines[at]), self.values[at].mean(axis=0)
        rings = np.arange(1, int(1 / step) + 1)
        power = np.array([value[np.abs(sine - ring * step) < 0.5 * step].sum() for ring in rings])
        edges = (np.append(rings, rings[-1] + 1) - 0.5) * step
        inside = np.append(0.0, np.cumsum(power)) / power.sum()
        return float(np.degrees(np.arcsin(np.interp(0.5, inside, edges))))


def rigorous_fan(wing: str, cells: dict[tuple[str, float, int], list[dict[str, Any]]]) -> Fan:
    """What the supercells send out."""
    draws = [cells[wing, 0.0, draw] for draw in range(DRAWS)]
    sines, values = [], []
    for at, step in enumerate(WAVELENGTHS_NM / PERIOD_NM):
        first, last = draws[0][at]["orders"]
        sines.append(np.arange(first, last + 1) * step)
        values.append(np.array([0.5 * (np.array(d[at]["s"]) + np.array(d[at]["p"])) for d in draws]) / step)
    return Fan(sines, values)


def steady(fan: Fan, wing: str) -> Fan:
    """Return the draws less what the interference of equal ridges explains, by linear regression over the draws."""
    ridge = WINGS[wing]
    heights = np.array([drawn_heights(ridge, draw) for draw in range(DRAWS)])
    centres = (np.arange(RIDGES) + 0.5) * ridge.pitch_nm
    normal = np.linspace(-FARTHEST, FARTHEST, 2001)
    density = np.exp(-0.5 * normal**2)
    values = []
    for wavelength, sines, value in zip(WAVELENGTHS_NM, fan.sines, fan.values):
        wave = 2 * np.pi / wavelength
        up = wave * (1 + np.sqrt(np.maximum(0.0, 1 - sines**2)))
        phases = heights[:, :, None] * up + centres[:, None] * wave * sines
        found = np.abs(np.exp(1j * phases).mean(axis=1)) ** 2
        one = np.exp(1j * np.multiply.outer(up, ridge.height_deviation_nm * normal)) @ density / density.sum()
        is_of_pitch = np.round(sines * ridge.period_nm / wavelength).astype(int) % RIDGES == 0
        mean = (1 - np.abs(one) ** 2) / RIDGES + np.abs(one) ** 2 * is_of_pitch
        spread = found - found.mean(axis=0)
        slope = (spread * value).sum(axis=0) / np.maximum((spread**2).sum(axis=0), 1e-30)
        values.append(value + slope * (mean - found))
    return Fan(fan.sines, values)


def vector_fan(sines: list[Array]) -> Fan:
    """Return the light of nacre's vector optics, of supercells of 5 ridges, at these sines."""
    ridges = {"optics": "vector", "count": VECTOR_RIDGES}
    model = nacre.material({"family": "film", "preset": "morpho", "ridges": ridges}).model
    assert isinstance(model, SupercellFilm)
    values = []
    for case, sine in zip(model.cases(WAVELENGTHS_NM), sines):
        mean, _ = solved_case(case, 0.0)
        values.append(np.interp(sine, np.linspace(-1.0, 1.0, len(mean)), mean[len(mean) // 2])[None])
    return Fan(sines, values)


def our_fan(lobe: Ridge, sines: list[Array], way: str = "half angle") -> Fan:
    """What nacre's lobe sends out at these sines, spread along the ridges taken together.

    Args:
        way: the cosine at which the lamellae are looked up: of the half angle, as nacre has it, or "normal part",
            (cos_i + cos_o) / 2, which is the phase that lamellae that lie flat have.
    """
    values = []
    for at, sine in enumerate(sines):
        cos_o = np.sqrt(np.maximum(0.0, 1 - sine**2))
        normal = 1 + cos_o
        cos = 0.5 * (np.hypot(sine, normal) if way == "half angle" else normal)
        reflected = lobe.response.lookup(cos, np.zeros(cos.shape, dtype=bool), None)[0]
        spread = ridge_interference(
            sine, normal, lobe.wavelengths_nm, lobe.pitch_nm, lobe.width_nm, lobe.height_deviation_nm, lobe.count
        )
        values.append((lobe.fill * reflected * spread / lobe.norm)[None, :, at])
    return Fan(sines, values)


def peak_nm(spectrum: Array) -> float:
    """Where a parabola through the greatest value and its neighbours is greatest."""
    at = int(np.clip(np.argmax(spectrum), 1, len(spectrum) - 2))
    before, middle, after = spectrum[at - 1 : at + 2]
    step = WAVELENGTHS_NM[1] - WAVELENGTHS_NM[0]
    return float(WAVELENGTHS_NM[at] + 0.5 * step * (before - after) / (before - 2 * middle + after))


def colours(views: Array, white: Array) -> Array:
    """Lab `[view, 3]` of spectra, with the spectrum `white` at 100."""
    return np.asarray(xyz_to_lab(views @ WEIGHTS / (white @ WEIGHTS[:, 1] / WHITE[1]), WHITE))


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    cells = read_cells()
    (lobe,) = film(preset="morpho").bsdf(WAVELENGTHS_NM).lobes
    assert isinstance(lobe, Ridge)
    rows = [*_checked(), _again(cells)]
    fans = {wing: rigorous_fan(wing, cells) for wing in WINGS}
    for wing, fan in fans.items():
        rows += _compared(wing, fan, lobe)
    vector = vector_fan(fans["meant"].sines)
    rows += _vector(steady(fans["meant"], "meant"), vector)
    _draw(fans, lobe, vector, out_dir)
    return rows


def _vector(fan: Fan, ours: Fan) -> list[dict[str, Any]]:
    """Vector optics by other supercells."""
    views = fan.views()
    truth = colours(views, views[0])
    random = np.random.default_rng(2)
    resampled = [fan.mean_of(random.integers(DRAWS, size=DRAWS)) for _ in range(RESAMPLED)]
    noise = np.mean([delta_e_2000(truth, colours(each.views(), views[0])) for each in resampled], axis=0)
    away = delta_e_2000(truth, colours(ours.views(), views[0]))
    half, our_half = fan.half_deg(BLUE), ours.half_deg(BLUE)
    angles = ", ".join(f"{angle:g}" for angle in VIEWS_DEG)
    return [
        row(f"vector optics, other supercells, of {VECTOR_RIDGES} ridges: colour seen at {angles} degrees, dE00",
            f"each <= {VECTOR_DE00:g}", f"{_list(away)} (standard error of these supercells {_list(noise)})",
            bool(np.all(away <= VECTOR_DE00)), FIGURE),
        row("vector optics: half of the light of 460 nm leaves across the ridges within",
            f"{VECTOR_DEG:g} degrees of the supercells", f"{our_half:.1f}; supercells {half:.1f}",
            abs(our_half - half) <= VECTOR_DEG, FIGURE),
    ]  # fmt: skip


def _checked() -> list[dict[str, Any]]:
    """One cell with more orders, and by another code."""
    checked = read_check()
    kept = checked["ours"][str(TRUNCATION)]
    rows = []
    for claim, other in (
        ("one cell, 64 orders to each side", checked["ours"]["64"]),
        ("the same, by fmmax with 64", checked["fmmax"]["64"]),
    ):
        worst = 0.0
        assert kept["orders"] == other["orders"]
        for which in "sp":
            values, others = np.array(kept[which]), np.array(other[which])
            strong = others >= STRONG * others.max()
            worst = max(worst, float(np.max(np.abs(values - others)[strong] / others[strong])))
        rows.append(
            row(f"{claim} in place of our {TRUNCATION}: strong orders, relative", f"within {AGREE:.0%}",
                f"{worst:.2%}", worst <= AGREE, FIGURE)
        )  # fmt: skip
    rows[-1]["code"] = "fmmax"
    return rows


def _again(cells: dict[tuple[str, float, int], list[dict[str, Any]]]) -> dict[str, Any]:
    random = np.random.default_rng(int(time.time() // 86400))
    worst = 0.0
    for _ in range(3):
        wing, draw = str(random.choice(list(WINGS))), int(random.integers(DRAWS))
        at = int(random.integers(len(WAVELENGTHS_NM)))
        found, kept = solve(wing, draw, 0.0, float(WAVELENGTHS_NM[at])), cells[wing, 0.0, draw][at]
        worst = max(worst, *(float(np.abs(np.subtract(found[which], kept[which])).max()) for which in "sp"))
    # kept to five digits
    return row("three cases solved again", "within 2e-5", f"{worst:.1e}", worst <= 2e-5, FIGURE)


def _compared(wing: str, fan: Fan, lobe: Ridge) -> list[dict[str, Any]]:
    name = NAMES[wing]
    ours = our_fan(lobe, fan.sines)
    random = np.random.default_rng(1)
    resampled = [fan.mean_of(random.integers(DRAWS, size=DRAWS)) for _ in range(RESAMPLED)]
    rigorous, total, ours_total = fan.views(), fan.total(), ours.total()

    peak, our_peak = peak_nm(total), peak_nm(ours_total)
    noise = 2 * float(np.std([peak_nm(each.total()) for each in resampled]))
    rows = [
        row(f"{name}: peak of the light that leaves beside the mirror direction (Vukusic: 450-480 nm), rigorous",
            "450-480 nm", f"{peak:.0f} +- {noise:.0f} nm; nacre {our_peak:.0f} nm",
            VUKUSIC_NM[0] <= peak <= VUKUSIC_NM[1], FIGURE),
        row(f"{name}: nacre's peak", "within half a step of the wavelengths, 10 nm, and two standard errors",
            f"{our_peak - peak:+.0f} nm", abs(our_peak - peak) <= 10 + noise, FIGURE),
    ]  # fmt: skip
    height = float(total.max())
    noise = 2 * float(np.std([each.total().max() for each in resampled]))
    above = float(ours_total.max()) - height
    rows += [
        row(f"{name}: its height, rigorous (Vukusic: about 0.7-0.8)", "0.6-0.9",
            f"{height:.2f} +- {noise:.2f}; nacre {ours_total.max():.2f}", VUKUSIC[0] <= height <= VUKUSIC[1], FIGURE),
        row(f"{name}: nacre's height", "within two standard errors", f"{above:+.2f}", abs(above) <= noise, FIGURE),
    ]  # fmt: skip
    half, our_half = fan.half_deg(BLUE), ours.half_deg(BLUE)
    noise = 2 * float(np.std([each.half_deg(BLUE) for each in resampled]))
    rows.append(
        row(f"{name}: half of the light of 460 nm leaves across the ridges within", "two standard errors",
            f"{half:.1f} +- {noise:.1f} degrees of the normal; nacre {our_half:.1f}", abs(our_half - half) <= noise,
            FIGURE)
    )  # fmt: skip

    white = rigorous[0]
    truth = colours(rigorous, white)
    grains = np.mean([delta_e_2000(truth, colours(each.views(), white)) for each in resampled], axis=0)
    away = delta_e_2000(truth, colours(ours.views(), white))
    views = ", ".join(f"{angle:g}" for angle in VIEWS_DEG)
    within = ", ".join(f"{np.sum(away <= level)} within {level:g}" for level in CLASSES)
    rows.append(
        row(f"{name}: colour seen at {views} degrees, dE00", "each <= 10",
            f"{_list(away)}: {within} (of another 20 draws: {_list(grains)})", bool(np.all(away <= CLASSES[-1])),
            FIGURE)
    )  # fmt: skip
    shown = [int(WAVELENGTHS_NM[at]) for at in np.argmax(rigorous, axis=1)]
    our_shown = [int(WAVELENGTHS_NM[at]) for at in np.argmax(ours.views(), axis=1)]
    limit = 20
    rows.append(
        row(f"{name}: peaks seen at these angles", f"within a step of the wavelengths, {limit} nm",
            f"{shown} nm; nacre {our_shown}", bool(np.all(np.abs(np.subtract(shown, our_shown)) <= limit)), FIGURE)
    )  # fmt: skip
    (wide,) = film(preset="morpho", ridges={"width_nm": WIDE_NM}).bsdf(WAVELENGTHS_NM).lobes
    for cure, other in (
        ("the lamellae's phase by the normal part, (cos_i + cos_o) / 2, in place of the half angle's cosine",
         our_fan(lobe, fan.sines, "normal part")),
        (f"ridges {WIDE_NM:g} nm wide in place of 300, as light between them joins in", our_fan(wide, fan.sines)),
    ):  # fmt: skip
        changed = delta_e_2000(truth, colours(other.views(), white))
        is_better = float(changed.mean()) <= 0.5 * float(away.mean())
        note = f"mean dE00 {away.mean():.1f} to {changed.mean():.1f} ({_list(changed)})"
        rows.append(
            row(f"{name}: {cure}: does it halve the error?", "taken if it does",
                note if is_better else f"{note}: not taken", not is_better, FIGURE)
        )  # fmt: skip
    return rows


def _list(values: Array) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _draw(fans: dict[str, Fan], lobe: Ridge, vector: Fan, out_dir: str | Path) -> None:
    figure, axes = canvas(1, 3, 12.0, 3.8)
    spectra, fan_axis, patches = axes.flat
    ours = our_fan(lobe, fans["letter"].sines)
    lines = [*fans.items(), ("nacre, scalar", ours), ("nacre, vector", vector)]
    for (name, fan), colour in zip(lines, ("tab:orange", "tab:green", "k", "tab:blue")):
        label = NAMES.get(name, name)
        spectra.plot(WAVELENGTHS_NM, fan.total(), color=colour, label=label)
        order = np.argsort(fan.sines[BLUE])
        fan_axis.plot(
            np.degrees(np.arcsin(fan.sines[BLUE][order])), fan.values[BLUE].mean(axis=0)[order], color=colour,
            label=label, marker="." if name in NAMES else "", lw=1.0,
        )  # fmt: skip
    spectra.set(xlabel="wavelength (nm)", ylim=(0, 1))
    spectra.set_title("reflected, but for the mirror direction", fontsize=9)
    fan_axis.set(xlabel="angle across the ridges (deg)", ylabel="power over the sine", ylim=(0, 1.6))
    fan_axis.set_title("460 nm, mean of 20 cells of 8 ridges", fontsize=9)
    for axis in (spectra, fan_axis):
        axis.legend(fontsize=7, frameon=False)
    image = np.ones((4, len(VIEWS_DEG), 3))
    for at, fan in enumerate((*fans.values(), ours, vector)):
        views = fan.views()
        white = fans["meant"].views()[0] @ WEIGHTS[:, 1] / WHITE[1]
        image[at] = [np.clip(srgb(each, WAVELENGTHS_NM, 0.6 / white), 0, 1) for each in views]
    patches.imshow(image, aspect="auto")
    patches.set_yticks(range(4), ["35 nm", "70 nm", "scalar", "vector"])
    patches.set_xticks(range(len(VIEWS_DEG)), [f"{angle:g}" for angle in VIEWS_DEG])
    patches.set(xlabel="view (deg)")
    patches.set_title("colour", fontsize=9)
    finish(figure, out_dir, FIGURE)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
