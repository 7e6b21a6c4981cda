"""Packages of other makers that only a part of nacre uses, and the command that brings a missing one."""

from __future__ import annotations

import importlib.util

from nacre.core.errors import MachineError

# package -> what it serves, and the extra that brings it ("" for nacre itself)
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
    """Return one line that names a missing package, what it serves and the command that brings it; "" for others.

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
        MachineError: one is not; the line of `missing_line`.
    """
    for name in packages:
        if importlib.util.find_spec(name) is None:
            raise MachineError(missing_line(name))
