"""Mutated film recipes: whatever is thrown at the loader, only clear one-line errors come back."""

from __future__ import annotations

import copy
import random
import tomllib
from pathlib import Path
from typing import Any

import pytest

from nacre.core.errors import NacreError
from nacre.material.material import material_from_data
from nacre.recipe.model import RecipeContext

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RECIPES = [
    tomllib.loads(path.read_text()) for path in sorted(EXAMPLES.glob("*.toml")) if 'family = "film"' in path.read_text()
]
JUNK: list[Any] = [
    None, True, -1, 0, 1e308, -1e308, float("nan"), float("inf"), 1e-320, 2**70, "", "Si", "∅", "u*v", "a" * 5000,
    "__import__('os').system('true')", "../../etc/passwd", "\x00", [], [[]], [1, 2, 3], {}, {"n": 1.5}, {"n": -1},
    {"n": 1.5, "k": -1}, {"formula": "1/0"}, {"formula": "u" + "+u" * 150}, {"formula": "((((((u))))))^9^9^9"},
    {"texture": "none.png", "min": 0, "max": 1}, {"texture": ".", "min": 0, "max": 1}, {"file": "/dev/null"},
    {"file": "."}, {"rii": "main/Ag"}, {"rii": "////"}, {"cauchy": []}, {"cauchy": [1e9]}, {"sellmeier": [1]},
    {"drude": {}}, {"n_d": 1.5}, b"bytes", object(),
]  # fmt: skip
KEYS = ["family", "layers", "substrate", "thickness_nm", "material", "roughness", "n", "k", "", "🦋", "preset", "min"]


def mutate(node: Any, rng: random.Random) -> Any:
    """Change one place of a recipe's tree."""
    if isinstance(node, dict) and node and rng.random() < 0.85:
        key = rng.choice(list(node))
        action = rng.random()
        if action < 0.6:
            node[key] = mutate(node[key], rng)
        elif action < 0.75:
            del node[key]
        elif action < 0.9:
            node[rng.choice(KEYS)] = copy.deepcopy(rng.choice(JUNK))
        else:
            node[key + rng.choice("sxé")] = node.pop(key)
        return node
    if isinstance(node, list) and node and rng.random() < 0.8:
        i = rng.randrange(len(node))
        if rng.random() < 0.2:
            return node * rng.choice([2, 400])
        node[i] = mutate(node[i], rng)
        return node
    return copy.deepcopy(rng.choice(JUNK))


def throw(count: int, seed: int) -> int:
    """Throw `count` mutated recipes and return how many were refused."""
    rng = random.Random(seed)
    refused = 0
    for _ in range(count):
        data = copy.deepcopy(rng.choice(RECIPES))
        for _ in range(rng.choice([1, 1, 2, 4])):
            data = mutate(data, rng)
            if not isinstance(data, dict):
                data = {"family": "film", "layers": data}
        data.setdefault("family", "film")
        try:
            material_from_data(data, RecipeContext("fuzz.toml", EXAMPLES))
        except NacreError as error:
            message = str(error)
            assert message.startswith("fuzz.toml") and "\n" not in message and len(message) < 1000, message
            refused += 1
    return refused


def test_mutated_recipes_give_clear_errors_only() -> None:
    assert throw(400, seed=1) > 200


@pytest.mark.full
def test_many_mutated_recipes_give_clear_errors_only() -> None:
    assert throw(2000, seed=2) > 1000
