"""Pictures of disordered metasurfaces on a car, a sphere and a window (after Vynck et al., Nature Materials 2022).

The source's car stands before a gallery under a strip of sky; ours is another car in a street of our own, so the
statements are compared, not the pictures. The measures are ours and are named in each row.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.monolayer import PolarGrid, pack_triangle
from nacre.core.arrays import Array
from nacre.light import delta_e_2000, xyz_to_lab
from validation._rows import finish, row

Row = tuple[str, str, str, bool]

WAVELENGTHS = np.arange(380.0, 781.0, 20.0)
CAR_SIZE, CAR_SPP = (256, 144), 64
PROBE_SIZE, PROBE_SPP = (96, 96), 256
TINTED_GLASS = {"n": 1.5, "k": 0.01}
GREY = 12.0  # CIELAB chroma below which a colour counts as grey
BLOCK = 8  # pixels a side over which pictures are averaged before their colours are compared
JUST_NOTICEABLE = 1.0  # CIEDE2000


def silver(substrate: Any, packing: float | None, layers: tuple[Any, ...] = ()) -> Bsdf:
    """Silver spheres of 90 nm at 5 a square micrometre (f = 0.1 on the layered substrate, as in the source)."""
    monolayer: dict[str, Any] = {"coverage": 0.1} if layers else {"density_per_um2": 5}
    if packing is not None:
        monolayer["packing"] = packing
    recipe = {
        "family": "metasurface",
        "substrate": substrate,
        "layers": list(layers),
        "particle": {"material": "Ag", "radius_nm": 90},
        "monolayer": monolayer,
    }
    made: Bsdf = nacre.material(recipe).bsdf(WAVELENGTHS)
    return made


def bodies() -> dict[str, Any]:
    """The four bodies of the source's first figure."""
    bare = nacre.material({"family": "film", "substrate": TINTED_GLASS, "layers": []})
    return {
        "bare tinted glass": bare.bsdf(WAVELENGTHS),
        "Ag at random": silver(TINTED_GLASS, None),
        "Ag, p = 0.5": silver(TINTED_GLASS, 0.5),
        "Ag on 400 nm SiO2 on Si": silver("Si", None, ({"material": "SiO2", "thickness_nm": 400},)),
    }


def picture(material: Any, **settings: Any) -> Any:
    """Render, at a fixed exposure if none is asked for, so that pictures compare."""
    return nacre.render(material, **{"exposure": 0.0, "progress": False, "seed": 3, **settings})


def blocks(xyz: Array) -> Array:
    """Means over blocks of pixels, `[row, column, 3]`."""
    rows, columns = (n // BLOCK for n in xyz.shape[:2])
    cut = xyz[: rows * BLOCK, : columns * BLOCK]
    return np.asarray(cut.reshape(rows, BLOCK, columns, BLOCK, 3).mean(axis=(1, 3)))


def spread(lab: Array) -> float:
    """Root mean square distance of a*b* from their mean."""
    ab = lab[..., 1:]
    return float(np.sqrt(np.mean(np.sum((ab - ab.mean(axis=0)) ** 2, axis=-1))))


def car_rows(axes: Any) -> list[Row]:
    """The source's Fig. 1 in our street, and the last body under the bare sky and indoors."""
    made = bodies()
    shots, diffuse = {}, {}
    for axis, (name, bsdf) in zip(axes[0], made.items(), strict=True):
        shot = picture(bsdf, scene="body", light="street", size=CAR_SIZE, spp=CAR_SPP)
        shots[name] = np.asarray(shot.xyz)
        axis.imshow(shot.srgb8)
        axis.set_title(name, fontsize=8)
    paint = np.abs(shots["Ag at random"] - shots["bare tinted glass"])[..., 1] > 0.02
    names = list(made)
    for name in names[1:]:
        part = picture(made[name], scene="body", light="street", size=CAR_SIZE, spp=CAR_SPP, components="diffuse")
        diffuse[name] = np.asarray(part.xyz)
    for axis, (name, light) in zip(
        axes[1],
        ((names[2], "sky"), (names[3], "sky"), (names[2], "interior"), (names[3], "interior")),
        strict=True,
    ):
        shot = picture(made[name], scene="body", light=light, size=CAR_SIZE, spp=CAR_SPP, exposure="auto")
        axis.imshow(shot.srgb8)
        axis.set_title(f"{name}: {light}", fontsize=8)
    for axis in axes.ravel():
        axis.set_axis_off()
    share = {n: float(diffuse[n][paint][:, 1].sum() / shots[n][paint][:, 1].sum()) for n in diffuse}
    lab = {n: xyz_to_lab(_bright(part, paint)) for n, part in diffuse.items()}
    c = {n: float(np.median(np.hypot(values[:, 1], values[:, 2]))) for n, values in lab.items()}
    wide = {n: spread(values) for n, values in lab.items()}
    dark = float(np.median(shots[names[0]][paint][:, 1]))
    mirror = {n: made[n].specular(np.radians(30.0)).reflectance.mean() for n in names}
    return [
        ("car, bare tinted glass: specular, dominantly black", "black",
         f"median Y of the paint {dark:.3f} of paper 0.6",
         dark < 0.06),
        ("car, Ag at random: specular reflection reduced", "reduced",
         f"R at 30 degrees {mirror[names[1]]:.3f}, bare {mirror[names[0]]:.3f}; "
         f"{100 * share[names[1]]:.0f} % of the light is diffuse", mirror[names[1]] < mirror[names[0]]),
        ("car, Ag at random: nearly uniform diffuse grey", "grey, uniform",
         f"median C* of the diffuse light {c[names[1]]:.1f} (grey: below {GREY:g}), spread {wide[names[1]]:.1f}",
         c[names[1]] < GREY),
        ("car, correlated Ag: colours out of the grey", "vivid colours",
         f"spread of a*b* {wide[names[2]]:.1f}, at random {wide[names[1]]:.1f}", wide[names[2]] > 1.5 * wide[names[1]]),
        ("car, layered substrate: further enriched, a mix of colours", "richer",
         f"median C* {c[names[3]]:.1f}, spread {wide[names[3]]:.1f}; at random {c[names[1]]:.1f}, {wide[names[1]]:.1f}",
         wide[names[3]] > 1.5 * wide[names[1]]),
    ]  # fmt: skip


def _bright(xyz: Array, where: NDArray[np.bool_]) -> Array:
    """Block means of the paint scaled to Y = 0.5, the darkest left out, `[block, 3]`."""
    weight = blocks(np.repeat(where[..., None], 3, axis=-1).astype(float))
    mean = blocks(xyz * where[..., None]) / np.maximum(weight, 1e-9)
    kept = mean[weight[..., 0] > 0.6]
    kept = kept[kept[:, 1] > 0.2 * np.median(kept[:, 1])]
    return np.asarray(0.5 * kept / kept[:, 1:2])


def thinned(bsdf: Bsdf, angles: int, wavelengths: int) -> Bsdf:
    """The material on a grid `angles` times coarser over both angles and `wavelengths` times over the spectrum."""
    specular, lobe = bsdf.lobes
    count = lobe.count_above // angles
    theta = PolarGrid(count).nodes
    x = theta * 2 / np.pi * (lobe.count_above - 0.5)
    low = np.minimum(x.astype(int), lobe.count_above - 2)
    part = (x - low)[:, None, None]
    full = np.empty((lobe.count_above, lobe.count_above, *lobe.above.shape[1:]), dtype=np.float32)
    rows, columns = np.tril_indices(lobe.count_above)
    full[rows, columns] = full[columns, rows] = lobe.above
    full = full[low] * (1 - part[..., None]) + full[low + 1] * part[..., None]
    full = full[:, low] * (1 - part) + full[:, low + 1] * part
    cut = slice(None, None, wavelengths)
    less = dataclasses.replace(
        lobe,
        above=np.ascontiguousarray(pack_triangle(full)[..., cut]),
        count_above=count,
        **{n: getattr(lobe, n)[..., cut] for n in ("below", "across", "above_free", "below_free", "across_free")},
        **{n: getattr(lobe, n)[cut] for n in ("wavelengths_nm", "wavenumbers", "index_below")},
    )
    return Bsdf((less,), {})


def convergence_rows(axis: Any) -> list[Row]:
    """How the picture of the probe changes as the grids get coarser."""
    recipe = {
        "family": "metasurface",
        "substrate": "Si",
        "layers": [{"material": "SiO2", "thickness_nm": 400}],
        "particle": {"material": "Ag", "radius_nm": 90},
        "monolayer": {"coverage": 0.1},
    }
    # angles and wavelengths of the stored grid: see `nacre.families.metasurface.monolayer.evaluation.choose_grids`
    whole: Bsdf = nacre.material(recipe).bsdf(np.arange(380.0, 781.0, 10.0))

    def lab(bsdf: Bsdf, seed: int) -> Array:
        settings: dict[str, Any] = {"size": PROBE_SIZE, "spp": PROBE_SPP, "exposure": 0.0, "progress": False}
        shot = nacre.render(bsdf, scene="probe", components="diffuse", seed=seed, **settings)
        return np.asarray(xyz_to_lab(blocks(np.asarray(shot.xyz))))

    best = lab(Bsdf((whole.lobes[1],), {}), 0)
    noise = float(np.mean(delta_e_2000(best, lab(Bsdf((whole.lobes[1],), {}), 1))))
    steps = {"angles": [(2, 1), (4, 1), (8, 1)], "wavelengths": [(1, 2), (1, 4), (1, 8)]}
    found: dict[str, list[float]] = {}
    for name, cases in steps.items():
        found[name] = [float(np.mean(delta_e_2000(best, lab(thinned(whole, *case), 2)))) for case in cases]
        axis.plot([2, 4, 8], found[name], "o-", label=name)
    axis.axhline(noise, color="grey", ls="--", label="noise of the picture")
    axis.set(xlabel="times coarser than stored (120 angles, 10 nm)", ylabel="mean CIEDE2000", xticks=[2, 4, 8])
    axis.legend(fontsize=7)
    return [
        (f"picture converged with the grid of {name}", f"below {JUST_NOTICEABLE:g}",
         f"mean CIEDE2000 {values[0]:.2f}, {values[1]:.2f}, {values[2]:.2f} for grids 2, 4, 8 times coarser; "
         f"noise {noise:.2f}", values[0] < JUST_NOTICEABLE and values[0] <= values[2])
        for name, values in found.items()
    ]  # fmt: skip


def window_scene(mi: Any, coated: Any, behind: bool, light: dict[str, Any] | None = None) -> Any:
    """A pane whose near (or far) face is coated, before a chessboard, or under a uniform light if `light` is given.

    The pane's narrow sides are mirrors, as if it went on: through open ones guided light would leave without the
    refraction that its radiance needs.
    """
    to = mi.ScalarTransform4f
    origin = [1.6, -3.4, 0.6] if not behind else [1.6, 3.4, 0.6]
    depth = 24 if light is None else 300  # guided light takes long to get out, and nothing may be lost
    stage: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": depth},
        "sensor": {
            "type": "perspective",
            "fov": 33,
            "to_world": to().look_at(origin, [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 160, "height": 160, "pixel_format": "rgb"},
        },
        "front": {"type": "rectangle", "to_world": to().rotate([1, 0, 0], 90), "bsdf": coated},
        "back": {
            "type": "rectangle",
            "to_world": to().translate([0, 0.1, 0]).rotate([1, 0, 0], -90),
            "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
        },
        "light": light or {"type": "constant", "radiance": 0.25},
    }
    mirror = {"type": "twosided", "bsdf": {"type": "conductor", "material": "none"}}
    for end in (-1, 1):
        thin = to().scale([1, 0.05, 1])
        for name, place in (
            ("side", to().translate([end, 0.05, 0]).rotate([0, 1, 0], 90)),
            ("rim", to().translate([0, 0.05, end])),
        ):
            stage[f"{name}_{end + 1}"] = {"type": "rectangle", "to_world": place @ thin, "bsdf": mirror}
    if light is None:
        board = {
            "type": "checkerboard", "color0": {"type": "uniform", "value": 0.05},
            "color1": {"type": "uniform", "value": 0.7}, "to_uv": to().scale([6, 3, 1]),
        }  # fmt: skip
        place = to().translate([-0.6, -1.6 if behind else 1.6, -0.7]).rotate([1, 0, 0], 90).scale([2.2, 0.7, 1])
        two = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": board}}
        stage["board"] = {"type": "rectangle", "to_world": place, "bsdf": two}
        sun = [0.4, 0.8, -0.5] if not behind else [0.4, -0.8, -0.5]
        stage["sun"] = {"type": "directional", "direction": sun, "irradiance": 1.5}
    return mi.load_dict(stage)


def window_rows(axes: Any) -> list[Row]:
    """A pane coated on one face, from both sides; and a lossless one in a uniform light, which must vanish."""
    from nacre.render import make_bsdf, use_variant

    mi = use_variant()
    halo = make_bsdf(silver("glass", 0.5))
    for axis, behind in zip(axes, (False, True), strict=True):
        shot = np.array(mi.render(window_scene(mi, halo, behind), spp=128, seed=1))
        axis.imshow(np.clip(shot, 0, 1) ** (1 / 2.2))
        axis.set_title(f"Ag on a pane, seen from {'behind' if behind else 'the coated side'}", fontsize=8)
        axis.set_axis_off()
    recipe = {
        "family": "metasurface",
        "substrate": {"n": 1.5},
        "particle": {"material": {"n": 3.5}, "radius_nm": 70},
        "monolayer": {"coverage": 0.1, "packing": 0.4},
        "model": {"multipole_order": 6, "correction": "qca-balanced"},
    }
    clear = make_bsdf(nacre.material(recipe).bsdf(WAVELENGTHS))
    uniform = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
    seen = []
    for behind in (False, True):
        shot = np.array(mi.render(window_scene(mi, clear, behind, uniform), spp=128, seed=2))
        pane = shot[60:100, 60:100]
        seen.append(float(pane.mean() / shot[:8, :8].mean()))
    return [
        ("window coated on one face, lossless, in uniform light: it vanishes from both sides", "1 within 2 %",
         f"{seen[0]:.4f} from the coated side, {seen[1]:.4f} from behind", max(abs(s - 1) for s in seen) < 0.02),
    ]  # fmt: skip


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figures, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = []
    cars, axes = plt.subplots(2, 4, figsize=(14, 4.6))
    table = car_rows(axes)
    more, others = plt.subplots(1, 3, figsize=(12, 3.8))
    rest = window_rows(others[:2]) + convergence_rows(others[2])
    for figure, name, part in (
        (cars, "metasurface_cars.png", table),
        (more, "metasurface_window_and_grids.png", rest),
    ):
        figure.tight_layout()
        path = finish(figure, out_dir, name, dpi=110)
        rows += [row(*line, path) for line in part]
    return rows


if __name__ == "__main__":
    main()
