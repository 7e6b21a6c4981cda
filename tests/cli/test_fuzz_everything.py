"""A share of `make fuzz` that fits into the quick suite: every kind of input, in this process."""

from __future__ import annotations

import importlib
import logging
import sys
from pathlib import Path

import pytest

QUICK = 60


def test_the_first_inputs_of_the_fuzzer_give_an_answer_or_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sys, "path", [str(Path(__file__).resolve().parents[2]), *sys.path])
    inputs = importlib.import_module("tools.fuzz.inputs")
    monkeypatch.delitem(inputs.KINDS, "scene")  # it needs Mitsuba
    monkeypatch.chdir(tmp_path)
    caplog.set_level(logging.ERROR, "nacre")
    sound = inputs.Sound(tmp_path)
    came = [inputs.throw(number, 7, tmp_path, sound) for number in range(QUICK)]
    assert {found for _, found in came} == {"answered", "refused"}, [pair for pair in came if len(pair[1]) > 8]
    assert {kind for kind, _ in came} == set(inputs.KINDS)
