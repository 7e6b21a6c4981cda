"""The family grating: recipes, commands, lobes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_grating import check_resumed_table

import nacre
from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.bsdf.texture import ParameterAxis, Texture, parse_formula
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.matter.periodic.structure import NotConvergedError

LINES = {"shape": "line", "material": {"n": 1.5}, "width_nm": 800}
DISC: dict[str, Any] = {
    "family": "grating", "substrate": {"n": 1.5},
    "layers": [
        {"thickness_nm": 130, "material": "air", "shapes": [{"shape": "disc", "material": "Si", "diameter_nm": 140}]},
        {"thickness_nm": 50, "material": "SiO2"},
    ],
    "lattice": {"period_nm": 300},
}  # fmt: skip


def compact_disc(**changes: Any) -> dict[str, Any]:
    layers = [{"thickness_nm": 110, "material": "air", "shapes": [LINES | {"material": "Al"}]}]
    return {"family": "grating", "substrate": "Al", "layers": layers, "lattice": {"period_nm": 1600}} | changes


def test_the_orders_of_a_compact_disc_lie_where_they_should() -> None:
    bsdf = nacre.material(compact_disc()).bsdf(np.array([450.0, 550.0, 650.0]))
    angles = np.radians(np.linspace(10.0, 30.0, 2001))
    wo = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    peaks = np.degrees(angles[bsdf.evaluate(np.array([0.0, 0.0, 1.0]), wo).argmax(axis=0)])
    assert peaks == pytest.approx([16.33, 20.11, 23.97], abs=0.02)


def test_a_wide_shallow_lamellar_grating_meets_its_scalar_limit() -> None:
    # quarter-wave grooves, half filled: the zero order vanishes and each first one takes 4 / pi^2 = 0.4053 of R
    metal = {"n": 1.0, "k": 60.0}
    layers = [{"thickness_nm": 125, "material": "air", "shapes": [LINES | {"material": metal, "width_nm": 10_000}]}]
    made = {"family": "grating", "substrate": metal, "layers": layers, "lattice": {"period_nm": 20_000}}
    found = nacre.orders(made, 0.0, 0.0, [500.0])
    values = dict(zip(found.numbers[:, 0].tolist(), found.reflected[0, 0].mean(axis=-1), strict=True))
    assert values[1] == pytest.approx(0.4053, abs=0.01) and values[-1] == pytest.approx(values[1], abs=1e-6)
    assert values[0] < 0.005


def test_the_command_prints_orders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "disc.toml"
    path.write_text(
        'family = "grating"\nsubstrate = "Al"\nprofile = {shape = "sinusoidal", depth_nm = 100}\n'
        "lattice = {period_nm = 800}\n"
    )
    words = ["--angles-deg", "0,70", "--azimuth-deg", "30", "--wavelengths-nm", "500,700", "--json"]
    assert run(["orders", str(path), *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["angles_deg"] == [0, 70] and found["wavelengths_nm"] == [500, 700] and found["azimuth_deg"] == 30
    assert [0, 0] in found["orders"] and [1, 0] in found["orders"]
    for side in ("reflected", "transmitted"):
        for name in ("s", "p"):
            assert np.shape(found[side][name]) == (2, 2, len(found["orders"]))
    again = nacre.orders(path, [0, 70], 30, [500, 700])
    values = np.array(found["reflected"]["p"], dtype=float)  # None becomes NaN
    assert np.array_equal(np.isnan(values), np.isnan(again.reflected[..., 1]))
    assert np.nanmax(np.abs(values - again.reflected[..., 1])) < 1e-12
    assert all(value is None for value in found["transmitted"]["s"][0][0])


def test_the_azimuth_is_that_of_the_light() -> None:
    # light from +x at 40 degrees: order -1 lies further along -x than the mirror direction
    found = nacre.orders(compact_disc(), 40.0, 0.0, [500.0])
    x = dict(zip(found.numbers[:, 0].tolist(), found.reflected_direction[0, 0, :, 0], strict=True))
    assert x[0] == pytest.approx(-np.sin(np.radians(40.0)))
    assert x[-1] == pytest.approx(x[0] - 500 / 1600)


def test_spectrum_adds_up_without_loss() -> None:
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 700},
            "profile": {"shape": "triangle", "depth_nm": 200, "apex": 0.7}}  # fmt: skip
    for polarisation in ("s", "p", "both"):
        parts = nacre.spectrum(made, [0, 35], [450.0, 650.0], polarisation).parts()
        assert sum(parts.values()) == pytest.approx(np.ones((2, 2)), abs=1e-8)


def test_lines_of_the_same_material_are_no_grating_in_a_lossless_layer() -> None:
    shapes = [{"shape": "line", "material": {"n": 1.7}, "width_nm": 200}]
    layers = [{"thickness_nm": 100, "material": {"n": 1.7}, "shapes": shapes}]
    made = {"family": "grating", "substrate": "Al", "layers": layers, "lattice": {"period_nm": 600}}
    found = nacre.orders(made, 10.0, 0.0, [500.0])
    away = np.any(found.numbers != 0, axis=1)
    assert np.nanmax(found.reflected[0, 0, away], initial=0.0) == 0.0


def layers(*shapes: dict[str, Any]) -> dict[str, Any]:
    return {"layers": [{"thickness_nm": 100, "material": "air", "shapes": [{"material": "Si"} | s for s in shapes]}]}


@pytest.mark.parametrize(
    "changes",
    [
        layers({"shape": "disc", "diameter_nm": 310}),
        layers({"shape": "disc", "diameter_nm": 140, "center_nm": [200, 0]}),
        layers({"shape": "disc", "diameter_nm": 140}, {"shape": "rectangle", "width_nm": 90, "center_nm": [60, 0]}),
        layers({"shape": "line", "width_nm": 140}, {"shape": "line", "width_nm": 90, "center_nm": [60, 0]}),
        layers({"shape": "disc"}),
        layers({"shape": "hexagon"}),
        layers({"gds": "absent.gds"}),
        layers({"shape": "disc", "diameter_nm": 140, "rounding_nm": 120}),
        layers({"shape": "disc", "diameter_nm": 140, "sidewall_deg": 10}),
        layers({"shape": "disc", "diameter_nm": 280, "sidewall_deg": 120}),
        layers({"shape": "disc", "diameter_nm": 140, "corner_radius_nm": 20}),
        layers({"shape": "rectangle", "width_nm": 140, "corner_radius_nm": 80}),
        layers({"shape": "disc", "diameter_nm": 140, "width_nm": 90}),
        layers({"shape": "line", "width_nm": 140, "length_nm": 90}),
        layers({"shape": "line", "width_nm": 140, "rotation_deg": 30}),
        layers({"shape": "disc", "diameter_nm": 140, "layer": 3}),
        layers({"shape": "image", "file": "cell.png", "center_nm": [20, 0]}),
        layers({"shape": "polygon", "points_nm": [[-50, 0], [50, 0], [0, 0]]}),
        layers({"shape": "polygon", "points_nm": [[-50, -50], [50, 50], [0, 0]]}),
        {"lattice": {"period_nm": 300, "kind": "square", "angle_deg": 75}},
        {"layers": [], "profile": {"shape": "sinusoidal", "depth_nm": 100, "apex": 0.3}},
        {"layers": [], "profile": {"shape": "triangle", "depth_nm": 100, "heights": "profile.csv"}},
        {"layers": [], "profile": {"shape": "triangle", "depth_nm": 100, "apex": 0}},
        {"lattice": {"period_nm": 0}},
        {"lattice": {"period_nm": 1e9}},
        {"lattice": {"period_nm": 8000}},
        {"lattice": {"period_nm": 300, "kind": "line"}},
        {"lattice": {"period_nm": [300, 400], "kind": "hexagonal"}},
        {"profile": {"shape": "sinusoidal", "depth_nm": 100}},
        {"orders": {"spread_deg": 0}},
        {"layers": [], "orientation": {"turn_deg": {"formula": "90*u"}}},
        {"layers": [], "lattice": {"period_nm": {"formula": "400 + 90*u"}}},
        {"lattice": {"period_nm": {"formula": "200*u"}}},
        {"lattice": {"period_nm": {"formula": "120 + 200*u"}}},
        {"lattice": {"period_nm": {"formula": "300 + 2000*u"}}},
        {"lattice": {"period_nm": {"texture": "absent.png", "min": 300, "max": 400}}},
    ],
)
def test_wrong_recipes_are_refused_in_one_line(changes: dict[str, Any]) -> None:
    with pytest.raises(RecipeError) as error:
        nacre.material(DISC | changes)
    assert "\n" not in str(error.value)


def test_orders_that_do_not_converge_are_refused() -> None:
    made = compact_disc(model={"tolerance": 1e-7})
    with pytest.raises(NacreError):
        nacre.orders(made, 0, 0, [450.0])


@pytest.mark.parametrize(
    "wrong",
    [
        {"azimuth_deg": np.nan}, {"azimuth_deg": "east"}, {"azimuth_deg": [0, 30]},
        {"angles_deg": np.nan}, {"angles_deg": []}, {"angles_deg": [[0, 1]]}, {"angles_deg": 90},
        {"wavelengths_nm": []}, {"wavelengths_nm": [[500]]}, {"wavelengths_nm": np.nan},
    ],
)  # fmt: skip
def test_wrong_arguments_of_orders_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(NacreError):
        nacre.orders(compact_disc(), **wrong)


def test_other_families_have_no_orders() -> None:
    with pytest.raises(UnsupportedError):
        nacre.orders({"family": "film", "substrate": "Si"}, 0, 0, [500.0])


def test_gds_cells_are_checked(tmp_path: Path) -> None:
    import gdstk

    library = gdstk.Library(unit=1e-6, precision=1e-9)
    cell = library.new_cell("PIXEL")
    cell.add(gdstk.rectangle((-0.07, -0.07), (0.07, 0.07), layer=1))
    library.write_gds(tmp_path / "cell.gds")
    shape: dict[str, Any] = {"material": {"n": 2.0}, "gds": "cell.gds"}

    def made(shape: dict[str, Any]) -> Any:
        layers = [{"thickness_nm": 100, "material": "air", "shapes": [shape]}]
        return nacre.material(DISC | {"layers": layers, "model": {"tolerance": 0.05}}, tmp_path)

    square = nacre.orders(made({"shape": "rectangle", "material": {"n": 2.0}, "width_nm": 140}), 0, 0, [500.0])
    assert nacre.orders(made(shape), 0, 0, [500.0]).reflected == pytest.approx(square.reflected, abs=4e-3)
    for wrong in (shape | {"cell": "NONE"}, shape | {"layer": 7}):
        with pytest.raises(RecipeError):
            made(wrong)


@pytest.mark.parametrize("keep", [0.0, 0.6])
def test_a_broken_gds_is_refused_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str], keep: float) -> None:
    import gdstk

    library = gdstk.Library()
    library.new_cell("PIXEL").add(gdstk.rectangle((-0.07, -0.07), (0.07, 0.07), layer=1))
    library.write_gds(tmp_path / "cell.gds")
    data = (tmp_path / "cell.gds").read_bytes()
    (tmp_path / "cell.gds").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(RecipeError):
        nacre.material(DISC | layers({"gds": "cell.gds"}), tmp_path)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("unit_m", [1e-12, 1e-3])
def test_a_gds_whose_unit_does_not_fit_the_cell_is_refused(tmp_path: Path, unit_m: float) -> None:
    import gdstk

    library = gdstk.Library(unit=unit_m, precision=unit_m / 1000)
    library.new_cell("PIXEL").add(gdstk.rectangle((-0.07, -0.07), (0.07, 0.07), layer=1))
    library.write_gds(tmp_path / "cell.gds")
    with pytest.raises(RecipeError):
        nacre.material(DISC | layers({"gds": "cell.gds"}), tmp_path)


@pytest.mark.parametrize(("span", "is_allowed"), [(600.0, True), (580.0, True), (300.0, False), (0.6, False)])
def test_a_table_of_heights_spans_the_period(tmp_path: Path, span: float, is_allowed: bool) -> None:
    x = np.linspace(0.0, span, 31)
    np.savetxt(tmp_path / "heights.csv", np.column_stack([x, 40 * np.cos(2 * np.pi * x / 600)]), delimiter=",")
    made = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 600}}
    made["profile"] = {"shape": "file", "heights": "heights.csv"}
    if is_allowed:
        assert nacre.material(made, tmp_path).model.profile.depth_nm == pytest.approx(80.0, abs=0.2)
        return
    with pytest.raises(RecipeError):
        nacre.material(made, tmp_path)


def test_tables_of_directions_state_that_they_miss_narrow_orders() -> None:
    from nacre.formats.bsdf_tables import lost_parts, unresolved_lost

    found = nacre.material(compact_disc()).bsdf(np.array([550.0]))
    flat = nacre.material({"family": "film", "substrate": "Al"}).bsdf(np.array([550.0]))
    for lost in (lost_parts, unresolved_lost):
        assert len(lost(found)) == len(lost(flat)) + 1


def test_colour_tables_refuse_orders_before_any_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def solved(*_: object) -> None:
        raise AssertionError("orders were solved")

    with monkeypatch.context() as patch:
        patch.setattr("nacre.families.grating.material.order_tables", solved)
        disc = nacre.material(compact_disc())
        for to in ("lut", "three"):
            with pytest.raises(UnsupportedError):
                nacre.export(disc, to, tmp_path / to)
    assert not list(tmp_path.iterdir())
    lines = {"thickness_nm": 100, "material": "air", "shapes": [LINES | {"material": "Al", "width_nm": 60}]}
    fine = nacre.material(compact_disc(layers=[lines], lattice={"period_nm": 150}))
    assert not fine.model.scatters_orders(np.array([400.0])) and fine.model.scatters_orders(np.array([290.0]))


def test_a_material_whose_orders_do_not_converge_is_refused_and_a_coarse_table_warned_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines = {"thickness_nm": 60, "material": "air", "shapes": [LINES | {"material": "Al", "width_nm": 120}]}
    made = nacre.material(compact_disc(layers=[lines], lattice={"period_nm": 300}))
    lam = np.array([620.0])
    with monkeypatch.context() as patch:
        patch.setattr("nacre.families.grating.material.LARGEST_ERROR", 1e-9)
        patch.setattr("nacre.matter.periodic.order_tables.responses", None)  # the table is not begun
        with pytest.raises(NotConvergedError, match=f"^{made.context.source}: "):
            made.bsdf(lam)
        patch.setattr("nacre.matter.periodic.solve.LARGEST_ERROR", 1e-9)
        with pytest.raises(NotConvergedError, match=f"^{made.context.source}: .* 1e-09;"):  # not that of the aim
            made.spectrum([0.0], lam)
    monkeypatch.setattr("nacre.matter.periodic.order_tables.difference", lambda *_: 0.1)
    found = made.bsdf(lam).provenance
    assert found["estimated_error"] == 0.1 and len(found["warnings"]) == 1


def test_directions_of_a_turned_lattice_obey_the_grating_equation_in_the_surface() -> None:
    turn, azimuth, theta = np.radians([30.0, 70.0, 25.0])
    made = {"family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 60},
            "lattice": {"period_nm": 900}, "orientation": {"turn_deg": 30}}  # fmt: skip
    found = nacre.orders(made, 25, 70, [550])
    towards = np.array([np.cos(azimuth), np.sin(azimuth)])
    across = np.array([np.cos(turn), np.sin(turn)])
    expected = -np.sin(theta) * towards + found.numbers[:, :1] * 550 / 900 * across
    got = found.reflected_direction[0, 0, :, :2]
    there = np.isfinite(got[:, 0])
    assert there.sum() >= 3 and got[there] == pytest.approx(expected[there], abs=1e-9)
    assert found.azimuth_rad == pytest.approx(azimuth)


def test_disorder_moves_light_from_orders_to_a_diffuse_part() -> None:
    lam = np.array([500.0, 600.0])
    wi = np.array([0.0, 0.0, 1.0])
    made: dict[str, Any] = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 900}}
    made["profile"] = {"shape": "sinusoidal", "depth_nm": 80}
    plain = nacre.material(made).bsdf(lam)
    rough = nacre.material(made | {"orders": {"period_deviation_nm": 60.0}}).bsdf(lam)
    orders, diffuse = (lobe.hemispherical(wi)[0] for lobe in rough.lobes[1:])
    whole = plain.lobes[1].hemispherical(wi)[0]
    assert np.all(orders < 0.9 * whole) and orders + diffuse == pytest.approx(whole, rel=0.01)


@pytest.mark.full
def test_the_period_varies_over_the_surface() -> None:
    made = compact_disc(profile={"shape": "sinusoidal", "depth_nm": 80}, layers=[])
    made["lattice"] = {"period_nm": {"formula": "800 + 160*u"}}
    grid = np.array([500.0])
    varied = nacre.material(made)
    assert nacre.orders(varied, 0, 0, [500.0]).reflected_direction[0, 0, -1, 0] == pytest.approx(500 / 880)
    bsdf = varied.bsdf(grid)
    assert bsdf.lobes[1].varying == ("lattice.period_nm",)
    wi = np.array([0.0, 0.0, 1.0])
    for u, period in ((0.0, 800.0), (0.75, 920.0)):
        plain = nacre.material(made | {"lattice": {"period_nm": period}}).bsdf(grid)
        uv = np.array([u, 0.5])
        sine = grid / period
        wo = np.column_stack([sine, 0 * sine, np.sqrt(1 - sine**2)])
        value, exact = (np.diagonal(b.evaluate(wi, wo, at)) for b, at in ((bsdf, uv), (plain, None)))
        assert np.all(exact > 5.0) and value == pytest.approx(exact, rel=0.05)
        assert bsdf.lobes[1].hemispherical(wi, uv)[0] == pytest.approx(plain.lobes[1].hemispherical(wi)[0], abs=0.01)


def test_transmitted_orders_are_part_of_the_material() -> None:
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 900},
            "profile": {"shape": "sinusoidal", "depth_nm": 300}}  # fmt: skip
    bsdf = nacre.material(made).bsdf(np.array([550.0]))
    wi = np.array([0.0, 0.0, 1.0])
    mirror = bsdf.lobes[0].specular(np.array(1.0))
    sides = [part for lobe in bsdf.lobes[1:] for part in lobe.hemispherical(wi)]
    assert mirror.reflectance + mirror.transmittance + sum(sides) == pytest.approx(np.ones(1), abs=2e-3)
    orders = bsdf.lobes[2].hemispherical(wi)[1]
    assert bsdf.lobes[2].transmits and np.all(orders > 0.2)


def orders_lobe(eta: float = 0.0, varies: bool = False) -> Bsdf:
    g = np.random.default_rng(1)
    power = g.uniform(0.05, 0.25, (3, 6, 9, 6, 5)).astype(np.float32)
    power[:, :, -1] = power[:, :, 0]
    numbers = np.array([[-2, 0], [-1, 0], [1, 0], [2, 0], [0, 1], [0, -1]])
    lattice = np.array([[1 / 1600.0, 0.0], [0.0, 1 / 1200.0]])
    grid = np.array([400.0, 450.0, 520.0, 600.0, 700.0])
    if not varies:
        return Bsdf((OrdersLobe(grid, power[0], lattice, numbers, 0.02, None, eta),))
    texture = Texture(1600.0, 2000.0, formula=parse_formula("1600 + 400*u"))
    period = ParameterAxis("lattice.period_nm", np.array([1600.0, 1800.0, 2000.0]), texture)
    return Bsdf((OrdersLobe(grid, power, lattice, numbers, 0.02, None, eta, (period,)),))


LOBES = {"reflected": (0.0, False), "transmitted": (1.5, False), "period": (0.0, True), "both": (1.5, True)}


def pairs(seed: int, eta: float = 0.0, scale: float = 1.0) -> tuple[Any, Any]:
    """Return light and eye near orders; of transmitted ones one of the two lies below."""
    from lobe_trials import directions

    lobe = orders_lobe().lobes[0]
    assert isinstance(lobe, OrdersLobe)
    g = np.random.default_rng(seed)
    eye = directions(2000, seed, False)
    t = (
        -eye[:, :2]
        + (lobe.orders[g.integers(0, 6, 2000)] @ lobe.lattice) * g.choice(lobe.wavelengths_nm, 2000)[:, None] / scale
    )
    t = (t + g.normal(0.0, 0.02, t.shape)) / (eta or 1.0)
    z = np.sqrt(np.maximum(1.0 - np.sum(t**2, axis=1), 0.03))
    light = np.column_stack([t, -z if eta else z])
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    is_swapped = (np.arange(2000) % 2 == 1)[:, None] & (eta > 0.0)
    return np.where(is_swapped, eye, light), np.where(is_swapped, light, eye)


@pytest.mark.render
@pytest.mark.parametrize("name", LOBES)
def test_the_plugin_gives_the_values_of_the_arrays(mi: Any, name: str) -> None:
    from lobe_trials import array_mismatch, reciprocity_mismatch

    eta, varies = LOBES[name]
    uv = np.column_stack([np.random.default_rng(0).uniform(0.2, 0.3, 2000), np.zeros(2000)]) if varies else None
    lobe = orders_lobe(eta, varies)
    light, eye = pairs(3, eta, 1.06 if varies else 1.0)
    assert np.mean(lobe.evaluate(light, eye, uv).max(axis=-1) > 1.0) > 0.3
    assert array_mismatch(lobe, light, eye, uv) <= 2e-4
    if not varies:
        assert reciprocity_mismatch(lobe, *pairs(4, eta), max(eta, 1.0)) <= 1e-4


@pytest.mark.render
@pytest.mark.parametrize(
    ("name", "view"),
    [
        ("reflected", (1.0, 0.0)),
        ("reflected", (30.0, 40.0)),
        ("reflected", (65.0, 200.0)),
        ("transmitted", (30.0, 40.0)),
        ("both", (125.0, 100.0)),
    ],
)
def test_draws_follow_the_density(mi: Any, name: str, view: tuple[float, float]) -> None:
    from lobe_trials import chi_square, direction, draw, weight_mismatch

    lobe = orders_lobe(*LOBES[name])
    assert weight_mismatch(draw(lobe, direction(*view), 20_000, seed=3)) <= 2e-3
    outcome = chi_square(lobe, *view, resolution=200, steps=24)
    assert outcome.passes(0.01, 5), outcome.messages


@pytest.mark.parametrize("eta", [0.7, 1.5])
def test_transmitted_orders_keep_their_light_both_ways(eta: float) -> None:
    lobe = orders_lobe(eta).lobes[0]
    assert isinstance(lobe, OrdersLobe) and lobe.transmits
    grid = np.linspace(-1, 1, 601)
    x, y = np.meshgrid(grid, grid)
    inside = x**2 + y**2 < 1
    wo = np.stack([x[inside], y[inside], np.sqrt(1 - x[inside] ** 2 - y[inside] ** 2)], axis=-1)
    for sign in (1.0, -1.0):
        wi = np.array([0.1, 0.05, sign * np.sqrt(1 - 0.0125)])
        away = wo * [1.0, 1.0, -sign]
        total = lobe.evaluate(np.broadcast_to(wi, away.shape), away).sum(axis=0) * (grid[1] - grid[0]) ** 2
        back, through = lobe.hemispherical(wi)
        assert not back.any() and total == pytest.approx(through, rel=0.03)


def test_the_lobe_conserves_the_efficiencies() -> None:
    lobe = orders_lobe().lobes[0]
    assert isinstance(lobe, OrdersLobe)
    wi = np.array([0.2, 0.1, np.sqrt(1 - 0.05)])
    grid = np.linspace(-1, 1, 801)
    x, y = np.meshgrid(grid, grid)
    inside = x**2 + y**2 < 1
    wo = np.stack([x[inside], y[inside], np.sqrt(1 - x[inside] ** 2 - y[inside] ** 2)], axis=-1)
    total = lobe.evaluate(np.broadcast_to(wi, wo.shape), wo).sum(axis=0) * (grid[1] - grid[0]) ** 2
    # E at the exit differs from E at the entrance in this made-up table, so the mean of both is integrated
    expected = lobe.hemispherical(wi)[0]
    assert total == pytest.approx(expected, rel=0.25)


def test_a_material_is_stored_and_loaded(tmp_path: Path) -> None:
    orders_lobe().save(tmp_path / "orders.nacre")
    again = Bsdf.load(tmp_path / "orders.nacre")
    light, eye = pairs(5)
    assert np.array_equal(again.evaluate(light, eye), orders_lobe().evaluate(light, eye))


def test_a_varying_period_is_stored_and_a_period_of_zero_refused(tmp_path: Path) -> None:
    orders_lobe(varies=True).save(tmp_path / "orders.nacre")
    again = Bsdf.load(tmp_path / "orders.nacre")
    light, eye = pairs(5)
    uv = np.random.default_rng(6).random((len(light), 2))
    assert np.array_equal(again.evaluate(light, eye, uv), orders_lobe(varies=True).evaluate(light, eye, uv))
    lobe = again.lobes[0]
    assert isinstance(lobe, OrdersLobe)
    axis = lobe.parameters[0]
    with pytest.raises(ValueError):
        replace(lobe, parameters=(replace(axis, values=axis.values - axis.values[0]),)).check()


def test_an_interrupted_table_resumes_at_the_next_angle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = {
        "family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 80},
        "lattice": {"period_nm": 600},
    }  # fmt: skip
    lam = np.array([600.0])
    stacks = nacre.load(made).model.stacks(lam)
    check_resumed_table(monkeypatch, tmp_path, "responses", stacks, lam, 2)


@pytest.mark.parametrize(("row", "height"), [(9, "oops"), (20, 20_000.0)])
def test_a_table_of_heights_with_a_gap_or_a_wall_is_refused(tmp_path: Path, row: int, height: Any) -> None:
    x = np.linspace(0.0, 600.0, 61)
    z: list[Any] = (40 * np.cos(2 * np.pi * x / 600)).tolist()
    made = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 600}}
    made["profile"] = {"shape": "file", "heights": "heights.csv"}
    for values in (z, [*z[:row], height, *z[row + 1 :]]):
        lines = ["# x, z", *(f"{a},{b}" for a, b in zip(x, values, strict=True)), "# end"]
        (tmp_path / "heights.csv").write_text("\n".join(lines))
        if values is z:
            nacre.material(made, tmp_path)
    with pytest.raises(RecipeError):
        nacre.material(made, tmp_path)


def test_a_gds_without_a_cell_is_refused(tmp_path: Path) -> None:
    import gdstk

    gdstk.Library().write_gds(tmp_path / "cell.gds")
    with pytest.raises(RecipeError):
        nacre.material(DISC | layers({"gds": "cell.gds"}), tmp_path)
