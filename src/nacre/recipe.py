"""TOML <-> Material: the only place that knows all families.

A `Recipe` is checked text; its `Material` is the wing's frozen physics plus the text it came from. Any number
of a recipe can be changed by its path (`layers[0].thickness_nm`), which is how sweeps, fits, tolerances and
animations vary a material without knowing what it is.
"""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.spectrum import Spectrum
from nacre.errors import RecipeError, UnsupportedError, did_you_mean
from nacre.files import parse_toml, read_text
from nacre.specs import TEXTURE_KEYS, RecipeContext, RecipeModel, show_value, validate

FAMILIES = {
    "film": "nacre.film.spec:FilmSpec",
    "pearl": "nacre.pearl.spec:PearlSpec",
    "metasurface": "nacre.metasurface.spec:MetasurfaceSpec",
    "relief": "nacre.relief.spec:ReliefSpec",
    "measured": "nacre.measured.spec:MeasuredSpec",
    "blend": "nacre.blend.spec:BlendSpec",
}
MAX_NESTED_RECIPES = 8
STUDY_TABLES = ("fit", "tolerance")  # read by nacre.study: which numbers are free, which vary in manufacture


def family_model(family: object, source: str) -> type[RecipeModel]:
    """Return the recipe model of a family, importing its wing.

    Raises:
        RecipeError: the family is missing or unknown.
    """
    if family is None:
        raise RecipeError(f"{source}: family is missing; give one of {', '.join(FAMILIES)}")
    if not isinstance(family, str) or family not in FAMILIES:
        hint = did_you_mean(family, FAMILIES) if isinstance(family, str) else ""
        raise RecipeError(
            f"{source}: family = {show_value(family)} is not known.{hint} Families: {', '.join(FAMILIES)}"
        )
    module, name = FAMILIES[family].split(":")
    model: type[RecipeModel] = getattr(importlib.import_module(module), name)
    return model


@dataclass(frozen=True)
class Material:
    """A material: its family's frozen parameters (`model`) and the recipe it was built from.

    Attributes:
        model: the wing's object; holds the physics.
        data: the recipe as a dictionary.
        context: file name, folder and text of the recipe.
    """

    model: Any
    data: Mapping[str, Any]
    context: RecipeContext = field(default_factory=RecipeContext)

    @property
    def family(self) -> str:
        """The family's name, such as "film"."""
        return str(self.data.get("family", "stored"))

    @property
    def name(self) -> str:
        """A short name for titles and file names."""
        return Path(self.context.source).stem

    def bsdf(self, wavelengths_nm: ArrayLike | None = None) -> Bsdf:
        """Solve the optics and return the arrays, with their provenance.

        Args:
            wavelengths_nm: vacuum wavelengths, ascending; default: chosen by the material.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """
        grid = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        bsdf: Bsdf = self.model.bsdf(grid)
        provenance = {"nacre": __version__, "recipe": self.context.text, "source": Path(self.context.source).name}
        return dataclasses.replace(bsdf, provenance={**bsdf.provenance, **provenance})

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
            seed: of a pearl's random walk; another one gives independent noise.

        Raises:
            UnsupportedError: the material has no such spectrum.
        """
        grid = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        # only families of random walks have a seed
        walk = {"seed": seed} if "seed" in inspect.signature(self.model.spectrum).parameters else {}
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        result: Spectrum = self.model.spectrum(theta, grid, polarisation, **walk)
        return result

    def figure_data(self, kind: str, **options: Any) -> dict[str, NDArray[Any]]:
        """Return the arrays of a figure that only this family can feed, such as "field" or "structure".

        Raises:
            UnsupportedError: the family has no such figure.
        """
        maker = getattr(self.model, "figure_data", None)
        if maker is None:
            raise UnsupportedError(f'{self.context.source}: a {self.family} has no figure of kind "{kind}"')
        result: dict[str, NDArray[Any]] = maker(kind, **options)
        return result

    def vary(self, changes: Mapping[str, Any]) -> Material:
        """Return the material with some recipe numbers changed, each named by its path.

        Raises:
            RecipeError: a path does not exist or a value is not allowed.

        Example: `soap.vary({"layers[0].thickness_nm": 420})`.
        """
        data = copy.deepcopy(dict(self.data))
        for path, value in changes.items():
            set_by_path(data, path, value, self.context.source)
        return material_from_data(data, dataclasses.replace(self.context, text=dump_toml(data)))

    def get(self, path: str) -> Any:
        """Return the recipe's value at a path such as `strata[0].platelets[0].volume_fraction`.

        Raises:
            RecipeError: the path does not exist in the recipe.
        """
        holder, last = _walk(self.data, path, self.context.source)
        return holder[last]

    def _repr_html_(self) -> str:
        from nacre.notebook import material_html

        return material_html(self)


@dataclass(frozen=True)
class StoredBsdf:
    """A compiled `.nacre` file: a material whose physics was done before."""

    stored: Bsdf

    def bsdf(self, wavelengths_nm: NDArray[np.float64] | None = None) -> Bsdf:
        """Return the stored Bsdf; it cannot be recomputed on another grid.

        Raises:
            UnsupportedError: another wavelength grid is asked for.
        """
        if wavelengths_nm is not None and not np.array_equal(wavelengths_nm, self.stored.wavelengths_nm):
            raise UnsupportedError("a compiled .nacre file keeps its wavelengths; give its recipe to choose others")
        return self.stored

    def spectrum(
        self,
        theta_rad: NDArray[np.float64],
        wavelengths_nm: NDArray[np.float64] | None,
        polarisation: str,
        seed: int = 0,
    ) -> Spectrum:
        """Integrate the stored arrays; `seed` is of a pearl's random walk.

        Raises:
            UnsupportedError: polarisation asked for, or another wavelength grid.
        """
        if polarisation != "both":
            raise UnsupportedError("a compiled .nacre file holds unpolarised values; give its recipe for s or p")
        from nacre.bsdf.hemisphere import bsdf_spectrum

        return bsdf_spectrum(self.bsdf(wavelengths_nm), theta_rad, seed=seed)


def load(path: str | Path) -> Material:
    """Load a material: a recipe (.toml), a compiled file (.nacre) or a design folder.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
        NacreError: the file cannot be read.

    Example: `nacre.load("soap.toml").spectrum([0.0])`.
    """
    return _load(Path(path), depth=0)


def _load(path: Path, depth: int, ambient: Any = None) -> Material:
    if depth > MAX_NESTED_RECIPES:
        raise RecipeError(f"{path}: recipes are nested more than {MAX_NESTED_RECIPES} deep; is there a circle?")
    try:
        is_folder = path.is_dir()
    except OSError as error:  # a name that no file system takes
        raise RecipeError(f"{str(path)[:80]}: cannot be read: {error.strerror}") from None
    if is_folder:
        if not (path / "recipe.toml").is_file():
            raise RecipeError(
                f"{path}: is a folder without a recipe.toml; give a recipe, a .nacre file or a design folder"
            )
        path = path / "recipe.toml"
    if path.suffix == ".nacre":
        bsdf = Bsdf.load(path)
        text = str(bsdf.provenance.get("recipe", ""))
        return Material(StoredBsdf(bsdf), {}, RecipeContext(str(path), path.parent, text))
    text = read_text(path, "recipe")

    def load_recipe(other: str, ambient: Any = ambient) -> Material:
        return _load(_resolve(path, other), depth + 1, ambient)

    context = RecipeContext(str(path), path.parent.resolve(), text, load_recipe, ambient)
    return material_from_data(parse_toml(text, str(path)), context)


def _resolve(recipe: Path, other: str) -> Path:
    return Path(other) if Path(other).is_absolute() else recipe.parent / other


def material(data: Mapping[str, Any], folder: str | Path = ".") -> Material:
    """Build a material from a dictionary with a recipe's keys; paths inside are relative to `folder`.

    Raises:
        RecipeError: naming key, value and what is allowed.

    Example: `nacre.material({"family": "film", "substrate": "Si"})` is a bare silicon wafer.
    """
    folder = Path(folder)

    def load_recipe(other: str, ambient: Any = None) -> Material:
        return _load(folder / other, 1, ambient)

    context = RecipeContext("recipe", folder.resolve(), dump_toml(data), load_recipe)
    return material_from_data(data, context)


def material_from_data(data: Mapping[str, Any], context: RecipeContext) -> Material:
    """Check a recipe's dictionary and build the material.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
    """
    model = family_model(data.get("family"), context.source)
    if model.varies_by_nodes and (numbers := varying_numbers(data, model.varies_by_nodes)):
        from nacre.varying import Varying

        def fixed(values: Mapping[str, float]) -> Material:
            even = copy.deepcopy(dict(data))
            for path, value in values.items():
                set_by_path(even, path, value, context.source)
            return material_from_data(even, context)

        return Material(Varying.read(numbers, fixed, context), copy.deepcopy(dict(data)), context)
    spec = validate(model, {key: value for key, value in data.items() if key not in STUDY_TABLES}, context)
    return Material(spec.build(context), copy.deepcopy(dict(data)), context)


def varying_numbers(data: Any, patterns: tuple[str, ...], path: str = "") -> dict[str, Mapping[str, Any]]:
    """Find the textures and formulas of a recipe that stand at one of the patterns: path -> table.

    Args:
        patterns: such as `strata[].platelets[].volume_fraction`; lengths end in `_nm`, whatever unit a recipe takes.
    """
    if isinstance(data, list):
        inner = [varying_numbers(value, patterns, f"{path}[{i}]") for i, value in enumerate(data)]
        return {key: table for found in inner for key, table in found.items()}
    if not isinstance(data, Mapping):
        return {}
    if set(data) & set(TEXTURE_KEYS):
        pattern = re.sub(r"_(um|mm)$", "_nm", re.sub(r"\[\d+\]", "[]", path))
        return {path: data} if pattern in patterns else {}
    found = {}
    for key, value in data.items():
        found.update(varying_numbers(value, patterns, f"{path}.{key}" if path else str(key)))
    return found


_PATH_PART = re.compile(r"([A-Za-z_][A-Za-z_0-9-]*)((?:\[\d+\])*)$")


def _walk(data: Any, path: str, source: str) -> tuple[Any, Any]:
    """Return the container and the last key of a path."""
    keys: list[Any] = []
    for part in path.split("."):
        match = _PATH_PART.match(part)
        if not match:
            raise RecipeError(f'{source}: "{path}" is not a path; write it like layers[0].thickness_nm')
        keys.append(match[1])
        keys += [int(i) for i in re.findall(r"\d+", match[2])]
    holder = data
    for key in keys[:-1]:
        try:
            holder = holder[key]
        except (KeyError, IndexError, TypeError):
            raise RecipeError(f'{source}: "{path}" does not exist in the recipe') from None
    last = keys[-1]
    exists = (
        (isinstance(holder, Mapping) and last in holder)
        if isinstance(last, str)
        else (isinstance(holder, list) and last < len(holder))
    )
    if not exists and not isinstance(holder, Mapping):
        raise RecipeError(f'{source}: "{path}" does not exist in the recipe')
    return holder, last


def set_by_path(data: dict[str, Any], path: str, value: Any, source: str = "recipe") -> None:
    """Set one value of a recipe's dictionary in place; a missing last key is added (it may have a default).

    Raises:
        RecipeError: the path leads nowhere.
    """
    head, _, _ = path.rpartition(".")
    if head and "[" not in head and head not in data and "." not in head:
        data[head] = {}  # a whole optional table, such as [surface], may be absent
    holder, last = _walk(data, path, source)
    if isinstance(last, str):
        stem, _, unit = last.rpartition("_")
        for other in ("nm", "um", "mm"):
            if unit in ("nm", "um", "mm") and other != unit:
                holder.pop(f"{stem}_{other}", None)
    holder[last] = value


def dump_toml(data: Mapping[str, Any]) -> str:
    """Write a recipe's dictionary as TOML: scalars first, tables as inline tables where they are small.

    Example: `dump_toml({"family": "film"})` is 'family = "film"' and a newline.
    """
    lines = [f"{_toml_key(k)} = {_toml_value(v)}" for k, v in data.items() if not isinstance(v, Mapping)]
    for key, value in data.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{_toml_key(key)}]"]
            lines += [f"{_toml_key(k)} = {_toml_value(v)}" for k, v in value.items()]
    return "\n".join(lines) + "\n"


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
        return f'"{escaped}"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml_key(k)} = {_toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return _toml_value(str(value))
