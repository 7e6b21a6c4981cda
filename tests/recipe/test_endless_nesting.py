"""Texts that nest without end are refused before they cost memory."""

from __future__ import annotations

import pytest

from nacre.core.errors import RecipeError
from nacre.recipe.toml import parse_toml

DOTS = 100_000
ENDLESS = {
    "a key": "a" + ".a" * DOTS + " = 1",
    "a quoted key": '"a"' + '."a"' * DOTS + " = 1",
    "a key with blanks": "a" + " . a" * DOTS + " = 1",
    "a table": "[a" + ".a" * DOTS + "]",
    "after a text": 'title = """a\n\\\\""" # "\n' + "a.'b'." * DOTS + "c = 1",
}


@pytest.mark.parametrize("where", ENDLESS)
def test_a_key_dotted_without_end_is_refused_before_it_is_read(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory of Python's reader grows with the square of the number of parts: 40 GB here."""
    monkeypatch.setattr("tomllib.loads", lambda text: pytest.fail("it was read"))
    with pytest.raises(RecipeError, match="nested without end"):
        parse_toml(ENDLESS[where], "deep.toml")


def test_dots_in_texts_and_comments_are_no_nesting() -> None:
    dots = "a." * DOTS
    text = f"title = \"{dots}\"\nabout = '''{dots}'''  # {dots}\nnumbers = [{'0.5, ' * 1000}]\n"
    assert parse_toml(text, "dots.toml")["title"] == dots
