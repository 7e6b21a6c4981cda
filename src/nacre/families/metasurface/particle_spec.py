"""Particle recipe: spheres, cylinders, spheroids, T-matrix files, or a mixture."""

import fnmatch
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pydantic

from nacre.core.errors import MaterialRangeError
from nacre.families.metasurface.species import Species
from nacre.families.metasurface.tmatrix.axisymmetric import (
    SAME_SIZE,
    SPHERE,
    AxialTMatrices,
    Body,
    TabulatedBody,
    TabulatedSphere,
    is_spherical,
)
from nacre.families.metasurface.tmatrix.particle_shapes import Shell, Sizes, SolvedBody
from nacre.families.metasurface.tmatrix.tmatrix_file import TMatrixFileError, read_several
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

CORE_LIMIT_NM = 1000.0
SMALLEST_CORE_NM = 0.1  # less than an atom; far smaller values underflow when squared
WIDEST_RELATIVE_SIZE = 0.3
SAME_MEDIUM = 1e-3  # relative tolerance for the T-matrix index
MAX_FILES = 1000  # of T-matrices of one particle
SAME_LENGTH = 1e-2  # relative tolerance for a length in both recipe and file
ALIGNED = 'write orientation = "aligned", and turn_deg for the angle by which all are turned about the normal'
OTHER_WORDS = dict.fromkeys(  # plausible unknown keys, and what to write instead
    ("orientation_deg", "turn", "rotation", "rotation_deg", "azimuth_deg", "aligned"), ALIGNED
)
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
Extent = Annotated[float, pydantic.Field(ge=2 * SMALLEST_CORE_NM, le=2 * CORE_LIMIT_NM)]


class ShellSpec(RecipeModel):
    """A coating around the core; it adds to the outer particle dimensions."""

    forms: ClassVar[tuple[str, ...]] = ('{material = "SiO2", thickness_nm = 10}',)

    material: IndexSpec = pydantic.Field(description="what the shell is made of")
    thickness_nm: Annotated[float, pydantic.Field(gt=0.0, le=CORE_LIMIT_NM)] = pydantic.Field(
        description="thickness of the shell, the same all over, from the core outward: twice as much is added to "
        "diameter_nm and height_nm, once to radius_nm",
        examples=[10],
    )


class SpeciesSpec(RecipeModel):
    """One particle species: keys, validation, and construction."""

    table: ClassVar[str] = "particle"  # recipe table
    one_of: ClassVar[tuple[str, ...]] = ("material", "tmatrix")

    material: IndexSpec | None = pydantic.Field(
        default=None, description="what the particle, or its core, is made of", examples=["Ag"]
    )
    radius_nm: Annotated[float, pydantic.Field(ge=SMALLEST_CORE_NM, le=CORE_LIMIT_NM)] | None = pydantic.Field(
        default=None, description="mean radius of the core of a sphere", examples=[90]
    )
    shape: Literal["sphere", "cylinder", "spheroid"] = pydantic.Field(
        default="sphere", description="form; the axis of a cylinder (disc or rod) or a spheroid is the normal"
    )
    deviation_nm: NotNegative = pydantic.Field(
        default=0.0,
        description="standard deviation of the radius, of a cylinder or spheroid of half its width (the height stays); "
        "at most 0.3 of it",
        examples=[5],
    )
    distribution: Literal["gaussian", "lognormal"] = pydantic.Field(
        default="gaussian", description="shape of that spread"
    )
    gap_nm: NotNegative = pydantic.Field(
        default=0.0, description="distance between the particles and the stack below them", examples=[2]
    )
    depth_nm: NotNegative | None = pydantic.Field(
        default=None,
        description="in place of gap_nm: the particles lie inside a layer, which is clear and holds them whole, their "
        "tops (of the mean size) this far below the top of the layers",
        examples=[100],
    )
    shell: ShellSpec | None = pydantic.Field(
        default=None,
        description="a coat round the core, round about a cylinder's edges; gap_nm and depth_nm are of its outside",
    )
    tmatrix: str | None = pydantic.Field(
        default=None,
        description="in place of material and radius_nm: a file of T-matrices of a particle, axis z, "
        "as programs exchange them (arXiv:2408.10727); or a folder or pattern of files at several wavelengths",
        examples=["disc.tmat.h5"],
    )
    diameter_nm: Extent | None = pydantic.Field(
        default=None,
        description="width of a cylinder or spheroid (of its core); or of what tmatrix describes, if its file does "
        "not say",
        examples=[120],
    )
    height_nm: Extent | None = pydantic.Field(
        default=None,
        description="height of a cylinder or spheroid (of its core); or of what tmatrix describes, if its file does "
        "not say",
        examples=[80],
    )

    edge_radius_nm: NotNegative = pydantic.Field(
        default=0.0,
        description="radius of the edges of a cylinder (of its core), which are sharp at 0; at most half of the "
        "cylinder's radius and a quarter of its height",
        examples=[2],
    )

    orientation: Literal["averaged", "aligned"] = pydantic.Field(
        default="averaged",
        description="of a particle of tmatrix that is not axisymmetric: the mean over its turn about the normal, or "
        "all point one way, the file's x along the surface's u",
    )
    turn_deg: Annotated[float, pydantic.Field(ge=-360.0, le=360.0)] = pydantic.Field(
        default=0.0,
        description="angle by which aligned particles are turned about the normal, from u towards v",
        examples=[30],
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _in_our_words(cls, data: Any) -> Any:
        for key in OTHER_WORDS if isinstance(data, Mapping) else ():
            if key in data:
                raise ValueError(f"gives {key}: {OTHER_WORDS[key]}")
        return data

    @pydantic.model_validator(mode="after")
    def _turned_as_one(self) -> Self:
        if self.tmatrix is None and self.orientation == "aligned":
            raise ValueError(
                f'gives orientation = "aligned" of a {self.shape}, which looks the same at any turn about the normal; '
                "it is for a particle of tmatrix"
            )
        if "turn_deg" in self.model_fields_set and self.orientation != "aligned":
            raise ValueError('gives turn_deg, which is of aligned particles alone; write orientation = "aligned" too')
        return self

    @pydantic.model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.depth_nm is not None and "gap_nm" in self.model_fields_set:
            raise ValueError("gives gap_nm and depth_nm; particles lie above the layers or inside one")
        return self

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.tmatrix is not None:
            of_others = ("material", "radius_nm", "shape", "deviation_nm", "shell", "edge_radius_nm")
            given = [name for name in of_others if name in self.model_fields_set]
            if given:
                raise ValueError(f"gives tmatrix and {given[0]}; a file of T-matrices says what the particle is")
            return self
        required: tuple[str, ...] = ("material", "radius_nm")
        foreign: tuple[str, ...] = ("diameter_nm", "height_nm")
        if self.shape != "sphere":
            required, foreign = ("material", *foreign), ("radius_nm",)
        if self.shape != "cylinder":
            foreign = (*foreign, "edge_radius_nm")
        given = [name for name in foreign if name in self.model_fields_set]
        if given:
            raise ValueError(f"gives {given[0]}, which a {self.shape} does not have; it has {', '.join(required)}")
        missing = [name for name in required if getattr(self, name) is None]
        if missing:
            raise ValueError(
                f"needs {' and '.join(missing)} of a {self.shape}, or tmatrix, a file of T-matrices, in place of all"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _moderate_spread(self) -> Self:
        key, radius = "radius_nm", self.radius_nm
        if radius is None and self.diameter_nm is not None:
            key, radius = "half of diameter_nm", self.diameter_nm / 2
        if radius is not None and self.deviation_nm > WIDEST_RELATIVE_SIZE * radius:
            raise ValueError(
                f"deviation_nm = {self.deviation_nm:g} is not allowed; it should be at most "
                f"{WIDEST_RELATIVE_SIZE:g} of {key} = {radius:g}"
            )
        return self

    def species(self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, share: float = 1.0) -> Species:
        """Return the species with number fraction `share`; see `body`."""

        def built(spec: IndexSpec) -> OpticalConstant:
            made = spec.build()
            return made.with_extrapolation("edge") if hold_ends else made

        shell = Shell(built(self.shell.material), self.shell.thickness_nm) if self.shell else None
        body = self.body(context, around, hold_ends, shell)
        coat = shell.thickness_nm if shell is not None and body is not None else 0.0
        mean = body.radius_nm - coat if body is not None else self.radius_nm
        assert mean is not None  # given for spheres, see _one_kind
        sizes = Sizes.of(mean, self.deviation_nm, self.distribution).larger_by(coat)
        thinnest = min(sizes.radii_nm) - coat
        if self.edge_radius_nm > min(thinnest, (self.height_nm or 0.0) / 2) / 2:
            raise context.fail(
                f"{self.table}.edge_radius_nm",
                self.edge_radius_nm,
                f"is too large for a cylinder {2 * thinnest:.4g} nm wide, the narrowest of the spread, and "
                f"{self.height_nm:.4g} nm high; it should be at most half of its radius and a quarter of its height",
            )
        core = None if self.material is None else built(self.material)
        return Species(core, sizes, shell, self.gap_nm, body, share, self.table, self.depth_nm)

    def body(
        self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, shell: Shell | None = None
    ) -> Body | None:
        """Return a non-spherical particle, or None.

        Args:
            around: the surrounding medium.
            hold_ends: whether T-matrices hold beyond their wavelengths.
            shell: its coating.

        Raises:
            RecipeError: the file is unusable, for another medium, or without dimensions.
        """
        if self.tmatrix is None:
            return None if self.shape == "sphere" else self._solid(context, around, hold_ends, shell)
        try:
            known = read_several(self._tmatrix_paths(context), self.orientation == "aligned")
        except TMatrixFileError as error:
            raise context.fail(f"{self.table}.tmatrix", self.tmatrix, str(error)) from None
        self._check_medium(context, known, around)
        radius = self._extent(context, "diameter_nm", None if known.radius_nm is None else 2 * known.radius_nm) / 2
        height = self._extent(context, "height_nm", known.height_nm)
        # without a shape the particle may fill the cylinder with both lengths
        reach = float(np.hypot(radius, height / 2)) if known.circumscribing_nm is None else known.circumscribing_nm
        source = f'{context.source}: {self.table}.tmatrix = "{self.tmatrix}"'
        shape = known.shape
        if shape in ("", SPHERE) and abs(2 * radius - height) <= SAME_SIZE * height and is_spherical(known):
            return TabulatedSphere(known, radius, height, radius, source, hold_ends, shape)
        return TabulatedBody(known, radius, height, reach, source, hold_ends, shape, float(np.radians(self.turn_deg)))

    def _tmatrix_paths(self, context: RecipeContext) -> list[Path]:
        """Return the files: one, those of a folder, or those of a pattern such as `w*.tmat.h5`.

        Raises:
            RecipeError: a folder or a pattern has none, or too many.
        """
        assert self.tmatrix is not None
        plain = Path(self.tmatrix)
        place = plain if plain.is_absolute() else context.folder / plain
        is_pattern = any(c in plain.name for c in "*?[") and not place.exists()
        if not is_pattern and not place.is_dir():
            return [context.path(self.tmatrix)]
        folder, pattern = (place.parent, plain.name) if is_pattern else (place, "*.h5")
        names = fnmatch.filter(sorted(os.listdir(folder)) if folder.is_dir() else [], pattern)
        if not 0 < len(names) <= MAX_FILES:
            what = "a pattern for" if is_pattern else "a folder with"
            reason = f"is {what} {len(names)} files; 1 to {MAX_FILES} are read"
            raise context.fail(f"{self.table}.tmatrix", self.tmatrix, reason)
        above = plain.parent if is_pattern else plain
        return [context.path(str(above / name)) for name in names]

    def _solid(
        self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, shell: Shell | None
    ) -> SolvedBody:
        assert self.material is not None and self.diameter_nm is not None and self.height_nm is not None  # _one_kind
        core = self.material.build()
        core = core.with_extrapolation("edge") if hold_ends else core
        source = f'{context.source}: {self.table}.shape = "{self.shape}"'
        coat = 0.0 if shell is None else shell.thickness_nm
        return SolvedBody(
            self.shape,
            self.diameter_nm / 2 + coat,
            self.height_nm + 2 * coat,
            core,
            around,
            source,
            shell=shell,
            edge_nm=self.edge_radius_nm,
        )

    def _check_medium(self, context: RecipeContext, known: AxialTMatrices, medium: OpticalConstant) -> None:
        for wavelength, index in zip(known.wavelengths_nm, known.ambient_index):
            try:
                around = float(medium.n_complex(np.array([wavelength]))[0].real)
            except MaterialRangeError:
                continue  # not computed at unknown wavelengths
            if abs(around / index - 1) > SAME_MEDIUM:
                place = "the ambient" if self.depth_nm is None else "the layer"
                raise context.fail(
                    f"{self.table}.tmatrix",
                    self.tmatrix,
                    f"is for particles in a medium of n = {index:.5g}, and {place} has {around:.5g}",
                )

    def _extent(self, context: RecipeContext, key: str, stated: float | None) -> float:
        given: float | None = getattr(self, key)
        if given is None and stated is None:
            raise context.fail(
                f"{self.table}.tmatrix",
                self.tmatrix,
                f"does not say how large the particle is; give {self.table}.{key}",
            )
        if given is not None and stated is not None and abs(given / stated - 1) > SAME_LENGTH:
            raise context.fail(
                f"{self.table}.{key}", given, f"is not what {self.tmatrix} says: {stated:.5g} nm; leave it out"
            )
        found = stated if stated is not None else given
        assert found is not None
        return found


class SecondSpeciesSpec(SpeciesSpec):
    """The second species in a mixture, with its number fraction; both lie at random on one arrangement."""

    table: ClassVar[str] = "particle.second"
    forms: ClassVar[tuple[str, ...]] = ('{material = "Ag", radius_nm = 50, share = 0.3}',)

    share: Annotated[float, pydantic.Field(gt=0.0, lt=1.0)] = pydantic.Field(
        description="number of these particles over that of all", examples=[0.3]
    )


class ParticleSpec(SpeciesSpec):
    """The particles: spheres, upright cylinders or spheroids, or particles from a file."""

    forms: ClassVar[tuple[str, ...]] = (
        *SpeciesSpec.forms,
        '{material = "Si", radius_nm = 75, second = {material = "Ag", radius_nm = 50, share = 0.3}}',
    )

    second: SecondSpeciesSpec | None = pydantic.Field(
        default=None, description="second species of particles in a mixture"
    )

    @pydantic.model_validator(mode="after")
    def _all_inside_or_none(self) -> Self:
        if self.second is not None and (self.depth_nm is None) != (self.second.depth_nm is None):
            raise ValueError("and second: one gives depth_nm; both species lie inside one layer, or both above all")
        return self

    def all_species(self, context: RecipeContext, around: OpticalConstant, hold_ends: bool) -> tuple[Species, ...]:
        """Return the one or two species, in the medium `around` them.

        Raises:
            RecipeError: see `body`.
        """
        if self.second is None:
            return (self.species(context, around, hold_ends),)
        share = self.second.share
        second = self.second.species(context, around, hold_ends, share)
        return self.species(context, around, hold_ends, 1.0 - share), second
