"""Finding an LLVM, choosing a variant, and what is said where none works."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from nacre.core.errors import MachineError, UnsupportedError
from nacre.device import llvm, variant

PLAIN_SCENE = """
import warnings
import nacre
import nacre.render
mi = nacre.render.use_variant()
bsdf = nacre.material({"family": "film", "substrate": "Si"}).bsdf()
sphere = {"type": "sphere", "bsdf": nacre.render.make_bsdf(bsdf)}
film = {"type": "hdrfilm", "width": 4, "height": 4}
sensor = {"type": "perspective", "film": film, "to_world": mi.ScalarTransform4f().translate([0, 0, -3])}
light = {"type": "constant"}
scene = mi.load_dict({"type": "scene", "integrator": {"type": "path"}, "a": sphere, "b": light, "c": sensor})
import numpy as np
print(mi.variant(), np.isfinite(np.array(mi.render(scene, spp=2))).all())
"""


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the verdicts on libraries a folder of their own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def refuse_all(folder: Path, reason: str = "refused by the test") -> dict[str, str]:
    """Write a verdict against every library of this machine; return the environment that believes it."""
    (folder / "nacre").mkdir(parents=True)
    verdicts = {llvm._cache_key(path): ["", reason] for path in llvm.candidates()}
    (folder / "nacre" / "llvm.json").write_text(json.dumps(verdicts))
    return {**os.environ, "XDG_CACHE_HOME": str(folder)}


def python(code: str, environment: dict[str, str], *options: str) -> subprocess.CompletedProcess[str]:
    """Run a script in a fresh process."""
    return subprocess.run(
        [sys.executable, *options, "-c", code], env=environment, capture_output=True, text=True, timeout=300
    )


def test_a_file_that_is_no_llvm_is_refused_with_a_reason(tmp_path: Path, empty_cache: Path) -> None:
    """Neither a missing file nor a text file brings the process down."""
    fake = tmp_path / "libLLVM-19.so"
    fake.write_text("not a library")
    assert "drjit does not accept it" in llvm.probe_library(str(fake)).reason
    assert "does not exist" in llvm.probe_library(str(tmp_path / "libLLVM-20.so")).reason


def test_verdicts_are_kept_until_the_file_changes(
    tmp_path: Path, empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second start asks no child process."""
    fake = tmp_path / "libLLVM-19.so"
    fake.write_text("not a library")
    first = llvm.probe_library(str(fake))
    calls: list[str] = []
    monkeypatch.setattr(llvm, "_run_probe", lambda path: calls.append(path) or llvm.Probe(path, "", "asked again"))
    assert llvm.probe_library(str(fake)) == first and not calls
    os.utime(fake, ns=(1, 1))
    assert llvm.probe_library(str(fake)).reason == "asked again" and len(calls) == 1


def test_a_broken_cache_is_no_obstacle(tmp_path: Path, empty_cache: Path) -> None:
    """Rubbish in the cache, or a cache that cannot be written, costs a probe and nothing else."""
    (empty_cache / "nacre").mkdir(parents=True)
    (empty_cache / "nacre" / "llvm.json").write_text("{rubbish")
    assert "does not exist" in llvm.probe_library(str(tmp_path / "libLLVM-19.so")).reason
    (empty_cache / "nacre" / "llvm.json").write_text('{"a": 3, "b": ["19", ""]}')
    assert llvm._read_cache() == {"b": ["19", ""]}


@pytest.mark.parametrize(
    ("name", "rank"),
    [
        ("/usr/lib/llvm-19/lib/libLLVM.so.19.1", 0),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-20.so", 1),
        ("/x/libLLVM.so.22.1", 3),
        ("/x/libLLVM-18.so.1", 5),
        ("/x/libLLVM-17.so", 6),
        ("/x/libLLVM.so.23.1", 7),
        ("/x/libLLVM-16.so.1", None),
        ("/usr/lib/llvm-15/lib/libLLVM.so.1", None),
        ("/x/libLLVM.so", 4),
    ],
)
def test_libraries_are_tried_best_first(name: str, rank: int | None) -> None:
    """19 to 22 first, then unknown ones, then 18 and 17; those known to abort not at all."""
    assert llvm._rank(name) == rank


def test_the_environment_is_tried_first_and_the_search_goes_on_if_it_fails(
    tmp_path: Path, empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong DRJIT_LIBLLVM_PATH is reported, not fatal."""
    monkeypatch.setenv(llvm.ENVIRONMENT_VARIABLE, "/nowhere/libLLVM.so")
    monkeypatch.setattr(llvm, "_installed", lambda: iter(["/x/libLLVM-19.so"]))
    monkeypatch.setattr(llvm, "_wheel_libraries", lambda: [])
    verdicts = {"/x/libLLVM-19.so": llvm.Probe("/x/libLLVM-19.so", "19.1.0", "")}
    monkeypatch.setattr(
        llvm, "_run_probe", lambda path: verdicts.get(path, llvm.Probe(path, "", "the file does not exist"))
    )
    llvm.find_llvm.cache_clear()
    try:
        found, tried = llvm.find_llvm()
    finally:
        llvm.find_llvm.cache_clear()
    assert found is not None and found.path == "/x/libLLVM-19.so"
    assert [probe.path for probe in tried] == ["/nowhere/libLLVM.so", "/x/libLLVM-19.so"]
    assert tried[0].reason == "the file does not exist"


def test_libraries_unpacked_beside_llvm_are_loaded_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """libLLVM needs libedit, which needs libbsd; all lie in the project's own folder."""
    folder = tmp_path / ".llvm" / "usr" / "lib"
    folder.mkdir(parents=True)
    for name in ("libLLVM-19.so", "libedit.so.2", "libbsd.so.0"):
        (folder / name).write_text("")
    wanted = {"libLLVM-19.so": "libedit.so.2", "libedit.so.2": "libbsd.so.0"}

    def missing(paths: list[str]) -> str | None:
        seen: list[str] = []
        for path in paths:
            need = wanted.get(Path(path).name)
            if need is not None and need not in seen:
                return need
            seen.append(Path(path).name)
        return None

    monkeypatch.setattr(llvm, "_missing_library", missing)
    found = [Path(path).name for path in llvm.companions(str(folder / "libLLVM-19.so"))]
    assert found == ["libbsd.so.0", "libedit.so.2"]
    assert llvm.companions("/usr/lib/libLLVM-19.so") == []


def test_each_system_gets_the_one_command_that_brings_an_llvm() -> None:
    """The wheel where there is one; no apt on a Mac."""
    assert llvm.advice("Linux", "x86_64").startswith("`pip install karellen-llvm-core==")
    assert "apt-get install libllvm19" in llvm.advice("Linux", "aarch64")
    assert "`brew install llvm`" in llvm.advice("Darwin", "arm64") and "apt" not in llvm.advice("Darwin", "arm64")
    assert "`winget install LLVM.LLVM`" in llvm.advice("Windows", "AMD64")


def test_the_wheel_that_is_advised_is_the_one_that_pip_brings() -> None:
    root = Path(__file__).parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    (line,) = (line for line in project["dependencies"] if line.startswith(llvm.WHEEL))
    requirement, marker = line.split(";")
    assert requirement.strip() == f"{llvm.WHEEL}=={llvm.WHEEL_VERSION}"
    assert "linux" in marker and "x86_64" in marker
    assert requirement.strip() in (root / "constraints.txt").read_text().splitlines()


def wheel_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Lay out what pip leaves of the wheel before an interpreter has started once; return its libLLVM."""
    site, lib = folder / "lib" / "python3" / "site-packages", folder / "lib"
    info = site / f"{llvm.WHEEL.replace('-', '_')}-19.1.7.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {llvm.WHEEL}\nVersion: 19.1.7\n")
    (info / "RECORD").write_text("../../libLLVM.so.19.1,,\n../../x86_64-unknown-linux-gnu/libc++.so.1.0,,\n")
    (lib / "x86_64-unknown-linux-gnu").mkdir()
    (lib / "x86_64-unknown-linux-gnu" / "libc++.so.1.0").write_text("")
    (lib / "libLLVM.so.19.1").write_text("")
    monkeypatch.syspath_prepend(str(site))
    return lib / "libLLVM.so.19.1"


def test_the_wheel_goes_before_what_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its version is pinned; it is found wherever pip put it, and named by doctor."""
    library = wheel_in(tmp_path, monkeypatch)
    monkeypatch.delenv(llvm.ENVIRONMENT_VARIABLE, raising=False)
    monkeypatch.setattr(llvm, "_installed", lambda: iter(["/x/libLLVM-19.so"]))
    assert llvm.candidates() == [str(library), "/x/libLLVM-19.so", ""]
    assert llvm.from_wheel(str(library)) and llvm.wheel_version() == "19.1.7"
    assert not llvm.from_wheel("") and not llvm.from_wheel("/x/libLLVM-19.so")


def test_the_wheel_works_where_its_links_could_not_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment of another user's: libc++.so.1 is a link that is made at a first start with rights to write."""
    library = wheel_in(tmp_path, monkeypatch)
    monkeypatch.setattr(llvm, "_missing_library", lambda paths: None if len(paths) > 1 else "libc++.so.1")
    assert [Path(path).name for path in llvm.companions(str(library))] == ["libc++.so.1.0"]


@pytest.mark.render
def test_companions_are_loaded_before_the_library_is_tried(
    tmp_path: Path, empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were found and handed on, and the trial did without them."""
    monkeypatch.setattr(llvm, "companions", lambda path: [str(tmp_path / "libedit.so.2")])
    assert "libedit.so.2" in llvm.probe_library("").reason


@pytest.mark.parametrize("name", ["llvm_ad_rgb", "scalar_rgb", "llvm_ad_mono_polarized", "spectral"])
def test_variants_without_plain_spectra_are_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Structural colour is a spectrum."""
    monkeypatch.setenv(variant.ENVIRONMENT_VARIABLE, name)
    with pytest.raises(UnsupportedError, match="cannot carry spectral materials"):
        variant.use_variant()


def test_without_llvm_a_tiny_picture_still_comes_with_a_warning(tmp_path: Path) -> None:
    """The fallback is scalar_spectral, with a warning about its speed."""
    done = python(PLAIN_SCENE, {**refuse_all(tmp_path), variant.ENVIRONMENT_VARIABLE: ""})
    assert done.returncode == 0, done.stderr
    assert "RuntimeWarning: no usable LLVM was found" in done.stderr
    assert done.stdout.split() == ["scalar_spectral", "True"]


def test_the_report_states_the_remedy_without_llvm(tmp_path: Path) -> None:
    """`nacre doctor` gets the reason of each library and the way out."""
    code = (
        "import json; from dataclasses import asdict; from nacre.device.variant import report, llvm_failure\n"
        "print(json.dumps([asdict(report()), llvm_failure()]))"
    )
    done = python(code, {**refuse_all(tmp_path), variant.ENVIRONMENT_VARIABLE: ""})
    assert done.returncode == 0, done.stderr
    report, reason = json.loads(done.stdout)
    assert "refused by the test" in report["variants"]["llvm_ad_spectral"] and llvm.advice() in reason
    assert report["variant"] in ("scalar_spectral", "cuda_ad_spectral")
    if report["variant"] == "scalar_spectral":
        assert llvm.advice() in report["advice"]
    assert all(tried["reason"] == "refused by the test" for tried in report["llvm_tried"])


def test_render_tests_fail_the_session_without_llvm(tmp_path: Path) -> None:
    """Never skipped in silence: one line at the end, and a failing status."""
    folder = tmp_path / "suite"
    folder.mkdir()
    (folder / "conftest.py").write_text((Path(__file__).parents[1] / "conftest.py").read_text())
    (folder / "test_a.py").write_text(
        "import pytest\n\n@pytest.mark.render\ndef test_picture(mi):\n    pass\n\ndef test_plain():\n    pass\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        env=refuse_all(tmp_path / "cache"),
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1
    assert "1 passed, 1 skipped" in done.stdout
    line = done.stdout.strip().splitlines()[-1]
    assert line.startswith("FAILED: 1 rendering tests could not run: no usable LLVM")


@pytest.mark.parametrize(
    ("gone", "processes"), [("suite/test_a.py::test_gone", ["-n", "1"]), ("suite/test_gone.py::test_plain", [])]
)
def test_a_slow_case_that_no_longer_exists_fails_the_session(gone: str, processes: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "suite"
    folder.mkdir()
    (folder / "conftest.py").write_text((Path(__file__).parents[1] / "conftest.py").read_text())
    (folder / "test_a.py").write_text("def test_plain():\n    pass\n\ndef test_slow():\n    pass\n")
    (folder / "slow_cases.txt").write_text(f"suite/test_a.py::test_slow\n{gone}\n")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n    full\n    slow\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not full", *processes, str(folder)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode not in (0, 5) and gone in done.stdout + done.stderr


@pytest.mark.render
def test_an_own_variant_is_kept_and_the_plugin_follows_it(tmp_path: Path) -> None:
    """A user's own mi.set_variant, before or after importing nacre.render, is all that is needed."""
    (tmp_path / "a.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    code = (
        "import nacre.render, mitsuba as mi\n"
        "mi.set_variant('llvm_ad_spectral')\n"
        f"print(mi.load_dict({{'type': 'nacre', 'recipe': {str(tmp_path / 'a.toml')!r}}}))\n"
        "mi.set_variant('scalar_spectral')\n"
        f"print(mi.load_dict({{'type': 'nacre', 'recipe': {str(tmp_path / 'a.toml')!r}}}))\n"
        "assert nacre.render.use_variant() is mi and mi.variant() == 'scalar_spectral'\n"
    )
    done = python(code, {name: value for name, value in os.environ.items() if name != variant.ENVIRONMENT_VARIABLE})
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["NacreBSDF[specular]"] * 2


VALUES = """
import numpy as np
import nacre
import nacre.render
from lobe_trials import directions
mi = nacre.render.use_variant()
import drjit as dr
recipes = (
    {"substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": 300}], "surface": {"roughness": [0.2, 0.4]}},
    {"substrate": "BK7", "layers": [{"material": "Ag", "thickness_nm": 10}], "surface": {"roughness": 0.3,
     "distribution": "beckmann", "compensate": True}},
    {"substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": {"formula": "100 + 300*v", "min": 100,
     "max": 400}}], "surface": {"roughness": 0.3, "distribution": "blinn"}},
    {"preset": "morpho"},
)
worst = 0.0
for recipe in recipes:
    bsdf = nacre.material({"family": "film", **recipe}).bsdf()
    plugin = nacre.render.make_bsdf(bsdf)
    eye, light = directions(6, 1, bsdf.transmits), directions(6, 2, bsdf.transmits)
    uv = np.array([0.3, 0.4])
    expected = bsdf.evaluate(light, eye, np.broadcast_to(uv, (6, 2)))
    nodes = np.linspace(0, len(bsdf.wavelengths_nm) - 1, 4).astype(int)
    for k in range(6):
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(*map(float, eye[k]))
        si.wavelengths = mi.Spectrum(*map(float, bsdf.wavelengths_nm[nodes]))
        si.uv = mi.Point2f(*map(float, uv))
        wo = mi.Vector3f(*map(float, light[k]))
        value = np.ravel(plugin.eval(mi.BSDFContext(), si, wo)) / abs(light[k, 2])
        worst = max(worst, np.abs(value - expected[k, nodes]).max() / expected.max())
        bs, weight = plugin.sample(mi.BSDFContext(), si, 0.3, mi.Point2f(0.4, 0.7))
        assert np.isfinite(np.array(weight)).all()
print(mi.variant(), worst)
"""


def test_scalar_variant_gives_the_same_values() -> None:
    """The fallback is slow, not different."""
    helpers = str(Path(__file__).parents[1] / "helpers")
    done = python(VALUES, {**os.environ, "PYTHONPATH": helpers, variant.ENVIRONMENT_VARIABLE: "scalar_spectral"})
    assert done.returncode == 0, done.stderr
    name, worst = done.stdout.split()
    assert name == "scalar_spectral" and float(worst) <= 1e-4


@pytest.mark.gpu
def test_gpu_renders_what_the_arrays_say() -> None:
    """The same plugins run in cuda_ad_spectral."""
    helpers = str(Path(__file__).parents[1] / "helpers")
    path = os.pathsep.join([helpers, os.environ.get("PYTHONPATH", "")])
    done = python(VALUES, {**os.environ, "PYTHONPATH": path, variant.ENVIRONMENT_VARIABLE: "cuda_ad_spectral"})
    assert done.returncode == 0, done.stderr
    name, worst = done.stdout.split()
    assert name == "cuda_ad_spectral" and float(worst) <= 1e-4


@pytest.mark.render
def test_the_test_kernel_of_the_gpu_expects_what_another_backend_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit as dr
    import drjit.llvm

    import nacre.render

    nacre.render.use_variant()
    monkeypatch.setattr(dr, "has_backend", lambda backend: True)
    monkeypatch.setitem(sys.modules, "drjit.cuda", drjit.llvm)
    assert variant.cuda_failure() == ""


@pytest.mark.render
def test_a_ray_that_a_variant_cannot_trace_is_a_failure_and_leaves_the_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    import nacre.render

    mi = nacre.render.use_variant()
    before = mi.variant()
    trace = variant.ray_failure.__wrapped__
    assert trace("llvm_ad_spectral" if before.startswith("llvm") else before) == ""

    def without_optix(_: object) -> None:
        raise RuntimeError("Could not initialize OptiX!")

    monkeypatch.setattr(mi, "load_dict", without_optix)
    assert "OptiX" in trace("scalar_spectral") and mi.variant() == before


@pytest.mark.render
@pytest.mark.parametrize(("has_gpu", "warned"), [(True, 1), (False, 0)])
def test_a_gpu_without_rays_leaves_the_picture_to_llvm(
    has_gpu: bool, warned: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Containers often lack OptiX; the GPU used to be chosen, and the picture then failed."""
    mi = variant.import_mitsuba()
    monkeypatch.setattr(variant, "has_gpu", lambda: has_gpu)
    monkeypatch.setattr(variant, "cuda_failure", lambda: "" if has_gpu else "no NVIDIA GPU")
    monkeypatch.setattr(variant, "ray_failure", lambda: "Could not initialize OptiX!")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert variant._available(None, mi) == "llvm_ad_spectral"
    assert len([each for each in caught if "OptiX" in str(each.message)]) == warned
    with pytest.raises(MachineError, match="OptiX" if has_gpu else "GPU"):
        variant._available("cuda_ad_spectral", mi)


@pytest.mark.render
@pytest.mark.parametrize("requested", ["", "llvm_ad_spectral", "scalar_spectral"])
def test_a_polarised_picture_keeps_its_variant_whatever_the_environment_requests(
    requested: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import mitsuba

    before = mitsuba.variant()
    if requested:
        monkeypatch.setenv(variant.ENVIRONMENT_VARIABLE, requested)
    try:
        with variant.polarised_variant() as mi:
            polarised = mi.variant()
            assert polarised in variant.POLARISED and polarised.startswith(requested)
            assert variant.use_variant().variant() == polarised
        assert mi.variant() not in variant.POLARISED
    finally:
        mitsuba.set_variant(before or "llvm_ad_spectral")


def test_an_llvm_that_mitsuba_chose_wrongly_is_reported_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mitsuba imported first, its own LLVM broken, a good one beside it: not "no usable LLVM was found"."""
    good = llvm.Probe("/x/libLLVM-19.so", "19.1.0", "")
    monkeypatch.setattr(llvm, "find_llvm", lambda: (good, (good,)))
    monkeypatch.setattr(llvm, "use_llvm", lambda: None)
    monkeypatch.setattr(variant, "_variant_failure", lambda name, mi: "it fails")
    with pytest.warns(RuntimeWarning, match=r"imported before nacre.render.*DRJIT_LIBLLVM_PATH=/x/libLLVM-19.so"):
        assert variant._available(None, sys) == "scalar_spectral"


def test_a_variant_that_was_set_on_a_broken_llvm_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mitsuba was imported first and found LLVM 14 to 16, whose first minimum would end the whole process."""
    import nacre.render

    mi = nacre.render.use_variant()
    if not mi.variant().startswith("llvm"):
        pytest.skip("the variant that is set needs no LLVM")
    broken = llvm.Probe("", "15.0.7", "it aborts")
    found = llvm.Probe("/x/libLLVM-19.so", "19.1.7", "")
    monkeypatch.setattr(llvm, "use_llvm", lambda: None)
    monkeypatch.setattr(llvm, "probe_library", lambda path: broken)
    monkeypatch.setattr(llvm, "find_llvm", lambda: (found, (found,)))
    variant._set_variant_failure.cache_clear()
    try:
        with pytest.raises(MachineError, match=r"imported before nacre.render.*DRJIT_LIBLLVM_PATH=/x/libLLVM-19.so"):
            variant.use_variant()
        with pytest.raises(RuntimeError, match="imported before nacre.render"):
            mi.load_dict({"type": "nacre", "recipe": "not asked for.toml"})
    finally:
        variant._set_variant_failure.cache_clear()


@pytest.mark.render
@pytest.mark.skipif(
    not (Path("/proc/cpuinfo").exists() and "avx2" in Path("/proc/cpuinfo").read_text()), reason="needs AVX2 and Linux"
)
def test_kernels_gather_by_instructions_of_the_processor(mi: ModuleType) -> None:
    import drjit as dr
    from drjit.llvm import Float, UInt32

    rng = np.random.default_rng(5)
    values, places = rng.random(1000, dtype=np.float32), rng.integers(0, 1000, 333)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        index = UInt32(places.astype(np.uint32))
        found = np.array(dr.gather(Float, Float(values), index, index < 500))
        sources = [entry["ir"].getvalue() for entry in dr.kernel_history() if "ir" in entry]
    assert np.array_equal(found, np.where(places < 500, values[places], 0.0))
    gathers = [source for source in sources if "masked.gather" in source]
    assert gathers and all("+fast-gather" in source for source in gathers)


@pytest.mark.render
def test_a_scene_in_a_mono_variant_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    code = (
        "import nacre.render, mitsuba as mi\nmi.set_variant('llvm_ad_mono')\n"
        f"mi.load_dict({{'type': 'nacre', 'recipe': {str(tmp_path / 'a.toml')!r}}})\n"
    )
    done = python(code, dict(os.environ))
    assert done.returncode != 0 and "this is llvm_ad_mono." in done.stderr


RGB_RECIPES = 4
RGB_AGAINST_SPECTRAL = """
import nacre, nacre.render, numpy as np, mitsuba as mi
def picture(variant, bsdf):
    mi.set_variant(variant)
    from nacre.device.bsdf import make_bsdf
    white = {"type": "rgb", "value": 1.0} if "rgb" in variant else {"type": "d65"}
    camera = {"type": "orthographic", "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
              "film": {"type": "hdrfilm", "width": 16, "height": 16}}
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": camera,
                          "light": {"type": "constant", "radiance": white},
                          "object": {"type": "rectangle", "bsdf": make_bsdf(bsdf)}})
    return np.array(mi.render(scene, spp=256)).mean((0, 1))
for recipe in (
    {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 300}]},
    {"family": "film", "substrate": "Al", "layers": [{"material": "TiO2", "thickness_nm": 120}],
     "surface": {"roughness": 0.2}},
    {"family": "film", "substrate": {"n": 1.5}, "base": {"albedo": 0.5}},
    {"family": "blend", "mask": 0.4, "first": {"family": "film", "substrate": "Au", "surface": {"roughness": 0.1}},
     "second": {"family": "film", "substrate": "Si"}},
):
    bsdf = nacre.material(recipe).bsdf()
    print(*picture("llvm_ad_rgb", bsdf), *picture("llvm_ad_spectral", bsdf))
"""


@pytest.mark.render
def test_an_rgb_variant_shows_the_colours_of_the_spectral_one() -> None:
    done = python(RGB_AGAINST_SPECTRAL, dict(os.environ))
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines()[-RGB_RECIPES:]:
        rgb, spectral = np.array(line.split(), dtype=float).reshape(2, 3)
        # one bounce: the projection is exact; noise of 65,000 samples with 4 wavelengths each
        np.testing.assert_allclose(rgb, spectral, rtol=0.02, atol=0.003)


RGB_TABLE = """
import nacre, numpy as np
from nacre.core.arrays import direction
from nacre.device.bsdf import projected_to_rgb
from nacre.light import spectrum_to_rgb_matrix
pearl = {"family": "pearl", "quality": "fast", "base": {"albedo": 0.6}, "strata": [
    {"resin": {"n": 1.5}, "thickness_um": 100, "roughness": 0.2, "platelets": [
        {"volume_fraction": 0.05, "substrate": {"material": "mica", "thickness_nm": 300}, "normal_deviation": 0.1,
         "coatings": [{"material": "TiO2", "thickness_nm": 60}]}]}]}
import nacre.families.pearl.tables as tables
for name in ("WALKS", "BASE_WALKS", "SINGLES", "PRODUCTS", "CHECK_WALKS", "CHECK_SINGLES"):
    setattr(tables, name, getattr(tables, name) // 10)  # whose noise the projection takes over
bsdf = nacre.material(pearl).bsdf(np.linspace(400.0, 700.0, 7))
random = np.random.default_rng(2)
wi, wo = (direction(np.arccos(random.uniform(0.3, 1.0, 400)), random.uniform(0, 2 * np.pi, 400)) for _ in "io")
wanted = np.maximum(bsdf.evaluate(wi, wo) @ spectrum_to_rgb_matrix(bsdf.wavelengths_nm), 0.0)
found = projected_to_rgb(bsdf).evaluate(wi, wo)
print(np.abs(found - wanted).max() / wanted.max(), np.median(np.abs(found / wanted - 1.0)))
walk = nacre.material({**pearl, "quality": "reference"}).bsdf(np.linspace(400.0, 700.0, 13))
try:
    projected_to_rgb(walk)
except nacre.NacreError as error:
    print(type(error).__name__)
"""


@pytest.mark.render
def test_a_lobe_that_is_not_linear_is_projected_as_a_table() -> None:
    done = python(RGB_TABLE, dict(os.environ))
    assert done.returncode == 0, done.stderr
    numbers, refused = done.stdout.splitlines()[-2:]
    worst, median = map(float, numbers.split())
    assert worst < 0.03 and median < 0.01 and refused == "UnsupportedError"


SCALAR_BLEND = """
import nacre, nacre.render, numpy as np, mitsuba as mi
blend = nacre.material({"family": "blend", "mask": 0.5,
    "first": {"family": "film", "substrate": "Au", "surface": {"roughness": 0.3}},
    "second": {"family": "film", "substrate": "Al", "surface": {"roughness": 0.3}}}).bsdf()
for variant in ("scalar_spectral", "scalar_rgb"):
    mi.set_variant(variant)
    from nacre.device.bsdf import make_bsdf
    bsdf, context, point = make_bsdf(blend), mi.BSDFContext(), mi.SurfaceInteraction3f()
    point.wi, point.wavelengths = mi.Vector3f(0.6, 0.0, 0.8), [450.0, 500.0, 550.0, 600.0][: len(point.wavelengths)]
    for wo in (mi.Vector3f(0.0, 0.0, 0.0), mi.Vector3f(-0.6, 0.0, 0.8)):
        print(*np.ravel(bsdf.eval(context, point, wo)))
"""


@pytest.mark.render
def test_a_scalar_variant_gives_no_light_where_no_direction_was_drawn() -> None:
    """Scalars cannot be divided by 0; a failed draw of one lobe is evaluated by the other lobes."""
    done = python(SCALAR_BLEND, dict(os.environ))
    assert done.returncode == 0, done.stderr
    values = [np.array(line.split(), dtype=float) for line in done.stdout.splitlines()[-4:]]
    assert all(np.all(nothing == 0.0) for nothing in values[::2]) and all(np.all(light > 0.1) for light in values[1::2])
