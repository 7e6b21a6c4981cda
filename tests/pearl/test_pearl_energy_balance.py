"""`energy_balance = "published"`: R (1 - T) in tables, surrogate and walk, and the energy defect in the report."""

from __future__ import annotations

import copy
import logging

import numpy as np
import pytest

import nacre
from nacre.bsdf.lobes.table import from_half_difference
from nacre.families.pearl import platelet as platelet_module
from nacre.families.pearl.platelet import cos_nodes
from nacre.light import spectrum_to_xyz, xyz_to_lab

LAM = np.array([450.0, 530.0, 610.0])
INDEX, COATING, SUBSTRATE, ALBEDO, SIGMA = 1.575, 2.6 + 0.02j, 1.4585, 0.6, 0.1
COATING_NM, SUBSTRATE_NM, FRACTION, RESIN_NM = 85.0, 80.0, 0.02, 150e3
LOST_BAR = 0.01  # the bar of the claim; two walks of these lengths differ by 0.003 (one standard error)
WALKS = 60_000
COLOURED = 10.0  # CIELAB chroma at L* 50 of a colour that earns a name

DATA = {
    "family": "pearl",
    "strata": [
        {
            "resin": {"n": INDEX},
            "thickness_nm": RESIN_NM,
            "platelets": [
                {
                    "volume_fraction": FRACTION,
                    "substrate": {"material": {"n": SUBSTRATE}, "thickness_nm": SUBSTRATE_NM},
                    "coatings": [{"material": {"n": 2.6, "k": 0.02}, "thickness_nm": COATING_NM}],
                    "normal_deviation": SIGMA,
                    "energy_balance": "published",
                }
            ],
        }
    ],
    "base": {"albedo": ALBEDO},
}


def recipe(**keys: object) -> dict:
    """The recipe with other keys of its platelet."""
    data = copy.deepcopy(DATA)
    data["strata"][0]["platelets"][0].update(keys)
    return data


def own_flake(cos, lam):
    """R and T of the flake by characteristic matrices, unpolarised, `[cos]`."""
    found = np.zeros((2, len(cos)))
    kx = INDEX * np.sqrt(1.0 - cos**2)
    for is_p in (False, True):

        def admittance(n, kx=kx, is_p=is_p):
            kz = np.sqrt(n * n - kx**2 + 0j)
            return kz, n * n / kz if is_p else kz

        q0 = admittance(INDEX)[1]
        b, c = np.ones_like(q0), q0
        for n, d in ((COATING, COATING_NM), (SUBSTRATE, SUBSTRATE_NM), (COATING, COATING_NM)):
            kz, q = admittance(n)
            phase = 2 * np.pi * kz * d / lam
            b, c = np.cos(phase) * b - 1j * np.sin(phase) / q * c, np.cos(phase) * c - 1j * q * np.sin(phase) * b
        found += 0.5 * np.stack([np.abs((q0 * b - c) / (q0 * b + c)) ** 2, np.abs(2 * q0 / (q0 * b + c)) ** 2])
    return found


def fresnel(cos, eta):
    """Reflectance of the bare interface."""
    kz = np.sqrt(np.maximum(eta**2 - 1 + cos**2, 0.0))
    s, p = (cos - kz) / (cos + kz), (eta**2 * cos - kz) / (eta**2 * cos + kz)
    return np.where(kz > 0, 0.5 * (s**2 + p**2), 1.0)


def slab_loses(theta_deg: float, lam: float, rng: np.random.Generator) -> float:
    """1 - R - T - A of the slab, counted by single photons; flakes of all normals, met as |w.m| says."""
    nodes = np.linspace(1e-3, 1.0, 800)
    big_r, big_t = own_flake(nodes, lam)
    sine = np.sin(np.radians(theta_deg)) / INDEX
    w = np.tile([-sine, 0.0, -np.sqrt(1 - sine**2)], (WALKS, 1))
    reflected = rng.random(WALKS) < fresnel(np.cos(np.radians(theta_deg)), INDEX)
    accounted = int(reflected.sum())
    w, depth = w[~reflected], np.zeros(WALKS - accounted)
    axes = np.array([SIGMA, SIGMA, 1.0])
    sphere = rng.normal(size=(200_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    area = np.linalg.norm(axes * sphere, axis=1).mean()
    # the faces of a unit of flakes lying flat have the area 2 (both sides); density on the full sphere is 4 <|A n|>
    rate = FRACTION * RESIN_NM / (SUBSTRATE_NM + 2 * COATING_NM) * 0.5 * 4 * area
    while len(w):
        depth = depth - w[:, 2] * rng.exponential(size=len(w)) / rate
        top, bottom = depth <= 0, depth >= 1
        out = top & (rng.random(len(w)) >= fresnel(np.abs(w[:, 2]), 1 / INDEX))
        w[top & ~out, 2] *= -1.0
        eaten = bottom & (rng.random(len(w)) >= ALBEDO)
        up, phi = np.sqrt(rng.random(len(w))), 2 * np.pi * rng.random(len(w))
        side = np.sqrt(1 - up**2)
        w[bottom] = np.stack([side * np.cos(phi), side * np.sin(phi), up], axis=1)[bottom]
        depth = np.clip(depth, 0.0, 1.0)
        inside = np.flatnonzero(~top & ~bottom)
        m = np.empty((0, 3))
        while len(m) < len(inside):  # normals from D: A n of an even n, in proportion to its length
            n = rng.normal(size=(2 * len(inside) + 10, 3))
            n = axes * n / np.linalg.norm(n, axis=1, keepdims=True)
            length = np.linalg.norm(n, axis=1)
            m = np.concatenate([m, (n / length[:, None])[rng.random(len(n)) < length]])
        m = m[: len(inside)]
        dot = np.sum(w[inside] * m, axis=1)
        r, t = (np.interp(np.abs(dot), nodes, table) for table in (big_r, big_t))
        met, choice = rng.random(len(inside)) < np.abs(dot), rng.random(len(inside))
        turned = met & (choice < r * (1 - t))
        w[inside[turned]] -= 2 * dot[turned, None] * m[turned]
        ends = met & ~turned & (choice >= r * (1 - t) + t)
        swallowed = ends & (choice < r * (1 - t) + t + (1 - r - t))  # A; what is left of 1 is lost
        accounted += int(out.sum() + eaten.sum() + swallowed.sum())
        gone = out | eaten
        gone[inside[ends]] = True
        w, depth = w[~gone], depth[~gone]
    return 1.0 - accounted / WALKS


@pytest.mark.parametrize("theta_deg", [pytest.param(0.0, marks=pytest.mark.full), 45.0])
def test_the_published_balance_loses_what_an_independent_slab_walk_loses(theta_deg):
    lost = nacre.material(DATA).model.energy_defect(np.radians([theta_deg]), LAM)[0]
    own = slab_loses(theta_deg, LAM[1], np.random.default_rng(3))
    assert abs(lost[1] - own) < LOST_BAR
    assert own > 0.2  # much is lost, or the claim would be empty


def test_every_form_of_a_platelet_reflects_r_times_one_minus_t():
    """The walk's tables, the surrogate and the figure; extinction, which is of T alone, stays."""
    made = {name: nacre.material(recipe(energy_balance=name)).model for name in ("conserving", "published")}
    tables = {name: model.platelet_tables(LAM)[0] for name, model in made.items()}
    r, t = np.moveaxis(tables["conserving"], -1, 0)
    assert np.abs(tables["published"] - np.stack([r * (1 - t), t], axis=-1)).max() < 1e-12
    figures = {name: model.figures["platelet"](LAM, np.array([0.0, 60.0])) for name, model in made.items()}
    before, after = figures["conserving"], figures["published"]
    assert np.abs(after["reflectance"] - before["reflectance"] * (1 - before["transmittance"])).max() < 1e-12
    assert np.array_equal(after["transmittance"], before["transmittance"])
    lobes = {name: model.bsdf(LAM).lobes[0] for name, model in made.items()}
    assert np.array_equal(lobes["conserving"].flake_extinction, lobes["published"].flake_extinction)
    # off the mirror direction inside: one flake tilted by some 10 degrees, the exact part of the surrogate
    wi, wo = np.array([[0.0, 0.0, 1.0]]), np.array([[0.3, 0.0, np.sqrt(0.91)]])
    sure = {name: model.surrogate_radiance(wi, wo, LAM)[0][0] for name, model in made.items()}
    inner = np.sqrt(0.5 * (1 + np.sqrt(1 - 0.09 / INDEX**2)))
    share = 1 - np.array([np.interp(inner, cos_nodes(len(t)), t[:, i]) for i in range(len(LAM))])
    assert np.abs(sure["published"] / sure["conserving"] - share).max() < 2e-3  # 65 nodes instead of 257


def test_platelets_are_counted_physically_by_default():
    plain = recipe()
    del plain["strata"][0]["platelets"][0]["energy_balance"]
    model = nacre.material(plain).model
    assert model.strata[0].flakes[0].platelet.energy_balance == "conserving"
    assert model.energy_defect(np.array([0.0]), LAM) is None


def test_one_kind_of_two_may_be_counted_so():
    data = recipe()
    physical = {**data["strata"][0]["platelets"][0], "energy_balance": "conserving"}
    data["strata"][0]["platelets"].append(physical)
    model = nacre.material(data).model
    first, second = model.platelet_tables(LAM)
    assert np.all(first[..., 0] <= second[..., 0]) and first[-1, 0, 0] < second[-1, 0, 0]
    both = model.energy_defect(np.array([0.0]), LAM)[0]
    data["strata"][0]["platelets"][1]["energy_balance"] = "published"
    assert np.all(both < nacre.material(data).model.energy_defect(np.array([0.0]), LAM)[0])


def test_the_published_balance_warns_once(caplog):
    platelet_module._warn_of_published_balance.cache_clear()
    with caplog.at_level(logging.WARNING, logger="nacre"):
        for _ in range(3):
            nacre.material(DATA).model.platelet_tables(LAM)
    assert caplog.text.count("R (1 - T)") == 1


def test_a_bad_energy_balance_is_one_clear_line():
    with pytest.raises(
        nacre.NacreError, match=r'platelets\[0\]\.energy_balance = "printed".*conserving.*published'
    ) as caught:
        nacre.material(recipe(energy_balance="printed"))
    assert "\n" not in str(caught.value)


def hue_path(name: str, balance: str):
    """Hue in degrees and chroma at L* 50 of a source's pigment near the mirror direction, 5 to 70 degrees."""
    lam = np.arange(400.0, 701.0, 20.0)
    angles = np.radians([5.0, 20.0, 35.0, 50.0, 60.0, 70.0])
    wi, wo = from_half_difference(np.full(6, np.radians(4.0)), angles, np.full(6, np.pi / 2))
    model = nacre.load(f"pearl/{name}").vary({"strata[0].platelets[0].energy_balance": balance}).model
    xyz = spectrum_to_xyz(np.pi * model.estimate_radiance(wi, wo, lam, 400, 1)[0], lam)
    lab = xyz_to_lab(0.1842 * xyz / xyz[:, 1:2])
    return np.degrees(np.arctan2(lab[:, 2], lab[:, 1])) % 360, np.hypot(lab[:, 1], lab[:, 2])


@pytest.mark.parametrize("name", [*(pytest.param(n, marks=pytest.mark.full) for n in ("mcs1", "mcs2")), "bfs1"])
def test_the_sources_pigments_travel_in_colour_as_it_counts_them(name):
    """Colours that travel: a sixth of the hue circle at least, where chroma is that of a colour with a name."""
    hue, chroma = hue_path(name, "published")
    strong = chroma > COLOURED
    assert strong.sum() >= 4  # of six angles
    assert np.ptp(np.degrees(np.unwrap(np.radians(hue[strong])))) > 60.0
    if name == "bfs1":  # burgundy, as the source calls it
        assert np.any(strong & ((hue > 330.0) | (hue < 30.0)))


@pytest.mark.full
@pytest.mark.parametrize("name", ["mcs1", "mcs2", "bfs1"])
def test_the_same_pigments_are_pale_where_no_light_is_lost(name):
    """A deep stack of flakes that absorb nothing tends to white, whatever colour one flake has."""
    assert hue_path(name, "conserving")[1].max() < COLOURED


@pytest.mark.full
@pytest.mark.render
def test_the_report_states_what_is_lost_and_only_then():
    """R + T and the lost light leave to base and flakes what they absorb; a conserving recipe has no such row."""
    found = nacre.report(nacre.material(DATA)).hemispherical
    for angle in (0, 45):
        assert 0.2 < found[f"energy_defect_{angle}"] < 1.0 - found[f"diffuse_reflectance_{angle}"]
    assert not [
        key
        for key in nacre.report(nacre.material(recipe(energy_balance="conserving"))).hemispherical
        if "defect" in key
    ]
