"""A material: the model that its family built, and the recipe that it was built from.

Every number of a recipe can be changed by its path (`layers[0].thickness_nm`). Sweeps, fits, tolerances, designs and
animations use these paths for all families.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import html
import json
import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.bsdf.texture import named_numbers, refuse_new_number, refuse_place
from nacre.core import disk_cache
from nacre.core.arrays import Array, floats, wavelength_grid
from nacre.core.disk_cache import cache_arrays, cached, cached_arrays
from nacre.core.errors import NacreError, RecipeError, UnsupportedError, warn_once
from nacre.core.files import DESIGN_RECIPE, named, read_text, short_name
from nacre.core.html import png_bytes, png_uri
from nacre.core.machine import check_memory
from nacre.families.contract import (
    Diffracting,
    ExcessEnergy,
    ExpensiveMethod,
    Model,
    Polarised,
    Polarising,
    Traits,
    figure_data,
    values_at,
)
from nacre.families.registry import family_spec
from nacre.light import sampling_warning
from nacre.material.examples import resolve_recipe_path
from nacre.material.parametrise import Parametrisation
from nacre.material.spatial_variation import Varying
from nacre.matter.indices.library import lone_axes
from nacre.matter.periodic.structure import NotConvergedError
from nacre.measure.evaluate import bsdf_spectrum
from nacre.recipe.fingerprint import file_digest, fingerprint
from nacre.recipe.model import RecipeContext, RecipeModel, validate
from nacre.recipe.paths import NUMBERS, find_by_path, numbers_of, set_by_path, varying_numbers
from nacre.recipe.toml import dump_toml, open_all, open_parts, parse_toml, plain_data

logger = logging.getLogger("nacre")

MAX_EXCESS = 1e-3  # relative to the incident light; larger sums of reflectance and transmittance are reported
MAX_NESTED_RECIPES = 8
ENTRY = "entry"  # provenance field of a cached Bsdf with its key, which identifies a renamed file
OF_OUTER = object()  # default of a nested recipe's ambient: that of the outer recipe
BYTES_PER_VALUE = 160  # per angle and wavelength: amplitudes and powers of two polarisations, and the stored parts
MANY_ANGLES = 1000  # angle count from which memory is checked for the material's own wavelengths
POLARISATIONS = ("s", "p", "both", "left", "right", "mueller")
STUDY_TABLES = (
    "fit",
    "tolerance",
    "ties",
    "instrument",
    "geometry",
    "correlation",
)  # keys of fits and tolerances; they do not change the optics


@dataclass(frozen=True)
class Material:
    """A material: its family's frozen parameters (`model`) and its recipe.

    Attributes:
        model: the physics, built by the family.
        data: the recipe as a dictionary.
        context: file name, folder and text of the recipe.
    """

    model: Model
    data: Mapping[str, Any]
    context: RecipeContext = field(default_factory=RecipeContext)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the recipe, not the model: worker processes build the model from it, once per recipe."""
        if self.context.ambient is not None:
            raise TypeError(f"{self.context.source}: a nested material cannot be pickled on its own")
        if isinstance(self.model, StoredBsdf):
            return _load, (Path(self.context.source).resolve(), 0)
        c = self.context
        digests = tuple(sorted((str(path), digest) for path, digest in c.dependencies.items()))
        return _restored, (json.dumps(self.data, sort_keys=True), c.source, c.folder, c.is_low_fidelity, digests)

    def __repr__(self) -> str:
        """Return family and source on one line, without the model's tables."""
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
        """A hash of everything that determines the material's optics; see `nacre.recipe.fingerprint`."""
        data = {key: value for key, value in self.data.items() if key not in STUDY_TABLES}
        options: dict[str, Any] = {
            "ambient": str(self.context.ambient), "version": self.model.version, "nested": self.context.versions,
        }  # fmt: skip
        if self.context.is_low_fidelity:
            options["fidelity"] = "low"
        return fingerprint(data, self.context.files, **options)

    def bsdf(self, wavelengths_nm: ArrayLike | None = None, *, keep: bool = True) -> Bsdf:
        """Solve the optics and return the lobes with their provenance.

        Args:
            wavelengths_nm: vacuum wavelengths, ascending; default: chosen by the material.
            keep: whether a slow result is stored in the disk cache.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """
        with self._named_errors():
            bsdf = self._solved(wavelength_grid(wavelengths_nm), keep)
        polarisation = bsdf.polarisation
        if isinstance(self.model, Polarising):
            polarisation = functools.partial(self._polarisation, self.model, bsdf.wavelengths_nm)
        provenance = {**bsdf.provenance, **recipe_provenance(self)}
        return dataclasses.replace(bsdf, provenance=provenance, polarisation=polarisation)

    def _polarisation(self, model: Polarising, wavelengths_nm: Array) -> InterfacePolarisation | None:
        """Tabulate Mueller matrices; those of an anisotropic interface that take long are stored in the disk cache."""
        key = fingerprint(self.fingerprint, {}, wavelengths_nm=wavelengths_nm, part="mueller")
        if (stored := cached_arrays(key)) is not None:
            with contextlib.suppress(ValueError, KeyError):  # damaged
                return InterfacePolarisation.from_arrays(stored)
        start = time.perf_counter()
        tables = model.polarisation(wavelengths_nm)
        if tables is not None and tables.response is None and time.perf_counter() - start > disk_cache.MIN_SOLVE_S:
            cache_arrays(key, tables.arrays())
        return tables

    def _solved(self, grid: NDArray[np.float64] | None, keep: bool = True) -> Bsdf:
        for warning in self.model.warnings:
            warn_once(self.context.source, warning)
        if grid is not None:
            traits = self.model.traits
            check_memory(float(traits.bytes_per_wavelength) * grid.size, f"a {traits.noun} at {grid.size} wavelengths")
        if isinstance(self.model, StoredBsdf) or self.context.ambient is not None:
            return self.model.bsdf(grid)  # solved already, or part of another material, which is cached as a whole
        key = fingerprint(self.fingerprint, {}, wavelengths_nm=grid)
        bsdf = cached(key, lambda: self.model.bsdf(grid), _load_entry, _save_entry if keep else _discard)
        for warning in bsdf.provenance.get("warnings", ()):
            warn_once(self.context.source, warning)
        return bsdf

    def values_at(
        self, wi: Array, wo: Array, wavelengths_nm: Array | None = None
    ) -> tuple[Array, NDArray[np.float64]] | None:
        """Return BSDF values of a few pairs `[pair, wavelength]` and the wavelengths, without solving the whole Bsdf.

        None: the family has no direct evaluation.

        Args:
            wi, wo: `[pair, 3]`, unit vectors.
            wavelengths_nm: ascending; default: chosen by the material.
        """
        grid = self.model.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        values = values_at(self.model, np.asarray(wi, dtype=float), np.asarray(wo, dtype=float), grid)
        return None if values is None else (values, np.asarray(grid, dtype=float))

    @property
    def text(self) -> str:
        """The recipe as text: as its author wrote it, or written again after changes."""
        return self.context.text or dump_toml(self.data)

    def spectrum(
        self,
        theta_rad: ArrayLike,
        wavelengths_nm: ArrayLike | None = None,
        polarisation: str = "both",
        *,
        seed: int = 0,
        azimuth_deg: float = 0.0,
    ) -> Spectrum:
        """Return reflectance and transmittance, specular and diffuse, each `[angle, wavelength]`.

        The parts never sum to more than 1 within the noise of random walks, unless the data or the chosen model do;
        this is logged as a warning.

        Args:
            theta_rad: incidence angles in the ambient medium, in [0, pi/2].
            wavelengths_nm: vacuum wavelengths; default: chosen by the material.
            polarisation: "s", "p", "both" (unpolarised), "left" or "right" (circular), or "mueller": unpolarised, with
                Mueller matrices.
            seed: seed of a random walk; another seed gives independent noise.
            azimuth_deg: azimuth of the direction towards the light, from u.

        Raises:
            UnsupportedError: the material lacks such a spectrum, or a formula uses x, y or z, which only pictures have.
        """
        refuse_place(self.model, f"{self.context.source}: spectrum")
        grid = wavelength_grid(wavelengths_nm)
        theta = np.atleast_1d(floats(theta_rad, "angles"))
        if theta.ndim != 1 or not theta.size or not np.all((theta >= 0) & (theta <= np.pi / 2 + 1e-12)):
            raise UnsupportedError("angles must be a number or a list of at least one, from 0 to 90 degrees (pi/2)")
        if not np.isfinite(azimuth_deg):
            raise UnsupportedError(f"azimuth_deg = {azimuth_deg} is not finite")
        if polarisation not in POLARISATIONS:
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use {", ".join(POLARISATIONS)}')
        if grid is not None or len(theta) >= MANY_ANGLES:
            count = len(np.atleast_1d(self.model.wavelengths_nm if grid is None else grid))
            what = f"a spectrum of {len(theta)} angles x {count} wavelengths"
            check_memory(float(BYTES_PER_VALUE) * len(theta) * count, what)
        with self._named_errors():
            spectrum = self._solved_spectrum(theta, grid, polarisation, seed, azimuth_deg)
        if grid is None and spectrum is not None and isinstance(self.model, Diffracting):
            remark = sampling_warning(np.stack(list(spectrum.parts().values())), spectrum.wavelengths_nm)
            if remark:
                warn_once(self.context.source, remark)
        if spectrum is None:
            if polarisation != "both":
                traits = self.model.traits
                raise UnsupportedError(f"{self.context.source}: a {traits.noun} {traits.unpolarised_reason}")
            spectrum = bsdf_spectrum(self._solved(grid), theta, seed=seed)
        self._warn_of_excess(spectrum)
        return spectrum

    @contextlib.contextmanager
    def _named_errors(self) -> Iterator[None]:
        """Name the recipe where orders do not converge."""
        try:
            yield
        except NotConvergedError as error:
            raise NotConvergedError(f"{self.context.source}: {error}") from None

    def _solved_spectrum(
        self, theta: Array, grid: Array | None, polarisation: str, seed: int, azimuth_deg: float
    ) -> Spectrum | None:
        if azimuth_deg == 0.0 and polarisation in ("s", "p", "both"):
            return self.model.spectrum(theta, grid, polarisation, seed)
        if isinstance(self.model, Polarised):
            return self.model.polarised_spectrum(theta, grid, polarisation, float(np.radians(azimuth_deg)))
        noun = self.model.traits.noun
        what = f'polarisation = "{polarisation}"' if azimuth_deg == 0.0 else f"azimuth_deg = {azimuth_deg:g}"
        raise UnsupportedError(f"{self.context.source}: {what} is not known for a {noun}")

    def _warn_of_excess(self, spectrum: Spectrum) -> None:
        """Log a warning if the model or data scatter more light than they receive."""
        because = self.model.excess_reason if isinstance(self.model, ExcessEnergy) else ""
        parts = list(spectrum.parts().values())
        if not because or not parts:
            return
        total = np.sum(parts, axis=0)
        angle, band = np.unravel_index(int(np.argmax(total)), total.shape)
        if total[angle, band] > 1.0 + MAX_EXCESS:
            logger.warning(
                "%s: sends out %.4g times the light that arrives, at %g degrees and %g nm: %s",
                self.context.source, total[angle, band], spectrum.angles_deg[angle], spectrum.wavelengths_nm[band],
                because,
            )  # fmt: skip

    def figure_data(self, kind: str, **options: Any) -> dict[str, NDArray[Any]]:
        """Return the arrays of a figure of this family, such as "field" or "structure".

        Raises:
            UnsupportedError: the family has no such figure, or a formula uses x, y or z.
        """
        refuse_place(self.model, f"{self.context.source}: {kind}")
        return figure_data(self.model, kind, **options)

    def vary(self, changes: Mapping[str, Any]) -> Material:
        """Return the material with some recipe values changed, each named by its path.

        Raises:
            RecipeError: a path does not exist or a value is not allowed.

        Example:
            >>> nacre.load("soap").vary({"substrate": "Si"}).get("substrate")
            'Si'
        """
        if not isinstance(changes, Mapping):
            raise RecipeError(f"{type(changes).__name__} names no changes; give a table of paths and values")
        data = open_parts(self.data, changes, self.context.folder)
        for path, value in changes.items():
            refuse_new_number(data, str(path), self.context.source)
            set_by_path(data, path, value, self.context.source)
        return self._rebuilt(data)

    def parametrise(self, paths: Iterable[str]) -> Callable[[Mapping[str, Any]], Material]:
        """Return a function from values at recipe paths to materials, much faster than repeated `vary`.

        Files are read once: a later change of a file has no effect on the function.

        Raises:
            RecipeError: a path does not exist in the recipe.

        Example:
            >>> layers = [{"material": "SiO2", "thickness_nm": 100}]
            >>> candidate = nacre.material({"family": "film", "substrate": "Si", "layers": layers})
            >>> at = candidate.parametrise(["layers[0].thickness_nm"])
            >>> at({"layers[0].thickness_nm": 420}).get("layers[0].thickness_nm")
            420
        """
        return Parametrisation(self, paths, read_recipe, material_from_data)

    def with_parts_loaded(self, paths: Iterable[str]) -> Material:
        """Return the material with nested recipe files replaced by tables if one paths leads into them.

        `first.layers[0].thickness_nm` names a number of the recipe that `first = {recipe = "film.toml"}` names.

        Raises:
            RecipeError: a nested recipe cannot be read.
        """
        return self._with_data(open_parts(self.data, paths, self.context.folder))

    def inlined(self) -> Material:
        """Return the material with every nested recipe file replaced by its table.

        Raises:
            RecipeError: a nested recipe cannot be read.
        """
        return self._with_data(open_all(self.data, self.context.folder))

    def _with_data(self, data: Mapping[str, Any]) -> Material:
        return self if data == self.data else self._rebuilt(data)

    def _rebuilt(self, data: Mapping[str, Any]) -> Material:
        return material_from_data(data, dataclasses.replace(self.context, text="", snapshot=None))

    def at_low_fidelity(self, is_reported: bool = False, is_corrected: bool = False) -> Material:
        """Return the material for sweeps, searches and drafts, without an expensive method that it uses by default.

        A method that the recipe names is retained. Materials made of the result by `vary` have low fidelity too.

        Args:
            is_reported: whether the replaced method has been reported, which suppresses the warning.
            is_corrected: whether converged orders follow, so that coarse ones need no warning.
        """
        if self.context.is_low_fidelity or isinstance(self.model, StoredBsdf):
            return self
        if isinstance(self.model, ExpensiveMethod) and self.model.expensive_method and not is_reported:
            logger.warning(
                "%s: alone it takes %s; among many it takes the quick way, unless the recipe names the slow one",
                self.context.source, self.model.expensive_method,
            )  # fmt: skip
        made = material_from_data(self.data, dataclasses.replace(self.context, is_low_fidelity=True))
        if isinstance(made.model, Diffracting) and made.model.coarse_warning and not (is_reported or is_corrected):
            warn_once(self.context.source, made.model.coarse_warning)
        return made

    def at_full_fidelity(self) -> Material:
        """Return the material as its recipe gives it: the inverse of `at_low_fidelity`."""
        if not self.context.is_low_fidelity:
            return self
        return material_from_data(self.data, dataclasses.replace(self.context, is_low_fidelity=False))

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
        """All recipe numbers by their paths: candidates for the parameters of fits and designs."""
        return numbers_of({key: value for key, value in self.data.items() if key not in STUDY_TABLES})

    def layers(self) -> tuple[list[str], list[float]]:
        """Return a stack's media from the light's side and its thicknesses in nm; empty lists for no stack."""
        if "structure" not in self.model.figures:
            return [], []
        try:
            data = self.figure_data("structure")
        except NacreError:
            return [], []
        if "thicknesses_nm" not in data or "names" not in data:
            return [], []
        return [str(name) for name in data["names"]], [float(d) for d in np.atleast_1d(data["thicknesses_nm"])]

    def _repr_html_(self) -> str:
        return material_html(self)


def _save_entry(bsdf: Bsdf, path: Path) -> None:
    """Write an entry of the disk cache with its key; unpacked, since packing a film takes as long as solving it."""
    replace(bsdf, provenance={**bsdf.provenance, ENTRY: path.stem}).save(path, is_packed=False)


def _load_entry(path: Path) -> Bsdf:
    """Read an entry of the disk cache.

    Raises:
        NacreError: the file is damaged, or belongs to another key.
    """
    bsdf = Bsdf.load(path)
    if bsdf.provenance.get(ENTRY) != path.stem:
        raise NacreError(f"{path}: belongs to another key")
    return replace(bsdf, provenance={key: value for key, value in bsdf.provenance.items() if key != ENTRY})


def _discard(bsdf: Bsdf, path: Path) -> None:
    pass


@dataclass(frozen=True)
class StoredBsdf(Model, ExcessEnergy):
    """A compiled `.nacre` file: a material with solved optics."""

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
        """Return the stored Bsdf; it cannot be computed on another grid.

        Raises:
            UnsupportedError: another wavelength grid is requested.
        """
        if wavelengths_nm is not None and not np.array_equal(wavelengths_nm, self.stored.wavelengths_nm):
            raise UnsupportedError("a compiled .nacre file keeps its wavelengths; give its recipe to choose others")
        return self.stored


MaterialLike = Material | str | Path | Mapping[str, Any]  # the last: a recipe's table


def load(path: MaterialLike) -> Material:
    """Load a material: a recipe (.toml), a compiled file (.nacre), a design folder, or an example by its name.

    An example's name ("soap", "pearl/foil") counts only if no file has that name. A recipe's table is accepted as by
    `material` (its paths are relative to the working folder); a material is returned unchanged.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
        NacreError: the file cannot be read.

    Example:
        >>> nacre.load("soap").family
        'film'
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
    except OSError as error:  # an invalid file name
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
        dependencies = {path.resolve(): file_digest(path)}
        context = RecipeContext(str(path), path.parent.resolve(), text, dependencies=dependencies)
        return Material(StoredBsdf(bsdf), {}, context)
    text = read_text(path, "recipe")
    context = RecipeContext(str(path), path.parent.resolve(), text, ambient=ambient)
    return material_from_data(parse_toml(text, str(path)), _with_loader(context, path.parent, depth + 1))


def _with_loader(context: RecipeContext, folder: Path, depth: int) -> RecipeContext:
    """Return a context that loads nested recipes from files of a folder or from tables."""
    return dataclasses.replace(context, load_recipe=_NestedLoader(context, folder, depth))


@dataclass(frozen=True)
class _NestedLoader:
    """Loads a recipe nested in another one.

    Attributes:
        context: the outer recipe's context, without a loader.
        folder: base of relative paths.
        depth: nesting depth.
    """

    context: RecipeContext
    folder: Path
    depth: int

    def __call__(self, other: str | Mapping[str, Any], ambient: Any = OF_OUTER) -> Material:
        ambient = self.context.ambient if ambient is OF_OUTER else ambient
        if isinstance(other, Mapping):
            ready = dataclasses.replace(self.context, load_recipe=self, text="", ambient=ambient)
            return material_from_data(other, ready)
        return _load(self.folder / other, self.depth, ambient)


def material(data: Mapping[str, Any], folder: str | Path = ".") -> Material:
    """Build a material from a dictionary with a recipe's keys; paths in it are relative to `folder`.

    Raises:
        RecipeError: naming key, value and the allowed values.

    Example:
        >>> nacre.material({"family": "film", "substrate": "Si"}).family
        'film'
    """
    folder = named(folder)
    return material_from_data(data, _with_loader(RecipeContext("recipe", folder.resolve()), folder, 1))


@functools.lru_cache(maxsize=8)
def _restored(
    data: str, source: str, folder: Path, is_low_fidelity: bool, digests: tuple[tuple[str, str], ...]
) -> Material:
    """Return a material from its pickle.

    Raises:
        NacreError: a file that the recipe names has changed since.
    """
    context = dataclasses.replace(
        _with_loader(RecipeContext(source, folder), folder, 1), is_low_fidelity=is_low_fidelity
    )
    made = material_from_data(json.loads(data), context)
    for path, digest in digests:
        if made.context.dependencies.get(Path(path)) != digest:
            raise NacreError(f"{path}: has changed since the recipe was read; start again")
    return made


def loaded(thing: Any) -> Any:
    """Load a path, an example's name or a recipe's table; return anything else unchanged.

    A table with the key `type` belongs to Mitsuba and is returned unchanged.

    Raises:
        NacreError: there is no such material, or it is not valid.
    """
    if isinstance(thing, str | Path) or (isinstance(thing, Mapping) and "type" not in thing):
        return load(thing)
    return thing


def as_material(thing: MaterialLike) -> Material:
    """Return a material unchanged; load a path, an example's name or a recipe's table.

    Raises:
        UnsupportedError: another type.
        NacreError: there is no such material, or it is not valid.
    """
    ready = loaded(thing)
    if not callable(getattr(ready, "bsdf", None)):
        raise UnsupportedError(f"{thing!r:.60} is not a material, no path or name of one and no table of a recipe")
    return cast(Material, ready)


def material_from_data(data: Mapping[str, Any], context: RecipeContext) -> Material:
    """Validate a recipe's dictionary and build the material.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
    """
    data = plain_data(data, context.source)
    spec, context = read_recipe(data, context)
    for remark in lone_axes(data):
        warn_once(context.source, remark)
    if spec is not None:
        return Material(spec.build(context), data, context)  # type: ignore[attr-defined]  # every family has it
    numbers = varying_numbers(data, family_spec(data.get("family"), context.source).varies_by_nodes)
    return Material(Varying.read(numbers, _uniform_variants(data, context), context), data, context)


def read_recipe(data: Mapping[str, Any], context: RecipeContext) -> tuple[RecipeModel | None, RecipeContext]:
    """Return the validated recipe and its context; None rather than the recipe if its numbers vary by nodes.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
    """
    spec_class = family_spec(data.get("family"), context.source)
    names = named_numbers(data, context.source)
    context = dataclasses.replace(context, dependencies={}, versions={}, names=names)
    if spec_class.varies_by_nodes and varying_numbers(data, spec_class.varies_by_nodes):
        return None, context
    own = {key: value for key, value in data.items() if key not in (*STUDY_TABLES, NUMBERS)}
    return validate(spec_class, own, context), context


def _uniform_variants(data: Mapping[str, Any], context: RecipeContext) -> Callable[[Mapping[str, float]], Material]:
    """Return a function that builds the material with uniform values in place of its varying numbers."""
    reported: list[str] = []

    def fixed(values: Mapping[str, float]) -> Material:
        uniform = copy.deepcopy(dict(data))
        for path, value in values.items():
            set_by_path(uniform, path, value, context.source)
        node = material_from_data(uniform, dataclasses.replace(context, is_low_fidelity=True))
        context.add_dependencies(node.context.dependencies)
        context.versions.update(node.context.versions, **{node.family: node.model.version})
        replaced = node.model.replaced_method if isinstance(node.model, ExpensiveMethod) else ""
        if replaced and not reported and not context.is_low_fidelity:
            reported.append(replaced)
            logger.warning(
                "%s: with even numbers it may take %s; with numbers that vary it takes the quick way, unless the "
                "recipe names the slow one", context.source, reported[0],
            )  # fmt: skip
        return node

    return fixed


def recipe_provenance(material: Material) -> dict[str, Any]:
    """Return the provenance that files made from a recipe carry."""
    source = Path(material.context.source).name
    return {"nacre": __version__, "source": source, "recipe": material.text, "fingerprint": material.fingerprint}


# HTML of a material in a notebook: a small rendered sphere and its colour over the angle.

SIDE, SPP = 160, 48
RIBBON_ANGLES_DEG = np.linspace(0.0, 85.0, 60)
# a random walk costs over a second per angle, and its colour changes slowly with the angle
WALK_STRIDE, WALK_SPP = 8, 24
_cache: dict[str, str] = {}
CACHE_SIZE = 32


def material_html(material: Any) -> str:
    """Return picture, colour ribbon and name of a material as HTML; a failed part is replaced by its error."""
    key = f"{material.context.source}\n{material.text}\n{material.fingerprint}"
    if key not in _cache:
        while len(_cache) >= CACHE_SIZE:
            _cache.pop(next(iter(_cache)))
        _cache[key] = _make(material)
    return _cache[key]


def _make(material: Any) -> str:
    try:
        bsdf = material.bsdf()
    except NacreError as error:
        return f"<div><small>{html.escape(str(error))}</small></div>"
    walks = any(lobe.is_stochastic for lobe in bsdf.lobes)
    parts = [
        _attempt(_sphere, bsdf, WALK_SPP if walks else SPP),
        _attempt(_ribbon, material, WALK_STRIDE if walks else 1),
    ]
    title = html.escape(f"{material.name} ({material.family})")
    return f'<div style="display:inline-block"><div>{"".join(parts)}</div><small>{title}</small></div>'


def _attempt(maker: Any, *arguments: Any) -> str:
    try:
        return str(maker(*arguments))
    except NacreError as error:
        return f"<div><small>{html.escape(str(error))}</small></div>"


def _sphere(bsdf: Any, spp: int) -> str:
    from nacre.picture.picture import render

    result = render(bsdf, size=(SIDE, SIDE), spp=spp, progress=False)
    return _image(result.srgb8, "rendered sphere", SIDE)


def _ribbon(material: Any, stride: int) -> str:
    from nacre.light import clip_to_srgb, spectrum_to_rgb_linear, srgb_encode

    angles = RIBBON_ANGLES_DEG[::stride]
    spectrum = material.spectrum(np.radians(angles))
    parts = spectrum.parts()
    total = sum((v for name, v in parts.items() if name.endswith("reflectance")), np.zeros(1))
    few = spectrum_to_rgb_linear(total, spectrum.wavelengths_nm)
    linear = np.stack([np.interp(RIBBON_ANGLES_DEG, angles, channel) for channel in few.T], axis=-1)
    rgb = srgb_encode(clip_to_srgb(linear).rgb)
    row = np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)
    return _image(np.repeat(np.repeat(row[None], 24, axis=0), 3, axis=1), "reflected colour, 0 to 85 degrees", SIDE)


def _image(pixels: np.ndarray, words: str, width: int) -> str:
    uri = png_uri(png_bytes(pixels))
    return f'<img alt="{words}" title="{words}" width="{width}" src="{uri}" style="display:block">'
