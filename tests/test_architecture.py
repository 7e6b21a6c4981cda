"""The house rules, kept by reading the imports: floors, circles, who may know what."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
from import_graph import ImportGraph

from nacre.families.registry import FAMILIES

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src" / "nacre"
GRAPH = ImportGraph(SRC)
# from the ground up; rooms of one floor do not know each other, but for the ground's files
FLOORS = (
    ("_version", "core"),
    ("recipe",),
    ("light",),
    ("readers",),
    ("matter",),
    ("bsdf",),
    ("families",),
    ("device",),
    ("formats",),
    ("measure",),
    ("picture",),
    ("material",),
    ("plot",),
    ("optimise",),
    ("analysis",),
    ("render",),
    ("design",),
    ("api",),
    ("studio",),
    ("cli",),
    ("", "__main__"),
)
MOST_ROOMS = 22  # at the top of src/nacre; a person keeps no more in mind
MAX_LINES = 1000
LONGER_FILES: dict[str, str] = {}  # path -> reason


def floor_of(module: str) -> int:
    """Return the number of a module's floor."""
    return next(i for i, rooms in enumerate(FLOORS) if GRAPH.room(module) in rooms)


def who_imports(*names: str) -> dict[str, str]:
    """Return the modules that import one of the packages named, or something inside it, and what."""
    return {
        module: found
        for module in GRAPH.files
        for found in sorted(GRAPH.imports(module))
        if any(found == name or found.startswith(name + ".") for name in names)
    }


def rooms_of(modules: dict[str, str]) -> set[str]:
    return {GRAPH.room(module) for module in modules}


def test_the_graph_sees_every_kind_of_import(tmp_path: Path) -> None:
    package = tmp_path / "nacre"
    (package / "low").mkdir(parents=True)
    files = {
        "__init__.py": "",
        "low/__init__.py": "from nacre.low.inner import thing\n",
        "low/inner.py": "thing = 1\n",
        "top.py": "from nacre.low import thing\n",
        "lazy.py": "def f():\n    import nacre.top\n",
        "typed.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from nacre import lazy\n",
        "text.py": 'PLACES = {"a": "nacre.typed:Name"}\nANCHOR = files("nacre.low")\n',
        "round.py": "from . import text\nimport nacre.back\n",
        "back.py": "from nacre.round import x\n",
    }
    for name, text in files.items():
        (package / name).write_text(text)
    graph = ImportGraph(package)
    assert graph.arrows["nacre.top"] == {"nacre.low.inner"}
    assert graph.arrows["nacre.lazy"] == {"nacre.top"}
    assert graph.arrows["nacre.typed"] == {"nacre.lazy"}
    assert graph.arrows["nacre.text"] == {"nacre.typed"}
    assert graph.circles() == [["nacre.back", "nacre.round"]]


def test_every_room_has_a_floor() -> None:
    assert {GRAPH.room(m) for m in GRAPH.files} <= {room for rooms in FLOORS for room in rooms}


def test_no_files_import_each_other_in_a_circle() -> None:
    assert GRAPH.circles() == []


def test_no_arrow_runs_to_a_higher_floor_or_across_one() -> None:
    wrong = []
    for module, arrows in GRAPH.arrows.items():
        for other in arrows:
            here, there = floor_of(module), floor_of(other)
            across = here == there and here > 0 and GRAPH.room(module) != GRAPH.room(other)
            if there > here or across:
                wrong.append(f"{module} imports {other}")
    assert wrong == []


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_known_to_its_folder_and_one_line_of_registration_only(family: str) -> None:
    importers = who_imports(f"nacre.families.{family}")
    strangers = [m for m in importers if not m.startswith((f"nacre.families.{family}", "nacre.optimise"))]
    assert strangers == ["nacre.families.registry"]
    inside = [m for m in GRAPH.files if m.startswith(f"nacre.families.{family}")]
    others = [f"nacre.families.{name}" for name in FAMILIES if name != family]
    assert [m for m in inside if any(found.startswith(tuple(others)) for found in GRAPH.imports(m))] == []


def test_nobody_asks_a_material_for_its_family() -> None:
    """No comparison with a family's name and no `isinstance` of a family's class outside the families themselves.

    Designs may name the family that they design, and an importer writes one into recipe text.
    """
    classes = r"isinstance\([^)]*\b(Film|Pearl|Metasurface|Relief|Measured|Blend)(Model)?\b"
    names = r"\bfamily (==|!=|in|not in)\b|\.family (==|!=)|inspect\.signature"
    asks = re.compile(f"{classes}|{names}")
    wrong = []
    for module, path in GRAPH.files.items():
        # `picture.options` inspects a function of the API, no material
        if module.startswith(("nacre.families", "nacre.optimise")) or module == "nacre.picture.options":
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            if asks.search(line):
                wrong.append(f"{module}:{number}: {line.strip()}")
    assert wrong == []


def test_the_top_of_the_package_stays_small() -> None:
    rooms = {p.name for p in SRC.iterdir() if not p.name.startswith("__") and p.name != "py.typed"}
    assert len(rooms) <= MOST_ROOMS, sorted(rooms)


def test_only_the_rooms_of_pictures_import_mitsuba() -> None:
    assert rooms_of(who_imports("mitsuba", "drjit")) <= {"device", "picture", "render"}


def test_only_plot_imports_matplotlib() -> None:
    assert rooms_of(who_imports("matplotlib")) <= {"plot"}


def test_only_the_studio_imports_the_web_server() -> None:
    assert rooms_of(who_imports("starlette", "uvicorn", "websockets", "anyio")) == {"studio"}


def test_the_product_never_imports_a_test_oracle() -> None:
    assert who_imports("tmm", "colour", "treams", "miepython", "torch", "smuthi", "pandas") == {}


def test_what_physics_is_made_of_cannot_be_changed_afterwards() -> None:
    """A material that is shared, cached or a key of a cache must stay what it was."""
    loose = [
        f"{module}: {node.name}"
        for module, tree in GRAPH.trees.items()
        if GRAPH.room(module) in ("light", "matter", "bsdf", "families", "measure", "exchange")
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for decorator in map(ast.unparse, node.decorator_list)
        if "dataclass" in decorator and "frozen=True" not in decorator
    ]
    assert loose == []


def test_nothing_the_user_supplies_is_ever_run() -> None:
    calls = [
        f"{module}:{node.lineno} calls {node.func.id}"
        for module, tree in GRAPH.trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec")
    ]
    assert calls == []
    assert who_imports("pickle", "cPickle", "dill", "cloudpickle") == {}


def test_no_file_is_longer_than_a_reader_holds() -> None:
    lengths = {str(p.relative_to(SRC)): len(p.read_text(encoding="utf-8").splitlines()) for p in SRC.rglob("*.py")}
    assert {name: n for name, n in lengths.items() if n > MAX_LINES and name not in LONGER_FILES} == {}


@pytest.mark.parametrize("command", ["import nacre", "import nacre.cli; nacre.cli.run(['--help'])"])
def test_start_up_loads_nothing_heavy(command: str) -> None:
    heavy = ["jax", "mitsuba", "drjit", "scipy", "matplotlib", "numba", "pydantic", "starlette", "uvicorn"]
    code = f"{command}\nimport sys\nassert not [m for m in {heavy!r} if m in sys.modules], sys.modules.keys()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("folder", ["benchmarks", "validation", "docs", "tools", "examples"])
def test_scripts_import_names_that_exist(folder: str) -> None:
    """What no test runs would otherwise keep the names of rooms that are gone."""
    missing = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "nacre":
                module = importlib.import_module(str(node.module))
                names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                missing += [f"{path.name}: {node.module}.{name}" for name in names if not _is_module(node.module, name)]
    assert missing == []


def _is_module(parent: str | None, name: str) -> bool:
    return importlib.util.find_spec(f"{parent}.{name}") is not None
