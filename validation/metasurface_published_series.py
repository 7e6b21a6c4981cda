"""Further series of the source on disordered metasurfaces (Vynck et al., Nature Materials 21, 1035, 2022).

Silver on oxide of growing thickness, silicon over angle and density, the halo over incidence, density and a spread of
sizes, and the source's experiment with its square silicon disks taken as spheres of equal volume. Its colours and
statements are of pictures; the measures below are ours and are named in each row.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from nacre.light import spectrum_to_xyz, xyz_to_lab
from nacre.material.material import material
from validation._rows import finish, row

OXIDES_NM = (2.0, 100.0, 200.0, 400.0, 600.0)
INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
DISK_NM = (175.0, 145.0)  # side and height of the fabricated silicon squares
WAVELENGTHS = np.arange(380.0, 781.0, 20.0)
DIP_DEG = 4.0  # the middle of the dark disk lies within this of the specular direction
VIVID = 15.0  # CIELAB chroma of a colour that nobody calls grey
PALE = 20.0  # chroma below which a bluish colour is still called a bluish grey


def metasurface(substrate: str, core: str, radius_nm: float, monolayer: dict[str, Any], **more: Any) -> Any:
    """Return a material."""
    layers = more.pop("layers", [])
    return material(
        {
            "family": "metasurface",
            "substrate": substrate,
            "layers": layers,
            "particle": {"material": core, "radius_nm": radius_nm, **more},
            "monolayer": monolayer,
            "model": {"correction": "qca-balanced"},
        }
    )


def on_oxide(thickness_nm: float) -> Any:
    """Silver on oxide on silicon; on the native oxide with the gap of 1 nm that makes the series converge."""
    gap = {"gap_nm": 1} if thickness_nm < 5 else {}
    layers = [{"material": "SiO2", "thickness_nm": thickness_nm}]
    return metasurface("Si", "Ag", 90, {"coverage": 0.1}, layers=layers, **gap)


def hue(spectrum: np.ndarray) -> np.ndarray:
    """CIELAB of reflectances `[..., wavelength]`, each scaled to Y = 0.5: the colour without its lightness."""
    xyz = np.asarray(spectrum_to_xyz(spectrum, WAVELENGTHS))
    return np.asarray(xyz_to_lab(0.5 * xyz / xyz[..., 1:2]))


def chroma(lab: np.ndarray) -> np.ndarray:
    """C*, `[...]`."""
    return np.hypot(lab[..., 1], lab[..., 2])


def spread(lab: np.ndarray) -> float:
    """Root mean square distance of colours from their mean."""
    flat = lab.reshape(-1, 3)
    return float(np.sqrt(np.mean(np.sum((flat - flat.mean(axis=0)) ** 2, axis=1))))


def plane(made: Any, incidence_deg: float, wavelength_nm: float | np.ndarray, theta_deg: np.ndarray) -> np.ndarray:
    """BRDF in the plane of incidence, `[angle, wavelength]`; positive angles on the specular side."""
    t, i = np.radians(theta_deg), np.radians(incidence_deg)
    wi = np.array([np.sin(i), 0.0, np.cos(i)])
    wo = np.stack([-np.sin(t), 0 * t, np.cos(t)], axis=1)
    bsdf = made.bsdf(np.atleast_1d(np.asarray(wavelength_nm, dtype=float)))
    return np.asarray(bsdf.evaluate(np.broadcast_to(wi, wo.shape), wo))


def oxide_rows(axes: Any) -> list[tuple[str, str, str, bool]]:
    """Lobes at 400 nm, and colours, over the thickness of the oxide."""
    lobes, colours = [], []
    for h in OXIDES_NM:
        made = on_oxide(h)
        data = made.figure_data("scattering", wavelength_nm=400.0, theta_deg=30.0)
        total = data["s"] + data["p"]
        lobes.append(len(find_peaks(total, prominence=0.05 * total.max())[0]))
        axes[0].plot(data["theta_deg"], total / total.max() + len(lobes), label=f"{h:g} nm")
        diffuse = made.spectrum(np.radians([30.0]), WAVELENGTHS).diffuse_reflectance[0]
        colours.append(hue(diffuse))
        axes[1].plot(WAVELENGTHS, diffuse, label=f"h = {h:g} nm")
    axes[0].set(xlabel="scattering angle / degrees", ylabel="400 nm, scaled, set apart")
    axes[1].set(xlabel="wavelength / nm", ylabel="diffuse reflectance, 30 degrees")
    axes[1].legend(fontsize=6)
    grows = bool(np.all(np.diff(lobes) >= 0) and lobes[-1] > lobes[0])
    return [
        ("Ag on SiO2 on Si: scattering diagrams at 400 nm gain lobes with h", "more lobes",
         f"{lobes} lobes (over 5 % of the largest) at h = {[int(h) for h in OXIDES_NM]} nm", grows),
        ("vivid diffuse colours appear out of a pale bluish grey as h grows from 0 (native oxide) to 600 nm",
         "pale and bluish, then vivid",
         f"C* at equal Y: {[round(float(chroma(c))) for c in colours]}, vivid: over {VIVID:g}; b* at h = 0: "
         f"{colours[0][2]:.0f}", bool(chroma(colours[0]) < PALE and colours[0][2] < 0
                                      and min(float(chroma(c)) for c in colours[2:]) > VIVID)),
    ]  # fmt: skip


def silicon_rows(axes: Any) -> list[tuple[str, str, str, bool]]:
    """Colours over angle and density."""
    made = metasurface("glass", "Si", 75, {"coverage": 0.1})
    densities, angles = np.array([1.0, 3.0, 5.66, 8.0]), np.array([0.0, 20.0, 40.0, 60.0])
    found = {}
    for axis, part in zip(axes, ("diffuse", "specular"), strict=True):
        data = made.figure_data("colour-map", part=part, densities_per_um2=densities, angles_deg=angles)
        lab = np.array([hue(values) for values in data["reflectance"]])
        found[part] = spread(lab)
        for colours, density in zip(lab, densities, strict=True):
            axis.plot(colours[:, 1], colours[:, 2], "o-", ms=3, label=f"{density:g} /um$^2$")
        axis.set(xlabel="a*", ylabel="b*", title=part, aspect="equal", xlim=(-90, 90), ylim=(-90, 90))
        axis.legend(fontsize=6)
    return [
        ("Si r = 75 nm on glass: the diffuse colour hardly depends on angle and density, the specular one strongly",
         "hardly, strongly",
         f"rms spread of a*b* at equal Y: {found['diffuse']:.1f} diffuse, {found['specular']:.1f} specular",
         found["diffuse"] < 0.5 * found["specular"]),
    ]  # fmt: skip


def halo_rows(axes: Any) -> list[tuple[str, str, str, bool]]:
    """Where the dark disk and the ring lie, over incidence, density and sizes."""
    theta = np.arange(-85.0, 85.1, 1.0)
    wavelength = 450.0
    ordered = metasurface("glass", "Ag", 90, {"density_per_um2": 5, "packing": 0.5})
    loose = metasurface("glass", "Ag", 90, {"density_per_um2": 5})
    flanks, rings, middles = [], [], []
    sines = np.sin(np.radians(theta))
    for incidence in INCIDENCES_DEG:
        ratio = (plane(ordered, incidence, wavelength, theta) / plane(loose, incidence, wavelength, theta))[:, 0]
        axes[0].plot(theta, ratio, label=f"{incidence:g} degrees")
        specular = np.sin(np.radians(incidence))
        # from the specular direction out to where the ratio is half of 1
        inner = float(sines[(ratio > 0.5) & (sines < specular)][-1])
        flanks.append(specular - inner)
        outer = sines[(ratio > 0.5) & (sines > specular)]
        if outer.size:
            middle = 0.5 * (inner + float(outer[0]))
            middles.append(float(np.degrees(np.arcsin(middle)) - incidence))
        peak = find_peaks(ratio[sines < specular], prominence=0.1)[0]
        if peak.size:
            rings.append(float(specular - sines[sines < specular][peak[-1]]))
    axes[0].set(xlabel="view / degrees", ylabel="p = 0.5 over p = f, 450 nm")
    axes[0].legend(fontsize=6)
    off = float(np.max(np.abs(middles)))
    narrow = metasurface("glass", "Ag", 90, {"density_per_um2": 2.5, "packing": 0.5})
    few = metasurface("glass", "Ag", 90, {"density_per_um2": 2.5})
    at = (plane(narrow, 30.0, wavelength, theta) / plane(few, 30.0, wavelength, theta))[:, 0]
    inner = theta < 30.0
    peak = find_peaks(at[inner], prominence=0.1)[0]
    small = 0.5 - float(np.sin(np.radians(theta[inner][peak[-1]])))
    rows = [
        ("Ag halo: the dark disk follows the specular direction for all incidence angles", "follows",
         f"its middle is at most {off:.1f} degrees off where both its flanks lie above the horizon ({len(middles)} of "
         f"5 incidences to 60 degrees); its inner flank is {min(flanks):.2f} to {max(flanks):.2f} in sin(theta) away",
         off < DIP_DEG and max(flanks) < 1.1 * min(flanks)),
        ("Ag halo: the ring keeps its size in sin(theta) over incidence", "follows",
         f"radius {[round(r, 2) for r in rings]}; at normal incidence and 450 nm it is below the horizon",
         bool(len(rings) >= 4 and np.ptp(rings) < 0.06)),
        ("Ag halo: the ring shrinks as density falls", "by the root of the density, 0.71",
         f"{small / rings[-3]:.2f} from 5 to 2.5 /um^2", abs(small / rings[-3] - 0.5**0.5) < 0.07),
    ]  # fmt: skip
    spread_sizes = metasurface("glass", "Ag", 90, {"density_per_um2": 5, "packing": 0.5}, deviation_nm=9)
    depth = []
    for made in (ordered, spread_sizes):
        f = plane(made, 30.0, wavelength, theta)[:, 0]
        axes[1].plot(theta, f)
        depth.append(float(f[np.argmin(np.abs(theta - 30.0))] / f.max()))
    axes[1].set(xlabel="view / degrees", ylabel="BRDF / sr$^{-1}$; radii spread by 0, 10 %")
    rows.append(
        ("polydispersity 10 %: the halo survives", "survives",
         f"specular direction at {depth[1]:.2f} of the maximum, {depth[0]:.2f} for equal sizes", depth[1] < 0.4),
    )  # fmt: skip
    return rows


def polydisperse_colour_row() -> tuple[str, str, str, bool]:
    """Diffuse iridescence with spread sizes."""
    change = []
    theta = np.array([-40.0, 0.0, 60.0])
    for deviation in (0.0, 9.0):
        layers = [{"material": "SiO2", "thickness_nm": 400}]
        made = metasurface("Si", "Ag", 90, {"coverage": 0.1}, layers=layers, deviation_nm=deviation)
        change.append(spread(hue(plane(made, 20.0, WAVELENGTHS, theta))))
    return (
        "polydispersity 10 %: the diffuse iridescence on 400 nm of oxide survives", "survives",
        f"rms spread of a*b* over three views: {change[1]:.1f}, {change[0]:.1f} for equal sizes",
        change[1] > 0.5 * change[0],
    )  # fmt: skip


def experiment_rows(axes: Any) -> list[tuple[str, str, str, bool]]:
    """Luminance over incidence and view."""
    side, height = DISK_NM
    radius = (3 * side**2 * height / (4 * np.pi)) ** (1 / 3)
    incidences, views = np.arange(0.0, 61.0, 10.0), np.arange(-70.0, 71.0, 5.0)
    maps = []
    for axis, packing in zip(axes, ({}, {"packing": 0.5}), strict=True):
        made = metasurface("SiO2", "Si", float(radius), {"density_per_um2": 3.14, **packing})
        bsdf = made.bsdf(WAVELENGTHS)
        ti, to = np.radians(incidences)[:, None], np.radians(views)[None, :]
        zero = np.zeros((incidences.size, views.size))
        wi = np.stack([np.sin(ti) + zero, zero, np.cos(ti) + zero], axis=-1)
        wo = np.stack([-np.sin(to) + zero, zero, np.cos(to) + zero], axis=-1)
        values = bsdf.evaluate(wi, wo)
        maps.append(np.asarray(spectrum_to_xyz(values, WAVELENGTHS))[..., 1])
        axis.pcolormesh(views, incidences, maps[-1], shading="nearest")
        axis.set(
            xlabel="view / degrees",
            ylabel="incidence / degrees",
            title=f"luminance, p = {made.model.structure.packing:.2g}",
        )
    ratio = maps[1] / maps[0]
    there = views[np.argmin(ratio, axis=1)]
    off = float(np.max(np.abs(there - incidences)))
    dark = float(np.max(np.min(ratio, axis=1)))
    beyond = float(np.min(np.max(ratio, axis=1)))
    note = f"square disks as spheres of equal volume, r = {radius:.0f} nm; p = f = 0.103 for 0.1"
    return [
        ("experiment: p = 0.5 fades to black towards the specular direction and follows it", "black, follows",
         f"at most {dark:.2f} of p = 0.1, darkest within {off:g} degrees of specular at all incidences; {note}",
         dark < 0.35 and off <= 10.0),
        ("experiment: p = 0.5 is brighter beyond the dark disk", "brighter", f"at least {beyond:.2f} of p = 0.1",
         beyond > 1.0),
    ]  # fmt: skip


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(15, 6.5))
    table = oxide_rows(axes[0, :2]) + silicon_rows(axes[0, 2:])
    table += [*halo_rows(axes[1, :2]), polydisperse_colour_row(), *experiment_rows(axes[1, 2:])]
    figure.tight_layout()
    path = finish(figure, out_dir, "metasurface_published_series.png", dpi=110)
    return [row(*line, path) for line in table]


if __name__ == "__main__":
    main()
