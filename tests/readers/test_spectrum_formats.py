"""Formats of spectrometers: small files in the form of each maker, written here."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file

NM = np.linspace(400.0, 700.0, 31)
PER_CENT = 20.0 + 10.0 * np.sin(NM / 40.0)
FACTOR = PER_CENT / 100.0
DARK, WHITE = 100.0, 4100.0
SAMPLE = DARK + FACTOR * (WHITE - DARK)


def rows(*columns: np.ndarray, mark: str = "\t", comma: bool = False, digits: int = 6) -> str:
    lines = [mark.join(f"{value:.{digits}f}" for value in row) for row in zip(*columns, strict=True)]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


def ocean(begin: str = "Begin Processed Spectral Data", end: bool = True, **form: bool) -> bytes:
    head = (
        "SpectraSuite Data File\n++++++++++++\nUser: x\nDark Spectrum Present: Yes\nReference Spectrum Present: Yes\n"
    )
    tail = ">>>>>End Processed Spectral Data<<<<<\n" if end else ""
    return (f"{head}>>>>>{begin}<<<<<\n" + rows(NM, PER_CENT, comma=bool(form.get("comma"))) + tail).encode()


def jaz() -> bytes:
    table = rows(NM, np.full(31, DARK), np.full(31, WHITE), SAMPLE, PER_CENT)
    head = "Jaz Data File\nDark Spectrum Present: Yes\n>>>>>Begin Processed Spectral Data<<<<<\nW\tD\tR\tS\tP\n"
    return (head + table).encode()


def procspec() -> bytes:
    def doubles(tag: str, values: np.ndarray) -> str:
        return f"<{tag}>" + "".join(f"<double>{value:.6f}</double>" for value in values) + f"</{tag}>"

    xml = "<OmniSpectrum>" + doubles("channelWavelengths", NM) + doubles("pixelValues", SAMPLE)
    xml += f"<darkSpectrum>{doubles('pixelValues', np.full(31, DARK))}</darkSpectrum>"
    xml += f"<referenceSpectrum>{doubles('pixelValues', np.full(31, WHITE))}</referenceSpectrum></OmniSpectrum>"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("ps_0.xml", xml.encode() + b"<!-- \xff\x01 -->")
    return out.getvalue()


def jcamp(form: str) -> bytes:
    head = "##TITLE=x\n##JCAMP-DX=4.24\n##DATA TYPE=UV/VIS SPECTRUM\n##XUNITS=NANOMETERS\n##YUNITS=REFLECTANCE\n"
    head += "##XFACTOR=1\n##NPOINTS=31\n##FIRSTX=400\n##LASTX=700\n"
    if form == "pairs":
        return f"{head}##YFACTOR=1\n##XYDATA=(XY..XY)\n{rows(NM, FACTOR, mark=', ')}##END=\n".encode()
    integers = np.round(FACTOR * 1e4).astype(int)
    text = f"{head}##YFACTOR=0.0001\n##XYDATA=(X++(Y..Y))\n"
    squeezed = {**{str(d): c for d, c in zip(range(10), "@ABCDEFGHI", strict=True)}}
    for start in range(0, 31, 8):
        block = integers[start : start + 8]
        if form == "affn":
            text += " ".join([f"{NM[start]:g}", *map(str, block)]) + "\n"
            continue
        # differences, with the last ordinate repeated as the check of the next line
        text += f"{NM[start]:g}{squeezed[str(block[0])[0]]}{str(block[0])[1:]}"
        following = integers[start + 1 : start + 9]
        for step in np.diff([block[0], *following]):
            lead = "%JKLMNOPQR" if step >= 0 else "%jklmnopqr"
            digits = str(abs(int(step)))
            text += lead[int(digits[0])] + digits[1:]
        text += "\n"
    if form == "dif":
        last = text.rstrip().splitlines()
        text = "\n".join(last) + "\n"
    return (text + "##END=\n").encode()


def linked_counts() -> bytes:
    blocks = ""
    for title, values in (("PROCESSED", SAMPLE), ("DARK", np.full(31, DARK)), ("REFERENCE", np.full(31, WHITE))):
        blocks += f"##TITLE= X: {title} SPECTRUM\n##JCAMP-DX= 5\n##DATA TYPE= UV/VIS SPECTRUM\n##XUNITS= NANOMETERS\n"
        blocks += "##YUNITS= Transmission (%)\n##XFACTOR= 1.0\n##YFACTOR= 1.0\n##NPOINTS= 31\n##XYPOINTS= (XY..XY)\n"
        blocks += rows(NM, values, mark=", ") + "##END=\n"
    return f"##TITLE= X\n##DATA TYPE= LINK\n##BLOCKS= 3\n{blocks}##END=\n".encode()


def avantes(nul: bool) -> bytes:
    name = b"1U1" + b"\0" * 20 * nul
    head = b"Integration time: 5 ms\nData measured with spectrometer name: " + name
    units = "\nWave ;Sample ;Dark ;Reference;Reflectance\n[nm] ;[counts] ;[counts] ;[counts] ;[%]\n\n"
    return head + (units + rows(NM, SAMPLE, np.full(31, DARK), np.full(31, WHITE), PER_CENT, mark=";")).encode()


def avantes_8() -> bytes:
    body = struct.pack("<4B10s64sBHHf", 0, 4, 16, 0, b"1U1", b"1U1", 0, 0, 30, 5.0) + bytes(231)
    for values in (NM, SAMPLE, np.full(31, DARK), np.full(31, WHITE)):
        body += values.astype("<f4").tobytes()
    return b"AVS82\1" + struct.pack("<I", len(body)) + body + bytes(10)


def avantes_6() -> bytes:
    floats = [60.0, 400.0, 10.0, 0.0, 0.0, 0.0, *map(float, b"1U1\0\0\0\0\0\0"), 0.0, 30.0, 0.0, 0.0]
    table = np.stack([SAMPLE, np.full(31, WHITE), np.full(31, DARK)], axis=1)
    return np.array([*floats, *table.ravel(), 5.0, 1.0, 0.0], dtype="<f4").tobytes()


def perkinelmer() -> bytes:
    head = "PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00\n" + "0\n" * 20
    text = f"{head}#HDR\n-1\n#GR\nnm\n%R\n1.0\n0.0\n700.0\n-10.0\n31\n8\n30.0\n10.0\n#DATA\n"
    return (text + rows(NM[::-1], PER_CENT[::-1])).encode()


def sp() -> bytes:
    def member(code: int, kind: int, body: bytes) -> bytes:
        return struct.pack("<hih", code, len(body) + 2, kind) + body

    def text(value: str) -> bytes:
        return struct.pack("<h", len(value)) + value.encode()

    values = PER_CENT.astype("<f8").tobytes()
    members = [
        member(-29838, 29974, struct.pack("<dd", 400.0, 700.0)), member(-29836, 29976, struct.pack("<d", 10.0)),
        member(-29835, 29975, struct.pack("<i", 31)), member(-29833, 29987, text("nm")),
        member(-29832, 29987, text("%R")),
        member(-29828, 29981, struct.pack("<i", len(values)) + values),
    ]  # fmt: skip
    body = b"".join(members)
    return b"PEPE" + b"x".ljust(40) + struct.pack("<hi", 120, len(body)) + body


def jasco() -> bytes:
    head = "TITLE\tfilm\nDATA TYPE\t\nORIGIN\tJASCO\nXUNITS\tNANOMETERS\nYUNITS\tREFLECTANCE\nNPOINTS\t31\nXYDATA\n"
    return (head + rows(NM[::-1], PER_CENT[::-1])).encode() + "\n[コメント]\nサンプル\t1\n".encode("cp932")


def jws() -> bytes:
    head = bytearray(0x740)
    head[:4] = b"L~S "
    struct.pack_into("<HI3d", head, 130, 1, 31, 400.0, 650.0, 10.0)
    return bytes(head) + PER_CENT.astype("<f4").tobytes()


def craic() -> bytes:
    return f"gorget\nReflectance\nSciMode:IT1=5ms:NS1=10:Obj=15X:(9/28/2012)\n{rows(NM, PER_CENT)}".encode()


def cary() -> bytes:
    lines = [f"{x:.3f},{y:.5f},{x + 5:.3f},{z:.5f}," for x, y, z in zip(NM, FACTOR, 2 * PER_CENT, strict=True)]
    lines[-1] = f"{NM[-1]:.3f},{FACTOR[-1]:.5f},,,"
    return (
        "film,,film 2,,\nWavelength (nm),Abs,Wavelength (nm),%T,\n" + "\n".join(lines) + "\n\nfilm\nUser: x\n"
    ).encode()


def across() -> bytes:
    head = "sample,date," + ",".join(f"{nm:g}" for nm in NM)
    body = [f"leaf {k},2020," + ",".join(f"{value * k:.6f}" for value in FACTOR) for k in (1, 2, 3)]
    return (head + "\n" + "\n".join(body) + "\n").encode()


def asd() -> bytes:
    head = "\nText conversion of header file x.asd\nNew ASD spectrum file: Program version = 6\n"
    return f"{head}Data is compared to a white reference:\nSerial#  0\nWavelength\tx.asd\n{rows(NM, FACTOR)}".encode()


def licor() -> bytes:
    return ('"FILE:A"\n"REM: REFL 1"\n"LIMS: 400- 700NM"\n"INT: 10NM"\n' + rows(NM, FACTOR, mark=" ")).encode()


def aster() -> bytes:
    head = (
        "Name: grass\nX Units:  Wavelength (micrometers)\nY Units:  Reflectance (percent)\nNumber of X Values: 31\n\n"
    )
    return (head + rows(NM / 1000, PER_CENT)).encode()


def woollam() -> bytes:
    return (
        "written\nnm\n" + "".join(f"uR {x:.3f} 15.0 {y:.6f} 0.01\n" for x, y in zip(NM, FACTOR, strict=True))
    ).encode()


def opus() -> bytes:
    def code(*parts: int) -> int:
        bits, shift, total = (2, 2, 6, 7, 2, 3), 0, 0
        for part, width in zip(parts, bits, strict=True):
            total, shift = total | part << shift, shift + width
        return total

    def parameter(key: str, kind: int, body: bytes) -> bytes:
        return key.encode() + b"\0" + struct.pack("<2h", kind, len(body) // 2) + body

    x = 1e7 / NM
    even = np.linspace(x[0], x[-1], 31)
    values = np.interp(1e7 / even, NM, FACTOR).astype("<f4").tobytes()
    status = parameter("NPT", 0, struct.pack("<i", 31)) + parameter("FXV", 1, struct.pack("<d", x[0]))
    status += parameter("LXV", 1, struct.pack("<d", x[-1])) + parameter("CSF", 1, struct.pack("<d", 1.0))
    status += parameter("DXU", 3, b"WN\0\0") + b"END\0\0\0\0\0"
    status += b"\0" * (-len(status) % 4)
    entries = [(code(3, 0, 0, 12, 0, 0), values), (code(3, 0, 1, 12, 0, 0), status)]
    out = bytearray(struct.pack("<4sd3i", b"\n\n\xfe\xfe", 920622.0, 24, 40, len(entries)).ljust(24 + 40 * 12, b"\0"))
    for place, (kind, body) in enumerate(entries):
        struct.pack_into("<3I", out, 24 + 12 * place, kind, len(body) // 4, len(out))
        out += body
    return bytes(out)


def spc(version: int = 0x4B, floats: bool = True) -> bytes:
    order = ">" if version == 0x4C else "<"
    exponent = -128 if floats else 0
    head = struct.pack(order + "BBBbIddIBBBBI9s9sH32s130s30sII", 0, version, 0, exponent, 31, 400.0, 700.0, 1, 3, 129,
                       0, 0, 0, b"", b"", 0, b"", b"film", b"", 0, 0).ljust(512, b"\0")  # fmt: skip
    values = FACTOR.astype(order + "f4") if floats else np.round(FACTOR * 2.0**32 / 2).astype(order + "i4")
    if not floats:
        head = head[:3] + struct.pack("b", 1) + head[4:]
    return head + bytes(32) + values.tobytes()


WRITERS: dict[str, tuple[Callable[[], bytes], str, str, float]] = {
    "ocean": (ocean, "ocean-text", "reflectance", 1e-6),
    "ocean, Spanish": (lambda: ocean("Comienza los datos"), "ocean-text", "reflectance", 1e-6),
    "ocean, decimal commas": (lambda: ocean("Début", comma=True), "ocean-text", "reflectance", 1e-6),
    "jaz": (jaz, "ocean-text", "reflectance", 1e-6),
    "procspec": (procspec, "ocean-procspec", "reflectance", 1e-6),
    "jcamp pairs": (lambda: jcamp("pairs"), "jcamp", "reflectance", 1e-6),
    "jcamp numbers": (lambda: jcamp("affn"), "jcamp", "reflectance", 1e-4),
    "jcamp differences": (lambda: jcamp("dif"), "jcamp", "reflectance", 1e-4),
    "jcamp linked counts": (linked_counts, "jcamp", "reflectance", 1e-6),
    "avantes": (lambda: avantes(False), "avantes-text", "reflectance", 1e-6),
    "avantes with NUL": (lambda: avantes(True), "avantes-text", "reflectance", 1e-6),
    "avantes 8": (avantes_8, "avantes-binary", "reflectance", 1e-5),
    "avantes 6": (avantes_6, "avantes-binary", "reflectance", 1e-5),
    "perkinelmer": (perkinelmer, "perkinelmer-text", "reflectance", 1e-6),
    "sp": (sp, "perkinelmer-sp", "reflectance", 1e-6),
    "jasco": (jasco, "jasco-text", "reflectance", 1e-6),
    "craic": (craic, "craic-text", "reflectance", 1e-6),
    "asd": (asd, "asd-text", "reflectance", 1e-6),
    "licor": (licor, "licor-prn", "reflectance", 1e-6),
    "aster": (aster, "aster", "reflectance", 1e-6),
    "woollam": (woollam, "woollam-intensity", "reflectance", 1e-6),
    "opus": (opus, "opus", "reflectance", 1e-3),
    "spc": (spc, "grams-spc", "reflectance", 1e-6),
    "spc, big-endian": (lambda: spc(0x4C), "grams-spc", "reflectance", 1e-6),
    "spc, integers": (lambda: spc(floats=False), "grams-spc", "reflectance", 1e-6),
}


def written(tmp_path: Path, data: bytes, name: str = "file.dat") -> Path:
    path = tmp_path / name
    path.write_bytes(data)
    return path


def check(measurement: Measurement, quantity: str, tolerance: float) -> None:
    nm, values = measurement.data["wavelength_nm"], measurement.data[quantity]
    assert np.all(np.diff(nm) > 0)
    np.testing.assert_allclose(nm[[0, -1]], [400.0, 700.0], rtol=1e-6)
    np.testing.assert_allclose(values, np.interp(nm, NM, FACTOR), atol=10 * tolerance if len(nm) != 31 else tolerance)


@pytest.mark.parametrize("name", list(WRITERS))
def test_each_form_is_recognised_by_content_and_read(tmp_path: Path, name: str) -> None:
    writer, format_id, quantity, tolerance = WRITERS[name]
    (measurement,) = open_file(written(tmp_path, writer()))
    assert measurement.format == format_id
    check(measurement, quantity, 1e-2 if name == "opus" else tolerance)


def test_a_jws_asks_for_its_quantity_and_computes_the_last_abscissa(tmp_path: Path) -> None:
    path = written(tmp_path, jws())
    with pytest.raises(AmbiguousFileError) as error:
        open_file(path)
    assert error.value.option == "quantity"
    (measurement,) = open_file(path, ReadOptions(quantity="reflectance (%)"))
    check(measurement, "reflectance", 1e-6)
    assert measurement.assumed


def test_a_data_point_table_asks_for_unit_and_quantity(tmp_path: Path) -> None:
    path = written(tmp_path, rows(NM, FACTOR, mark=",").encode(), "film.dpt")
    for options, asked in ((ReadOptions(), "unit"), (ReadOptions(unit="nm"), "quantity")):
        with pytest.raises(AmbiguousFileError) as error:
            open_file(path, options)
        assert error.value.option == asked
    check(open_file(path, ReadOptions(unit="nm", quantity="reflectance (1)"))[0], "reflectance", 1e-6)


def test_pairs_of_columns_are_separate_spectra(tmp_path: Path) -> None:
    first, second = open_file(written(tmp_path, cary()))
    assert (first.name, second.name) == ("film", "film 2")
    np.testing.assert_allclose(first.data["absorbance"], FACTOR, atol=1e-5)
    np.testing.assert_allclose(second.data["transmittance"], 2 * FACTOR[:-1], atol=1e-6)
    assert second.data["wavelength_nm"][0] == 405.0
    (chosen,) = open_file(written(tmp_path, cary()), ReadOptions(spectrum="film 2"))
    assert "transmittance" in chosen.data


def test_wavelengths_across_give_a_spectrum_a_row(tmp_path: Path) -> None:
    found = open_file(written(tmp_path, across()))
    assert [each.name for each in found] == ["leaf 1", "leaf 2", "leaf 3"]
    np.testing.assert_allclose(found[2].data["reflectance"], 3 * FACTOR, atol=1e-5)


@pytest.mark.parametrize("heading", ['"Wavelength nm.","R%"', "Wavelength [nm],Reflectance (%)", "nm,%R"])
def test_a_heading_in_per_cent_gives_factors(tmp_path: Path, heading: str) -> None:
    path = written(tmp_path, f"{heading}\n{rows(NM, PER_CENT, mark=',')}".encode())
    check(open_file(path)[0], "reflectance", 1e-6)


def test_a_dark_column_has_the_scale_of_its_table(tmp_path: Path) -> None:
    """A black of 0.8 % beside a white of 90 %."""
    text = "wavelength,white,black\n" + rows(NM, np.full(31, 90.0), np.full(31, 0.8), mark=",")
    white, black = open_file(written(tmp_path, text.encode()))
    assert white.data["reflectance"][0] == pytest.approx(0.9)
    assert black.data["reflectance"][0] == pytest.approx(0.008)


@pytest.mark.parametrize(
    "name", ["perkinelmer", "sp", "jasco", "avantes 8", "avantes 6", "opus", "spc", "jcamp pairs", "licor"]
)
def test_a_cut_file_with_a_stated_size_is_refused(tmp_path: Path, name: str) -> None:
    data = WRITERS[name][0]()
    tail = data.find(b"\n[") if name == "jasco" else len(data) - len(data) % 4
    with pytest.raises(NacreError):
        open_file(written(tmp_path, data[: tail - 40]))


def test_absorbance_and_counts_are_no_reflectance(tmp_path: Path) -> None:
    for text, quantity in (("Wavelength (nm),Abs\n", "absorbance"), ("Wavelength (nm),Counts\n", "counts")):
        found = open_file(written(tmp_path, (text + rows(NM, PER_CENT, mark=",")).encode()))
        assert quantity in found[0].data and "reflectance" not in found[0].data


@pytest.mark.parametrize("size", [2.0, 3000.0])
def test_values_that_do_not_decide_are_asked(tmp_path: Path, size: float) -> None:
    path = written(tmp_path, rows(NM, np.full(31, size), mark=",").encode())
    with pytest.raises(AmbiguousFileError) as error:
        open_file(path)
    assert error.value.option == "quantity"


def test_values_above_one_are_kept(tmp_path: Path) -> None:
    text = "Wavelength (nm),Reflectance (%)\n" + rows(NM, np.full(31, 250.0), mark=",")
    (measurement,) = open_file(written(tmp_path, text.encode()))
    assert measurement.data["reflectance"][0] == pytest.approx(2.5) and measurement.assumed


def test_the_title_above_the_heading_and_rows_without_values(tmp_path: Path) -> None:
    text = '"film - RawData"\n"Wavelength nm.","R%"\n' + rows(NM, PER_CENT, mark=",") + "701.00, \n"
    (measurement,) = open_file(written(tmp_path, text.encode()))
    check(measurement, "reflectance", 1e-6)
    assert measurement.left_out


def test_linked_counts_with_decimal_commas(tmp_path: Path) -> None:
    text = linked_counts().decode()
    lines = [line if line.startswith("##") else line.replace(".", ",") for line in text.splitlines()]
    data = "\n".join(lines).replace("##NPOINTS", "##FIRSTX= 400,0\n##NPOINTS").encode()
    (measurement,) = open_file(written(tmp_path, data))
    check(measurement, "reflectance", 1e-6)


def test_a_pixel_number_before_the_wavelength_is_no_axis(tmp_path: Path) -> None:
    text = "ENLIGHTEN Version,3.2.6\nSerial Number,WP-1\nCCD C0,393.12\n\nWP-1,,2020-01-01,\n"
    text += "Pixel,Wavelength,Processed,Raw\n" + rows(np.arange(31.0), NM, PER_CENT, 40 * PER_CENT, mark=",")
    (measurement,) = open_file(written(tmp_path, text.encode()))
    check(measurement, "reflectance", 1e-6)


def ole(streams: dict[str, bytes]) -> bytes:
    """Return a compound file ([MS-CFB]) whose streams are filled to 4096 bytes, so that none is in the mini stream."""
    sector, end, free = 512, 0xFFFFFFFE, 0xFFFFFFFF
    bodies = {name: body.ljust(-(-max(len(body), 4096) // sector) * sector, b"\0") for name, body in streams.items()}
    fat, at, entries = [0xFFFFFFFD, end], 2, [("Root Entry", 5, end, 0)]
    for name, body in bodies.items():
        count = len(body) // sector
        fat += [*range(at + 1, at + count), end]
        entries.append((name, 2, at, max(len(streams[name]), 4096)))
        at += count
    directory = b""
    for name, kind, first, size in entries:
        text = (name + "\0").encode("utf-16-le")
        entry = text.ljust(64, b"\0") + struct.pack("<HBB3I", len(text), kind, 1, free, free, free)
        directory += entry.ljust(116, b"\0") + struct.pack("<III", first, size, 0)
    head = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16) + struct.pack("<5H", 62, 3, 0xFFFE, 9, 6) + bytes(10)
    head += struct.pack("<8I", 1, 1, 0, 4096, end, 0, end, 0) + struct.pack("<109I", 0, *[free] * 108)
    fat += [free] * (sector // 4 - len(fat))
    sectors = struct.pack(f"<{sector // 4}I", *fat) + directory.ljust(sector, b"\0")
    return head + sectors + b"".join(bodies.values())


def test_a_jws_of_the_second_version_is_an_ole_file(tmp_path: Path) -> None:
    info = struct.pack("<6I3d4I4d", 3, 1, 0, 1, 1, 31, 400.0, 700.0, 10.0, 0x10000103, 3, 0, 0, 400.0, 0.0, 700.0, 1.0)
    data = ole({"DataInfo": info, "Y-Data": FACTOR.astype("<f4").tobytes()})
    (measurement,) = open_file(written(tmp_path, data))
    assert measurement.format == "jasco-jws"
    check(measurement, "absorbance", 1e-6)


def test_geometry_and_white_reference_are_metadata(tmp_path: Path) -> None:
    text = "Sample: tile\nGeometry: d/8 SCE\nWhite: Spectralon 99\n\nWavelength (nm),R (%)\n" + rows(
        NM, PER_CENT, mark=","
    )
    (measurement,) = open_file(written(tmp_path, text.encode()))
    assert measurement.metadata["geometry"] == "diffuse"
    assert measurement.metadata["white_reference"] == "Spectralon"


UNKNOWN_QUANTITIES: dict[str, tuple[bytes, bytes]] = {
    "jcamp pairs": (b"##YUNITS=REFLECTANCE", b"##YUNITS=ARBITRARY UNITS"),
    "jasco": (b"YUNITS\tREFLECTANCE", b"YUNITS\tFLUORESCENCE"),
    "sp": (b"%R", b"mV"),
    "spc": (struct.pack("<dIBB", 700.0, 1, 3, 129), struct.pack("<dIBB", 700.0, 1, 3, 0)),
}  # fmt: skip


@pytest.mark.parametrize("name", UNKNOWN_QUANTITIES)
def test_a_quantity_that_is_not_known_is_asked_not_assumed(tmp_path: Path, name: str) -> None:
    known, unknown = UNKNOWN_QUANTITIES[name]
    data = WRITERS[name][0]()
    assert data.count(known) == 1
    path = written(tmp_path, data.replace(known, unknown))
    with pytest.raises(AmbiguousFileError) as error:
        open_file(path)
    assert error.value.option == "quantity" and "counts" in error.value.choices
    (found,) = open_file(path, ReadOptions(quantity="counts"))
    assert "counts" in found.data and "reflectance" not in found.data
