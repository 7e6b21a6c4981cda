"""Every `>>>` example of a docstring gives the value that it states."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import types
from pathlib import Path

import numpy as np
import pytest

import nacre

SRC = Path(nacre.__file__).parent


def _modules() -> list[str]:
    names = [module.name for module in pkgutil.walk_packages([str(SRC)], "nacre.", onerror=lambda _: None)]
    files = {name: SRC.joinpath(*name.split(".")[1:]) for name in names}
    # a folder of a package that is now a module may still hold compiled files
    both = {name: (path.with_suffix(".py"), path / "__init__.py") for name, path in files.items()}
    paths = {name: file if file.is_file() else package for name, (file, package) in both.items()}
    return [name for name, path in paths.items() if ">>> " in path.read_text(encoding="utf-8")]


def _docstrings(module: types.ModuleType) -> dict[str, str]:
    """Return the docstrings of a module by name; compiled functions carry theirs too."""
    found = {}
    for name, value in vars(module).items():
        if getattr(value, "__module__", None) != module.__name__:
            continue
        found[name] = value.__doc__ or ""
        if isinstance(value, type):
            found |= {f"{name}.{key}": getattr(inner, "__doc__", None) or "" for key, inner in vars(value).items()}
    return found


@pytest.mark.parametrize("name", _modules())
def test_the_examples_of_a_module_hold(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    parser = doctest.DocTestParser()
    for owner, text in _docstrings(module).items():
        if ">>> " in text:
            names = {**vars(module), "nacre": nacre, "np": np}
            report: list[str] = []
            runner.run(parser.get_doctest(text, names, f"{name}.{owner}", module.__file__, 0), out=report.append)
            assert not report, "".join(report)
    assert runner.tries > 0
