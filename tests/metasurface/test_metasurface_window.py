"""A pane of glass with spheres on one face: its other face and what passes between them."""

from pathlib import Path

import numpy as np
import pytest

from nacre.material.material import material

pytestmark = pytest.mark.render

PANE = Path(__file__).parents[2] / "examples" / "metasurface" / "window-pane.xml"
LIGHT_BAR = 0.02
CLEAR = {
    "family": "metasurface",
    "substrate": {"n": 1.5},
    "particle": {"material": {"n": 3.5}, "radius_nm": 70},
    "monolayer": {"coverage": 0.1, "packing": 0.4},
    "model": {"multipole_order": 5, "correction": "qca-balanced"},
}


@pytest.mark.parametrize("y", [-3.4, 3.4], ids=["coated side", "bare side"])
def test_a_clear_window_in_uniform_light_cannot_be_seen(tmp_path, y):
    """Nothing is absorbed: specular, diffuse, refracted and guided light add up to what a hole would show."""
    from tested_variant import use_tested_variant

    from nacre.render import make_bsdf

    mi = use_tested_variant()
    text = f"""<scene version="3.0.0">
        <integrator type="path"><integer name="max_depth" value="300"/>
            <integer name="rr_depth" value="300"/></integrator>
        <include filename="{PANE}"/>
        <sensor type="perspective"><float name="fov" value="6"/>
            <transform name="to_world"><lookat origin="1.2, {y}, 0.6" target="0, 0, 0" up="0, 0, 1"/></transform>
            <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
    </scene>"""
    (tmp_path / "scene.xml").write_text(text)
    scene = mi.load_file(str(tmp_path / "scene.xml"))
    bsdf = make_bsdf(material(CLEAR).bsdf(np.arange(400.0, 701.0, 60.0)))
    for shape in scene.shapes():
        if shape.bsdf().id() == "nacre":
            shape.set_bsdf(bsdf)
    luminance = float(np.array(mi.render(scene, spp=512, seed=1))[..., 1].mean())
    hole = mi.load_dict({"type": "scene", "e": {"type": "constant", "radiance": {"type": "rgb", "value": 0.25}},
                         "integrator": {"type": "path"}, "sensor": scene.sensors()[0]})  # fmt: skip
    empty = float(np.array(mi.render(hole, spp=512, seed=2))[..., 1].mean())
    assert abs(luminance / empty - 1) <= LIGHT_BAR
