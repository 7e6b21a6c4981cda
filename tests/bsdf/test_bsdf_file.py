"""The .nacre file: what goes in comes out; what is broken is refused in one line."""

from __future__ import annotations

import dataclasses
import functools
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers_bsdf import WAVELENGTHS, dielectric, mirror, random_directions

from nacre.bsdf import Bsdf, ParameterAxis
from nacre.bsdf.compensation import compensate
from nacre.bsdf.file import HEADER, VERSION, check_fields
from nacre.bsdf.lobes.interface import Diffuse, Microfacet, Specular
from nacre.bsdf.lobes.monolayer import Harmonic
from nacre.bsdf.lobes.ridge import RidgeTable
from nacre.bsdf.texture import Texture, parse_formula
from nacre.core.errors import NacreError
from nacre.families.film import Ridges


@functools.cache
def bsdf() -> Bsdf:
    """Return one Bsdf with every lobe of the films, textures of both kinds and a parameter axis."""
    axis = ParameterAxis("layers[0].thickness_nm", np.linspace(0, 10, 3), Texture(0, 10, parse_formula("10*u")))
    image = Texture(0.1, 0.5, image=np.linspace(0, 1, 12).reshape(3, 4))
    varying = Diffuse(WAVELENGTHS, np.full((3, 3), 0.5), np.linspace(0, 1, 3 * 5 * 3).reshape(3, 5, 3), (axis,))
    lobes = (
        Specular(dielectric(1.5)),
        compensate(Microfacet(dielectric(1.5, 33), "ggx", 0.2, 0.4, rotation=image)),
        Microfacet(mirror(), "blinn", 1.0, 1.0, alpha_texture=image),
        Ridges(700, 300, 120).lobe(mirror()),
        RidgeTable(WAVELENGTHS, np.full((2, 3, 3, 3), 0.25, dtype=np.float32), 0.07, 0.9, rotation=image),
        varying,
        Diffuse(WAVELENGTHS, np.array([0.1, 0.2, 0.3]), np.ones((1, 3))),
    )
    return Bsdf(lobes, {"recipe": "family = 'film'", "seed": 3, "notes": [1.5, None, "x"]})


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "all.nacre"
    bsdf().save(path)
    return path


def edit_header(path: Path, change: dict) -> Path:
    """Write a copy whose header has some keys changed."""
    out = path.with_name("edited.nacre")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == HEADER:
                content = json.dumps({**json.loads(content), **change}).encode()
            new.writestr(name, content)
    return out


def refused(path: Path) -> str:
    """Return the message with which a file is refused: one line that begins with its name."""
    with pytest.raises(NacreError) as caught:
        Bsdf.load(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path)) and len(message) < 400
    return message


def test_a_stored_bsdf_is_the_same_to_the_last_bit(stored: Path) -> None:
    before, after = bsdf(), Bsdf.load(stored)
    wi, wo = random_directions(200, 1), random_directions(200, 2)
    uv = np.random.default_rng(3).random((200, 2))
    np.testing.assert_array_equal(before.evaluate(wi, wo, uv), after.evaluate(wi, wo, uv))
    np.testing.assert_array_equal(before.specular(0.3).transmittance, after.specular(0.3).transmittance)
    assert after.provenance == dict(before.provenance)
    assert after.transmits


@pytest.mark.parametrize("index", [0.0, -1.5, 1e9])
def test_an_impossible_relative_index_is_refused(tmp_path: Path, index: float) -> None:
    path, response = tmp_path / "index.nacre", dielectric(1.5)
    good = np.linspace(1.49, 1.51, len(WAVELENGTHS))
    Bsdf((Specular(dataclasses.replace(response, relative_index=good)),)).save(path)
    found = Bsdf.load(path).lobes[0]
    assert isinstance(found, Specular)
    np.testing.assert_array_equal(found.response.relative_index, good)
    Bsdf((Specular(dataclasses.replace(response, relative_index=np.full(len(WAVELENGTHS), index))),)).save(path)
    refused(path)


def test_the_same_bsdf_makes_the_same_bytes(tmp_path: Path, stored: Path) -> None:
    again = tmp_path / "again.nacre"
    bsdf().save(again)
    assert again.read_bytes() == stored.read_bytes()


def test_the_header_says_what_is_inside(stored: Path) -> None:
    with zipfile.ZipFile(stored) as zipped:
        header = json.loads(zipped.read(HEADER))
        names = set(zipped.namelist())
    assert header["format"] == "nacre-bsdf" and header["version"] == VERSION
    assert [lobe["type"] for lobe in header["lobes"]] == [
        "specular",
        "microfacet",
        "microfacet",
        "ridge",
        "ridge-table",
        "diffuse",
        "diffuse",
    ]
    assert header["arrays"]["lobe0.response.reflectance"]["axes"] == "*params cos wavelength"
    assert names == {HEADER} | {f"{name}.npy" for name in header["arrays"]}


def test_a_newer_version_is_refused(stored: Path) -> None:
    assert "newer" in refused(edit_header(stored, {"version": VERSION + 1}))
    # whoever wrote it cannot fill the screen: 40 letters of its name are shown
    said = refused(edit_header(stored, {"version": VERSION + 1, "nacre": "x" * 1000}))
    assert said.count("x" * 40) == 1 and "x" * 41 not in said


@pytest.mark.parametrize("keep", [0, 10, 0.3, 0.9, 0.999])
def test_a_file_cut_short_is_refused(stored: Path, keep: float) -> None:
    content = stored.read_bytes()
    stored.write_bytes(content[: int(keep if keep > 1 else keep * len(content))])
    refused(stored)


def test_flipped_bits_are_refused_or_harmless(stored: Path) -> None:
    content = bytearray(stored.read_bytes())
    good = Bsdf.load(stored)
    rng = np.random.default_rng(1)
    wi, wo = random_directions(20, 1), random_directions(20, 2)
    refusals = 0
    for _ in range(60):
        at = int(rng.integers(len(content)))
        broken = bytearray(content)
        broken[at] ^= 1 << int(rng.integers(8))
        stored.write_bytes(broken)
        try:
            loaded = Bsdf.load(stored)
        except NacreError as error:
            assert "\n" not in str(error)
            refusals += 1
        else:  # a bit of a date or an attribute of the zip: the content must be what it was
            np.testing.assert_array_equal(loaded.evaluate(wi, wo), good.evaluate(wi, wo))
    assert refusals > 40


def test_a_huge_array_is_refused_before_memory_is_taken(stored: Path) -> None:
    with zipfile.ZipFile(stored) as zipped:
        arrays = json.loads(zipped.read(HEADER))["arrays"]
    arrays["lobe0.response.reflectance"]["shape"] = [2**31 - 1, 2**31 - 1]
    refused(edit_header(stored, {"arrays": arrays}))


def test_a_pickle_is_never_opened(tmp_path: Path, stored: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple:
            return (Path.touch, (tmp_path / "exploded",))

    out = tmp_path / "bomb.nacre"
    with zipfile.ZipFile(stored) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "lobe0.response.reflectance.npy":
                bomb = pickle.dumps(Bomb())
                header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
                content = (header.ljust(127) + b"\n" + bomb).ljust(len(content))
            new.writestr(name, content)
    refused(out)
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"lobes": []},
        {"lobes": [{"type": "specular", "fields": {}}]},
        {"lobes": [{"type": "table-of-a-later-nacre", "fields": {}}]},
        {"lobes": [{"type": "texture", "fields": {"low": 0, "high": 1}}]},
        {"lobes": 3},
        {"lobes": None},
        {"arrays": {}},
        {"version": "one"},
        {"format": "other"},
        {"lobes": [[[[]]]]},
    ],
)
def test_nonsense_in_the_header_is_refused(stored: Path, change: dict) -> None:
    refused(edit_header(stored, change))


def test_other_files_are_refused(tmp_path: Path) -> None:
    assert "does not exist" in refused(tmp_path / "none.nacre")
    (tmp_path / "folder.nacre").mkdir()
    refused(tmp_path / "folder.nacre")
    text = tmp_path / "text.nacre"
    text.write_text("family = 'film'")
    refused(text)
    empty = tmp_path / "zip.nacre"
    with zipfile.ZipFile(empty, "w") as zipped:
        zipped.writestr("a.txt", "b")
    refused(empty)


def test_what_is_not_finite_is_never_written(tmp_path: Path) -> None:
    bad = Diffuse(WAVELENGTHS, np.array([0.1, np.nan, 0.3]), np.ones((1, 3)))
    with pytest.raises(NacreError, match="finite"):
        Bsdf((bad,)).save(tmp_path / "bad.nacre")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_does_not_exist_is_reported(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match="does not exist"):
        bsdf().save(tmp_path / "no" / "x.nacre")


def test_the_harmonic_lobe_accepts_read_only_tables_beside_writable_ones() -> None:
    waves = np.array([450.0, 550.0, 650.0])
    above = np.random.default_rng(1).random((3, 2, 3)).astype(np.float32)
    empty = np.zeros((0, 2, 3), np.float32)
    ones = np.ones(3)
    lobe = Harmonic(waves, 2, 0, 0, 1.0, ones, ones, 0.1, np.ones(4), above, empty, empty, empty, empty, empty)
    wi, wo = np.array([0.3, 0.1, 0.9]), np.array([-0.2, 0.4, 0.8])
    wi, wo = wi / np.linalg.norm(wi), wo / np.linalg.norm(wo)
    expected = lobe.evaluate(wi, wo)
    frozen = above.copy()
    frozen.flags.writeable = False
    assert np.array_equal(dataclasses.replace(lobe, above=frozen).evaluate(wi, wo), expected)


def test_a_compiled_film_has_its_mueller_matrices(tmp_path: Path) -> None:
    import nacre

    film = {"family": "film", "substrate": 1.5, "layers": [{"material": 2.0, "thickness_nm": 100}]}
    made = nacre.material(film).bsdf([500.0, 600.0])
    made.save(tmp_path / "a.nacre")
    matrices = nacre.load(tmp_path / "a.nacre").bsdf().polarisation()
    for name in ("reflected", "reflected_inside", "total", "transmitted"):
        # single precision in the file
        np.testing.assert_allclose(getattr(matrices, name), getattr(made.polarisation(), name), atol=1e-6)
    header, arrays = parts(tmp_path / "a.nacre")
    header["polarisation"]["fields"]["total"] = header["polarisation"]["fields"]["reflected"]["array"]
    with zipfile.ZipFile(tmp_path / "b.nacre", "w") as zipped:
        zipped.writestr(HEADER, json.dumps(header))
        for name, content in arrays.items():
            zipped.writestr(name, content)
    with pytest.raises(NacreError):
        Bsdf.load(tmp_path / "b.nacre")


def parts(path: Path) -> tuple[dict, dict[str, bytes]]:
    with zipfile.ZipFile(path) as zipped:
        arrays = {name: zipped.read(name) for name in zipped.namelist() if name != HEADER}
        return json.loads(zipped.read(HEADER)), arrays


@pytest.mark.parametrize(
    "changed", [{"fill": "0.9"}, {"power": np.full((2, 3, 3, 3), 0.25j)}, {"spread_along": None}, {"fill": (0.9,)}]
)
def test_fields_of_another_type_are_refused(changed: dict) -> None:
    lobe = bsdf().lobes[4]
    check_fields(lobe)
    with pytest.raises(ValueError):
        check_fields(dataclasses.replace(lobe, **changed))
