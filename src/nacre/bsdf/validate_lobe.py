"""Validate lobes loaded from a file: field types, invariants, and a trial evaluation.

Invalid files are detected on loading, not during a rendering.
"""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from typing import Any

import numpy as np

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.texture import at_the_middle

TRIAL_COS = np.array([1.0, 0.7, 0.05])
TRIAL_AZIMUTHS = (0.0, 2.0)
LARGEST = 1e15  # far above any index, height in nm, density or BSDF value
ROUNDING = 1e-6  # relative undershoot below 0 that interpolation may cause


def check_lobe(lobe: Lobe) -> None:
    """Check one lobe.

    Raises:
        ValueError: names the invalid part.
    """
    check_fields(lobe)
    lobe.check()
    try:
        with np.errstate(all="ignore"):
            answers = list(_trial(at_the_middle(lobe)))
    except Exception as error:  # inconsistent tables cause various numpy errors
        raise ValueError(f"its {lobe.kind} lobe cannot be evaluated: {type(error).__name__}") from None
    for answer in answers:
        if answer.shape[-1:] != (len(lobe.wavelengths_nm),):
            raise ValueError(f"its {lobe.kind} lobe has values at other wavelengths than its own")
        if not np.isfinite(answer).all() or answer.min() < -ROUNDING * max(float(answer.max()), ROUNDING):
            raise ValueError(f"its {lobe.kind} lobe has values that are negative or not finite")


def _trial(lobe: Lobe) -> typing.Iterator[Any]:
    """Yield the lobe's values at some directions; random walks are left to the renderer."""
    sides = (1.0, -1.0) if lobe.transmits else (1.0,)
    yield from (part for side in sides for part in dataclasses.astuple(lobe.specular(side * TRIAL_COS)))
    if lobe.is_stochastic:
        return
    sine = np.sqrt(1.0 - TRIAL_COS**2)
    for side in sides:
        for azimuth in TRIAL_AZIMUTHS:
            wi = np.stack([sine, 0.0 * sine, TRIAL_COS], axis=-1)
            wo = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), side * TRIAL_COS], axis=-1)
            yield lobe.evaluate(*map(np.ascontiguousarray, np.broadcast_arrays(wi[:, None], wo[None])))


def check_fields(part: Any) -> None:
    """Check a lobe's field types, or of a part, against the class annotations.

    Raises:
        ValueError: names the field.
    """
    for name, declared in _declared(part.__class__).items():
        value = getattr(part, name)
        if isinstance(value, np.ndarray) and value.size and np.abs(value).max() > LARGEST:
            raise ValueError(f"{name} of its {type(part).__name__} has the value {np.abs(value).max():.3g}: too large")
        if not _fits(value, declared):
            raise ValueError(f"{name} of its {type(part).__name__} is a {type(value).__name__}, an invalid type")
        for inner in value if isinstance(value, tuple) else (value,):
            if dataclasses.is_dataclass(inner):
                check_fields(inner)


@functools.lru_cache(maxsize=256)
def _declared(kind: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _fits(value: Any, declared: Any) -> bool:
    origin, arguments = typing.get_origin(declared), typing.get_args(declared)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, argument) for argument in arguments)
    if origin is np.ndarray:
        kind = np.dtype(typing.get_args(arguments[1])[0] if typing.get_args(arguments[1]) else arguments[1]).kind
        # bytes and integers are accepted as floats; text and complex numbers are not
        return isinstance(value, np.ndarray) and value.dtype.kind in {"f": "fiub", "c": "cfiub"}.get(kind, "iub")
    if origin is tuple:
        return isinstance(value, tuple) and (
            all(_fits(inner, arguments[0]) for inner in value)
            if arguments[-1:] == (Ellipsis,)
            else len(value) == len(arguments) and all(map(_fits, value, arguments))
        )
    if origin is typing.Literal:
        return value in arguments
    if declared is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if declared is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return declared is Any or not isinstance(declared, type) or isinstance(value, declared)
