"""A material: what its family built, and the recipe that it was built from.

Any number of a recipe can be changed by its path (`layers[0].thickness_nm`), which is how sweeps, fits, tolerances,
designs and animations vary a material without knowing what it is.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array, floats, wavelength_grid
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.core.files import DESIGN_RECIPE, named, read_text, short_name
from nacre.core.memory import check_memory
from nacre.families.contract import ExcessEnergy, ExpensiveMethod, Model, Traits, figure_data, values_at
from nacre.families.registry import family_source, family_spec
from nacre.material.cache import solved
from nacre.material.examples import resolve_recipe_path
from nacre.material.spatial_variation import Varying
from nacre.measure.spectrum import bsdf_spectrum
from nacre.recipe.fingerprint import file_digest, fingerprint
from nacre.recipe.model import RecipeContext, validate
from nacre.recipe.named_numbers import named_numbers, refuse_new_number
from nacre.recipe.nested_recipes import open_all, open_parts
from nacre.recipe.normalise import plain_data
from nacre.recipe.paths import NUMBERS, find_by_path, numbers_of, set_by_path, varying_numbers
from nacre.recipe.toml import dump_toml, parse_toml

logger = logging.getLogger("nacre")

EXCESS_TOLD = 1e-3  # of the light that arrives: what spectra keep to
MAX_NESTED_RECIPES = 8
BYTES_A_VALUE = 160  # of an angle and wavelength: two polarisations' amplitudes and powers, and the parts kept
MANY_ANGLES = 1000  # so many that the material's own wavelengths count
POLARISATIONS = ("s", "p", "both")
STUDY_TABLES = ("fit", "tolerance")  # read by nacre.study: which numbers are free, which vary in manufacture


@functools.lru_cache(maxsize=256)  # once a process is enough for the same words
def _tell_once(source: str, line: str) -> None:
    logger.warning("%s: %s", source, line)


@dataclass(frozen=True)
class Material:
    """A material: its family's frozen parameters (`model`) and the recipe it was built from.

    Attributes:
        model: what its family built; holds the physics.
        data: the recipe as a dictionary.
        context: file name, folder and text of the recipe.
    """

    model: Model
    data: Mapping[str, Any]
    context: RecipeContext = field(default_factory=RecipeContext)

    def __repr__(self) -> str:
        """Say what it is in a line: its model holds whole tables."""
        return f"<{self.family} material: {self.context.source}>"

    @property
    def family(self) -> str:
        """The family's name, such as "film"."""
        return str(self.data.get("family", "stored"))

    @property
    def name(self) -> str:
        """A short name for titles and file names."""
        return short_name(self.context.source)

    @property
    def fingerprint(self) -> str:
        """A hash of all that decides the material's answers; see `nacre.recipe.fingerprint`."""
        data = {key: value for key, value in self.data.items() if key not in STUDY_TABLES}
        outside = {"ambient": str(self.context.ambient), "family": family_source(self.data.get("family"))}
        if self.context.is_low_fidelity:
            outside["way"] = "quick"
        return fingerprint(data, self.context.files, **outside)

    def bsdf(self, wavelengths_nm: ArrayLike | None = None, *, keep: bool = True) -> Bsdf:
        """Solve the optics and return the arrays, with their provenance.

        Args:
            wavelengths_nm: vacuum wavelengths, ascending; default: chosen by the material.
            keep: whether what took long to solve is kept on disk for the next time, which takes as long again.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """
        grid = wavelength_grid(wavelengths_nm)
        bsdf = self._solved(grid, keep)
        return dataclasses.replace(bsdf, provenance={**bsdf.provenance, **recipe_provenance(self)})

    def _solved(self, grid: NDArray[np.float64] | None, keep: bool = True) -> Bsdf:
        for warning in self.model.warnings:
            _tell_once(self.context.source, warning)
        if grid is not None:
            traits = self.model.traits
            check_memory(float(traits.bytes_per_wavelength) * grid.size, f"a {traits.noun} at {grid.size} wavelengths")
        if isinstance(self.model, StoredBsdf) or self.context.ambient is not None:
            return self.model.bsdf(grid)  # solved already; or a part of another material, which is kept as a whole
        what = fingerprint(self.fingerprint, {}, wavelengths_nm=grid)
        return solved(what, lambda: self.model.bsdf(grid), keep)

    def values_at(
        self, wi: Array, wo: Array, wavelengths_nm: Array | None = None
    ) -> tuple[Array, NDArray[np.float64]] | None:
        """Return what `bsdf` gives at a few pairs, `[pair, wavelength]`, and the wavelengths, where that is less work.

        None where it is not: the Bsdf must then be solved.

        Args:
            wi, wo: `[pair, 3]`, unit vectors.
            wavelengths_nm: ascending; default: chosen by the material.
        """
        grid = self.model.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        values = values_at(self.model, np.asarray(wi, dtype=float), np.asarray(wo, dtype=float), grid)
        return None if values is None else (values, np.asarray(grid, dtype=float))

    @property
    def text(self) -> str:
        """The recipe as text: as its author wrote it, or written anew where numbers were changed since."""
        return self.context.text or dump_toml(self.data)

    def spectrum(
        self,
        theta_rad: ArrayLike,
        wavelengths_nm: ArrayLike | None = None,
        polarisation: str = "both",
        *,
        seed: int = 0,
    ) -> Spectrum:
        """Return reflectance and transmittance, specular and diffuse, each `[angle, wavelength]`.

        Args:
            theta_rad: angles of incidence in the ambient medium, in [0, pi/2].
            wavelengths_nm: vacuum wavelengths; default: chosen by the material.
            polarisation: "s", "p" or "both" (unpolarised).
            seed: of a pearl's random walk; another seed gives independent noise.

        Raises:
            UnsupportedError: the material has no such spectrum, or a formula of x, y or z, which are of pictures.

        The parts never sum to more than 1 (random walks: but for their noise), unless data or a model chosen say so;
        that is logged as a warning.
        """
        refuse_place(self.model, f"{self.context.source}: spectrum")
        grid = wavelength_grid(wavelengths_nm)
        theta = np.atleast_1d(floats(theta_rad, "angles"))
        if theta.ndim != 1 or not np.all((theta >= 0) & (theta <= np.pi / 2 + 1e-12)):
            raise UnsupportedError("angles must be a number or a list, from 0 to 90 degrees (pi/2)")
        if polarisation not in POLARISATIONS:
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use {", ".join(POLARISATIONS)}')
        if grid is not None or len(theta) >= MANY_ANGLES:
            count = len(np.atleast_1d(self.model.wavelengths_nm if grid is None else grid))
            what = f"a spectrum of {len(theta)} angles x {count} wavelengths"
            check_memory(float(BYTES_A_VALUE) * len(theta) * count, what)
        found = self.model.spectrum(theta, grid, polarisation, seed)
        if found is None:
            if polarisation != "both":
                traits = self.model.traits
                raise UnsupportedError(f"{self.context.source}: a {traits.noun} {traits.unpolarised_reason}")
            found = bsdf_spectrum(self._solved(grid), theta, seed=seed)
        self._tell_excess(found)
        return found

    def _tell_excess(self, spectrum: Spectrum) -> None:
        """Warn where more leaves than arrives, of a model or data that may do so."""
        because = self.model.excess_reason if isinstance(self.model, ExcessEnergy) else ""
        parts = list(spectrum.parts().values())
        if not because or not parts:
            return
        total = np.sum(parts, axis=0)
        angle, band = np.unravel_index(int(np.argmax(total)), total.shape)
        if total[angle, band] > 1.0 + EXCESS_TOLD:
            logger.warning(
                "%s: sends out %.4g times the light that arrives, at %g degrees and %g nm: %s",
                self.context.source, total[angle, band], spectrum.angles_deg[angle], spectrum.wavelengths_nm[band],
                because,
            )  # fmt: skip

    def figure_data(self, kind: str, **options: Any) -> dict[str, NDArray[Any]]:
        """Return the arrays of a figure that only this family has, such as "field" or "structure".

        Raises:
            UnsupportedError: the family has no such figure, or a formula of x, y or z.
        """
        refuse_place(self.model, f"{self.context.source}: {kind}")
        return figure_data(self.model, kind, **options)

    def vary(self, changes: Mapping[str, Any]) -> Material:
        """Return the material with some recipe numbers changed, each named by its path.

        Raises:
            RecipeError: a path does not exist or a value is not allowed.

        Example: `soap.vary({"layers[0].thickness_nm": 420})`; of a blend, whose parts are files of their own,
        `door.vary({"first.layers[0].thickness_nm": 420})`.
        """
        if not isinstance(changes, Mapping):
            raise RecipeError(f"{type(changes).__name__} names no changes; give a table of paths and values")
        data = open_parts(self.data, changes, self.context.folder)
        for path, value in changes.items():
            refuse_new_number(data, str(path), self.context.source)
            set_by_path(data, path, value, self.context.source)
        return material_from_data(data, dataclasses.replace(self.context, text=""))

    def with_parts_loaded(self, paths: Iterable[str]) -> Material:
        """Return the material with each recipe inside its own that a path reaches into as a table, not as a file.

        `first.layers[0].thickness_nm` names a number of the recipe that `first = {recipe = "film.toml"}` names.

        Raises:
            RecipeError: a part cannot be read.
        """
        data = open_parts(self.data, paths, self.context.folder)
        if data == self.data:
            return self
        return material_from_data(data, dataclasses.replace(self.context, text=""))

    def inlined(self) -> Material:
        """Return the material with every recipe inside its own as a table, not as a file.

        Raises:
            RecipeError: a part cannot be read.
        """
        data = open_all(self.data, self.context.folder)
        if data == self.data:
            return self
        return material_from_data(data, dataclasses.replace(self.context, text=""))

    def at_low_fidelity(self, is_reported: bool = False) -> Material:
        """Return the material as one of many that are solved, without the way of minutes that it may take alone.

        Sweeps, searches, fits and drafts use "search"; `vary` preserves it. A method that the recipe names itself
        is used at any fidelity. A replaced method is reported as a warning unless `is_reported`.
        """
        if self.context.is_low_fidelity or isinstance(self.model, StoredBsdf):
            return self
        if isinstance(self.model, ExpensiveMethod) and self.model.expensive_method and not is_reported:
            logger.warning(
                "%s: alone it takes %s; among many it takes the quick way, unless the recipe names the slow one",
                self.context.source, self.model.expensive_method,
            )  # fmt: skip
        return material_from_data(self.data, dataclasses.replace(self.context, is_low_fidelity=True))

    def get(self, path: str) -> Any:
        """Return the recipe's value at a path such as `strata[0].platelets[0].volume_fraction`.

        Raises:
            RecipeError: the path does not exist in the recipe.
        """
        data = open_parts(self.data, [path], self.context.folder)
        holder, last = find_by_path(data, path, self.context.source)
        return holder[last]

    @property
    def parameters(self) -> dict[str, float]:
        """Every number that the recipe gives, by its path: what a fit or a search may free."""
        tables = {key: value for key, value in self.data.items() if key not in STUDY_TABLES}
        return numbers_of(tables)

    def _repr_html_(self) -> str:
        from nacre.material.notebook import material_html  # draws and renders: only where a notebook asks

        return material_html(self)


@dataclass(frozen=True)
class StoredBsdf(Model, ExcessEnergy):
    """A compiled `.nacre` file: a material whose optics are already solved."""

    traits = Traits(
        noun="compiled .nacre file",
        takes_ambient=False,
        unpolarised_reason="holds unpolarised values; give its recipe for s or p",
    )
    excess_reason = "so the file says"

    stored: Bsdf

    @property
    def wavelengths_nm(self) -> Array:
        """The stored wavelengths."""
        return self.stored.wavelengths_nm

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the stored Bsdf; it cannot be recomputed on another grid.

        Raises:
            UnsupportedError: another wavelength grid is asked for.
        """
        if wavelengths_nm is not None and not np.array_equal(wavelengths_nm, self.stored.wavelengths_nm):
            raise UnsupportedError("a compiled .nacre file keeps its wavelengths; give its recipe to choose others")
        return self.stored


MaterialLike = Material | str | Path | Mapping[str, Any]  # the last: a table with a recipe's keys


def load(path: MaterialLike) -> Material:
    """Load a material: a recipe (.toml), a compiled file (.nacre), a design folder, or an example by its name.

    A name is that of an example ("soap", "pearl/foil") only where there is no such file. A recipe's table is taken too,
    as `material` takes it (its paths are relative to the working folder), and a material is returned as it is.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
        NacreError: the file cannot be read.

    Example: `nacre.load("soap.toml").spectrum([0.0])`.
    """
    if isinstance(path, Material):
        return path
    if isinstance(path, Mapping):
        return material(path)
    return _load(resolve_recipe_path(named(path)), depth=0)


def _load(path: Path, depth: int, ambient: Any = None) -> Material:
    if depth > MAX_NESTED_RECIPES:
        raise RecipeError(f"{path}: recipes are nested more than {MAX_NESTED_RECIPES} deep; is there a circle?")
    try:
        is_folder = path.is_dir()
    except OSError as error:  # a name that no file system takes
        raise RecipeError(f"{str(path)[:80]}: cannot be read: {error.strerror}") from None
    if is_folder:
        if not (path / DESIGN_RECIPE).is_file():
            raise RecipeError(
                f"{path}: is a folder without a recipe.toml; give a recipe, a .nacre file or a design folder"
            )
        path = path / DESIGN_RECIPE
    if path.suffix == ".nacre":
        bsdf = Bsdf.load(path)
        text = str(bsdf.provenance.get("recipe", ""))
        reached = {path.resolve(): file_digest(path)}
        context = RecipeContext(str(path), path.parent.resolve(), text, dependencies=reached)
        return Material(StoredBsdf(bsdf), {}, context)
    text = read_text(path, "recipe")

    def load_recipe(other: str | Mapping[str, Any], ambient: Any = ambient) -> Material:
        if isinstance(other, Mapping):
            return _inside(other, context, ambient)
        return _load(_resolve(path, other), depth + 1, ambient)

    context = RecipeContext(str(path), path.parent.resolve(), text, load_recipe, ambient)
    return material_from_data(parse_toml(text, str(path)), context)


def _inside(data: Mapping[str, Any], context: RecipeContext, ambient: Any) -> Material:
    """Build a recipe that stands inside another one as a table."""
    return material_from_data(data, dataclasses.replace(context, text="", ambient=ambient))


def _resolve(recipe: Path, other: str) -> Path:
    return Path(other) if Path(other).is_absolute() else recipe.parent / other


def material(data: Mapping[str, Any], folder: str | Path = ".") -> Material:
    """Build a material from a dictionary with a recipe's keys; paths inside are relative to `folder`.

    Raises:
        RecipeError: naming key, value and what is allowed.

    Example: `nacre.material({"family": "film", "substrate": "Si"})` is a bare silicon wafer.
    """
    folder = named(folder)

    def load_recipe(other: str | Mapping[str, Any], ambient: Any = None) -> Material:
        if isinstance(other, Mapping):
            return _inside(other, context, ambient)
        return _load(folder / other, 1, ambient)

    context = RecipeContext("recipe", folder.resolve(), "", load_recipe)
    return material_from_data(data, context)


def loaded(thing: Any) -> Any:
    """Return the material of a path, of an example's name, or of a table with a recipe's keys; else the thing itself.

    A table with the key `type` is Mitsuba's, and left as it is.

    Raises:
        NacreError: there is no such material, or it is wrong.
    """
    if isinstance(thing, str | Path) or (isinstance(thing, Mapping) and "type" not in thing):
        return load(thing)
    return thing


def as_material(thing: MaterialLike) -> Material:
    """Return a material as it is, and what names one, or is a recipe's table, as a material.

    Raises:
        UnsupportedError: it is nothing of the kind.
        NacreError: there is no such material, or it is wrong.
    """
    found = loaded(thing)
    if not callable(getattr(found, "bsdf", None)):
        raise UnsupportedError(f"{thing!r:.60} is no material, no path or name of one and no table of a recipe")
    return found


def material_from_data(data: Mapping[str, Any], context: RecipeContext) -> Material:
    """Check a recipe's dictionary and build the material.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
    """
    data = plain_data(data, context.source)
    spec_class = family_spec(data.get("family"), context.source)
    context = dataclasses.replace(context, dependencies={}, names=named_numbers(data, context.source))
    if spec_class.varies_by_nodes and (numbers := varying_numbers(data, spec_class.varies_by_nodes)):
        told: list[str] = []

        def fixed(values: Mapping[str, float]) -> Material:
            even = copy.deepcopy(dict(data))
            for path, value in values.items():
                set_by_path(even, path, value, context.source)
            node = material_from_data(even, dataclasses.replace(context, is_low_fidelity=True))
            context.add_dependencies(node.context.dependencies)
            replaced = node.model.replaced_method if isinstance(node.model, ExpensiveMethod) else ""
            if replaced and not told and not context.is_low_fidelity:
                told.append(replaced)
                logger.warning(
                    "%s: with even numbers it may take %s; with numbers that vary it takes the quick way, unless the "
                    "recipe names the slow one", context.source, told[0],
                )  # fmt: skip
            return node

        return Material(Varying.read(numbers, fixed, context), data, context)
    own = {key: value for key, value in data.items() if key not in (*STUDY_TABLES, NUMBERS)}
    spec = validate(spec_class, own, context)
    return Material(spec.build(context), data, context)


def recipe_provenance(material: Material) -> dict[str, Any]:
    """Return the provenance that a file made from a recipe carries."""
    source = Path(material.context.source).name
    return {"nacre": __version__, "source": source, "recipe": material.text, "fingerprint": material.fingerprint}


# The layers of a material that is a stack, in words and numbers for sheets and pages.


def layers_of(material: Material) -> tuple[list[str], list[float]]:
    """Return the media of a stack from the light's side and its thicknesses; nothing of what is no stack."""
    if "structure" not in material.model.figures:
        return [], []
    try:
        data = material.figure_data("structure")
    except (NacreError, UnsupportedError):
        return [], []
    if "thicknesses_nm" not in data or "names" not in data:
        return [], []
    return [str(name) for name in data["names"]], [float(d) for d in np.atleast_1d(data["thicknesses_nm"])]
