"""Further statements of Guillen et al. 2020 on the space of pearls: figures 9 to 12, and the effect gamut in a*b*.

`pearl_trends` holds the materials, its directions, the single trends of figure 10 and their panels; here stand the
statements on whole tracks: how narrow their manifolds are, which way they turn, how the second substrate compares.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from scipy.spatial import ConvexHull

from nacre.light import xyz_to_xyy
from validation._pearl import SRGB, Array, chroma, in_both_balances, lab_at_50, seen, track, with_balance
from validation._rows import finish, row
from validation.pearl_trends import COATINGS_NM, DENSITIES, DEVIATIONS, FLAT, diffuse, falling, gloss, pearl

DENSITY = 0.03
GLOSS_ANGLES_DEG, DIFFUSE_ANGLES_DEG = (10.0, 30.0, 50.0), (30.0, 45.0, 60.0)
# bounds of the rows, set from the words before any value was seen
NARROW = 0.1  # mean distance of tracks on one narrow manifold, over their extent
MOST = 0.5
OPPOSITE = 0.8  # share of the steps in which two components must move against each other
LINKED = 0.8  # of a correlation


def xy(xyz: Any) -> Array:
    """Chromaticities `[..., 2]`."""
    return np.asarray(xyz_to_xyy(np.asarray(xyz)))[..., :2]


def fans(kind: str) -> tuple[list[Array], list[Array]]:
    """XYZ of gloss and of diffuse light over the coating, `[coating, 3]`, one of each for each angle."""
    lobes = [pearl(kind, c, DENSITY, FLAT) for c in COATINGS_NM]
    shiny = [np.array([seen(lobe, 4.0, angle) for lobe in lobes]) for angle in GLOSS_ANGLES_DEG]
    matt = [np.array([seen(lobe, angle, 10.0) for lobe in lobes]) for angle in DIFFUSE_ANGLES_DEG]
    return shiny, matt


def width(tracks: list[Array]) -> float:
    """Mean distance of each track's points to the others' lines, over the extent of all, in xy."""
    points = [xy(t) for t in tracks]
    every = np.concatenate(points)
    found = [_to_line(p, other) for i, one in enumerate(points) for j, other in enumerate(points) if i != j
             for p in one]  # fmt: skip
    return float(np.mean(found) / np.linalg.norm(np.ptp(every, axis=0)))


def _to_line(point: Array, line: Array) -> float:
    start, way = line[:-1], np.diff(line, axis=0)
    along = np.clip(np.sum((point - start) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(start + along[:, None] * way - point, axis=1).min())


def outside(points: Array) -> Array:
    """Which chromaticities lie outside the sRGB triangle."""
    way = points[:, None] - SRGB[:3]
    edge = np.diff(SRGB, axis=0)
    side = edge[:, 0] * way[..., 1] - edge[:, 1] * way[..., 0]  # of each edge; the corners run anticlockwise
    return np.asarray(np.any(side < 0, axis=1))


def compare_rows(figure: str) -> list[dict[str, Any]]:
    """Ask what the source says of tracks and of the second substrate."""
    rows = []
    shiny, matt = fans("C1")
    for name, tracks, panel in (("diffuse", matt, "10a"), ("gloss", shiny, "10b")):
        rows.append(row(f"{name}: chromaticities of all angles lie on one narrow manifold ({panel})",
                        f"mean distance below {NARROW:.0%} of the extent", f"{width(tracks):.1%}",
                        width(tracks) < NARROW, figure))  # fmt: skip
    share = float(np.mean(outside(xy(np.concatenate(matt)))))
    rows.append(row("diffuse: the manifold lies mostly outside sRGB (10a)", f"more than {MOST:.0%} of the points",
                    f"{share:.0%}", share > MOST, figure))  # fmt: skip
    steps = [np.diff(xy(np.array([look("C1", c, DENSITY, FLAT) for c in COATINGS_NM])), axis=0)
             for look in (gloss, diffuse)]  # fmt: skip
    against = float(np.mean(np.sum(steps[0] * steps[1], axis=1) < 0))
    rows.append(row("gloss and diffuse chromaticities move in opposite directions with the coating (10b, 10c)",
                    f"in {OPPOSITE:.0%} of the steps", f"{against:.0%}", against >= OPPOSITE, figure))  # fmt: skip
    change = {s: np.ptp([chroma(diffuse("C1", 100, c, s)) for c in DENSITIES]) for s in (FLAT, 0.1)}
    rows.append(row("density moves the diffuse saturation, especially for a small deviation (10e)",
                    "more at 0.01 than at 0.1", f"C* range {change[FLAT]:.0f} and {change[0.1]:.0f}",
                    change[FLAT] > change[0.1], figure))  # fmt: skip
    values = np.array([diffuse("C2", 100, c, FLAT)[1] for c in DENSITIES])
    rows.append(row("mica behaves the same globally: diffuse luminance falls with density (12)", "falls",
                    ", ".join(f"{v:.2f}" for v in values), falling(values), figure))  # fmt: skip
    bright = [np.array([look("C2", c, DENSITY, FLAT)[1] for c in COATINGS_NM]) for look in (gloss, diffuse)]
    together = float(np.corrcoef(*bright)[0, 1])
    rows.append(row("mica behaves the same globally: gloss luminance is complementary (12)",
                    f"correlation below -{LINKED:g}", f"{together:.2f}", together < -LINKED, figure))  # fmt: skip
    values = np.array([chroma(diffuse("C2", 100, DENSITY, s)) for s in DEVIATIONS])
    rows.append(row("mica behaves the same globally: less saturated as the normals spread (12)", "falls",
                    "diffuse C* at L* 50: " + ", ".join(f"{v:.0f}" for v in values), falling(values),
                    figure))  # fmt: skip
    return [*rows, axes_of_the_slice(figure)]


def axes_of_the_slice(figure: str) -> dict[str, Any]:
    """Figure 9: away from the gloss, colour runs along the radius of (theta_h, theta_d), hardly across it."""
    lobe = pearl("C1", 100, DENSITY, FLAT)
    radius, turn = np.meshgrid(np.arange(25.0, 66.0, 5.0), np.radians(np.arange(0.0, 61.0, 15.0)), indexing="ij")
    points = xy(seen(lobe, radius * np.cos(turn), radius * np.sin(turn)))
    across = float(np.linalg.norm(points.std(axis=1), axis=-1).mean())
    along = float(np.linalg.norm(points.std(axis=0), axis=-1).mean())
    return row("diffuse colour varies along the radius of the image slice, roughly constant across it (9)",
               "spread of xy across at most half of that along", f"{across:.3f} and {along:.3f}",
               across <= 0.5 * along, figure)  # fmt: skip


def draw(out: Path, figure: str) -> None:
    """Draw the fans, the tracks against density and deviation, and the effect gamut."""
    page, axes = pyplot.subplots(2, 4, figsize=(17, 8.6), constrained_layout=True)
    gamut: dict[str, dict[str, list[Array]]] = {}
    for column, kind in enumerate(("C1", "C2")):
        shiny, matt = fans(kind)
        for axis, name, tracks, angles, colour in (
            (axes[column, 0], "theta_h", matt, DIFFUSE_ANGLES_DEG, "black"),
            (axes[column, 1], "theta_d", shiny, GLOSS_ANGLES_DEG, "0.5"),
        ):
            for values, angle, style in zip(tracks, angles, ("-", "--", ":"), strict=True):
                track(axis, values, style, f"{name} {angle:g}", colour)
            axis.set_title(f"{kind}, {'diffuse' if name == 'theta_h' else 'gloss'} over the coating, 50 to 150 nm")
        gamut[kind] = {"gloss": shiny, "diffuse": matt}
    for axis, keys, title in (
        (axes[0, 2], [[("C1", t, c, FLAT) for c in DENSITIES] for t in (60, 100)], "C1, density 1 to 16.5 %"),
        (axes[1, 2], [[("C1", t, DENSITY, s) for s in DEVIATIONS] for t in (60, 100)], "C1, deviation .01 to .2"),
    ):
        for line, style, thickness in zip(keys, ("-", "--"), (60, 100), strict=True):
            track(axis, [gloss(*key) for key in line], style, f"gloss, {thickness} nm", "0.5")
            track(axis, [diffuse(*key) for key in line], style, f"diffuse, {thickness} nm", "black")
        axis.set_title(title)
    for axis, name in ((axes[0, 3], "gloss"), (axes[1, 3], "diffuse")):
        for kind, colour in (("C1", "tab:blue"), ("C2", "tab:orange")):
            ab = lab_at_50(np.concatenate(gamut[kind][name]))[:, 1:]
            hull = ConvexHull(ab)
            axis.plot(*ab.T, ".", color=colour)
            ring = np.append(hull.vertices, hull.vertices[0])
            axis.plot(*ab[ring].T, color=colour, label=f"{kind}: {hull.volume:.0f}")
        axis.axhline(0, color="0.8", linewidth=0.7)
        axis.axvline(0, color="0.8", linewidth=0.7)
        axis.set(title=f"effect gamut, {name}, at L* 50", xlabel="a*", ylabel="b*", aspect="equal")
        axis.legend(frameon=False, title="area")
    finish(page, out, figure, dpi=90)


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Test the statements, draw, return the rows."""
    figure = "pearl_parameter_panels.png"
    rows = in_both_balances(lambda: compare_rows(figure))
    with with_balance("published"):  # the source's figures use its balance
        draw(Path(out_dir), figure)
    return rows


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
