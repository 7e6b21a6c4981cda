"""Two kinds of particle on one arrangement, and sizes of flat ones that spread: limits, other codes, real mixtures."""

import dataclasses
import json

import numpy as np
import pytest
from helpers_metasurface import surface, t_matrix
from validation._metasurface_helpers import plane_waves
from validation.metasurface_ensembles import distance, light, of_discs, pattern_correction
from validation.metasurface_mixtures import SILICON as DARK_SILICON
from validation.metasurface_mixtures import SILVER as MIE_SILVER
from validation.metasurface_mixtures import mixture

from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.families.metasurface.ensemble import EnsembleSettings, _kind_factor, expected_seconds
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.species import widened
from nacre.families.metasurface.supercells import (
    Coupling,
    Period,
    Supercell,
    direct_coupling,
    lift,
    with_species,
)
from nacre.families.metasurface.tmatrix.axisymmetric import as_blocks, multipole_index
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions
from nacre.material.material import material

SINGLE = 2e-5  # of the largest amplitude: the matrix is in single precision, its tables good to 1e-5
SILICON, SILVER = {"n": 4.0, "k": 0.03}, {"n": 0.05, "k": 3.1}
AROUND = 2 * np.pi * np.arange(12) / 12
FLAT = {"shape": "spheroid", "material": SILICON, "diameter_nm": 120, "height_nm": 80, "gap_nm": 60}


def recipe(particle, **more):
    return {
        "family": "metasurface", "substrate": {"n": 1.5}, "particle": particle, "monolayer": {"coverage": 0.05},
        "model": {"correction": "qca-balanced", "multipole_order": 5}, **more,
    }  # fmt: skip


def powers(made, wavelength=550.0):
    return np.stack(material(made).model.powers(np.array([1.0, 0.5]), wavelength))


def two(first, second, share):
    return {**first, "second": {**second, "share": share}}


def test_a_mixture_of_one_kind_with_itself_is_that_kind():
    ball = {"material": SILICON, "radius_nm": 70}
    plain = powers(recipe(ball))
    assert np.abs(powers(recipe(two(ball, ball, 0.4))) - plain).max() <= 1e-12
    # by way of blocks too
    assert np.abs(powers(recipe(two(FLAT, FLAT, 0.4))) - powers(recipe(FLAT))).max() <= 1e-12


def test_a_mixture_tends_to_each_kind_and_a_thin_one_adds_them():
    silicon, silver = {"material": SILICON, "radius_nm": 70}, {"material": SILVER, "radius_nm": 70}
    ends = powers(recipe(silicon)), powers(recipe(silver))
    for share, end in ((1e-6, ends[0]), (1 - 1e-6, ends[1])):
        assert np.abs(powers(recipe(two(silicon, silver, share))) - end).max() <= 1e-4
    thin = {"monolayer": {"coverage": 1e-3}}
    apart = [powers(recipe(p, **thin))[2:].sum(axis=0) for p in (silicon, silver, two(silicon, silver, 0.25))]
    assert apart[2] == pytest.approx(0.75 * apart[0] + 0.25 * apart[1], rel=0.01)


def test_lossless_mixtures_and_spread_spheroids_keep_all_light():
    glassy = {"n": 3.0}
    ball = {"material": glassy, "radius_nm": 60}
    mixture = two(ball, {**FLAT, "material": glassy}, 0.4)
    made = recipe(mixture)
    assert np.abs(powers(made).sum(axis=0) - 1).max() <= 6e-3  # as spheres of one size keep it
    spread = {**FLAT, "material": glassy, "deviation_nm": 6}
    assert np.abs(powers(recipe(spread)).sum(axis=0) - 1).max() <= 6e-3


def test_a_narrow_spread_of_spheroids_is_one_size_and_a_wide_one_is_not():
    plain = powers(recipe(FLAT))
    narrow = powers(recipe({**FLAT, "deviation_nm": 0.01}))
    wide = powers(recipe({**FLAT, "deviation_nm": 10}))
    assert np.abs(narrow - plain).max() <= 1e-4 < np.abs(wide - plain).max()


def test_coverage_is_by_the_mean_area_and_the_larger_kind_keeps_all_apart():
    made = material(
        recipe(two({"material": SILICON, "radius_nm": 80}, {"material": SILVER, "radius_nm": 40}, 0.75))
    ).model
    density = made.structure.density_per_nm2
    assert density * np.pi * (0.25 * 80**2 + 0.75 * 40**2) == pytest.approx(0.05)
    assert made.coverage == pytest.approx(0.05) and made.structure.diameter_nm == pytest.approx(160.0)


def test_room_for_multipoles_that_are_not_there_changes_nothing():
    t = t_matrix(2, 0.9, 3.5)
    blocks = widened(t, 4)
    assert blocks.shape == (5, 8, 8)
    kept = np.array([0, 1, 4, 5])
    assert np.array_equal(blocks[:3, kept[:, None], kept], as_blocks(t)) and np.count_nonzero(blocks) == 4 * 2 + 2


def unlike(below, order):
    """A large silicon and a small silver sphere, both standing on the plane: their centres differ in height."""
    k = below.wavenumber
    return (
        Particle(0.5, 85.0, t_matrix(order, k * 85.0, 3.9 + 0.02j)),
        Particle(0.5, 50.0, t_matrix(order, k * 50.0, 0.05 + 3.1j), species=1),
    )  # fmt: skip


PLACES, KINDS = np.array([[0.0, 0.0], [150.0, 30.0], [-120.0, 260.0], [500.0, -340.0]]), np.array([0, 1, 1, 0])


def _far(below, order, theta_i, theta_s, azimuths, views):
    particles = unlike(below, order)
    coupling = Coupling.build(below, particles[0], 140.0, 1000.0, particles[1])

    def waves(theta, around):
        each = [Directions.build(below, p.centre_nm, order, order, np.cos(theta)) for p in particles]
        return plane_waves(each[0], np.asarray(around), order, below.wavenumber, each[1])

    solved = coupling.solve(PLACES, waves(theta_i, azimuths), KINDS)
    return coupling.far_field(PLACES, solved, waves(theta_s, views), KINDS)


@pytest.mark.parametrize("substrate", [1.5, 4.3 + 0.07j])
def test_unlike_spheres_over_a_stack_are_reciprocal(substrate):
    """It sees both ways between unequal heights, directly and by the stack."""
    theta, azimuths = np.array([0.3, 1.1]), AROUND[:6]
    f = np.abs(_far(surface(500.0, substrate), 3, theta, theta, azimuths, azimuths + np.pi))
    assert np.abs(f - f.T).max() <= SINGLE * f.max()


def test_unlike_spheres_at_unlike_heights_agree_with_treams():
    treams = pytest.importorskip("treams")
    order, k = 3, 2 * np.pi / 600.0
    theta_s = np.array([0.3, 1.2])
    found = _far(surface(600.0, 1.0), order, np.array([0.0]), theta_s, [0.0], AROUND)
    found = found.reshape(2, 2, 12, 2)
    sizes = ((85.0, (3.9 + 0.02j) ** 2), (50.0, (0.05 + 3.1j) ** 2))
    ones = [treams.TMatrix.sphere(order, k, sizes[n][0], [sizes[n][1], 1.0]) for n in KINDS]
    at = np.column_stack([PLACES, [sizes[n][0] for n in KINDS]])
    cluster = treams.TMatrix.cluster(ones, at).interaction.solve()
    far = 1e9
    r = np.array([theta_s[:, None] + 0 * AROUND, AROUND + 0 * theta_s[:, None]])
    outward = np.stack([np.sin(r[0]) * np.cos(r[1]), np.sin(r[0]) * np.sin(r[1]), np.cos(r[0])], axis=-1)
    parts = [treams.plane_wave([0, 0, -k], hand, k0=k, material=1.0, poltype="helicity") for hand in (0, 1)]
    for pol, field in enumerate(([0.0, 1.0, 0.0], [1.0, 0.0, 0.0])):
        shares = np.linalg.lstsq(
            np.stack([np.asarray(p.efield(np.zeros(3))) for p in parts], axis=1), np.array(field), rcond=None
        )[0]
        sent = sum(
            share * np.asarray((cluster @ wave.expand(cluster.basis)).efield(far * outward)) * far
            for share, wave in zip(shares, parts)
        )
        ours = np.sqrt((np.abs(found[..., pol]) ** 2).sum(axis=0))
        theirs = np.linalg.norm(sent, axis=-1)
        assert np.abs(ours - theirs).max() <= 1e-4 * theirs.max()


def _real_mixture(coverage, substrate):
    below = surface(500.0, substrate)
    density = coverage / np.pi / (0.5 * 85.0**2 + 0.5 * 50.0**2)
    structure = hard_disk_structure(density, density * np.pi * 85.0**2, 5 * below.wavenumber)
    return Monolayer(below, unlike(below, 2), structure)


def test_a_thin_mixture_is_what_its_ensemble_says():
    """Far apart both know single scattering: the mean square of the kinds, which their mean amplitude is not."""
    layer = _real_mixture(0.01, 1.5 + 0.01j)
    ratio, errors, _ = pattern_correction(layer, 20, 10)
    angles = np.radians([20.0, 50.0])
    corrected_light, plain = (light(layer, angles, angles, r) for r in (ratio, None))
    error = float(np.median(errors))
    assert np.all(np.abs(corrected_light / plain - 1) <= 4 * error + 0.02) and error < 0.1
    # one kind alone at the same density is far from it
    alone = dataclasses.replace(layer, particles=(dataclasses.replace(layer.particles[0], share=1.0),))
    assert np.all(np.abs(light(alone, angles, angles, None) / plain - 1) > 0.2)


@pytest.mark.full
def test_the_ensemble_of_a_mixture_is_what_discs_of_it_send_without_any_model():
    """As one kind against another code: 8 % with a quarter of the patterns, light to 60 degrees."""
    layer = mixture(520.0, (75.0, MIE_SILVER), (60.0, DARK_SILICON), 0.4, 0.08)
    theta_s, theta_i = np.radians(np.linspace(3.5, 80.5, 12)), np.radians([10.5, 24.5, 38.5, 52.5])
    ratio, _, _ = pattern_correction(layer, 130, 12)
    assert distance(light(layer, theta_s, theta_i, ratio), of_discs(layer, theta_s, theta_i, 24), theta_s) <= 0.08


def test_a_mixture_s_ensemble_of_unlike_heights_states_a_longer_time():
    """Two kinds of 60 spheres took 2.2 times the work of one; level ones hardly more. What is opaque takes half."""
    level, apart = (mixture(500.0, (70.0, MIE_SILVER), (radius, DARK_SILICON), 0.4, 0.08) for radius in (70.0, 50.0))
    one = dataclasses.replace(level, particles=(dataclasses.replace(level.particles[0], share=1.0),))
    opaque = dataclasses.replace(one.surface, indices=np.array([1.0, 4.0 + 0.1j]))
    dark = dataclasses.replace(one, surface=opaque)
    settings = EnsembleSettings(60, 48, 2)
    alone, level_s, apart_s, dark_s = (expected_seconds(16, settings, each) for each in (one, level, apart, dark))
    assert dark_s < 0.7 * alone and alone < level_s < 1.3 * alone and 1.7 * alone < apart_s < 3.0 * alone
    higher = EnsembleSettings(60, 48, 3)
    assert expected_seconds(16, higher, apart) / expected_seconds(16, higher, one) > apart_s / alone


def test_each_kind_has_its_share_of_all_patterns():
    made = [Supercell(np.zeros((n, 2)), Period(1.0, np.zeros(2)), 0) for n in (31, 24, 45)]
    kinds, others = ([one.species for one in with_species(made, np.array([0.7, 0.3]), seed)] for seed in (3, 4))
    assert [len(k) for k in kinds] == [31, 24, 45] and sum(int(k.sum()) for k in kinds) == 30
    assert not np.array_equal(np.concatenate(kinds), np.concatenate(others))


def test_how_a_pattern_s_kinds_lie_adds_nothing_on_average():
    """The control variate of a mixture must not move the mean: 1 over many dealings, and two unlike spheres by hand."""
    g = np.random.default_rng(5)
    xy, shares, q = g.uniform(0, 2000, (40, 2)), np.array([0.7, 0.3]), g.uniform(0.003, 0.01, (6, 2))
    waves = np.exp(-1j * xy @ q.T), np.ones((40, 1))
    cells_of_it = with_species([Supercell(xy, Period(2000.0, np.zeros(2)), 0)] * 400, shares, 1)
    found = np.stack([_kind_factor(one, shares, *waves) for one in cells_of_it])
    assert np.all(np.abs(found.mean(axis=0) - 1) <= 4 * found.std(axis=0) / 20) and found.std() > 0.5
    pair = dataclasses.replace(cells_of_it[0], xy_nm=xy[:2], species=np.array([0, 1]))
    turn = np.exp(-1j * (xy[1] - xy[0]) @ q[0])
    by_hand = np.abs(0.3 - 0.7 * turn) ** 2 / (2 * 0.21)
    assert _kind_factor(pair, shares, waves[0][:2], waves[1][:2])[0, 0] == pytest.approx(by_hand)


@pytest.mark.parametrize("height", [0.4, -1.1])
def test_waves_seen_from_another_height_are_those_of_the_straight_way(height):
    r, low = np.array([8.0, 15.0]), multipole_index(7).l <= 2
    wanted = direct_coupling(2, r, height)
    carried = np.einsum("ab,bcr->acr", lift(7, height)[low], direct_coupling(7, r)[:, low])
    assert np.abs(carried - wanted).max() <= 2e-4 * np.abs(wanted).max()


def test_a_mixture_with_an_ensemble_in_a_recipe_is_reported_and_cached(tmp_path, monkeypatch):
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path))
    made = recipe(
        two({"material": SILICON, "radius_nm": 75}, {"material": SILVER, "radius_nm": 50}, 0.3),
        substrate={"n": 1.5, "k": 0.01},
        model={
            "correction": "ensemble", "multipole_order": 3, "ensemble": {"spheres": 20, "realisations": 4},
        },
    )  # fmt: skip
    bsdf = material(made).bsdf(np.array([500.0]))
    again = material(made).bsdf(np.array([500.0]))
    assert bsdf.provenance["ensemble"]["standard_error"] > 0
    assert np.array_equal(bsdf.lobes[1].above, again.lobes[1].above)


def test_layout_draws_both_kinds_and_says_so(tmp_path, capsys):
    import gdstk

    path = tmp_path / "mixed.toml"
    path.write_text(
        'family = "metasurface"\nsubstrate = "glass"\n[particle]\nmaterial = "Ag"\nradius_nm = 50\n'
        '[particle.second]\nshape = "cylinder"\nmaterial = "Si"\ndiameter_nm = 160\nheight_nm = 80\nshare = 0.25\n'
        "[monolayer]\ncoverage = 0.1\n"
    )
    assert run(["fabricate", str(path), "--to", "gds", "-o", str(tmp_path / "x.gds")]) == 0
    facts = json.loads((tmp_path / "x.gds.json").read_text())
    assert [kind["radius_um"] for kind in facts["kinds"]] == [0.05, 0.08]
    counts = [kind["particles"] for kind in facts["kinds"]]
    assert sum(counts) == facts["particles"] and counts[1] / sum(counts) == pytest.approx(0.25, abs=0.02)
    cells = {cell.name: cell for cell in gdstk.read_gds(str(tmp_path / "x.gds")).cells}
    for name, radius in (("PARTICLE", 0.05), ("PARTICLE_2", 0.08)):
        low, high = cells[name].bounding_box()
        assert high[0] - low[0] == pytest.approx(2 * radius, rel=0.02)
    drawn = [ref.cell.name for ref in cells["PERIOD"].references]
    assert [drawn.count("PARTICLE"), drawn.count("PARTICLE_2")] == counts
    assert run(["fabricate", str(path), "--to", "csv", "-o", str(tmp_path / "x.csv")]) == 0
    lines = (tmp_path / "x.csv").read_text().splitlines()
    assert lines[0] == "x_um,y_um,radius_um" and sum(line.endswith("0.0800") for line in lines) == counts[1]
    assert run(["fabricate", str(path), "--to", "sheet", "-o", str(tmp_path / "s.csv")]) == 0
    sheet = (tmp_path / "s.csv").read_text()
    assert "25 % of them" in sheet and "cylinder" in sheet and "Ag" in sheet and "Si" in sheet


def test_figures_and_files_of_a_mixture(tmp_path):
    made = material(
        recipe(two({"material": SILICON, "radius_nm": 50}, {"material": SILVER, "radius_nm": 70}, 0.3))
    ).model
    drawn = made.figures["colour-map"](angles_deg=[0.0], densities_per_um2=[1.0, 12.0])
    assert np.all(drawn["reflectance"] >= 0) and drawn["reflectance"].max() < 1
    narrow = dataclasses.replace(made, range_nm=(500.0, 510.0))
    lost = narrow.own_formats["tmat"](tmp_path / "first.tmat.h5", "")
    assert any("second species" in line for line in lost)


def test_what_a_mixture_cannot_be_gets_one_line():
    ball = {"material": SILICON, "radius_nm": 70}
    for second, said in (
        ({"material": SILVER, "radius_nm": 50}, "share"),
        ({"material": SILVER, "radius_nm": 50, "share": 1.0}, "share"),
        ({"material": SILVER, "share": 0.2}, "needs radius_nm of a sphere"),
        ({"material": SILVER, "radius_nm": 50, "share": 0.2, "second": ball}, "second"),
    ):
        with pytest.raises(NacreError, match=said) as raised:
            material(recipe({**ball, "second": second}))
        assert "particle.second" in str(raised.value) and "\n" not in str(raised.value)
    with pytest.raises(NacreError, match="for the larger species"):
        material(
            recipe(
                two({"material": SILVER, "radius_nm": 40}, {**ball, "radius_nm": 120}, 0.05),
                monolayer={"coverage": 0.1, "packing": 0.12},
            )
        )


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("orientation", "aligned", "symmetric about the normal"),
        ("turn_deg", 30, 'orientation = "aligned"'),
        ("rotation_deg", 30, 'write orientation = "aligned", and turn_deg'),
    ],
)
def test_spheres_are_not_turned_and_the_line_says_what_to_write(key, value, said):
    with pytest.raises(NacreError, match=f"gives {key}.*{said}|gives orientation.*{said}") as raised:
        material(recipe({"material": SILICON, "radius_nm": 70, key: value}))
    assert "\n" not in str(raised.value)


def test_a_mixture_varies_as_other_recipes_do():
    made = material(recipe(two({"material": SILICON, "radius_nm": 75}, {"material": SILVER, "radius_nm": 50}, 0.3)))
    other = made.vary({"particle.second.share": 0.6, "particle.second.radius_nm": 45})
    assert other.model.second.share == 0.6 and other.model.second.mean_radius_nm == 45
    assert other.fingerprint != made.fingerprint
