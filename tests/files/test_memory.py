"""Memory is refused before it is taken: every size that a user's number or file decides has its one line."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.sweep_plan import load_sweep
from nacre.cli import run
from nacre.core import machine
from nacre.core.errors import MachineError, UnsupportedError
from nacre.families.metasurface.monolayer.arrangement import random_sequential
from nacre.light import delta_e_2000, spectrum_to_xyz, xyz_to_lab
from nacre.readers.bsdf.databases import read_tensor

RELIEF = """family = "relief"
heights = "heights.npy"
feature_um = {feature_um}
blur_um = 0.4
[coherence]
sigma = {sigma}
"""
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
# what a refusal may take itself: the packages, and nothing that grows with what is asked
ADDRESS_SPACE = 6 << 30


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow 64 MiB."""
    monkeypatch.setenv(machine.VARIABLE, "64MiB")


def relief(folder: Path, **numbers: float) -> Path:
    np.save(folder / "heights.npy", np.random.default_rng(1).random((8, 8)) * 0.3)
    path = folder / "relief.toml"
    path.write_text(RELIEF.format(**{"feature_um": 1.0, "sigma": 1.5, **numbers}))
    return path


@pytest.mark.parametrize(
    ("text", "amount"), [("4GiB", 4 << 30), ("500 MB", 500_000_000), ("1.5gib", 3 << 29), ("2147483648", 2 << 30)]
)
def test_the_limit_is_written_as_people_write_memory(text: str, amount: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(machine.VARIABLE, text)
    assert machine.memory_limit() == amount


@pytest.mark.parametrize("text", ["much", "-1GiB", "4 apples", "0", "1e9", "nan", "12", "9" * 40])
def test_an_amount_that_cannot_be_read_is_one_line(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(machine.VARIABLE, text)
    with pytest.raises(MachineError, match="is not an amount of memory; write it like 4GiB"):
        machine.memory_limit()
    (tmp_path / "film.toml").write_text(FILM)
    assert run(["spectrum", str(tmp_path / "film.toml"), "--wavelengths-nm", "400:700:1"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert run(["doctor", "--json"]) == 0
    found = next(f for f in json.loads(capsys.readouterr().out) if f["what"] == "memory")
    assert found["state"] == "bad" and found["advice"]


def test_without_a_limit_a_quarter_of_the_machine_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(machine.VARIABLE, raising=False)
    monkeypatch.setattr(machine, "machine_memory", lambda: 8 << 30)
    machine.check_memory(2 << 30, "size = 1")
    with pytest.raises(UnsupportedError, match=r"^size = 1 asks for 3 GiB of memory; at most 2 GiB are allowed \("):
        machine.check_memory(3 << 30, "size = 1")
    with pytest.raises(UnsupportedError):
        machine.check_memory(float("nan"), "size = 1")


def test_a_container_counts_as_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "max").write_text("1073741824\n")
    (tmp_path / "none").write_text("max\n")
    monkeypatch.setattr(machine, "_CONTAINER_LIMITS", (str(tmp_path / "none"), str(tmp_path / "missing")))
    whole = machine.machine_memory()
    assert whole > 1 << 30
    monkeypatch.setattr(machine, "_CONTAINER_LIMITS", (str(tmp_path / "none"), str(tmp_path / "max")))
    assert machine.machine_memory() == 1 << 30


def refused(arguments: list[str], folder: Path) -> str:
    """Run a command under a limit of its address space; return its one line."""
    code = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({ADDRESS_SPACE}, {ADDRESS_SPACE}))\n"
        f"from nacre.cli import main; main({arguments!r})"
    )
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 2, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ({"sigma": 1e-7}, "feature_um = 1 "),
        ({"feature_um": 1e6}, "feature_um = 1e+06 "),
        ({"sigma": 1e4}, "coherence sigma = 1e+04"),
    ],
)
def test_a_relief_of_impossible_size_is_refused_in_time(numbers: dict[str, float], named: str, tmp_path: Path) -> None:
    """A tiny sigma asked for 737 GiB."""
    relief(tmp_path, **numbers)
    line = refused(["spectrum", "relief.toml"], tmp_path)
    assert named in line and "iB" in line and "allowed" in line


@pytest.mark.parametrize("feature_um", [1e-3, 1e-6, 1e-12])
def test_features_far_below_the_blur_make_a_flat_mirror(feature_um: float, tmp_path: Path) -> None:
    """The sum over neighbouring tiles had as many terms as features in the blur."""
    rough = nacre.load(relief(tmp_path, feature_um=feature_um)).spectrum([0.3], [500.0, 600.0])
    np.save(tmp_path / "heights.npy", np.zeros((8, 8)))
    flat = nacre.load(tmp_path / "relief.toml").spectrum([0.3], [500.0, 600.0])
    for name, values in flat.parts().items():
        np.testing.assert_allclose(rough.parts()[name], values, atol=1e-6)


def test_a_file_that_unpacks_to_more_than_is_allowed_is_refused_before(tmp_path: Path, small: None) -> None:
    """The array is refused before it is read: the file does not even contain all of it."""
    path = tmp_path / "film.nacre"
    nacre.material({"family": "film", "substrate": "Si"}).bsdf([500.0, 600.0]).save(path)
    with zipfile.ZipFile(path) as packed:
        entries = {name: packed.read(name) for name in packed.namelist()}
    header = json.loads(entries["header.json"])
    name, described = next((n, a) for n, a in header["arrays"].items() if len(a["shape"]) == 2)
    described["shape"] = [1 << 24, 2]
    entries["header.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for entry, content in entries.items():
            if entry == f"{name}.npy":
                with packed.open(entry, "w", force_zip64=True) as stream:
                    np.lib.format.write_array_header_1_0(
                        stream, {"descr": "<f8", "fortran_order": False, "shape": (1 << 24, 2)}
                    )
                    for _ in range(64):
                        stream.write(bytes(4 << 20))
            else:
                packed.writestr(entry, content)
    assert path.stat().st_size < 4 << 20
    with pytest.raises(UnsupportedError, match=r"film\.nacre: unpacked, it asks for 256 MiB of memory; at most 64 MiB"):
        nacre.load(path)


THICK = {"family": "film", "substrate": "Si",
         "layers": [{"material": {"n": 1.5, "k": 1.0}, "thickness_um": 10}] * 50}  # fmt: skip


def test_an_opaque_film_has_no_fringes_to_resolve() -> None:
    """Fifty layers of 10 um with k = 1 took 47,002 wavelengths; no light comes back from below the first micron."""
    film = nacre.material(THICK)
    assert len(film.model.wavelengths_nm) <= 48 * 4
    bulk = nacre.material({"family": "film", "substrate": {"n": 1.5, "k": 1.0}})
    np.testing.assert_allclose(
        film.spectrum([0.0, 1.0], [400.0, 700.0]).specular_reflectance,
        bulk.spectrum([0.0, 1.0], [400.0, 700.0]).specular_reflectance, atol=1e-9,
    )  # fmt: skip


@pytest.mark.parametrize("k", [0.0, 1e-3, 0.01, 0.05])
def test_what_light_does_come_back_from_keeps_its_fringes(k: float) -> None:
    """A weakly absorbing film's colour on its own grid is that on a grid of 0.05 nm."""
    layers = [{"material": {"n": 1.8, "k": k}, "thickness_um": 8}]
    film = nacre.material({"family": "film", "substrate": "Al", "layers": layers})
    own = film.spectrum([0.0, 0.8])
    fine = film.spectrum([0.0, 0.8], np.linspace(360.0, 830.0, 9401))
    assert own.specular_reflectance is not None and fine.specular_reflectance is not None
    found = xyz_to_lab(spectrum_to_xyz(own.specular_reflectance, own.wavelengths_nm))
    exact = xyz_to_lab(spectrum_to_xyz(fine.specular_reflectance, fine.wavelengths_nm))
    assert np.max(delta_e_2000(found, exact)) <= 0.5


def test_an_opaque_stack_on_glass_keeps_the_fringes_seen_from_below() -> None:
    layers = [{"material": {"n": 1.5, "k": 2.0}, "thickness_um": 1}, {"material": "SiO2", "thickness_um": 8}]
    film = nacre.material({"family": "film", "substrate": {"n": 1.9}, "layers": layers})
    clear = nacre.material({"family": "film", "substrate": {"n": 1.9}, "layers": layers[1:]})
    assert len(film.model.wavelengths_nm) >= len(clear.model.wavelengths_nm)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--angles-deg", "0:90:0.01", "--wavelengths-nm", "380:780:0.01"], "9001 angles x 40001 wavelengths"),
        (["--wavelengths-nm", "380:780:0.004"], "100001"),
    ],
)
def test_a_spectrum_of_too_many_values_is_refused(
    arguments: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], small: None
) -> None:
    (tmp_path / "film.toml").write_text(FILM)
    assert run(["spectrum", str(tmp_path / "film.toml"), *arguments]) == 2
    line = capsys.readouterr().err
    assert len(line.splitlines()) == 1 and "at most" in line


def test_directions_points_textures_and_foreign_files_ask_as_well(tmp_path: Path, small: None) -> None:
    film = nacre.material({"family": "film", "substrate": "Si", "surface": {"roughness": 0.2}})
    with pytest.raises(UnsupportedError, match="200000 pairs of directions x 48 wavelengths asks for"):
        nacre.evaluate(film, np.broadcast_to([0.0, 0.0, 1.0], (200_000, 3)), [0.0, 0.6, 0.8])
    (tmp_path / "film.toml").write_text(FILM)
    (tmp_path / "sweep.toml").write_text(
        'recipe = "film.toml"\nmode = "sobol"\ncount = 5000000\n'
        '[axes]\n"layers[0].thickness_nm" = {low = 1, high = 9}\n'
    )
    with pytest.raises(UnsupportedError, match=r"sweep\.toml: a sweep of 5000000 points asks for"):
        load_sweep(tmp_path / "sweep.toml")
    with pytest.raises(UnsupportedError, match="a pattern of 1000 points at packing 1e-06 asks for"):
        random_sequential(1000, 1e-6, 1e-6)
    tensor = tmp_path / "big.bsdf"
    with tensor.open("wb") as file:  # sparse: 1 GiB of nothing
        file.write(b"tensor_file\0" + struct.pack("<BBI", 1, 0, 0))
        file.truncate(1 << 30)
    with pytest.raises(UnsupportedError, match=r"big\.bsdf: read .* asks for 3 GiB"):
        read_tensor(tensor)


def test_a_large_texture_asks_before_it_is_unpacked(tmp_path: Path, small: None) -> None:
    from PIL import Image

    Image.new("L", (4000, 4000)).save(tmp_path / "grey.png")
    layer = {"material": "SiO2", "thickness_nm": {"texture": "grey.png", "min": 100, "max": 200}}
    with pytest.raises(UnsupportedError, match=r"grey\.png.*4000 x 4000.*366 MiB"):
        nacre.material({"family": "film", "substrate": "Si", "layers": [layer]}, tmp_path)


@pytest.mark.render
@pytest.mark.parametrize(("size", "output"), [("2000x2000", "a.png"), ("300x300", "a.spectral.exr")])
def test_a_picture_asks_before_it_is_rendered(
    size: str, output: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], small: None
) -> None:
    (tmp_path / "film.toml").write_text(FILM)
    assert run(["render", str(tmp_path / "film.toml"), "--size", size, "-o", str(tmp_path / output)]) == 2
    line = capsys.readouterr().err
    assert len(line.splitlines()) == 1 and f"size = {size}: the picture asks for" in line
    assert not (tmp_path / output).exists()
