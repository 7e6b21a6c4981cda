"""Discs and spheroids in a coat: against Mie and a closed form, what coats of one's own matter do, conservation."""

import json

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.machine import single_threaded_blas
from nacre.families.metasurface.tmatrix import particle_shapes
from nacre.families.metasurface.tmatrix.axisymmetric import as_blocks, gain, mirror_signs
from nacre.families.metasurface.tmatrix.particle_shapes import (
    Mesh,
    Shell,
    Sizes,
    SolvedBody,
    block_t_matrix,
    cylinder_panels,
    locate,
    spheroid_panels,
)
from nacre.families.metasurface.tmatrix.tmatrix_file import write_tmatrices
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.mie import mie_coefficients

OF_OWN_METHOD = 1e-6  # what is exact but for quadrature
SILVER, SILICA, SILICON = 0.06 + 3.4j, 1.46, 4.0 + 0.03j


@pytest.fixture(autouse=True)
def small_matrices_on_one_thread():
    """As the product solves them: on a loaded machine threads of linear algebra wait for each other."""
    with single_threaded_blas():
        yield


def _mesh(shape, radius, height, thickness, index):
    if shape == "cylinder":
        core, outside = cylinder_panels(radius, height, abs(index), coat=thickness)
        return Mesh(outside, core)
    outside = spheroid_panels(radius, height, abs(index), coat=thickness)
    return Mesh(outside, outside * [1, 1, 1, 1, 1, 0])


def _index(n):
    n = complex(n)
    return IndexSpec.model_validate({"n": n.real, "k": n.imag}).build()


def _body(shape, radius, height, core, thickness, coat):
    shell = Shell(_index(coat), thickness)
    return SolvedBody(shape, radius + thickness, height + 2 * thickness, _index(core), _index(1.0), "test", shell=shell)


@pytest.mark.parametrize(("coat", "core"), [(SILICA, SILVER), (SILVER, SILICA), (SILICON, 0.1 + 4.0j)])
@pytest.mark.parametrize(("x", "thickness"), [(0.05, 0.01), (0.8, 0.06), (0.8, 0.0004), (2.0, 0.5)])
def test_a_coated_spheroid_as_wide_as_high_is_a_coated_sphere(x, thickness, coat, core):
    index = max(coat, core, key=abs)
    found = block_t_matrix(_mesh("spheroid", x, 2 * x, thickness, index), coat, 4, 4, core)
    a, b = mie_coefficients(4, np.array([x, x + thickness]), np.array([core, coat]))
    wanted = as_blocks(np.concatenate([-b, -a]))
    assert np.abs(found - wanted).max() <= OF_OWN_METHOD * np.abs(wanted).max()


SHAPES = {"disc": ("cylinder", 0.7, 0.5), "rod": ("cylinder", 0.3, 1.2), "flat spheroid": ("spheroid", 0.7, 0.3)}


@pytest.mark.parametrize(("what", "thickness"), [*((what, 0.01) for what in SHAPES), ("disc", 0.2)])
def test_a_coat_of_the_cores_matter_is_a_larger_body_and_one_of_the_mediums_is_none(what, thickness):
    """The second one holds the outer surface's waves against the inner's: neither surface is where the other is."""
    mesh = _mesh(*SHAPES[what], thickness, SILICON)
    larger = block_t_matrix(Mesh(mesh.panels), SILICON, 3, 2)
    found = block_t_matrix(mesh, SILICON, 3, 2, SILICON)
    assert np.abs(found - larger).max() <= OF_OWN_METHOD * np.abs(larger).max()
    bare = block_t_matrix(Mesh(mesh.core), SILICON, 3, 2)
    found = block_t_matrix(mesh, 1.0, 3, 2, SILICON)
    assert np.abs(found - bare).max() <= OF_OWN_METHOD * np.abs(bare).max()


def _depolarisation(a, c):
    """Factors of a spheroid along x and z (Bohren and Huffman, 5.3)."""
    if c > a:
        e = np.sqrt(1 - (a / c) ** 2)
        along = (1 - e**2) / e**2 * (np.log((1 + e) / (1 - e)) / (2 * e) - 1)
    else:
        g = np.sqrt(c**2 / (a**2 - c**2))
        across = g / (2 * (a**2 - c**2) / a**2) * (np.pi / 2 - np.arctan(g)) - g**2 / 2
        along = 1 - 2 * across
    return (1 - along) / 2, along


@pytest.mark.parametrize(("a", "c"), [(0.01, 0.004), (0.004, 0.01)])
@pytest.mark.parametrize(("coat", "core"), [(SILICA, SILVER), (0.5 + 2.0j, 2.0)])
def test_a_small_confocal_coat_has_the_dipoles_of_the_closed_form(a, c, coat, core):
    """Bohren and Huffman, eq. 8.38; the rest is of the order of the size parameter squared."""
    wide, high = np.sqrt(a**2 + 0.004**2), np.sqrt(c**2 + 0.004**2)
    mesh = Mesh(spheroid_panels(wide, 2 * high, 1.0, -2), spheroid_panels(a, 2 * c, 1.0, -2))
    t = block_t_matrix(mesh, coat, 1, 1, core)
    share, volume = a**2 * c / (wide**2 * high), 4 / 3 * np.pi * wide**2 * high
    e1, e2 = core**2, coat**2
    for m, inner, outer in zip((1, 0), _depolarisation(a, c), _depolarisation(wide, high), strict=True):
        middle = e2 + (e1 - e2) * (inner - share * outer)
        alpha = volume * ((e2 - 1) * middle + share * e2 * (e1 - e2))
        alpha /= middle * (1 + (e2 - 1) * outer) + share * outer * e2 * (e1 - e2)
        wanted = 1j * alpha / (6 * np.pi)
        assert abs(t[m, 1, 1] / wanted - 1) <= 10 * wide**2, m


@pytest.mark.parametrize("what", SHAPES)
def test_what_absorbs_nothing_scatters_all_and_reciprocally(what):
    """Neither is built in: the blocks are not made symmetric here, and absorption is what energy is missing."""
    mesh = _mesh(*SHAPES[what], 0.1, 2.5)
    t = block_t_matrix(mesh, 1.5, 5, 5, 2.5)
    back = mirror_signs(5) * t.transpose(0, 2, 1)
    assert np.abs(t - back).max() <= OF_OWN_METHOD * np.abs(t).max()
    unitary = np.eye(10) + 2 * t
    product = unitary.conj().transpose(0, 2, 1) @ unitary
    assert np.abs(product - np.eye(10)).max() <= OF_OWN_METHOD
    for coat, core in ((1.5 + 0.1j, 2.5), (1.5, 2.5 + 0.1j)):
        lossy = block_t_matrix(mesh, coat, 5, 5, core)
        taken = -0.5 * (lossy + lossy.conj().transpose(0, 2, 1)) - lossy.conj().transpose(0, 2, 1) @ lossy
        assert gain(lossy) <= OF_OWN_METHOD and np.linalg.eigvalsh(taken).max() > 1e-3


@pytest.mark.parametrize("what", SHAPES)
def test_a_coat_is_as_thick_everywhere(what):
    mesh = _mesh(*SHAPES[what], 0.1, 2.5)
    s = np.linspace(-1, 1, 401)
    core, outside = (np.array([locate(p, x)[:2] for p in panels for x in s]) for panels in (mesh.core, mesh.panels))
    apart = np.array([np.hypot(*(core - point).T).min() for point in outside])
    assert np.abs(apart / 0.1 - 1).max() <= 1e-3  # as finely as the core is sampled
    _, radius, height = SHAPES[what]
    assert outside.max(0) == pytest.approx([radius + 0.1, height / 2 + 0.1])
    steps = np.hypot(*np.diff(outside, axis=0).T)
    assert steps.max() <= 0.02  # no hole
    speeds = np.array([locate(p, x)[4] for p in mesh.panels for x in s])
    length = np.hypot(*np.diff(np.array([locate(p, x)[:2] for p in mesh.panels for x in s]).T)).sum()
    assert speeds.sum() * 2 / 401 == pytest.approx(length, rel=1e-2)


@pytest.mark.parametrize(
    ("shape", "radius", "height", "coat", "core"),
    [("cylinder", 60.0, 80.0, SILICA, SILVER), ("cylinder", 60.0, 20.0, SILVER, SILICA),
     ("spheroid", 60.0, 20.0, SILICA, SILVER)],
)  # fmt: skip
def test_the_stated_error_covers_a_finer_mesh(shape, radius, height, coat, core):
    body, k = _body(shape, radius, height, core, 5.0, coat), 2 * np.pi / 550.0
    found, stated = body._solve(*body.reduced(550.0)[:3], 1, body.reduced(550.0)[3])
    lengths = radius * k, height * k
    if shape == "cylinder":
        inside, outside = cylinder_panels(*lengths, 10.0, 7, 5.0 * k)
    else:
        outside = spheroid_panels(*lengths, 3.4, -3, 5.0 * k)
        inside = outside * [1, 1, 1, 1, 1, 0]
    fine = block_t_matrix(Mesh(outside, inside, degree=8), coat, 4, 1, core)
    kept = np.concatenate([np.arange(4), body.lmax + np.arange(4)])
    change = np.linalg.norm(fine - found[:2, kept[:, None], kept]) / np.linalg.norm(fine)
    assert change <= stated <= 1e-3


def test_a_coated_disc_is_kept_and_its_coat_names_it(tmp_path, monkeypatch):
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "cache"))
    first = _body("spheroid", 40.0, 60.0, 3.5, 5.0, 1.5).t_matrix(500.0)

    def solve_again(*args, **options):
        raise AssertionError("solved again")

    monkeypatch.setattr(particle_shapes, "block_t_matrix", solve_again)
    assert np.array_equal(_body("spheroid", 40.0, 60.0, 3.5, 5.0, 1.5).t_matrix(500.0), first)
    bare = SolvedBody("spheroid", 45.0, 70.0, _index(3.5), _index(1.0), "test")
    thicker, other = _body("spheroid", 40.0, 60.0, 3.5, 6.0, 1.5), _body("spheroid", 40.0, 60.0, 3.5, 5.0, 1.6)
    for unlike in (bare, thicker, other):
        with pytest.raises(AssertionError, match="solved again"):
            unlike.t_matrix(500.0)


RECIPE = """
family = "metasurface"
substrate = {n = 1.5}
[particle]
shape = "%s"
material = {n = 4, k = 0.03}
diameter_nm = 80
height_nm = 60
gap_nm = 20
shell = {material = {n = 1.46}, thickness_nm = 10}
[monolayer]
coverage = 0.05
[model]
correction = "qca-balanced"
"""


@pytest.mark.parametrize(("shape", "reach"), [("cylinder", 60.0), ("spheroid", 50.0)])
def test_a_recipe_counts_distances_by_the_outside_and_draws_it(tmp_path, capsys, shape, reach):
    """A disc 80 nm wide and 60 high reaches 50 nm from its centre, with the shell 60; a spheroid 40 and 50."""
    path = tmp_path / "coated.toml"
    path.write_text(RECIPE % shape)
    model = nacre.load(path).model
    assert (model.outer_radius_nm, model.all_species[0].height_nm) == (50.0, 80.0)
    assert model.structure.density_per_nm2 * np.pi * 50.0**2 == pytest.approx(0.05)
    assert model.structure.diameter_nm == pytest.approx(2 * reach)
    up, down = model.powers([0.8], 550.0)[:2]
    assert np.all(up >= 0) and np.all(up + down <= 1.0)
    assert run(["fabricate", str(path), "--to", "gds", "-o", str(tmp_path / "x.gds")]) == 0
    assert json.loads((tmp_path / "x.gds.json").read_text())["radius_um"] == pytest.approx(0.05)
    assert run(["fabricate", str(path), "--to", "sheet", "-o", str(tmp_path / "sheet.csv")]) == 0
    sheet = (tmp_path / "sheet.csv").read_text()
    assert "shell" in sheet and "thickness_nm,10" in sheet and "radius_nm,40" in sheet


def test_sizes_spread_as_the_cores_do(tmp_path):
    path = tmp_path / "coated.toml"
    path.write_text((RECIPE % "cylinder").replace("gap_nm", 'deviation_nm = 5\ndistribution = "lognormal"\ngap_nm'))
    kind = nacre.load(path).model.all_species[0]
    assert kind.outer_radius_nm == pytest.approx(50.0) and kind.core_radius_nm == pytest.approx(40.0)
    bare = Sizes.of(40.0, 5.0, "lognormal")
    assert np.array(kind.sizes.radii_nm) - 10.0 == pytest.approx(np.array(bare.radii_nm))
    assert kind.body.with_radius(kind.sizes.radii_nm[0]).core_extents_nm[0] == pytest.approx(bare.radii_nm[0])


@pytest.mark.parametrize(
    ("shape", "edge", "coat", "named"),
    [("spheroid", 0, True, ""), ("cylinder", 0, True, ""), ("cylinder", 12, False, "cylinder")],
)
def test_an_exported_body_is_read_with_its_own_sphere_around_it(tmp_path, capsys, shape, edge, coat, named):
    """That of the cylinder which two lengths alone may mean would cut the stack, and keep neighbours further apart."""
    path = tmp_path / "coated.toml"
    text = (RECIPE % shape).replace("[model]", "[model]\nmultipole_order = 4").replace("gap_nm = 20", "gap_nm = 24")
    rows = [row for row in text.splitlines() if coat or not row.startswith("shell")]
    text = "\n".join([row + f"\nedge_radius_nm = {edge}" if edge and "height_nm" in row else row for row in rows])
    path.write_text(text)
    model = nacre.load(path).model
    wide, high = 2 * model.body.radius_nm, model.body.height_nm
    assert high / 2 + 24 > model.body.circumscribing_nm < np.hypot(wide, high) / 2 - 1.0
    known = model.body.exported_t_matrices(np.array([550.0]))
    assert "in 10 nm of" in known.name or not coat
    write_tmatrices(tmp_path / "coated.tmat.h5", known, named)
    particle = text[text.index("[particle]") : text.index("[monolayer]")]
    (tmp_path / "file.toml").write_text(text.replace(particle, '[particle]\ntmatrix = "coated.tmat.h5"\ngap_nm = 24\n'))
    other = nacre.load(tmp_path / "file.toml").model
    assert other.body.circumscribing_nm == pytest.approx(model.body.circumscribing_nm)
    assert other.structure.diameter_nm == pytest.approx(model.structure.diameter_nm)
    assert other.body.shape == named  # what is coated is none of the shapes by which "auto" decides
    for a, b in zip(model.powers([0.8], 550.0), other.powers([0.8], 550.0), strict=True):
        assert np.abs(a - b).max() <= 1e-10


def _rounded(radius, height, edge, core, thickness=0.0, coat=1.46):
    shell = Shell(_index(coat), thickness) if thickness else None
    sizes = radius + thickness, height + 2 * thickness
    return SolvedBody("cylinder", *sizes, _index(core), _index(1.0), "test", shell=shell, edge_nm=edge)


@pytest.mark.parametrize(("core", "thickness"), [(SILICON, 0.0), (SILVER, 0.0), (SILVER, 5.0)])
def test_a_cylinder_rounded_all_over_is_a_sphere(core, thickness):
    """Half a nanometre is left flat, then a quarter: the difference halves, and what both point to is the sphere's."""
    radius, wavelength = 50.0, 550.0
    k = 2 * np.pi / wavelength
    x = k * np.array([radius, radius + thickness] if thickness else [radius])
    a, b = mie_coefficients(3, x, np.array([core, 1.46] if thickness else [core]))
    wanted = np.concatenate([-b, -a])
    found = []
    for flat in (0.5, 0.25):
        t = _rounded(radius, 2 * radius, radius - flat, core, thickness).azimuthal(wavelength, 1)
        order = len(t[1]) // 2
        found.append(np.diag(t[1])[[0, 1, 2, order, order + 1, order + 2]])
    scale = np.abs(wanted).max()
    far, near = (np.abs(one - wanted).max() / scale for one in found)
    assert near < 0.6 * far
    assert np.abs(2 * found[1] - found[0] - wanted).max() < 2e-4 * scale


def test_a_rounded_edge_settles_where_a_sharp_one_has_no_finite_field():
    """Silver in silica at 420 nm, epsilon -2.56 relative: a sharp edge is refused; a radius of 1 nm is enough."""
    relative = 1.6j  # squared -2.56
    with pytest.raises(UnsupportedError, match="give the edges a radius: edge_radius_nm = 1"):
        _rounded(45.0, 40.0, 0.0, relative).azimuthal(420.0, 1)
    made = _rounded(45.0, 40.0, 1.0, relative)
    made.azimuthal(420.0, 1)
    assert made.estimated_error < 1e-3


def test_a_cylinders_edge_is_a_key_of_the_recipe_and_refused_where_it_does_not_fit():
    def recipe(**keys):
        particle = {"material": "Si", "gap_nm": 2, "shape": "cylinder", "diameter_nm": 80, "height_nm": 60, **keys}
        return {"family": "metasurface", "substrate": "glass", "particle": particle, "monolayer": {"coverage": 0.1}}

    (kind,) = nacre.material(recipe(edge_radius_nm=3, shell={"material": "SiO2", "thickness_nm": 5})).model.all_species
    assert kind.body.edge_nm == 3.0 and kind.body.height_nm == 70.0
    assert "edges of 3 nm" in kind.body.name
    assert kind.body.circumscribing_nm == pytest.approx(np.hypot(37.0, 27.0) + 8.0)
    for keys, words in (
        ({"edge_radius_nm": 16}, "particle.edge_radius_nm = 16.0 is too large for a cylinder 80 nm wide"),
        ({"edge_radius_nm": -1}, "edge_radius_nm"),
        ({"edge_radius_nm": 2, "shape": "spheroid"}, "gives edge_radius_nm, which a spheroid does not have"),
        ({"edge_radius_nm": 12, "deviation_nm": 12}, "the narrowest of the spread"),
    ):
        with pytest.raises(NacreError, match=words):
            nacre.material(recipe(**keys))
