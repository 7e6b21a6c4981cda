"""Spectra of the USGS library and of StellarNet SpectraWiz: small files in their form, written here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.curves import spectrum
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file

UM = np.linspace(0.4, 0.8, 9)
FACTOR = np.linspace(0.1, 0.5, 9)
TITLE = " splib07a Record=5932: Kaolinite CM5                 {spectrometer} {kind}"


def column(path: Path, title: str, values: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([title, *(f" {value:.7e}" for value in values)]) + "\n", encoding="utf-8")
    return path


def usgs(folder: Path, values: np.ndarray = FACTOR, spectrometer: str = "BECKb", kind: str = "AREF") -> Path:
    name = f"splib07a_Kaolinite_CM5_{spectrometer}_{kind}.txt"
    return column(folder / "ChapterM_Minerals" / name, TITLE.format(spectrometer=spectrometer, kind=kind), values)


def wavelengths(folder: Path, spectrometer: str = "BECK", um: np.ndarray = UM, more: str = "") -> Path:
    title = f" splib07a Record=13: Wavelengths {spectrometer} microns"
    return column(folder / f"splib07a_Wavelengths_{spectrometer}{more}_microns.txt", title, um)


@pytest.mark.parametrize("place", ["", "ChapterM_Minerals"])
def test_usgs_takes_the_wavelengths_beside_it_or_above_its_folder(tmp_path: Path, place: str) -> None:
    wavelengths(tmp_path / place)
    values = FACTOR.copy()
    values[[0, 4]] = -1.23e34
    (found,) = open_file(usgs(tmp_path, values))
    kept = np.delete(np.arange(9), [0, 4])
    np.testing.assert_allclose(found.data["wavelength_nm"], 1e3 * UM[kept], rtol=1e-6)
    np.testing.assert_allclose(found.data["reflectance"], FACTOR[kept], rtol=1e-6)
    assert (found.format, found.name, found.metadata["record"]) == ("usgs-splib", "Kaolinite CM5", "5932")
    assert found.left_out == ("2 deleted channels",)


def test_usgs_without_wavelengths_is_refused_and_takes_a_named_file(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    with pytest.raises(NacreError):
        open_file(path)
    given = wavelengths(tmp_path / "elsewhere")
    (found,) = open_file(path, ReadOptions(wavelengths=str(given)))
    np.testing.assert_allclose(found.data["wavelength_nm"], 1e3 * UM, rtol=1e-6)


def test_usgs_pairs_the_spectrometer_and_the_number_of_channels(tmp_path: Path) -> None:
    wavelengths(tmp_path, "ASD")  # as many channels of another spectrometer
    wavelengths(tmp_path, "BECK", UM[:-1])  # another number
    with pytest.raises(NacreError):
        open_file(usgs(tmp_path))
    wavelengths(tmp_path, "BECK", UM + 0.1, "_b")
    (found,) = open_file(usgs(tmp_path))
    np.testing.assert_allclose(found.data["wavelength_nm"], 1e3 * UM + 100, rtol=1e-6)
    wavelengths(tmp_path, "BECK", UM + 0.2, "_c")
    with pytest.raises(NacreError):
        open_file(usgs(tmp_path))


def test_usgs_transmittance_and_what_is_no_spectrum(tmp_path: Path) -> None:
    given = wavelengths(tmp_path)
    (found,) = open_file(usgs(tmp_path, kind="TRAN"))
    np.testing.assert_allclose(found.data["transmittance"], FACTOR, rtol=1e-6)
    with pytest.raises(AmbiguousFileError):
        open_file(usgs(tmp_path, kind="XYZ"))
    for path in (given, usgs(tmp_path, 100 * FACTOR), usgs(tmp_path, np.full(9, -1.23e34))):
        with pytest.raises(NacreError):
            open_file(path)
    broken = usgs(tmp_path, kind="RREF")
    broken.write_text(broken.read_text().replace("1.0000000e-01", "1.0 2.0"))
    with pytest.raises(NacreError):
        open_file(broken)


def test_wavelengths_are_refused_for_another_format(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("wavelength (nm),%R\n400,10\n500,20\n600,30\n")
    with pytest.raises(NacreError):
        open_file(path, ReadOptions(wavelengths=str(path)))


def stellarnet(folder: Path, suffix: str, view: str, values: np.ndarray) -> Path:
    path = folder / f"sample{suffix}"
    settings = "Wave:632.47nm  Pix:1050  Val:1.5  Time:30ms  Avg:10  Sm:1"
    head = f'" File: Users\\lab\\sample{suffix[:-1]}\n"  {view}->  {settings}\n'
    rows = "".join(f" {nm:.2f}  {value:.4E}\n" for nm, value in zip(1e3 * UM, values, strict=True))
    path.write_text(head + rows, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("suffix", "view", "quantity"),
    [
        (".SSM", "SCOPE", "counts"),
        (".ABS", "ABSOR", "absorbance"),
        (".IRR", "WATTS", "irradiance"),  # a view that is not known: the suffix
        (".txt", "SCOPE", "counts"),  # and the reverse
        (".TRM", "TRANS", "transmittance"),
    ],
)
def test_stellarnet_takes_the_quantity_from_view_or_suffix(
    tmp_path: Path, suffix: str, view: str, quantity: str
) -> None:
    path = stellarnet(tmp_path, suffix, view, FACTOR)
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["wavelength_nm"], 1e3 * UM)
    np.testing.assert_allclose(found.data[quantity], FACTOR, rtol=1e-4)
    assert found.format == "stellarnet"
    assert found.metadata["integration_time"] == "30ms"
    if quantity != "transmittance":
        with pytest.raises(NacreError):
            spectrum(path, ("reflectance",))


def test_stellarnet_ratios_in_per_cent_are_reflectances_where_a_key_states_it(tmp_path: Path) -> None:
    path = stellarnet(tmp_path, ".TRM", "TRANS", 100 * FACTOR)
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["transmittance"], FACTOR, rtol=1e-4)
    np.testing.assert_allclose(spectrum(path, ("reflectance",))[1], FACTOR, rtol=1e-4)


@pytest.mark.parametrize(("suffix", "view"), [(".TRM", "SCOPE"), (".txt", "WATTS")])
def test_stellarnet_asks_where_view_and_suffix_contradict_or_are_unknown(
    tmp_path: Path, suffix: str, view: str
) -> None:
    path = stellarnet(tmp_path, suffix, view, FACTOR)
    with pytest.raises(AmbiguousFileError) as caught:
        open_file(path)
    assert caught.value.option == "quantity"
    with pytest.raises(NacreError):
        spectrum(path, ("reflectance",))
    (found,) = open_file(path, ReadOptions(quantity="counts"))
    np.testing.assert_allclose(found.data["counts"], FACTOR, rtol=1e-4)


CARDS = {
    "blanks": "wl red blue\n" + "".join(f"{um:.2f} {a:.3f} {1 - a:.3f}\n" for um, a in zip(UM, FACTOR, strict=True)),
    "decimal commas": "Wavelength (um);red;blue\n"
    + "".join(f"{um:.2f};{a:.3f};{1 - a:.3f}\n" for um, a in zip(UM, FACTOR, strict=True)).replace(".", ","),
    "per cent of nm": "wavelength,red,blue\n"
    + "".join(f"{1e3 * um:.0f},{100 * a:.1f},{100 - 100 * a:.1f}\n" for um, a in zip(UM, FACTOR, strict=True)),
    "energies": "energy (eV),red,blue\n"
    + "".join(f"{1.239841984 / um:.8f},{a:.3f},{1 - a:.3f}\n" for um, a in zip(UM, FACTOR, strict=True)),
}


@pytest.mark.parametrize("form", CARDS)
def test_a_card_whose_columns_are_samples_takes_quantity_and_spectrum(tmp_path: Path, form: str) -> None:
    path = tmp_path / "card.csv"
    path.write_text(CARDS[form])
    red, blue = open_file(path, ReadOptions(quantity="reflectance"))
    assert (red.name, blue.name) == ("red", "blue")
    np.testing.assert_allclose(red.data["wavelength_nm"], 1e3 * UM, rtol=1e-6)
    np.testing.assert_allclose(red.data["reflectance"], FACTOR, rtol=1e-6)
    nm, values, _ = spectrum(path, ("reflectance",), ReadOptions(spectrum="blue"))
    np.testing.assert_allclose(nm, 1e3 * UM, rtol=1e-6)
    np.testing.assert_allclose(values, 1 - FACTOR, rtol=1e-6)
    for options in (ReadOptions(), ReadOptions(spectrum="grey")):  # a key needs one of them
        with pytest.raises(NacreError):
            spectrum(path, ("reflectance",), options)


@pytest.mark.parametrize("heads", ["wl counts blue", "wl n blue", "wl blue pixel", "sample red blue"])
def test_a_card_with_another_quantity_is_not_taken_for_samples(tmp_path: Path, heads: str) -> None:
    path = tmp_path / "card.txt"
    path.write_text(CARDS["blanks"].replace("wl red blue", heads))
    with pytest.raises(NacreError):
        spectrum(
            path, ("reflectance",), ReadOptions(spectrum=heads.split()[1] if "blue pixel" not in heads else "pixel")
        )


def test_a_card_of_samples_asks_for_the_quantity(tmp_path: Path) -> None:
    path = tmp_path / "card.txt"
    path.write_text(CARDS["blanks"])
    with pytest.raises(AmbiguousFileError) as caught:
        open_file(path)
    assert caught.value.option == "quantity"
