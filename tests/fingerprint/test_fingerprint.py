"""What is kept is used again only where it would come out the same: one fingerprint, of recipe, files and code."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.analysis.sweep import run_sweep
from nacre.analysis.sweep_plan import load_sweep
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers
from nacre.families.film.material import Film
from nacre.families.grating.material import Grating
from nacre.recipe.fingerprint import file_digest, file_stamp

INDEX = "wavelength_nm,n\n300,{n}\n900,{n}\n"
SMALL: dict[str, Any] = {"size": (16, 14), "spp": 1}


def write(path: Path, text: str) -> Path:
    path.write_text(textwrap.dedent(text))
    return path


def grey(path: Path, value: int) -> None:
    Image.fromarray(np.full((4, 4), value, np.uint8)).save(path)


def film(folder: Path) -> Path:
    write(folder / "glass.csv", INDEX.format(n=1.5))
    return write(
        folder / "film.toml",
        """
        family = "film"
        substrate = "Si"
        layers = [{material = {file = "glass.csv"}, thickness_nm = 300}]
        """,
    )


def textured(folder: Path) -> Path:
    grey(folder / "map.png", 10)
    return write(
        folder / "textured.toml",
        """
        family = "film"
        substrate = "Si"
        layers = [{material = "SiO2", thickness_nm = {texture = "map.png", min = 100, max = 400}}]
        """,
    )


def blend(folder: Path) -> Path:
    film(folder)
    return write(
        folder / "blend.toml",
        """
        family = "blend"
        first = {recipe = "film.toml"}
        second = {recipe = "film.toml"}
        mask = 0.5
        """,
    )


def relief(folder: Path) -> Path:
    np.save(folder / "heights.npy", np.eye(4))
    return write(
        folder / "relief.toml",
        """
        family = "relief"
        heights = "heights.npy"
        feature_um = 1
        blur_um = 0.1
        coherence = {sigma = 0.5}
        """,
    )


def compiled(folder: Path) -> Path:
    nacre.material({"family": "film", "substrate": "Si"}).bsdf([400.0, 700.0]).save(folder / "silicon.nacre")
    return write(folder / "measured.toml", 'family = "measured"\nfile = "silicon.nacre"\n')


def other_stored(folder: Path) -> None:
    nacre.material({"family": "film", "substrate": "Ag"}).bsdf([400.0, 700.0]).save(folder / "silicon.nacre")


CASES: dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]] = {
    "index": (film, lambda folder: write(folder / "glass.csv", INDEX.format(n=1.6))),
    "texture": (textured, lambda folder: grey(folder / "map.png", 11)),
    "nested recipe": (
        blend,
        lambda folder: write(folder / "film.toml", (folder / "film.toml").read_text().replace("300", "301")),
    ),
    "file of a nested recipe": (blend, lambda folder: write(folder / "glass.csv", INDEX.format(n=1.6))),
    "heights": (relief, lambda folder: np.save(folder / "heights.npy", 2 * np.eye(4))),
    "stored": (compiled, other_stored),
}


@pytest.mark.parametrize("case", CASES)
def test_a_changed_file_makes_another_material(tmp_path: Path, case: str) -> None:
    make, change = CASES[case]
    path = make(tmp_path)
    before = nacre.load(path).fingerprint
    assert nacre.load(path).fingerprint == before
    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
    change(tmp_path)
    for file, stamp in stamps.items():  # the content counts, not the time
        os.utime(file, ns=(stamp, stamp))
    assert nacre.load(path).fingerprint != before


def test_a_moved_folder_holds_the_same_materials(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    before = nacre.load(blend(tmp_path / "here")).fingerprint
    (tmp_path / "here").rename(tmp_path / "there")
    assert nacre.load(tmp_path / "there" / "blend.toml").fingerprint == before


def test_a_model_of_another_version_is_another_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    path = blend(tmp_path / "here")
    before = nacre.load(path).fingerprint
    monkeypatch.setattr(Film, "version", Film.version + 1)  # of a nested recipe's family
    assert nacre.load(path).fingerprint != before


def test_results_of_gratings_in_larger_bases_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 800}, "layers": [{"material": "air",
              "thickness_nm": 100, "shapes": [{"shape": "line", "material": "Al", "width_nm": 400}]}]}  # fmt: skip
    before = nacre.material(recipe).fingerprint
    monkeypatch.setattr(Grating, "version", 1)
    assert nacre.material(recipe).fingerprint != before


def test_a_comment_in_the_package_changes_no_fingerprint(tmp_path: Path) -> None:
    """Caches, sweeps and searches go on after an edit that changes no numbers."""
    package = Path(nacre.__file__).parent
    copy = tmp_path / "source" / "nacre"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("*.nb?"))  # with what Python compiled, not numba
    recipe = film(tmp_path)
    plan = write(tmp_path / "sweep.toml", f'recipe = "{recipe.name}"\n[axes]\n"layers[0].thickness_nm" = [100, 200]\n')
    code = (
        "import sys, nacre\nfrom nacre.analysis.sweep_plan import load_sweep\n"
        "print(nacre.__file__, nacre.load(sys.argv[1]).fingerprint, load_sweep(sys.argv[2]).fingerprint, sep='\\n')"
    )

    def fingerprints() -> list[str]:
        environment = {**os.environ, "PYTHONPATH": str(copy.parent)}
        command = [sys.executable, "-c", code, str(recipe), str(plan)]
        where, *found = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        assert Path(where).is_relative_to(copy)
        return found

    before = fingerprints()
    sheet = next(copy.rglob("*.css"))
    sheet.write_text(sheet.read_text() + "\n/* a comment */\n")
    (copy / "_version.py").write_text('__version__ = "99.0"\n')
    assert fingerprints() == before


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("scene.xml", '<scene><texture><string name="filename" value="wall é.png"/></texture></scene>'),
        ("scene.xml", "<scene><!-- it's --><string name='filename' value='wall é.png'/></scene>"),
        ("scene.gltf", '{"buffers": [{"uri": "wall%20%C3%A9.png"}]}'),
        ("scene.gltf", r'{"buffers": [{"uri": "\u0077all \u00e9.png"}]}'),
        (
            "scene.xml",
            '<scene><default name="end" value="png"/><string name="filename" value="wall é.$end"/></scene>',
        ),
        ("scene.xml", '<scene><string name="filename" value="w&#97;ll &#xe9;.png"/></scene>'),
        (
            "scene.xml",
            '<!DOCTYPE scene [<!ENTITY w "wall">]><scene><string name="filename" value="&w; é.png"/></scene>',
        ),
    ],
)
def test_a_scene_is_also_the_files_that_it_names(tmp_path: Path, name: str, text: str) -> None:
    grey(tmp_path / "wall é.png", 10)
    scene = write(tmp_path / name, text)
    before = file_digest(scene), file_stamp(scene)
    assert before == (file_digest(scene), file_stamp(scene))
    grey(tmp_path / "wall é.png", 11)
    assert file_digest(scene) != before[0] and file_stamp(scene) != before[1]


def test_a_scene_is_also_the_files_of_its_folders_includes_and_recipes(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    names = ("maps/wall.png", "maps/film.png")
    for name in names:
        grey(tmp_path / name, 10)
    write(tmp_path / "maps" / "r.toml", 'mask = {texture = "film.png"}')
    write(tmp_path / "part.xml", '<scene><string name="filename" value="$file"/></scene>')
    scene = write(
        tmp_path / "scene.xml",
        '<scene><default name="file" value="wall.png"/><path value="maps"/><include filename="part.xml"/>'
        '<bsdf type="nacre"><string name="recipe" value="r.toml"/></bsdf></scene>',
    )
    for number, name in enumerate(names):
        before = file_digest(scene), file_stamp(scene)
        grey(tmp_path / name, 20 + number)
        assert file_digest(scene) != before[0] and file_stamp(scene) != before[1], name


def test_every_output_of_a_material_carries_its_identity(tmp_path: Path) -> None:
    material = nacre.load(film(tmp_path))
    assert material.bsdf().provenance["fingerprint"] == material.fingerprint
    assert material.vary({"layers[0].thickness_nm": 301}).fingerprint != material.fingerprint


def test_a_material_whose_nodes_are_solved_later_refuses_another_file(tmp_path: Path) -> None:
    film(tmp_path)
    grey(tmp_path / "map.png", 10)
    albedo = {"texture": "map.png", "min": 0.1, "max": 0.6}
    lacquer = {"family": "film", "substrate": {"file": "glass.csv"}, "base": {"albedo": albedo}}
    material = nacre.material(lacquer, tmp_path)
    write(tmp_path / "glass.csv", INDEX.format(n=1.6))
    with pytest.raises(NacreError, match=r"glass\.csv has changed"):
        material.bsdf()


def sweep_file(folder: Path, axes: str = '"layers[0].thickness_nm" = [100, 200]') -> Path:
    return write(
        folder / "sweep.toml",
        f"""
        recipe = "film.toml"
        [axes]
        {axes}
        [measure]
        angles_deg = [0]
        wavelengths_nm = [450, 550]
        """,
    )


def test_a_sweep_is_not_resumed_with_another_index_file(tmp_path: Path) -> None:
    film(tmp_path)
    path = sweep_file(tmp_path)
    run_sweep(load_sweep(path), tmp_path / "s.zarr", workers=Workers(1))
    write(tmp_path / "glass.csv", INDEX.format(n=1.6))
    with pytest.raises(NacreError, match="another sweep, or its recipe, a file"):
        run_sweep(load_sweep(path), tmp_path / "s.zarr", workers=Workers(1))


def test_a_sweep_is_not_resumed_with_another_file_on_an_axis(tmp_path: Path) -> None:
    film(tmp_path)
    write(tmp_path / "resin.csv", INDEX.format(n=1.4))
    path = sweep_file(tmp_path, '"layers[0].material" = ["SiO2", {file = "resin.csv"}]')
    run_sweep(load_sweep(path), tmp_path / "s.zarr", workers=Workers(1))
    write(tmp_path / "resin.csv", INDEX.format(n=1.6))
    with pytest.raises(NacreError, match="another sweep, or its recipe, a file"):
        run_sweep(load_sweep(path), tmp_path / "s.zarr", workers=Workers(1))


def test_a_file_changed_while_a_sweep_runs_is_not_read_again(tmp_path: Path) -> None:
    film(tmp_path)
    sweep = load_sweep(sweep_file(tmp_path))
    run_sweep(sweep, tmp_path / "whole.zarr", workers=Workers(1))

    def change(done: int, failed: int, total: int) -> None:
        if done == 1:
            write(tmp_path / "glass.csv", INDEX.format(n=1.6))

    assert run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(1), progress=change) == (2, 0)
    for chunk in (tmp_path / "whole.zarr").glob("lab*/c.*"):
        assert (tmp_path / "s.zarr" / chunk.parent.name / chunk.name).read_bytes() == chunk.read_bytes()
    with pytest.raises(NacreError):
        run_sweep(load_sweep(tmp_path / "sweep.toml"), tmp_path / "s.zarr", workers=Workers(1))


def test_a_search_is_not_resumed_with_another_calibration(tmp_path: Path) -> None:
    from nacre.optimise.run import read_target

    curve = write(tmp_path / "curve.csv", "0,0\n255,10\n")
    target = write(
        tmp_path / "target.toml",
        """
        features = 16
        feature_um = 0.8
        blur_um = 0.13
        height_max_um = 0.8
        calibration = "curve.csv"
        coherence = {sigma = 1.0}
        target = {kind = "anti-mirror", range = 0.5, resolution = 16}
        """,
    )

    def fingerprint() -> str:
        return read_target(target).fingerprint

    before = fingerprint()
    assert fingerprint() == before
    write(curve, "0,0\n255,11\n")
    assert fingerprint() != before


@pytest.mark.render
def test_an_animation_keeps_no_frame_of_another_texture(tmp_path: Path) -> None:
    path = textured(tmp_path)
    movie = tmp_path / "turn.gif"
    nacre.render.animate(nacre.load(path), "light", movie, frames=2, **SMALL)
    assert nacre.render.animate(nacre.load(path), "light", movie, frames=2, **SMALL).reused == 2
    grey(tmp_path / "map.png", 200)
    assert nacre.render.animate(nacre.load(path), "light", movie, frames=2, **SMALL).reused == 0


@pytest.mark.render
def test_an_animation_keeps_no_frame_of_other_components(tmp_path: Path) -> None:
    lacquer = {"family": "film", "substrate": {"n": 1.5}, "surface": {"roughness": 0.3}, "base": {"albedo": 0.25}}
    movie = tmp_path / "turn.gif"
    for components in ("specular", "diffuse"):
        made = nacre.render.animate(nacre.material(lacquer), "light", movie, frames=1, components=components, **SMALL)
        assert made.reused == 0


@pytest.mark.render
def test_a_damaged_frame_is_rendered_again(tmp_path: Path) -> None:
    material, movie = nacre.material({"family": "film", "substrate": "Si"}), tmp_path / "turn.gif"
    frames = nacre.render.animate(material, "light", movie, frames=3, **SMALL).frames
    content = bytearray(frames[0].read_bytes())
    place = content.index(b"IDAT") + 40  # in the pixels; what the frame says about itself stands before them
    content[place] ^= 0xFF
    frames[0].write_bytes(content)
    frames[1].write_bytes(frames[1].read_bytes()[:-30])
    assert nacre.render.animate(material, "light", movie, frames=3, **SMALL).reused == 1


@pytest.mark.render
def test_an_animation_that_fails_leaves_no_folder(tmp_path: Path) -> None:
    material = nacre.material({"family": "film", "substrate": "Si"})
    with pytest.raises(NacreError):
        nacre.render.animate(material, "nothing=1:2", tmp_path / "turn.gif", frames=2, **SMALL)
    with pytest.raises(NacreError):
        nacre.render.animate(material, "light", tmp_path / "turn.gif", frames=2, scene="nowhere", **SMALL)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.render
def test_an_animation_takes_which_way_a_mesh_is_up(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(tmp_path / "box.ply")
    material, mesh = nacre.material({"family": "film", "substrate": "Si"}), tmp_path / "box.ply"
    for up in ("x", "y"):
        made = nacre.render.animate(material, "light", tmp_path / "t.gif", frames=1, shape=mesh, up=up, **SMALL)
        assert made.reused == 0
