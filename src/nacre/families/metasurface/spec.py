"""Metasurface recipe: keys, validation, construction, figures and exports."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from nacre.core.errors import MaterialRangeError, UnsupportedError, did_you_mean
from nacre.families.contract import Fabricable, Figure, OwnFormats, Writer
from nacre.families.metasurface.ensemble import EnsembleSettings
from nacre.families.metasurface.material import Metasurface
from nacre.families.metasurface.monolayer.arrangement import (
    ARRANGEMENTS,
    SUFFIXES,
    Arrangement,
    Pattern,
    is_picture,
    jittered_structure,
    pattern_structure,
    points_pattern,
    points_structure,
    sq_structure,
)
from nacre.families.metasurface.monolayer.structure import PACKING_LIMIT, Structure, hard_disk_structure
from nacre.families.metasurface.species import MAX_TOLERANCE, ParticleSpec, Species, mean_square_radius
from nacre.families.metasurface.supercells import draw_species
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, as_blocks
from nacre.families.metasurface.tmatrix.particle_on_stack import amplitude
from nacre.families.metasurface.tmatrix.substrate import LOSSLESS_K
from nacre.families.metasurface.tmatrix.tmatrix_file import write_tmatrices
from nacre.light import default_wavelengths
from nacre.matter.drawings import Drawer, DrawingRequest, LayerSheet, Layout
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec, ambient_in
from nacre.readers.curves import FileSpec
from nacre.readers.hdf5 import MAX_BYTES
from nacre.recipe.model import Positive, RecipeContext, RecipeModel, UnitNumber, show_value

LEAST_COVERAGE = 1e-4
LARGEST_REACH_UM = 4.0  # beyond ten wavelengths S(q) has more rings than light resolves, and needs minutes
MAX_THICKNESS_NM = 1e4


class LayerSpec(RecipeModel):
    """One layer in the stack."""

    forms: ClassVar[tuple[str, ...]] = ('{material = "SiO2", thickness_nm = 500}',)

    material: IndexSpec = Field(description="material of the layer")
    thickness_nm: Annotated[float, Field(ge=0.0, le=MAX_THICKNESS_NM)] = Field(
        description="geometric thickness of the layer", examples=[500]
    )


class StructureSpec(RecipeModel):
    """Particle arrangement: a name, or a table with the name and its parameters."""

    one_of: ClassVar[tuple[str, ...]] = ("name", "points", "sq")
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ({"enum": list(ARRANGEMENTS)},)

    name: Literal["hard-disk", "rsa", "poisson-disk", "lattice"] | None = Field(
        default=None, description="type of order; a name can replace the table", examples=["lattice"]
    )
    points: FileSpec | None = Field(
        default=None,
        description="in place of name: a file of particle positions, in um unless it or `unit` states another, or a "
        "picture of particles (png, tif, jpg, bmp), which needs width_um",
        examples=["xy.csv"],
    )
    width_um: Positive | None = Field(default=None, description="width of the picture that points names", examples=[10])
    sq: FileSpec | None = Field(
        default=None, description="in place of name: a file of the structure factor S(q)", examples=["s.csv"]
    )
    lattice: Literal["square", "hexagonal"] = Field(
        default="hexagonal", description='the lattice that is jittered, for name = "lattice"'
    )
    jitter: UnitNumber = Field(
        default=0.1, description="standard deviation of the jitter, in units of the lattice's constant"
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(default=0, description="seed of the random pattern")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_name(cls, data: Any) -> Any:
        if isinstance(data, str):
            if data not in ARRANGEMENTS:
                raise ValueError(
                    f"= {show_value(data)} is not known.{did_you_mean(data, ARRANGEMENTS)} "
                    f'Write {", ".join(ARRANGEMENTS)}, {{points = "xy.csv"}} or {{sq = "s.csv"}}'
                )
            return {"name": data}
        if not isinstance(data, Mapping | StructureSpec):
            raise ValueError(
                f'= {show_value(data)} is not a structure; write a name, {{points = "xy.csv"}} or {{sq = "s.csv"}}'
            )
        return data

    def model_post_init(self, _: Any) -> None:
        forms = [key for key in ("name", "points", "sq") if getattr(self, key) is not None]
        if len(forms) != 1:
            raise ValueError(f"gives {' and '.join(forms) or 'nothing'}; it needs one of name, points, sq")
        foreign = {"lattice": ("lattice",), "jitter": ("lattice",), "seed": ARRANGEMENTS}
        for key, names in foreign.items():
            if key in self.model_fields_set and self.name not in names:
                of = "arrangements that are drawn at random" if key == "seed" else 'name = "lattice"'
                what = f'name = "{self.name}"' if self.name else forms[0]
                raise ValueError(f"gives {key}, which {what} does not have; it is of {of}")
        is_image = self.points is not None and is_picture(self.points.file)
        if self.points is not None and is_image and self.width_um is None:
            raise ValueError(f'names a picture, points = "{self.points.file}", and not how wide it is; give width_um')
        if not is_image and self.width_um is not None:
            raise ValueError(f"gives width_um, which is of a picture; points should name one ({', '.join(SUFFIXES)})")


class MonolayerSpec(RecipeModel):
    """Particle density and order."""

    coverage: Positive | None = Field(
        json_schema_extra={"exclusiveMaximum": 0.9},
        default=None,
        description="share of the area that the particles cover: f = density pi r^2",
        examples=[0.1],
    )
    density_per_um2: Positive | None = Field(
        default=None, description="in place of coverage: number of particles in a square micrometre", examples=[2]
    )
    packing: Positive | None = Field(
        json_schema_extra={"maximum": PACKING_LIMIT},
        default=None,
        description="order of the particles: p = density pi a^2 / 4 with a the least distance of centres; "
        "without it p = f",
        examples=[0.3],
    )
    structure: StructureSpec = Field(
        default=StructureSpec(name="hard-disk"), description="kind of order: a name, or a table that leads to a file"
    )

    def model_post_init(self, _: Any) -> None:
        if (self.coverage is None) == (self.density_per_um2 is None) and self.structure.points is None:
            raise ValueError("needs either coverage or density_per_um2")
        for key in ("coverage", "density_per_um2", "packing"):
            if self.structure.points is not None and getattr(self, key) is not None:
                raise ValueError(
                    f'gives {key} and points = "{self.structure.points.file}", which says it; leave {key} out'
                )
        if self.coverage is not None and self.coverage >= 0.9:
            raise ValueError(
                f"coverage = {self.coverage:g} is not allowed; it should be below 0.9, and at most 0.7 of hard disks"
            )
        if self.packing is not None and self.packing > PACKING_LIMIT:
            raise ValueError(
                f"packing = {self.packing:g} is not allowed; it should be at most {PACKING_LIMIT:g}, "
                "where hard disks freeze"
            )


class EnsembleSpec(RecipeModel):
    """Ensemble size, for correction = "ensemble" or if "auto" selects one."""

    forms: ClassVar[tuple[str, ...]] = ("{spheres = 260, realisations = 24}",)

    spheres: Annotated[int, Field(ge=20, le=1000)] = Field(
        default=130, description="spheres of one pattern; the time grows with the cube"
    )
    realisations: Annotated[int, Field(ge=4, le=1000)] = Field(
        default=48, description="patterns; the standard error falls with the root"
    )
    multipole_order: Annotated[int, Field(ge=1, le=4)] = Field(
        default=2, description="highest multipole of a sphere in the ensemble and in the mean-field reference"
    )


class ModelSpec(RecipeModel):
    """Model details."""

    forms: ClassVar[tuple[str, ...]] = ("{tolerance = 0.005}", '{multipole_order = 6, correction = "optical-depth"}')

    multipole_order: Annotated[int, Field(ge=1, le=60)] | None = Field(
        default=None, description="highest multipole of one sphere; chosen by convergence if not given", examples=[6]
    )
    tolerance: Annotated[float, Field(ge=1e-5, le=MAX_TOLERANCE)] | None = Field(
        default=None,
        description="largest change of a sphere's far field when its order is doubled; a larger one "
        "is refused; default: 0.001, or up to 0.01 with a warning",
        examples=[0.005],
    )
    interaction_order: Annotated[int, Field(ge=1, le=4)] = Field(
        default=3, description="highest multipole that neighbouring spheres exchange"
    )
    correction: Literal[
        "auto", "ensemble", "qca-balanced", "qca-ladder", "gv-balanced", "optical-depth", "in-only", "in-out", "none"
    ] = Field(
        default="auto",
        description="treatment of the balance C between neighbouring spheres: a mean field "
        '("qca-balanced"), in seconds; a mean field with light exchanged by neighbours ("qca-ladder"), more accurate, '
        "in up to two seconds per wavelength; or solved patterns of many spheres "
        '("ensemble"), in minutes; "auto" chooses the mean field where its measured error is below 12 %',
    )
    ensemble: EnsembleSpec = Field(default=EnsembleSpec(), description="size of an ensemble")


@dataclass(frozen=True, eq=False)
class MetasurfaceModel(Metasurface, Fabricable, OwnFormats):
    """A metasurface from a recipe, with figures and drawings."""

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Single-particle scattering, arrangement and S(q), colour over density and angle."""
        return {name: partial(maker, self) for name, maker in FIGURES.items()}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """Particle layouts and list, and the layer sheet."""
        draw = partial(layout, self)
        return {"gds": draw, "oas": draw, "csv": draw, "sheet": lambda request: layer_sheet(self)}

    @property
    def own_formats(self) -> Mapping[str, Writer]:
        """The particle T-matrix."""
        return {"tmat": partial(write_particle, self)}


PARTICLE_NUMBERS = (
    "radius_nm",
    "diameter_nm",
    "height_nm",
    "edge_radius_nm",
    "shell.thickness_nm",
    "gap_nm",
    "depth_nm",
)


class MetasurfaceSpec(RecipeModel):
    """A disordered particle layer on a stack."""

    varies_by_nodes: ClassVar[tuple[str, ...]] = (
        *(f"particle.{key}" for key in PARTICLE_NUMBERS),
        *(f"particle.second.{key}" for key in (*PARTICLE_NUMBERS, "share")),
        "monolayer.coverage",
        "monolayer.density_per_um2",
        "monolayer.packing",
        "layers[].thickness_nm",
    )

    family: Literal["metasurface"] = Field(default="metasurface", description="the family's name")
    title: str = Field(default="", description="a title for figures", examples=["Silver on oxide"])
    ambient: IndexSpec = Field(
        default=IndexSpec.model_validate("air"), description="clear medium above, where the light comes from"
    )
    substrate: IndexSpec = Field(description="medium below the layers: denser than the ambient, or absorbing")
    layers: tuple[LayerSpec, ...] = Field(
        default=(), max_length=50, description="layers between the particles and the substrate, from the top"
    )
    particle: ParticleSpec = Field(description="the particles")
    monolayer: MonolayerSpec = Field(description="density and order of the particles")
    model: ModelSpec = Field(
        default=ModelSpec(), description="details of the computation; default: chosen automatically"
    )
    extrapolate: Literal["error", "edge"] = Field(
        default="error",
        description="outside the tabulated range of an optical constant: an error, or the end values",
    )

    def build(self, context: RecipeContext) -> MetasurfaceModel:
        """Return the material.

        Raises:
            RecipeError: contradicting density and packing, or an unusable point or S(q) file.
        """
        ambient = self._edge(ambient_in(self.ambient, "ambient" in self.model_fields_set, context))
        substrate = self._index(self.substrate)
        probe = np.array([570.0])
        n_ambient = complex(ambient.n_complex(probe)[0])
        n_substrate = complex(substrate.n_complex(probe)[0])
        if n_substrate.imag < 1e-4 and n_substrate.real < n_ambient.real - 1e-9:
            raise context.fail(
                "substrate",
                self.substrate.name or n_substrate.real,
                "is clear and less dense than the ambient, which the tables cannot hold",
            )
        index = max(1.0, n_substrate.real if n_substrate.imag < 1e-4 else 1.0, n_ambient.real)
        correction = self.model.correction
        is_replaced = context.is_low_fidelity and correction == "auto"
        layers = tuple((self._index(layer.material), layer.thickness_nm) for layer in self.layers)
        host = host_layer(context, self.particle.depth_nm, layers)
        if host and correction not in ("auto", "ensemble", "qca-balanced"):
            why = 'is not modelled for particles inside a layer; "ensemble" and the mean field, "qca-balanced", are'
            raise context.fail("model.correction", correction, why)
        around = layers[host - 1][0] if host else ambient
        all_species = self.particle.all_species(context, around, self.extrapolate == "edge")
        if host:
            all_species = embed_species(context, all_species, host, layers)
        self._check_aligned(context, all_species)
        structure, arrangement = self._structure(context, all_species, 4.2 * np.pi * index / 360.0)
        first = all_species[0]
        return MetasurfaceModel(
            ambient=ambient,
            layers=layers,
            substrate=substrate,
            core=first.core,
            sizes=first.sizes,
            structure=structure,
            shell=first.shell,
            gap_nm=first.gap_nm,
            correction="qca-balanced" if is_replaced else correction,
            is_replaced=is_replaced,
            ensemble=EnsembleSettings(**self.model.ensemble.model_dump()),
            multipole_order=self.model.multipole_order,
            multipole_tolerance=self.model.tolerance,
            interaction_order=self.model.interaction_order,
            source=context.source,
            arrangement=arrangement,
            body=first.body,
            second=all_species[1] if len(all_species) > 1 else None,
            host=host,
            depth_nm=first.depth_nm,
        )

    def _check_aligned(self, context: RecipeContext, all_species: tuple[Species, ...]) -> None:
        """Refuse unsupported combinations with aligned particles.

        Raises:
            RecipeError: a mixture, or a correction other than the mean field.
        """
        if not any(species.body is not None and species.body.is_aligned for species in all_species):
            return
        if len(all_species) > 1:
            key = (
                "particle" if all_species[0].body is not None and all_species[0].body.is_aligned else "particle.second"
            )
            why = 'is not modelled in a mixture; write "averaged", or leave particle.second out'
            raise context.fail(f"{key}.orientation", "aligned", why)
        correction = self.model.correction
        if correction not in ("auto", "qca-balanced"):
            why = 'is not modelled for aligned particles; the mean field, "qca-balanced", is'
            raise context.fail("model.correction", correction, why)

    def _index(self, spec: IndexSpec) -> OpticalConstant:
        return self._edge(spec.build())

    def _edge(self, made: OpticalConstant) -> OpticalConstant:
        return made.with_extrapolation("edge") if self.extrapolate == "edge" else made

    def _structure(
        self, context: RecipeContext, all_species: tuple[Species, ...], q_max: float
    ) -> tuple[Structure, Arrangement | Pattern | None]:
        """Return the arrangement; in a mixture the larger species sets the least distance."""
        mean_nm = mean_square_radius(all_species)  # defines the coverage
        outer_nm = max(species.outer_radius_nm for species in all_species)  # defines overlaps
        # circumscribing spheres must not overlap: multipoles diverge inside
        reach_nm = max(species.reach_nm for species in all_species)
        layer, spec = self.monolayer, self.monolayer.structure
        if spec.points is not None:
            pattern = points_pattern(context, spec.points, 2 * outer_nm, spec.width_um)
            measured = points_structure(pattern, q_max)
            self._clear(context, "monolayer.structure.points", spec.points.file, measured.diameter_nm, reach_nm)
            return measured, pattern
        if layer.coverage is not None:
            density = layer.coverage / (np.pi * mean_nm**2)
        else:
            assert layer.density_per_um2 is not None  # one of both is given, see MonolayerSpec
            density = layer.density_per_um2 * 1e-6
        coverage = float(density * np.pi * mean_nm**2)
        occupied = float(density * np.pi * outer_nm**2)
        if not LEAST_COVERAGE <= coverage <= PACKING_LIMIT:
            raise context.fail(
                "monolayer.density_per_um2" if layer.coverage is None else "monolayer.coverage",
                layer.density_per_um2 if layer.coverage is None else layer.coverage,
                f"covers {coverage:.3g} of the area; it should be from {LEAST_COVERAGE:g} to {PACKING_LIMIT:g}",
            )
        widening = 1.0 if spec.name == "lattice" else (reach_nm / outer_nm) ** 2
        packing = occupied * widening if layer.packing is None else layer.packing
        if packing < occupied * (1 - 1e-9):
            floor = (
                f"the coverage f = {coverage:.4g}"
                if len(all_species) == 1
                else f"{occupied:.4g}, for the larger species"
            )
            raise context.fail(
                "monolayer.packing",
                packing,
                f"is below {floor}: the particles would overlap; it should be from "
                f"{'f' if len(all_species) == 1 else f'{occupied:.4g}'} to {PACKING_LIMIT:g}",
            )
        if packing > PACKING_LIMIT:
            key = "monolayer.density_per_um2" if layer.coverage is None else "monolayer.coverage"
            raise context.fail(
                key,
                layer.density_per_um2 if layer.coverage is None else layer.coverage,
                f"keeps the circumscribing spheres, {2 * reach_nm:.4g} nm wide, apart only at a packing of "
                f"{packing:.3g}; at most {PACKING_LIMIT:g} can be made",
            )
        if spec.name != "lattice":
            least = float(np.sqrt(4.0 * packing / (np.pi * density)))
            self._clear(context, "monolayer.packing", packing, least, reach_nm)
        reach_um = 1e-3 * float(np.sqrt(4.0 * packing / (np.pi * density)))
        if reach_um > LARGEST_REACH_UM:
            raise context.fail(
                "monolayer.packing",
                packing,
                f"keeps particles {reach_um:.3g} um apart at this density; it should be at most "
                f"{packing * (LARGEST_REACH_UM / reach_um) ** 2:.3g}, for {LARGEST_REACH_UM:g} um",
            )
        if spec.sq is not None:
            return sq_structure(context, spec.sq, float(density), packing, q_max), None
        assert spec.name is not None  # StructureSpec requires name, points or sq
        made = Arrangement(spec.name, float(density), packing, spec.seed, spec.lattice, spec.jitter)
        if spec.name == "hard-disk":
            return hard_disk_structure(float(density), packing, q_max), made
        if spec.name == "lattice":
            jittered = jittered_structure(context, made, 2 * outer_nm, q_max)
            self._clear(context, "monolayer.structure.jitter", spec.jitter, jittered.diameter_nm, reach_nm)
            return jittered, made
        return pattern_structure(context, made, q_max), made

    @staticmethod
    def _clear(context: RecipeContext, key: str, got: object, least_nm: float, reach_nm: float) -> None:
        """Refuse overlapping circumscribing spheres.

        Raises:
            RecipeError: the spheres overlap.
        """
        if least_nm < 2 * reach_nm * (1 - 1e-6):
            raise context.fail(
                key,
                got,
                f"lets particles come {least_nm:.4g} nm close, where their circumscribing spheres, "
                f"{2 * reach_nm:.4g} nm wide, meet; multipoles hold outside these alone",
            )


ROOM = 1e-6  # rounding tolerance in nm
Layers = Sequence[tuple[OpticalConstant, float]]


def host_layer(context: RecipeContext, depth_nm: float | None, layers: Layers) -> int:
    """Return the layer number, from 1, at a depth below the stack top; 0 without a depth.

    Raises:
        RecipeError: no layer is so deep, or it absorbs.
    """
    if depth_nm is None:
        return 0
    bottom = 0.0
    for number, (medium, thickness) in enumerate(layers, start=1):
        bottom += thickness
        if depth_nm < bottom - ROOM:
            _check_clear(context, medium, number)
            return number
    raise context.fail(
        "particle.depth_nm", depth_nm, f"is not inside a layer: the layers end {bottom:g} nm below their top"
    )


def _check_clear(context: RecipeContext, medium: OpticalConstant, number: int) -> None:
    grid = default_wavelengths()
    low, high = medium.range_nm
    try:
        loss = medium.n_complex(grid[(grid >= low) & (grid <= high)]).imag
    except MaterialRangeError:
        return  # not computed at unknown wavelengths
    if loss.size and loss.max() >= LOSSLESS_K:
        at = grid[(grid >= low) & (grid <= high)][int(np.argmax(loss))]
        raise context.fail(
            f"layers[{number - 1}].material",
            medium.name,
            f"absorbs (k = {loss.max():.2g} at {at:g} nm), and particles lie in it; k should be below {LOSSLESS_K:g}",
        )


def embed_species(
    context: RecipeContext, all_species: tuple[Species, ...], host: int, layers: Layers
) -> tuple[Species, ...]:
    """Return the species with their gaps above the lower layer face.

    Raises:
        RecipeError: the layer does not contain them, or their circumscribing spheres.
    """
    top = sum(thickness for _, thickness in layers[: host - 1])
    bottom = top + layers[host - 1][1]
    out = []
    for species in all_species:
        assert species.depth_nm is not None  # given for all species
        gap = bottom - species.depth_nm - species.height_nm
        largest = max(species.sizes.radii_nm) - species.mean_radius_nm
        above = 0.0 if species.body is None else species.reach_nm - species.height_nm / 2  # multipoles diverge inside
        over = species.depth_nm - top - above - (2 * largest if species.body is None else 0.0)
        if species.depth_nm >= bottom - ROOM or min(over, gap - above) < -ROOM:
            needs = "" if not above else f", or the sphere of radius {species.reach_nm:.4g} nm around them"
            raise context.fail(
                f"{species.key}.depth_nm",
                species.depth_nm,
                f"puts particles {species.height_nm:.4g} nm high{' and higher' if largest else ''} across a face of "
                f"layer {host}, which lies {top:g} to {bottom:g} nm deep; it should hold them whole{needs}",
            )
        out.append(replace(species, gap_nm=max(gap, 0.0)))
    return tuple(out)


# Fabrication files and figures of a metasurface.

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
        UnsupportedError: the matrices are too large.
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
    losses = ["the stack, the density and the order: a T-matrix is of one particle alone"]
    if len(material.sizes.radii_nm) > 1:
        losses.append("the spread of sizes: the mean one was taken")
    if material.second is not None:
        losses.append("the second species of the mixture: the first was taken")
    return losses


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
        number = float(value) if value != "" else ""
        rows.append(dict(zip(COLUMNS, (position, medium.name, quantity, number, n.real, n.imag, medium.source))))
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
