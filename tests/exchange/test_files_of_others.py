"""Files that other programs wrote, a measurement among them: do they arrive as materials with the numbers they hold?

Where they come from, and under which licence, stands in `data/README.md`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.readers.bsdf.ray_tracers import read_zemax_table, scatter_direction

DATA = Path(__file__).parent / "data"
BLACK = DATA / "anodised_black_632nm.bsdf"
STATED = 0.05  # the file states its totals from a finer grid than the one it keeps
NODES = 1e-6
BETWEEN = 0.10  # linear on the file's grid of 5 to 20 degrees against our table's own nodes, in the whole albedo


@pytest.fixture
def brought(tmp_path: Path):
    def bring(name: str):
        assert run(["import", str(DATA / name), "-o", str(tmp_path / "r.toml")]) == 0
        return nacre.load(tmp_path / "r.toml")

    return bring


def test_a_measured_table_holds_the_totals_that_its_own_program_stated() -> None:
    from nacre.formats.bsdf_tables import _total

    table = read_zemax_table(BLACK)
    assert (table.spectral_content, table.scatter_type, table.values.shape) == ("Monochrome", "BRDF", (1, 4, 19, 21))
    i, a, r = np.meshgrid(table.incidence_deg, table.azimuth_deg, table.radial_deg, indexing="ij")
    cos_o = scatter_direction(i, a, r)[..., 2]
    np.testing.assert_allclose(_total(table.values, cos_o, table.azimuth_deg, table.radial_deg), table.tis, rtol=STATED)
    # the program goes on for a node or so below the horizon; were azimuth 0 to point away from the normal, much more
    # light would be found there
    turned = scatter_direction(i, 180 - a, r)[..., 2]
    lost = [np.count_nonzero(table.values[0][cos < -0.1]) for cos in (cos_o, turned)]
    assert lost[1] > 5 * lost[0] > 0


def test_a_measured_table_becomes_a_material_of_its_reflectance(brought) -> None:
    bsdf = brought(BLACK.name).bsdf()
    table = read_zemax_table(BLACK)
    for theta, stated in zip(table.incidence_deg, table.tis[0], strict=True):
        wi = np.array([np.sin(np.radians(theta)), 0.0, np.cos(np.radians(theta))])
        total = sum(lobe.hemispherical(wi)[0] for lobe in bsdf.lobes)
        np.testing.assert_allclose(total, stated, rtol=BETWEEN)
    wi = scatter_direction(*np.meshgrid([50.0], [0.0], [0.0], indexing="ij"))[0, 0, 0] * [-1, -1, 1]
    wo = scatter_direction(np.full(2, 50.0), np.array([90.0, 180.0]), np.array([20.0, 20.0]))
    np.testing.assert_allclose(bsdf.evaluate(wi, wo)[:, 0], [4.8321e-02, 1.3161e-01], rtol=BETWEEN)


def test_a_soap_bubble_of_materialx_is_a_free_film(brought) -> None:
    material = brought("open_pbr_soapbubble.mtlx")
    lam = np.array([450.0, 550.0, 650.0])
    found = material.spectrum([0.0], lam).specular_reflectance[0]
    r, phase = (1 - 1.4) / (1 + 1.4), np.exp(4j * np.pi * 1.4 * 500 / lam)
    np.testing.assert_allclose(found, np.abs(r * (1 - phase) / (1 - r * r * phase)) ** 2, rtol=1e-6)
    np.testing.assert_allclose(material.spectrum([0.0], lam).specular_transmittance[0], 1 - found, rtol=1e-6)


def test_what_a_thin_film_cannot_take_over_is_named(brought, capsys: pytest.CaptureFixture[str]) -> None:
    film = brought("open_pbr_pearl.mtlx").model
    assert film.stack.layers[0].thickness_nm == pytest.approx(420.0)
    said = "".join(capsys.readouterr())
    assert "not carried over: base_color, coat_ior, coat_roughness, coat_weight, subsurface_color" in said


def test_a_film_of_the_gltf_samples_has_the_thickness_of_the_specification(brought, capsys) -> None:
    import pygltflib

    material = brought("CompareIridescence.gltf")
    foreign = pygltflib.GLTF2().load(str(DATA / "CompareIridescence.gltf")).materials[1]
    film = foreign.extensions["KHR_materials_iridescence"]
    layer = material.model.stack.layers[0]
    assert layer.thickness_nm == 400.0  # the extension's own default
    assert layer.material.n_complex(np.array([550.0]))[0].real == pytest.approx(film["iridescenceIor"])
    (lobe,) = [lobe for lobe in material.bsdf().lobes if lobe.kind == "microfacet"]
    assert lobe.alpha_x == pytest.approx(foreign.pbrMetallicRoughness.roughnessFactor**2)
    assert "not carried over: baseColorTexture, metallicRoughnessTexture, iridescenceTexture" in "".join(
        capsys.readouterr()
    )
