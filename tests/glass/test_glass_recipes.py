"""What a recipe of photonic glass builds, and what it refuses in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.families.glass.medium import percus_yevick

PLAIN: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 20,
    "matrix": "air",
    "spheres": {"material": {"n": 1.59}, "radius_nm": 125, "volume_fraction": 0.55},
}
LAM = [450.0, 550.0, 650.0]


def varied(**changes: Any) -> dict[str, Any]:
    data = {key: (dict(value) if isinstance(value, dict) else value) for key, value in PLAIN.items()}
    for path, value in changes.items():
        holder, *last = path.split("__")
        if last:
            data[holder] = {**data.get(holder, {}), last[0]: value}
        else:
            data[holder] = value
    return data


def reflectance(data: dict[str, Any], folder: Path | str = ".") -> Any:
    found = nacre.material(data, folder).spectrum([0.0], LAM)
    assert found.diffuse_reflectance is not None
    return found.diffuse_reflectance[0]


REFUSED = {
    "denser than random packing": (varied(spheres__volume_fraction=0.7), "volume_fraction = 0.7 .*at most 0.64"),
    "nothing there": (varied(spheres__volume_fraction=0.0), "volume_fraction = 0.0 .*above 0"),
    "spheres larger than the layer": (varied(thickness_um=0.5), "thickness_um = 0.5 .*at least 0.75"),
    "spheres larger than waves": (varied(spheres__radius_nm=900), "radius_nm = 900 .*500"),
    "gain": (varied(absorber__k=-0.1), "absorber.*k = -0.1 .*gain"),
    "two absorbers": (varied(absorber={"k": 0.1, "material": "Ag", "volume_fraction": 0.1}), "give k or material"),
    "half an absorber": (varied(absorber={"material": "Ag"}), "belong together"),
    "wide sizes": (varied(spheres__deviation_nm=60), "deviation_nm = 60 .*at most 0.2"),
    "metal": (varied(spheres__material={"n": 1.0, "k": 4.0}), "effective_index = \"bruggeman\" fails: .*solved"),
    "too black": (varied(absorber__k=2.0), "absorbs too much"),
    "shell and Maxwell Garnett": (
        varied(
            spheres__shell={"material": "SiO2", "thickness_nm": 10}, model={"effective_index": "maxwell-garnett"}
        ),
        "not allowed with a shell",
    ),
    "unknown structure": (varied(model={"structure": "crystal"}), 'structure = "crystal" is not known'),
    "no file": (varied(model={"structure": {"sq": "none.csv"}}), r'"none.csv" is not usable: does not exist'),
    "unknown key": (varied(spheres__radios_nm=3), "radios_nm is not known"),
    "a base without a family": (varied(base={"recipe": {"albedo": 0.5}}), "base: recipe has no family"),
}  # fmt: skip


@pytest.mark.parametrize("target", ["rgl", "csv"])
def test_a_walk_is_exported_by_its_fast_form_and_the_refusal_says_so(tmp_path: Path, target: str) -> None:
    with pytest.raises(UnsupportedError, match=f'a file of kind {target} holds values; give it quality = "fast"'):
        nacre.export(nacre.material(PLAIN), target, tmp_path / "glass")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(case: str) -> None:
    data, message = REFUSED[case]
    with pytest.raises(RecipeError, match=message) as caught:
        nacre.material(data)
    assert "\n" not in str(caught.value)


def test_polarised_light_is_refused() -> None:
    with pytest.raises(NacreError, match="unpolarised"):
        nacre.material(PLAIN).spectrum([0.0], LAM, "s")


def test_a_file_of_the_structure_serves_as_the_formula_does(tmp_path: Path) -> None:
    q = np.linspace(0, 80, 4001)  # 1/um
    table = np.stack([q, percus_yevick(q * 0.25, 0.55)], axis=1)
    np.savetxt(tmp_path / "s.csv", table, delimiter=",", header="q,S")
    found = reflectance(varied(model={"structure": {"sq": "s.csv"}}), tmp_path)
    np.testing.assert_allclose(found, reflectance(PLAIN), rtol=1e-3)


def test_the_structure_of_a_file_is_used(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("0 1\n1 1\n50 1\n60 1\n")
    assert np.all(
        np.abs(reflectance(varied(model={"structure": {"sq": "s.csv"}}), tmp_path) - reflectance(PLAIN)) > 0.02
    )


def test_an_absorber_may_be_a_number_or_a_material() -> None:
    number = reflectance(varied(absorber={"k": 0.003}))
    material = reflectance(varied(absorber={"material": {"n": 1.8, "k": 0.6}, "volume_fraction": 0.005}))
    np.testing.assert_allclose(number, material, rtol=1e-9)
    assert np.all(number < 0.8 * reflectance(PLAIN))


def test_a_shell_of_the_cores_material_is_a_larger_sphere() -> None:
    coated = varied(spheres__radius_nm=105, spheres__shell={"material": {"n": 1.59}, "thickness_nm": 20})
    np.testing.assert_allclose(reflectance(coated), reflectance(PLAIN), rtol=1e-6)


def test_a_narrow_spread_of_sizes_changes_little_and_a_wide_one_blurs_the_peak() -> None:
    narrow = reflectance(varied(spheres__deviation_nm=0.5))
    np.testing.assert_allclose(narrow, reflectance(PLAIN), rtol=0.02)
    # with a black matrix the peak of order stands out over the valley before it
    peaks = []
    for deviation in (0.0, 20.0):
        data = varied(spheres__deviation_nm=deviation, absorber__k=0.003)
        found = nacre.material(data).spectrum([0.0], [505.0, 560.0]).diffuse_reflectance
        assert found is not None
        peaks.append(found[0, 1] - found[0, 0])
    assert peaks[1] < 0.5 * peaks[0] and peaks[0] > 0.02


def test_colour_keeps_with_the_angle() -> None:
    """The point of the family: the peak of the diffuse light hardly moves where a Bragg mirror's would by a fifth."""
    lam = np.arange(400, 701, 10.0)
    found = nacre.material(varied(absorber={"k": 0.004})).spectrum(np.radians([0, 60]), lam).diffuse_reflectance
    assert found is not None
    window = (lam > 500) & (lam < 680)
    peaks = [lam[window][np.argmax(row[window])] for row in found]
    assert abs(peaks[1] / peaks[0] - 1) < 0.06
