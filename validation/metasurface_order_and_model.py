"""Order of the particles and order of the model: S(q) over the hemisphere, density and packing, multipoles exchanged.

The first three follow the source's figures (Vynck et al., Nature Materials 21, 1035, 2022, Fig. 3b, Fig. 4c and the
extended data on p and density); the last asks what multipoles of order 3 and 4 change of the quasi-crystalline model,
against multi-sphere ensembles that were made with order 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from nacre.core.arrays import Array
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    ParticleOnStack,
    amplitude,
    choose_order,
    hemisphere_rule,
)
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.light import spectrum_to_xyz, srgb_encode, xyz_to_srgb_linear
from nacre.material.material import material
from nacre.matter.mie import mie_coefficients
from validation._rows import finish, row

Row = tuple[str, str, str, bool]

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "metasurface"
COARSE = np.arange(400.0, 701.0, 30.0)
OXIDES_NM = (2.0, 100.0, 200.0, 400.0, 600.0)
PACKINGS, DENSITIES = (0.15, 0.3, 0.5), (2.0, 3.5, 5.0)
SIZES = {"Ag": 90.0, "Si": 75.0}


def hemisphere_rows(axes: Any) -> list[Row]:
    """S over the upper hemisphere as p grows: density 2.5 /um^2, 450 nm, 30 degrees."""
    k, axis_points = 2 * np.pi / 450.0, np.linspace(-1.0, 1.0, 301)
    x, y = np.meshgrid(axis_points, axis_points)
    inside = np.hypot(x, y) <= 1.0
    at_mirror, ring = [], []
    for axis, packing in zip(axes, (0.1, 0.3, 0.5), strict=True):
        made = hard_disk_structure(2.5e-6, packing, 2.2 * k)
        s = made.structure_factor(k * np.hypot(x - 0.5, y))
        axis.imshow(np.where(inside, s, np.nan), extent=(-1, 1, -1, 1), origin="lower", vmin=0, vmax=2)
        axis.set_title(f"S, p = {packing:g}", fontsize=8)
        axis.set_axis_off()
        at_mirror.append(float(made.structure_factor(0.0)))
        ring.append(float(s[inside].max()))
    return [
        ("S over the hemisphere: with p the specular direction darkens and sharp lobes surround it",
         "suppressed; lobes",
         f"S there {', '.join(f'{v:.2f}' for v in at_mirror)}, highest {', '.join(f'{v:.2f}' for v in ring)} "
         "at p = 0.1, 0.3, 0.5", bool(np.all(np.diff(at_mirror) < 0) and np.all(np.diff(ring) > 0))),
    ]  # fmt: skip


def backscatter_rows(axis: Any) -> list[Row]:
    """Backscattering of one silver sphere at normal incidence over the oxide's thickness."""
    wavelengths = np.arange(380.0, 801.0, 5.0)
    peaks = []
    for h in OXIDES_NM:
        gap = {"gap_nm": 1} if h < 5 else {}
        made = material(
            {
                "family": "metasurface",
                "substrate": "Si",
                "layers": [{"material": "SiO2", "thickness_nm": h}],
                "particle": {"material": "Ag", "radius_nm": 90, **gap},
                "monolayer": {"coverage": 0.1},
            }
        ).model
        values = []
        for wavelength in wavelengths:
            surface = made.surface(float(wavelength))
            sphere = ParticleOnStack(surface, 90.0 + made.gap_nm, made.t_matrix(12, surface, 90.0))
            normal = sphere.directions([np.cos(1e-3)])
            f = amplitude(sphere.harmonics(normal, normal), [np.pi])
            values.append(0.5 * float((np.abs(f) ** 2).sum()) * 4 * np.pi / (np.pi * 90.0**2))
        spectrum = np.array(values)
        peaks.append(len(find_peaks(spectrum, prominence=0.05 * spectrum.max())[0]))
        axis.plot(wavelengths, spectrum, label=f"h = {h:g} nm")
    axis.set(xlabel="wavelength / nm", ylabel="backscattering efficiency", yscale="log")
    axis.legend(fontsize=6)
    return [
        ("Ag on SiO2 on Si: backscattering spectra become multi-peaked with h", "more, sharper peaks",
         f"{peaks} peaks (over 5 % of the largest) at h = {[int(h) for h in OXIDES_NM]} nm, order 12",
         peaks[-1] > peaks[0] and peaks[-1] >= 3),
    ]  # fmt: skip


def map_rows(axes: Any) -> list[Row]:
    """Colour over the view, for packing and density, light from 30 degrees; the dark disk's half width.

    By the mean field, which has S as the source's model has; the ensemble of the dense silicon would take minutes each.
    """
    theta = np.radians(np.arange(-80.0, 80.1, 2.0))
    wi = np.array([0.5, 0.0, np.sqrt(0.75)])
    wo = np.stack([-np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    rows: list[Row] = []
    for axis, (core, radius) in zip(axes, SIZES.items(), strict=True):
        picture, widths, depths = [], {}, {}
        for density in DENSITIES:
            for packing in PACKINGS:
                made = material(
                    {
                        "family": "metasurface",
                        "substrate": "glass",
                        "particle": {"material": core, "radius_nm": radius},
                        "monolayer": {"density_per_um2": density, "packing": packing},
                        "model": {"correction": "qca-balanced"},
                    }
                )
                f = np.asarray(made.bsdf(COARSE).lobes[1].evaluate(np.broadcast_to(wi, wo.shape), wo))
                xyz = np.asarray(spectrum_to_xyz(f, COARSE))
                picture.append(xyz)
                y = xyz[:, 1]
                at = int(np.argmin(np.abs(theta - np.radians(30.0))))
                depths[density, packing] = float(y[at] / y.max())
                half = np.sin(theta[:at][y[:at] > 0.5 * y.max()])
                widths[density, packing] = float(0.5 - half[-1]) if half.size else 1.5
        image = np.stack(picture)
        shown = srgb_encode(np.clip(xyz_to_srgb_linear(image / image[..., 1].max()), 0, 1))
        axis.imshow(shown, aspect="auto", extent=(-80, 80, len(picture), 0), interpolation="nearest")
        axis.set_yticks(np.arange(9) + 0.5, [f"{d:g}, {p:g}" for d in DENSITIES for p in PACKINGS], fontsize=6)
        axis.set(title=f"{core}: density / um$^{{-2}}$, p", xlabel="view / degrees")
        dark = [depths[DENSITIES[-1], p] for p in PACKINGS]
        width = [widths[d, PACKINGS[-1]] for d in DENSITIES]
        rows += [
            (f"{core} r = {radius:g} nm on glass, p x density: correlation darkens the specular direction",
             "darker with p", f"{', '.join(f'{v:.2f}' for v in dark)} of the largest Y at p = {PACKINGS}",
             bool(np.all(np.diff(dark) < 0))),
            (f"{core}: the density controls the extent of the dark area at p = 0.5",
             "wider with density",
             f"half width in sin(theta) {', '.join(f'{v:.2f}' for v in width)} at {DENSITIES} /um^2",
             bool(np.all(np.diff(width) > 0))),
        ]  # fmt: skip
    return rows


def phi_mean(layer: Monolayer, theta_i: Array, theta_s: Array) -> Array:
    """Incoherent power per particle, azimuth-averaged, both outgoing polarisations, `[s, i, pol]`."""
    mu, w = hemisphere_rule(24)
    cosines = np.concatenate([mu, np.cos(theta_i), np.cos(theta_s)])
    sides = [(layer.illuminate(cosines), np.concatenate([w, np.zeros(cosines.size - 24)]))]
    if layer.transmits_below:
        mu_b, w_b = hemisphere_rule(20, layer.surface.index_below)
        sides.append((layer.illuminate(mu_b, True), w_b))
    term = diffuse_term(layer, sides, 14, symmetric=False)
    k, density = layer.surface.wavenumber, layer.structure.density_per_nm2
    phi = 2 * np.pi * np.arange(72) / 72
    out = np.empty((theta_s.size, theta_i.size, 2))
    for i, t in enumerate(theta_i):
        square = np.sin(t) ** 2 + np.sin(theta_s)[:, None] ** 2 - 2 * np.sin(t) * np.sin(theta_s)[:, None] * np.cos(phi)
        s = layer.structure.structure_factor(k * np.sqrt(np.maximum(square, 0.0)))
        for pol in range(2):
            rows = 24 + theta_i.size + np.arange(theta_s.size)
            harmonics = term.coherent[rows, 24 + i, :, pol].sum(axis=1) / density
            out[:, i, pol] = (harmonics @ np.cos(np.arange(14)[:, None] * phi) * s).mean(axis=1)
    return out


def distance(ours: Array, truth: Array, theta_s: Array) -> float:
    """The mean over incidences and polarisations of the relative L2 over scattering angles."""
    sine = np.sin(theta_s)[:, None, None]
    return float(np.mean(np.sqrt(np.sum(sine * (ours - truth) ** 2, 0) / np.sum(sine * truth**2, 0))))


def interaction_rows(axis: Any) -> list[Row]:
    """Multipoles of the spheres converged, those that neighbours exchange up to L = 1..4."""
    if not REFERENCE.is_dir():
        return [("what L = 3 and 4 change", "shown", "the reference ensembles are not here", False)]
    lines, changes = [], {}
    for name in "BCDEF":
        data = np.load(REFERENCE / f"ensemble_{name}.npz")
        films = list(zip(data["film_n"], data["film_h_nm"], strict=True))
        indices = np.array([1.0, *(n for n, _ in films), complex(data["n_substrate"])], dtype=complex)
        surface = Substrate(float(data["wavelength_nm"]), indices, np.array([h for _, h in films], dtype=float))
        k, radius, n = surface.wavenumber, float(data["radius_nm"]), complex(data["n_sphere"])
        structure = hard_disk_structure(float(data["density_per_nm2"]), float(data["packing_p"]), 3.2 * k)

        def t_matrix(order: int, x: float = k * radius, m: complex = n) -> NDArray[np.complex128]:
            a, b = mie_coefficients(order, np.array([x]), np.array([m]))
            return np.concatenate([-b, -a])

        full = choose_order(surface, radius, t_matrix)
        theta_i, theta_s = data["theta_i_rad"], data["theta_s_rad"]
        truth = data["incoherent_nm2_per_sr"].mean(axis=2).sum(axis=0)
        found = {}
        for label, order, exchanged in (("2|2", 2, 2), *((f"{full}|{l}", full, l) for l in (1, 2, 3, 4))):
            particle = Particle(1.0, radius, t_matrix(order))
            layer = Monolayer(surface, (particle,), structure, interaction_order=exchanged)
            found[label] = phi_mean(layer, theta_i, theta_s)
        best = found[f"{full}|4"]
        steps = [distance(found[f"{full}|{l}"], best, theta_s) for l in (1, 2, 3)]
        changes[name] = steps
        own, far = distance(found["2|2"], truth, theta_s), distance(best, truth, theta_s)
        truncation = distance(found["2|2"], best, theta_s)
        lines.append(
            f"{name} (order {full}): L 1, 2, 3 against 4: {', '.join(f'{v:.3f}' for v in steps)}; to the ensemble "
            f"{own:.3f} with spheres of order 2 as it has, {far:.3f} with all (those alone change {truncation:.3f})"
        )
        axis.semilogy([1, 2, 3], steps, "o-", label=name)
    axis.set(xlabel="highest multipole L that neighbours exchange", ylabel="change against L = 4", xticks=[1, 2, 3])
    axis.legend(fontsize=7)
    worst = [max(c[i] for c in changes.values()) for i in range(3)]
    return [
        ("QCA with L = 3 and 4 against ensembles: L = 3 is enough", "shown; L = 3 within 1 %", "; ".join(lines),
         worst[2] < 0.01 and worst[2] < worst[1] < worst[0]),
    ]  # fmt: skip


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(15, 6.8))
    axes[1, 3].set_axis_off()
    table = hemisphere_rows(axes[0, :3]) + backscatter_rows(axes[0, 3])
    table += map_rows(axes[1, :2]) + interaction_rows(axes[1, 2])
    figure.tight_layout()
    path = finish(figure, out_dir, "metasurface_order_and_model.png", dpi=110)
    return [row(*line, path) for line in table]


if __name__ == "__main__":
    main()
