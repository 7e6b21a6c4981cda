"""Ways to spoil a TOML document or a file: what every fuzz test throws at its reader."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from typing import Any

from nacre.recipe.toml import dump_toml

STRANGE: list[Any] = [
    0, -1, 1, 2, 1e-300, 1e300, -1e300, float("inf"), float("nan"), 10**30, 0.5, 1.0000001, True, False, "", " ", "Si",
    "TiO3", "a" * 3000, "../../etc/passwd", "/dev/zero", "/", ".", "x.png", "\x00", "ggx", "nan", [], [[]], [1, 2],
    [0.1, 0.2], {}, {"n": 1.5}, {"n": -1}, {"k": 1}, {"n": 1.5, "k": -1}, {"cauchy": []}, {"cauchy": ["a"]},
    {"file": "none.csv"}, {"rii": "main/Ag/Nobody"}, {"formula": "u"}, {"formula": "1/0"}, {"formula": "("},
    {"texture": "x.png"}, {"recipe": "self.toml"}, {"sellmeier": [1, 2, 3]}, {"abbe": 0, "n_d": 1.5},
    {"min": 3, "max": 1}, "\u2603",
    [{}] * 50,
]  # fmt: skip


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


def mutate_bytes(content: bytes, generator: random.Random) -> bytes:
    """Return a file with some bytes changed, a piece cut out or doubled, or its end missing."""
    data = bytearray(content)
    for _ in range(generator.choice([1, 1, 2, 4])):
        if not data:
            break
        place, length = generator.randrange(len(data)), generator.choice([1, 1, 4, 16, 200])
        action = generator.randrange(5)
        if action == 0:
            del data[place:]
        elif action == 1:
            del data[place : place + length]
        elif action == 2:
            data[place:place] = data[place : place + length]
        elif action == 3:
            data[place : place + length] = bytes(generator.randrange(256) for _ in range(length))
        else:
            data[place : place + 1] = generator.choice([b"nan", b"-1", b"1e400", b",", b"\n", b"\x00", b"\xff", b'"'])
    return bytes(data)
