"""The ensemble inside: its ratio, what it does to the light, agreement with truth, the choice, cache and messages."""

import dataclasses
import logging

import numpy as np
import pytest
from helpers_metasurface import monolayer, reference, surface, t_matrix
from scipy.interpolate import RegularGridInterpolator
from validation.metasurface_ensembles import light

from nacre.bsdf import Bsdf
from nacre.core.errors import NacreError
from nacre.core.machine import in_threads
from nacre.core.progress import on_progress
from nacre.families.metasurface import ensemble
from nacre.families.metasurface import material as model_selection
from nacre.families.metasurface.ensemble import ANGLES, Ensemble, same_order
from nacre.families.metasurface.monolayer.arrangement import Arrangement
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import (
    BLOCKS_ABOVE,
    Pairs,
    Ratio,
    RatioDirections,
    _terms,
    block_sums,
    blocks,
    fit_ratio,
    hard_disk_structure,
)
from nacre.families.metasurface.supercells import orders, supercells, with_species
from nacre.families.metasurface.tmatrix.particle_on_stack import hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Embedded
from nacre.material.material import material

TRUTH_BAR, TRUTH_MEAN_BAR = 0.08, 0.06
UP_TO = np.radians(60.0)
SIGMAS, SPECKLE, SHARE_WITHIN = 2.0, 0.04, 0.9  # the other code's own speckle: 3-4 %
RECIPROCITY_BAR = 1e-10
ENERGY_BAR = 5e-3  # what single precision and the waves left out as weak leave
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


def some_ratio(transmits_below, seed=0):
    g = np.random.default_rng(seed)
    sizes = {b: len(_terms(b)) for b in blocks(transmits_below)}
    return Ratio({b: np.tile(0.1 * g.normal(size=n), (3, 1)) for b, n in sizes.items()})


def ratio_directions(count=6, below=0):
    kappa = np.concatenate([np.sin(np.linspace(0.05, 1.4, count)), np.linspace(0.1, 1.4, below)])
    is_below = np.arange(count + below) >= count
    return RatioDirections.of(kappa, np.where(is_below, 1.5, 1.0), is_below)


def _planted(true, block, generator, follows=0.0, count=24):
    """One pattern of random light over 8 bins of the angle, which is `true` times its model."""
    theta = np.sort(generator.uniform(0.05, 1.4, (2, count)), axis=1)
    left, right = (
        RatioDirections.of(
            np.sin(t) * (1.3 if side else 1.0), np.full(count, 1.5 if side else 1.0), np.full(count, bool(side))
        )
        for t, side in zip(theta, block[:2])
    )
    phi = generator.uniform(0, 2 * np.pi, (count, count))
    factor = true.at(left, right, block, phi[..., None])[..., 0]
    model = 1.0 + generator.random((count, count))
    excess = generator.exponential(size=(count, count)) - 1.0
    light = follows * excess + 1.0 + (1.0 - follows) * (generator.exponential(size=(count, count)) - 1.0)
    bins = [(t / 1.4001 * ANGLES).astype(int) for t in theta]
    pairs = Pairs(left, right, phi, model * factor * light, model, model * excess, np.ones_like(model), *bins)
    return pairs, model, factor


@pytest.mark.parametrize("transmits_below", [False, True])
def test_a_planted_ratio_is_found_through_the_speckle_and_its_errors_are_its_own(transmits_below):
    scores = []
    for seed in range(2):
        g, true = np.random.default_rng(seed), some_ratio(transmits_below, seed)
        patterns, light, model = [], np.zeros(ANGLES**2), np.zeros(ANGLES**2)
        for _ in range(12):
            one = {}
            for block in blocks(transmits_below):
                pairs, _, factor = _planted(true, block, g)
                one[block] = block_sums(block, pairs, ANGLES)
                if block in BLOCKS_ABOVE:
                    where = pairs.left_bins[:, None] * ANGLES + pairs.right_bins
                    np.add.at(light, where, pairs.model * factor)
                    np.add.at(model, where, pairs.model)
            patterns.append(one)
        found, errors = fit_ratio(patterns)
        shapes = {b: np.sum([one[b].shapes for one in patterns], axis=0) for b in BLOCKS_ABOVE}
        fitted = model + sum(shapes[b] @ found.coefficients[b].mean(axis=0) for b in BLOCKS_ABOVE)
        off = fitted / light - 1
        assert np.all(np.abs(off) <= 5 * errors)
        scores.append(off / errors)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_what_a_pattern_s_own_structure_explains_is_taken_off_and_costs_no_truth():
    block, true = (0, 0, 0, 0), some_ratio(False)
    spread = []
    for knows in (False, True):
        g = np.random.default_rng(1)
        patterns = []
        for _ in range(24):
            pairs, _, _ = _planted(true, block, g, follows=0.8)
            if not knows:
                pairs = dataclasses.replace(pairs, control=0.0 * pairs.control)
            patterns.append({block: block_sums(block, pairs, ANGLES)})
        found, errors = fit_ratio(patterns)
        spread.append(np.sqrt(np.mean(errors**2)))
        theta = np.linspace(0.1, 1.3, 7)
        way = RatioDirections.of(np.sin(theta), np.ones(7), np.zeros(7, bool))
        phi = np.linspace(0, np.pi, 9)
        off = found.at(way, way, block, phi).mean(-1) / true.at(way, way, block, phi).mean(-1) - 1
        assert np.abs(off).max() < 0.3
    # of the variance .8^2 is the structure's and .2^2 is not
    assert spread[1] < 0.5 * spread[0]


def test_light_with_a_ratio_is_reciprocal_and_its_totals_are_its_own():
    plain = monolayer(500.0, 90.0, 0.05 + 3.1j, 1.5, 0.1, 0.3, lmax=3)
    layer = dataclasses.replace(plain, ratio=some_ratio(True))
    mu, w = hemisphere_rule(12)
    mu_b, w_b = hemisphere_rule(10, 1.5)
    term = diffuse_term(layer, [(layer.illuminate(mu), w), (layer.illuminate(mu_b, True), w_b)], 14)
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
    a = diffuse_term(plain, [(plain.illuminate(mu), w), (plain.illuminate(mu, True), w)], 8)
    layer = dataclasses.replace(plain, ratio=ones)
    b = diffuse_term(layer, [(layer.illuminate(mu), w), (layer.illuminate(mu, True), w)], 8)
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
    return data, _ratio(Monolayer(below, (particle,), structure), density, packing, 130, realisations)


def _ratio(layer, density, packing, spheres, realisations):
    one = _patterns(layer, density, packing, spheres, realisations)
    ratio, errors = one.ratio(in_threads(one.solve, range(realisations)))
    return layer, ratio, errors, one


def _patterns(layer, density, packing, spheres, realisations):
    def pattern(count, seed):
        return Arrangement("hard-disk", density, packing, seed).pattern(count)

    made = supercells(pattern, density, layer.structure.diameter_nm, spheres, realisations, 0)
    one = Ensemble(same_order(layer, 2, *layer.particles), with_species(made, layer.shares, 0))
    one.prepare()
    return one


def _stored_error(one, errors, theta_s, theta_i):
    """The standard errors that a Bsdf keeps, between its angles, `[s, i, 1]`."""
    angles = one.angles_rad
    held = [np.clip(t, angles[0], angles[-1]) for t in (theta_s, theta_i)]
    return RegularGridInterpolator((angles, angles), errors)(tuple(np.meshgrid(*held, indexing="ij")))[..., None]


def _against_truth(names, realisations):
    errors, within = {}, {}
    for name in names:
        data, (layer, ratio, stored, one) = _ensemble(name, realisations)
        few = data["theta_i_rad"] < UP_TO
        theta_s, theta_i = data["theta_s_rad"], data["theta_i_rad"][few]
        ours = light(layer, theta_s, theta_i, ratio)
        error = _stored_error(one, stored, theta_s, theta_i) * ours
        truth = data["incoherent_nm2_per_sr"].mean(axis=2).sum(axis=0)[:, few]
        sine = np.sin(theta_s)[:, None, None]
        errors[name] = np.mean(np.sqrt((sine * (ours - truth) ** 2).sum(0) / (sine * truth**2).sum(0)))
        alike = theta_s < UP_TO
        within[name] = np.mean((np.abs(ours - truth) <= SIGMAS * np.hypot(error, SPECKLE * truth))[alike])
    return errors, within


@pytest.mark.full
def test_the_ensemble_agrees_with_multi_sphere_solutions_of_another_code():
    """With a quarter of the patterns; `validation/metasurface_ensembles.py` takes them all.

    Light up to 55 degrees: those solutions are of discs of 130 spheres, which near grazing send out up to a fifth more
    than an endless layer has to give, see `test_each_endless_pattern_of_lossless_spheres_sends_out_what_arrives`.
    """
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
    layer, ratio, errors, one = _ratio(layer, density, coverage, 20, 10)
    angles = np.radians([20.0, 50.0])
    corrected = light(layer, angles, angles, ratio)
    plain = light(layer, angles, angles, None)
    assert np.all(np.abs(corrected / plain - 1) <= 4 * _stored_error(one, errors, angles, angles) + 0.02)
    assert errors.max() < 0.2


@pytest.mark.parametrize("system", model_selection.MEASURED, ids=lambda m: f"{m.name}, f {m.coverage:g}")
def test_the_choice_keeps_the_mean_field_where_it_was_measured_to_hold(system):
    """One that fails decides for all like it that are as dense, also at wavelengths where it would do."""
    holds, _ = model_selection.mean_field_holds(system.species, system.on_substrate, system.coverage)
    alike = [
        m for m in model_selection.MEASURED if (m.species, m.on_substrate) == (system.species, system.on_substrate)
    ]
    assert holds == all(m.error <= model_selection.MAX_ERROR for m in alike if m.coverage <= system.coverage)


DISC = {"shape": "cylinder", "material": "Ag", "diameter_nm": 150, "height_nm": 60, "gap_nm": 10}
SILICON = {"radius_nm": 60, "material": {"n": 4.0, "k": 0.05}, "share": 0.4}
SILVER = {"radius_nm": 75, "material": {"n": 0.05, "k": 3.1}}


@pytest.mark.parametrize(
    ("particle", "substrate", "coverage", "taken", "why"),
    [
        # discs are evaluated by discs: of spheres the mean field would be taken up to 0.2
        (DISC, {"n": 1.5}, 0.1, "ensemble", "metal discs on a substrate"),
        (DISC, {"n": 1.5}, 0.02, "qca-balanced", "metal discs on a substrate"),
        # 14 % off, though it would do of either kind alone
        ({**SILVER, "second": SILICON}, {"n": 1.5}, 0.08, "ensemble", "a mixture of metal spheres and high-index"),
        ({**SILVER, "second": SILICON}, {"n": 1.5}, 0.04, "qca-balanced", "a mixture of"),
        # nothing like it was measured
        ({**SILVER, "second": SILICON}, "air", 0.01, "ensemble", "no such layer was measured"),
        ({**DISC, "second": {**SILVER, "share": 0.2}}, {"n": 1.5}, 0.01, "ensemble", "no such layer was measured"),
    ],
)
def test_discs_and_mixtures_are_evaluated_by_ensembles_of_their_kind(particle, substrate, coverage, taken, why):
    given = {"substrate": substrate, "particle": particle, "monolayer": {"coverage": coverage}}
    correction, because = material(recipe({"correction": "auto"}, **given)).model.chosen_correction
    assert correction == taken and why in because


def test_a_shape_known_only_by_its_t_matrix_is_not_taken_for_a_sphere():
    assert not model_selection.mean_field_holds(
        [model_selection.SystemClass(model_selection.SHAPES[""], model_selection.METAL)], True, 0.01
    )[0]


def test_an_ensemble_is_reported_stored_and_solved_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path))
    heard, grid = [], np.array([480.0, 520.0])
    with on_progress(lambda what, seconds: heard.append(what)), caplog.at_level(logging.WARNING, "nacre"):
        dark = {"substrate": {"n": 1.5, "k": 0.01}}  # nothing comes from below: a third of the work
        first = material(recipe(**dark)).bsdf(grid[:1])
        both = material(recipe(**dark)).bsdf(grid)
        monkeypatch.setattr(ensemble, "_solve", lambda *_: pytest.fail("solved again"))
        again = material(recipe(title="under another name", **dark)).bsdf(grid)
    assert len(heard) == 2 and "1 wavelength (1 more are cached)" in heard[1]
    assert "standard error" in caplog.text
    notes = both.provenance["ensemble"]
    assert notes["standard_error"] > 0 and np.shape(notes["standard_errors"])[0] == 2
    assert both.provenance["correction"] == "ensemble"
    assert np.array_equal(both.lobes[1].above, again.lobes[1].above)
    assert np.array_equal(both.lobes[1].above[..., 0], first.lobes[1].above[..., 0])
    both.save(tmp_path / "kept.nacre")
    assert Bsdf.load(tmp_path / "kept.nacre").provenance["ensemble"] == notes


def _stopping(monkeypatch, after):
    """Solve patterns until so many are done, then be interrupted; return the list of what was solved."""
    solved, solve = [], Ensemble.solve

    def once(self, number):
        if len(solved) == after:
            raise KeyboardInterrupt
        solved.append(number)
        return solve(self, number)

    monkeypatch.setattr(Ensemble, "solve", once)
    monkeypatch.setattr(ensemble, "in_workers", lambda work, items, keep: [keep(i, work(i)) for i in items])
    return solved


def test_a_stopped_run_solves_no_pattern_twice_and_comes_to_the_same(tmp_path, monkeypatch):
    dark, heard = {"substrate": {"n": 1.5, "k": 0.01}}, []
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "whole"))
    whole = material(recipe(**dark)).bsdf(np.array([500.0]))
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "stopped"))
    with monkeypatch.context() as patched:
        first = _stopping(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            material(recipe(**dark)).bsdf(np.array([500.0]))
    with monkeypatch.context() as patched, on_progress(lambda what, seconds: heard.append(what)):
        rest = _stopping(patched, 99)
        found = material(recipe(**dark)).bsdf(np.array([500.0]))
    assert sorted(first + rest) == list(range(SMALL["realisations"])) and len(first) == 3
    assert "3 patterns of these are cached" in heard[0]
    # the whole run solved in threads, which may sum in another order: the last bits; a pattern moves per cents
    assert np.abs(found.lobes[1].above - whole.lobes[1].above).max() <= 1e-6 * np.abs(whole.lobes[1].above).max()
    # what was kept for a fit goes once it is made
    assert len(list((tmp_path / "stopped").rglob("ensemble-*"))) == 1


def test_a_stopped_run_goes_on_with_nothing_of_a_file_that_changed(tmp_path, monkeypatch):
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "cache"))
    places = np.random.default_rng(1).permutation(np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1).reshape(-1, 2))
    given = {"substrate": {"n": 1.5, "k": 0.01}, "monolayer": {"structure": {"points": "xy.csv"}}}

    def write(shift):
        rows = 0.5 * places + shift * (places[:, :1] % 2)
        (tmp_path / "xy.csv").write_text("".join(f"{x},{y}\n" for x, y in rows))

    write(0.0)
    with monkeypatch.context() as patched:
        _stopping(patched, 3)
        with pytest.raises(KeyboardInterrupt):
            material(recipe(**given), tmp_path).bsdf(np.array([500.0]))
    write(0.03)
    with monkeypatch.context() as patched:
        solved = _stopping(patched, 99)
        found = material(recipe(**given), tmp_path).bsdf(np.array([500.0]))
    assert sorted(solved) == list(range(SMALL["realisations"]))
    assert np.all(np.isfinite(found.lobes[1].above))  # of a lattice, whose light is next to nothing between its orders


def test_a_corrected_material_is_solved_once_without_a_cache_and_keeps_energy_and_reciprocity(monkeypatch):
    monkeypatch.setenv("NACRE_CACHE", "off")
    asked = []
    solve = ensemble._solve
    monkeypatch.setattr(ensemble, "_solve", lambda *given: asked.append(1) or solve(*given))
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
        quick = alone.at_low_fidelity()
    assert "among many it takes the quick way" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING, "nacre"):
        alone.at_low_fidelity(is_reported=True)
    assert not caplog.text
    assert quick.vary({"monolayer.coverage": 0.2}).model.chosen_correction[0] == "qca-balanced"
    assert quick.fingerprint != alone.fingerprint
    assert material(recipe()).at_low_fidelity().model.chosen_correction[0] == "ensemble"


def test_numbers_that_vary_take_the_mean_field_and_say_so_once(caplog):
    varying = {"monolayer": {"coverage": {"formula": "0.15 + 0.05*u"}}}
    with caplog.at_level(logging.WARNING, "nacre"):
        material(recipe({"correction": "auto"}, substrate="air", **varying)).spectrum([0.0], [500.0])
    assert caplog.text.count("with numbers that vary it takes the quick way") == 1
    caplog.clear()
    low = {"monolayer": {"coverage": {"formula": "0.02 + 0.02*u"}}}
    with caplog.at_level(logging.WARNING, "nacre"):
        material(recipe({"correction": "auto"}, substrate="air", **low)).spectrum([0.0], [500.0])
    assert "quick way" not in caplog.text


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
def test_a_size_that_is_not_allowed_is_reported_with_its_key(key, value):
    with pytest.raises(NacreError, match=rf"model\.ensemble\.{key}"):
        material(recipe({"ensemble": {key: value}}))


def test_squares_cut_from_a_list_stay_inside_it_and_a_close_pair_loses_one():
    from nacre.families.metasurface.monolayer.arrangement import Pattern

    xy = np.random.default_rng(2).uniform(0, 8000, (600, 2))
    listed = Pattern(xy, 8000.0)
    wanted = np.sqrt(60 / (600 / 8000.0**2))
    for one in supercells(lambda count, seed: listed, 600 / 8000.0**2, 60.0, 60, 5, 0, True):
        side = one.period.side_nm
        assert side == pytest.approx(wanted)
        gap = (one.xy_nm[:, None] - one.xy_nm + side / 2) % side - side / 2
        assert (np.linalg.norm(gap, axis=2) + 1e9 * np.eye(len(gap))).min() >= 60.0 * (1 - 1e-6)
        # each is a point of the list, moved by one and the same step or brought back by the period
        assert np.all(np.abs(one.period.bloch) <= np.pi / side)
    whole = supercells(lambda count, seed: listed, 600 / 8000.0**2, 0.0, 550, 2, 0, True)
    assert all(len(one.xy_nm) == 600 and one.period.side_nm == 8000.0 for one in whole)


def _layered(indices, thicknesses, host):
    return Embedded(600.0, np.array(indices, complex), np.array(thicknesses), host)


# inside layers less dense than the glass below, as dense, denser, which guides light, and under another
INSIDE = {
    "thin": (_layered([1.0, 1.33, 1.5], [300.0], 1), 120.0),
    "resin": (_layered([1.0, 1.5, 1.5], [300.0], 1), 120.0),
    "guides": (_layered([1.0, 1.7, 1.5], [400.0], 1), 150.0),
    "covered": (_layered([1.0, 2.0, 1.33, 1.5], [60.0, 300.0], 2), 120.0),
}


@pytest.mark.parametrize(
    ("substrate", "is_mixture"),
    [
        (1.0, False),
        (1.5, False),
        (1.0, True),
        (1.5, True),
        *((name, False) for name in INSIDE),
        ("thin", True),
        ("covered", True),
    ],
)
def test_each_endless_pattern_of_lossless_spheres_sends_out_what_arrives(substrate, is_mixture):
    """All orders on both sides, the straight ones with the stack's own beams: no light has an edge to leave by."""
    radius = 75.0
    below, height = INSIDE[substrate] if substrate in INSIDE else (surface(600.0, substrate), radius)
    density = 0.2 / np.pi / radius**2
    particles = [Particle(1.0, height, t_matrix(2, below.inner_wavenumber * radius, 3.9 / below.inner_index))]
    if is_mixture:  # of unlike heights
        small = Particle(
            0.4, height - 35.0, t_matrix(2, below.inner_wavenumber * 60.0, 3.0 / below.inner_index), species=1
        )
        particles = [dataclasses.replace(particles[0], share=0.6), small]
    layer = Monolayer(below, tuple(particles), hard_disk_structure(density, 0.2, 7 * below.wavenumber))
    one = _patterns(layer, density, 0.2, 30, 1)
    k, low = below.wavenumber, below.index_below
    for cell in one.supercells:
        wave = orders(cell.period, 0.97 * k)[::7]
        sine = np.hypot(*wave.T) / k
        solved = one.lattice.solve(cell, one.waves(one.side(wave, False), False))
        total = 0.0
        for under in (False, True):
            index = low if under else 1.0
            every = orders(cell.period, index * k * (1 - 1e-9))
            side = one.side(every, under)
            f = one.coupling.far_field(cell.xy_nm, solved, one.waves(side, True), cell.species)
            f = f.reshape(2, len(every), 2, -1)
            cos = side.directions.cosines
            amplitude = (
                2 * np.pi / (k * index * cell.period.side_nm**2 * cos[:, None, None, None]) * f.transpose(1, 0, 2, 3)
            )
            for i, at in enumerate(wave):
                straight = int(np.argmin(np.hypot(*(every - at).T)))
                if under:
                    bare = side.directions.transmission_up[:, straight] * np.cos(np.arcsin(sine[i]))
                    bare = bare / (index * cos[straight])
                else:
                    bare = side.directions.reflection[:, straight]
                amplitude[straight, 0, 0, i] += bare[0]
                amplitude[straight, 1, 1, i] += bare[1]
            # of each order its power through the plane, over that of the light
            total = total + np.einsum("oqpi,o->pi", np.abs(amplitude) ** 2, index * cos) / np.sqrt(1 - sine**2)
        assert np.abs(total - 1).max() <= ENERGY_BAR


@pytest.mark.parametrize(
    ("second", "place"),
    [
        (None, "glass"),
        (0.05 + 3.1j, "glass"),
        (3.9, "glass"),
        (None, "film"),
        (None, "guides"),
        (None, "covered"),
        (3.9, "guides"),
        (0.05 + 3.1j, "covered"),
    ],
)
def test_where_the_window_ends_changes_no_coupling(second, place):
    """In a mixture direct waves beyond the window connect different heights; without them the error is 2 to 3 %.

    Light guided by a film also propagates far; without the waves beyond its index the error is 2.6 %.
    """
    from nacre.families.metasurface.supercells import Coupling, PeriodicCoupling

    stacks = {"glass": (surface(500.0, 1.5), 90.0), "film": (surface(500.0, 1.5, ((2.4, 120.0),)), 90.0), **INSIDE}
    (below, height), radius = stacks[place], 90.0
    density = 0.1 / np.pi / radius**2
    particles = [Particle(1.0, height, t_matrix(2, below.inner_wavenumber * radius, 0.05 + 3.1j))]
    if second is not None:
        small = Particle(0.5, height - 40.0, t_matrix(2, below.inner_wavenumber * 80.0, second), species=1)
        particles = [dataclasses.replace(particles[0], share=0.5), small]
    layer = Monolayer(below, tuple(particles), hard_disk_structure(density, 0.1, 7 * below.wavenumber))
    one = _patterns(layer, density, 0.1, 20, 1)
    found = []
    for share in (0.9, 1.7):
        reach = share * one.supercells[0].period.side_nm
        first, *others = one.layer.particles
        near = Coupling.build(below, first, 2 * radius, reach, *others, fades=True)
        found.append(PeriodicCoupling.build(one.layer, near, reach).matrix(one.supercells[0]))
    assert np.abs(found[0] - found[1]).max() <= 3e-3 * np.abs(found[1] - np.eye(len(found[1]))).max()
