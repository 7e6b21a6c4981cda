"""Rows of the validation: each limit has a source."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from validation._limits import LIMITS, source_of

VALIDATION = Path(__file__).resolve().parents[1] / "validation"
SCRIPTS = sorted(path.stem for path in VALIDATION.glob("[a-z]*_*.py"))


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_row_of_the_last_run_has_a_limit_with_a_source(script: str) -> None:
    kept = VALIDATION / "figures" / script / "rows.json"
    rows = json.loads(kept.read_text(encoding="utf-8"))["rows"] if kept.exists() else []
    assert [row["claim"] for row in rows if source_of(script, row["claim"]) is None] == []
    assert script in LIMITS


def test_sources_belong_to_scripts() -> None:
    assert set(LIMITS) <= set(SCRIPTS)


def test_a_row_without_a_source_is_noticed() -> None:
    assert source_of("film_morpho_rcwa", "a claim that nobody knows") is None
    assert source_of("no_such_script", "peak") is None
