"""The opened folder: its recipes, and the fence that prevents the page's recipes from reading other files."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import atomic_path, check_writable, named, plain, read_text, real
from nacre.families import contract
from nacre.light import ILLUMINANTS
from nacre.material.examples import examples, examples_folder
from nacre.material.material import MAX_NESTED_RECIPES, Material, material_from_data
from nacre.recipe.model import RecipeContext
from nacre.recipe.toml import parse_toml

MAX_TEXT = 300_000  # characters
MAX_LISTED = 500
MAX_DEPTH = 3  # folders below the opened one
OTHER_FILE_KEYS = ("target", "recipe")  # files with these keys are targets and sweeps, even if they name a family
EXAMPLE = "example:"  # name prefix for shipped recipes
# starting points for a visitor, one for each type of appearance
STARTS = ("jewel-beetle", "bragg-mirror", "blue-oxide", "morpho-film", "metasurface/silver_on_oxide", "pearl/bottle3")


@dataclass(frozen=True)
class FencedContext(RecipeContext):
    """Recipe context for the page; files outside `fence` are refused.

    Attributes:
        fence: folder that must contain all paths.
        depth: nesting depth.
    """

    fence: Path = dataclasses.field(default_factory=Path)
    depth: int = 0

    def path(self, name: str) -> Path:
        """Resolve a path, including links.

        Raises:
            RecipeError: it leads outside the fence.
        """
        try:
            is_inside = (self.folder / name).resolve().is_relative_to(self.fence)
        except (OSError, ValueError, RuntimeError):
            is_inside = False
        if not is_inside:
            raise RecipeError(f'{self.source}: the file "{str(name)[:80]}" is outside the opened folder')
        return super().path(name)


def build(text: str, source: str, folder: Path, fence: Path, depth: int = 0, ambient: Any = None) -> Material:
    """Build a recipe's text as if it were a file in `folder`.

    Raises:
        RecipeError: an invalid value, or a file outside the fence.
    """
    if depth > MAX_NESTED_RECIPES:
        raise RecipeError(f"{source}: recipes are nested more than {MAX_NESTED_RECIPES} deep; is there a circle?")
    context: FencedContext

    def load_recipe(other: str | Mapping[str, Any], ambient: Any = ambient) -> Material:
        if isinstance(other, Mapping):
            return material_from_data(other, dataclasses.replace(context, text="", ambient=ambient))
        path = real(context.path(other))
        if path.suffix != ".toml":
            raise RecipeError(f'{source}: the recipe "{other[:80]}" should end in .toml')
        return build(read_text(path, "recipe"), str(path), path.parent, fence, depth + 1, ambient)

    context = FencedContext(source, folder, text, load_recipe, ambient, fence=fence, depth=depth)
    return material_from_data(parse_toml(text, source), context)


@dataclass(frozen=True)
class OpenedFolder:
    """The folder that `nacre studio` serves.

    Attributes:
        folder: resolved; recipes are read from it and saved into it.
        first: name of the first recipe shown, or "" to offer the starting points.
    """

    folder: Path
    first: str = ""

    @classmethod
    def of(cls, path: str | None) -> OpenedFolder:
        """Open a recipe or a folder, by default the current folder, which need not contain recipes.

        Raises:
            NacreError: a missing file, or a folder without recipes.
        """
        if path is None:
            return cls(Path.cwd().resolve())
        requested = Path(path)
        if requested.is_dir():
            opened = cls(requested.resolve())
            if not opened.names():
                raise NacreError(
                    f"{path}: contains no recipe (.toml with a family); nacre examples -o {path} writes some"
                )
            return opened
        if requested.suffix not in (".toml", "") or (requested.suffix == "" and requested.exists()):
            raise NacreError(f"{path}: is not a recipe; the studio opens a .toml file or a folder of them")
        if requested.is_file():
            read_text(requested, "recipe")
            return cls(requested.resolve().parent, requested.name)
        if any(example.name == path.removesuffix(".toml") for example in examples()):
            return cls(Path.cwd().resolve(), EXAMPLE + path.removesuffix(".toml"))
        raise NacreError(f"{path}: no such file or folder, and no example of that name")

    def names(self) -> list[str]:
        """Return relative names for the folder's recipes: .toml files with a family, without links that lead out."""
        names: list[str] = []
        for path in sorted(self.folder.rglob("*.toml")):
            inner = path.relative_to(self.folder)
            if len(inner.parts) > MAX_DEPTH + 1 or any(part.startswith(".") for part in inner.parts):
                continue
            if real(path).is_relative_to(self.folder) and _has_family(path):
                names.append(inner.as_posix())
            if len(names) == MAX_LISTED:
                break
        return names

    def place(self, name: str) -> tuple[Path, Path]:
        """Return a recipe's file and its fence.

        Raises:
            NacreError: the name leads outside the folder, or does not name a recipe.
        """
        fence = self.folder
        if name.startswith(EXAMPLE):
            fence, name = examples_folder().resolve(), f"{name.removeprefix(EXAMPLE)}.toml"
        named(fence / name)
        try:
            path = (fence / name).resolve()
        except (OSError, ValueError, RuntimeError):
            raise NacreError(f'"{name[:80]}" is not the name of a recipe') from None
        if not path.is_relative_to(fence) or path.suffix != ".toml" or not name or "\0" in name:
            raise NacreError(f'"{name[:80]}" is not a recipe in the opened folder')
        return path, fence

    def read(self, name: str) -> str:
        """Return a recipe's text.

        Raises:
            NacreError: it cannot be read.
        """
        path, _ = self.place(name)
        if path.exists() and not path.is_file():
            raise NacreError(f'"{name[:80]}" is not a file')
        return read_text(path, "recipe")

    def is_readable(self, name: str) -> bool:
        """Whether a recipe is TOML; its values may still be invalid."""
        try:
            parse_toml(self.read(name), name)
        except NacreError:
            return False
        return True

    def material(self, text: str, name: str) -> Material:
        """Build a recipe's text as the file with that name.

        Raises:
            NacreError: as `build`.
        """
        path, fence = self.place(name)
        return build(text, path.name, path.parent, fence)

    def save(self, name: str, text: str, known: str) -> str:
        """Write a recipe into the folder atomically; return its version.

        Args:
            name: relative to the folder; examples are read-only.
            text: TOML; it may be an invalid recipe.
            known: version that the page last read or wrote; "" for a new file.

        Raises:
            NacreError: it cannot be written, or another program has changed it.
        """
        if name.startswith(EXAMPLE):
            raise NacreError("an example cannot be changed; save it under a name of your own")
        path, _ = self.place(name)
        if path.exists() and version_of(read_text(path, "recipe")) != known:
            raise NacreError(f"{name}: exists already, or was changed by another program; choose another name")
        if not path.parent.is_dir():
            raise NacreError(f"{name}: there is no such folder")
        check_writable(path)
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return version_of(text)

    def store(self, name: str, content: bytes) -> None:
        """Write a file that a recipe refers to into the folder atomically; the same content may exist already.

        Raises:
            NacreError: not a plain file name, another file of this name exists, or it cannot be written.
        """
        if not name or name.startswith(".") or Path(name).name != name or name.endswith(".toml"):
            raise NacreError(f'"{name[:80]}" is not the name of a data file')
        named(self.folder / name)
        path = self.folder / name
        if path.is_symlink() or path.exists():
            if path.is_file() and not path.is_symlink() and path.read_bytes() == content:
                return
            raise NacreError(f"{name}: another file of this name is in the opened folder; rename one of them")
        check_writable(path)
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)


def version_of(text: str) -> str:
    """Return a hash that distinguishes file versions."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _has_family(path: Path) -> bool:
    try:
        if plain(path).stat().st_size > MAX_TEXT:
            return False
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    try:
        data = parse_toml(text, path.name)
        return isinstance(data.get("family"), str) and not any(key in data for key in OTHER_FILE_KEYS)
    except RecipeError:
        return "family" in text  # invalid TOML is listed too: the page shows the mistake


def shown(value: Any) -> str:
    """Return a request's value for an error message: as JSON, in one line, ASCII, shortened."""
    return json.dumps(value)[:40]


def read_lamp(body: Mapping[str, Any]) -> str:
    """Return the requested lamp, by default D65.

    Raises:
        NacreError: it is not known.
    """
    lamp = body.get("lamp", "D65")
    if not isinstance(lamp, str) or lamp not in ILLUMINANTS:
        raise NacreError(f"lamp {shown(lamp)} is not known")
    return lamp


def read_recipe(recipe: Any, opened: OpenedFolder) -> dict[str, str]:
    """Return `text`, `path` and `fence` for a recipe in a request.

    Raises:
        NacreError: text or name is missing, it is too long, or leads outside the folder.
    """
    if not isinstance(recipe, dict) or not all(isinstance(recipe.get(key), str) for key in ("text", "name")):
        raise NacreError("a recipe needs text and name")
    if len(recipe["text"]) > MAX_TEXT:
        raise NacreError(f"{recipe['name'][:80]}: a recipe of {len(recipe['text'])} characters; at most {MAX_TEXT}")
    path, fence = opened.place(recipe["name"])
    return {"text": recipe["text"], "path": str(path), "fence": str(fence)}


def read_choice(body: Mapping[str, Any], key: str, default: str | None, allowed: tuple[str, ...]) -> str | None:
    """Return one of the known words from a request, or the default.

    Raises:
        NacreError: another value.
    """
    value = body.get(key)
    if value is None:
        return default
    if not isinstance(value, str) or value not in allowed:
        raise NacreError(f"{key} {shown(value)} is not known; choose from {', '.join(allowed)}")
    return value


def read_number(value: Any, name: str, low: float, high: float) -> float:
    """Return a number within its limits.

    Raises:
        NacreError: it is not a number, or is outside the limits.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise NacreError(f"{name} = {shown(value)} is not allowed; it should be from {low:g} to {high:g}")
    return float(value)


def built(recipe: Mapping[str, str]) -> Material:
    """Return the material for a recipe from `read_recipe`.

    Raises:
        NacreError: the recipe is invalid, or reads a file outside its fence.
    """
    path = Path(recipe["path"])
    return build(recipe["text"], path.name, path.parent, Path(recipe["fence"]))


# Azimuth and polarisation of the light on films that mix polarisations: anisotropic and twisted ones.

POLARISATIONS = ("both", "s", "p", "left", "right")
MAX_AZIMUTH_DEG = 360.0


@dataclass(frozen=True)
class Incidence:
    """The light on the material.

    Attributes:
        azimuth_deg: azimuth of the direction towards the light, from u, for all colours and spectra.
        polarisation: for the spectra in the chart; colours use unpolarised light.
    """

    azimuth_deg: float = 0.0
    polarisation: str = "both"


UNPOLARISED = Incidence()


def read_incidence(body: Mapping[str, Any]) -> Incidence:
    """Return the light that a request selects by `azimuth_deg` and `polarisation`.

    Raises:
        NacreError: a value is not allowed.
    """
    azimuth = read_number(body.get("azimuth_deg", 0.0), "azimuth_deg", -MAX_AZIMUTH_DEG, MAX_AZIMUTH_DEG)
    return Incidence(azimuth, read_choice(body, "polarisation", "both", POLARISATIONS) or "both")


def mixes_polarisations(material: Material) -> bool:
    """Whether azimuth and polarisation of the light can be selected for a material."""
    return isinstance(material.model, contract.Polarised) and material.model.mixes_polarisations


def spectrum_from(
    material: Material, theta_rad: Array, wavelengths_nm: Array | None, incidence: Incidence
) -> Spectrum | None:
    """Return the model's spectra, or None if its Bsdf has to be integrated.

    Args:
        theta_rad: `[angle]`.
        wavelengths_nm: `[wavelength]`; default: those of the model.
        incidence: applies to materials that mix polarisations; others are seen by unpolarised light from u.
    """
    model = material.model
    if incidence == UNPOLARISED or not (isinstance(model, contract.Polarised) and model.mixes_polarisations):
        return model.spectrum(theta_rad, wavelengths_nm, "both", 0)
    azimuth = math.radians(incidence.azimuth_deg)
    return model.polarised_spectrum(theta_rad, wavelengths_nm, incidence.polarisation, azimuth)
