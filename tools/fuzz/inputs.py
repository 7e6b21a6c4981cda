"""What is thrown: one function for each kind of input, which makes one from a seed and looks at what comes of it.

A kind returns "answered" or "refused"; anything else is a failure, whose words the caller counts.
"""

from __future__ import annotations

import contextlib
import io
import random
import sys
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from helpers_fuzz import STRANGE, mutate, mutate_bytes  # noqa: E402  # what the tests throw, too
from random_recipes import random_film  # noqa: E402

import nacre  # noqa: E402
from nacre.cli import run  # noqa: E402
from nacre.core.errors import NacreError  # noqa: E402
from nacre.families.contract import ExcessEnergy  # noqa: E402

EXAMPLES = ROOT / "examples"
GRID_NM = np.array([450.0, 550.0, 650.0])
ANGLES_RAD = np.radians([0.0, 40.0, 80.0, 89.9])
EXCESS = 1e-3  # of the light that arrives: what spectra keep to
RECIPROCITY = 1e-6  # of the largest value
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
ROUGH = FILM + "[surface]\nroughness = 0.2\n"
SWEEP = (
    'recipe = "film.toml"\n[axes]\nsubstrate = ["Si", "Ag"]\n'
    '"layers[0].thickness_nm" = {start = 1, stop = 9, count = 3}\n'
    "[measure]\nangles_deg = [0, 45]\nwavelengths_nm = [450, 550]\n"
)
SCENE = """<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0,-5,1" target="0,0,0" up="0,0,1"/></transform><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="8"/></film></sensor><emitter type="constant"/>
<shape type="sphere"><float name="radius" value="1"/><bsdf type="diffuse" id="nacre"/></shape></scene>"""
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 2/2 4/3\nf 2 3 4\n"
WORDS = [
    "0", "-1", "1e308", "1:1e308:1e-300", "nan", "inf", "9" * 400, "9" * 5000, "", " ", "0:90:10", "450,550", "x", "=",
    "[" * 3000, "/dev/null", "/", ".", "a\0b", "\u2603", "layers[0].thickness_nm=1:2", "layers[0].thickness_nm=5%",
    "layers[9].x=1", "--", "-h", "--json", "film.toml", "no.toml", "550:450:5", "1e-320", "0x10", "1_0", "D65", "s",
]  # fmt: skip
LINES = [
    ["spectrum", "film.toml", "--angles-deg", "0,30", "--wavelengths-nm", "450,550,650"],
    ["spectrum", "film.toml", "--polarisation", "s", "--json", "--set", "layers[0].thickness_nm=20"],
    ["evaluate", "film.toml", "--directions", "d.npz", "--wavelengths-nm", "550", "-o", "v.npz"],
    ["tolerance", "film.toml", "--spread", "layers[0].thickness_nm=1%", "--draws", "3", "--limit", "1"],
    ["report", "film.toml", "--illuminant", "D65", "--observer", "2deg", "--json"],
    ["fit", "m.csv", "film.toml", "--free", "layers[0].thickness_nm=200:400", "--starts", "1"],
    ["indices", "show", "Si", "--json"], ["indices", "search", "Ag", "--limit", "3"], ["keys", "film", "layers"],
    ["compile", "film.toml", "--wavelengths-nm", "550", "-o", "c.nacre"], ["fabricate", "film.toml", "--to", "sheet"],
    ["export", "film.toml", "--to", "nacre", "-o", "e.nacre"], ["import", "m.csv", "-o", "i.toml"],
    ["plot", "film.toml", "--kind", "spectrum", "--over", "layers[0].thickness_nm=1:9:4", "-o", "p.png"],
]  # fmt: skip


class Sound:
    """One sound file of every kind, made once in a worker's folder; `contents` are what is then broken."""

    def __init__(self, folder: Path) -> None:
        from PIL import Image

        from nacre.analysis.import_export import export_material
        from nacre.formats.bsdf_tables import rgl_fields, write_tensor

        (folder / "film.toml").write_text(ROUGH)
        rough, smooth = nacre.load(folder / "film.toml"), nacre.material(tomllib.loads(FILM))
        two = rough.bsdf(GRID_NM)
        two.save(folder / "s.nacre")
        options = {"angle_step_deg": 30.0, "wavelength_nm": 550.0}
        for target, name in (("zemax", "s.bsdf"), ("csv", "s.csv")):
            export_material(rough, target, folder / name, **options)  # type: ignore[arg-type]  # both are numbers
        for target, name in (("gltf", "s.gltf"), ("materialx", "s.mtlx")):
            export_material(smooth, target, folder / name)
        write_tensor(folder / "t.bsdf", rgl_fields(two, "x", resolution=8, theta_nodes=3))
        (folder / "short.binary").write_bytes(np.array([90, 90, 180], dtype="<i4").tobytes() + bytes(4000))
        g = np.random.default_rng(0)
        np.save(folder / "s.npy", g.uniform(0.0, 0.3, (4, 4)))
        np.savez(folder / "d.npz", wi=[[0.0, 0.0, 1.0]], wo=[[0.6, 0.0, 0.8]], uv=[[0.5, 0.5]])
        for name in ("s.png", "s.tif"):
            Image.fromarray(g.integers(0, 255, (5, 7), dtype=np.uint8)).save(folder / name)
        rows = [f"{w},{a},{0.1 + w / 1e4}" for a in (0, 45) for w in (450, 550, 650)]
        (folder / "m.csv").write_text("wavelength_nm,angle_deg,specular_reflectance\n" + "\n".join(rows) + "\n")
        (folder / "nk.csv").write_text("wavelength_nm,n,k\n360,1.5,0\n500,1.51,0.1\n830,1.52,0\n")
        (folder / "points.csv").write_text("x,y\n" + "\n".join(f"{x},{y}" for x, y in g.uniform(0, 9e3, (60, 2))))
        (folder / "cal.csv").write_text("0,1.0\n100,0.6\n255,0.0\n")
        (folder / "s.obj").write_text(MESH)
        (folder / "s.xml").write_text(SCENE)
        self.contents = {path.name: path.read_bytes() for path in folder.iterdir()}


def outcome(act: Callable[[], object]) -> str:
    """Run something; "answered", or "refused" by one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ResourceWarning)  # numpy leaves a broken archive to the collector
        try:
            act()
        except NacreError as error:
            if "\n" in str(error) or "Traceback" in str(error) or "should be a valid" in str(error):
                raise AssertionError(f"not one clear line: {error!s:.200}") from None
            return "refused"
    return "answered"


def check_answers(material: nacre.Material) -> None:
    """Check sign, finiteness, reciprocity and energy of what a material answers."""
    model = material.model
    bounded = not (isinstance(model, ExcessEnergy) and model.excess_reason)
    parts = material.spectrum(ANGLES_RAD, GRID_NM).parts().values()
    for part in parts:
        assert np.isfinite(part).all(), "spectrum is not finite"
        assert part.min() >= -1e-9, "spectrum is negative"
    if parts and bounded:
        assert np.sum(list(parts), axis=0).max() <= 1 + EXCESS, "spectrum has more than arrives"
    bsdf = material.bsdf(GRID_NM)
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        return
    g = np.random.default_rng(1)
    w = g.normal(size=(2, 12, 3))
    w[..., 2] = np.abs(w[..., 2]) + 0.05
    wi, wo = w / np.linalg.norm(w, axis=-1, keepdims=True)
    there, back = bsdf.evaluate(wi, wo), bsdf.evaluate(wo, wi)
    assert np.isfinite(there).all() and there.min() >= -1e-9, "BSDF is negative or not finite"
    if bounded:  # what is imported is as it was measured
        scale = max(float(there.max()), 1e-12)
        assert np.abs(there - back).max() <= RECIPROCITY * scale, "BSDF is not reciprocal"


def is_recipe(path: Path) -> bool:
    """Whether an example is a recipe, and no target or list."""
    data = tomllib.loads(path.read_text())
    return "family" in data and "target" not in data


RECIPES = [tomllib.loads(p.read_text()) for p in sorted(EXAMPLES.rglob("*.toml")) if is_recipe(p)]
FILMS = [data for data in RECIPES if data["family"] == "film" and "texture" not in str(data)]
TARGETS = [tomllib.loads(p.read_text()) for p in sorted((EXAMPLES / "targets").rglob("*.toml"))]


def _recipe(seeds: list[dict[str, Any]], g: random.Random, folder: Path, answers: bool) -> str:
    text = mutate(g.choice(seeds), g)
    (folder / "r.toml").write_bytes(text.encode("utf-8", "surrogatepass"))

    def act() -> None:
        material = nacre.load(folder / "r.toml")
        if answers:
            check_answers(material)

    return outcome(act)


def recipes(g: random.Random, folder: Path, sound: Sound) -> str:
    """Mutated recipes of all families, loaded."""
    return _recipe(RECIPES, g, folder, False)


def film_recipes(g: random.Random, folder: Path, sound: Sound) -> str:
    """Mutated film recipes, asked for answers."""
    return _recipe(FILMS, g, folder, True)


def random_films(g: random.Random, folder: Path, sound: Sound) -> str:
    """Random sound films, which must answer."""
    data = random_film(np.random.default_rng(g.getrandbits(32)))
    found = outcome(lambda: check_answers(nacre.material(data)))
    assert found == "answered", "a sound film is refused"
    return found


def dictionaries(g: random.Random, folder: Path, sound: Sound) -> str:
    """Recipes from Python with values and keys that no TOML holds."""
    data = dict(g.choice(RECIPES))
    odd = [*STRANGE, None, b"x", object(), {1: 2}, {None: 1}, (1, 2), {1, 2}, np.nan, np.ones(3), 1j, 10**400, "\ud800"]
    for _ in range(g.choice([1, 1, 2])):
        data[g.choice([*data, "x", 3, None])] = g.choice(odd)  # type: ignore[index]  # on purpose
    return outcome(lambda: nacre.material(data, g.choice([folder, str(folder), "no"])))


def targets(g: random.Random, folder: Path, sound: Sound) -> str:
    """Mutated targets of designs."""
    from nacre.optimise.run import read_target

    (folder / "t.toml").write_bytes(mutate(g.choice(TARGETS), g).encode("utf-8", "surrogatepass"))

    return outcome(lambda: read_target(folder / "t.toml"))


def sweeps(g: random.Random, folder: Path, sound: Sound) -> str:
    """Mutated sweeps."""
    from nacre.analysis.sweep_plan import load_sweep

    (folder / "film.toml").write_text(FILM)
    (folder / "w.toml").write_bytes(mutate(tomllib.loads(SWEEP), g).encode("utf-8", "surrogatepass"))
    return outcome(lambda: load_sweep(folder / "w.toml"))


def lines(g: random.Random, folder: Path, sound: Sound) -> str:
    """Broken command lines: status 0, or 2 and one line on stderr."""
    for name in ("film.toml", "d.npz", "m.csv"):
        (folder / name).write_bytes(sound.contents[name])
    words = list(g.choice(LINES))
    for _ in range(g.choice([1, 1, 1, 2, 3])):
        at, action = g.randrange(len(words)), g.randrange(4)
        if action == 0 and len(words) > 1:
            del words[at]
        elif action == 1:
            words.insert(at, g.choice(WORDS))
        else:
            words[max(at, 1) if len(words) > 1 else 0] = g.choice(WORDS)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), contextlib.chdir(folder):
        status = run(words)
    said = [line for line in err.getvalue().splitlines() if line.strip()]
    shown = " ".join(words)[:200]
    assert status in (0, 2), f"status {status} of {shown}: {said[-1:]}"
    progress = ("tolerance", "rms")  # lines that a bar or a fit leaves before
    if status == 2:
        assert len([line for line in said if not any(word in line.split(":")[0] for word in progress[1:])]) <= 2
        assert said and all("Traceback" not in line and "bug in nacre" not in line for line in said), shown
    return "answered" if status == 0 else "refused"


def _broken(names: tuple[str, ...], use: Callable[[Path, Path], object]) -> Callable[..., str]:
    def kind(g: random.Random, folder: Path, sound: Sound) -> str:
        name = g.choice(names)
        path = folder / name
        path.write_bytes(mutate_bytes(sound.contents[name], g))
        return outcome(lambda: use(path, folder))

    return kind


def _loaded(data: dict[str, Any], answers: bool = True) -> Callable[[Path, Path], object]:
    def use(path: Path, folder: Path) -> None:
        text = repr(data).replace("PATH", path.name)
        import ast

        material = nacre.material(ast.literal_eval(text), folder)
        if answers:
            check_answers(material)

    return use


def _import(path: Path, folder: Path) -> None:
    check_answers(nacre.import_(path, folder / "out.toml"))


def _measurement(path: Path, folder: Path) -> None:
    from nacre.analysis.fit import read_measurement

    read_measurement(path)


def _calibration(path: Path, folder: Path) -> None:
    from nacre.formats.layouts import read_calibration

    read_calibration(path)


def _mesh(path: Path, folder: Path) -> None:
    from nacre.picture.subjects import read_mesh

    mesh = read_mesh(path)
    assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.normals).all(), "mesh is not finite"


def _directions(path: Path, folder: Path) -> None:
    from nacre.cli.show import _read_directions

    wi, wo, uv = _read_directions(str(path))
    nacre.evaluate(folder / "s.nacre", wi, wo, uv=uv)


def _nacre(path: Path, folder: Path) -> None:
    check_answers(nacre.load(path))


def _scene(path: Path, folder: Path) -> None:
    from nacre.picture.built_scene import UserScene

    UserScene(path)


TEXTURED = {"family": "film", "substrate": "Si", "layers": [
    {"material": "SiO2", "thickness_nm": {"texture": "PATH", "min": 100, "max": 300}}]}  # fmt: skip
RELIEF = {"family": "relief", "heights": "PATH", "feature_um": 1.5, "blur_um": 0.4, "coating": "Al",
          "coherence": {"sigma": 2.0}}  # fmt: skip
SHEET = {"family": "metasurface", "substrate": {"n": 1.5}, "particle": {"material": "Ag", "radius_nm": 50, "gap_nm": 2},
         "monolayer": {"coverage": 0.05, "structure": {"points": "PATH"}}}  # fmt: skip
IMPORTS = ("s.bsdf", "t.bsdf", "s.csv", "s.gltf", "s.mtlx", "short.binary")

# kind -> (its share of all inputs, the function)
KINDS: dict[str, tuple[float, Callable[[random.Random, Path, Sound], str]]] = {
    "recipe": (26, recipes), "film, asked": (8, film_recipes), "random film": (4, random_films),
    "dictionary": (8, dictionaries), "command line": (10, lines), "target": (5, targets), "sweep": (5, sweeps),
    "index CSV": (5, _broken(("nk.csv",), _loaded({"family": "film", "substrate": {"file": "PATH"}}))),
    "texture": (4, _broken(("s.png", "s.tif"), _loaded(TEXTURED))),
    "heights": (4, _broken(("s.npy",), _loaded(RELIEF, answers=False))),
    "points": (2, _broken(("points.csv",), _loaded(SHEET, answers=False))),
    "measurement": (4, _broken(("m.csv", "s.csv"), _measurement)), "import": (5, _broken(IMPORTS, _import)),
    ".nacre": (4, _broken(("s.nacre",), _nacre)), "calibration": (1, _broken(("cal.csv",), _calibration)),
    "mesh": (2, _broken(("s.obj",), _mesh)), "directions": (2, _broken(("d.npz",), _directions)),
    "scene": (1, _broken(("s.xml",), _scene)),
}  # fmt: skip


def throw(number: int, seed: int, folder: Path, sound: Sound) -> tuple[str, str]:
    """Throw one input; return its kind and what came of it, "answered", "refused" or a failure in words."""
    g = random.Random(f"{seed}:{number}")
    kind = g.choices(list(KINDS), [share for share, _ in KINDS.values()])[0]
    for left in folder.iterdir():
        if left.name not in sound.contents and left.is_file():
            left.unlink()
    for name in ("s.nacre", "film.toml"):  # others lean on these
        (folder / name).write_bytes(sound.contents[name])
    try:
        found = KINDS[kind][1](g, folder, sound)
    except BaseException as error:  # whatever it is, it is what we look for
        frames = []
        trace = error.__traceback__
        while trace is not None:
            frames.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
            trace = trace.tb_next
        return kind, f"{type(error).__name__}: {' '.join(str(error).split())[:160]} at {frames[-1]}"
    half = [path.name for path in folder.glob(".*")]
    return kind, f"left half-written {half[0]}" if half else found
