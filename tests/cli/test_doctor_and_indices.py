"""`nacre doctor` names what is wrong and the way out; `nacre indices` shows where a constant comes from."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.cli import run
from nacre.device import doctor, variant
from nacre.matter.indices.library import index


@pytest.mark.render
def test_on_a_machine_that_runs_the_tests_nothing_is_bad(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "everything works"
    assert any(line.startswith("ok") and "LLVM" in line for line in lines)


def test_json_holds_one_entry_a_finding(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    assert {"nacre", "packages", "LLVM", "Mitsuba", "GPU", "folders", "memory"} <= {f["what"] for f in findings}
    assert all(f["state"] in ("ok", "note", "bad") for f in findings)
    assert all(f["advice"] for f in findings if f["state"] == "bad")


def test_a_missing_package_is_named_with_the_command_that_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = importlib.util.find_spec
    absent = {"gdstk", "zarr"}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in absent else found(name, *rest))
    assert run(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "missing: gdstk" in text and "pip install 'nacre[study]'" in text
    assert text.splitlines()[-1].endswith("see above")


@pytest.mark.parametrize(
    ("name", "state"), [(None, "cannot be loaded"), ("scalar_spectral", "780 times slower")], ids=["none", "scalar"]
)
def test_without_a_good_variant_the_remedy_is_stated(monkeypatch: pytest.MonkeyPatch, name: Any, state: str) -> None:
    report = variant.report()
    broken = type(report)(**{**report.__dict__, "variant": name, "llvm_used": None, "advice": "apt install libllvm19"})
    monkeypatch.setattr(variant, "report", lambda: broken)
    findings = {f.what: f for f in doctor.examine()}
    assert findings["Mitsuba"].state == "bad" == findings["LLVM"].state
    assert state in findings["Mitsuba"].found + findings["Mitsuba"].advice
    assert "libllvm19" in findings["LLVM"].advice


def test_folders_memory_and_gpu_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/nvidia-smi")
    monkeypatch.setattr(os, "sysconf", lambda key: 4096 if key == "SC_PAGE_SIZE" else 1000)
    findings = {f.what: f for f in doctor.examine()}
    assert findings["folders"].state == "bad" and "TMPDIR" in findings["folders"].advice
    assert "cuda_ad_spectral" in findings["GPU"].advice
    assert findings["memory"].state == "note" and findings["memory"].found.startswith("0.0")


def test_a_constant_is_shown_with_its_values_source_and_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "gold.png"
    assert run(["indices", "show", "Au", "--json", "-o", str(figure)]) == 0
    shown = json.loads(capsys.readouterr().out)
    expected = index("Au").n_complex(np.array(shown["wavelengths_nm"]))
    np.testing.assert_allclose(np.array(shown["n"]) + 1j * np.array(shown["k"]), expected, rtol=1e-12)
    assert shown["source"] and figure.stat().st_size > 5000


def test_a_search_says_how_much_it_left_out_or_that_nothing_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["indices", "search", "silver", "--limit", "2"]) == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 2 and "use --limit" in err
    assert run(["indices", "search", "unobtainium"]) == 0
    assert 'nothing is called "unobtainium"' in capsys.readouterr().err
