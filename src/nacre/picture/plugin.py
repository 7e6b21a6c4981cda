"""Mitsuba and Dr.Jit, imported on first use, and Mitsuba plugins in Python."""

import functools
import importlib
import types
from collections.abc import Callable
from typing import Any, ClassVar

from nacre.device.variant import use_variant


class _LazyModule:
    def __init__(self, load: Callable[[], Any]) -> None:
        self._load = load

    def __getattr__(self, name: str) -> Any:
        return getattr(self._load(), name)


mi: Any = _LazyModule(use_variant)  # Mitsuba in the current variant
dr: Any = _LazyModule(lambda: importlib.import_module("drjit"))


class Plugin:
    """Methods for a Mitsuba plugin; `set_up` takes its arguments.

    Base classes differ between variants and accept no second base, therefore `make_plugin` copies the methods into a
    class for the variant.
    """

    BASE: ClassVar[str] = "SamplingIntegrator"
    is_scalar: bool

    def set_up(self, *arguments: Any, **options: Any) -> None:
        """Initialise the plugin."""


class WrappedIntegrator(Plugin):
    """An integrator that modifies an inner integrator's rays or result."""

    inner: Any

    def aov_names(self) -> list[str]:
        return list(self.inner.aov_names())


def make_plugin(methods: type[Plugin], *arguments: Any) -> Any:
    """Return an instance in the current variant."""
    made = _plugin_class(methods, mi.variant())  # type: ignore[arg-type]  # mypy takes classes for unhashable
    return made(mi.Properties(), *arguments)


@functools.cache
def _plugin_class(methods: type[Plugin], variant: str) -> type:
    base = getattr(mi, methods.BASE)

    def initialise(self: Any, properties: Any, *arguments: Any) -> None:
        base.__init__(self, properties)
        self.set_up(*arguments)

    names: dict[str, Any] = {}
    for each in reversed(methods.__mro__[:-1]):
        names |= {name: value for name, value in vars(each).items() if name not in ("__dict__", "__weakref__")}
    names |= {"is_scalar": variant.startswith("scalar"), "__init__": initialise}
    return types.new_class(methods.__name__, (base,), exec_body=lambda body: body.update(names))
