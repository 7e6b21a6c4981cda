"""The material from its recipe: lobes, energy, file, spectrum, figures; bad input in one line."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from read_back import read_layout, read_points_csv

from nacre.bsdf import Bsdf
from nacre.core.errors import MaterialRangeError, NacreError, RecipeError
from nacre.families.metasurface.material import Metasurface, MetasurfaceWarning
from nacre.families.metasurface.species import GAPS_NM
from nacre.families.metasurface.tmatrix.particle_on_stack import MultipoleConvergenceError
from nacre.formats.layouts import write_layout, write_points_csv
from nacre.material.material import load, material

EXAMPLES = Path(__file__).parents[2] / "examples" / "metasurface"

WAVELENGTHS = np.array([450.0, 550.0, 650.0])
EDGE_OF_ENERGY = 1.002


def recipe(substrate="glass", layers=(), monolayer=None, model=None, **particle):
    data = {
        "family": "metasurface",
        "substrate": substrate,
        "layers": list(layers),
        "particle": {"material": {"n": 3.5, "k": 0.01}, "radius_nm": 70, **particle},
        "monolayer": monolayer or {"coverage": 0.1, "packing": 0.3},
    }
    # in seconds: "auto" takes the ensemble of such spheres
    return {**data, "model": {"correction": "qca-balanced", **(model or {})}}


def vectors(n, seed, both):
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(n, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return v if both else v * np.sign(v[:, 2:])


@pytest.fixture(scope="module")
def on_glass():
    return material(recipe()).bsdf(WAVELENGTHS)


def test_final_bsdf_is_reciprocal_and_never_negative(on_glass):
    a, b = vectors(3000, 0, True), vectors(3000, 1, True)
    eta = 1.5
    n2 = lambda w: np.where(w[:, 2] < 0, eta**2, 1.0)[:, None]
    there, back = on_glass.evaluate(a, b) / n2(b), on_glass.evaluate(b, a) / n2(a)
    assert np.abs(there - back).max() <= 1e-10 * there.max()
    assert there.min() >= 0 and np.all(np.isfinite(there))


@pytest.mark.parametrize("below", [False, True])
def test_stored_bsdf_gives_back_no_more_than_it_gets(on_glass, below):
    for theta in (0.05, 0.6, 1.0, 1.4):
        wi = np.array([np.sin(theta), 0.0, -np.cos(theta) if below else np.cos(theta)])
        here, there = on_glass.lobes[1].hemispherical(wi)
        delta = on_glass.specular(np.pi - theta if below else theta)
        total = here + there + delta.reflectance + delta.transmittance
        assert np.all(total <= EDGE_OF_ENERGY) and np.all(total > 0.9)  # a percent or so is absorbed


def test_bsdf_agrees_with_the_spectrum(on_glass):
    theta = np.array([0.2, 0.9])
    found = material(recipe()).spectrum(theta, WAVELENGTHS)
    for i, t in enumerate(theta):
        here, there = on_glass.lobes[1].hemispherical(np.array([np.sin(t), 0.0, np.cos(t)]))
        assert np.abs(here - found.diffuse_reflectance[i]).max() < 6e-3
        assert np.abs(there - found.diffuse_transmittance[i]).max() < 6e-3
        delta = on_glass.specular(t)
        assert np.abs(delta.reflectance - found.specular_reflectance[i]).max() < 2e-3
        assert np.abs(delta.transmittance - found.specular_transmittance[i]).max() < 2e-3


def test_bsdf_survives_its_file(on_glass, tmp_path):
    on_glass.save(tmp_path / "m.nacre")
    again = Bsdf.load(tmp_path / "m.nacre")
    a, b = vectors(100, 0, True), vectors(100, 1, True)
    assert np.array_equal(again.evaluate(a, b), on_glass.evaluate(a, b))
    assert again.provenance["energy_excess"] == on_glass.provenance["energy_excess"]


def test_rings_of_the_structure_factor_stay_sharp(on_glass):
    """f / S is smooth: the ring is multiplied at the exact q, however coarse the angles are."""
    made = material(recipe()).model.structure
    theta = np.linspace(0.05, 1.2, 400)
    wi = np.array([0.0, 0.0, 1.0])
    wo = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    f = on_glass.evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 0]
    smooth = f / made.structure_factor(2 * np.pi / WAVELENGTHS[0] * np.sin(theta))
    coarse = np.interp(theta, theta[::25], smooth[::25])
    assert np.abs(coarse[:376] / smooth[:376] - 1).max() < 0.02


def test_polarisations_average_to_unpolarised_light():
    made = material(recipe("Si"))
    parts = [made.spectrum([0.7], [500.0], p).diffuse_reflectance for p in ("s", "p", "both")]
    assert abs((parts[0] + parts[1]) / 2 - parts[2]).max() < 1e-12


def test_opaque_substrate_reflects_only():
    made = material(recipe("Si", [{"material": "SiO2", "thickness_nm": 100}])).bsdf([500.0])
    assert not made.transmits
    assert np.all(made.evaluate(np.array([0, 0, 1.0]), np.array([0.6, 0, -0.8])) == 0)
    assert np.all(made.evaluate(np.array([0, 0, -1.0]), np.array([0.6, 0, -0.8])) == 0)


def test_shell_without_contrast_is_no_shell():
    plain = material(recipe("Si", deviation_nm=0.0)).spectrum([0.3], [500.0])
    shelled = material(
        recipe(
            "Si",
            monolayer={"coverage": 0.1, "packing": 0.3},
            radius_nm=50,
            shell={"material": {"n": 3.5, "k": 0.01}, "thickness_nm": 20},
        )
    ).spectrum([0.3], [500.0])
    assert np.abs(plain.diffuse_reflectance - shelled.diffuse_reflectance).max() < 1e-12


@pytest.mark.parametrize("name", ["p.gds", "p.oas"])
def test_a_pattern_without_a_period_is_laid_out_once(tmp_path, name):
    import gdstk

    xy = np.array([[0.0, 0.0], [1.5, 0.25], [-2.0, 3.0]])
    assert write_layout(tmp_path / name, xy, 0.09) == 3
    read = gdstk.read_gds if name.endswith("gds") else gdstk.read_oas
    (top,) = read(str(tmp_path / name)).top_level()
    np.testing.assert_allclose(sorted(r.origin for r in top.references), sorted(map(tuple, xy)), atol=1e-3)


def test_spread_radii_keep_both_tables():
    lobe = material(recipe(deviation_nm=7)).bsdf([500.0, 600.0]).lobes[1]
    lobe.check()
    assert lobe.above_free.max() > 0 and lobe.across_free.max() > 0


@pytest.mark.parametrize(
    ("structure", "least", "most"), [("rsa", 0.7, 1.4), ({"name": "lattice", "jitter": 0.08}, 0, 0.5)]
)
def test_measured_arrangements_scatter_by_their_order(structure, least, most):
    """At one coverage, disks laid at random send out what disks in equilibrium do, a lattice much less."""
    layer = {"coverage": 0.1, "packing": 0.3}
    made, disks = (material(recipe("Si", monolayer=m)) for m in (layer | {"structure": structure}, layer))
    density = 0.1 / (np.pi * made.model.outer_radius_nm**2)
    assert made.model.structure.density_per_nm2 == pytest.approx(density, rel=0.03)
    light, usual = (m.spectrum([0.3], [500.0]).diffuse_reflectance for m in (made, disks))
    assert np.all(least < light / usual) and np.all(light / usual < most) and np.all(light != usual)


def test_points_and_sq_files_make_materials(tmp_path):
    from nacre.families.metasurface.monolayer.arrangement import random_sequential

    pattern = random_sequential(3000, 6.5e-6, 0.3)
    write_points_csv(tmp_path / "xy.csv", pattern.xy_nm * 1e-3)
    data = recipe("Si", monolayer={"structure": {"points": "xy.csv"}})
    assert material(data, tmp_path).model.structure.density_per_nm2 == pytest.approx(6.5e-6, rel=0.03)
    q = np.linspace(0, 40, 200)
    np.savetxt(tmp_path / "s.csv", np.stack([q, 1 - 0.7 * np.exp(-((q / 8) ** 2))], axis=1), delimiter=",")
    data = recipe("Si", monolayer={"coverage": 0.1, "packing": 0.3, "structure": {"sq": "s.csv"}})
    made = material(data, tmp_path).model.structure
    assert abs(float(made.structure_factor(8e-3)) - (1 - 0.7 / np.e)) < 1e-3


def test_the_figure_of_one_particle_is_even_and_has_the_polarisations_of_a_dipole():
    """A small particle in the open: s is the same all round, p goes with cos^2 of the scattering angle."""
    small = recipe(radius_nm=8.0, substrate={"n": 1.0}, monolayer={"coverage": 0.001, "packing": 0.001})
    data = material(small).figure_data("scattering")
    s, p, angle = data["s"], data["p"], np.radians(data["theta_deg"])
    np.testing.assert_allclose(s, s[::-1], rtol=1e-9)
    np.testing.assert_allclose(p, p[::-1], rtol=1e-9, atol=1e-9 * p.max())
    np.testing.assert_allclose(s / s.max(), 1.0, rtol=0.05)
    np.testing.assert_allclose(p / s, np.cos(angle) ** 2, atol=0.02)


def test_the_figure_of_the_structure_is_the_structure_factor_of_the_layer():
    made = material(recipe())
    data = made.figure_data("structure")
    structure = made.model.structure
    np.testing.assert_allclose(data["sq"][0], structure.structure_factor(data["q"] / structure.diameter_nm))
    assert data["sq"][0, 0] < 0.5 and abs(data["sq"][0, -1] - 1) < 0.05  # disks keep apart, and forget at a distance


def test_the_colour_map_goes_from_a_tenth_of_the_density_to_what_fits(monkeypatch):
    # the densities alone are asked for: 21 mean fields a density would take a minute
    monkeypatch.setattr(Metasurface, "powers", lambda self, cosines, wavelength: (np.zeros((2, len(cosines))),) * 3)
    made = material(recipe("Si", radius_nm=70))
    low, *_, high = made.figure_data("colour-map", angles_deg=[0.0])["y"]
    own = 0.1 / (np.pi * 0.07**2)  # a coverage of a tenth, particles a um^2
    assert (low, high) == (pytest.approx(0.1 * own), pytest.approx(3 * own))


def test_colour_map_covers_density_and_angle():
    data = material(recipe("Si")).figure_data("colour-map", densities_per_um2=[2.0, 6.0], angles_deg=[0.0, 40.0])
    assert data["reflectance"].shape == (2, 2, len(data["wavelengths_nm"]))
    np.testing.assert_allclose(data["wavelengths_nm"], np.linspace(380.0, 780.0, 21))
    assert data["reflectance"][1].mean() > data["reflectance"][0].mean()


BAD = {
    "p below f": ({"monolayer": {"coverage": 0.3, "packing": 0.1}}, "monolayer.packing = 0.1 is below the coverage"),
    "p too high": ({"monolayer": {"coverage": 0.1, "packing": 0.75}}, "at most 0.7"),
    "f too high": ({"monolayer": {"density_per_um2": 60}}, "covers"),
    "no density": ({"monolayer": {"packing": 0.3}}, "coverage or density_per_um2"),
    "two densities": ({"monolayer": {"coverage": 0.1, "density_per_um2": 3}}, "coverage or density_per_um2"),
    "radius": ({"radius_nm": 0}, "radius_nm = 0"),
    "density": ({"monolayer": {"density_per_um2": -1}}, "density_per_um2 = -1"),
    "small negative density": (
        {"monolayer": {"density_per_um2": -0.5}},
        "monolayer.density_per_um2 = -0.5 is not allowed; it should be above 0",
    ),
    "no coverage": ({"monolayer": {"coverage": 0.0}}, "monolayer.coverage = 0"),
    "structure": ({"monolayer": {"coverage": 0.1, "structure": "hard-disc"}}, 'Did you mean "hard-disk"'),
    "correction": ({"model": {"correction": "qca"}}, "correction"),
    "typo": ({"radios_nm": 50}, "radios_nm"),
    "wide spread": ({"deviation_nm": 60}, "deviation_nm"),
    "lighter substrate": ({"substrate": {"n": 0.9}}, "less dense"),
    "missing points": ({"monolayer": {"structure": {"points": "no.csv"}}}, "no.csv"),
    # what would be ignored is refused
    **{
        f"points and {key}": ({"monolayer": {key: 0.3, "structure": {"points": "xy.csv"}}},
                              f'gives {key} and points = "xy.csv", which says it; leave {key} out')
        for key in ("coverage", "density_per_um2", "packing")
    },
    "jitter of no lattice": (
        {"monolayer": {"coverage": 0.1, "structure": {"name": "rsa", "jitter": 0.3}}},
        'monolayer.structure: gives jitter, which name = "rsa" does not have; it is of name = "lattice"',
    ),
    "lattice of points": (
        {"monolayer": {"structure": {"points": "xy.csv", "lattice": "square"}}},
        "monolayer.structure: gives lattice, which points does not have",
    ),
    "seed of S(q)": (
        {"monolayer": {"coverage": 0.1, "structure": {"sq": "s.csv", "seed": 4}}},
        "gives seed, which sq does not have; it is of arrangements that are drawn at random",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case, tmp_path):
    change, words = BAD[case]
    with pytest.raises(RecipeError) as caught:
        material(recipe(**change), tmp_path)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_overlapping_points_are_named(tmp_path):
    xy = np.random.default_rng(0).uniform(0, 10, (300, 2))
    write_points_csv(tmp_path / "xy.csv", xy)
    with pytest.raises(RecipeError, match="overlap"):
        material(recipe(monolayer={"structure": {"points": "xy.csv"}}), tmp_path)


def test_metal_touching_silicon_is_refused_with_the_remedy():
    data = recipe("Si")
    data["particle"] = {"material": "Ag", "radius_nm": 90}
    with pytest.raises(NacreError, match="native oxide") as caught:
        material(data).spectrum([0.0], [450.0])
    assert "\n" not in str(caught.value)
    data["particle"]["gap_nm"] = 2
    assert np.all(np.isfinite(material(data).spectrum([0.0], [450.0]).diffuse_reflectance))


@pytest.mark.parametrize(("substrate", "tolerance"), [("glass", 1e-3), ("Si", 4e-3)])
def test_the_gap_that_a_refusal_names_works_and_is_the_least_of_those_tried(substrate, tolerance):
    def order(gap_nm):
        particle = {"material": "Ag", "radius_nm": 75, "gap_nm": gap_nm}
        model = material({**recipe(substrate), "particle": particle, "model": {"tolerance": tolerance}}).model
        return model.order(model.surface(360.0))

    with pytest.raises(MultipoleConvergenceError, match="or a gap_nm of ") as raised:
        order(0.0)
    named = float(re.search(r"or a gap_nm of ([\d.]+)", str(raised.value))[1])
    assert order(named) <= 40
    smaller = [gap for gap in GAPS_NM if gap < named]
    for gap in smaller[-1:]:
        with pytest.raises(MultipoleConvergenceError):
            order(gap)
    assert (named >= 1.0) == (substrate == "Si")  # bare silicon: 1 to 2 nm, as the physics note found


SILVER_ON_GLASS = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 90},
    "monolayer": {"density_per_um2": 5, "packing": 0.5},
}


def test_an_unconverged_order_is_said_or_refused_in_the_ultraviolet_too(caplog):
    """Order 40 leaves 0.36 % at 360 nm: said where the recipe is silent, refused where it asks for more."""
    made = material(SILVER_ON_GLASS).bsdf([360.0, 500.0])
    assert 1e-3 < made.provenance["multipole_tolerance"] < 4e-3
    assert "at 360 nm the far field is converged to 0.0036 only" in caplog.text
    with pytest.raises(
        MultipoleConvergenceError, match="at 360 nm .*does not converge to 0.001.*model.tolerance = 0.004"
    ) as e:
        material({**SILVER_ON_GLASS, "model": {"tolerance": 1e-3}}).bsdf()
    assert "\n" not in str(e.value) and 1e-3 < e.value.change < 4e-3
    accepted = material({**SILVER_ON_GLASS, "model": {"tolerance": 4e-3}})
    assert accepted.model.order(accepted.model.surface(360.0)) == 40
    assert accepted.bsdf([360.0]).provenance["multipole_tolerance"] == 4e-3
    apart = material({**SILVER_ON_GLASS, "particle": {"material": "Ag", "radius_nm": 90, "gap_nm": 2}}).model
    assert apart.order(apart.surface(360.0)) <= 40


def test_a_series_without_a_limit_cannot_be_accepted():
    touching = {**SILVER_ON_GLASS, "substrate": "Si"}
    with pytest.raises(RecipeError, match="tolerance"):
        material({**touching, "model": {"tolerance": 0.5}})
    with pytest.raises(MultipoleConvergenceError) as e:
        material({**touching, "model": {"tolerance": 0.02}}).spectrum([0.0], [450.0])
    assert "accept" not in str(e.value)


def test_a_layer_of_almost_no_particles_is_refused():
    data = {**SILVER_ON_GLASS, "monolayer": {"density_per_um2": 1e-300, "packing": 0.5}}
    with pytest.raises(RecipeError, match=r"density_per_um2 = 1e-300 covers .* from 0.0001 to 0.7"):
        material(data)
    data["monolayer"]["density_per_um2"] = 0.01
    with pytest.raises(RecipeError, match=r"packing = 0.5 keeps particles 7.98 um apart .* at most 0.126"):
        material(data)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda p: p.stem)
def test_the_examples_converge_over_the_whole_default_range(path):
    made = load(path).model
    if not hasattr(made, "order"):
        return
    if made.all_species[0].is_sphere:
        assert all(made.order(made.surface(w)) <= 40 for w in made.wavelengths_nm[::4])
    else:  # others are refused where they do not converge
        layer, _ = made.layers_at(made.wavelengths_nm)
        assert all(layer(float(w)).particles for w in made.wavelengths_nm[[0, -1]])


def test_a_wavelength_outside_a_materials_range_is_named():
    data = {**SILVER_ON_GLASS, "particle": {"material": "Si", "radius_nm": 60}}
    with pytest.raises(MaterialRangeError) as e:
        material(data).spectrum([0.0], [150.0])
    assert "\n" not in str(e.value) and "150" in str(e.value)


@pytest.mark.parametrize("deviation_nm", [0.0, 7.0])
def test_packing_goes_over_into_the_coverage(deviation_nm):
    """p -> f: particles kept apart by no more than their own diameter, of equal or of spread sizes."""
    alone, near = (
        material(recipe("Si", monolayer={"coverage": 0.1, **more}, deviation_nm=deviation_nm)).spectrum([0.4], [500.0])
        for more in ({}, {"packing": 0.1 * (1 + 1e-7)})
    )
    assert np.abs(alone.diffuse_reflectance - near.diffuse_reflectance).max() < 1e-6 * alone.diffuse_reflectance.max()
    apart = material(recipe("Si", monolayer={"coverage": 0.1, "packing": 0.4}, deviation_nm=deviation_nm))
    assert apart.spectrum([0.4], [500.0]).diffuse_reflectance < 0.9 * alone.diffuse_reflectance


def test_energy_beyond_one_is_scaled_away_symmetrically():
    """A monolayer that would send back 1.4 times what it gets: the factors leave no direction above 1."""
    from nacre.families.metasurface.monolayer.diffuse import DiffuseTerm
    from nacre.families.metasurface.monolayer.evaluation import _energy_scale

    layer = material(recipe("Si")).model.monolayer(500.0)
    mu, weights = np.polynomial.legendre.leggauss(12)
    mu, weights = (mu + 1) / 2, weights / 2
    pairs = mu[:, None] * mu * (1.0 + 0.3 * np.cos(3 * mu[:, None]) * np.cos(3 * mu))
    pairs *= 1.4 / np.max(weights @ pairs / mu)
    none = np.zeros(0)
    term = DiffuseTerm(none, none, none, none, pairs)
    specular = np.full(12, 0.2)
    c, excess = _energy_scale(term, [(layer.illuminate(mu), weights)], specular, 1.0)
    assert excess == pytest.approx(0.6)
    assert np.max(c * ((weights * c) @ pairs) / mu + specular) <= 1 + 1e-8 and c.min() > 0.3


def test_coverage_beyond_the_tested_warns():
    with pytest.warns(MetasurfaceWarning, match="coverage"):
        plain = {"correction": "qca-balanced"}
        material(recipe("Si", monolayer={"coverage": 0.3}, model=plain)).spectrum([0.0], [500.0])


@pytest.mark.parametrize("ending", ["gds", "oas"])
def test_layout_keeps_every_particle_and_repeats_by_reference(tmp_path, ending):
    xy = np.random.default_rng(1).uniform(0, 20, (500, 2))
    path = tmp_path / f"pattern.{ending}"
    assert write_layout(path, xy, 0.09, box_um=20.0, periods=(500, 500)) == 500 * 500**2
    back, radius = read_layout(path)
    order = lambda p: p[np.lexsort(np.round(p, 3).T)]
    assert np.abs(order(back) - order(np.round(xy, 3))).max() < 1e-3 and abs(radius - 0.09) < 1.5e-3
    assert path.stat().st_size < 100_000  # 1.25e8 particles in the size of one period
    assert dataclasses.is_dataclass(material(recipe()).model)


def test_points_csv_comes_back(tmp_path):
    xy = np.random.default_rng(1).uniform(0, 20, (50, 2))
    write_points_csv(tmp_path / "p.csv", xy)
    assert np.abs(read_points_csv(tmp_path / "p.csv") - xy).max() < 1e-4


@pytest.mark.parametrize("eta", [None, 1.0, 1.5, 2.4])
@pytest.mark.parametrize("polydisperse", [False, True])
@pytest.mark.parametrize(("thick", "low"), [(False, False), (True, False), (False, True)])
def test_tables_of_every_stack_stay_under_100_megabytes(eta, polydisperse, thick, low):
    from nacre.families.metasurface.monolayer.evaluation import HARMONICS, choose_grids

    grids = choose_grids(eta, polydisperse, thick, low)
    n, m = grids.above.size, grids.below.size if grids.below else 0
    rows = n * (n + 1) // 2 + m * (m + 1) // 2 + n * m
    wavelengths = 48  # 360 to 830 nm; the device keeps two or four words for eight numbers, which is less
    assert rows * HARMONICS * 4 * wavelengths * (2 if polydisperse else 1) <= 100e6


RESOLVED = 5e-3  # relative L2 of f, linear between the stored angles


@pytest.mark.parametrize(
    ("substrate", "oxide_nm", "wavelength_nm", "count"),
    [("Si", 400, 380.0, 48), ("Si", 400, 450.0, 48), ("Si", 950, 450.0, 120), ("Si", 0, 450.0, 48),
     ("glass", 0, 450.0, 32), ("air", 0, 450.0, 100)],
)  # fmt: skip
def test_the_stored_angles_resolve_films_up_to_a_micrometre(substrate, oxide_nm, wavelength_nm, count):
    from nacre.bsdf.lobes.monolayer import PolarGrid
    from nacre.families.metasurface.monolayer.evaluation import Grids, tabulate

    particle = {"material": "Si", "radius_nm": 75} if substrate == "glass" else {"material": "Ag", "radius_nm": 90}
    made = material(
        {
            "family": "metasurface",
            "substrate": substrate,
            "layers": [{"material": "SiO2", "thickness_nm": oxide_nm}] if oxide_nm else [],
            "particle": particle,
            "monolayer": {"coverage": 0.1},
            "model": {"multipole_order": 8, "correction": "qca-balanced"},
        }
    ).model
    a, b = vectors(1500, 0, made.transmits), vectors(1500, 1, made.transmits)
    stored = made.bsdf([wavelength_nm]).lobes[1]
    below = None
    if made.transmits:
        below = PolarGrid(160, 70, made.eta) if made.eta > 1.0 else PolarGrid(240)
    fine = tabulate(
        np.array([wavelength_nm]), made.monolayer, made.structure, Grids(PolarGrid(240), below), stored.eta
    )[0][1]
    f, best = stored.evaluate(a, b), fine.evaluate(a, b)
    assert stored.count_above == count
    assert np.linalg.norm(f - best) <= RESOLVED * np.linalg.norm(best)


def test_the_figure_of_the_structure_shows_points_of_the_pattern():
    made = material(
        {
            "family": "metasurface",
            "substrate": "glass",
            "particle": {"material": {"n": 2.0}, "radius_nm": 60},
            "monolayer": {"density_per_um2": 5, "packing": 0.4},
        }
    )
    data = made.figure_data("structure")
    xy = data["xy_um"]
    assert 400 <= len(xy) <= 700 and len(xy) / np.prod(np.ptp(xy, axis=0)) == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize("micrometres", [1, 30, 100, 150, 500])
def test_spheres_on_opaque_layers_over_glass_answer_with_numbers(micrometres):
    """Down to amplitudes of 1e-320, light from below gets nothing through: that leaves nothing to balance."""
    data = {
        "family": "metasurface",
        "substrate": "glass",
        "layers": [{"material": {"n": 1.5, "k": 1.0}, "thickness_nm": 1000.0 * micrometres / 50}] * 50,
        "particle": {"material": "Ag", "radius_nm": 50, "gap_nm": 2},
        "monolayer": {"coverage": 0.05, "packing": 0.1},
        "model": {"multipole_order": 3},
    }
    parts = material(data).spectrum([0.0, 1.0], [550.0]).parts()
    assert all(np.all(np.isfinite(part)) for part in parts.values())
    assert np.all(parts["diffuse_transmittance"] < 1e-6)
    bare = material({**data, "substrate": "Si"}).spectrum([0.0, 1.0], [550.0])
    np.testing.assert_allclose(parts["diffuse_reflectance"], bare.diffuse_reflectance, rtol=1e-6)


@pytest.mark.parametrize("radius_nm", [1e-300, 0.05])
def test_a_particle_smaller_than_an_atom_is_refused(radius_nm: float) -> None:
    with pytest.raises(RecipeError, match="radius_nm"):
        material(recipe(radius_nm=radius_nm))


def test_a_layer_is_at_most_ten_micrometres_thick():
    layer = {"material": "SiO2", "thickness_nm": 10_000.0}
    assert material(recipe(layers=[layer])).model.layers[0][1] == 10_000.0
    with pytest.raises(RecipeError):
        material(recipe(layers=[{**layer, "thickness_nm": 10_000.1}]))
