"""The named materials: which source a bare name in a recipe stands for.

Every name covers 360-830 nm. Most are one entry of the refractiveindex.info database; where no entry covers
the range, or none exists, `splice` says in words what was done instead, and `nacre indices show` prints it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from nacre.matter.indices.database import load_entry
from nacre.matter.indices.models import (
    Cauchy,
    Constant,
    Continued,
    Dispersion,
    Joined,
    Spliced,
    abbe_cauchy,
    cauchy_tail,
)

COLOUR_RANGE_NM = (360.0, 830.0)


@dataclass(frozen=True)
class Default:
    """One named material.

    Attributes:
        name: as recipes write it.
        title: what it is.
        build: makes the dispersion.
        source: database keys or literature.
        splice: what was joined or continued beyond the published data, empty if nothing was.
        aliases: other spellings.
    """

    name: str
    title: str
    build: Callable[[], Dispersion]
    source: str
    splice: str = ""
    aliases: tuple[str, ...] = ()


def _entry(name: str, title: str, key: str, *aliases: str) -> Default:
    return Default(name, title, lambda: load_entry(key).model, key, aliases=aliases)


def _constant(name: str, title: str, n: float, source: str, *aliases: str) -> Default:
    return Default(name, title, lambda: Constant(n), f"n = {n:g}: {source}", aliases=aliases)


def _continued(name: str, title: str, key: str, remark: str, *aliases: str) -> Default:
    def build() -> Dispersion:
        return Continued(load_entry(key).model, *COLOUR_RANGE_NM)

    return Default(name, title, build, key, f"the entry's formula is continued to 360 nm; {remark}", aliases)


def _abbe(name: str, title: str, n_d: float, abbe: float, *aliases: str) -> Default:
    source = f"n_d = {n_d:g}, Abbe number {abbe:g}: Guillen et al. 2020, table A1"
    splice = "no database entry; the two-term Cauchy formula through n_d and the Abbe number, no absorption"
    return Default(name, title, lambda: abbe_cauchy(n_d, abbe), source, splice, aliases)


def _water() -> Dispersion:
    return Joined(load_entry("main/H2O/Daimon-20.0C").model, load_entry("main/H2O/Hale").model)


def _pet() -> Dispersion:
    published = load_entry("organic/polyethylene_terephthalate/Zhang").model
    tail = cauchy_tail(published, (400.0, 450.0, 500.0), COLOUR_RANGE_NM[0])
    return Spliced(tail, published, published.range_nm[0])


_WATER_SOURCE = "main/H2O/Daimon-20.0C (n) and main/H2O/Hale (k)"
_WATER_SPLICE = "n and k come from two entries, as the one with the better n has no k"

DEFAULTS: tuple[Default, ...] = (
    # metals
    _entry("Ag", "silver", "main/Ag/Johnson", "silver"),
    _entry("Al", "aluminium", "main/Al/Rakic", "aluminium", "aluminum"),
    _entry("Au", "gold", "main/Au/Johnson", "gold"),
    _entry("Cr", "chromium", "main/Cr/Johnson", "chromium"),
    _entry("Cu", "copper", "main/Cu/Johnson", "copper"),
    _entry("Fe", "iron", "main/Fe/Johnson", "iron"),
    _entry("Ni", "nickel", "main/Ni/Johnson", "nickel"),
    _entry("Pt", "platinum", "main/Pt/Rakic-BB", "platinum"),
    _entry("Ti", "titanium", "main/Ti/Johnson", "titanium"),
    # not Werner 2009 for Pt and W: its n falls to 0.5 and 0.9 in the visible, where others measure 2.3 and 3.5
    _entry("W", "tungsten", "main/W/Weaver", "tungsten"),
    # semiconductors
    _entry("Si", "silicon, crystalline", "main/Si/Green-2008", "silicon"),
    _entry("Ge", "germanium, crystalline", "main/Ge/Nunley", "germanium"),
    # oxides and other dielectrics
    _entry("SiO2", "silica, fused", "main/SiO2/Malitson", "silica", "fused silica"),
    _continued("TiO2", "titania, rutile, ordinary ray (an upper bound for coatings; see TiO2-film)",
               "main/TiO2/Devore-o", "published from 430 nm; the absorption of rutile below 410 nm is left out",
               "titania", "rutile"),
    _entry("TiO2-film", "titania, amorphous film by atomic layer deposition", "main/TiO2/Siefke"),
    _entry("Al2O3", "alumina, sapphire, ordinary ray", "main/Al2O3/Malitson", "alumina", "sapphire"),
    _entry("Al2O3-film", "alumina, amorphous film by atomic layer deposition", "main/Al2O3/Boidin"),
    _entry("MgF2", "magnesium fluoride, ordinary ray", "main/MgF2/Dodge-o"),
    _continued("ZnS", "zinc sulphide, cubic", "main/ZnS/Debenham",
               "published from 405 nm; absorption, which sets in below 370 nm, is left out"),
    _entry("Si3N4", "silicon nitride", "main/Si3N4/Luke"),
    _entry("ITO", "indium tin oxide, sputtered", "other/In2O3-SnO2/Konig"),
    _entry("Nb2O5", "niobia, film", "main/Nb2O5/Lemarchand", "niobia"),
    _entry("Ta2O5", "tantala, film", "main/Ta2O5/Gao", "tantala"),
    _entry("HfO2", "hafnia, film", "main/HfO2/Al-Kuhaili", "hafnia"),
    _continued("ZrO2", "zirconia, cubic", "main/ZrO2/Wood", "published from 361 nm, one nanometre short",
               "zirconia"),
    _entry("Fe2O3", "iron oxide, haematite, ordinary ray", "main/Fe2O3/Querry-o", "hematite", "haematite"),
    _constant("BiOCl", "bismuth oxychloride, pigment flakes", 2.15,
              "the value that pigment makers state; no database entry"),
    _abbe("mica", "mica, pigment grade", 1.6137, 54.56, "muscovite"),
    # living matter
    _constant("cuticle", "butterfly cuticle", 1.56,
              "the real part commonly taken for Morpho scales (Vukusic et al. 1999); no database entry"),
    Default("chitin", "butterfly scale chitin, dispersive",
            lambda: Cauchy((1.517, 8.80e-3)),
            "n = 1.517 + 0.00880 / l^2, l in um: Leertouwer, Wilts and Stavenga 2011",
            "no database entry; the published Cauchy formula, no absorption"),
    # liquids and gases
    Default("water", "water, 20 C", _water, _WATER_SOURCE, _WATER_SPLICE, ("H2O",)),
    Default("soap film", "soap film: water, which dilute soap changes by less than 0.002", _water, _WATER_SOURCE,
            _WATER_SPLICE, ("soap", "soap-film", "soap water")),
    _constant("oil", "mineral oil", 1.47, "a common value of mineral oils at the d line", "mineral oil"),
    _constant("air", "air, taken as empty; {rii = \"other/air/Ciddor\"} has the 0.0003", 1.0, "by convention"),
    _constant("vacuum", "empty space", 1.0, "by definition"),
    # polymers and glasses
    Default("PET", "polyethylene terephthalate", _pet, "organic/polyethylene_terephthalate/Zhang",
            "published from 400 nm; below, the three-term Cauchy formula through its n at 400, 450 and 500 nm, "
            "no absorption"),
    _continued("PMMA", "polymethyl methacrylate, acrylic glass", "organic/poly_methyl_methacrylate/Szczurowski",
               "published from 405 nm", "acrylic"),
    _continued("polystyrene", "polystyrene", "organic/polystyrene/Sultanova", "published from 437 nm", "PS"),
    _continued("polycarbonate", "polycarbonate", "organic/polycarbonate/Sultanova", "published from 437 nm", "PC"),
    _abbe("polyurethane", "polyurethane lacquer", 1.5650, 24.37, "PU"),
    _constant("polysilazane", "polysilazane lacquer", 1.5550,
              "Guillen et al. 2020, table A1, which gives no dispersion; no database entry"),
    _entry("BK7", "borosilicate crown glass N-BK7", "specs/SCHOTT-optical/N-BK7", "N-BK7", "BK7 glass"),
    _constant("glass", "plain glass without dispersion", 1.5, "by convention; BK7 is the dispersive one"),
)  # fmt: skip


BY_NAME: dict[str, Default] = {d.name: d for d in DEFAULTS}
BY_ANY_NAME: dict[str, Default] = {
    **{alias.lower(): d for d in DEFAULTS for alias in d.aliases},
    **{d.name.lower(): d for d in DEFAULTS},
}


def find_default(name: str) -> Default | None:
    """Return the named material, whatever the capitals, or None."""
    return BY_NAME.get(name) or BY_ANY_NAME.get(name.strip().lower())
