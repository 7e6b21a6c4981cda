"""Relief, forward: the 21 published renders, by the plain model and with the published evaluator's artefact.

The published program multiplies each sample by a Gabor factor of its local slope, which depends on the sampling pitch
and vanishes with it; it cuts its blur at 17 taps and lights the tile from 0.5 m off its middle (physics/relief.md,
section 8). No constant is fitted: the scale factor reported is only looked at.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.plane_cut import (
    CutGeometry,
    chebyshev_nodes,
    interpolation_weights,
    plan_cut,
    smoothing_matrix,
)
from nacre.families.relief.surface import Tile

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "relief"
UPSAMPLING = 8  # the source's sampling when it renders
TAPS = 8  # on each side
ORDER = 3  # of the expansion of one factor; products up to ORDER + 1 are kept
EACH_BAR, MEDIAN_BAR, SCALE_BAR = 3e-3, 1e-3, 1e-3
NODES = 6


def load() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the published designs and their spectrum."""
    stored = []
    for name in ("published_designs.npz", "published_spectrum.npz"):
        with np.load(REFERENCE / name) as data:
            stored.append({key: data[key] for key in data.files})
    return stored[0], stored[1]


def published_surface(heights_um: Array, pixel_um: float, blur_um: float) -> Array:
    """Return H at pitch p/8 with the source's own 17-tap blur, um."""
    fine = np.repeat(np.repeat(heights_um, UPSAMPLING, axis=0), UPSAMPLING, axis=1)
    offsets = np.arange(-TAPS, TAPS + 1)
    kernel = np.exp(-0.5 * (offsets * pixel_um / UPSAMPLING / blur_um) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        fine = sum(k * np.roll(fine, int(o), axis) for k, o in zip(kernel, offsets))
    return np.asarray(fine)


def artefact_slice(
    surface_um: Array, pixel_um: float, sigma: float, half_range: float, spectrum: dict[str, Any]
) -> Array:
    """Return the RGB slice `[x, y, 3]` of the published evaluator, normal incidence."""
    pitch = pixel_um / UPSAMPLING
    period = surface_um.shape[0] * pitch
    shift = -2.0 * 48.0 * pixel_um / 5e5
    axis = ((np.arange(64) + 0.5) / 64 * 2 - 1) * half_range + shift
    u, v = axis[:, None], axis[None, :]
    xi = 1.0 + np.sqrt(1.0 - u**2 - v**2)
    coherence = Coherence.from_sigma(sigma)
    gx, gy = ((np.roll(surface_um, -1, k) - np.roll(surface_um, 1, k)) / (2 * pitch) for k in (0, 1))
    a = 0.5 * (np.pi * pitch) ** 2
    nodes = chebyshev_nodes(float(xi.min()), float(xi.max()), NODES)
    weights = interpolation_weights(nodes, xi)
    rgb = np.zeros((64, 64, 3))
    for k, wavelength in enumerate(spectrum["wavelength_um"]):
        highest = min(
            math.ceil(period * (half_range + 0.01 + 6 * coherence.blur) / wavelength), len(surface_um) // 2 - 1
        )
        lines = np.arange(-highest, highest + 1) % len(surface_um)
        smooth = smoothing_matrix(axis, highest, period, float(wavelength), coherence.blur)
        power = np.zeros((64, 64))
        for q, node in enumerate(nodes):
            power += weights[q] * _expanded(surface_um, gx, gy, float(node), float(wavelength), a, lines, smooth, u, v)
        power *= 4 * np.pi * coherence.width_in_wavelengths**2
        power *= np.exp(-2 * a * (u**2 + v**2) / wavelength**2)
        factor = xi**2 / (4 * (xi - 1.0))
        rgb += (power * factor)[..., None] * spectrum["W_RGB"][:, k]
    return rgb


def _expanded(
    surface: Array, gx: Array, gy: Array, xi: float, wavelength: float, a: float, lines: Any, smooth: Array, u: Array,
    v: Array,
) -> Array:  # fmt: skip
    """Return the smoothed power with the slope factor, expanded in the direction, for one (xi, wavelength)."""
    qx, qy = xi * gx / wavelength, xi * gy / wavelength
    base = np.exp(-2j * np.pi * xi / wavelength * surface - a * (qx**2 + qy**2))
    fields = {}
    for i in range(ORDER + 1):
        for j in range(ORDER + 1 - i):
            term = base * (-2 * a * qx) ** i / math.factorial(i) * (-2 * a * qy) ** j / math.factorial(j)
            fields[i, j] = (np.fft.fft2(term) / surface.size)[np.ix_(lines, lines)]
    total = np.zeros((len(smooth), len(smooth)))
    for degree_x in range(ORDER + 2):
        for degree_y in range(ORDER + 2 - degree_x):
            cross = np.zeros((len(lines), len(lines)))
            for (i, j), c in fields.items():
                other = fields.get((degree_x - i, degree_y - j))
                if other is not None:
                    cross += (c * other.conj()).real
            direction = (u / wavelength) ** degree_x * (v / wavelength) ** degree_y
            total += direction * (smooth @ cross @ smooth.T)
    return total


def plain_slice(
    heights_um: Array, pixel_um: float, blur_um: float, sigma: float, half_range: float, spectrum: Any
) -> Array:
    """Return the RGB slice of nacre's own model, at a sampling that no longer matters."""
    tile = Tile(1e3 * heights_um, 1e3 * pixel_um, 1e3 * blur_um)
    upsampling = 24 if blur_um / pixel_um < 0.2 else 16
    axis = ((np.arange(64) + 0.5) / 64 * 2 - 1) * half_range
    plan = plan_cut(
        CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), 1e3 * spectrum["wavelength_um"]),
        samples=tile.features * upsampling,
        period_nm=tile.period_nm,
        height_range_nm=tile.height_range_nm,
        coherence=Coherence.from_sigma(sigma),
        prefactor="published",
        node_error=1e-3,
        dtype=np.float32,
    )
    values, _ = plan.forward(tile.surface_nm(upsampling).astype(np.float32))
    return np.asarray(np.einsum("cl,lxy->xyc", spectrum["W_RGB"], values[0]))


def compare(designs: dict[str, Any], spectrum: dict[str, Any], i: int, with_plain: bool = True) -> dict[str, Any]:
    """Return relative L2 errors and the scale factor of one design."""
    heights = designs["feature_height"][i].astype(float)
    pixel, blur, sigma, half_range = (
        float(designs[name][i]) for name in ("pixel_um", "blur_um", "sigma", "slice_range")
    )
    render = designs["render_rgb"][i].astype(float)
    ours = artefact_slice(published_surface(heights, pixel, blur), pixel, sigma, half_range, spectrum)
    result = {
        "name": str(designs["name"][i]),
        "artefact": float(np.linalg.norm(ours - render) / np.linalg.norm(render)),
        "scale": float((ours * render).sum() / (ours * ours).sum()),
        "render": render,
        "ours": ours,
    }
    if with_plain:
        plain = plain_slice(heights, pixel, blur, sigma, half_range, spectrum)
        result["plain"] = float(np.linalg.norm(plain - render) / np.linalg.norm(render))
        result["plain_rgb"] = plain
    return result


def main(out_dir: Path) -> list[dict[str, Any]]:
    """Compare all designs; return the rows of the report and write a figure."""
    out_dir = Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    designs, spectrum = load()
    results = [compare(designs, spectrum, i) for i in range(len(designs["pixel_um"]))]
    figure = out_dir / "published_renders.png"
    _picture(results, designs, figure)
    rows = []
    for r in results:
        holds = r["artefact"] <= EACH_BAR and abs(r["scale"] - 1) <= SCALE_BAR
        rows.append(
            {
                "claim": f"render of {r['name']}",
                "claimed": f"relative L2 <= {EACH_BAR:g}, scale 1 within {SCALE_BAR:g}",
                "ours": f"{r['artefact']:.1e} with the artefact (scale {r['scale']:.5f}), {r['plain']:.1e} plain",
                "verdict": "reproduced" if holds else "differs",
                "figure": str(figure),
            }
        )
    median = float(np.median([r["artefact"] for r in results]))
    plain = [r["plain"] for r in results]
    rows.append(
        {
            "claim": "median over the published renders",
            "code": "the authors' own program",
            "claimed": f"<= {MEDIAN_BAR:g}",
            "ours": f"{median:.1e} with the artefact; plain: median {np.median(plain):.1e}, largest {max(plain):.1e}",
            "verdict": "reproduced" if median <= MEDIAN_BAR else "differs",
            "figure": str(figure),
        }
    )
    for row in rows:
        print(f"{row['claim']:70s} {row['claimed']:45s} {row['ours']:70s} {row['verdict']}")
    return rows


def _picture(results: list[dict[str, Any]], designs: dict[str, Any], path: Path) -> None:
    """Write rows of published | with artefact | plain | difference x 10, at each design's own scale."""
    from PIL import Image

    strips = []
    for i, r in enumerate(results):
        scale = float(designs["intensity_scale"][i])
        shown = [np.clip(np.maximum(scale * r[k], 0) ** (1 / 2.2), 0, 1) for k in ("render", "ours", "plain_rgb")]
        shown.append(np.clip(10 * np.abs(shown[0] - shown[1]), 0, 1))
        strips.append(np.concatenate([np.pad(s, ((2, 2), (2, 2), (0, 0)), constant_values=1) for s in shown], axis=1))
    while len(strips) % 3:
        strips.append(np.ones_like(strips[0]))
    columns = [np.concatenate(strips[k::3], axis=0) for k in range(3)]
    page = np.round(255 * np.concatenate(columns, axis=1)).astype(np.uint8)
    Image.fromarray(np.repeat(np.repeat(page, 2, axis=0), 2, axis=1)).save(path)


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
