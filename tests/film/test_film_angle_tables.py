"""Tables of films over angle: right between their nodes, or the larger error is stated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nacre.bsdf.bsdf import Bsdf
from nacre.core.errors import NacreError
from nacre.material.material import material
from nacre.measure.evaluate import bsdf_spectrum

ALLOWED = 0.005  # of R and T, the bar, unless the file states more
ANGLES = 2000  # the issue's
CLEAR = ("air", "SiO2", "BK7", {"n": 1.33}, {"n": 1.5}, {"n": 1.9})
ANY = ("air", "SiO2", "TiO2", "Ag", "Au", "Al", "Si", "BK7", "Al2O3", "Cr")
LOOK_UP = 2e-4  # single precision, and 16-bit entries, of values up to 1
MOST_WAVELENGTHS = 48


def medium(g: np.random.Generator) -> Any:
    kind = g.random()
    if kind < 0.35:
        return {"n": round(g.uniform(1.0, 2.6), 3)}
    if kind < 0.5:
        return {"n": round(g.uniform(0.1, 4.0), 3), "k": float(10 ** g.uniform(-4, 0.7))}
    return str(g.choice(ANY))


def random_film(seed: int) -> dict[str, Any]:
    """Return a film of any ambient, layers and substrate: also gaps, guides, metals and thick sheets."""
    g = np.random.default_rng(seed)
    layers = [
        {"material": medium(g), "thickness_nm": float(10 ** g.uniform(0.7, 3.7)), "incoherent": bool(g.random() < 0.08)}
        for _ in range(g.integers(0, 6))
    ]
    ambient = CLEAR[g.integers(len(CLEAR))]
    substrate = ambient if g.random() < 0.3 else medium(g)
    return {"family": "film", "ambient": ambient, "substrate": substrate, "layers": layers}


def differences(recipe: dict[str, Any], angles: int = ANGLES) -> tuple[Any, Any, dict[str, Any]]:
    """Return the differences of R and T from the solution over angle, from both sides; the stated ones; the note."""
    model: Any = material(recipe).model
    lam = model.wavelengths_nm
    lam = lam[:: -(-len(lam) // MOST_WAVELENGTHS)]
    theta = np.radians((np.arange(angles) + 0.37) * 90.0 / angles)
    bsdf = model.bsdf(lam)
    error, stated = [], []
    for below in (False, True)[: 2 if bsdf.transmits else 1]:
        at = np.pi - theta if below else theta
        found, exact = bsdf.specular(at), model.stack.reversed() if below else model.stack
        powers = exact.powers(theta, lam)
        parts = [found.reflectance - powers.reflectance]
        if bsdf.transmits:
            parts.append(found.transmittance - powers.transmittance)
        error.append(np.abs(np.stack(parts)).max(axis=(0, 2)))
        stated.append(bsdf.angle_error(at))
    return np.concatenate(error), np.concatenate(stated), dict(bsdf.provenance["angle_table"])


def largest_error(recipe: dict[str, Any]) -> tuple[float, float]:
    """Return the largest error of R and T, and the error that the file states."""
    error, _, note = differences(recipe)
    return float(error.max()), float(note["largest_error"])


def check(seeds: range, angles: int = ANGLES) -> None:
    solved = 0
    for seed in seeds:
        try:
            error, stated, _ = differences(random_film(seed), angles)
        except NacreError:  # an incoherent layer in which intensities do not add, a clear medium that absorbs
            continue
        solved += 1
        assert np.all(error <= np.maximum(ALLOWED, stated)), seed
    assert solved >= 0.8 * len(seeds)


def test_random_films_have_the_stated_errors() -> None:
    check(range(20))


@pytest.mark.full
def test_five_hundred_random_films_have_the_stated_errors() -> None:
    check(range(20, 540))


def test_a_gap_between_prisms_is_right_beside_its_critical_angle() -> None:
    gap = {"material": "air", "thickness_nm": 2000}
    error, stated = largest_error({"family": "film", "ambient": {"n": 1.5}, "substrate": {"n": 1.5}, "layers": [gap]})
    assert error <= ALLOWED and stated <= ALLOWED


def test_a_plasmon_beyond_the_critical_angle_is_resolved() -> None:
    silver = {"material": "Ag", "thickness_nm": 50}
    error, stated = largest_error({"family": "film", "ambient": {"n": 1.5}, "substrate": "air", "layers": [silver]})
    assert error <= ALLOWED and stated <= ALLOWED


def test_a_dispersive_dense_side_has_the_critical_angle_of_each_wavelength() -> None:
    film: dict[str, Any] = {"family": "film", "layers": [{"material": "TiO2", "thickness_nm": 300}]}
    for sides in ({"ambient": "air", "substrate": "BK7"}, {"ambient": "BK7", "substrate": "air"}):
        error, stated, note = differences({**film, **sides})
        assert error.max() <= ALLOWED and stated.max() <= ALLOWED and not note["ranges"]


def test_media_equal_at_one_wavelength_only_have_a_critical_angle() -> None:
    model: Any = material({"family": "film", "substrate": "BK7", "layers": []}).model
    same = round(float(model.stack.indices(np.array([570.0]))[-1, 0].real), 4)
    error, stated, note = differences({"family": "film", "ambient": {"n": same}, "substrate": "BK7", "layers": []})
    assert np.all(error <= np.maximum(ALLOWED, stated))
    assert sum(r["to_deg"] - r["from_deg"] for r in note["ranges"]) < 0.5


def test_a_guided_mode_seen_at_one_angle_is_found_or_its_error_stated_there() -> None:
    error, stated, note = differences(random_film(80))
    assert np.all(error <= np.maximum(ALLOWED, stated))
    assert note["largest_error"] > ALLOWED
    narrow = [r["to_deg"] - r["from_deg"] for r in note["ranges"]]
    assert max(narrow) < 0.3  # stated at the dips only


def test_a_warning_appears_only_where_a_result_uses_an_affected_angle(caplog: Any) -> None:
    gap = {"material": "air", "thickness_nm": {"formula": "1500 + 500*v"}}
    recipe = {"family": "film", "ambient": {"n": 1.5}, "substrate": {"n": 1.5}, "layers": [gap]}
    bsdf = material(recipe).bsdf()
    inside = max(bsdf.provenance["angle_table"]["ranges"], key=lambda one: one["error"])
    bsdf_spectrum(bsdf, np.radians([0.5, 80.0]))
    assert not caplog.records
    angle = 0.5 * (inside["from_deg"] + inside["to_deg"])
    bsdf_spectrum(bsdf, np.radians([angle if inside["side"] == "ambient" else 180.0 - angle]))
    assert len(caplog.records) == 1


def test_a_varying_gap_states_its_error(tmp_path: Any) -> None:
    gap = {"material": "air", "thickness_nm": {"formula": "1500 + 500*v"}}
    bsdf = material({"family": "film", "ambient": {"n": 1.5}, "substrate": {"n": 1.5}, "layers": [gap]}).bsdf()
    note = bsdf.provenance["angle_table"]
    assert note["cosines"] == 129 and note["largest_error"] > ALLOWED
    bsdf.save(tmp_path / "gap.nacre")
    assert Bsdf.load(tmp_path / "gap.nacre").provenance["angle_table"] == note


def test_a_thin_incoherent_metal_is_refused() -> None:
    gold = {"material": "Au", "thickness_nm": 20, "incoherent": True}
    with pytest.raises(NacreError, match="incoherent"):
        material({"family": "film", "substrate": {"n": 1.5}, "layers": [gold]}).bsdf()


@pytest.mark.render
@pytest.mark.parametrize("kind", ["gap", "prism", "lossless"])
def test_irregular_tables_are_read_alike_on_the_device(kind: str, tmp_path: Any) -> None:
    from nacre.device.variant import use_variant

    use_variant()
    import drjit as dr
    import mitsuba as mi

    from nacre.device.response import DeviceResponse

    if not dr.is_jit_v(mi.Float):
        pytest.skip("no LLVM: nothing is compiled")
    guide = [{"material": {"n": 1.3}, "thickness_nm": 700}, {"material": {"n": 2.2, "k": 3e-3}, "thickness_nm": 150}]
    recipe = {
        "gap": {"ambient": {"n": 1.5}, "substrate": {"n": 1.5}, "layers": [*guide, guide[0]]},
        "prism": {"ambient": {"n": 1.8}, "substrate": {"n": 1.1}, "layers": guide},
        "lossless": {"ambient": {"n": 1.5}, "substrate": {"n": 1.6}, "layers": [guide[0]] * 4},
    }[kind]
    material({"family": "film", **recipe}).bsdf().save(tmp_path / "film.nacre")
    response: Any = Bsdf.load(tmp_path / "film.nacre").lobes[0].response  # type: ignore[attr-defined]
    device = DeviceResponse(response)
    assert not device.is_uniform and device.is_lossless == (kind == "lossless")
    g = np.random.default_rng(1)
    cos, inside = g.uniform(0.0, 1.0, 4000), g.random(4000) < 0.5
    cos[:3] = 0.0, 1.0, response.cos_critical
    lam = response.wavelengths_nm[[0, 5, 9, -1]]
    si = dr.zeros(mi.SurfaceInteraction3f, 4000)
    for k in range(4):
        si.wavelengths[k] = float(lam[k])
    mask = mi.Bool(inside.tolist())
    reflected, passed = device.look_up(mi.Float(cos), mask, si, mi.Bool(True))
    expected = response.lookup(cos.astype(np.float32).astype(float), inside)
    picked = [0, 5, 9, len(response.wavelengths_nm) - 1]
    # steep flanks: a single-precision cosine moves along them
    steep = [np.abs(a - b) for a, b in zip(response.lookup(cos + 1e-6, inside), response.lookup(cos - 1e-6, inside))]
    for got, wanted, slope in zip((reflected, passed), expected, steep, strict=True):
        error = np.abs(np.array(got).T.reshape(-1, 4)[: len(cos)] - wanted[:, picked])
        assert np.max(error - slope[:, picked]) <= LOOK_UP
