"""Incidence angle and polarisation in the lines above a table, such as "AOI = 45 deg" or "s-polarized"."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nacre.readers.headings import ILLUMINANT_WORDS, meanings, polarisation_word
from nacre.readers.measurement import Measurement
from nacre.readers.units import normal

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
    """What the lines above a table state.

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
        float((found[1] or found[2]).replace(",", "."))
        for found in _AT_ANGLE.finditer(text)
        if _INCIDENCE.search(found[0]) or not _OTHER_ANGLE.search(text[: found.start()])
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
    found = (polarisation_word("unpolarised" if each[1] == "un" else each[1]) for each in _POLARISED.finditer(text))
    return [word for word in found if word]


def light_above(titles: Sequence[str]) -> dict[str, str]:
    """Return `illuminant` and `observer` of colours that lines above a table state.

    Example:
        >>> light_above(["ILLUMINANT\tD50", "Observer: 10°"])
        {'illuminant': 'D50', 'observer': '10deg'}
    """
    found: dict[str, str] = {}
    for title in titles:
        lamp, view = _LAMP.search(title), _OBSERVER.search(title)
        if lamp and (word := ILLUMINANT_WORDS.get(lamp[1].lower())):
            found["illuminant"] = word
        if view:
            found["observer"] = "10deg" if (view[1] or view[2]) in ("10", "1964") else "2deg"
    return found


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
    said = f"angle or polarisation from {' and '.join(map(repr, above.lines))}"
    return replace(measurement, metadata={**measurement.metadata, **new}, assumed=(*measurement.assumed, said))
