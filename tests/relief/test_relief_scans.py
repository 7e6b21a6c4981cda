"""Reliefs from scans: planes, gratings and rough surfaces of known spectrum, files, units, and what is stated."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import gammaln

import nacre
from nacre.core.arrays import direction
from nacre.core.errors import NacreError
from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.scan import Scan, suggested
from nacre.families.relief.spectrum_map import SpectrumMap, spectrum_map
from nacre.families.relief.surface import Tile

COHERENCE = Coherence.from_sigma(5.0)
WAVELENGTHS = np.array([450.0, 550.0, 650.0])
FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0)) * COHERENCE.blur  # of the lobe of a mirror, in direction cosines
OUTSIDE = 1e-4  # the bar
CLOSED_FORM = 0.03  # the bar
RECIPE: dict[str, Any] = {"family": "relief", "heights": "h.npy", "feature_um": 0.78, "coherence": {"sigma": 5.0}}


def perfect(cosines: Any) -> np.ndarray:
    return np.ones((*np.shape(cosines), len(WAVELENGTHS)))


def lobe_of(surface: Tile | Scan, coherence: Coherence = COHERENCE) -> SpectrumMap:
    return spectrum_map(surface, coherence, WAVELENGTHS, perfect, bounded=False)[0]


def share_outside(lobe: SpectrumMap, wi: np.ndarray, mirror: np.ndarray, radius: float) -> float:
    """Return the share of the reflected power farther than `radius` from a direction, in direction cosines."""
    grid = np.arange(-1.0, 1.0, 0.5 * COHERENCE.blur)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    inside = x**2 + y**2 < 0.98
    wo = np.stack([x[inside], y[inside], np.sqrt(1.0 - x[inside] ** 2 - y[inside] ** 2)], axis=-1)
    power = lobe.evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 1]  # f cos_o d(omega) is f du dv
    far = np.hypot(wo[:, 0] - mirror[0], wo[:, 1] - mirror[1]) > radius
    return float(power[far].sum() / power.sum())


@pytest.mark.parametrize("theta_deg", [0.0, 40.0])
def test_a_tilted_plane_is_a_turned_mirror(theta_deg: float) -> None:
    slope = 1.0 / 50.0
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    wi = direction(np.radians(theta_deg), 0.3)
    mirror = 2.0 * (wi @ normal) * normal - wi
    lobe = lobe_of(Scan(np.zeros((64, 48)), 780.0, (slope, 0.0)))
    assert share_outside(lobe, wi, mirror, 3.0 * FWHM) <= OUTSIDE
    # the share of the Gaussian lobe of a mirror, exp(-9/2), and no more: the mirror stands where it should
    assert share_outside(lobe, wi, mirror, 3.0 * COHERENCE.blur) == pytest.approx(np.exp(-4.5), rel=0.3)


def test_a_plane_in_an_array_is_no_blazed_grating(tmp_path: Path, caplog: Any) -> None:
    np.save(tmp_path / "h.npy", np.outer(0.78 * np.arange(64) / 50.0, np.ones(64)))
    recipe = {**RECIPE, "blur_um": 0.2, "coherence": {"sigma": 2.0}}
    plane = nacre.material(recipe, folder=tmp_path)
    with caplog.at_level(logging.WARNING):
        lobe = plane.bsdf(WAVELENGTHS).lobes[0]
    assert caplog.records
    wi = direction(np.radians(45.0), np.pi)
    away = [direction(np.radians(angle), 0.0) for angle in (20.0, 0.0, -30.0)]  # aspecular 25, 45 and 75 degrees
    assert np.abs(lobe.evaluate(np.broadcast_to(wi, (3, 3)), np.array(away))).max() < 1e-6
    grating = nacre.material({**recipe, "periodic": True}, folder=tmp_path)
    assert isinstance(grating.model.tile, Tile)


def sinusoid(period_um: float, depth_um: float, points: tuple[int, int], pitch_um: float) -> np.ndarray:
    x = np.arange(points[0]) * pitch_um
    return np.outer(0.5 * depth_um * np.cos(2.0 * np.pi * x / period_um + 0.7), np.ones(points[1]))


def test_orders_of_a_grating_in_a_scan_carry_the_power_of_the_periodic_one() -> None:
    period, pitch = 4.0, 0.125
    heights = 1e3 * sinusoid(period, 0.25, (1201, 900), pitch)
    scan = Scan(heights - heights.mean(), 1e3 * pitch)
    assert scan.kind == "scan"
    tile = Tile(1e3 * sinusoid(period, 0.25, (32, 32), pitch), 1e3 * pitch, 1.0)
    found, exact = (lobe_of(surface) for surface in (scan, tile))
    wi = np.array([0.0, 0.0, 1.0])
    for order in (0, 1, -1, 2):
        # power within 3 deviations of an order, whose width a window of 16 coherence widths increases by 5 %
        place = -order * 0.55 / period
        grid = np.linspace(-3.5, 3.5, 29) * COHERENCE.blur
        u, v = np.meshgrid(place + grid, grid, indexing="ij")
        wo = np.stack([u.ravel(), v.ravel(), np.sqrt(1.0 - u.ravel() ** 2 - v.ravel() ** 2)], axis=-1)
        mine, theirs = (lobe.evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 1].sum() for lobe in (found, exact))
        assert mine == pytest.approx(theirs, rel=0.03), order


def test_a_scan_of_a_sinusoid_is_as_steep_and_as_smooth_as_one() -> None:
    """Its middle height is crossed twice in a period."""
    heights = 1e3 * sinusoid(4.0, 0.2, (400, 400), 0.1)
    found = Scan(heights - heights.mean(), 100.0).validity()
    assert [found.slope, found.feature, found.smoothness] == pytest.approx([0.2 / 2.0, 2.0 / 0.55, 1.0], rel=0.03)


def test_a_flat_scan_is_no_steeper_than_a_mirror() -> None:
    found = Scan(np.zeros((32, 32)), 100.0).validity()
    assert (found.slope, found.smoothness, found.de00, found.is_outside) == (0.0, 1.0, 0.0, False)


def rough(count: int, pitch_um: float, sq_um: float, length_um: float, seed: int = 1) -> np.ndarray:
    """Return normal heights with the autocorrelation exp(-(r / length)^2), periodic beyond the scan."""
    f = np.fft.fftfreq(count, pitch_um)
    spectrum = np.exp(-((np.pi * length_um * np.hypot(f[:, None], f)) ** 2))
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=(count, count)))
    return np.fft.ifft2(noise * np.sqrt(spectrum)).real * sq_um / np.sqrt(spectrum.mean())


def closed_form(psi: np.ndarray, xi: np.ndarray, wavelength_um: float, sq_um: float, length_um: float) -> np.ndarray:
    """Return <|A|^2> / lambda^2 of Gaussian statistics: Beckmann's series, widened by the coherence window."""
    g = (2.0 * np.pi * xi / wavelength_um * sq_um) ** 2
    own = (COHERENCE.blur / wavelength_um) ** 2
    frequency = (psi / wavelength_um) ** 2
    total = np.exp(-g - 0.5 * frequency / own) / (2.0 * np.pi * own)
    for m in range(1, 200):
        variance = m / (2.0 * (np.pi * length_um) ** 2) + own
        weight = np.exp(-g + m * np.log(g) - gammaln(m + 1))
        total = total + weight * np.exp(-0.5 * frequency / variance) / (2.0 * np.pi * variance)
    return total / wavelength_um**2


def closed_form_error(heights_um: np.ndarray, pitch_um: float, length_um: float) -> float:
    """Return the relative L2 error of S over 0 to 45 degrees and 12 azimuths, at the Sq of the sample."""
    surface = Scan(1e3 * heights_um, 1e3 * pitch_um)
    assert surface.kind == "isotropic"
    lobe = lobe_of(surface)
    psi = np.linspace(0.0, 0.7, 29)
    xi = 1.0 + np.sqrt(1.0 - psi**2)
    turns = np.arange(12) * (np.pi / 6.0)
    errors = []
    for k, wavelength in enumerate(WAVELENGTHS):
        found = np.array([lobe.spectrum_at(psi * np.cos(p), psi * np.sin(p), xi)[:, k] for p in turns])
        exact = np.broadcast_to(closed_form(psi, xi, wavelength / 1e3, heights_um.std(), length_um), found.shape)
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    return float(max(errors))


def test_the_lobe_of_a_rough_surface_is_beckmanns() -> None:
    assert closed_form_error(rough(1024, 0.15, 0.06, 1.0), 0.15, 1.0) < CLOSED_FORM


@pytest.mark.full
def test_the_lobe_of_a_strongly_rough_surface_is_beckmanns() -> None:
    assert closed_form_error(rough(2048, 0.4, 0.4, 4.0), 0.4, 4.0) < CLOSED_FORM


@pytest.mark.full
def test_a_scan_of_4096_points_a_side_is_a_material(tmp_path: Path) -> None:
    np.save(tmp_path / "h.npy", rough(4096, 0.1, 0.05, 1.0).astype(np.float32))
    recipe = {**RECIPE, "feature_um": 0.1, "periodic": False}
    found = nacre.material(recipe, folder=tmp_path).bsdf()
    assert found.provenance["relief"]["statistics"] == "isotropic"


def test_statistics_follow_the_surface() -> None:
    round_, stretched = rough(512, 1.0, 1.0, 5.0), np.repeat(rough(512, 1.0, 1.0, 5.0), 4, axis=0)[:512]
    assert suggested(round_) == "isotropic"
    assert suggested(stretched) == "random"
    assert suggested(sinusoid(20.0, 1.0, (512, 512), 1.0)) == "scan"
    assert suggested(np.exp(round_)) == "scan"  # far from normally distributed


def test_power_is_conserved_by_all_statistics() -> None:
    heights = 1e3 * rough(256, 0.3, 0.05, 2.0)
    for statistics in ("scan", "random", "isotropic"):
        lobe = lobe_of(Scan(heights - heights.mean(), 300.0, statistics=statistics))
        albedo = lobe.hemispherical(np.array([0.0, 0.0, 1.0]))[0]
        np.testing.assert_allclose(albedo, 1.0, atol=0.01, err_msg=statistics)  # slopes of 2 degrees


def write_sdf(path: Path, heights_um: np.ndarray, pitch_um: tuple[float, float]) -> None:
    """Write `[row, column]` heights."""
    rows, columns = heights_um.shape
    head = (
        f"aISO-1.0\nNumPoints = {columns}\nNumProfiles = {rows}\nXscale = {pitch_um[0] * 1e-6}\n"
        f"Yscale = {pitch_um[1] * 1e-6}\nZscale = 1e-6\nDataType = 7\nCheckType = 0\n*\n"
    )
    path.write_text(head + "\n".join(" ".join(f"{v:.6f}" for v in row) for row in heights_um) + "\n*\n")


def test_a_scan_file_gives_pitch_orientation_and_roughness(tmp_path: Path) -> None:
    row, column = np.indices((40, 60))
    heights = 0.3 * np.cos(2 * np.pi * column / 10) + 0.1 * np.cos(2 * np.pi * row / 20) + 0.02 * row + 7.0
    write_sdf(tmp_path / "scan.sdf", heights, (0.2, 0.4))
    recipe = {"family": "relief", "heights": "scan.sdf", "coherence": {"sigma": 5.0}}
    model = nacre.material(recipe, folder=tmp_path).model
    assert model.tile.pitch_nm == pytest.approx(200.0)
    assert model.tile.heights_nm.shape == (60, 80)  # 12 x 16 um
    figures = model.surface_figures
    assert figures["sq_um"] == pytest.approx(np.hypot(0.3, 0.1) / np.sqrt(2.0), rel=0.02)
    assert figures["tilt_deg"] == pytest.approx(np.degrees(np.arctan(0.05)), rel=0.05)
    assert model.tile.tilt == (0.0, 0.0) and len(model.warnings) >= 1
    kept = nacre.material({**recipe, "level": "none"}, folder=tmp_path).model
    # y runs upward and rows downward
    assert kept.tile.tilt == pytest.approx((0.0, -0.05), abs=0.005)


def test_holes_are_filled_up_to_a_tenth(tmp_path: Path) -> None:
    heights = rough(64, 0.5, 0.05, 3.0)
    recipe = {"family": "relief", "heights": "scan.sdf", "coherence": {"sigma": 5.0}}
    for share, is_read in ((0.05, True), (0.3, False)):
        holed = np.where(np.random.default_rng(0).random(heights.shape) < share, np.nan, heights)
        write_sdf(tmp_path / "scan.sdf", holed, (0.5, 0.5))
        if is_read:
            assert np.isfinite(nacre.material(recipe, folder=tmp_path).model.tile.heights_nm).all()
        else:
            with pytest.raises(NacreError):
                nacre.material(recipe, folder=tmp_path)


@pytest.mark.parametrize(
    "heights, changes",
    [
        (1.2e-7 * np.random.default_rng(0).random((16, 16)), {}),  # metres
        (120.0 * np.random.default_rng(0).random((16, 16)), {}),  # nm
        (300.0 * np.random.default_rng(0).random((16, 16)), {"periodic": False, "height_unit": "um"}),  # mountains
        (np.random.default_rng(0).random((16, 16)), {"statistics": "scan", "periodic": True}),
        (np.random.default_rng(0).random((16, 16)), {"feature_um": None}),
        (np.random.default_rng(0).random((16, 16)), {"blur_um": None}),
    ],
)
def test_what_is_unlikely_or_missing_is_refused(tmp_path: Path, heights: np.ndarray, changes: dict[str, Any]) -> None:
    np.save(tmp_path / "h.npy", heights)
    recipe = {k: v for k, v in {**RECIPE, "blur_um": 0.2, **changes}.items() if v is not None}
    with pytest.raises(NacreError):
        nacre.material(recipe, folder=tmp_path)


def test_units_are_taken_where_they_are_stated(tmp_path: Path) -> None:
    np.save(tmp_path / "h.npy", 120.0 * np.random.default_rng(0).random((16, 16)))
    model = nacre.material({**RECIPE, "blur_um": 0.2, "height_unit": "nm"}, folder=tmp_path).model
    assert model.tile.height_range_nm == pytest.approx(120.0, rel=0.05)


def test_a_text_matrix_needs_unit_and_pitch(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "m.txt", 1e3 * rough(32, 0.5, 0.05, 2.0))
    recipe = {"family": "relief", "heights": "m.txt", "coherence": {"sigma": 5.0}}
    for given in ({}, {"height_unit": "nm"}, {"feature_um": 0.5}):
        with pytest.raises(NacreError):
            nacre.material({**recipe, **given}, folder=tmp_path)
    model = nacre.material({**recipe, "height_unit": "nm", "feature_um": 0.5}, folder=tmp_path).model
    assert model.tile.sq_nm == pytest.approx(50.0, rel=0.3)


def test_the_energy_bound_says_when_it_acts(tmp_path: Path, caplog: Any) -> None:
    np.save(tmp_path / "h.npy", np.random.default_rng(1).random((16, 16)))
    recipe = {**RECIPE, "feature_um": 1.0, "blur_um": 0.3, "coherence": {"sigma": 1.0}}
    found = nacre.material(recipe, folder=tmp_path).bsdf(np.array([550.0]))
    assert len(found.provenance["warnings"]) == 1
    free = nacre.material({**recipe, "bounded": False}, folder=tmp_path).bsdf(np.array([550.0]))
    assert "warnings" not in free.provenance


def test_the_report_states_the_roughness(tmp_path: Path) -> None:
    write_sdf(tmp_path / "scan.sdf", rough(128, 0.5, 0.05, 3.0), (0.5, 0.5))
    recipe = {"family": "relief", "heights": "scan.sdf", "coherence": {"sigma": 1.0}}
    found = nacre.report(nacre.material(recipe, folder=tmp_path))
    assert found.surface["sq_um"] == pytest.approx(0.05, rel=0.2)
    assert {"sdq", "correlation_length_um"} <= set(found.surface)


def test_the_azimuthal_mean_continues_the_largest_circle_into_the_corners() -> None:
    from nacre.families.relief.scan import _azimuthal_mean

    lag = np.hypot(*np.mgrid[-8:9, -8:9])
    found = _azimuthal_mean(np.exp(-0.02 * lag**2))
    inside = lag <= 6.5  # the last radius: half a point short of 7
    np.testing.assert_allclose(found[inside], np.exp(-0.02 * lag[inside] ** 2), atol=2e-3)  # of splines
    np.testing.assert_allclose(found[~inside], np.exp(-0.02 * 6.5**2), atol=2e-3)


@pytest.mark.parametrize(("blur_nm", "is_vertical"), [(0.0, True), (6.0, True), (9.0, False)])
def test_steps_steeper_than_20_are_vertical_walls_between_level_features(blur_nm: float, is_vertical: bool) -> None:
    """The slope of a step h blurred by sigma is h / (sqrt(2 pi) sigma)."""
    from nacre.families.relief.structures import Blocks

    heights = np.zeros((6, 6))
    heights[2:4, 1:5] = 400.0
    assert Blocks(heights, 800.0, blur_nm).is_vertical == is_vertical
