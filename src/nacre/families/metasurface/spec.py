"""The recipe of a metasurface: its keys, what they allow, and the material that they build."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from nacre.families.contract import Figure
from nacre.families.metasurface.arrangement import (
    ARRANGEMENTS,
    Arrangement,
    jittered_structure,
    pattern_structure,
    points_pattern,
    points_structure,
    sq_structure,
)
from nacre.families.metasurface.drawings import layer_sheet, layout
from nacre.families.metasurface.figures import FIGURES
from nacre.families.metasurface.material import LOOSEST_TOLERANCE, Metasurface, Shell, Sizes
from nacre.families.metasurface.patterns import Pattern
from nacre.families.metasurface.structure import PACKING_LIMIT, Structure, hard_disk_structure
from nacre.matter.drawings import Drawer
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec, ambient_in
from nacre.recipe.model import RecipeContext, RecipeModel, show_value

LEAST_COVERAGE = 1e-4
LARGEST_REACH_UM = 4.0  # beyond ten wavelengths S(q) has more rings than light can tell apart, and takes minutes
Positive = Annotated[float, pydantic.Field(gt=0.0)]
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
MAX_THICKNESS_NM = 1e4
CORE_LIMIT_NM = 1000.0
WIDEST_RELATIVE_SIZE = 0.3


class LayerSpec(RecipeModel):
    """One layer of the stack."""

    material: IndexSpec
    thickness_nm: Annotated[float, pydantic.Field(ge=0.0, le=MAX_THICKNESS_NM)]


class ShellSpec(RecipeModel):
    """A coating round the core; the outer radius is radius_nm plus this thickness."""

    material: IndexSpec
    thickness_nm: Annotated[float, pydantic.Field(gt=0.0, le=CORE_LIMIT_NM)]


class ParticleSpec(RecipeModel):
    """The spheres."""

    material: IndexSpec
    radius_nm: Annotated[float, pydantic.Field(gt=0.0, le=CORE_LIMIT_NM)]
    deviation_nm: NotNegative = 0.0
    distribution: Literal["gaussian", "lognormal"] = "gaussian"
    gap_nm: NotNegative = 0.0
    shell: ShellSpec | None = None

    @pydantic.model_validator(mode="after")
    def _moderate_spread(self) -> ParticleSpec:
        if self.deviation_nm > WIDEST_RELATIVE_SIZE * self.radius_nm:
            raise ValueError(
                f"deviation_nm = {self.deviation_nm:g} is not allowed; it should be at most "
                f"{WIDEST_RELATIVE_SIZE:g} of radius_nm = {self.radius_nm:g}"
            )
        return self


class StructureSpec(RecipeModel):
    """How the particles are arranged: a bare name, or a table with the name and its numbers."""

    name: Literal["hard-disk", "rsa", "poisson-disk", "lattice"] | None = None
    points: str | None = None
    sq: str | None = None
    lattice: Literal["square", "hexagonal"] = "hexagonal"
    jitter: Annotated[float, pydantic.Field(ge=0.0, le=1.0)] = 0.1
    seed: Annotated[int, pydantic.Field(ge=0, lt=2**32)] = 0

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_name(cls, data: Any) -> Any:
        if isinstance(data, str):
            if data not in ARRANGEMENTS:
                from nacre.errors import did_you_mean

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

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> StructureSpec:
        given = [key for key in ("name", "points", "sq") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"gives {' and '.join(given) or 'nothing'}; it needs one of name, points, sq")
        return self


class MonolayerSpec(RecipeModel):
    """Density and order of the particles."""

    coverage: Positive | None = None
    density_per_um2: Positive | None = None
    packing: Positive | None = None
    structure: StructureSpec = StructureSpec(name="hard-disk")

    @pydantic.model_validator(mode="after")
    def _one_density(self) -> MonolayerSpec:
        if (self.coverage is None) == (self.density_per_um2 is None) and self.structure.points is None:
            raise ValueError("needs either coverage or density_per_um2")
        if self.coverage is not None and self.coverage >= 0.9:
            raise ValueError(
                f"coverage = {self.coverage:g} is not allowed; it should be below 0.9, and at most 0.7 of hard disks"
            )
        if self.packing is not None and self.packing > PACKING_LIMIT:
            raise ValueError(
                f"packing = {self.packing:g} is not allowed; it should be at most {PACKING_LIMIT:g}, "
                "where hard disks freeze"
            )
        return self


class ModelSpec(RecipeModel):
    """The model, where its own choice is not wanted."""

    multipole_order: Annotated[int, pydantic.Field(ge=1, le=60)] | None = None
    tolerance: Annotated[float, pydantic.Field(ge=1e-5, le=LOOSEST_TOLERANCE)] | None = None
    interaction_order: Annotated[int, pydantic.Field(ge=1, le=4)] = 3
    correction: Literal["qca-balanced", "gv-balanced", "optical-depth", "in-only", "in-out", "none"] = "qca-balanced"


@dataclass(frozen=True, eq=False)
class MetasurfaceModel(Metasurface):
    """A metasurface as its recipe builds it: with its figures and its drawings."""

    @property
    def figures(self) -> Mapping[str, Figure]:
        """One particle's scattering, the arrangement and its S(q), colour over density and angle."""
        return {kind: partial(maker, self) for kind, maker in FIGURES.items()}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """Layouts of the particles, their list, and the sheet of what to make."""
        draw = partial(layout, self)
        return {"gds": draw, "oas": draw, "csv": draw, "sheet": lambda request: layer_sheet(self)}


class MetasurfaceSpec(RecipeModel):
    """A metasurface recipe."""

    varies_by_nodes: ClassVar[tuple[str, ...]] = (
        "particle.radius_nm",
        "particle.shell.thickness_nm",
        "particle.gap_nm",
        "monolayer.coverage",
        "monolayer.density_per_um2",
        "monolayer.packing",
        "layers[].thickness_nm",
    )

    family: Literal["metasurface"] = "metasurface"
    title: str = ""
    ambient: IndexSpec = IndexSpec.model_validate("air")
    substrate: IndexSpec
    layers: tuple[LayerSpec, ...] = pydantic.Field(default=(), max_length=50)
    particle: ParticleSpec
    monolayer: MonolayerSpec
    model: ModelSpec = ModelSpec()
    extrapolate: Literal["error", "edge"] = "error"

    def build(self, context: RecipeContext) -> MetasurfaceModel:
        """Return the material.

        Raises:
            RecipeError: density and packing contradict each other, or a file of points or of S(q) is not usable.
        """
        particle = self.particle
        outer = particle.radius_nm + (particle.shell.thickness_nm if particle.shell else 0.0)
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
        structure, arrangement = self._structure(context, outer, 4.2 * np.pi * index / 360.0)
        return MetasurfaceModel(
            ambient=ambient,
            layers=tuple((self._index(layer.material), layer.thickness_nm) for layer in self.layers),
            substrate=substrate,
            core=self._index(particle.material),
            sizes=Sizes.of(particle.radius_nm, particle.deviation_nm, particle.distribution),
            structure=structure,
            shell=Shell(self._index(particle.shell.material), particle.shell.thickness_nm) if particle.shell else None,
            gap_nm=particle.gap_nm,
            correction=self.model.correction,
            multipole_order=self.model.multipole_order,
            multipole_tolerance=self.model.tolerance,
            interaction_order=self.model.interaction_order,
            source=context.source,
            arrangement=arrangement,
        )

    def _index(self, spec: IndexSpec) -> OpticalConstant:
        return self._edge(spec.build())

    def _edge(self, made: OpticalConstant) -> OpticalConstant:
        return made.with_extrapolation("edge") if self.extrapolate == "edge" else made

    def _structure(
        self, context: RecipeContext, outer_nm: float, q_max: float
    ) -> tuple[Structure, Arrangement | Pattern | None]:
        layer, kind = self.monolayer, self.monolayer.structure
        if kind.points is not None:
            pattern = points_pattern(context, kind.points, 2 * outer_nm)
            return points_structure(pattern, q_max), pattern
        if layer.coverage is not None:
            density = layer.coverage / (np.pi * outer_nm**2)
        else:
            assert layer.density_per_um2 is not None  # one of the two is given, see MonolayerSpec
            density = layer.density_per_um2 * 1e-6
        coverage = float(density * np.pi * outer_nm**2)
        if not LEAST_COVERAGE <= coverage <= PACKING_LIMIT:
            raise context.fail(
                "monolayer.density_per_um2" if layer.coverage is None else "monolayer.coverage",
                layer.density_per_um2 if layer.coverage is None else layer.coverage,
                f"covers {coverage:.3g} of the area; it should be from {LEAST_COVERAGE:g} to {PACKING_LIMIT:g}",
            )
        packing = coverage if layer.packing is None else layer.packing
        if packing < coverage * (1 - 1e-9):
            raise context.fail(
                "monolayer.packing",
                packing,
                f"is below the coverage f = {coverage:.4g}: the particles would overlap; it should be from f to "
                f"{PACKING_LIMIT:g}",
            )
        reach_um = 1e-3 * float(np.sqrt(4.0 * packing / (np.pi * density)))
        if reach_um > LARGEST_REACH_UM:
            raise context.fail(
                "monolayer.packing",
                packing,
                f"keeps particles {reach_um:.3g} um apart at this density; it should be at most "
                f"{packing * (LARGEST_REACH_UM / reach_um) ** 2:.3g}, for {LARGEST_REACH_UM:g} um",
            )
        if kind.sq is not None:
            return sq_structure(context, kind.sq, float(density), packing, q_max), None
        assert kind.name is not None  # StructureSpec takes one of name, points, sq
        made = Arrangement(kind.name, float(density), packing, kind.seed, kind.lattice, kind.jitter)
        if kind.name == "hard-disk":
            return hard_disk_structure(float(density), packing, q_max), made
        if kind.name == "lattice":
            return jittered_structure(context, made, 2 * outer_nm, q_max), made
        return pattern_structure(context, made, q_max), made
