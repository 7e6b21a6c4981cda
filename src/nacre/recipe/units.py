"""Numbers written as text, with or without a unit, and their form in a recipe."""

from __future__ import annotations

import re

LENGTH_UNITS_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
_OTHER_LENGTHS_NM = {"å": 0.1, "angstrom": 0.1, "cm": 1e7, "m": 1e9}
_DEGREES = ("deg", "degree", "degrees", "°")
_MEASURE = re.compile(r"([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_]*|[%°])")


def written_as_number(key: str, text: str) -> str | None:
    """Return the correct recipe line, `key = number`, for a number given as text; None if the text is no measure.

    A length retains its unit if recipes accept it; a number without unit has the key's unit.

    Args:
        key: last word of the key, such as `thickness_nm`.
        text: the given text, such as "60 nm" or "0,06 µm".

    Example:
        >>> written_as_number("thickness_nm", "0,06 µm")
        'thickness_um = 0.06'
    """
    match = _MEASURE.fullmatch(text.strip())
    if match is None:
        return None
    number = match[1].replace(",", ".")
    value, unit = float(number), match[2].lower().replace("µ", "u").replace("μ", "u")
    stem, _, own = key.rpartition("_")
    if own in LENGTH_UNITS_NM:
        if unit in LENGTH_UNITS_NM:
            return f"{stem}_{unit} = {value:.12g}"
        if unit in _OTHER_LENGTHS_NM:
            return f"{key} = {value * _OTHER_LENGTHS_NM[unit] / LENGTH_UNITS_NM[own]:.12g}"
    elif own == "deg":
        if unit in _DEGREES:
            return f"{key} = {value:.12g}"
    elif unit == "%":
        return f"{key} = {value / 100:.12g}"
    return None if unit else f"{key} = {value:.12g}"
