"""A family and a lobe of another package: found by entry points alone, stored, listed, and refused where wrong.

The package stands in tests/toy with its .dist-info; nothing else in nacre or its tests names it. That it samples what
it evaluates, keeps energy and reciprocity, survives the fuzz and answers every verb is asked by the shared suites.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.bsdf.registry import GROUP, LOBES, LobeEntry, outside_lobe
from nacre.core import lazy
from nacre.core.errors import NacreError
from nacre.families.registry import FAMILIES, family_names, family_spec

OUTSIDE_FAMILIES = [name for name in family_names() if name not in FAMILIES]
OUTSIDE_LOBES = list(lazy.entry_points(GROUP, LOBES))


def test_the_toy_package_is_found() -> None:
    assert len(OUTSIDE_FAMILIES) == len(OUTSIDE_LOBES) == 1
    assert isinstance(outside_lobe(OUTSIDE_LOBES[0]), LobeEntry)


@pytest.mark.parametrize("name", OUTSIDE_FAMILIES)
def test_a_compiled_file_of_an_outside_lobe_loads_without_its_recipe(name: str, tmp_path: Path) -> None:
    material = nacre.material(family_spec(name, "here").example)
    material.bsdf().save(tmp_path / "x.nacre")
    wi, wo = np.array([[0.0, 0.6, 0.8]]), np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_array_equal(nacre.evaluate(tmp_path / "x.nacre", wi, wo), nacre.evaluate(material, wi, wo))


@pytest.mark.parametrize("name", OUTSIDE_FAMILIES)
def test_an_outside_family_is_named_among_the_known_ones_and_guessed_at(name: str) -> None:
    with pytest.raises(NacreError, match=f'Did you mean "{name}"'):
        nacre.material({"family": name + "x"})
    with pytest.raises(NacreError, match="s, p|unpolarised"):
        nacre.material(family_spec(name, "here").example).spectrum([0.0], polarisation="s")


def test_importing_nacre_scans_no_packages() -> None:
    code = "import nacre, sys; assert 'importlib.metadata' not in sys.modules"
    done = subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {code}"],
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_a_name_given_twice_or_taken_from_nacre_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(group: str) -> list[EntryPoint]:
        return [EntryPoint("sand", "a.b:C", group), EntryPoint("sand", "d.e:F", group)]

    monkeypatch.setattr("importlib.metadata.entry_points", installed)
    lazy._scan.cache_clear()
    try:
        with pytest.raises(NacreError, match='"sand" of nacre.families .* a.b:C and d.e:F'):
            family_spec("sand", "here")
        monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [EntryPoint("film", "a.b:C", group)])
        lazy._scan.cache_clear()
        with pytest.raises(NacreError, match='"film" of nacre.families'):
            family_names()
    finally:
        lazy._scan.cache_clear()


def test_an_entry_point_that_leads_elsewhere_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = [EntryPoint("sand", "pathlib:Path", "nacre.families")]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: wrong)
    lazy._scan.cache_clear()
    try:
        with pytest.raises(NacreError, match="is not a RecipeModel"):
            nacre.material({"family": "sand"})
        with pytest.raises(NacreError, match="is not a LobeEntry"):
            outside_lobe("sand")
    finally:
        lazy._scan.cache_clear()
