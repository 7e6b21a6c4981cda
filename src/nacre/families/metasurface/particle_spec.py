"""The recipe's particles: spheres, discs, rods, spheroids, or what a file of T-matrices describes."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
import pydantic

from nacre.errors import MaterialRangeError
from nacre.families.metasurface.axial import AxialTMatrices, Body, KnownBody
from nacre.families.metasurface.solids import SolvedBody
from nacre.families.metasurface.tmatrix_file import TMatrixFileError, read_tmatrices
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

CORE_LIMIT_NM = 1000.0
SMALLEST_CORE_NM = 0.1  # less than an atom; squares of far smaller ones are 0 in floating point
WIDEST_RELATIVE_SIZE = 0.3
SAME_MEDIUM = 1e-3  # relative, of the index that a T-matrix is for
SAME_LENGTH = 1e-2  # relative, of a length that recipe and file both give
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
Extent = Annotated[float, pydantic.Field(ge=2 * SMALLEST_CORE_NM, le=2 * CORE_LIMIT_NM)]


class ShellSpec(RecipeModel):
    """A coating round the core; the outer radius is radius_nm plus this thickness."""

    forms: ClassVar[tuple[str, ...]] = ('{material = "SiO2", thickness_nm = 10}',)

    material: IndexSpec = pydantic.Field(description="what the shell is made of")
    thickness_nm: Annotated[float, pydantic.Field(gt=0.0, le=CORE_LIMIT_NM)] = pydantic.Field(
        description="thickness of the shell, from the core's radius outward", examples=[10]
    )


class ParticleSpec(RecipeModel):
    """The particles: spheres, upright cylinders or spheroids, or any with an axis along the normal, by a file."""

    forms: ClassVar[tuple[str, ...]] = (
        '{material = "Ag", radius_nm = 90}',
        '{material = "Au", radius_nm = 60, deviation_nm = 5, shell = {material = "SiO2", thickness_nm = 10}}',
        '{shape = "cylinder", material = "Si", diameter_nm = 120, height_nm = 80}',
        '{tmatrix = "disc.tmat.h5", gap_nm = 5}',
    )
    one_of: ClassVar[tuple[str, ...]] = ("material", "tmatrix")

    material: IndexSpec | None = pydantic.Field(
        default=None, description="what the particle, or the core of a sphere, is made of", examples=["Ag"]
    )
    radius_nm: Annotated[float, pydantic.Field(ge=SMALLEST_CORE_NM, le=CORE_LIMIT_NM)] | None = pydantic.Field(
        default=None, description="mean radius of the core of a sphere", examples=[90]
    )
    shape: Literal["sphere", "cylinder", "spheroid"] = pydantic.Field(
        default="sphere", description="form; the axis of a cylinder (disc or rod) or a spheroid is the normal"
    )
    deviation_nm: NotNegative = pydantic.Field(
        default=0.0, description="standard deviation of the radius, at most 0.3 of it", examples=[5]
    )
    distribution: Literal["gaussian", "lognormal"] = pydantic.Field(
        default="gaussian", description="shape of that spread"
    )
    gap_nm: NotNegative = pydantic.Field(
        default=0.0, description="distance between the particles and the stack below them", examples=[2]
    )
    shell: ShellSpec | None = pydantic.Field(default=None, description="a coat round the core")
    tmatrix: str | None = pydantic.Field(
        default=None,
        description="in place of material and radius_nm: a file of T-matrices of an axisymmetric particle, axis z, "
        "as programs exchange them (arXiv:2408.10727)",
        examples=["disc.tmat.h5"],
    )
    diameter_nm: Extent | None = pydantic.Field(
        default=None,
        description="width of a cylinder or spheroid; or of what tmatrix describes, if its file does not say",
        examples=[120],
    )
    height_nm: Extent | None = pydantic.Field(
        default=None,
        description="height of a cylinder or spheroid; or of what tmatrix describes, if its file does not say",
        examples=[80],
    )

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> ParticleSpec:
        if self.tmatrix is not None:
            of_others = ("material", "radius_nm", "shape", "deviation_nm", "shell")
            given = [name for name in of_others if name in self.model_fields_set]
            if given:
                raise ValueError(f"gives tmatrix and {given[0]}; a file of T-matrices says what the particle is")
            return self
        wanted: tuple[str, ...] = ("material", "radius_nm")
        foreign: tuple[str, ...] = ("diameter_nm", "height_nm")
        if self.shape != "sphere":
            wanted, foreign = ("material", *foreign), ("radius_nm", "deviation_nm", "shell")
        given = [name for name in foreign if name in self.model_fields_set]
        if given:
            raise ValueError(f"gives {given[0]}, which a {self.shape} does not have; it has {', '.join(wanted)}")
        missing = [name for name in wanted if getattr(self, name) is None]
        if missing:
            raise ValueError(
                f"needs {' and '.join(missing)} of a {self.shape}, or tmatrix, a file of T-matrices, in place of all"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _moderate_spread(self) -> ParticleSpec:
        if self.radius_nm is not None and self.deviation_nm > WIDEST_RELATIVE_SIZE * self.radius_nm:
            raise ValueError(
                f"deviation_nm = {self.deviation_nm:g} is not allowed; it should be at most "
                f"{WIDEST_RELATIVE_SIZE:g} of radius_nm = {self.radius_nm:g}"
            )
        return self

    @property
    def outer_radius_nm(self) -> float:
        """Of a sphere, with its shell."""
        assert self.radius_nm is not None  # of spheres, see _one_kind
        return self.radius_nm + (self.shell.thickness_nm if self.shell else 0.0)

    def body(self, context: RecipeContext, ambient: OpticalConstant, hold_ends: bool) -> Body | None:
        """Return what is no sphere, or None.

        Args:
            ambient: the medium around.
            hold_ends: whether T-matrices hold beyond their wavelengths.

        Raises:
            RecipeError: the file is not usable, or is of another medium or of an unknown size.
        """
        if self.tmatrix is None:
            return None if self.shape == "sphere" else self._solid(context, ambient, hold_ends)
        try:
            known = read_tmatrices(context.path(self.tmatrix))
        except TMatrixFileError as error:
            raise context.fail("particle.tmatrix", self.tmatrix, str(error)) from None
        self._check_medium(context, known, ambient)
        radius = self._extent(context, "diameter_nm", None if known.radius_nm is None else 2 * known.radius_nm) / 2
        height = self._extent(context, "height_nm", known.height_nm)
        # without a shape the particle may fill the cylinder that its two lengths name
        reach = float(np.hypot(radius, height / 2)) if known.circumscribing_nm is None else known.circumscribing_nm
        source = f'{context.source}: particle.tmatrix = "{self.tmatrix}"'
        return KnownBody(known, radius, height, reach, source, hold_ends)

    def _solid(self, context: RecipeContext, ambient: OpticalConstant, hold_ends: bool) -> SolvedBody:
        assert self.material is not None and self.diameter_nm is not None and self.height_nm is not None  # _one_kind
        core = self.material.build()
        core = core.with_extrapolation("edge") if hold_ends else core
        source = f'{context.source}: particle.shape = "{self.shape}"'
        return SolvedBody(self.shape, self.diameter_nm / 2, self.height_nm, core, ambient, source)

    def _check_medium(self, context: RecipeContext, known: AxialTMatrices, ambient: OpticalConstant) -> None:
        for wavelength, index in zip(known.wavelengths_nm, known.ambient_index):
            try:
                around = float(ambient.n_complex(np.array([wavelength]))[0].real)
            except MaterialRangeError:
                continue  # where the ambient is not known nothing is computed
            if abs(around / index - 1) > SAME_MEDIUM:
                raise context.fail(
                    "particle.tmatrix",
                    self.tmatrix,
                    f"is for particles in a medium of n = {index:.5g}, and the ambient has {around:.5g}",
                )

    def _extent(self, context: RecipeContext, key: str, told: float | None) -> float:
        given: float | None = getattr(self, key)
        if given is None and told is None:
            raise context.fail(
                "particle.tmatrix", self.tmatrix, f"does not say how large the particle is; give particle.{key}"
            )
        if given is not None and told is not None and abs(given / told - 1) > SAME_LENGTH:
            raise context.fail(
                f"particle.{key}", given, f"is not what {self.tmatrix} says: {told:.5g} nm; leave it out"
            )
        found = told if told is not None else given
        assert found is not None
        return found
