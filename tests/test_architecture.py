"""The house rules of DESIGN section 2, kept by reading the imports."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SRC = Path(__file__).resolve().parents[1] / "src" / "nacre"
WINGS = ("film", "pearl", "metasurface", "relief", "measured", "blend")
FACES = ("cli", "recipe", "api", "verbs", "design", "study", "render", "plot", "exchange", "notebook", "doctor")
MAX_LINES = 500
LONGER_FILES: dict[str, str] = {}  # path -> reason


def imports(path: Path) -> set[str]:
    """Return the modules a file imports anywhere in it, lazily or not."""
    found: set[str] = set()
    package = ["nacre", *path.relative_to(SRC).with_suffix("").parts]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: -node.level]) if node.level else ""
            module = ".".join(part for part in (base, node.module or "") if part)
            found.add(module)
            if module == "nacre" or module.count(".") == 0:
                found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def files(*packages: str) -> list[Path]:
    """Return the Python files of the named packages of nacre."""
    paths: list[Path] = []
    for package in packages:
        folder = SRC / package
        paths += sorted(folder.rglob("*.py")) if folder.is_dir() else [SRC / f"{package}.py"]
    return [path for path in paths if path.exists()]


def offences(paths: list[Path], forbidden: tuple[str, ...]) -> list[str]:
    """Return 'file imports module' for each import of a forbidden module or of something inside it."""
    return [
        f"{path.relative_to(SRC)} imports {module}"
        for path in paths
        for module in sorted(imports(path))
        if any(module == f or module.startswith(f + ".") for f in forbidden)
    ]


@pytest.mark.parametrize("wing", WINGS)
def test_a_wing_knows_neither_another_wing_nor_a_face(wing: str) -> None:
    others = tuple(f"nacre.{other}" for other in (*WINGS, *FACES) if other != wing)
    assert offences(files(wing), others) == []


def test_the_core_knows_no_wing_and_no_face() -> None:
    forbidden = tuple(f"nacre.{other}" for other in (*WINGS, *FACES))
    assert offences(files("light", "matter", "bsdf"), forbidden) == []


def test_render_plot_and_exchange_know_no_wing() -> None:
    forbidden = tuple(f"nacre.{other}" for other in (*WINGS, "recipe", "api", "verbs", "cli", "design", "study"))
    assert offences(files("render", "plot", "exchange"), forbidden) == []


def test_design_and_study_do_not_import_the_command_line() -> None:
    assert offences(files("design", "study", "recipe", "api"), ("nacre.cli",)) == []


def test_only_render_imports_mitsuba() -> None:
    others = [path for path in SRC.rglob("*.py") if "render" not in path.relative_to(SRC).parts[:1]]
    assert offences(others, ("mitsuba", "drjit")) == []


def test_only_plot_imports_matplotlib() -> None:
    others = [path for path in SRC.rglob("*.py") if "plot" not in path.relative_to(SRC).parts[:1]]
    assert offences(others, ("matplotlib",)) == []


def test_the_product_never_imports_a_test_oracle() -> None:
    oracles = ("tmm", "colour", "treams", "miepython", "torch", "smuthi", "pandas")
    assert offences(sorted(SRC.rglob("*.py")), oracles) == []


def test_nothing_the_user_supplies_is_ever_run() -> None:
    bad = []
    for path in SRC.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec"):
                bad.append(f"{path.relative_to(SRC)}:{node.lineno} calls {node.func.id}")
        if offences([path], ("pickle", "cPickle", "dill", "cloudpickle")):
            bad.append(f"{path.relative_to(SRC)} imports pickle")
    assert bad == []


def test_no_file_is_longer_than_a_reader_holds() -> None:
    lengths = {str(p.relative_to(SRC)): len(p.read_text(encoding="utf-8").splitlines()) for p in SRC.rglob("*.py")}
    assert {name: n for name, n in lengths.items() if n > MAX_LINES and name not in LONGER_FILES} == {}


@pytest.mark.parametrize("command", ["import nacre", "import nacre.cli; nacre.cli.run(['--help'])"])
def test_start_up_loads_nothing_heavy(command: str) -> None:
    heavy = ["jax", "mitsuba", "drjit", "scipy", "matplotlib", "numba", "pydantic"]
    code = f"{command}\nimport sys\nassert not [m for m in {heavy!r} if m in sys.modules], sys.modules.keys()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
