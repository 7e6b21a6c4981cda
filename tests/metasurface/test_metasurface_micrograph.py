"""Particles found in a picture: places, widths and S(q) that were drawn; what shows nothing is refused in one line."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.families.metasurface.monolayer.arrangement import find_particles, grey_levels, hard_disks, otsu
from nacre.material.material import material

PIXEL_NM = 20.0


def drawn(xy_nm, radius_nm, size_nm, noise=0.0, dark=False, seed=0):
    """Grey levels of discs, smoothed over a pixel; x to the right, y up."""
    rows, columns = (round(s / PIXEL_NM) for s in size_nm[::-1])
    y, x = np.mgrid[:rows, :columns]
    x, y = (x + 0.5) * PIXEL_NM, (rows - y - 0.5) * PIXEL_NM
    levels = np.zeros((rows, columns))
    for (cx, cy), r in zip(xy_nm, np.broadcast_to(radius_nm, len(xy_nm))):
        near = (np.abs(x - cx) < r + 50) & (np.abs(y - cy) < r + 50)
        levels[near] = np.maximum(
            levels[near], np.clip(0.5 + (r - np.hypot(x[near] - cx, y[near] - cy)) / PIXEL_NM, 0, 1)
        )
    levels = 0.2 + 0.6 * (1 - levels if dark else levels)
    return np.clip(levels + np.random.default_rng(seed).normal(scale=noise, size=levels.shape), 0, 1)


def picture(path, levels):
    Image.fromarray(np.round(255 * levels).astype(np.uint8)).save(path)


@pytest.mark.parametrize(("dark", "noise"), [(False, 0.0), (True, 0.0), (False, 0.1)])
def test_what_was_drawn_is_found_where_it_was_drawn(dark, noise):
    pattern = hard_disks(150, 3e-6, 0.2, 4)
    box = pattern.box_nm
    levels = drawn(pattern.xy_nm, 80.0, (box, box), noise, dark)
    found = find_particles(levels, levels.shape[1] * PIXEL_NM * 1e-3)
    whole = pattern.xy_nm[np.all((pattern.xy_nm > 100) & (pattern.xy_nm < box - 100), axis=1)]
    gaps = np.linalg.norm(whole[:, None] - 1e3 * found.xy_um, axis=2).min(axis=1)
    assert gaps.max() <= 0.3 * PIXEL_NM + 40 * noise  # noise moves an outline of 25 pixels by some tenths
    assert len(whole) <= len(found.xy_um) <= 150 and found.is_bright is not dark
    assert found.diameters_nm.mean() == pytest.approx(160.0, rel=0.05)


@pytest.mark.parametrize("what", ["banner", "bar", "shade"])
def test_what_a_microscope_adds_is_no_particle(what):
    """A banner with the scale, a bar drawn into the picture, light that falls off: the same particles are found."""
    pattern = hard_disks(150, 3e-6, 0.2, 4)
    levels = drawn(pattern.xy_nm, 80.0, (pattern.box_nm, pattern.box_nm), 0.06)
    plain, width_um = find_particles(levels, levels.shape[1] * PIXEL_NM * 1e-3), levels.shape[1] * PIXEL_NM * 1e-3
    rows, columns = levels.shape
    if what == "banner":
        strip = np.zeros((60, columns))
        strip[20:28, 100:300] = strip[12:36, 400:404] = strip[12:36, 420:440] = 1.0
        levels = np.vstack([levels, strip])
    if what == "bar":
        free = ndimage.uniform_filter(np.where(levels > 0.5, 1.0, 0.0), (20, 60))
        row, column = np.unravel_index(np.argmin(free[40:-40, 80:-80]), free[40:-40, 80:-80].shape)
        levels[row + 34 : row + 46, column + 60 : column + 100] = 1.0
    if what == "shade":
        levels = 0.7 * levels + 0.3 * np.arange(columns) / columns
    found = find_particles(levels, width_um)
    assert found.size_um == pytest.approx((width_um, rows * PIXEL_NM * 1e-3))
    gaps = np.linalg.norm(plain.xy_um[:, None] - found.xy_um, axis=2).min(axis=1)
    assert len(found.xy_um) == pytest.approx(len(plain.xy_um), abs=0 if what != "shade" else 2)
    assert np.sort(1e3 * gaps)[-3] <= PIXEL_NM
    assert found.left_out == {"banner": "a banner of 60 rows", "bar": "marks drawn in", "shade": ""}[what]


def test_discs_that_touch_are_two_and_specks_are_none():
    at = np.array([[500.0, 500.0], [690.0, 500.0], [1400.0, 500.0], [1500.0, 1500.0], [600.0, 1500.0]])
    levels = drawn(at, [100, 100, 100, 100, 20], (2000, 2000))
    found = find_particles(levels, 2.0)
    assert len(found.xy_um) == 4
    gaps = np.linalg.norm(at[:4, None] - 1e3 * found.xy_um, axis=2).min(axis=1)
    assert gaps.max() <= PIXEL_NM


def test_otsu_parts_two_levels():
    levels = np.concatenate([np.full(300, 0.2), np.full(100, 0.9)])
    threshold, explained = otsu(levels)
    assert 0.2 < threshold < 0.9 and explained == pytest.approx(1.0)


def _recipe(**structure):
    return {
        "family": "metasurface", "substrate": "glass", "particle": {"material": "Si", "radius_nm": 70},
        "monolayer": {"structure": structure}, "model": {"correction": "qca-balanced", "multipole_order": 4},
    }  # fmt: skip


def test_a_recipe_takes_a_picture_as_it_takes_its_points(tmp_path):
    pattern = hard_disks(300, 3e-6, 0.3, 7)
    box = pattern.box_nm
    # wide: its middle is taken
    picture(tmp_path / "sem.png", drawn(pattern.xy_nm + [0.25 * box, 0.0], 70.0, (1.5 * box, box)))
    inside = pattern.xy_nm[np.all((pattern.xy_nm > 80) & (pattern.xy_nm < box - 80), axis=1)]
    np.savetxt(tmp_path / "xy.csv", inside * 1e-3, delimiter=",")
    seen = material(_recipe(points="sem.png", width_um=1.5e-3 * box), tmp_path)
    listed = material(_recipe(points="xy.csv"), tmp_path)
    assert seen.model.structure.density_per_nm2 == pytest.approx(listed.model.structure.density_per_nm2, rel=0.03)
    assert seen.model.structure.density_per_nm2 == pytest.approx(3e-6, rel=0.05)
    q = np.linspace(0.004, 0.03, 60)
    # both guess the period from their own outermost points, which moves the speckle of single modes: means are compared
    s = [m.model.structure.structure_factor(q).reshape(6, 10).mean(axis=1) for m in (seen, listed)]
    assert np.abs(s[0] - s[1]).max() <= 0.1 < 0.5 < np.ptp(s[1])
    before = seen.fingerprint
    picture(tmp_path / "sem.png", drawn(pattern.xy_nm + [0.25 * box, 0.0], 66.0, (1.5 * box, box)))
    assert material(_recipe(points="sem.png", width_um=1.5e-3 * box), tmp_path).fingerprint != before


def test_sixteen_bits_are_read(tmp_path):
    levels = drawn(np.array([[500.0, 500.0], [1500.0, 900.0]]), 100.0, (2000, 2000))
    Image.fromarray(np.round(65535 * levels).astype(np.uint16)).save(tmp_path / "sem.tif")
    assert len(find_particles(grey_levels(tmp_path / "sem.tif", "sem.tif"), 2.0).xy_um) == 2


REFUSED = {
    "no width": ({"points": "sem.png"}, "not how wide it is; give width_um"),
    "a list with a width": ({"points": "xy.csv", "width_um": 5}, "gives width_um, which is of a picture"),
    "missing": ({"points": "none.png", "width_um": 5}, "none.png"),
    "no picture": ({"points": "text.png", "width_um": 5}, "is not a readable image"),
    "empty": ({"points": "grey.png", "width_um": 5}, "is of one grey level"),
    "noise": ({"points": "noise.png", "width_um": 5}, "has no two levels"),
    "few": ({"points": "sem.png", "width_um": 2}, "which is what is taken; at least 50 are needed"),
    "in nm": ({"points": "nm.csv"}, "lengths are in um unless a heading says else, as x_nm,y_nm"),
    "too small": ({"points": "dots.png", "width_um": 5}, "pixels wide"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_picture_that_shows_nothing_gets_one_line(tmp_path, what):
    picture(tmp_path / "sem.png", drawn(np.array([[500.0, 500.0], [1500.0, 900.0]]), 100.0, (2000, 2000)))
    picture(tmp_path / "grey.png", np.full((50, 50), 0.4))
    picture(tmp_path / "noise.png", np.clip(np.random.default_rng(1).normal(0.5, 0.1, (200, 200)), 0, 1))
    dots = np.zeros((300, 300))
    dots[5::9, 5::9] = dots[6::9, 5::9] = dots[5::9, 6::9] = dots[6::9, 6::9] = 1.0
    picture(tmp_path / "dots.png", dots)
    np.savetxt(tmp_path / "nm.csv", hard_disks(100, 3e-6, 0.2, 2).xy_nm, delimiter=",")
    (tmp_path / "text.png").write_text("no picture")
    structure, said = REFUSED[what]
    with pytest.raises(NacreError) as raised:
        material(_recipe(**structure), tmp_path)
    assert said in str(raised.value) and "\n" not in str(raised.value)


def test_the_command_draws_what_it_found(tmp_path, capsys):
    pattern = hard_disks(120, 3e-6, 0.2, 2)
    picture(tmp_path / "sem.png", drawn(pattern.xy_nm, 70.0, (pattern.box_nm, pattern.box_nm)))
    path = tmp_path / "sem.toml"
    path.write_text(
        'family = "metasurface"\nsubstrate = "glass"\nparticle = {material = "Si", radius_nm = 70}\n'
        f'monolayer = {{structure = {{points = "sem.png", width_um = {pattern.box_nm * 1e-3:.4f}}}}}\n'
    )
    assert run(["fabricate", str(path), "--to", "csv", "-o", str(tmp_path / "found.csv")]) == 0
    assert len((tmp_path / "found.csv").read_text().splitlines()) > 80
