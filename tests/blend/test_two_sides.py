"""Objects with two faces: the same material on both, or another one behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

GOLD = 'family = "film"\nsubstrate = "Au"\n[surface]\nroughness = 0.3\n'
OXIDE = GOLD.replace('"Au"', '"Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]')


@pytest.mark.render
def test_the_renderers_twosided_takes_another_of_our_materials_behind(tmp_path: Path) -> None:
    from nacre.device.variant import use_variant

    use_variant()
    import mitsuba as mi
    from lobe_trials import context, directions, interaction

    import nacre.render  # noqa: F401  registers the plugin

    (tmp_path / "gold.toml").write_text(GOLD)
    (tmp_path / "oxide.toml").write_text(OXIDE)
    gold, oxide = (mi.load_dict({"type": "nacre", "recipe": str(tmp_path / f"{n}.toml")}) for n in ("gold", "oxide"))
    both = mi.load_dict({"type": "twosided", "front": gold, "back": oxide})
    wi, wo = directions(200, 1, both_sides=False), directions(200, 2, both_sides=False)
    turn = np.array([1.0, 1.0, -1.0])

    def values(bsdf: object, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        at = mi.Vector3f(np.ascontiguousarray(there.T, dtype=np.float32))
        return np.array(bsdf.eval(context(), interaction(here), at, mi.Bool(True))).T  # type: ignore[attr-defined]

    np.testing.assert_allclose(values(both, wi, wo), values(gold, wi, wo), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(values(both, wi * turn, wo * turn), values(oxide, wi, wo), rtol=1e-5, atol=1e-7)
    assert values(oxide, wi, wo).max() > 0.01  # something to compare
