"""Every command that writes, killed at random moments: nothing half-written, nothing lost, nothing left.

After each kill all files have their names and are whole: the old ones or the new ones. A run that is left alone then
ends well, and leaves what it leaves in an empty folder and nothing else: no temporary file of those killed before.
"""

from __future__ import annotations

import json
import random
import shutil
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from helpers_crash import Forker, check_whole, forker, names, visible

import nacre
from nacre.analysis.sweep import DONE

pytestmark = pytest.mark.full

FILM = """family = "film"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 300}]
surface = {roughness = 0.2}
tolerance = {"layers[0].thickness_nm" = 5}
fit = {"layers[0].thickness_nm" = {min = 250, max = 350}}
"""
SMOOTH = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 120}]\n'
METASURFACE = """family = "metasurface"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 100}]
[particle]
material = {n = 2.0}
radius_nm = 60
[monolayer]
coverage = 0.05
[model]
multipole_order = 1
"""
RELIEF = """family = "relief"
heights = "heights.npy"
feature_um = 2
blur_um = 0.6
[coherence]
sigma = 1.5
"""
GRATING = """family = "grating"
substrate = "Al"
profile = {shape = "sinusoidal", depth_nm = 60}
lattice = {period_nm = 800}
"""
SWEEP = """recipe = "smooth.toml"
[axes]
"layers[0].thickness_nm" = {start = 100, stop = 200, count = 600}
[measure]
angles_deg = [0]
"""
TARGET = """family = "relief"
features = 8
feature_um = 1.5
blur_um = 0.5
height_max_um = 0.6
coating = "Al"
coherence = {sigma = 0.8}
spectrum = "published-8"
[target]
kind = "anti-mirror"
colour = "white"
range = 0.3
resolution = 12
intensity_scale = 0.2
[search]
starts = 2
perturbed_restarts = 1
"""
MANY = """recipe = "smooth.toml"
[parameters]
"layers[0].thickness_nm" = {min = 50, max = 400}
[[target]]
geometry = "specular 0"
colour = "#336699"
"""
PAINT = """[recipe]
family = "pearl"
base = {albedo = 0.1}
strata = [{resin = {n = 1.5}, thickness_um = 40}]
[library]
resin = {cost_per_kg = 4, density_kg_l = 1.0}
[[library.pigment]]
name = "silver"
volume_fraction = [0, 0.03]
cost_per_kg = 45
density_kg_l = 2.5
platelet = {coatings = [{material = "Al", thickness_nm = 60}]}
[[library.dye]]
name = "red"
volume_fraction = [0, 0.02]
cost_per_kg = 40
density_kg_l = 1.5
dye = {material = "Fe2O3"}
[[target]]
geometry = "45as45"
lab = [50, 5, 5]
tolerance = 0.3
[search]
solutions = 2
"""
BYSTANDER = "notes.txt"
MOST_ATTEMPTS = 20  # a kill: what takes some milliseconds alone on a quick machine is often over before it comes
OLD = b"what was here before\n"


@dataclass(frozen=True)
class Case:
    """A command, the outputs that are already there when it starts, and how many kills it takes.

    Attributes:
        makes: the file that a second run would write over.
    """

    arguments: tuple[str, ...]
    makes: str
    kills: int = 6


CASES = {
    "spectrum": Case(("spectrum", "film.toml", "-o", "out.csv"), "out.csv"),
    "evaluate": Case(("evaluate", "film.toml", "--directions", "directions.npz", "-o", "out.npz"), "out.npz"),
    "plot": Case(("plot", "film.toml", "--kind", "spectrum", "-o", "out.png"), "out.png"),
    "compile": Case(("compile", "meta.toml", "-o", "out.nacre", "--no-cache"), "out.nacre", 4),
    "export-rgl": Case(("export", "film.toml", "--to", "rgl", "-o", "out.bsdf"), "out.bsdf"),
    "export-csv": Case(("export", "film.toml", "--to", "csv", "--angle-step-deg", "30", "-o", "out.csv"), "out.csv"),
    "export-gltf": Case(("export", "smooth.toml", "--to", "gltf", "-o", "out.gltf"), "out.gltf", 3),
    "import": Case(("import", "measured.csv", "-o", "out.toml"), "out.toml"),
    "fabricate-png16": Case(("fabricate", "relief.toml", "--to", "png16", "-o", "out.png"), "out.png"),
    "fabricate-stl": Case(("fabricate", "relief.toml", "--to", "stl", "-o", "out.stl"), "out.stl"),
    "fabricate-gds": Case(("fabricate", "relief.toml", "--to", "oas", "-o", "out.oas"), "out.oas", 4),
    "fabricate-sheet": Case(("fabricate", "film.toml", "--to", "sheet", "-o", "out.csv"), "out.csv", 4),
    "report": Case(("report", "smooth.toml", "-o", "out.html"), "out.html", 5),
    "tolerance": Case(("tolerance", "smooth.toml", "--tolerance", "layers[0].thickness_nm=5", "--draws", "20",
                       "-o", "out.json"), "out.json", 5),
    "fit": Case(("fit", "measured-spectrum.csv", "film.toml", "--starts", "1", "--residual", "out.npz",
                 "-o", "out.toml"), "out.toml", 5),
    "gamut": Case(("gamut", "smooth.toml", "--parameter", "layers[0].thickness_nm=50:400", "--points", "200",
                   "-o", "out.json"), "out.json", 5),
    "orders": Case(("orders", "grating.toml", "--wavelengths-nm", "450,600", "-o", "out.csv"), "out.csv", 3),
    "ellipsometry": Case(("ellipsometry", "smooth.toml", "-o", "out.csv"), "out.csv", 3),
    "runsheet": Case(("runsheet", "smooth.toml", "-o", "out.json"), "out.json", 3),
    "diagnose": Case(("diagnose", "measured-spectrum.csv", "film.toml", "-o", "out.toml"), "out.toml", 3),
    "export-materialx": Case(("export", "smooth.toml", "--to", "materialx", "-o", "out.mtlx"), "out.mtlx", 3),
    "export-nacre": Case(("export", "film.toml", "--to", "nacre", "-o", "out.nacre"), "out.nacre", 3),
    "blender": Case(("blender", "-o", "out.zip"), "out.zip", 3),
    "indices": Case(("indices", "show", "Au", "-o", "out.png"), "out.png", 4),
    "render-png": Case(("render", "film.toml", "--size", "48x48", "--spp", "4", "-o", "out.png"), "out.png", 5),
    "render-exr": Case(("render", "film.toml", "--size", "48x48", "--spp", "4", "-o", "out.exr"), "out.exr", 4),
}  # fmt: skip


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forker]:
    with forker(tmp_path_factory.mktemp("cache")) as made:
        yield made


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    texts = {"film": FILM, "smooth": SMOOTH, "meta": METASURFACE, "relief": RELIEF, "sweep": SWEEP, "target": TARGET}
    texts |= {"many": MANY, "grating": GRATING, "paint": PAINT, "other": SMOOTH.replace("120", "260")}
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text)
    np.save(folder / "heights.npy", np.random.default_rng(1).random((24, 24)) * 0.3)
    toward = np.random.default_rng(2).normal(size=(4000, 3))
    toward[:, 2] = np.abs(toward[:, 2]) + 0.1
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    np.savez(folder / "directions.npz", wi=toward, wo=toward[::-1])
    film = nacre.load(folder / "film.toml")
    nacre.export(film, "csv", folder / "measured.csv", angle_step_deg=30.0)
    found = film.spectrum([0.0], np.arange(400.0, 701.0, 10.0))
    assert found.specular_reflectance is not None
    rows = [f"{nm:g},{r:.6f}" for nm, r in zip(found.wavelengths_nm, found.specular_reflectance[0], strict=True)]
    (folder / "measured-spectrum.csv").write_text("\n".join(["wavelength_nm,specular_reflectance", *rows]) + "\n")
    (folder / BYSTANDER).write_bytes(OLD)
    return folder


def fresh(inputs: Path, folder: Path) -> Path:
    shutil.copytree(inputs, folder)
    return folder


def check_after_kill(folder: Path, reference: Path, before: dict[str, bytes]) -> None:
    """Nothing half-written, nothing lost."""
    found = visible(folder)
    assert set(before) <= set(found), "a file was lost"
    for name, path in found.items():
        assert name in visible(reference), f"{name} came from nowhere"
        check_whole(path, before.get(name), reference / name)


def contents(folder: Path) -> dict[str, bytes]:
    return {name: path.read_bytes() for name, path in visible(folder).items()}


def checked_kill(
    warm: Forker, arguments: list[str], folder: Path, reference: Path, chance: random.Random, seconds: float
) -> bool:
    """Kill a command at a random moment and check its files; False if it ended before."""
    before = contents(folder)
    is_killed = warm.kill(arguments, folder, chance, seconds)
    check_after_kill(folder, reference, before)
    return is_killed


@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_a_killed_command_leaves_the_old_output_or_the_new_one(
    name: str, warm: Forker, inputs: Path, tmp_path: Path
) -> None:
    case, chance = CASES[name], random.Random(f"kill {name}")
    arguments = list(case.arguments)
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    warm.run(arguments, reference)  # compiles what is not yet compiled
    seconds = warm.run(arguments, reference)
    assert (reference / case.makes).is_file()
    killed = 0
    for attempt in range(MOST_ATTEMPTS * case.kills):
        if killed == case.kills:
            break
        if attempt == case.kills // 2:  # first into an empty place, then over an old output
            for made in set(visible(folder)) - set(visible(inputs)):
                (folder / made).unlink()
            (folder / case.makes).write_bytes(OLD)
        killed += checked_kill(warm, arguments, folder, reference, chance, seconds)
    assert killed == case.kills, "the command ended before it could be killed"
    warm.run(arguments, folder)
    assert names(folder) == names(reference)
    check_after_kill(folder, reference, {})
    assert (folder / BYSTANDER).read_bytes() == OLD


@pytest.mark.parametrize("name", ["lut", "three"])
def test_a_killed_export_leaves_the_old_folder_or_the_new_one(
    name: str, warm: Forker, inputs: Path, tmp_path: Path
) -> None:
    """The folder of an earlier export is replaced as a whole: at no moment is it gone, or mixed."""
    new, old = (["export", f"{recipe}.toml", "--to", name, "-o", "out"] for recipe in ("smooth", "other"))
    chance = random.Random(name)
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    warm.run(new, reference)
    seconds = warm.run(new, reference)
    wanted = contents(reference)
    warm.run(old, folder)
    before = contents(folder)
    differing = {path for path in wanted if wanted[path] != before.get(path)}
    assert differing
    killed = 0
    for _ in range(MOST_ATTEMPTS):
        if killed == 3:
            break
        is_killed = warm.kill(new, folder, chance, seconds)
        now = contents(folder)
        assert set(now) == set(before)
        assert {path for path in now if now[path] != before[path]} in (set(), differing)
        if now != before:
            warm.run(old, folder)
        killed += is_killed
    assert killed == 3
    warm.run(new, folder)
    assert names(folder) == names(reference)


def test_killed_copies_of_examples_go_on(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    chance, arguments = random.Random(8), ["examples", "-o", "out"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    warm.run(arguments, reference)
    shutil.rmtree(reference / "out")
    seconds, killed = warm.run(arguments, reference), 0
    for _ in range(4 * MOST_ATTEMPTS):
        if killed == 6:
            break
        killed += warm.kill(arguments, folder, chance, seconds)
        for path, content in contents(folder).items():
            assert content == (reference / path).read_bytes()
        if names(folder) >= names(reference):  # all were there before the kill
            shutil.rmtree(folder / "out")
    assert killed == 6
    warm.run(arguments, folder)
    assert names(folder) == names(reference)


def test_a_killed_formulation_blocks_no_other(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    chance, arguments = random.Random(9), ["formulate", "paint.toml", "-o", "out"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    seconds, killed = warm.run(arguments, reference), 0
    for _ in range(MOST_ATTEMPTS):
        if killed == 2:
            break
        killed += checked_kill(warm, arguments, folder, reference, chance, seconds)
    assert killed == 2
    shutil.rmtree(folder / "out", ignore_errors=True)  # as if killed while the answers were written
    shutil.copytree(reference / "out", folder / "out")
    summary = folder / "out" / "formulation.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | {"status": "started"}))
    warm.start(["formulate", "paint.toml", "--batch", "notes.txt", "--made", "out"], folder)
    status, said = warm.finish()
    assert status == 2 and len(said.strip().splitlines()) == 1
    warm.run(arguments, folder)
    assert names(folder) == names(reference)
    assert json.loads(summary.read_text())["status"] == "done"


def test_a_killed_tolerance_leaves_no_worker(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    chance = random.Random(10)
    arguments = ["tolerance", "smooth.toml", "--tolerance", "layers[0].thickness_nm=5", "--draws", "200"]
    arguments += ["--jobs", "2", "-o", "out.json"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    seconds, killed = warm.run(arguments, reference), 0
    for _ in range(MOST_ATTEMPTS):
        if killed == 3:
            break
        killed += checked_kill(warm, arguments, folder, reference, chance, seconds)
        assert not warm.survivors(), "workers live on without their command"
    assert killed == 3
    warm.run(arguments, folder)
    assert names(folder) == names(reference)
    assert (folder / "out.json").read_bytes() == (reference / "out.json").read_bytes()


def done_points(store: Path) -> dict[str, int]:
    """The finished points of a sweep's store and when each was written."""
    found = (store / "status").glob("c.*") if (store / "status").is_dir() else ()
    return {
        p.name: p.stat().st_mtime_ns
        for p in found
        if not p.name.endswith(".partial") and p.read_bytes() == bytes([DONE])
    }


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_sweep_keeps_its_points(workers: int, warm: Forker, inputs: Path, tmp_path: Path) -> None:
    """Finished points stay as they are, bit by bit; the last run adds what is missing, and no process stays."""
    chance = random.Random(workers)
    arguments = ["sweep", "sweep.toml", "-o", "out.zarr", "--jobs", str(workers)]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    seconds = warm.run([*arguments[:-1], "1"], reference)
    seconds = max(seconds, 6.0) if workers > 1 else seconds
    killed, wanted = 0, 6 if workers == 1 else 3
    for _ in range(wanted):
        before = done_points(folder / "out.zarr")
        if len(before) == 600:  # start again
            shutil.rmtree(folder / "out.zarr")
            before = {}
        killed += warm.kill(arguments, folder, chance, seconds)
        assert not warm.survivors(), "workers live on without their sweep"
        after = done_points(folder / "out.zarr")
        assert {name: after.get(name) for name in before} == before
        for name in after:
            values = folder / "out.zarr" / "lab_specular_reflectance" / f"{name}.0.0"
            expected = reference / "out.zarr" / "lab_specular_reflectance" / f"{name}.0.0"
            np.testing.assert_allclose(np.fromfile(values), np.fromfile(expected), rtol=1e-9, atol=1e-9)
    assert killed >= wanted // 2
    before = done_points(folder / "out.zarr")
    warm.run([*arguments[:-1], "1"], folder)
    after = done_points(folder / "out.zarr")
    assert len(after) == 600 and {name: after[name] for name in before} == before
    assert names(folder) == names(reference)


@pytest.mark.render
def test_a_killed_animation_keeps_its_frames(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    chance = random.Random(3)
    arguments = ["render", "smooth.toml", "--size", "32x32", "--spp", "2", "--animate", "light", "--frames", "6"]
    arguments += ["-o", "out.gif"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    warm.run(arguments, reference)
    shutil.rmtree(reference / "out_frames")
    seconds = warm.run(arguments, reference)
    killed = 0
    for _ in range(15):
        if killed == 3:
            break
        before = contents(folder)
        is_killed = warm.kill(arguments, folder, chance, seconds)
        check_after_kill(folder, reference, before)
        frames = {name: data for name, data in before.items() if name.startswith("out_frames")}
        assert {name: (folder / name).read_bytes() for name in frames} == frames, "a finished frame was made again"
        killed += is_killed
        if not is_killed:  # the machine was quicker than when it was timed, or few frames were left: anew, and sooner
            shutil.rmtree(folder / "out_frames")
            seconds *= 0.7
    assert killed == 3
    warm.run(arguments, folder)
    assert names(folder) == names(reference)


def test_a_killed_design_has_its_best_on_disk_and_goes_on(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    chance = random.Random(4)
    arguments = ["design", "target.toml", "-o", "out", "--jobs", "1"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    warm.run(arguments, reference)
    shutil.rmtree(reference / "out")
    seconds = warm.run(arguments, reference)
    killed = 0
    for attempt in range(6):
        before = contents(folder)
        resume = ["--resume"] if attempt % 2 and (folder / "out" / "search.json").is_file() else []
        killed += warm.kill([*arguments, *resume], folder, chance, seconds)
        found = visible(folder)
        assert set(before) <= set(found)
        for name, path in found.items():
            check_whole(path, before.get(name), reference / name)
    assert killed >= 3
    warm.run([*arguments, "--resume"] if (folder / "out" / "search.json").is_file() else arguments, folder)
    assert names(folder) == names(reference)


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM])
def test_killed_designs_of_many_colours_go_on(by: signal.Signals, warm: Forker, inputs: Path, tmp_path: Path) -> None:
    """Whatever the moment: the next run accepts the folder, and finished colours keep their solutions."""
    chance = random.Random(int(by))
    colours = np.random.default_rng(1).uniform([30, -40, -40], [80, 40, 40], (75, 3))
    arguments = ["design", "many.toml", "--many", "colours.csv", "-o", "out"]
    reference, folder = fresh(inputs, tmp_path / "reference"), fresh(inputs, tmp_path / "killed")
    for place in (reference, folder):
        lines = [f"colour {i},{L:.2f},{a:.2f},{b:.2f}" for i, (L, a, b) in enumerate(colours)]
        (place / "colours.csv").write_text("\n".join(["name,L,a,b", *lines]) + "\n")
    seconds = warm.run(arguments, reference)
    killed, finished = 0, dict[str, Any]()
    for _ in range(MOST_ATTEMPTS):
        if killed == 6:
            break
        is_killed = warm.kill([*arguments, "--resume"], folder, chance, seconds, by)
        killed += is_killed
        summary = folder / "out" / "many.json"
        rows = json.loads(summary.read_text())["rows"] if summary.is_file() else []
        now = {row["folder"]: row["changes"] for row in rows}
        assert {name: now.get(name) for name in finished} == finished
        finished = now
        if not is_killed:  # quicker than when it was timed: anew, and sooner
            shutil.rmtree(folder / "out")
            seconds, finished = 0.7 * seconds, {}
    assert killed == 6
    warm.run([*arguments, "--resume"], folder)
    done = json.loads((folder / "out" / "many.json").read_text())
    assert done["status"] == "done" and done["done"] == len(colours)
    assert names(folder) == names(reference)


@pytest.mark.parametrize("name", ["search.json", "design.json"])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_truncated_checkpoint_is_one_line(
    name: str, share: float, warm: Forker, inputs: Path, tmp_path: Path
) -> None:
    folder = fresh(inputs, tmp_path / "cut")
    (folder / "many.toml").write_text(MANY + "[search]\nevaluations = 200\n")
    arguments = ["design", "many.toml", "-o", "out"]
    warm.run(arguments, folder)
    path = folder / "out" / name
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    warm.start([*arguments, "--resume"], folder)
    status, said = warm.finish()
    assert status == 2 and len(said.strip().splitlines()) == 1


@pytest.mark.render
def test_what_a_killed_solver_was_keeping_on_disk_is_no_obstacle(
    inputs: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The cache of solved materials: a run after the kills solves, answers, and leaves no temporary entry."""
    kept = tmp_path_factory.mktemp("kept")
    folder, chance = fresh(inputs, tmp_path / "killed"), random.Random(5)
    (folder / "meta.toml").write_text(METASURFACE.replace("multipole_order = 1", "multipole_order = 2"))
    arguments = ["compile", "meta.toml", "-o", "out.nacre"]
    with forker(kept) as cold:
        seconds = cold.run(arguments, folder)
        entries = names(kept)
        assert [name for name in entries if name.endswith(".nacre")], "nothing was kept"
        for _ in range(4):
            shutil.rmtree(kept)
            kept.mkdir(mode=0o700)
            (folder / "out.nacre").unlink(missing_ok=True)
            cold.kill(arguments, folder, chance, seconds)
            check_after_kill(folder, folder, {})
        cold.run(arguments, folder)
        cold.run(arguments, folder)
    assert names(kept) == entries


@pytest.mark.render
def test_a_killed_demo_shows_whole_pictures_only(warm: Forker, inputs: Path, tmp_path: Path) -> None:
    folder, chance = fresh(inputs, tmp_path / "killed"), random.Random(6)
    for _ in range(3):
        assert warm.kill(["demo", "--quick", "--out", "demo"], folder, chance, 8.0)
        for path in visible(folder).values():
            check_whole(path, OLD if path.name == BYSTANDER else None, inputs / path.name)
