"""Formulas and images over uv: right, clipped, periodic, and never run as code."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.bsdf.texture import Texture, parse_formula, read_grey
from nacre.core.errors import RecipeError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("100 + 600*v", lambda u, v: 100 + 600 * v),
        ("-u^2 + +v", lambda u, v: -(u**2) + v),
        ("2^-u", lambda u, v: 2**-u),
        ("sin(2*pi*u)*exp(-v)", lambda u, v: math.sin(2 * math.pi * u) * math.exp(-v)),
        ("mix(1, 3, u) - clip(v, 0.2, 0.4)", lambda u, v: 1 + 2 * u - min(max(v, 0.2), 0.4)),
        ("step(0.5, u) + mod(7*v, 2)", lambda u, v: (u >= 0.5) + (7 * v) % 2),
        ("max(u, v)/min(u + 1, 2)", lambda u, v: max(u, v) / min(u + 1, 2)),
        ("abs(u - v) + floor(3*v) + sqrt(u) + log(1 + v) + cos(u) + tan(v)",
         lambda u, v: abs(u - v) + math.floor(3 * v) + math.sqrt(u) + math.log(1 + v) + math.cos(u) + math.tan(v)),
        ("e", lambda u, v: math.e),
    ],
)  # fmt: skip
def test_formulas_mean_what_they_say(text: str, expected: object) -> None:
    formula = parse_formula(text)
    for u, v in ((0.1, 0.7), (0.6, 0.3), (0.9, 0.95)):
        assert float(formula(np.array(u), np.array(v))) == pytest.approx(expected(u, v), rel=1e-12)


def test_noise_is_smooth_bounded_and_the_same_every_time() -> None:
    uv = np.random.default_rng(1).random((5000, 2)) * 4
    noise = parse_formula("noise(u, v)")
    values = noise(uv[:, 0], uv[:, 1])
    assert np.max(np.abs(values)) <= 1.0 and np.std(values) > 0.1
    np.testing.assert_array_equal(values, parse_formula("noise(u, v)")(uv[:, 0], uv[:, 1]))
    shifted = noise(uv[:, 0] + 1e-4, uv[:, 1])
    assert np.max(np.abs(shifted - values)) < 5e-3


@pytest.mark.parametrize(
    "text",
    [
        "", "u +", "w", "u.real", "u[0]", "lambda: u", "(u, v)", "[u]", "u if v else 1", "u and v", "u < v", "'a'",
        "f'{u}'", "__import__('os').system('true')", "exec('1')", "().__class__", "sin(u, v)", "sin()", "max(u)",
        "sin(x=u)", "u := 1", "1j", "True", "None", "1e999", "u" * 1001, "u" + "+u" * 300, "(" * 300 + "u" + ")" * 300,
        "u\n+v;import os", "import os", "u\x00",
    ],
)  # fmt: skip
def test_what_is_no_formula_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(RecipeError) as caught:
        parse_formula(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_values_without_meaning_become_the_lower_bound() -> None:
    texture = Texture(2.0, 5.0, formula=parse_formula("1/(u - u)"))
    assert np.all(np.isfinite(texture(np.random.default_rng(1).random((9, 2)))))
    assert float(Texture(2.0, 5.0, formula=parse_formula("log(-1 - u)"))(np.array([0.5, 0.5]))) == 2.0
    assert float(Texture(2.0, 5.0, formula=parse_formula("9"))(np.array([0.5, 0.5]))) == 5.0


def test_an_image_of_numbers_goes_from_black_to_white(tmp_path: Path) -> None:
    from PIL import Image

    values = np.array([[-1e-6, 0.25, 0.0], [0.75, 1.0 + 1e-6, 1.0]], dtype=np.float32)
    Image.fromarray(values).save(tmp_path / "grey.tif")
    np.testing.assert_array_equal(read_grey(tmp_path / "grey.tif", "r.toml: k"), [[0, 0.25, 0], [0.75, 1, 1]])
    whole = np.array([[0, 13107], [65535, 32768]], dtype=np.uint16)
    Image.fromarray(whole).save(tmp_path / "grey.png")
    np.testing.assert_allclose(read_grey(tmp_path / "grey.png", "r.toml: k"), whole / 65535)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.array([[20.0, 160.0]], dtype=np.float32), "holds 20 to 160; black is 0 and white 1 in"),
        (np.array([[0.0, np.nan]], dtype=np.float32), "holds nan to nan"),
        (np.array([[0, 70_000]], dtype=np.int32), "holds 0 to 70000; black is 0 and white 65535"),
        (np.array([[0, 4_000_000_000]], dtype=np.uint32), "black is 0 and white 65535"),
    ],
)
def test_an_image_of_numbers_beyond_black_and_white_is_refused(tmp_path: Path, values: np.ndarray, says: str) -> None:
    """A map of thickness in nm was white all over, in silence."""
    import tifffile

    tifffile.imwrite(tmp_path / "map.tif", values)
    with pytest.raises(RecipeError, match=f'k = "map.tif" .*{says}'):
        read_grey(tmp_path / "map.tif", "r.toml: k")


def test_an_image_is_taken_as_a_viewer_shows_it(tmp_path: Path) -> None:
    from PIL import Image

    levels = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned by a quarter: viewers turn the picture clockwise
    Image.fromarray(np.rot90(levels)).save(tmp_path / "turned.png", exif=exif)
    np.testing.assert_allclose(read_grey(tmp_path / "turned.png", "r.toml: k"), levels / 255)
    Image.fromarray(np.dstack([levels, np.full_like(levels, 255)])).save(tmp_path / "opaque.png")
    np.testing.assert_allclose(read_grey(tmp_path / "opaque.png", "r.toml: k"), levels / 255)
    Image.fromarray(np.dstack([levels, levels])).save(tmp_path / "clear.png")
    with pytest.raises(RecipeError, match="partly transparent"):
        read_grey(tmp_path / "clear.png", "r.toml: k")


def test_images_are_read_at_texel_centres_and_wrap_round() -> None:
    image = np.array([[0.0, 1.0], [0.5, 0.25]])
    texture = Texture(10.0, 20.0, image=image)
    # row 0 is the top of the picture: v near 1
    at = np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25], [0.5, 0.75], [1.25, -0.25]])
    np.testing.assert_allclose(texture(at), [10.0, 20.0, 15.0, 12.5, 15.0, 10.0])


def test_a_formula_of_positions_has_its_range_over_the_unit_ball() -> None:
    layer = {"material": "SiO2", "thickness_nm": {"formula": "100 + 40*x + 30*y"}}
    thickness = nacre.material({"family": "film", "substrate": "Si", "layers": [layer]}).model.layers[0].thickness_nm
    assert [thickness.low, thickness.high] == pytest.approx([50.0, 150.0], abs=0.5)  # 100 -/+ |(40, 30, 0)|
