"""Fabrication files and figures of a metasurface."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import UnsupportedError
from nacre.families.contract import Figure
from nacre.families.metasurface.ensemble.supercells import draw_species
from nacre.families.metasurface.material import Metasurface
from nacre.families.metasurface.monolayer.structure import PACKING_LIMIT, hard_disk_structure
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, as_blocks
from nacre.families.metasurface.tmatrix.particle_on_stack import amplitude
from nacre.families.metasurface.tmatrix.tmatrix_file import MAX_BYTES, write_tmatrices
from nacre.matter.drawings import DrawingRequest, LayerSheet, Layout
from nacre.matter.indices.constant import OpticalConstant

HIGHEST_EXPORTED = 15  # a higher order has 500 MB for 48 wavelengths before compression


def particle_t_matrices(material: Metasurface) -> AxialTMatrices:
    """Return the T-matrices for one particle (mean size) at the material's wavelengths.

    Spheres get the multipoles needed on their stack, at most 15; particles from files all available.

    Raises:
        MultipoleConvergenceError, MaterialRangeError: see `Metasurface.monolayer`.
    """
    if material.body is not None:
        return material.body.exported_t_matrices(material.wavelengths_nm)
    surfaces = [material.surface(w) for w in material.wavelengths_nm]
    lmax = min(max(material.order(s) for s in surfaces), HIGHEST_EXPORTED)
    radius = float(np.dot(material.sizes.radii_nm, material.sizes.shares))
    assert material.core is not None  # known for spheres
    blocks = np.stack([as_blocks(material.t_matrix(lmax, s, radius)) for s in surfaces])
    outer = material.outer_radius_nm
    index = None if material.shell is not None else material.core.n_complex(material.wavelengths_nm)
    ambient = np.array([s.inner_index for s in surfaces])
    name = f"sphere of {material.core.name}, radius {outer:g} nm"
    return AxialTMatrices(material.wavelengths_nm, blocks, ambient, name, outer, 2 * outer, outer, index)


def write_particle(material: Metasurface, path: Path, description: str) -> list[str]:
    """Write the particle's T-matrices as `*.tmat.h5`; return notes on omitted material properties.

    Raises:
        UnsupportedError: they are too large.
        NacreError: the file cannot be written.
    """
    known = particle_t_matrices(material)
    size = len(known.wavelengths_nm) * (2 * known.lmax * (known.lmax + 2)) ** 2 * 16
    if size > MAX_BYTES:
        raise UnsupportedError(f"{path}: the T-matrices would take {size >> 20} MB; fewer multipoles are needed")
    shape = "sphere" if material.body is None else material.body.shape
    method = "Mie" if material.body is None else material.body.method
    if material.shell is not None:
        shape = ""  # shapes in the format have one material
    error = None if material.body is None else material.body.estimated_error
    if error is not None:
        method += f", estimated relative error {error:.1g}"
    write_tmatrices(path, known, shape, method, description)
    lost = ["the stack, the density and the order: a T-matrix is of one particle alone"]
    if len(material.sizes.radii_nm) > 1:
        lost.append("the spread of sizes: the mean one was taken")
    if material.second is not None:
        lost.append("the second species of the mixture: the first was taken")
    return lost


PERIOD_POINTS = 20_000  # S(q) equals the endless pattern for q above some 2 pi / period
REFERENCE_NM = 550.0
COLUMNS = ("position", "material", "quantity", "value", "n_550nm", "k_550nm", "source")


def layout(material: Metasurface, request: DrawingRequest) -> Layout:
    """Return one period with about 20 000 particles, repeated over the requested area in whole periods.

    Raises:
        UnsupportedError: only S(q) is known.
    """
    columns, rows = 1, 1
    count = PERIOD_POINTS
    density_per_um2 = material.structure.density_per_nm2 * 1e6
    if request.size_mm is not None:
        # limit the period to a small field's longer side
        count = min(count, max(50, math.ceil(density_per_um2 * (1e3 * max(request.size_mm)) ** 2)))
    pattern = material.pattern(count, request.seed)
    box_um = pattern.box_nm * 1e-3
    if request.size_mm is not None:
        columns, rows = (max(1, math.ceil(1e3 * side / box_um - 1e-9)) for side in request.size_mm)
    nouns = " and ".join(species.noun for species in material.all_species)
    seed = request.seed if request.seed is not None else getattr(material.arrangement, "seed", None)
    which, radii = _drawn_species(material, len(pattern.xy_nm), seed)
    facts: dict[str, Any] = {
        "radii_spread": any(len(species.sizes.radii_nm) > 1 for species in material.all_species),
        "arrangement": material.structure.name,
        "density_per_um2": density_per_um2,
        "packing": material.structure.packing,
        "seed": seed,
        "shape": f"circles are the outlines of {nouns}, seen from above",
    }
    if len(radii) > 1:
        repeated = columns * rows
        facts["kinds"] = [
            {"shape": species.noun, "radius_um": r, "particles": int(np.count_nonzero(which == n)) * repeated}
            for n, (species, r) in enumerate(zip(material.all_species, radii))
        ]
    return Layout(pattern.xy_nm * 1e-3, radii[0], box_um, (columns, rows), facts, radii_um=radii, species=which)


def _drawn_species(material: Metasurface, count: int, seed: int | None) -> tuple[NDArray[np.intp], tuple[float, ...]]:
    """Return the species number per particle, drawn by the shares, and the species radii in um."""
    which = draw_species(
        count, np.array([species.share for species in material.all_species]), np.random.default_rng((seed or 0, count))
    )
    return which, tuple(round(species.outer_radius_nm * 1e-3, 9) for species in material.all_species)


def layer_sheet(material: Metasurface) -> LayerSheet:
    """Return the material and thickness table, from the light's side inward."""
    entries: list[tuple[str, OpticalConstant, str, float | str]] = [("ambient", material.ambient, "", "")]
    for species, name in zip(material.all_species, ("", "second ")):
        if species.shell is not None:
            entries.append((f"{name}shell", species.shell.material, "thickness_nm", species.shell.thickness_nm))
        if species.core is not None:
            entries.append((f"{name}core", species.core, "radius_nm", species.core_radius_nm))
        if species.gap_nm and not material.host:
            entries.append((f"{name}gap", material.ambient, "thickness_nm", species.gap_nm))
    entries += [(str(k), m, "thickness_nm", d) for k, (m, d) in enumerate(material.layers, start=1)]
    entries.append(("substrate", material.substrate, "", ""))
    remarks = [
        f"{material.structure.density_per_nm2 * 1e6:.6g} particles a um^2, packing {material.structure.packing:.4g}, "
        f"{material.structure.name}"
    ]
    for species, name in zip(material.all_species, ("particles", "second particles")):
        if len(material.all_species) > 1:
            remarks.append(f"{name}: {100 * species.share:.4g} % of them, {species.noun}")
        if species.body is not None:
            place = "" if material.host else f", {species.gap_nm:g} nm above the layers"
            with_coat = "" if species.shell is None else " with the shell"
            remarks.append(
                f"{name}: {species.body.name}, {2 * species.body.radius_nm:.6g} nm wide, "
                f"{species.body.height_nm:.6g} nm high{with_coat}{place}"
            )
        if material.host:
            remarks.append(
                f"{name}: inside layer {material.host}, their tops {species.depth_nm:g} nm below the top of the layers"
                f", {species.gap_nm:g} nm over its lower face"
            )
        if len(species.sizes.radii_nm) > 1:
            shares, radii = np.array(species.sizes.shares), np.array(species.sizes.radii_nm)
            spread = float(np.sqrt(shares @ (radii - species.mean_radius_nm) ** 2))
            remarks.append(f"{name}: the radii spread by {spread:.4g} nm about their mean")
    rows = []
    for position, medium, quantity, value in entries:
        low, high = medium.range_nm
        n = complex(medium.n_complex(np.array([min(max(REFERENCE_NM, low), high)]))[0])
        shown = float(value) if value != "" else ""
        rows.append(dict(zip(COLUMNS, (position, medium.name, quantity, shown, n.real, n.imag, medium.source))))
    return LayerSheet(COLUMNS, tuple(rows), tuple(remarks), "sheet", "pattern")


MAP_DENSITIES = 13
SHOWN_POINTS = 600


def scattering(material: Metasurface, wavelength_nm: float = 400.0, theta_deg: float = 0.0) -> dict[str, NDArray[Any]]:
    """d sigma/d Omega for one particle on its stack in the incidence plane, um^2/sr.

    `theta_deg[t]` is the signed scattering angle from the normal, positive on the specular side.

    Raises:
        UnsupportedError: the particles are aligned.
    """
    if material.is_aligned:
        raise UnsupportedError(
            f"{material.source}: the scattering of one particle that points one way is not drawn; "
            "the lobe of the layer is (--kind lobe)"
        )
    sphere = material.monolayer(wavelength_nm).spheres[len(material.sizes.shares) // 2]
    theta = np.arange(-89.5, 90.0, 0.5)
    scattered = sphere.directions(np.cos(np.radians(np.abs(theta))))
    incident = sphere.directions([np.cos(np.radians(theta_deg))])
    f = amplitude(sphere.harmonics(scattered, incident), [0.0, np.pi])
    side = np.where(theta >= 0, 0, 1)
    power = np.abs(f[:, np.arange(theta.size), :, 0, side]) ** 2 * 1e-6  # angle, pol_s, pol_i
    summed = power.sum(axis=1)
    return {
        "theta_deg": theta,
        "s": summed[:, 0],
        "p": summed[:, 1],
        "title": np.array(f"{wavelength_nm:g} nm, incidence {theta_deg:g} degrees"),
    }


def structure(material: Metasurface) -> dict[str, NDArray[Any]]:
    """S over q a for the arrangement, and a pattern section if available."""
    made = material.structure
    q = np.linspace(0.0, 20.0, 801)
    points = {}
    if material.arrangement is not None:
        pattern = material.pattern(SHOWN_POINTS)
        xy = pattern.xy_nm
        side = (SHOWN_POINTS / made.density_per_nm2) ** 0.5
        points["xy_um"] = xy[np.all(xy < side, axis=1)] * 1e-3
    return points | {
        "q": q,
        "sq": made.structure_factor(q / made.diameter_nm)[None],
        "labels": np.array([f"{made.name}, p = {made.packing:.3g}"]),
        "q_label": np.array("q a"),
        "radius_um": np.array(material.outer_radius_nm * 1e-3),
    }


def colour_map(
    material: Metasurface, part: str = "diffuse", densities_per_um2: Any = None, angles_deg: Any = None
) -> dict[str, NDArray[Any]]:
    """Spectra over (density, angle): hemispherical diffuse or specular reflectance, `reflectance[y, x, l]`.

    Args:
        part: "diffuse" or "specular".
        densities_per_um2: default: from a tenth of the material's density to three times it, limited by the packing.
        angles_deg: incidence; default: 0 to 80 in 10 degree steps.
    """
    if part not in ("diffuse", "specular"):
        raise UnsupportedError(f'part = "{part}" is not known; use diffuse or specular')
    own = material.structure.density_per_nm2
    widest = max(species.reach_nm for species in material.all_species)  # circumscribing spheres must not overlap
    if densities_per_um2 is None:
        most = min(3 * own, 0.99 * PACKING_LIMIT / (np.pi * widest**2))
        densities = np.linspace(0.1 * own, most, MAP_DENSITIES)
    else:
        densities = np.asarray(densities_per_um2, dtype=float) * 1e-6
    angles = np.arange(0.0, 81.0, 10.0) if angles_deg is None else np.asarray(angles_deg, dtype=float)
    # coarse steps: each wavelength and density is a new mean field
    wavelengths = np.arange(380.0, 781.0, 20.0)
    rows = []
    for density in densities:
        packing = min(max(material.structure.packing, density * np.pi * widest**2), PACKING_LIMIT)
        q_max = float(material.structure.q_per_nm[-1])
        varied = dataclasses.replace(material, structure=hard_disk_structure(float(density), float(packing), q_max))
        # always by the mean field: a map has some 300 monolayers
        columns = [varied.powers(np.cos(np.radians(angles)), w) for w in wavelengths]
        rows.append(np.stack([c[2 if part == "diffuse" else 0].mean(axis=0) for c in columns], axis=-1))
    return {
        "y": densities * 1e6,
        "y_label": np.array("density / um$^{-2}$"),
        "angles_deg": angles,
        "wavelengths_nm": wavelengths,
        "reflectance": np.clip(np.array(rows), 0.0, 1.0),
        "title": np.array(f"{part} reflectance"),
    }


FIGURES: dict[str, Figure] = {"scattering": scattering, "structure": structure, "colour-map": colour_map}
