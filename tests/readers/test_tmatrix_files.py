"""T-matrix files as R, MATLAB, Julia and scripts of other programs write them, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices
from nacre.families.metasurface.tmatrix.tmatrix_file import (
    TMatrixFileError,
    read_several,
    read_tmatrices,
    write_tmatrices,
)
from nacre.matter.mie import mie_coefficients
from nacre.readers.registry import open_file

SHARED = Path(__file__).resolve().parents[3] / "shared" / "reference" / "instruments" / "tmatrix"
WAVELENGTHS = np.array([500.0, 520.0, 540.0])
RADIUS, INDEX, ORDER = 60.0, 2.0 + 0.1j, 3


def sphere(wavelengths: np.ndarray = WAVELENGTHS) -> AxialTMatrices:
    """Return Mie's T-matrices of a sphere in vacuum."""
    size = 2.0 * np.pi * RADIUS / wavelengths
    a, b = mie_coefficients(ORDER, size[None], np.full((1, len(size)), INDEX))
    blocks = np.zeros((len(size), ORDER + 1, 2 * ORDER, 2 * ORDER), dtype=complex)
    for m in range(ORDER + 1):
        for l in range(max(m, 1), ORDER + 1):
            blocks[:, m, l - 1, l - 1], blocks[:, m, ORDER + l - 1, ORDER + l - 1] = -b[l - 1], -a[l - 1]
    return AxialTMatrices(
        wavelengths, blocks, np.ones(len(size)), "sphere", RADIUS, 2 * RADIUS, RADIUS,
        material_index=np.full(len(size), INDEX), shape="sphere",
    )  # fmt: skip


def stored(folder: Path, change: Callable[[h5py.File], None] | None = None, name: str = "p.tmat.h5") -> Path:
    path = folder / name
    write_tmatrices(path, sphere(), "sphere")
    if change is not None:
        with h5py.File(path, "r+") as file:
            change(file)
    return path


def attributes_of_r(file: h5py.File) -> None:
    """rhdf5 writes arrays of one byte string, and scalars of shape (1,)."""
    for name in ("vacuum_wavelength", "scatterer/geometry", "scatterer/geometry/radius"):
        for key, value in list(file[name].attrs.items()):
            file[name].attrs[key] = np.array([str(value).encode()])
    file["scatterer/geometry"].attrs["shape"] = np.array([b"sphere"])
    value = file["embedding/relative_permittivity"][()]
    del file["embedding/relative_permittivity"]
    file["embedding/relative_permittivity"] = np.ravel(value)[:1]


def characters_of_matlab(file: h5py.File) -> None:
    """Older MATLAB functions write text as codes of characters, a row per mode or a column."""
    words = [w.decode() for w in file["modes/polarization"][()]]
    del file["modes/polarization"]
    file["modes/polarization"] = np.array([[ord(c) for c in w.ljust(8)] for w in words], dtype=np.uint16).T
    file["scatterer/geometry/shape"] = np.array([[c.encode() for c in "sphere"]], dtype="S1")
    del file["scatterer/geometry"].attrs["shape"]
    file["vacuum_wavelength"].attrs["unit"] = np.array([ord("n"), ord("m")], dtype=np.uint16)


def numbers_in_metres(file: h5py.File) -> None:
    """JCMsuite and COMSOL scripts work in m."""
    values = file["vacuum_wavelength"][()] * 1e-9
    del file["vacuum_wavelength"]
    file["vacuum_wavelength"] = values
    file["vacuum_wavelength"].attrs["unit"] = "m"


@pytest.mark.parametrize("change", [None, attributes_of_r, characters_of_matlab, numbers_in_metres])
def test_files_of_all_languages_hold_the_same_particle(tmp_path: Path, change: Any) -> None:
    found = read_tmatrices(stored(tmp_path, change))
    np.testing.assert_allclose(found.blocks, sphere().blocks, atol=1e-14)
    np.testing.assert_allclose(found.wavelengths_nm, WAVELENGTHS)
    assert found.shape == "sphere" and found.radius_nm == pytest.approx(RADIUS)


def test_the_front_door_states_extinction_and_embedding(tmp_path: Path) -> None:
    (found,) = open_file(stored(tmp_path))
    a, b = mie_coefficients(ORDER, (2 * np.pi * RADIUS / WAVELENGTHS)[None], np.full((1, 3), INDEX))
    order = np.arange(1, ORDER + 1)[:, None]
    mie = 2.0 * np.pi / (2 * np.pi / WAVELENGTHS) ** 2 * np.sum((2 * order + 1) * (a + b).real, axis=0)
    np.testing.assert_allclose(found.data["mean_extinction_nm2"], mie, rtol=1e-12)
    assert (found.kind, found.metadata["modes"], found.metadata["shape"]) == ("tmatrix", 30, "sphere")


def replaced(name: str, value: Any, **attributes: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = value
        file[name].attrs.update(attributes)

    return change


def conjugated(file: h5py.File) -> None:
    file["tmatrix"][...] = np.conj(file["tmatrix"][()])


def conjugated_with_its_material(file: h5py.File) -> None:
    conjugated(file)
    file["scatterer/material/relative_permittivity"][...] = np.conj(INDEX) ** 2


def linked(kind: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file.move("scatterer/geometry", "elsewhere")
        file["scatterer/geometry"] = kind

    return change


REFUSED: dict[str, Callable[[h5py.File], None]] = {
    "numbers in nm under m": replaced("vacuum_wavelength", WAVELENGTHS, unit="m"),
    "chirality parameter": replaced("embedding/chirality_parameter", 0.08),
    "chirality": replaced("embedding/chirality", 0.08),
    "origin above the particle": replaced("modes/positions", np.array([[0.0, 0.0, 150.0]]), unit="nm"),
    "two embeddings": replaced("embedding/refractive_index", 1.5),
    "other time": conjugated,
    "other time, material too": conjugated_with_its_material,
    "external link": linked(h5py.ExternalLink("other.h5", "/geometry")),
    "soft link": linked(h5py.SoftLink("/elsewhere")),
    "dangling link": linked(h5py.SoftLink("/nowhere")),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_read_wrongly_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(TMatrixFileError):
        read_tmatrices(stored(tmp_path, REFUSED[name]))


def spheroid_file(folder: Path, is_conjugate: bool) -> Path:
    """Write a small gold-like spheroid by its Gans dipole."""
    wavelengths, radius, half = np.array([600.0]), 10.0, 20.0
    e = np.sqrt(1.0 - (radius / half) ** 2)
    along = (1.0 - e**2) / e**2 * (np.arctanh(e) / e - 1.0)
    epsilon, k = -9.0 + 1.5j, 2 * np.pi / wavelengths
    blocks = np.zeros((1, 2, 2, 2), dtype=complex)
    for m, factor in ((0, along), (1, 0.5 * (1.0 - along))):
        alpha = 4 * np.pi / 3 * radius**2 * half * (epsilon - 1) / (1 + factor * (epsilon - 1))
        static = 1j * k**3 / (6 * np.pi) * alpha
        blocks[:, m, 1, 1] = static / (1 - static)
    blocks = blocks.conj() if is_conjugate else blocks
    known = AxialTMatrices(
        wavelengths, blocks, np.ones(1), "spheroid", radius, 2 * half, half, material_index=np.sqrt(epsilon)[None],
        shape="spheroid",
    )  # fmt: skip
    write_tmatrices(folder / "s.tmat.h5", known, "spheroid")
    return folder / "s.tmat.h5"


def test_a_small_spheroid_gives_its_time_sign(tmp_path: Path) -> None:
    assert read_tmatrices(spheroid_file(tmp_path, False)).shape == "spheroid"
    with pytest.raises(TMatrixFileError):
        read_tmatrices(spheroid_file(tmp_path, True))


def test_a_folder_and_a_pattern_are_one_particle(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    for wavelength in WAVELENGTHS:
        write_tmatrices(tmp_path / "runs" / f"w{wavelength:g}.tmat.h5", sphere(np.array([wavelength])), "sphere")
    files = sorted((tmp_path / "runs").iterdir())
    np.testing.assert_allclose(read_several(files[::-1]).blocks, sphere().blocks, atol=1e-14)
    recipe = {"family": "metasurface", "substrate": "glass", "monolayer": {"coverage": 0.05}}
    recipe["model"] = {"correction": "qca-balanced"}
    grid = np.array([500.0, 540.0])
    write_tmatrices(tmp_path / "whole.tmat.h5", sphere(), "sphere")
    parts = []
    for name in ("whole.tmat.h5", "runs", "runs/w*.tmat.h5"):
        made = nacre.material({**recipe, "particle": {"tmatrix": name}}, tmp_path)
        parts.append(made.spectrum([0.0], grid).diffuse_reflectance)
        assert len(made.context.dependencies) == (1 if name.startswith("whole") else 3)
    np.testing.assert_allclose(parts[1], parts[0], rtol=1e-9)
    np.testing.assert_allclose(parts[2], parts[0], rtol=1e-9)
    with pytest.raises(NacreError):
        nacre.material({**recipe, "particle": {"tmatrix": "runs/none*.h5"}}, tmp_path)


@pytest.mark.parametrize(
    "other", [sphere(), sphere(np.array([560.0])).__class__(np.array([560.0]), sphere().blocks[:1], np.ones(1))]
)
def test_files_of_different_particles_are_refused(tmp_path: Path, other: AxialTMatrices) -> None:
    paths = [stored(tmp_path), tmp_path / "q.tmat.h5"]
    write_tmatrices(paths[1], other, other.shape)
    with pytest.raises(TMatrixFileError):
        read_several(paths)


@pytest.mark.skipif(not SHARED.exists(), reason="the shared files of instruments are not here")
def test_the_shared_files_are_read_or_refused_as_their_readings_say() -> None:
    for entry in json.loads((SHARED / "index.json").read_text()):
        reading, path = entry["right_reading"], SHARED / entry["file"]
        if not reading.get("mean_extinction_nm2"):
            with pytest.raises(NacreError):
                open_file(path)
            continue
        (found,) = open_file(path)
        assert (found.metadata["axis"], found.metadata["unit_in_file"]) == (reading["axis"], reading["unit"])
        assert found.metadata["modes"] == reading["modes"]
        np.testing.assert_allclose(found.data["embedding_index"], reading["embedding_index"], rtol=1e-6)
        for place, element in ((0, "first_element"), (-1, "last_element")):
            value = found.data["tmatrix"][place, place, place]
            assert [value.real, value.imag] == pytest.approx(reading[element], rel=1e-6)
        extinction = dict(zip(found.data["wavelength_nm"].round(6), found.data["mean_extinction_nm2"]))
        for each in reading["mean_extinction_nm2"]:
            assert extinction[each["nm"]] == pytest.approx(each["C"], rel=1e-5)
