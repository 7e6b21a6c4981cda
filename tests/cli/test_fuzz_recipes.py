"""Mutated recipes of every family and mutated targets: a material or one clear line, never a traceback, never slow."""

from __future__ import annotations

import copy
import random
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nacre.errors import NacreError
from nacre.recipe import dump_toml, load

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
QUICK, FULL = 500, 10_000
HANG_S = 5.0
STRANGE: list[Any] = [
    0, -1, 1, 2, 1e-300, 1e300, -1e300, float("inf"), float("nan"), 10**30, 0.5, 1.0000001, True, False, "", " ", "Si",
    "TiO3", "a" * 3000, "../../etc/passwd", "/dev/zero", "/", ".", "x.png", "\x00", "ggx", "nan", [], [[]], [1, 2],
    [0.1, 0.2], {}, {"n": 1.5}, {"n": -1}, {"k": 1}, {"n": 1.5, "k": -1}, {"cauchy": []}, {"cauchy": ["a"]},
    {"file": "none.csv"}, {"rii": "main/Ag/Nobody"}, {"formula": "u"}, {"formula": "1/0"}, {"formula": "("},
    {"texture": "x.png"}, {"recipe": "self.toml"}, {"sellmeier": [1, 2, 3]}, {"abbe": 0, "n_d": 1.5},
    {"min": 3, "max": 1}, "\u2603",
    [{}] * 50,
]  # fmt: skip


def seeds() -> list[Path]:
    return sorted(p for p in EXAMPLES.rglob("*.toml") if p.name != "gallery.toml" and is_recipe(p))


def is_recipe(path: Path) -> bool:
    data = tomllib.loads(path.read_text())
    return "family" in data and "target" not in data


def targets() -> list[Path]:
    return sorted(p for p in EXAMPLES.rglob("*.toml") if "target" in tomllib.loads(p.read_text()))


def places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every (container, key) of nested data."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in list(items):
        yield data, key
        if isinstance(value, dict | list):
            yield from places(value)


def mutate(data: dict[str, Any], generator: random.Random) -> str:
    """Return the TOML of a recipe with one to three things wrong, or its text with some bytes changed."""
    data = copy.deepcopy(data)
    for _ in range(generator.choice([1, 1, 1, 2, 3])):
        holder, key = generator.choice(list(places(data)) or [(data, "family")])
        action = generator.randrange(6)
        if action == 0 and isinstance(holder, dict):
            holder.pop(key, None)
        elif action == 1 and isinstance(holder, dict) and key in holder:
            holder[str(key)[:-1] + generator.choice("xyz_ ")] = holder.pop(key)
        elif action == 2 and isinstance(holder, list) and len(holder) > key:
            holder.append(copy.deepcopy(holder[key]))
        else:
            holder[key] = copy.deepcopy(generator.choice(STRANGE))
    text = dump_toml(data)
    if generator.random() < 0.15:
        letters = list(text)
        for _ in range(generator.randrange(1, 6)):
            if letters:
                letters[generator.randrange(len(letters))] = generator.choice('[]{}="\\\n\x01\u00e9#.,0')
        text = "".join(letters)
    return text


def throw(count: int, folder: Path, sources: list[Path], read: Any, seed: int) -> tuple[int, int]:
    """Read `count` mutated files; return how many were accepted and how many refused."""
    generator = random.Random(seed)
    read_in = [tomllib.loads(p.read_text()) for p in sources]
    accepted = refused = 0
    path = folder / "self.toml"
    for number in range(count):
        text = mutate(generator.choice(read_in), generator)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        start = time.perf_counter()
        try:
            read(path)
            accepted += 1
        except NacreError as error:
            refused += 1
            assert "\n" not in str(error), f"{number}: {error!s}"
            assert "Traceback" not in str(error)
        except Exception as error:
            raise AssertionError(f"mutation {number} (seed {seed}):\n{text}") from error
        assert time.perf_counter() - start < HANG_S, f"mutation {number} (seed {seed}) is slow:\n{text}"
    assert {p.name for p in folder.iterdir()} == {"self.toml"}
    return accepted, refused


def read_target(path: Path) -> None:
    from nacre.design.run import load_target

    spec, context = load_target(path)
    spec.build(context)


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
