"""Matter: optical constants and what layered media do to a plane wave.

Everything is loaded on first use: the numba and JAX kernels are not needed to read a recipe.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nacre.matter.indices import OpticalConstant, index
    from nacre.matter.stack import Layer, Stack
    from nacre.matter.stratified import Amplitudes, Powers, Response, amplitudes, powers, solve

_LAZY = {
    "OpticalConstant": "nacre.matter.indices",
    "index": "nacre.matter.indices",
    "Layer": "nacre.matter.stack",
    "Stack": "nacre.matter.stack",
    "Amplitudes": "nacre.matter.stratified",
    "Powers": "nacre.matter.stratified",
    "Response": "nacre.matter.stratified",
    "amplitudes": "nacre.matter.stratified",
    "powers": "nacre.matter.stratified",
    "solve": "nacre.matter.stratified",
}

__all__ = [
    "Amplitudes",
    "Layer",
    "OpticalConstant",
    "Powers",
    "Response",
    "Stack",
    "amplitudes",
    "index",
    "powers",
    "solve",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'nacre.matter' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
