"""Mutated recipes of every family and mutated targets: a material or one clear line, never a traceback."""

from __future__ import annotations

import random
import tomllib
from pathlib import Path
from typing import Any

import pytest
from helpers_fuzz import mutate

from nacre.core.errors import NacreError
from nacre.families.registry import FAMILIES, family_names, family_spec
from nacre.material.material import load
from nacre.optimise.run import read_target

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
QUICK, FULL = 500, 10_000


def seeds() -> list[Path]:
    return sorted(p for p in EXAMPLES.rglob("*.toml") if p.name != "gallery.toml" and is_recipe(p))


def is_recipe(path: Path) -> bool:
    data = tomllib.loads(path.read_text())
    return "family" in data and "target" not in data


def targets() -> list[Path]:
    return sorted(p for p in EXAMPLES.rglob("*.toml") if isinstance(tomllib.loads(p.read_text()).get("target"), dict))


def examples_from_outside() -> list[dict[str, Any]]:
    """Return the examples that families of other packages bring."""
    names = [name for name in family_names() if name not in FAMILIES]
    return [dict(family_spec(name, "here").example) for name in names]


def throw(count: int, folder: Path, sources: list[Path], read: Any, seed: int) -> tuple[int, int]:
    """Read `count` mutated files; return how many were accepted and how many refused."""
    generator = random.Random(seed)
    read_in = [tomllib.loads(p.read_text()) for p in sources] + (examples_from_outside() if read is load else [])
    accepted = refused = 0
    path = folder / "self.toml"
    for number in range(count):
        text = mutate(generator.choice(read_in), generator)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        try:
            read(path)
            accepted += 1
        except NacreError as error:
            refused += 1
            assert "\n" not in str(error), f"{number}: {error!s}"
            assert "Traceback" not in str(error)
        except Exception as error:
            raise AssertionError(f"mutation {number} (seed {seed}):\n{text}") from error
    assert {p.name for p in folder.iterdir()} == {"self.toml"}
    return accepted, refused


@pytest.mark.parametrize("family", ["film", "pearl", "metasurface", "relief"])
def test_every_family_has_examples(family: str) -> None:
    assert any(tomllib.loads(p.read_text())["family"] == family for p in [*seeds(), *targets()])


def test_mutated_recipes_give_a_material_or_one_clear_line(tmp_path: Path) -> None:
    accepted, refused = throw(QUICK * 4 // 5, tmp_path, seeds(), load, seed=1)
    assert refused > accepted > 0


def test_mutated_targets_give_a_problem_or_one_clear_line(tmp_path: Path) -> None:
    _, refused = throw(QUICK // 5, tmp_path, targets(), read_target, seed=2)
    assert refused > 0


@pytest.mark.full
@pytest.mark.parametrize("part", range(4))
def test_ten_thousand_mutated_recipes(tmp_path: Path, part: int) -> None:
    throw(FULL * 9 // 40, tmp_path, seeds(), load, seed=10 + part)


@pytest.mark.full
def test_a_thousand_mutated_targets(tmp_path: Path) -> None:
    throw(FULL // 10, tmp_path, targets(), read_target, seed=20)
