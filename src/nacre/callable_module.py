"""Let a package be called: `nacre.render` is a package of parts and also the verb that people expect."""

from __future__ import annotations

import importlib
import sys
import types
from typing import Any


def make_callable(package: str, target: str) -> None:
    """Make calling `package` call `target` ("module:function"), which is imported at the first call."""
    module_name, function_name = target.split(":")

    class CallableModule(types.ModuleType):
        def __call__(self, *args: Any, **options: Any) -> Any:
            return getattr(importlib.import_module(module_name), function_name)(*args, **options)

    sys.modules[package].__class__ = CallableModule
