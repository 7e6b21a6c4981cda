"""Light that goes straight through a clear surface reaches what lies behind it, coloured by what it passed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre

pytestmark = pytest.mark.render

# a sheet at height 2 in a parallel beam; the camera sees the floor below from the side, and not through the sheet
SCENE = """<scene version="3.0.0">
  <emitter type="directional"><vector name="direction" value="{direction}"/>
    <spectrum name="irradiance" value="3"/></emitter>
  <shape type="rectangle"><transform name="to_world"><scale value="30"/></transform>
    <bsdf type="diffuse"><spectrum name="reflectance" value="0.1"/></bsdf></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="4"/><translate value="{place}, 0, 2"/></transform>
    <bsdf type="diffuse" id="nacre"/></shape>
  <sensor type="perspective"><float name="fov" value="6"/>
    <transform name="to_world"><lookat origin="0.6,-7,1.5" target="0.6,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
</scene>"""
SOAP = {"family": "film", "substrate": "air", "layers": [{"material": {"n": 1.33}, "thickness_nm": 240}]}
# 2 % of flakes in 20 um: about half of the light meets none
FOIL: dict[str, Any] = {
    "family": "pearl",
    "strata": [
        {
            "resin": {"n": 1.5}, "thickness_um": 20, "roughness": 0,
            "platelets": [{"volume_fraction": 0.02, "substrate": {"material": "SiO2", "thickness_nm": 80},
                           "coatings": [{"material": "TiO2", "thickness_nm": 105}], "normal_deviation": 0.02}],
        }
    ],
    "base": {"none": True, "roughness": 0},
}  # fmt: skip


def _floor(folder: Path, material: Any, place: float, tilt: float, **options: Any) -> np.ndarray:
    """Mean XYZ of the floor where the sheet's shadow falls, or, with the sheet far away, of the open floor."""
    scene = folder / f"scene{place:g}.xml"
    scene.write_text(SCENE.format(direction=f"{np.tan(tilt):.9f}, 0, -1", place=place))
    settings = {"spp": 64, "exposure": 0.0, "denoise": False, "progress": False, **options}
    return np.asarray(nacre.render(material, str(scene), **settings).xyz.mean(axis=(0, 1)))


def _passes(material: Any, angle_deg: float) -> np.ndarray:
    """XYZ of the light of equal energy that the smooth material lets straight through, of the light before it."""
    from nacre.light import xyz_weights

    grid = np.arange(400.0, 701.0, 5.0)
    spectrum = nacre.spectrum(material, angle_deg, grid)
    weights = xyz_weights(grid, "E")
    return np.asarray((spectrum.specular_transmittance[0] @ weights) / weights.sum(axis=0))


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0])
def test_a_films_shadow_is_what_it_lets_through(tmp_path: Path, tilt_deg: float) -> None:
    """Within 3 %: what floor and film throw to and fro is some 1 % of it, the noise as much."""
    film = nacre.material(SOAP)
    tilt = np.radians(tilt_deg)
    shade, open_floor = (_floor(tmp_path, film, place, tilt) for place in (0.6 - 2 * np.tan(tilt), 900.0))
    np.testing.assert_allclose(shade / open_floor, _passes(film, tilt_deg), rtol=0.03)


def test_a_mask_lets_its_share_through(tmp_path: Path) -> None:
    for name, thickness in (("thin", 1), ("soap", 240)):
        (tmp_path / f"{name}.toml").write_text(
            f'family = "film"\nsubstrate = "air"\nlayers = [{{material = {{n = 1.33}}, thickness_nm = {thickness}}}]\n'
        )
    parts = {"first": {"recipe": "soap.toml"}, "second": {"recipe": "thin.toml"}}
    blend = nacre.material({"family": "blend", **parts, "mask": 0.5}, tmp_path)
    shade, open_floor = (_floor(tmp_path, blend, place, 0.0) for place in (0.6, 900.0))
    np.testing.assert_allclose(shade / open_floor, 0.5 + 0.5 * _passes(nacre.material(SOAP), 0.0), rtol=0.03)


@pytest.mark.full
def test_a_foils_shadow_holds_what_met_no_flake(tmp_path: Path) -> None:
    """And besides what its flakes scatter down, which is no more than all the light that they let pass."""
    foil = nacre.material(FOIL)
    shade, open_floor = (_floor(tmp_path, foil, place, 0.0, spp=256) for place in (0.6, 900.0))
    straight = _passes(foil, 0.0)
    assert (straight > 0.2).all() and (straight < 0.9).all()
    assert (shade / open_floor > 0.95 * straight).all()
    assert (shade / open_floor < 1.0).all()
