"""Tracks of gloss and diffuse colour: where they are looked at, what they show, what they refuse."""

import numpy as np
import pytest

from nacre import plot
from nacre.bsdf import Bsdf, Lobe
from nacre.cli import main
from nacre.core.errors import NacreError, UnsupportedError
from nacre.light import smooth_weights, spectrum_to_xyz, xyz_to_lab
from nacre.material.material import material
from nacre.measure.colours import WALK_NM, solve_coarse_walk
from nacre.plot.material import plot_walk

NM = np.arange(400.0, 701.0, 20.0)


def film(roughness=0.2, thickness=300):
    return material({"family": "film", "substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": thickness}],
                     "surface": {"roughness": roughness}})  # fmt: skip


class Lambertian(Lobe):
    """A white diffuser: pi f = 1 in all directions."""

    wavelengths_nm = NM

    def evaluate(self, wi, wo, uv=None):
        assert np.all(wi[:, 2] > 0) and np.all(wo[:, 2] > 0)
        return np.full((len(wi), len(NM)), 1 / np.pi)


def test_a_white_diffuser_is_perfect_white_on_both_tracks():
    tracks = plot.angle_tracks(Bsdf((Lambertian(),)))
    assert set(tracks) == {"gloss", "diffuse"}
    for track in tracks.values():
        assert np.allclose(track.values, 1.0)
    assert tracks["diffuse"].steps.min() == 15.0


def test_the_gloss_of_a_mirror_is_its_reflectance_and_it_has_no_diffuse_track():
    mirror = film(roughness=0).bsdf(NM)
    tracks = plot.angle_tracks(mirror, [10.0, 40.0])
    assert set(tracks) == {"gloss"}
    assert np.array_equal(tracks["gloss"].values, mirror.specular(np.radians([10.0, 40.0])).reflectance)


def test_a_number_moves_through_its_values():
    tracks, nm = plot.number_tracks([film(thickness=t) for t in (200, 300)], [200, 300], wavelengths_nm=NM)
    alone = plot.angle_tracks(film(thickness=300).bsdf(NM), [10.0])["gloss"].values[0]
    assert np.array_equal(nm, NM) and np.allclose(tracks["gloss"].values[1], alone)
    assert not np.allclose(tracks["gloss"].values[0], alone)


PEARL = {
    "family": "pearl",
    "strata": [{"resin": {"n": 1.575}, "thickness_um": 50, "roughness": 0.02, "platelets": [{
        "volume_fraction": 0.02, "substrate": {"material": "SiO2", "thickness_nm": 80},
        "coatings": [{"material": "TiO2", "thickness_nm": 100}], "normal_deviation": 0.05}]}],
    "base": {"albedo": 0.5},
}  # fmt: skip


@pytest.mark.render
def test_the_gloss_of_a_pearl_is_brighter_than_its_body_and_of_another_colour():
    tracks, nm = plot.number_tracks([material(PEARL)] * 2, [0, 1], plot_walk, NM)
    gloss, body = (spectrum_to_xyz(tracks[name].values[0], nm) for name in ("gloss", "diffuse"))
    assert gloss[1] > 3 * body[1]
    assert np.linalg.norm(gloss / gloss.sum() - body / body.sum()) > 0.05
    assert np.array_equal(tracks["gloss"].values[0], tracks["gloss"].values[1])  # the walk's seed is fixed


def test_a_walk_is_solved_on_a_coarse_grid_unless_one_is_asked_for():
    pearl = material({**PEARL, "base": {"none": True}, "quality": "fast"})  # cannot be baked: a walk after all
    assert np.array_equal(solve_coarse_walk(pearl).wavelengths_nm, WALK_NM)
    assert np.array_equal(solve_coarse_walk(pearl, NM).wavelengths_nm, NM)
    assert len(solve_coarse_walk(film()).wavelengths_nm) > len(WALK_NM)


def test_the_command_draws_tracks_over_a_number(tmp_path):
    recipe = tmp_path / "film.toml"
    recipe.write_text('family = "film"\nsubstrate = "Al"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
                      "[surface]\nroughness = 0.2\n")  # fmt: skip
    out = tmp_path / "tracks.png"
    words = ["plot", str(recipe), "--kind", "tracks", "--over", "layers[0].thickness_nm=200:300:50", "-o", str(out)]
    with pytest.raises(SystemExit) as end:
        main(words)
    assert not end.value.code and out.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("tracks", {"over": ("layers[0].thickness_nm", [200.0])}, "at least two values"),
        ("tracks", {"over": ("layers[9].thickness_nm", [200.0, 300.0])}, "layers"),
        ("tracks", {"over": ("layers[0].thickness_nm", [200.0, 300.0]), "angles_deg": [10]}, "not both"),
        ("lobe", {"over": ("layers[0].thickness_nm", [200.0, 300.0])}, "only spectrum"),
        ("ribbon", {"over": ("layers[0].thickness_nm", [200.0, 300.0]), "angles_deg": [0, 10]}, "one angle"),
        ("spectrum", {"over": ("layers[0].thickness_nm", [300.0, 200.0])}, "ascending"),
        ("tracks", {"lightness": 0.0}, "over 0"),
        ("slice", {"lightness": 50.0}, "only \"tracks\""),
        ("colour-map", {"over": ("layers[0].thickness_nm", [200.0])}, "at least two values"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_one_clear_line(kind, options, words):
    with pytest.raises((NacreError, UnsupportedError), match=words):
        plot.material_figure(film(), kind, **options)


def drawn_ab(figure):
    """The points of the a*, b* panel."""
    return np.concatenate([np.asarray(c.get_offsets()) for c in figure.axes[1].collections if len(c.get_offsets()) > 3])


@pytest.mark.parametrize("lightness", [None, 50.0, 80.0])
def test_tracks_show_the_samples_own_colours_and_scaled_ones_on_request(lightness):
    tracks = {"gloss": plot.angle_tracks(film(roughness=0).bsdf(NM), [10.0, 30.0, 50.0, 60.0])["gloss"]}
    xyz = tracks["gloss"].values @ smooth_weights(NM, "D65", "2deg")
    if lightness is not None:
        xyz = xyz * ((lightness + 16) / 116) ** 3 / xyz[:, 1:2]
    figure = plot.tracks_figure(tracks, NM, lightness=lightness)
    np.testing.assert_allclose(drawn_ab(figure), xyz_to_lab(xyz)[:, 1:], atol=1e-6)


CAVITY = {
    "family": "film", "substrate": "Al",
    "layers": [{"material": "Cr", "thickness_nm": 6}, {"material": "SiO2", "thickness_nm": 300}],
}  # fmt: skip


def test_a_colour_map_runs_over_the_layer_that_moves_the_colour():
    """Six nanometres of chromium over silica: the silica's thickness decides; chromium is opaque long before 1 um."""
    cavity = material(CAVITY)
    data = cavity.figure_data("colour-map", wavelengths_nm=NM)
    assert int(data["layer"]) == 1 and data["thicknesses_nm"][-1] == 1000.0
    chromium = cavity.figure_data("colour-map", layer=0, wavelengths_nm=NM)["thicknesses_nm"]
    assert 12.0 <= chromium[-1] <= 100.0
    axes = plot.material_figure(cavity, "colour-map", wavelengths_nm=NM).axes[0]
    assert axes.get_ylabel() == "Thickness of layers[1] (nm)"  # which one is nowhere else in the figure


@pytest.mark.parametrize("kind", ["colour-map", "chromaticity", "tracks"])
def test_a_range_without_a_step_runs_over_any_number(tmp_path, kind):
    recipe = tmp_path / "film.toml"
    recipe.write_text('family = "film"\nsubstrate = {n = 1.5}\nlayers = [{material = "TiO2", thickness_nm = 60}]\n'
                      "[surface]\nroughness = 0.2\n[base]\nalbedo = 0.5\n")  # fmt: skip
    out = tmp_path / "x.png"
    words = ["plot", str(recipe), "--kind", kind, "--over", "base.albedo=0.2:0.8", "-o", str(out)]
    with pytest.raises(SystemExit) as end:
        main(words)
    assert not end.value.code and out.stat().st_size > 10_000


def test_a_colour_map_over_a_number_holds_the_materials_own_colours():
    over = ("layers[0].thickness_nm", [100.0, 300.0])
    figure = plot.material_figure(film(), "colour-map", over=over, angles_deg=[0, 60])
    assert figure.axes[0].get_ylabel() == "layers[0].thickness_nm"
