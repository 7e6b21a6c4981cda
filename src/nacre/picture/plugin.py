"""Mitsuba plugins in Python, derived from the base class of the current variant."""

from __future__ import annotations

import functools
import types
from typing import Any, ClassVar

from nacre.device.variant import use_variant


class Plugin:
    """Methods of a Mitsuba plugin.

    Base classes differ between variants and accept no second base, therefore `make_plugin` copies the methods into a
    class of the variant. `mi` is Mitsuba; `set_up` takes the arguments.
    """

    BASE: ClassVar[str] = "SamplingIntegrator"
    mi: Any
    is_scalar: bool

    def set_up(self, *arguments: Any, **options: Any) -> None:
        """Initialise the plugin."""


class WrappedIntegrator(Plugin):
    """An integrator that modifies the rays or the result of an inner integrator."""

    inner: Any

    def aov_names(self) -> list[str]:
        return list(self.inner.aov_names())


def make_plugin(methods: type[Plugin], *arguments: Any) -> Any:
    """Return an instance in the current variant."""
    mi = use_variant()
    return _plugin_class(methods, mi.variant())(mi.Properties(), *arguments)


@functools.cache
def _plugin_class(methods: type[Plugin], variant: str) -> type:
    mi: Any = use_variant()
    base = getattr(mi, methods.BASE)

    def initialise(self: Any, properties: Any, *arguments: Any) -> None:
        base.__init__(self, properties)
        self.set_up(*arguments)

    names: dict[str, Any] = {}
    for each in reversed(methods.__mro__[:-1]):
        names |= {name: value for name, value in vars(each).items() if name not in ("__dict__", "__weakref__")}
    names |= {"mi": mi, "is_scalar": variant.startswith("scalar"), "__init__": initialise}
    return types.new_class(methods.__name__, (base,), exec_body=lambda body: body.update(names))
