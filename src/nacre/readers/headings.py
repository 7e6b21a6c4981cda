"""One vocabulary for headings of tables (quantities, units, errors, angles, polarisations, lamps) and the lines above.

`meanings` returns the possible meanings of a heading. A reader selects those whose quantities it can use and refuses
headings without a meaning.
"""

from __future__ import annotations

import functools
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nacre.readers.measurement import Measurement
from nacre.readers.units import UNITS, VOCABULARY, normal, parse_unit

DIMENSIONS: dict[str, str] = VOCABULARY["dimensions"]
NUMBER_UNITS = ("1", "arbitrary")
ABSOLUTE = ("reflectance", "transmittance", "absorptance", "albedo", "n", "k", "eps1", "eps2", "alpha")  # scaled
SPECTRAL_QUANTITIES = ("wavelength", "energy", "wavenumber", "frequency", "angular_frequency")

# words are compared in lower case without accents, blanks and punctuation; Greek letters are spelt out
WORDS: dict[str, str] = VOCABULARY["words"]
# one or two letters: the case counts
SYMBOLS: dict[str, tuple[str, ...]] = {letters: tuple(names) for letters, names in VOCABULARY["symbols"].items()}
_GREEK: dict[str, str] = VOCABULARY["greek"]
ERROR_WORDS = frozenset(VOCABULARY["lists"]["errors"].split())
_OF_ALL_WORDS: dict[str, tuple[str, ...]] = {}
for _name, _words in WORDS.items():
    for _word in _words.split():
        _OF_ALL_WORDS[_word] = (*_OF_ALL_WORDS.get(_word, ()), _name)
ILLUMINANT_WORDS: dict[str, str] = VOCABULARY["illuminants"]


def _by_word(words: dict[str, str]) -> dict[str, str]:
    return {word: name for name, spelt in words.items() for word in spelt.split()}


_MODES = _by_word(VOCABULARY["modes"])
_POLARISATIONS = _by_word(VOCABULARY["polarisations"])
_IN_CELLS = {**_POLARISATIONS, **_by_word(VOCABULARY["polarisations_in_cells"])}
_WITH_POLARISATION = re.compile(r"(R|T)[ _]?(s|p|TE|TM|S|P)")
# Rs_45, Rp(60): an angle without its unit behind the polarisation
_POLARISED_ANGLE = re.compile(r"(%?\s?[RT])[ _]?(s|p|TE|TM|S|P)[ _]?[\[(]?(\d{1,2}(?:\.\d+)?)[\])]?")
# L*(-15): the geometry of a colour without its unit; 2 and 10 are observers
_COLOUR_ANGLE = re.compile(r"([LabCh]\*?)\s?[\[(](-?(?:15|20|25|30|45|60|70|75|85|105|110))[\])]")
# Psi_65, Delta 70.0: the angle of incidence without its unit
_ELLIPSOMETRIC_ANGLE = re.compile(r"(Psi|psi|PSI|Ψ|ψ|Delta|delta|DELTA|Δ|∆)[ _@]{1,2}(\d{2}(?:\.\d+)?)")
_LAMP_OBSERVER = re.compile(r"\s*([ACE])\s*[/,;]\s*(2|10)\s*°?\s*")
_ANGLE = re.compile(r"@?\s*([-+]?\d+(?:[.,]\d+)?)\s*(?:°|º|deg|degrees?|grad)")
_BRACKET = re.compile(r"[(\[{<]([^()\[\]{}<>]*)[)\]}>]")
_SUFFIX_UNIT = re.compile(
    r"(.*?\S)(?:\s*[/,]\s*|[\s_-]+(?:in[\s_]+)?)"
    r"(nm|um|μm|mum|microns?|micromet(?:er|re)s?|mikrometer|nanomet(?:er|re)s?|angstroms?|Å|mm|cm|eV|ev|meV|THz|GHz|Hz|"
    r"cm-1|cm\^-1|1/cm|per_cm|per_um|per_nm|per cm|per um|per nm|1/um|1/μm|1/nm|μm-1|nm-1|um-1|rad/s|rad/fs|"
    r"%|percent|per_cent|per cent|pct|deg|degrees?|°|rad|px|pixels?)\.?",
    re.IGNORECASE,
)  # fmt: skip
_QUANTITY_OF_UNIT = _by_word(VOCABULARY["bare_units"])
_FILLERS = frozenset(VOCABULARY["lists"]["fillers"].split())
_BRACKET_FILLERS = frozenset(VOCABULARY["lists"]["bracket_fillers"].split())


@dataclass(frozen=True)
class Meaning:
    """Information in a heading.

    Attributes:
        quantity: key of `WORDS`.
        unit: canonical unit, "" if none is stated.
        is_error: whether the column holds the quantity's standard error (with `quantity` "": the previous column's).
        angle_deg: incidence angle in the heading; for colours, the geometry's angle.
        polarisation: "s", "p", "unpolarised", or "".
        mode: "specular", "diffuse", "total", or "".
        illuminant, observer: reference for a colour; the observer is "2" or "10".
        number: index of a repeated quantity, as in L1, a1, b1.
        is_negated: whether the column holds the quantity with the other sign, as "-k".
    """

    quantity: str
    unit: str = ""
    is_error: bool = False
    angle_deg: float | None = None
    polarisation: str = ""
    mode: str = ""
    illuminant: str = ""
    observer: str = ""
    number: int | None = None
    is_negated: bool = False


def degrees(text: str) -> float | None:
    """Return the angle of a heading that is an angle only, such as "15°" or "45 deg"; else None."""
    match = _ANGLE.fullmatch(normal(text))
    return float(match[1].replace(",", ".")) if match else None


def polarisation_word(text: str) -> str | None:
    """Return "s", "p" or "unpolarised" for a cell of a polarisation column, or None."""
    word = re.sub(r"[\s_.-]+", "", normal(text).lower())
    return _IN_CELLS.get(word) or _IN_CELLS.get(word.removesuffix("polarisation").removesuffix("polarization"))


@functools.lru_cache(maxsize=4096)
def meanings(heading: str, unit: str = "") -> tuple[Meaning, ...]:
    """Return the possible meanings of a heading; empty if it is not in the vocabulary.

    Args:
        heading: text of the file.
        unit: canonical unit from a unit row.

    Example:
        >>> [meaning.quantity for meaning in meanings("Wellenlänge / µm")], meanings("Wellenlänge / µm")[0].unit
        (['wavelength'], 'um')
        >>> meanings("R_s (60°)")[0].polarisation, meanings("R_s (60°)")[0].angle_deg
        ('s', 60.0)
    """
    text = normal(heading).strip(" ;,:").removeprefix("#").strip() or normal(heading)
    text = re.sub(r"(?<=[\w'])(''|\u2033|\")(?=\W|$)", " double prime", text)
    text = re.sub(r"(?<=\w)('|\u2032)(?=\W|$)", " prime", text).strip("\"' ")
    if not text:
        return ()
    if polarised := _POLARISED_ANGLE.fullmatch(text):
        text = f"{polarised[1]}_{polarised[2]} ({polarised[3]}°)"
    if re.match(r"[kK]\s?/\s?[sS]\b", text):  # Kubelka-Munk function, not s polarisation
        return ()
    if geometry := _COLOUR_ANGLE.fullmatch(text) or _ELLIPSOMETRIC_ANGLE.fullmatch(text):
        text = f"{geometry[1]} ({geometry[2]}°)"
    text = re.sub(r"^(h\w{0,2}\*?)\s?[°º]$", r"\1 (°)", text)
    if re.match(r"-\s?[^\W\d_]", text):
        return tuple(replace(meaning, is_negated=True) for meaning in meanings(text[1:].strip(), unit))
    own_unit = parse_unit(text)
    if own_unit in _QUANTITY_OF_UNIT and len(text) > 1:
        return (Meaning(_QUANTITY_OF_UNIT[own_unit], own_unit),) if unit in ("", own_unit) else ()
    unbracketed = _BRACKET.sub(r" \1 ", text)
    parsed = (_of_core(unbracketed, Meaning("", unit)) if _is_function(text) else ()) or _of_bracketed(text, unit)
    if text[:1] == "w" and any(one.quantity == "angular_frequency" for one in parsed):  # "w[nm]" names no time
        spoken = "wavelength" if parsed[0].unit in ("nm", "um", "angstrom") else "angular_frequency"
        parsed = tuple(meaning for meaning in parsed if meaning.quantity == spoken)
    return _checked(parsed)


def _is_function(text: str) -> bool:
    """Whether brackets enclose an argument, as in Re(eps), Im(n), S(q), u(R)."""
    return bool(
        re.match(r"\s*((?i:re|im|real|imag|err|std|sigma|σ|tan|cos|abs|sd|log)\s?|[suS])[(\[{]", text)
    ) and not re.search(r"[(\[{]\s*(%|1|-)\s*[)\]}]", text)


def _of_bracketed(text: str, unit: str) -> tuple[Meaning, ...]:
    base = Meaning("", unit)
    core = _BRACKET.sub(" ", text).strip()
    if not core:
        return ()
    confirmed: set[str] | None = None
    for content in _BRACKET.findall(text):
        if re.fullmatch(r"(?i)(real|imag|imaginary|re|im)\.?( part)?", content.strip()):
            core = f"{core} {content}"
            continue
        symbol, comma, rest = content.partition(",")
        if symbol.strip()[:1] == "%" and len(symbol.strip()) > 1 and base.unit in ("", "%"):
            base, symbol = replace(base, unit="%"), symbol.strip()[1:]
        names = _lookup(symbol.strip()) if parse_unit(symbol) is None or symbol.strip() == "k" else ()
        names = () if symbol.strip().lower() in ("s", "p", "a", "b", "c", "e") else names
        if names:
            confirmed, content = set(names), rest
        stated = _qualified(content, base)
        if stated is None:
            return ()
        base = stated
    parsed = _of_core(core, base)
    return tuple(meaning for meaning in parsed if confirmed is None or meaning.quantity in confirmed)


def _qualified(content: str, base: Meaning) -> Meaning | None:
    """Extend a meaning by the content of brackets: unit, angle, polarisation, mode, lamp, observer."""
    content = content.strip()
    if not content:
        return base
    if lamp := _LAMP_OBSERVER.fullmatch(content):
        return replace(base, illuminant=lamp[1], observer=lamp[2])
    unit = parse_unit(content)
    is_lamp = content.upper() in ("A", "C", "E")
    if unit is not None and not (content in ("s", "p") or (is_lamp and content != "A")):
        return replace(base, unit=unit) if base.unit in ("", unit) or unit in NUMBER_UNITS else None
    for part in [p for p in re.split(r"[,;/|]|\s{2,}|\s(?![\d.]*\s?(?:°|deg))", content) if p.strip()]:
        stated = _qualifier(part.strip(), base)
        if stated is None:
            return None
        base = stated
    return base


def _qualifier(part: str, base: Meaning) -> Meaning | None:
    word = re.sub(r"[\s_.-]+", "", part.lower())
    unit = parse_unit(part)
    if unit is not None and word not in ("s", "p", "c", "e") and base.unit in ("", unit):
        return replace(base, unit=unit)
    match = _ANGLE.fullmatch(part)
    if match:
        value = float(match[1].replace(",", "."))
        if base.illuminant and value in (2.0, 10.0):
            return replace(base, observer=f"{value:g}")
        return replace(base, angle_deg=value) if base.angle_deg is None else None
    if word in ("hunter", "hunterlab"):
        return replace(base, mode="hunter")
    if part in ("±", "+/-"):
        return replace(base, is_error=True)
    if (measured := _how_measured(word, base)) is not None:
        return measured
    if word in ILLUMINANT_WORDS:
        moved = replace(base, illuminant=ILLUMINANT_WORDS[word])
        if moved.angle_deg in (2.0, 10.0):  # "10°/D65": the observer comes first
            moved = replace(moved, angle_deg=None, observer=f"{moved.angle_deg:g}")
        return moved
    if word in ("2", "10", "1931", "1964", "cie1931", "cie1964", "cie31", "cie64") and base.illuminant:
        return replace(base, observer="10" if "64" in word or word == "10" else "2")
    return base if word in _BRACKET_FILLERS else None


def _how_measured(word: str, base: Meaning) -> Meaning | None:
    """Return the meaning with an error, a polarisation or a mode that a word states, or None."""
    if word in ERROR_WORDS:
        return replace(base, is_error=True)
    if word in _POLARISATIONS:
        return replace(base, polarisation=_POLARISATIONS[word])
    return replace(base, mode=_MODES[word]) if word in _MODES else None


def _spelt(text: str) -> str:
    """Spell Greek letters out and drop accents."""
    text = "".join(f" {_GREEK[c]} " if c in _GREEK and c not in "μ" else c for c in text)
    text = text.replace("ß", "ss")
    decomposed = unicodedata.normalize("NFD", text)
    return unicodedata.normalize("NFC", "".join(c for c in decomposed if unicodedata.category(c) != "Mn"))


def _of_core(core: str, base: Meaning) -> tuple[Meaning, ...]:
    """Return the meanings of a heading without brackets."""
    core = core.strip(" :=")
    per_cent = re.fullmatch(r"%\s*(.+)|(.+?)\s*%", core)
    if per_cent and base.unit in ("", "%"):
        core, base = (per_cent[1] or per_cent[2]).strip(" /_,"), replace(base, unit="%")
    if candidates := _of_words(core, base):
        return candidates
    match = _SUFFIX_UNIT.fullmatch(core) or re.fullmatch(r"(\w{3,}.*?)\s*/\s*(m)", core)
    if match:
        spelt = re.sub("per[_ ]", "1/", re.sub("per[_ ]cent", "percent", match[2].lower()))
        unit = parse_unit(spelt) or parse_unit(match[2])
        if unit and base.unit in ("", unit):
            return _of_words(match[1].strip(" /_,-"), replace(base, unit=unit))
    return ()


def _of_words(core: str, base: Meaning) -> tuple[Meaning, ...]:
    is_sigma = _spelt(core).strip().lower() == "sigma" and (not base.unit or UNITS[base.unit][0] != "wavenumber")
    if core.strip() in ("±", "+/-", "+-") or is_sigma:
        return (replace(base, is_error=True),)
    match = _WITH_POLARISATION.fullmatch(core)
    if match:
        quantity = "reflectance" if match[1] == "R" else "transmittance"
        return (replace(base, quantity=quantity, polarisation=_POLARISATIONS[match[2].lower()]),)
    numbered = re.fullmatch(r"([Llab])[*_ ]?\s?(\d)", core)
    if numbered:
        return (replace(base, quantity=numbered[1].replace("l", "L"), number=int(numbered[2])),)
    match = re.fullmatch(r"[dΔδ]\s?([RTnk])|[dΔδ](Psi|Delta|psi|delta|Ψ|Δ)|u\s?([RTnk])", core)
    if match:
        inner = _of_words(match[1] or match[2] or match[3], base)
        return tuple(replace(meaning, is_error=True) for meaning in inner)
    mueller = re.fullmatch(r"[mM][_ ]?([1-4][1-4])", core)
    if mueller:
        return (replace(base, quantity=f"m{mueller[1]}"),)
    candidate = _lookup(core)
    if candidate:
        return tuple(replace(base, quantity=name) for name in candidate)
    return _peeled(core, base)


def _lookup(core: str) -> tuple[str, ...]:
    letters = re.sub(r"[\s_.:*^{}\\$~-]+", "", core)
    if letters in SYMBOLS:
        return SYMBOLS[letters]
    spelt = re.sub(r"[\s_.:*^{}\\$~,'-]+", "", _spelt(core))
    if spelt in SYMBOLS:
        return SYMBOLS[spelt]
    return _OF_ALL_WORDS.get(spelt.lower(), ()) if len(spelt) > 1 else ()


def _qualified_by(word: str, tokens: list[str], base: Meaning) -> Meaning | None:
    """Extend a meaning by a word beside the quantity: error, polarisation, mode, lamp, observer."""
    if word == "±":
        return replace(base, is_error=True)
    if (measured := _how_measured(word, base)) is not None:
        return measured
    if word in _FILLERS:
        return base
    if word in ILLUMINANT_WORDS and len(word) > 1:
        return replace(base, illuminant=ILLUMINANT_WORDS[word])
    has_lamp = bool(base.illuminant) or any(_spelt(token).lower() in ILLUMINANT_WORDS for token in tokens)
    return replace(base, observer=word) if word in ("2", "10") and has_lamp else None


def _peeled(core: str, base: Meaning) -> tuple[Meaning, ...]:
    """Return the meanings of a heading after removing words for errors, polarisation, mode, angle, lamp or observer."""
    angle = _ANGLE.search(core)
    if angle and core.strip() != angle[0].strip():
        rest = (core[: angle.start()] + " " + core[angle.end() :]).strip(" @,_-/")
        stated = _qualifier(angle[0].strip(" @"), base)
        candidates = _of_core(re.sub(r"\b(at|bei|aoi)\s*$", "", rest).strip(), stated) if stated and rest else ()
        if candidates:
            return candidates
    tokens = [token for token in re.split(r"[\s_,/-]+", core) if token]
    if len(tokens) < 2 and (camel := re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[^\W\d_]", core)) and len(camel) > 1:
        tokens = camel if "".join(camel) == core else tokens
    if len(tokens) < 2:
        is_error = len(tokens) == 1 and _spelt(tokens[0]).strip().lower() in ERROR_WORDS
        return (replace(base, is_error=True),) if is_error else ()
    if len(tokens) == 2 and (both := set(_lookup(tokens[0])) & set(_lookup(tokens[1]))):  # "Wavelength λ"
        return tuple(replace(base, quantity=name) for name in sorted(both))
    for place in (len(tokens) - 1, 0, *range(1, len(tokens) - 1)):
        word = _spelt(tokens[place]).strip().lower()
        stated = _qualified_by(word, tokens, base)
        if stated is None:
            continue
        candidates = _of_core(" ".join(tokens[:place] + tokens[place + 1 :]), stated)
        if candidates and (stated != base or word not in ("hunter", "lab")):
            return candidates
    return ()


def _checked(candidates: tuple[Meaning, ...]) -> tuple[Meaning, ...]:
    """Drop meanings whose unit has another dimension than the quantity."""
    valid = []
    for meaning in candidates:
        if meaning.quantity == "time" and meaning.polarisation == "s":
            meaning = replace(meaning, unit="s", polarisation="")
        if meaning.quantity in ("L", "a", "b", "C", "hue"):
            if meaning.mode == "hunter":
                meaning = replace(meaning, quantity=f"hunter_{meaning.quantity}", mode="")
            if meaning.unit == "angstrom":
                meaning = replace(meaning, unit="", illuminant="A")
        wanted = DIMENSIONS.get(meaning.quantity)
        unit = meaning.unit
        if unit == "arbitrary" and meaning.quantity in ABSOLUTE:
            continue
        if unit and unit not in NUMBER_UNITS and wanted != UNITS[unit][0]:
            stated = _of_other_dimension(meaning)
            if stated is not None:
                valid.append(stated)
            continue
        if unit in NUMBER_UNITS:
            if wanted is not None and wanted != "number":
                continue
            meaning = replace(meaning, unit="")
        valid.append(meaning)
    return tuple(dict.fromkeys(valid))


def _of_other_dimension(meaning: Meaning) -> Meaning | None:
    """Return the meaning of a symbol whose unit decides: ω in eV, x in pixels, counts, R in per cent."""
    name, unit = meaning.quantity, meaning.unit
    kind = UNITS[unit][0]
    if (name in ("angular_frequency", "frequency") and kind == "energy") or (name, kind) == ("frequency", "wavenumber"):
        return replace(meaning, quantity=kind)
    if name in DIMENSIONS:
        return meaning if kind == "pixels" and name in ("x", "y", "radius", "diameter", "z") else None
    if (name, kind) == ("intensity", "counts"):
        return replace(meaning, quantity="counts")
    is_number = kind == "number" and name not in ("n", "k", "eps1", "eps2", "L", "a", "b", "X", "Y", "Z")
    return meaning if is_number or (kind == "counts" and name.endswith("counts")) else None


_WORD = re.compile(r"[^\W\d_]+\d?(?:[_'-]?[^\W\d_]+)*|%", re.UNICODE)
_TELLING = frozenset(
    "energy wavenumber frequency angular_frequency eps1 eps2 alpha psi delta tan_psi cos_delta transmittance "
    "reflectance absorbance absorptance counts irradiance k".split()
)
_UNIT_TELLS = {"energy": "energy", "wavenumber": "wavenumber", "frequency": "frequency"}


def mentions(text: str) -> set[str]:
    """Return the quantities that a line of free text names by a word of at least two letters, or by a unit.

    Example:
        >>> sorted(mentions("dielectric function e1, e2 over energy (eV)"))
        ['energy', 'eps1', 'eps2']
    """
    quantities: set[str] = set()
    for word in _WORD.findall(normal(text)):
        unit = parse_unit(word) if len(word) > 1 else None
        if unit is not None and UNITS[unit][0] in _UNIT_TELLS:
            quantities.add(UNITS[unit][0])
        elif len(word) > 1 or word in "ελΨΔψ":
            quantities.update(name for name in _lookup(word) if name in _TELLING)
    return quantities


def stated_unit(heading: str) -> str:
    """Return the canonical unit that a heading of any quantity states; "" if there is none.

    Example:
        >>> stated_unit("oxide_nm"), stated_unit("Oxide (um)"), stated_unit("volts")
        ('nm', 'um', '')
    """
    text = normal(heading)
    match = _SUFFIX_UNIT.fullmatch(text)
    texts = [*_BRACKET.findall(text), *([match[2]] if match else [])]
    return next(filter(None, map(parse_unit, texts)), "")


# Incidence angle and polarisation in the lines above a table, such as "AOI = 45 deg" or "s-polarized".

_KEY_VALUE = re.compile(r"[\s#%!;*/']*([^:=\t;,]{1,40}?)\s*[:=\t;,]+\s*(\S.*?)[\s;,]*")
_VALUE = re.compile(r"([-+]?\d+(?:[.,]\d+)?)\s*(°|º|deg\w*\.?|grad|rad\w*|mrad)?", re.IGNORECASE)
_DEGREES = r"(\d+(?:[.,]\d+)?)\s*(?:°|º|deg(?:rees?)?\b)(?!\s*[CF]\b)"
_AT_ANGLE = re.compile(
    rf"(?:\bat|\baoi|incidence|incident|incidence angle|einfallswinkel)\s*(?:of|angle|=|:)?\s*{_DEGREES}"
    rf"|{_DEGREES}\s*(?:\baoi\b|angle of incidence|incidence)",
    re.IGNORECASE,
)
_OTHER_ANGLE = re.compile(
    r"polari[sz]er|analy[sz]er|azimuth|rotat|turned|detect|view|collect|retarder|plate", re.IGNORECASE
)
_LAMP = re.compile(
    r"(?i)\b(?:illuminant|illumination|light source|lamp)\w*\W+"
    r"([a-f]\d{1,2}|(?-i:[ACE])(?!\s+(?!observer|and|with|for|cie)[a-z])|fl\d{1,2}|tl84|cwf)\b"  # not an article
)
_OBSERVER = re.compile(r"(?i)\bobserver\w*\W+(?:angle\W+)?(?:cie\W*)?(10|2|1931|1964)\b|\b(?:D\d\d|A)\s*/\s*(10|2)\b")
_INCIDENCE = re.compile(r"aoi|inciden|einfall", re.IGNORECASE)
_POLARISED = re.compile(r"(?<!['’])\b(s|p|TE|TM|un)[-\s]?(?:pol(?:\.|\b)|polari[sz](?:ed|ation))")
POLARISERS = {0.0: "p", 90.0: "s"}  # angles from the plane of incidence


@dataclass(frozen=True)
class Preamble:
    """Information in the lines above a table.

    Attributes:
        angle_deg: incidence angle; None if not stated.
        polarisation: "s", "p", "unpolarised", or "".
        lines: the lines that state them.
    """

    angle_deg: float | None = None
    polarisation: str = ""
    lines: tuple[str, ...] = ()


def read_preamble(titles: Sequence[str]) -> Preamble:
    """Return the incidence angle and the polarisation that lines above a table state.

    Lines that contradict each other state neither.

    Example:
        >>> read_preamble(["# AOI = 45 deg", "# pol: s"])
        Preamble(angle_deg=45.0, polarisation='s', lines=('# AOI = 45 deg', '# pol: s'))
    """
    angles: dict[float, str] = {}
    words: dict[str, str] = {}
    for title in titles:
        text = normal(title)
        for angle in _angles(text):
            angles.setdefault(angle, title)
        for word in _polarisations(text):
            words.setdefault(word, title)
    one_angle, one_word = len(angles) == 1, len(words) == 1
    lines = [*(angles.values() if one_angle else ()), *(words.values() if one_word else ())]
    return Preamble(
        next(iter(angles)) if one_angle else None, next(iter(words)) if one_word else "", tuple(dict.fromkeys(lines))
    )


def instead_of(above: Preamble, angle_deg: float | None) -> list[str]:
    """Return the remark that a given incidence angle replaces the one above a table."""
    if angle_deg is None or above.angle_deg in (None, angle_deg):
        return []
    return [f"angle_deg = {angle_deg:g} in place of {' and '.join(map(repr, above.lines))}"]


def _angles(text: str) -> list[float]:
    match = _KEY_VALUE.fullmatch(text)
    if match:
        value, stated = _VALUE.fullmatch(match[2]), {each.quantity: each.unit for each in meanings(match[1])}
        if value and "angle_of_incidence" in stated:
            angle, unit = float(value[1].replace(",", ".")), (value[2] or stated["angle_of_incidence"] or "deg").lower()
            if unit.startswith(("rad", "mrad")):
                angle = float(np.degrees(angle)) * (1e-3 if unit == "mrad" else 1.0)
            return [angle]
    return [
        float((at_angle[1] or at_angle[2]).replace(",", "."))
        for at_angle in _AT_ANGLE.finditer(text)
        if _INCIDENCE.search(at_angle[0]) or not _OTHER_ANGLE.search(text[: at_angle.start()])
    ]


def _polarisations(text: str) -> list[str]:
    match = _KEY_VALUE.fullmatch(text)
    stated = {each.quantity: each.unit for each in meanings(match[1])} if match else {}
    if match and "polariser" in stated and (turn := _VALUE.fullmatch(match[2])):
        angle, unit = float(turn[1].replace(",", ".")) % 180.0, (turn[2] or stated["polariser"] or "").lower()
        return [POLARISERS[angle]] if angle in POLARISERS and unit.startswith(("deg", "°", "º", "grad")) else []
    if match and ("polarisation" in stated or "polariser" in stated):
        word = polarisation_word(match[2])
        return [word] if word else []
    letters = (polarisation_word("unpolarised" if each[1] == "un" else each[1]) for each in _POLARISED.finditer(text))
    return [word for word in letters if word]


def light_above(titles: Sequence[str]) -> dict[str, str]:
    """Return `illuminant` and `observer` of colours that lines above a table state.

    Example:
        >>> light_above(["ILLUMINANT\tD50", "Observer: 10°"])
        {'illuminant': 'D50', 'observer': '10deg'}
    """
    light: dict[str, str] = {}
    for title in titles:
        lamp, view = _LAMP.search(title), _OBSERVER.search(title)
        if lamp and (word := ILLUMINANT_WORDS.get(lamp[1].lower())):
            light["illuminant"] = word
        if view:
            light["observer"] = "10deg" if (view[1] or view[2]) in ("10", "1964") else "2deg"
    return light


def with_preamble(measurement: Measurement, above: Preamble) -> Measurement:
    """Return a spectrum with the statements of the lines above it, which its own statements precede."""
    stated = {"angle_of_incidence_deg": above.angle_deg, "polarisation": above.polarisation}
    new = {
        key: value
        for key, value in stated.items()
        if value not in (None, "") and key not in measurement.metadata and key not in measurement.data
    }
    if not new:
        return measurement
    remark = f"angle or polarisation from {' and '.join(map(repr, above.lines))}"
    return replace(measurement, metadata={**measurement.metadata, **new}, assumed=(*measurement.assumed, remark))
