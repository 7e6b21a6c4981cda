"""Lazy imports: callable packages, entry points of other packages, and packages that only a part of nacre uses."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
import types
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from nacre.core.errors import MachineError, NacreError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def make_callable(package: str, target: str) -> None:
    """Make `package` callable: a call runs `target` ("module:function"), which is imported at the first call.

    `nacre.render` and `nacre.material` are packages and functions.
    """
    module_name, function_name = target.split(":")

    class CallableModule(types.ModuleType):
        def __call__(self, *args: Any, **options: Any) -> Any:
            return getattr(importlib.import_module(module_name), function_name)(*args, **options)

    sys.modules[package].__class__ = CallableModule


def entry_points(group: str, own: Collection[str]) -> dict[str, EntryPoint]:
    """Return the entry points that installed packages register under a group, by name, not loaded.

    Args:
        group: "nacre.families" or "nacre.lobes".
        own: names that nacre uses itself.

    Raises:
        NacreError: a name is registered twice or used by nacre.
    """
    points = _scan(group)
    for name in points:
        if name in own:
            raise NacreError(f'entry point "{name}" of {group} ({_giver(points[name])}) has a name reserved for nacre')
    return points


@functools.cache
def _scan(group: str) -> dict[str, EntryPoint]:
    from importlib.metadata import entry_points as installed

    points: dict[str, EntryPoint] = {}
    for point in installed(group=group):
        if point.name in points and points[point.name].value != point.value:
            givers = f"{_giver(points[point.name])} and {_giver(point)}"
            raise NacreError(f'entry point "{point.name}" of {group} is registered twice: by {givers}')
        points[point.name] = point
    return points


def _giver(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.value


# package -> its purpose, and the extra that installs it ("" for nacre itself)
SERVES = {
    "mitsuba": ("pictures", ""),
    "drjit": ("pictures", ""),
    "uvicorn": ("the studio", "studio"),
    "starlette": ("the studio", "studio"),
    "websockets": ("the studio", "studio"),
    "anywidget": ("an object in a notebook", "notebook"),
    "zarr": ("a sweep", "study"),
    "xarray": ("a sweep", "study"),
    "dask": ("a sweep on a cluster", "study"),
    "distributed": ("a sweep on a cluster", "study"),
    "jax": ("the gradient of a stack as a JAX function", "gradient"),
}


def missing_line(package: str) -> str:
    """Return one line that names a missing package, its purpose and the command that installs it; "" for others.

    Example: `missing_line("zarr.storage")` ends with `pip install 'nacre[study]'`.
    """
    root = package.partition(".")[0]
    if root not in SERVES:
        return ""
    purpose, extra = SERVES[root]
    wanted = f"'nacre[{extra}]'" if extra else "nacre"
    return f"{purpose} cannot be made without {root}, which is not installed: pip install {wanted}"


def require(*packages: str) -> None:
    """Check that packages of `SERVES` are installed, without importing them.

    Raises:
        MachineError: a package is missing; the message is `missing_line`.
    """
    for name in packages:
        if importlib.util.find_spec(name) is None:
            raise MachineError(missing_line(name))
