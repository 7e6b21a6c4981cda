"""Structure factor, pair correlation and point patterns."""

from pathlib import Path

import numpy as np
import pytest
from helpers_metasurface import reference
from scipy.special import j0, j1

from nacre.core.errors import NacreError, RecipeError
from nacre.families.metasurface.monolayer import arrangement
from nacre.families.metasurface.monolayer.arrangement import points_pattern
from nacre.families.metasurface.monolayer.structure import (
    _compressibility,
    baus_colot,
    baus_colot_pair_correlation,
    baus_colot_scale,
    hard_disk_structure,
)
from nacre.families.metasurface.spec import StructureSpec
from nacre.readers.curves import FileSpec
from nacre.recipe.model import RecipeContext

MONTE_CARLO_BAR = 0.02


@pytest.mark.parametrize("packing, at_zero, scale", [(0.1, 0.6605, 1.838), (0.3, 0.2581, 1.566), (0.5, 0.0801, 1.352)])
def test_baus_colot_meets_its_published_numbers(packing, at_zero, scale):
    assert abs(float(baus_colot(0.0, packing)) - at_zero) < 6e-5
    assert abs(baus_colot_scale(packing) - scale) < 6e-4
    assert abs(float(baus_colot(0.0, packing)) * _compressibility(packing) - 1) <= 1e-10


@pytest.mark.parametrize("packing", [0.1, 0.3, 0.5])
def test_baus_colot_agrees_with_monte_carlo_disks(packing):
    data = reference("hard_disk_structure.npz")
    ours = baus_colot(data[f"q_{packing}"], packing)
    assert np.sqrt(np.mean((ours - data[f"mc_{packing}"]) ** 2)) <= MONTE_CARLO_BAR


@pytest.mark.parametrize("packing", [0.1, 0.3, 0.5])
def test_the_optics_structure_factor_agrees_with_monte_carlo_disks_and_keeps_its_compressibility(packing):
    data = reference("hard_disk_structure.npz")
    made = hard_disk_structure(1.0, packing, 40.0)
    q = data[f"q_{packing}"] / made.diameter_nm
    assert np.sqrt(np.mean((made.structure_factor(q) - data[f"mc_{packing}"]) ** 2)) <= MONTE_CARLO_BAR
    assert abs(made.s[0] * _compressibility(packing) - 1) <= 1e-10


@pytest.mark.parametrize("packing", [0.1, 0.5, 0.6])
def test_structure_factor_and_pair_correlation_are_a_pair(packing):
    """S = 1 + rho FT(g - 1) with an empty core, which the closed form alone misses by 0.02 at packing 0.5."""
    made = hard_disk_structure(1.0, packing, 20.0)
    a = made.diameter_nm
    r = np.linspace(a, 9 * a, 8001)
    weight = made.pair_excess(r) * r * (r[1] - r[0])
    weight[[0, -1]] *= 0.5
    q = made.q_per_nm[20:2000:150]
    back = 1 + 2 * np.pi * (j0(np.outer(q, r)) @ weight - a * j1(q * a) / q)
    assert np.abs(back - made.s[20:2000:150]).max() < 3e-3  # g ends at 9 diameters


def test_dense_disks_keep_a_positive_structure_factor():
    assert hard_disk_structure(1.0, 0.7, 20.0).s.min() >= 0


def test_structure_factor_goes_to_one_when_disks_vanish():
    q = np.linspace(0, 20, 50)
    assert np.abs(baus_colot(q, 1e-5) - 1).max() < 1e-4
    assert np.all(baus_colot(q, 0.0) == 1)


def test_pair_correlation_gives_the_structure_factor_back():
    """At low packing, where Baus-Colot keeps the core empty, S - 1 is the transform of g - 1."""
    x, weight = np.polynomial.legendre.leggauss(400)
    r = 4.5 + 3.5 * x
    h = baus_colot_pair_correlation(r, 0.1) - 1
    for q in (0.3, 1.5, 4.0):
        back = 1 + 0.8 * (-j1(q) / q + 3.5 * np.sum(weight * h * r * j0(q * r)))
        assert abs(back - float(baus_colot(q, 0.1))) < 2e-3


def test_packing_beyond_freezing_is_refused():
    for wrong in (0.71, -0.1):
        with pytest.raises(NacreError, match="packing"):
            baus_colot(1.0, wrong)
    with pytest.raises(NacreError, match="packing"):
        hard_disk_structure(1e-6, 0.8, 0.05)


@pytest.mark.parametrize("maker, packing", [("hard_disks", 0.5), ("random_sequential", 0.4), ("poisson_disk", 0.4)])
def test_patterns_keep_their_distance_their_density_and_their_seed(maker, packing):
    make = getattr(arrangement, maker)
    pattern = make(2000, 5e-6, packing, seed=3)
    a = np.sqrt(4 * packing / np.pi / 5e-6)
    assert arrangement.nearest_distances(pattern).min() >= a * (1 - 1e-12)
    assert abs(len(pattern.xy_nm) / pattern.box_nm**2 / 5e-6 - 1) < 1e-12
    assert np.array_equal(pattern.xy_nm, make(2000, 5e-6, packing, seed=3).xy_nm)
    assert not np.array_equal(pattern.xy_nm, make(2000, 5e-6, packing, seed=4).xy_nm)


@pytest.mark.parametrize("packing", [0.3, 0.5])
def test_monte_carlo_disks_have_the_structure_of_baus_colot(packing):
    pattern = arrangement.hard_disks(30_000, 1.0, packing, seed=1, sweeps=80)
    a = np.sqrt(4 * packing / np.pi)
    edges = np.arange(0.4, 12.01, 0.2) / a
    ours = arrangement.measured_structure_factor(pattern, edges)
    assert np.sqrt(np.mean((ours - baus_colot((edges[1:] + edges[:-1]) / 2 * a, packing)) ** 2)) <= 0.025
    r, g = arrangement.measured_pair_correlation(pattern, 4 * a, 160)
    assert np.all(g[r < a * 0.99] == 0)
    far = r > 1.2 * a
    assert np.sqrt(np.mean((g - baus_colot_pair_correlation(r / a, packing))[far] ** 2)) < 0.03


def test_pairs_are_counted_in_three_hundred_rings_unasked():
    """Against all pairs, one by one, of a small pattern; far apart points know nothing of each other."""
    xy = np.random.default_rng(5).uniform(0, 1000.0, (400, 2))
    r, g = arrangement.measured_pair_correlation(arrangement.Pattern(xy, 1000.0), 300.0)
    np.testing.assert_allclose(r, np.arange(0.5, 300.0))
    apart = xy[:, None] - xy
    apart -= 1000.0 * np.round(apart / 1000.0)
    distances = np.hypot(*apart[~np.eye(400, dtype=bool)].T)
    counts = np.histogram(distances, np.arange(301.0))[0]
    area = np.pi * (np.arange(1.0, 301.0) ** 2 - np.arange(300.0) ** 2)
    np.testing.assert_allclose(g, counts / (400 * 400 / 1e6 * area), atol=1e-9)
    assert g[100:].mean() == pytest.approx(1.0, abs=0.02)


def test_mesh_structure_factor_is_the_direct_sum():
    pattern = arrangement.random_sequential(300, 1.0, 0.3)
    n = np.array([3, 5])
    q = 2 * np.pi / pattern.box_nm * n
    direct = [abs(np.exp(1j * pattern.xy_nm @ q)[...].sum()) ** 2 / 300]
    size = float(np.hypot(*q))
    # all eight modes of that length (and their signs) share the bin
    modes = [(s * a, t * b) for a, b in ((3, 5), (5, 3)) for s in (1, -1) for t in (1, -1)]
    direct = (
        np.mean([abs(np.exp(2j * np.pi / pattern.box_nm * pattern.xy_nm @ np.array(m)).sum()) ** 2 for m in modes])
        / 300
    )
    found = arrangement.measured_structure_factor(pattern, np.array([size * 0.9999, size * 1.0001]))
    assert abs(found[0] / direct - 1) < 1e-3


def test_jittered_lattice_has_its_density_and_its_disorder():
    for kind in ("square", "hexagonal"):
        perfect = arrangement.lattice(900, 4e-6, kind)
        spacing = np.sqrt(1 / 4e-6) if kind == "square" else np.sqrt(2 / np.sqrt(3) / 4e-6)
        assert abs(arrangement.nearest_distances(perfect).min() / spacing - 1) < 0.03
        assert arrangement.nearest_distances(arrangement.lattice(900, 4e-6, kind, 0.1)).min() < 0.9 * spacing


def test_too_dense_patterns_are_refused():
    with pytest.raises(NacreError, match="rsa"):
        arrangement.random_sequential(1000, 1.0, 0.6)
    with pytest.raises(NacreError, match="poisson"):
        arrangement.poisson_disk(1000, 1.0, 0.6)
    with pytest.raises(NacreError, match="at most 0.7"):
        arrangement.hard_disks(1000, 1.0, 0.75)


LISTS = {
    "bare": ("", ",", lambda x, y: (f"{x:.4f}", f"{y:.4f}")),
    "um": ("x_um,y_um,radius_um", ",", lambda x, y: (f"{x:.4f}", f"{y:.4f}", "0.05")),
    "nm": ("X (nm);Y (nm)", ";", lambda x, y: (f"{1e3 * x:.1f}", f"{1e3 * y:.1f}")),
    "decimal commas": ("", ";", lambda x, y: (f"{x:.4f}".replace(".", ","), f"{y:.4f}".replace(".", ","))),
    "numbered": (" ,Area,X,Y", ",", lambda x, y: ("7", "0.008", f"{x:.4f}", f"{y:.4f}")),
}


@pytest.mark.parametrize("form", LISTS)
def test_a_list_of_points_is_read_by_its_heading_and_decimal_mark(form: str, tmp_path: Path) -> None:
    heading, parting, cells = LISTS[form]
    xy = np.stack(np.meshgrid(np.arange(8) * 0.5, np.arange(8) * 0.5), axis=-1).reshape(-1, 2)
    lines = [heading] * bool(heading) + [parting.join(cells(*point)) for point in xy]
    (tmp_path / "xy.csv").write_text("\n".join(lines))
    pattern = points_pattern(RecipeContext("r.toml", tmp_path), "xy.csv", 100.0)
    np.testing.assert_allclose(pattern.xy_nm, 1e3 * xy, atol=0.1)


def test_a_table_says_what_a_list_of_points_lacks(tmp_path: Path) -> None:
    """Columns without headings, with one that is no position, in nm."""
    xy = np.stack(np.meshgrid(np.arange(8) * 0.5, np.arange(8) * 0.5), axis=-1).reshape(-1, 2)
    np.savetxt(tmp_path / "xy.txt", np.column_stack([np.arange(len(xy)), 1e3 * xy]), fmt="%.1f")
    context = RecipeContext("r.toml", tmp_path)
    given = FileSpec(file="xy.txt", columns=("-", "x", "y"), unit="nm")
    np.testing.assert_allclose(points_pattern(context, given, 100.0).xy_nm, 1e3 * xy, atol=0.1)
    for unit in ("eV", "parsec"):
        with pytest.raises(RecipeError):
            points_pattern(context, FileSpec(file="xy.txt", columns=("-", "x", "y"), unit=unit), 100.0)
    structure = StructureSpec(points={"file": "xy.txt", "unit": "nm"})  # type: ignore[arg-type]
    assert structure.points is not None and structure.points.options.unit == "nm"
    assert StructureSpec(points="xy.csv") == StructureSpec(points={"file": "xy.csv"})  # type: ignore[arg-type]


WORDS = {
    "a word": ("0,0\n# remark\n0.5,north\n", 'holds "0.5 north" in line 3 where two numbers should stand'),
    "one number": ("x,y\n0,0\n\n1.5\n", 'holds "1.5" in line 4 where two numbers should stand'),
    "no number": ("0,0\n0.5,nan\n", "must hold finite numbers; line 2 does not"),
    "nothing": ("x,y\n", "must hold two numbers a line"),
}


@pytest.mark.parametrize("form", WORDS)
def test_a_list_that_is_none_is_refused_with_its_line(form: str, tmp_path: Path) -> None:
    text, why = WORDS[form]
    (tmp_path / "xy.csv").write_text(text)
    with pytest.raises(NacreError) as refused:
        points_pattern(RecipeContext("r.toml", tmp_path), "xy.csv", 100.0)
    assert str(refused.value) == f'r.toml: monolayer.structure.points = "xy.csv" {why}'


def test_a_list_from_a_strip_has_the_density_of_its_points(tmp_path: Path) -> None:
    """Its longer side had been the period of both: a strip of 4 to 1 came out with a fourth of its density."""
    rng = np.random.default_rng(3)
    xy = np.stack(np.meshgrid(np.arange(80) * 0.5, np.arange(20) * 0.5), axis=-1).reshape(-1, 2)
    np.savetxt(tmp_path / "xy.csv", xy + rng.uniform(-0.1, 0.1, xy.shape), delimiter=",")
    pattern = points_pattern(RecipeContext("r.toml", tmp_path), "xy.csv", 100.0)
    # 4 particles a square um; which rows the edges of the square take or leave is worth one of 20
    assert len(pattern.xy_nm) / (pattern.box_nm * 1e-3) ** 2 == pytest.approx(4.0, rel=0.1)


def test_points_that_fill_nothing_are_independent_beyond_contact():
    assert baus_colot_pair_correlation([0.0, 0.999, 1.0, 3.0], 0.0).tolist() == [0.0, 0.0, 1.0, 1.0]
