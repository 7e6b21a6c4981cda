"""The ensemble inside: its ratio, what it does to the light, agreement with truth, the choice, cache and messages."""

import dataclasses
import logging

import numpy as np
import pytest
from helpers_metasurface import monolayer, reference, surface, t_matrix
from scipy.interpolate import RegularGridInterpolator
from validation.metasurface_ensembles import light

from nacre.bsdf import Bsdf
from nacre.errors import NacreError
from nacre.families.metasurface import choice, refine
from nacre.families.metasurface.arrangement import Arrangement
from nacre.families.metasurface.corrections import diffuse_term
from nacre.families.metasurface.ensemble import Ensemble, EnsembleSettings, patches, same_order
from nacre.families.metasurface.monolayer import Monolayer, Particle
from nacre.families.metasurface.ratio import Ratio, Ways, _terms, blocks, fit_ratio
from nacre.families.metasurface.sphere import hemisphere_rule
from nacre.families.metasurface.structure import hard_disk_structure
from nacre.materials.material import material
from nacre.recipe.long_work import heard_by

TRUTH_BAR, TRUTH_MEAN_BAR = 0.08, 0.06
SIGMAS, SLACK, SHARE_WITHIN = 2.0, 0.04, 0.9
RECIPROCITY_BAR = 1e-10
PHI = 2 * np.pi * np.arange(24) / 24
SMALL = {"spheres": 20, "realisations": 4}


def recipe(model=None, **more):
    return {
        "family": "metasurface",
        "substrate": {"n": 1.5},
        "particle": {"material": {"n": 0.05, "k": 3.1}, "radius_nm": 90},
        "monolayer": {"coverage": 0.1},
        "model": {"correction": "ensemble", "multipole_order": 3, "ensemble": SMALL, **(model or {})},
        **more,
    }


def some_ratio(has_below, seed=0):
    g = np.random.default_rng(seed)
    sizes = {b: len(_terms(bool(b[0]), bool(b[1]), "same" if b[2] == b[3] else "cross")) for b in blocks(has_below)}
    return Ratio({b: np.tile(0.1 * g.normal(size=n), (3, 1)) for b, n in sizes.items()})


def ways(count=6, below=0):
    kappa = np.concatenate([np.sin(np.linspace(0.05, 1.4, count)), np.linspace(0.1, 1.4, below)])
    is_below = np.arange(count + below) >= count
    return Ways.of(kappa, np.where(is_below, 1.5, 1.0), is_below)


@pytest.mark.parametrize("below", [0, 5])
def test_a_planted_ratio_is_found_through_the_speckle_and_its_errors_are_its_own(below):
    count, waves = 6 + below, np.cos(np.arange(14)[:, None] * PHI)
    unit = np.zeros((count, count, 2, 2, 14))
    unit[..., 0] = 1.0
    scores = []
    for seed in range(6):
        g, true, where = np.random.default_rng(seed), some_ratio(below > 0, seed), ways(6, below)
        model = 1.0 + g.random((2, count, 2, count, 24))
        factor = np.moveaxis(true.applied(unit, where) @ waves, (2, 3), (0, 2))
        truth = model * factor * g.gamma(6.0, 1 / 6.0, (24, *model.shape))
        found = fit_ratio(truth, model, where, np.ones(count), PHI)
        again = np.moveaxis(found.applied(unit, where) @ waves, (2, 3), (0, 2))
        off = (model * again).sum((0, 2, 4)) / (model * factor).sum((0, 2, 4)) - 1
        assert np.abs(off).max() < 0.05
        scores.append(off[:6, :6] / found.standard_errors(truth, model, where, PHI))
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_light_with_a_ratio_is_reciprocal_and_its_totals_are_its_own():
    plain = monolayer(500.0, 90.0, 0.05 + 3.1j, 1.5, 0.1, 0.3, lmax=3)
    layer = dataclasses.replace(plain, ratio=some_ratio(True))
    mu, w = hemisphere_rule(12)
    mu_b, w_b = hemisphere_rule(10, 1.5)
    term = diffuse_term(layer, [(layer.light(mu), w), (layer.light(mu_b, True), w_b)], 14)
    swapped = term.coherent.transpose(1, 0, 3, 2, 4)
    assert np.abs(term.coherent - swapped).max() <= RECIPROCITY_BAR * np.abs(term.coherent).max()
    assert np.abs(term.unpolarised - term.unpolarised.T).max() <= RECIPROCITY_BAR * term.unpolarised.max()
    # the power sent up, from the series and S themselves
    phi = 2 * np.pi * np.arange(720) / 720
    kappa = np.sqrt(1 - mu**2)
    q = np.sqrt(np.maximum(
        (kappa[:, None] ** 2 + kappa**2)[..., None] - 2 * np.outer(kappa, kappa)[..., None] * np.cos(phi), 0
    ))  # fmt: skip
    s = layer.structure.structure_factor(layer.surface.wavenumber * q)
    values = term.coherent[:12, :12] @ np.cos(np.arange(14)[:, None] * phi)
    sent = np.einsum("s,siqpf,sif->pi", w, values, s) * 2 * np.pi / 720
    assert np.abs(sent / term.above[:, :12] - 1).max() < 2e-3


def test_no_ratio_and_one_of_one_are_the_same_light():
    plain = monolayer(500.0, 90.0, 0.05 + 3.1j, 1.0, 0.1, 0.3, lmax=3)
    ones = Ratio({b: np.zeros_like(c) for b, c in some_ratio(True).coefficients.items()})
    mu, w = hemisphere_rule(8)
    a = diffuse_term(plain, [(plain.light(mu), w), (plain.light(mu, True), w)], 8)
    layer = dataclasses.replace(plain, ratio=ones)
    b = diffuse_term(layer, [(layer.light(mu), w), (layer.light(mu, True), w)], 8)
    assert np.abs(a.coherent - b.coherent).max() <= 1e-12 * np.abs(a.coherent).max()
    assert np.abs(a.above / b.above - 1).max() < 1e-3


def _ensemble(name, realisations):
    data = reference(f"ensemble_{name}.npz")
    below = surface(
        float(data["wavelength_nm"]), complex(data["n_substrate"]), tuple(zip(data["film_n"], data["film_h_nm"]))
    )
    radius, density, packing = (float(data[key]) for key in ("radius_nm", "density_per_nm2", "packing_p"))
    particle = Particle(1.0, radius, t_matrix(2, below.wavenumber * radius, complex(data["n_sphere"])))
    structure = hard_disk_structure(density, packing, 4.8 * below.wavenumber)
    return data, _ratio(Monolayer(below, (particle,), structure), density, packing, EnsembleSettings(130, realisations))


def _ratio(layer, density, packing, settings):
    def pattern(count, seed):
        return Arrangement("hard-disk", density, packing, seed).pattern(count)

    cut = patches(pattern, density, layer.structure.diameter_nm, settings, 0)
    one = Ensemble(same_order(layer, 2, layer.particles[0]), cut)
    ratio, errors = one.ratio(refine.in_threads(one.far_fields, range(settings.realisations)))
    return layer, ratio, errors, one


def _stored_error(one, errors, theta_s, theta_i):
    """The standard errors that a Bsdf keeps, between its angles, `[s, i, 1]`."""
    angles = np.arccos(one.sides[0][0].cosines)
    held = [np.clip(t, angles[0], angles[-1]) for t in (theta_s, theta_i)]
    return RegularGridInterpolator((angles, angles), errors)(tuple(np.meshgrid(*held, indexing="ij")))[..., None]


def _against_truth(names, realisations):
    errors, within = {}, {}
    for name in names:
        data, (layer, ratio, stored, one) = _ensemble(name, realisations)
        theta_s, theta_i = data["theta_s_rad"], data["theta_i_rad"]
        ours = light(layer, theta_s, theta_i, ratio)
        error = _stored_error(one, stored, theta_s, theta_i) * ours
        truth = data["incoherent_nm2_per_sr"].mean(axis=2).sum(axis=0)
        sine = np.sin(theta_s)[:, None, None]
        errors[name] = np.mean(np.sqrt((sine * (ours - truth) ** 2).sum(0) / (sine * truth**2).sum(0)))
        within[name] = np.mean(np.abs(ours - truth) <= SIGMAS * error + SLACK * truth)
    return errors, within


@pytest.mark.full
def test_the_ensemble_agrees_with_multi_sphere_solutions_of_another_code():
    """With half of the patterns; `validation/metasurface_ensembles.py` takes them all."""
    errors, within = _against_truth("BCDEF", 12)
    assert max(errors.values()) <= TRUTH_BAR, errors
    assert np.mean(list(errors.values())) <= TRUTH_MEAN_BAR
    assert np.mean(list(within.values())) >= SHARE_WITHIN, within


def test_far_apart_spheres_need_no_ratio():
    """Single scattering is what both know: the ensemble's fit is one within its noise."""
    below, radius, coverage = surface(500.0, 1.5), 90.0, 0.01
    density = coverage / np.pi / radius**2
    particle = Particle(1.0, radius, t_matrix(2, below.wavenumber * radius, 0.05 + 3.1j))
    layer = Monolayer(below, (particle,), hard_disk_structure(density, coverage, 5 * below.wavenumber))
    layer, ratio, errors, one = _ratio(layer, density, coverage, EnsembleSettings(20, 10))
    angles = np.radians([20.0, 50.0])
    judged = light(layer, angles, angles, ratio)
    plain = light(layer, angles, angles, None)
    assert np.all(np.abs(judged / plain - 1) <= 4 * _stored_error(one, errors, angles, angles) + 0.02)
    assert errors.max() < 0.2


@pytest.mark.parametrize("system", choice.MEASURED, ids=lambda m: f"{m.system}, f {m.coverage:g}")
def test_the_choice_keeps_the_mean_field_where_it_was_measured_to_hold(system):
    holds, _ = choice.mean_field_holds(system.kind, system.on_substrate, system.coverage)
    assert holds == (system.error <= choice.HOLDS)


def test_an_ensemble_is_told_stored_and_solved_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path))
    heard, grid = [], np.array([480.0, 520.0])
    with heard_by(lambda what, seconds: heard.append(what)), caplog.at_level(logging.WARNING, "nacre"):
        dark = {"substrate": {"n": 1.5, "k": 0.01}}  # nothing comes from below: a third of the work
        first = material(recipe(**dark)).bsdf(grid[:1])
        both = material(recipe(**dark)).bsdf(grid)
        monkeypatch.setattr(refine, "_solve", lambda *_: pytest.fail("solved again"))
        again = material(recipe(title="under another name", **dark)).bsdf(grid)
    assert len(heard) == 2 and "1 wavelength (1 more are kept from before)" in heard[1]
    assert "standard error" in caplog.text
    notes = both.provenance["ensemble"]
    assert notes["standard_error"] > 0 and np.shape(notes["standard_errors"])[0] == 2
    assert both.provenance["correction"] == "ensemble"
    assert np.array_equal(both.lobes[1].above, again.lobes[1].above)
    assert np.array_equal(both.lobes[1].above[..., 0], first.lobes[1].above[..., 0])
    both.save(tmp_path / "kept.nacre")
    assert Bsdf.load(tmp_path / "kept.nacre").provenance["ensemble"] == notes


def test_a_judged_material_is_solved_once_without_a_cache_and_keeps_energy_and_reciprocity(monkeypatch):
    monkeypatch.setenv("NACRE_CACHE", "off")
    asked = []
    solve = refine._solve
    monkeypatch.setattr(refine, "_solve", lambda *given: asked.append(1) or solve(*given))
    made = material(recipe())
    total = np.sum(list(made.spectrum(np.radians([0.0, 60.0, 85.0]), [500.0]).parts().values()), axis=0)
    assert total.max() <= 1 + 1e-9
    bsdf = made.bsdf(np.array([500.0]))
    g = np.random.default_rng(0).normal(size=(2, 200, 3))
    wi, wo = g / np.linalg.norm(g, axis=2, keepdims=True)
    n2 = np.where(wo[:, 2] > 0, 1.0, 1.5**2)[:, None], np.where(wi[:, 2] > 0, 1.0, 1.5**2)[:, None]
    there, back = bsdf.evaluate(wi, wo) / n2[0], bsdf.evaluate(wo, wi) / n2[1]
    assert np.abs(there - back).max() <= RECIPROCITY_BAR * there.max()
    assert len(asked) == 1


def test_many_materials_take_the_mean_field_unless_the_recipe_names_the_ensemble(caplog):
    alone = material(recipe({"correction": "auto"}, substrate="air"))
    assert alone.model.chosen_correction[0] == "ensemble"
    with caplog.at_level(logging.WARNING, "nacre"):
        quick = alone.for_many()
    assert "among many it takes the quick way" in caplog.text
    assert quick.vary({"monolayer.coverage": 0.2}).model.chosen_correction[0] == "qca-balanced"
    assert quick.identity != alone.identity
    assert material(recipe()).for_many().model.chosen_correction[0] == "ensemble"


def test_positions_that_nobody_knows_are_refused_and_not_needed_by_auto(tmp_path):
    (tmp_path / "s.csv").write_text("0 0.5\n5 0.8\n10 1.1\n20 1\n30 1\n")
    structure = {"monolayer": {"coverage": 0.1, "packing": 0.1, "structure": {"sq": "s.csv"}}}
    with pytest.raises(NacreError, match="not where they lie"):
        material(recipe(**structure), tmp_path).spectrum([0.0], [500.0])
    by_itself = material(recipe({"correction": "auto"}, substrate="air", **structure), tmp_path)
    assert by_itself.model.chosen_correction[0] == "qca-balanced"


@pytest.mark.parametrize(
    ("key", "value"), [("spheres", 5), ("spheres", 5000), ("realisations", 1), ("multipole_order", 9)]
)
def test_a_size_that_is_not_allowed_is_told_with_its_key(key, value):
    with pytest.raises(NacreError, match=rf"model\.ensemble\.{key}"):
        material(recipe({"ensemble": {key: value}}))


def test_discs_cut_from_a_list_stay_inside_it_and_a_close_pair_loses_one():
    from nacre.families.metasurface.patterns import Pattern

    xy = np.random.default_rng(2).uniform(0, 8000, (600, 2))
    listed = Pattern(xy, 8000.0)
    cut = patches(lambda count, seed: listed, 600 / 8000.0**2, 60.0, EnsembleSettings(60, 5), 0, True)
    for one in cut:
        gaps = np.linalg.norm(one[:, None] - one, axis=2) + 1e9 * np.eye(len(one))
        assert gaps.min() >= 60.0 * (1 - 1e-6)
        assert np.hypot(*one.T).max() <= np.sqrt(60 / (np.pi * 600 / 8000.0**2))
