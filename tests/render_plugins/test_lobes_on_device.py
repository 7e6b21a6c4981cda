"""Every lobe on the device, asked the same questions: does it sample what it claims, and what the arrays say?

A new lobe joins with one line in `CASES`: a name, a function that makes a Bsdf, and how to look at it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.compensation import compensate
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import AlignedMicrofacet, Diffuse, Microfacet, Specular
from nacre.bsdf.lobes.ridge import Ridge, RidgeTable
from nacre.bsdf.lobes.table import TableLobe, directions_of
from nacre.bsdf.registry import GROUP, LOBES, outside_lobe
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.tabulate import StackTables
from nacre.bsdf.texture import ParameterAxis, Texture, parse_formula
from nacre.core.lazy import entry_points

pytestmark = pytest.mark.render

ARRAY_TOLERANCE = 1e-4  # the bar, of the maximum; single precision reaches 1e-5
RECIPROCITY_TOLERANCE = 1e-4  # single precision at both ends
WEIGHT_TOLERANCE = 2e-3  # of 99.9 % of the draws; narrow combs round at the per-mille level
CHI_SQUARE_LEVEL = 0.01  # the bar, after Sidak
CHI_SQUARE_DOUBT = 0.5  # of a count's standard deviation: what the integral of a cell may be unsure of
EDGE_DOUBT = 2.0  # where the density ends within the hemisphere: a few cells add at most 4 to a chi-squared of 270
FURNACE_TOP = 1.002  # the bar
GRID = np.arange(360.0, 831.0, 10.0)


def stack(n: tuple[complex, ...], d: tuple[float, ...], transmits: bool) -> InterfaceResponse:
    """Tabulate a stack of constant indices, ambient first."""
    media = np.repeat(np.array(n, dtype=complex)[:, None], len(GRID), axis=1)
    return StackTables(media, [False] * len(d), GRID, transmits).build(np.array(d), 129)


def drained(transmits: bool) -> InterfaceResponse:
    """Tabulate a film whose thickness a texture drives."""
    values = np.linspace(100.0, 500.0, 9)
    axis = ParameterAxis("layers[0].thickness_nm", values, Texture(100.0, 500.0, parse_formula("100 + 400*v^2 + 30*u")))
    n = np.repeat(np.array([1.0, 1.33, 1.0 if transmits else 1.6 + 3j])[:, None], len(GRID), axis=1)
    return StackTables(n, [False], GRID, transmits).build(values[:, None], 65, (axis,))


METAL = (1.0, 1.5, 1.2 + 7.0j), (250.0,)
GLASS = (1.0, 2.0, 1.5), (400.0,)
ROTATION = Texture(-7.0, 7.0, parse_formula("0.7 + u"))
PATCHES = Texture(0.5, 2.0, image=np.random.default_rng(5).uniform(0.0, 1.0, (5, 4)))


def bare_base(albedo: np.ndarray) -> Lobe:
    return Diffuse(GRID, albedo, np.ones((1, len(GRID))))


def metal(distribution: str, x: float, y: float | None = None, **more: Any) -> Lobe:
    """Return a rough coated metal."""
    return Microfacet(stack(*METAL, False), distribution, x, x if y is None else y, **more)


def glass(distribution: str, x: float, y: float | None = None, **more: Any) -> Lobe:
    """Return a rough coated glass."""
    return Microfacet(stack(*GLASS, True), distribution, x, x if y is None else y, **more)


def aligned(transmits: bool, **more: Any) -> Lobe:
    """Return a rough coated metal or glass whose R swings by 30 % over the azimuth, with a period of half a turn."""
    response = stack(*GLASS, True) if transmits else stack(*METAL, False)
    swing = 1.0 + 0.3 * np.cos(2.0 * np.linspace(0.0, 2.0 * np.pi, 17) + 0.4)[:, None, None]
    cos = response.cos_outside[:, None]
    share = np.minimum((1.0 - cos) / 0.4, 1.0)  # along the normal there is no azimuth
    reflectance = response.reflectance * np.where(response.reflectance < 0.7, 1.0 + (swing - 1.0) * share, 1.0)
    tables = {"reflectance": reflectance, "total": np.repeat(response.total[None], 17, axis=0)}
    tables["transmittance"] = 1.0 - reflectance if transmits else np.zeros_like(reflectance)
    tables["reflectance_inside"] = reflectance if transmits else np.zeros_like(reflectance)
    return AlignedMicrofacet(dataclasses.replace(response, **tables), "ggx", 0.3, 0.3, **more)


def ridge(deviation_nm: float, **more: Any) -> Lobe:
    """Return a Morpho-like ridge lobe; its norm is a bound of the diffraction integral, not the sharpest one."""
    return Ridge(stack(*METAL, False), 700.0, 300.0, deviation_nm, 4, 0.15, 0.8, np.full(len(GRID), 1.6), **more)


def ridge_table(**more: Any) -> Lobe:
    """Return a fan of ridges about the mirror direction and a second, weaker one."""
    c = np.linspace(0.0, 1.0, 13)[:, None, None]
    s = np.linspace(-1.0, 1.0, 41)
    a, b = s[:, None], s[None, :]
    power = (1.0 - 0.2 * c) * (0.6 * np.exp(-((a + b) ** 2) / 0.2) + 0.2 * np.exp(-((a - b) ** 2) / 0.05))
    slope = np.linspace(1.0, 0.6, len(GRID))
    power = power * np.sqrt((1.0 - a**2) * (1.0 - b**2))  # no light leaves along the surface
    table = (power[..., None] * slope).astype(np.float32)
    return RidgeTable(GRID, 0.5 * (table + np.swapaxes(table, 1, 2)), 0.12, 0.8, **more)


def under_film() -> Lobe:
    """Return a diffuse base seen through a film."""
    response = stack(*GLASS, True)
    return Diffuse(GRID, np.linspace(0.1, 0.4, len(GRID)), response.transmittance)


def table(coordinates: str) -> Lobe:
    """Return a measured-like reflection, glossy and broad, in three channels or one a wavelength."""
    wi, wo = directions_of(coordinates, (24, 24, 25))
    flat = np.sum((wi + wo)[..., :2] ** 2, axis=-1)
    values = 0.3 * np.exp(-flat / 0.15) / (np.maximum(wi[..., 2], 0) + np.maximum(wo[..., 2], 0) + 0.3) + 0.05
    basis = (
        np.eye(len(GRID)) if coordinates == "direction" else np.random.default_rng(2).uniform(0, 0.6, (3, len(GRID)))
    )
    slope = np.linspace(0.5, 1.0, len(basis))
    return TableLobe(GRID, values[..., None] * slope, basis, coordinates)


def matt_table() -> Lobe:
    """Return light that leaves nearly as from a matt surface, a little less to the side."""
    wi, wo = directions_of("direction", (12, 12, 9))
    values = 0.2 + 0.05 * wi[..., 2] * wo[..., 2]
    return TableLobe(GRID, values[..., None] * np.linspace(0.5, 1.0, len(GRID)), np.eye(len(GRID)))


def measured_table() -> Lobe:
    """Return a reciprocal table with its own nodes and different values on both sides of the plane of incidence."""
    a, c = np.array([0.0, 10.0, 35.0, 50.0, 80.0]) / 90.0, np.linspace(0.0, 1.0, 13)
    values = 0.1 + 0.1 * np.exp(-((a[:, None] - a) ** 2) / 0.02)[..., None] * (
        1 + 0.8 * (a[:, None, None] - a[:, None]) * np.sin(2 * np.pi * c)
    )
    return TableLobe(GRID, values[..., None], np.ones((1, len(GRID))), "direction", a, a, c, True)


def brushed_table() -> Lobe:
    """Return a table of an anisotropic sample; it is not reciprocal."""
    a, turn = np.array([0.0, 10.0, 35.0, 50.0, 80.0]) / 90.0, np.linspace(-0.05, 1.05, 12)
    c = np.linspace(0.0, 1.0, 13)
    values = 0.1 + 0.1 * np.exp(-((a[:, None] - a) ** 2) / 0.02)[..., None] * (1 + 0.5 * np.sin(2 * np.pi * c))
    values = values * (1 + 0.6 * np.cos(4 * np.pi * turn))[:, None, None, None]
    return TableLobe(GRID, values[..., None], np.ones((1, len(GRID))), "direction", a, a, c, True, turn)


def mirror_table() -> Lobe:
    """Return a table about the mirror direction, as of a Zemax file without symmetry; it is not reciprocal."""
    a, b = np.array([0.0, 15.0, 40.0, 75.0]) / 90.0, np.array([0.0, 5.0, 10.0, 20.0, 35.0, 60.0, 90.0, 180.0]) / 180.0
    c = np.linspace(0.0, 1.0, 13)
    turn = 1 + 0.3 * np.sin(2 * np.pi * c) * np.minimum(4 * b, 1.0)[:, None]
    values = (0.05 + 0.4 * np.exp(-(b**2) / 0.02))[:, None] * turn * (1 - 0.3 * a[:, None, None])
    return TableLobe(GRID, values[..., None], np.ones((1, len(GRID))), "specular", a, b, c, True)


@dataclasses.dataclass(frozen=True)
class Case:
    """How to look at a lobe.

    Attributes:
        make: builds the lobes.
        views_deg: (theta, phi) of the eye for the chi-square tests; none for a pure delta.
        eta: index below over index above.
        chi: resolution and integration steps of the chi-square test.
        is_continuous: False: delta only.
        width: slopes of the facets about which half of the light directions are drawn.
        conserves: False: a sum of parts that know nothing of each other may give back more than comes in.
        has_edge: the density ends within the hemisphere, which quadrature resolves slowly.
    """

    make: Callable[[], tuple[Lobe, ...]]
    views_deg: tuple[tuple[float, float], ...] = ((25.0, 40.0), (70.0, 200.0))
    eta: float = 1.0
    chi: tuple[int, int] = (100, 16)
    is_continuous: bool = True
    width: float = 0.3
    conserves: bool = True
    has_edge: bool = False


BOTH = ((25.0, 40.0), (72.0, 200.0), (160.0, 10.0), (118.0, 100.0))
CASES: dict[str, Case] = {
    "mirror": Case(lambda: (Specular(stack(*METAL, False)),), (), is_continuous=False),
    "coated glass": Case(lambda: (Specular(stack(*GLASS, True)),), (), 1.5, is_continuous=False),
    "soap film": Case(lambda: (Specular(stack((1.0, 1.33, 1.0), (300.0,), True)),), (), is_continuous=False),
    "drained film": Case(lambda: (Specular(drained(True)),), (), is_continuous=False),
    "ggx metal": Case(lambda: (metal("ggx", 0.3),)),
    "narrow ggx metal": Case(lambda: (metal("ggx", 0.05),), ((40.0, 10.0),), chi=(160, 32), width=0.05),
    "anisotropic ggx metal": Case(lambda: (metal("ggx", 0.15, 0.5, rotation=ROTATION),)),
    "beckmann metal": Case(lambda: (metal("beckmann", 0.25),)),
    "anisotropic beckmann metal": Case(lambda: (metal("beckmann", 0.5, 0.2),)),
    "blinn metal": Case(lambda: (metal("blinn", 0.3),)),
    "anisotropic blinn metal": Case(lambda: (metal("blinn", 0.2, 0.4, rotation=ROTATION),)),
    "ashikhmin-shirley metal": Case(lambda: (metal("ashikhmin-shirley", 0.3),)),
    "anisotropic ashikhmin-shirley metal": Case(lambda: (metal("ashikhmin-shirley", 0.4, 0.2),)),
    "compensated metal": Case(lambda: (compensate(metal("ggx", 0.5)),), width=0.6),
    "compensated anisotropic metal": Case(lambda: (compensate(metal("beckmann", 0.2, 0.6)),), width=0.6),
    "patchy metal": Case(lambda: (metal("ggx", 0.2, alpha_texture=PATCHES),)),
    "drained metal": Case(lambda: (Microfacet(drained(False), "ggx", 0.3, 0.3),)),
    "ggx glass": Case(lambda: (glass("ggx", 0.25),), BOTH, 1.5),
    "anisotropic ggx glass": Case(lambda: (glass("ggx", 0.4, 0.15, rotation=ROTATION),), BOTH[:2], 1.5),
    "beckmann glass": Case(lambda: (glass("beckmann", 0.3),), BOTH, 1.5),
    "blinn glass": Case(lambda: (glass("blinn", 0.3),), BOTH[1:3], 1.5),
    "ashikhmin-shirley glass": Case(lambda: (glass("ashikhmin-shirley", 0.3),), BOTH[::2], 1.5),
    "compensated glass": Case(lambda: (compensate(glass("ggx", 0.5)),), BOTH[::3], 1.5, width=0.6),
    "rough silvered glass": Case(  # absorbs, so that T is not 1 - R
        lambda: (Microfacet(stack((1.0, 0.1 + 3.0j, 1.5), (20.0,), True), "ggx", 0.3, 0.3),), BOTH, 1.5
    ),
    "silvered glass": Case(
        lambda: (Specular(stack((1.0, 0.1 + 3.0j, 1.5), (20.0,), True)),), (), 1.5, is_continuous=False
    ),
    "bubble in water": Case(  # the ambient is the denser side
        lambda: (Microfacet(stack((1.33, 1.4, 1.0), (200.0,), True), "ggx", 0.25, 0.25),), BOTH, 1.0 / 1.33
    ),
    "rough free film": Case(
        lambda: (Microfacet(stack((1.0, 1.4, 1.0), (300.0,), True), "ggx", 0.3, 0.3),), BOTH[:3], 1.0
    ),
    "rough anisotropic metal": Case(lambda: (aligned(False),)),
    "rough anisotropic glass": Case(lambda: (aligned(True, rotation=ROTATION),), BOTH[::2], 1.5),
    "diffuse": Case(lambda: (bare_base(np.linspace(0.2, 0.9, len(GRID))),)),
    "diffuse under a film": Case(lambda: (under_film(),)),
    "irregular ridges": Case(lambda: (ridge(120.0),), width=0.4),
    "level ridges": Case(lambda: (ridge(0.0, rotation=ROTATION),), ((10.0, 0.0),), chi=(100, 32), width=0.4),
    "ridges of a table": Case(lambda: (ridge_table(),), chi=(100, 32), width=0.4, has_edge=True),
    "turned ridges of a table": Case(
        lambda: (ridge_table(rotation=ROTATION),), ((10.0, 0.0),), chi=(100, 32), width=0.4, has_edge=True
    ),
    "table": Case(lambda: (table("direction"),), width=0.5),
    "matt table": Case(lambda: (matt_table(),), width=0.5),
    "half-angle table": Case(lambda: (table("half"),), width=0.5),
    "measured table": Case(lambda: (measured_table(),), width=0.5),
    "rough film over a base": Case(lambda: (metal("ggx", 0.2), bare_base(np.full(len(GRID), 0.3))), conserves=False),
    "film over a base": Case(lambda: (Specular(stack(*GLASS, False)), under_film()), ((30.0, 0.0),)),
}
# lobes of other packages bring a sample of their own
OUTSIDE = {kind: outside_lobe(kind) for kind in entry_points(GROUP, LOBES)}
CASES |= {kind: Case(lambda entry=entry: (entry.sample(),)) for kind, entry in OUTSIDE.items()}
CONTINUOUS = [name for name, case in CASES.items() if case.is_continuous]
CHI_SQUARES = [(name, view) for name in CONTINUOUS for view in CASES[name].views_deg]


@cache
def bsdf_of(name: str) -> Bsdf:
    """Build a case's Bsdf once."""
    return Bsdf(CASES[name].make())


def pairs(name: str, n: int, seed: int) -> tuple[Any, Any, Any]:
    """Return light, eye and uv: half of the pairs anywhere, half near the mirror or refracted image."""
    from lobe_trials import directions, near_mirror

    case = CASES[name]
    both = bsdf_of(name).transmits or case.eta != 1.0
    eye = directions(n, seed, both)
    eta = case.eta if case.eta > 1 else 1.0
    near = near_mirror(eye[n // 2 :], seed + 1, case.width, eta)
    light = np.concatenate([directions(n // 2, seed + 2, both), near])
    return light, eye, np.random.default_rng(seed).uniform(-0.4, 1.4, (n, 2))


@pytest.mark.parametrize("name", CONTINUOUS)
def test_plugin_gives_the_values_of_the_arrays(mi: Any, name: str) -> None:
    """Eye and light in their places, textures and all."""
    from lobe_trials import array_mismatch

    light, eye, uv = pairs(name, 2000, 11)
    assert array_mismatch(bsdf_of(name), light, eye, uv, every=12) <= ARRAY_TOLERANCE


@pytest.mark.parametrize("make", [mirror_table, brushed_table])
def test_plugin_of_a_table_that_is_not_reciprocal_gives_its_values_and_samples_them(
    mi: Any, make: Callable[[], Lobe]
) -> None:
    from lobe_trials import array_mismatch, chi_square

    bsdf = Bsdf((make(),))
    light, eye, uv = pairs("measured table", 2000, 11)
    assert array_mismatch(bsdf, light, eye, uv, every=12) <= ARRAY_TOLERANCE
    assert chi_square(bsdf, 40.0, 100.0, resolution=100, steps=16, uv=(0.3, 0.6)).passes(CHI_SQUARE_LEVEL, 1)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_plugin_gives_the_same_physics_traced_from_the_light(mi: Any, name: str) -> None:
    """f(light, eye) does not depend on which end a ray starts from."""
    from lobe_trials import plugin_values

    light, eye, uv = pairs(name, 1000, 12)
    seen = plugin_values(bsdf_of(name), light, eye, np.array([480.0]), uv, radiance=True)
    sent = plugin_values(bsdf_of(name), light, eye, np.array([480.0]), uv, radiance=False)
    assert np.max(np.abs(seen - sent)) <= ARRAY_TOLERANCE * np.max(seen)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_plugin_is_reciprocal(mi: Any, name: str) -> None:
    """f(a, b)/n_b^2 = f(b, a)/n_a^2."""
    from lobe_trials import reciprocity_mismatch

    light, eye, uv = pairs(name, 1000, 13)
    assert reciprocity_mismatch(bsdf_of(name), light, eye, CASES[name].eta, uv) <= RECIPROCITY_TOLERANCE


@pytest.mark.parametrize("name", CONTINUOUS)
def test_weight_times_density_is_the_value(mi: Any, name: str) -> None:
    """sample() and eval_pdf() agree on weight and density of what was drawn."""
    from lobe_trials import direction, draw, weight_mismatch

    for theta, phi in CASES[name].views_deg:
        draws = draw(bsdf_of(name), direction(theta, phi), 20_000, seed=3)
        assert weight_mismatch(draws) <= WEIGHT_TOLERANCE
        drawn = (draws.pdf > 0) & ~draws.is_delta
        assert drawn.mean() > 0.05
        ratio = draws.density[drawn] / draws.pdf[drawn]
        # in a sum with a delta both hold the lobe's own density times the share of samples
        assert np.quantile(np.abs(ratio - 1.0), 0.999) <= WEIGHT_TOLERANCE


@pytest.mark.parametrize(("name", "view"), CHI_SQUARES)
def test_draws_follow_the_density(mi: Any, name: str, view: tuple[float, float]) -> None:
    """Chi-square, one million draws."""
    from lobe_trials import chi_square

    resolution, steps = CASES[name].chi
    outcome = chi_square(bsdf_of(name), *view, resolution=resolution, steps=steps, uv=(0.3, 0.6))
    assert outcome.passes(CHI_SQUARE_LEVEL, len(CHI_SQUARES)), outcome.messages


@pytest.mark.parametrize("theta_deg", [5.0, 85.0])
def test_draws_of_a_narrow_metal_follow_the_density_to_grazing_light(mi: Any, theta_deg: float) -> None:
    from adaptive_chi_square import lobe_chi_square

    outcome = lobe_chi_square(bsdf_of("narrow ggx metal"), theta_deg, 10.0, samples=200_000, uv=(0.3, 0.6))
    assert outcome.passes(CHI_SQUARE_LEVEL, 2) and outcome.doubt < CHI_SQUARE_DOUBT, outcome


STEEP_TO_GRAZING_DEG = (2.0, 75.0, 87.0)


@pytest.mark.full
@pytest.mark.parametrize("name", CONTINUOUS)
def test_draws_follow_the_density_from_the_normal_to_87_degrees(mi: Any, name: str) -> None:
    """At 87 degrees Beckmann fails if its density has the fit of the masking that its values have."""
    from adaptive_chi_square import lobe_chi_square

    trials = len(CONTINUOUS) * len(STEEP_TO_GRAZING_DEG)
    doubt = EDGE_DOUBT if CASES[name].has_edge else CHI_SQUARE_DOUBT
    for theta in STEEP_TO_GRAZING_DEG:
        outcome = lobe_chi_square(bsdf_of(name), theta, 40.0, samples=400_000, uv=(0.3, 0.6))
        assert outcome.passes(CHI_SQUARE_LEVEL, trials) and outcome.doubt < doubt, (theta, outcome)


def test_only_a_matt_table_is_drawn_by_the_cosine(mi: Any) -> None:
    """A table of exits costs as much as the look-up; where the weights hardly vary without one there is none."""
    from nacre.device.lobes.table import TablePlugin

    lobes = {name: bsdf_of(name).lobes[0] for name in ("matt table", "table")}
    broad = {name: TablePlugin(lobe).is_broad for name, lobe in lobes.items()}
    assert broad == {"matt table": True, "table": False}


def test_chi_square_is_asked_of_at_least_twenty_cases() -> None:
    """The issue's count."""
    assert len(CHI_SQUARES) >= 20


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.conserves])
def test_no_lobe_creates_light(mi: Any, name: str) -> None:
    """A white furnace gives back at most 1.002, seen from both sides, steep and grazing."""
    from lobe_trials import furnace

    behind = bsdf_of(name).transmits or name == "rough free film"
    for theta in (0.5, 45.0, 80.0, *((100.0, 135.0, 179.5) if behind else ())):
        mean, error = furnace(bsdf_of(name), theta, 100_000)
        assert np.all(mean - 3.0 * error <= FURNACE_TOP), (theta, mean, error)
