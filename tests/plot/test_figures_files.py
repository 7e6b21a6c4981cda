"""Every kind of figure reaches a file, with its provenance, and leaves nothing else behind."""

import json

import matplotlib
import numpy as np
import pytest
from PIL import Image

from nacre import plot
from nacre.core.errors import NacreError, UnsupportedError
from nacre.material.material import material_from_data
from nacre.matter.indices.library import index
from nacre.plot.material import data_figure
from nacre.recipe.model import RecipeContext

NM = np.arange(360.0, 831.0, 10.0)
ANGLES = np.linspace(0, 80, 21)
Q = np.linspace(0.1, 20, 50)
THETA = np.linspace(0, 180, 91)
DATA = {
    "structure": {"q": Q, "sq": [1 - np.exp(-Q), 1 - np.exp(-Q / 2)], "labels": ["a", "b"],
                  "xy_um": np.random.default_rng(0).uniform(0, 5, (50, 2)), "radius_um": 0.1},
    "platelet": {"angles_deg": ANGLES, "wavelengths_nm": NM, "names": ["one", "two"],
                 "reflectance": np.full((2, 21, 48), 0.3), "transmittance": np.full((2, 21, 48), 0.6)},
    "scattering": {"theta_deg": THETA, "wavelengths_nm": [450, 550], "s": np.ones((2, 91)),
                   "p": np.cos(np.radians(THETA)) ** 2 * np.ones((2, 1))},
    "microscope": {"spectra": np.random.default_rng(1).uniform(size=(12, 16, 48)), "wavelengths_nm": NM,
                   "extent_um": 5.0},
}  # fmt: skip


def film(**changes):
    data = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 400}],
            "surface": {"roughness": 0.2}, **changes}  # fmt: skip
    return material_from_data(data, RecipeContext(source="film.toml", text="family = film"))


@pytest.mark.parametrize(
    "kind",
    [
        "spectrum",
        "ribbon",
        "chromaticity",
        "slice",
        "lobe",
        "field",
        "colour-map",
        "structure",
        "ellipsometry",
        "mueller",
        "circular",
    ],  # fmt: skip
)
def test_every_kind_of_a_film_is_drawn_and_saved(kind, tmp_path):
    path = tmp_path / "figure.png"
    plot.save_material(film(), kind, path, provenance={"recipe": "family = film"})
    with Image.open(path) as image:
        assert image.width > 900 and np.asarray(image.convert("L")).std() > 10  # 300 dpi, and not blank
        stated = json.loads(image.text["nacre"])
    assert stated["figure"] == kind and stated["recipe"] == "family = film" and stated["illuminant"] == "D65"
    assert [p.name for p in tmp_path.iterdir()] == ["figure.png"]


@pytest.mark.parametrize("kind", DATA)
def test_every_kind_of_plain_arrays_is_drawn_and_saved(kind, tmp_path):
    plot.save_figure(data_figure(kind, DATA[kind], title="test"), tmp_path / "figure.pdf", {"seed": 7})
    text = (tmp_path / "figure.pdf").read_bytes()
    assert text.startswith(b"%PDF") and b'"seed": 7' in text


def test_a_smooth_film_on_glass_shows_its_delta_lobes(tmp_path):
    clear = film(substrate="BK7", surface={"roughness": 0})
    texts = [t.get_text() for axes in plot.material_figure(clear, "lobe", angles_deg=[30]).axes for t in axes.texts]
    assert any(t.startswith("R = 0.") for t in texts) and any(t.startswith("T = 0.9") for t in texts)
    with pytest.raises(NacreError, match="delta lobe only"):
        plot.material_figure(clear, "slice")


def test_the_same_figure_is_the_same_file(tmp_path):
    for suffix in (".png", ".pdf", ".svg"):
        contents = []
        for name in ("a", "b"):
            plot.save_material(film(), "spectrum", tmp_path / f"{name}{suffix}")
            contents.append((tmp_path / f"{name}{suffix}").read_bytes())
        if suffix != ".svg":  # SVG numbers its clip paths at random
            assert contents[0] == contents[1]


def test_indices_are_drawn_where_they_are_known(tmp_path):
    for name in ("Ag", "TiO2", "air", "main/Ge/Burnett"):
        path = tmp_path / f"{name.replace('/', '-')}.png"
        plot.save_index(index(name), path)
        with Image.open(path) as image:
            assert json.loads(image.text["nacre"])["material"] == name


def test_the_user_s_own_matplotlib_settings_stay_theirs_and_change_nothing(tmp_path):
    before = dict(matplotlib.rcParams)
    plot.save_material(film(), "ribbon", tmp_path / "a.png")
    assert dict(matplotlib.rcParams) == before
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red", "savefig.dpi": 40}):
        plot.save_material(film(), "ribbon", tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_wrong_suffix_kind_or_folder_is_one_clear_line(tmp_path):
    with pytest.raises(NacreError, match=".png, .pdf, .svg"):
        plot.save_material(film(), "spectrum", tmp_path / "figure.gif")
    with pytest.raises(UnsupportedError, match='Did you mean "ribbon"'):
        plot.material_figure(film(), "ribon")
    with pytest.raises(NacreError, match="does not exist"):
        plot.save_material(film(), "spectrum", tmp_path / "no" / "figure.png")
    with pytest.raises(UnsupportedError, match="takes no angles"):
        plot.material_figure(film(), "structure", angles_deg=[30])
    assert list(tmp_path.iterdir()) == []


def test_a_stochastic_lobe_is_evaluated_by_what_the_caller_gives():
    material = film()
    bsdf = material.bsdf()

    class Walk:
        wavelengths_nm = bsdf.wavelengths_nm
        is_stochastic = True
        transmits = False

        def specular(self, cos_i, uv=None):
            return bsdf.lobes[0].specular(cos_i)

    class Stub:
        name = "walk"

        def bsdf(self, wavelengths_nm=None):
            from nacre.bsdf import Bsdf

            return Bsdf((Walk(),))

    calls = []

    def evaluate(given, wi, wo):
        calls.append(wi.shape)
        return bsdf.evaluate(wi, wo)

    plot.material_figure(Stub(), "slice", evaluate=evaluate)
    plot.material_figure(Stub(), "lobe", evaluate=evaluate, angles_deg=[20])
    assert calls == [(46 * 46, 3), (181, 3)]
