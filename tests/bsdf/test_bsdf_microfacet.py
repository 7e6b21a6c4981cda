"""Rough interfaces: the published formulas, reciprocity, energy, and the light between facets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers_bsdf import dielectric, metal, mirror, random_directions, reciprocity_error

from nacre.bsdf import Bsdf
from nacre.bsdf.compensation import compensate, facet_transmittance
from nacre.bsdf.facet_distributions import DISTRIBUTIONS, normal_density, smith_masking, visible_normals
from nacre.bsdf.lobe import hemisphere_nodes, product_rule
from nacre.bsdf.lobes.interface import Microfacet, Specular
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.tabulate import StackTables
from nacre.bsdf.texture import Texture, parse_formula
from nacre.core.arrays import direction
from nacre.core.errors import UnsupportedError
from nacre.measure.evaluate import directional_hemispherical

RECIPROCITY = 1e-10
FURNACE_LIMIT = 1.002
WIDTHS = [(0.05, 0.05), (0.3, 0.3), (0.1, 0.5)]
ANGLES = np.radians([0.0, 30.0, 60.0, 75.0, 85.0])
INTERFACES = {
    "metal": metal(1.0 + 6.5j),
    "glass": dielectric(1.5),
    "absorbing glass": dielectric(1.5, absorbed=0.2),
    "from a dense ambient": dielectric(1.5, flipped=True),
}


def furnace(lobe: Microfacet, azimuth: float = 0.7, side: int = 1, nodes: int = 64) -> np.ndarray:
    wi = direction(ANGLES, azimuth)
    wi[:, 2] *= side
    reflected, transmitted = directional_hemispherical(Bsdf((lobe,)), wi, nodes=nodes)
    return np.asarray(reflected + transmitted)[:, 0]


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize(("ax", "ay"), [(0.2, 0.2), (0.3, 0.6)])
def test_distributions_are_normalised(distribution: str, ax: float, ay: float) -> None:
    m, weight = hemisphere_nodes(400)
    total = weight @ (
        normal_density(distribution, m, ax, ay) / (m[:, 2] if distribution == "ashikhmin-shirley" else 1.0)
    )
    assert total == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann", "blinn"])
@pytest.mark.parametrize("degrees", [0.0, 45.0, 80.0])
def test_visible_normals_sum_to_one(distribution: str, degrees: float) -> None:
    # Beckmann's masking is a fit, off by 0.35 % at most
    weight = visible_normals(distribution, direction(np.radians(degrees), 0.4), 0.2, 0.4)[1]
    assert weight.sum() == pytest.approx(1.0, abs=4e-3 if distribution == "beckmann" else 1e-3)


def test_ggx_on_metal_is_the_textbook_formula() -> None:
    alpha, n = 0.25, 1.0 + 6.5j
    lobe = Microfacet(metal(n, nodes=2049), "ggx", alpha, alpha)
    wi, wo = direction(0.6, 0.1), direction(0.9, 2.8)
    h = (wi + wo) / np.linalg.norm(wi + wo)
    d = alpha**2 / (np.pi * ((alpha**2 - 1) * h[2] ** 2 + 1) ** 2)
    g = [2 / (1 + np.sqrt(1 + alpha**2 * (1 / w[2] ** 2 - 1))) for w in (wi, wo)]
    c = wi @ h
    kz = np.sqrt(n**2 - 1 + c**2)
    r = 0.5 * (abs((c - kz) / (c + kz)) ** 2 + abs((c - kz / n**2) / (c + kz / n**2)) ** 2)
    expected = r * d * g[0] * g[1] / (4 * wi[2] * wo[2])
    assert lobe.evaluate(wi, wo)[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.3])
@pytest.mark.parametrize("material", ["metal", "glass"])
def test_tables_are_fine_enough_for_the_renderers_own_materials(distribution: str, alpha: float, material: str) -> None:
    # the bars against Mitsuba's roughconductor and roughdielectric, here against tables of 16385 nodes
    n = 1.0 + 6.5j if material == "metal" else 1.5
    index = np.array([np.ones(3, complex), np.full(3, n)])
    tables = StackTables(index, [], metal(1.0 + 6.5j).wavelengths_nm, material == "glass")
    coarse = Microfacet(tables.adaptive(np.zeros(0)), distribution, alpha, alpha)
    fine = Microfacet(tables.build(np.zeros(0), 16385), distribution, alpha, alpha)
    wi, wo = random_directions(20000, 5), random_directions(20000, 6)
    cos = np.abs(wo[:, 2])
    exact = fine.evaluate(wi, wo)[:, 0] * cos
    # the renderer's test looks at each incidence with its own maximum: take that of a mirror-like pair
    largest = np.max(exact)
    error = np.abs(coarse.evaluate(wi, wo)[:, 0] * cos - exact)
    assert np.max(error) / largest <= 3e-4
    lit = exact > 1e-6 * largest
    relative = error[lit] / exact[lit]
    assert np.quantile(relative, 0.999) <= 1e-3
    assert np.max(relative) <= 0.02


def test_ashikhmin_shirley_reflects_as_published() -> None:
    ax, ay = 0.2, 0.45
    lobe = Microfacet(mirror(), "ashikhmin-shirley", ax, ay)
    wi, wo = direction(0.5, 0.3), direction(1.1, 2.5)
    h = (wi + wo) / np.linalg.norm(wi + wo)
    nu, nv = 2 / ax**2 - 2, 2 / ay**2 - 2
    power = (nu * h[0] ** 2 + nv * h[1] ** 2) / (1 - h[2] ** 2)
    published = np.sqrt((nu + 1) * (nv + 1)) / (8 * np.pi) * h[2] ** power / ((wi @ h) * max(wi[2], wo[2]))
    assert lobe.evaluate(wi, wo)[0] == pytest.approx(published, rel=1e-9)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("interface", list(INTERFACES))
@pytest.mark.parametrize("compensated", [False, True])
def test_reciprocity(distribution: str, interface: str, compensated: bool) -> None:
    response = INTERFACES[interface]
    lobe = Microfacet(response, distribution, 0.2, 0.4, rotation=Texture(0.5, 0.5, parse_formula("0.5")))
    lobe = compensate(lobe) if compensated else lobe
    wi, wo = random_directions(500, 1), random_directions(500, 2)
    # below the surface of a dense ambient lies the thin medium
    eta = 1.0 / response.eta if response.flipped else response.eta
    assert reciprocity_error(Bsdf((lobe,)), wi, wo, eta) < RECIPROCITY


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize(("ax", "ay"), WIDTHS)
@pytest.mark.parametrize(("response", "side"), [(mirror(), 1), (dielectric(1.5), 1), (dielectric(1.5), -1)])
def test_furnace_never_exceeds_one(
    distribution: str, ax: float, ay: float, response: InterfaceResponse, side: int
) -> None:
    lobe = Microfacet(response, distribution, ax, ay)
    assert np.max(furnace(lobe, side=side)) <= FURNACE_LIMIT


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize(
    ("response", "side"),
    [
        (mirror(), 1),
        (dielectric(1.5), 1),
        (dielectric(1.5), -1),
        (dielectric(1.5, flipped=True), 1),
        (dielectric(1.5, flipped=True), -1),
    ],
)
def test_compensation_returns_the_light_between_facets(
    distribution: str, response: InterfaceResponse, side: int
) -> None:
    lobe = compensate(Microfacet(response, distribution, 0.3, 0.3))
    total = furnace(lobe, side=side)
    assert np.min(total) > 0.98  # the bar at alpha 0.3
    assert np.max(total) <= FURNACE_LIMIT


@pytest.mark.full
@pytest.mark.parametrize(
    ("distribution", "ax", "ay", "response", "side"),
    [
        ("beckmann", 0.02, 1.0, dielectric(1.5), -1),
        ("blinn", 0.02, 1.0, dielectric(1.5), 1),
        ("ggx", 0.1, 0.5, dielectric(1.5), -1),
        ("ashikhmin-shirley", 0.1, 0.5, dielectric(1.5), -1),
        ("ggx", 1.0, 1.0, mirror(), 1),
        ("ggx", 1.0, 1.0, dielectric(1.5), -1),
        ("beckmann", 1.0, 1.0, dielectric(2.4), -1),
    ],
)
def test_compensation_at_extremes(
    distribution: str, ax: float, ay: float, response: InterfaceResponse, side: int
) -> None:
    lobe = compensate(Microfacet(response, distribution, ax, ay))
    for azimuth in (0.0, 0.7):
        total = furnace(lobe, azimuth, side, nodes=128)
        assert np.min(total) > 0.98
        assert np.max(total) <= FURNACE_LIMIT


def test_compensation_absorbs_where_facets_do() -> None:
    # a bounce more is an absorption more: gold-like facets must gain colour, not white light
    lobe = Microfacet(metal(0.2 + 3.0j), "ggx", 0.5, 0.5)
    gained = furnace(compensate(lobe)) - furnace(lobe)
    lost = 1.0 - furnace(Microfacet(mirror(), "ggx", 0.5, 0.5))
    assert np.all(gained > 0.5 * lost)
    assert np.all(gained < lost)


def test_compensation_refuses_what_it_cannot_tabulate() -> None:
    varying = Microfacet(mirror(), "ggx", 1.0, 1.0, alpha_texture=Texture(0.1, 0.3, parse_formula("0.1 + 0.2*u")))
    with pytest.raises(UnsupportedError, match="roughness texture"):
        compensate(varying)


def test_transmitted_light_follows_snell_on_average() -> None:
    lobe = Microfacet(dielectric(1.5), "beckmann", 0.02, 0.02)
    wi = direction(np.radians(40.0))
    thetas = np.radians(np.linspace(20, 32, 601))
    wo = direction(np.pi - thetas, np.pi)
    peak = thetas[np.argmax(lobe.evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 0])]
    assert np.degrees(peak) == pytest.approx(np.degrees(np.arcsin(np.sin(np.radians(40.0)) / 1.5)), abs=0.1)


def test_the_facets_own_quadrature_agrees_with_a_plain_one() -> None:
    lobe = compensate(Microfacet(dielectric(1.5), "ggx", 0.5, 0.7))
    wi = direction(0.8, 0.3)
    narrow = lobe.hemispherical(wi, nodes=96)
    plain = product_rule(lambda wo: lobe.evaluate(np.broadcast_to(wi, wo.shape), wo), wi, 200, True)
    np.testing.assert_allclose(narrow[0], plain[0], rtol=2e-3)
    np.testing.assert_allclose(narrow[1], plain[1], rtol=2e-3)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_a_rough_free_film_keeps_its_energy(distribution: str) -> None:
    cos = np.linspace(0.0, 1.0, 129)
    r = np.where(cos[:, None] > 0, 0.2, 1.0) * np.ones(3)
    free = InterfaceResponse(dielectric(1.5).wavelengths_nm, cos, r, 1 - r, r, np.zeros((0, 3)), 1.0, True)
    passed = facet_transmittance(free, distribution, 0.3, 0.5)
    shut = dataclasses.replace(free, transmits=False, transmittance=0 * r)
    zero = np.zeros_like(passed)
    straight = Specular(
        dataclasses.replace(
            free, cos_outside=np.linspace(0, 1, 33), reflectance=zero, reflectance_inside=zero, transmittance=passed
        )
    )
    bsdf = Bsdf((Microfacet(shut, distribution, 0.3, 0.5), straight))
    for side in (1, -1):
        wi = direction(ANGLES, 1.2)
        wi[:, 2] *= side
        reflected, through = directional_hemispherical(bsdf, wi)
        assert np.max(reflected + through) <= FURNACE_LIMIT
        assert np.all(through[0] == pytest.approx(0.8, abs=0.02))


def test_values_are_finite_and_positive_at_awkward_directions() -> None:
    awkward = np.array(
        [
            [0, 0, 1],
            [0, 0, -1],
            [1, 0, 0],
            [-1, 0, 0],
            [0, 1, 0],
            [1, 0, 1e-12],
            [1, 0, -1e-12],
            [0.6, 0, 0.8],
            [-0.6, 0, -0.8],
        ],
        dtype=float,
    )
    wi, wo = awkward[:, None, :], awkward[None, :, :]
    for distribution in DISTRIBUTIONS:
        for response in INTERFACES.values():
            for width in (0.001, 0.3, 1.0):
                values = Microfacet(response, distribution, width, width).evaluate(wi, wo)
                assert np.all(np.isfinite(values)) and np.all(values >= 0)


def test_rotation_and_roughness_follow_their_textures() -> None:
    base = Microfacet(mirror(), "ggx", 0.1, 0.4)
    turned = dataclasses.replace(base, rotation=Texture(0.0, np.pi / 2, parse_formula("u*pi/2")))
    wi, wo = random_directions(50, 3, False), random_directions(50, 4, False)
    swapped = Microfacet(mirror(), "ggx", 0.4, 0.1)
    np.testing.assert_allclose(turned.evaluate(wi, wo, np.array([1.0, 0.3])), swapped.evaluate(wi, wo), rtol=1e-9)
    np.testing.assert_allclose(turned.evaluate(wi, wo, np.array([0.0, 0.3])), base.evaluate(wi, wo), rtol=1e-9)
    scaled = Microfacet(mirror(), "ggx", 1.0, 1.0, alpha_texture=Texture(0.1, 0.9, parse_formula("v")))
    fixed = Microfacet(mirror(), "ggx", 0.25, 0.25)
    np.testing.assert_allclose(scaled.evaluate(wi, wo, np.array([0.7, 0.25])), fixed.evaluate(wi, wo), rtol=1e-9)


def test_smith_masking_of_beckmann_is_within_its_fit() -> None:
    from math import erf

    for cot in (0.2, 0.5, 1.0, 2.0):
        alpha = 0.5
        theta = np.arctan(1.0 / (alpha * cot))
        exact = 2.0 / (1 + erf(cot) + np.exp(-cot * cot) / (cot * np.sqrt(np.pi)))
        got = smith_masking("beckmann", direction(theta), alpha, alpha)
        assert got == pytest.approx(exact, rel=3.6e-3)
