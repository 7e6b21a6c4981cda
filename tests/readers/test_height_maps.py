"""Height maps, written here in the forms of their instruments, and the shared real ones."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from scipy.io import netcdf_file

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import filled, length_um, roughness
from nacre.readers.measurement import AmbiguousFileError, ReadOptions, write_measurements
from nacre.readers.registry import open_file, recognise

SHARED = Path(__file__).resolve().parents[3] / "shared" / "reference" / "instruments" / "heights"
DIGITS = 2e-7  # the readings are printed with 8 digits
ROWS, COLUMNS = 5, 7
PITCH = (0.25, 0.5)  # um
SINGLE = 1e-6


def heights() -> np.ndarray:
    """Return heights in um without any symmetry."""
    row, column = np.indices((ROWS, COLUMNS))
    return 0.001 * (3.0 * column + 20.0 * row + (row * column) % 4)


def integers() -> np.ndarray:
    return np.round(heights() * 1e3).astype(int)


def gwy_component(name: str, kind: str, data: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + data


def gwy_object(name: str, *components: bytes) -> bytes:
    body = b"".join(components)
    return name.encode() + b"\0" + struct.pack("<I", len(body)) + body


def gwy(unit: str = "m") -> bytes:
    units = [
        gwy_component(f"si_unit_{axis}", "o", gwy_object("GwySIUnit", gwy_component("unitstr", "s", text + b"\0")))
        for axis, text in (("xy", b"m"), ("z", unit.encode()))
    ]
    values = heights().ravel() * 1e-6
    field = gwy_object(
        "GwyDataField",
        gwy_component("xres", "i", struct.pack("<i", COLUMNS)),
        gwy_component("yres", "i", struct.pack("<i", ROWS)),
        gwy_component("xreal", "d", struct.pack("<d", COLUMNS * PITCH[0] * 1e-6)),
        gwy_component("yreal", "d", struct.pack("<d", ROWS * PITCH[1] * 1e-6)),
        gwy_component("data", "D", struct.pack("<I", values.size) + values.tobytes()),
        *units,
    )
    title = gwy_component("/0/data/title", "s", b"Height\0")
    return b"GWYP" + gwy_object("GwyContainer", gwy_component("/0/data", "o", field), title)


def sur(inversion: int = 0) -> bytes:
    flipped = {0: heights(), 1: -heights(), 2: -heights()[:, ::-1], 3: -heights()[::-1]}[inversion]
    raw = np.round(flipped * 1e3).astype("<i4")
    low = int(raw.min())
    head = struct.pack("<12s4H30s30s5H8xH4iI3f", b"DIGITAL SURF", 0, 1, 1, 2, b"", b"microscope", 0, 0, 0, 1, 0,
                       32, low, int(raw.max()), COLUMNS, ROWS, raw.size, PITCH[0], PITCH[1], 1.0)  # fmt: skip
    units = [b"X", b"Y", b"Z", b"\xb5m", b"um", b"nm", b"um", b"um", b"nm"]
    head += b"".join(unit.ljust(16) for unit in units) + struct.pack("<3f3H", 1, 1, 1, 0, inversion, 0)
    head = head.ljust(334, b"\0") + struct.pack("<2H", 4, 2)
    return head.ljust(512, b"\0") + b"abcdxy" + raw.tobytes()


def x3p() -> bytes:
    text = f"""<?xml version="1.0"?><p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
    <Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
    <CX><AxisType>I</AxisType><Increment>{PITCH[0] * 1e-6}</Increment></CX>
    <CY><AxisType>I</AxisType><Increment>{PITCH[1] * 1e-6}</Increment></CY>
    <CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
    <Record3><MatrixDimension><SizeX>{COLUMNS}</SizeX><SizeY>{ROWS}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
    <DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></p:ISO5436_2>"""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("main.xml", text)
        archive.writestr("bindata/data.bin", (heights() * 1e-6).astype("<f8").tobytes())
    return out.getvalue()


def zygo() -> bytes:
    # one phase unit of 1/4096 turn of a wavelength of 4.096 um is 1 nm
    head = bytearray(834)
    head[:4] = b"\x88\x1b\x03\x6f"
    struct.pack_into(">HI", head, 4, 1, 834)
    struct.pack_into(">hhHHH", head, 48, 0, 0, 2, 3, 1)
    struct.pack_into(">hhHH", head, 64, 0, 0, COLUMNS, ROWS)
    struct.pack_into(">4f", head, 164, 1.0, 4.096e-6, 0.0, 1.0)
    struct.pack_into(">f", head, 184, PITCH[0] * 1e-6)
    return bytes(head) + bytes(12) + integers().astype(">i4").tobytes()


def nanoscope() -> bytes:
    def image(offset: int, name: str, sens: str) -> str:
        return (
            f"\\*Ciao image list\r\n\\Data offset: {offset}\r\n\\Data length: {2 * ROWS * COLUMNS}\r\n"
            f"\\Bytes/pixel: 2\r\n\\Samps/line: {COLUMNS}\r\n\\Number of lines: {ROWS}\r\n"
            f"\\Scan size: {COLUMNS * PITCH[0]} {ROWS * PITCH[1]} ~m\r\n\\Line direction: Trace\r\n"
            f'\\@2:Image Data: S [{name}] "{name}"\r\n\\@2:Z scale: V [Sens. {sens}] (0.1 V/LSB) 65.536 V\r\n'
        )

    size = 2 * ROWS * COLUMNS
    head = (
        "\\*File list\r\n\\Version: 0x05120000\r\n\\Date: today\r\n\\*Scanner list\r\n\\@Sens. Zscan: V 1000.0 nm/V\r\n"
        "\\@Sens. Amplitude: V 1.0 \r\n"
        + image(2048, "Height", "Zscan")
        + image(2048 + size, "Amplitude", "Amplitude")
        + "\\*File list end\r\n\x1a"
    )
    raw = integers()[::-1].astype("<i2").tobytes()  # 65.536 V over 2^16 at 1000 nm/V: 1 nm per integer
    return head.encode("latin-1").ljust(2048, b"\0") + raw + raw


def wsxm() -> bytes:
    raw = integers()[::-1, ::-1]
    text = (
        "WSxM file copyright Nanotec Electronica\r\nSxM Image file\r\nImage header size: {size:4d}\r\n\r\n[Control]\r\n"
        f"\r\n    X Amplitude: {COLUMNS * PITCH[0]} um\r\n    Y Amplitude: {ROWS * PITCH[1]} um\r\n[General Info]\r\n"
        f"    Image Data Type: short\r\n    Number of columns: {COLUMNS}\r\n    Number of rows: {ROWS}\r\n"
        f"    Z Amplitude: {np.ptp(raw)} nm\r\n[Header end]\r\n"
    )
    text = text.format(size=len(text.format(size=0)))
    return text.encode() + raw.astype("<i2").tobytes()


def truemap() -> bytes:
    comment = b"Binary TrueMap Data File v2.0\r\n\0" + b"made here\r\n\0"
    sizes = struct.pack("<2I4f", COLUMNS, ROWS, COLUMNS * PITCH[0] * 1e-3, ROWS * PITCH[1] * 1e-3, 0, 0)
    return comment + sizes + (heights() * 1e-3).astype("<f4").tobytes()


def alicona() -> bytes:
    padded = np.zeros((ROWS, COLUMNS + 1), dtype="<f4")
    padded[:, :COLUMNS] = heights() * 1e-6
    tags = {
        "Version": 1, "TagCount": 6, "Cols": COLUMNS, "Rows": ROWS, "PixelSizeXMeter": PITCH[0] * 1e-6,
        "PixelSizeYMeter": PITCH[1] * 1e-6, "InvalidPixelValue": 3e15, "DepthImageOffset": 1000,
    }  # fmt: skip
    rows = [k.encode().ljust(20, b"\0") + str(v).encode().ljust(30, b"\0") + b"\r\n" for k, v in tags.items()]
    return (b"AliconaImaging\0\r\n" + b"".join(rows)).ljust(1000, b"\0") + padded.tobytes()


def opdx() -> bytes:
    def name(text: str) -> bytes:
        return struct.pack("<I", len(text.encode())) + text.encode()

    def sized(data: bytes) -> bytes:
        return b"\x04" + struct.pack("<I", len(data)) + data

    def quantity(label: str, value: float, unit: str) -> bytes:
        return name(label) + b"\x13" + sized(struct.pack("<d", value) + name(unit) + name(unit) + bytes(12))

    end = name("") + b"\x7f\xff\xff"
    values = struct.pack("<2I", ROWS, COLUMNS) + heights().astype("<f4").tobytes()
    inside = name("Raw") + b"\x7d" + sized(
        name("Matrix") + b"\x45" + name("Matrix<float>") + sized(values)
        + quantity("DataScale", 1.0, "µm")
        + quantity("Dimension1Extent", (ROWS - 1) * PITCH[1], "µm")
        + quantity("Dimension2Extent", (COLUMNS - 1) * PITCH[0] * 1e-3, "mm")
        + end
    )  # fmt: skip
    return b"VCA DATA\x01\x00\x00\x55" + name("2D_Data") + b"\x7d" + sized(inside + end)


def igor(unit: bytes = b"m") -> bytes:
    head = bytearray(384)
    struct.pack_into("<hhiiii4i4i", head, 0, 5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    struct.pack_into("<h", head, 64 + 16, 4)
    struct.pack_into("<4i4d", head, 64 + 68, COLUMNS, ROWS, 0, 0, PITCH[0] * 1e-6, PITCH[1] * 1e-6, 1, 1)
    head[64 + 148 : 64 + 148 + len(unit)] = unit
    head[64 + 152 : 64 + 153] = b"m"
    total = int(np.frombuffer(bytes(head), "<i2").astype(int).sum())
    struct.pack_into("<h", head, 2, (-total + 32768) % 65536 - 32768)
    return bytes(head) + (heights()[::-1] * 1e-6).tobytes()


def sdf_text() -> bytes:
    rows = "\r\n".join(" ".join(f"{v:.3f}" for v in row) for row in heights())
    return (
        f"aISO-1.0\r\nNumPoints = {COLUMNS}\r\nNumProfiles = {ROWS}\r\nXscale = {PITCH[0] * 1e-6}\r\n"
        f"Yscale = {PITCH[1] * 1e-6}\r\nZscale = 1e-6\r\nZresolution = -1\r\nCompression = 0\r\nDataType = 7\r\n"
        f"CheckType = 0\r\n*\r\n{rows}\r\n*\r\n"
    ).encode()


def sdf_binary() -> bytes:
    head = struct.pack(
        "<8s10s12s12sHHddddBBB", b"bISO-1.0", b"us", b"", b"", COLUMNS, ROWS, PITCH[0] * 1e-6, PITCH[1] * 1e-6, 1e-9,
        -1.0, 0, 6, 0,
    )  # fmt: skip
    return head + integers().astype("<i4").tobytes()


def gwyddion_text(comma: bool = False) -> bytes:
    rows = "\n".join("\t".join(f"{v * 1e-6:.9e}" for v in row) for row in heights())
    words = (
        ("Kanal", "Breite", "Höhe", "Einheiten der Werte") if comma else ("Channel", "Width", "Height", "Value units")
    )
    values = ("Topo", f"{COLUMNS * PITCH[0]} µm", f"{ROWS * PITCH[1]} µm", "m")
    text = "".join(f"# {word}: {value}\n" for word, value in zip(words, values)) + rows + "\n"
    return (text.replace(".", ",") if comma else text).encode()


def holography() -> bytes:
    rows = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in heights())
    head = f"h={ROWS} w={COLUMNS}\npixel size=2.5e-007 m\ndata unit=rad\nheight conversion factor (-> m)=1.0e-006\n"
    return (head + rows).encode()


def xyz() -> bytes:
    row, column = np.indices((ROWS, COLUMNS))
    points = zip(column.ravel() * PITCH[0], row.ravel() * PITCH[1], heights().ravel())
    return ("x [um],y [um],z [um]\n" + "\n".join(f"{x:.4f},{y:.4f},{z:.4f}" for x, y, z in points) + "\n").encode()


def jpk(path: Path) -> None:
    def text(code: int, value: str) -> tuple[int, int, int, str, bool]:
        return (code, 2, 0, value, True)

    def number(code: int, value: float) -> tuple[int, int, int, float, bool]:
        return (code, 12, 1, value, True)

    sizes = [number(0x8042, COLUMNS * PITCH[0] * 1e-6), number(0x8043, ROWS * PITCH[1] * 1e-6)]
    slot = [
        text(0x8090, "nominal"), text(0x8090 + 0x12, "m"), text(0x8090 + 0x13, "LinearScaling"),
        number(0x8090 + 0x14, 1e-9), number(0x8090 + 0x15, 0.0),
    ]  # fmt: skip
    page = [text(0x8052, "Height (measured)"), (0x8080, 4, 1, 1, True), text(0x8081, "nominal"), *slot]
    with tifffile.TiffWriter(path) as writer:
        writer.write(np.zeros((2, 3), np.uint8), extratags=sizes, metadata=None)
        writer.write(integers()[::-1].astype(np.uint16), extratags=page, metadata=None)


def netcdf(path: Path) -> None:
    with netcdf_file(path, "w") as file:
        for axis, count, step in (("x", COLUMNS, PITCH[0]), ("y", ROWS, PITCH[1])):
            file.createDimension(axis, count)
            variable = file.createVariable(axis, "f8", (axis,))
            variable[:] = np.arange(count) * step
            variable.unit = "um"
        stored = file.createVariable("heights", "f8", ("x", "y"))
        stored[:] = heights().T * 1e3
        stored.unit = "nm"


def topostats(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["image"], file["pixel_to_nm_scaling"] = heights() * 1e3, PITCH[0] * 1e3


FILES: dict[str, Callable[[], bytes] | Callable[[Path], None]] = {
    "sdf": sdf_text, "sdf binary": sdf_binary, "gwyddion-text": gwyddion_text, "gwy": gwy, "sur": sur, "x3p": x3p,
    "zygo": zygo, "nanoscope": nanoscope, "wsxm": wsxm, "tmd": truemap, "al3d": alicona, "opdx": opdx, "ibw": igor,
    "holography": holography, "xyz": xyz, "jpk": jpk, "netcdf": netcdf, "topostats": topostats,
}  # fmt: skip


def stored(folder: Path, name: str, suffix: str = ".bin") -> Path:
    """Write a file of the name under a suffix that says nothing."""
    path = folder / f"scan{suffix}"
    make: Any = FILES[name]
    if make in (jpk, netcdf, topostats):
        make(path)
    else:
        path.write_bytes(make())
    return path


@pytest.mark.parametrize("name", FILES)
def test_a_map_is_read_in_um_with_its_pitch_and_orientation(tmp_path: Path, name: str) -> None:
    (found,) = open_file(stored(tmp_path, name))
    assert (found.format, found.kind) == (name.split()[0], "heights")
    np.testing.assert_allclose(found.data["height_um"], heights(), rtol=2e-5, atol=1e-8)
    lateral = (PITCH[0],) * 2 if name in ("zygo", "topostats", "holography") else PITCH
    np.testing.assert_allclose(found.metadata["pitch_um"], lateral, rtol=SINGLE)
    assert found.metadata["holes"] == 0


@pytest.mark.parametrize("name", [n for n in FILES if n not in ("xyz",)])
def test_a_truncated_file_is_refused(tmp_path: Path, name: str) -> None:
    path = stored(tmp_path, name)
    whole = path.read_bytes()
    kept = len(whole) // 2 if name == "gwyddion-text" else len(whole) - 40
    path.write_bytes(whole[:kept])
    with pytest.raises(NacreError):
        open_file(path)


@pytest.mark.parametrize("inversion", [0, 1, 2, 3])
def test_inverted_and_mirrored_surfaces_are_turned_back(tmp_path: Path, inversion: int) -> None:
    path = tmp_path / "a.sur"
    path.write_bytes(sur(inversion))
    np.testing.assert_allclose(open_file(path)[0].data["height_um"], heights(), rtol=SINGLE, atol=1e-9)


def test_translated_heads_and_decimal_commas_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(gwyddion_text(comma=True))
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["height_um"], heights(), rtol=SINGLE, atol=1e-9)
    assert found.name == "Topo" and found.metadata["pitch_um"] == pytest.approx(PITCH)


def test_holes_are_counted_and_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.sdf"
    path.write_bytes(sdf_text().replace(b"0.003", b"BAD"))
    (found,) = open_file(path)
    assert found.metadata["holes"] == 1 and np.isnan(found.data["height_um"][0, 1])


def test_a_matrix_without_a_head_asks_for_unit_and_pitch(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    map_um = np.roll(heights(), 2, axis=0)  # no column rises
    np.savetxt(path, map_um, fmt="%.4f")
    for options, asked in ((ReadOptions(), "unit"), (ReadOptions(unit="um"), "pitch_um")):
        with pytest.raises(AmbiguousFileError) as caught:
            open_file(path, options)
        assert caught.value.option == asked
    (found,) = open_file(path, ReadOptions(unit="nm", pitch_um=PITCH))
    np.testing.assert_allclose(found.data["height_um"], map_um * 1e-3, atol=1e-7)


STATED = {
    "nm": ("nanoscope", "wsxm", "netcdf", "sur", "topostats"), "um": ("opdx", "xyz"), "mm": ("tmd",),
    "m": ("sdf", "sdf binary", "gwyddion-text", "gwy", "x3p", "zygo", "al3d", "ibw", "jpk"),
}  # fmt: skip


@pytest.mark.parametrize(("stated", "name"), [(unit, name) for unit, names in STATED.items() for name in names])
def test_a_unit_that_contradicts_the_file_is_refused(tmp_path: Path, stated: str, name: str) -> None:
    path = stored(tmp_path, name)
    (found,) = open_file(path, ReadOptions(unit=stated))
    np.testing.assert_allclose(found.data["height_um"], heights(), rtol=2e-5, atol=1e-8)
    with pytest.raises(NacreError) as caught:
        open_file(path, ReadOptions(unit="pm"))
    assert '"pm"' in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_a_unit_that_is_no_length_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.gwy"
    path.write_bytes(gwy("V"))
    with pytest.raises(NacreError):
        open_file(path)


@pytest.mark.parametrize(
    "text",
    [
        "X_(microns),y1\n0.1,2.0\n0.2,2.1\n",
        "".join(f"{k * 1e-8} 1e-9\n" for k in range(20)),
        "Scan Parameters\nScan Type,Standard\nLength,15 um\n\nScan Data\nLateral um,Raw Micrometer,\n0.0,-0.01,,\n",
    ],
)
def test_line_profiles_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert recognise(path)[0][1].id == "profile"
    with pytest.raises(NacreError):
        open_file(path)


def _file(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_text_exports_of_wsxm_and_the_second_edition_of_sdf(tmp_path: Path) -> None:
    (found,) = open_file(_file(tmp_path / "b.sdf", sdf_text().replace(b"aISO-1.0", b"aISO-2.0")))
    np.testing.assert_allclose(found.data["height_um"], heights(), atol=1e-9)
    head = "WSxM file copyright UAM\r\nWSxM ASCII "
    row, column = np.indices((ROWS, COLUMNS))
    points = zip(column.ravel() * PITCH[0], row.ravel() * PITCH[1], heights().ravel())
    rows = "".join(f"{x * 1e4:.3f}\t{y * 1e4:.3f}\t{z * 1e4:.3f}\r\n" for x, y, z in points)
    (found,) = open_file(_file(tmp_path / "p.txt", f"{head}XYZ file\r\nX[A]\tY[A]\tZ[A]\r\n\r\n{rows}".encode()))
    np.testing.assert_allclose(found.data["height_um"], heights(), atol=1e-9)
    np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)
    sides = f"X Amplitude: {COLUMNS * PITCH[0]} um\r\nY Amplitude: {ROWS * PITCH[1]} um\r\n"
    rows = "".join("\t".join(f"{z * 1e3:.3f}" for z in line) + "\r\n" for line in heights())
    path = _file(tmp_path / "m.txt", f"{head}Matrix file\r\n{sides}\r\n{rows}".encode())
    with pytest.raises(AmbiguousFileError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(unit="nm"))
    np.testing.assert_allclose(found.data["height_um"], heights(), atol=1e-9)
    np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)


@pytest.mark.parametrize(
    "magic, code, kind, hole",
    [("bISO-1.0", 5, "<i2", -32768), ("bISO-2.0", 4, "i1", -128), ("bISO-2.0", 7, "<f8", -np.finfo("f8").max),
     ("bISO-2.0", 3, "<f4", -np.finfo("f4").max), ("bBCR-1.0", 5, "<i2", 32767)],
)  # fmt: skip
def test_the_editions_of_sdf_differ_in_their_head_and_holes(
    tmp_path: Path, magic: str, code: int, kind: str, hole: float
) -> None:
    values = np.arange(ROWS * COLUMNS, dtype=float).reshape(ROWS, COLUMNS)
    values[1, 2] = hole
    size = "I" if magic == "bISO-2.0" else "H"
    head = struct.pack(
        f"<8s10s12s12s{size}{size}ddddBBB", magic.encode(), b"us", b"", b"", COLUMNS, ROWS, PITCH[0] * 1e-6,
        PITCH[1] * 1e-6, 1e-9, -1.0, 0, code, 0,
    )  # fmt: skip
    (found,) = open_file(_file(tmp_path / "x.sdf", head + values.astype(kind).tobytes()))
    values[1, 2] = np.nan
    np.testing.assert_allclose(found.data["height_um"], values * 1e-3, atol=1e-12)
    np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)


@pytest.mark.parametrize(
    "names", [("チャネル：", "幅:", "高さ：", "値の単位:"), ("Канал:", "Ширина:", "Высота:", "Единицы:")]
)
def test_heads_in_other_scripts_are_read(tmp_path: Path, names: tuple[str, ...]) -> None:
    text = gwyddion_text().decode()
    for old, new in zip(("Channel:", "Width:", "Height:", "Value units:"), names, strict=True):
        text = text.replace(old, new)
    (found,) = open_file(_file(tmp_path / "x.txt", text.encode()))
    np.testing.assert_allclose(found.data["height_um"], heights(), atol=1e-9)


def test_points_off_a_grid_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    points = np.random.default_rng(0).random((30, 3))
    path.write_text("x y z\n" + "\n".join(" ".join(f"{v:.5f}" for v in p) for p in points))
    with pytest.raises(NacreError):
        open_file(path, ReadOptions(unit="um"))


def test_the_table_that_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_measurements(path, open_file(stored(tmp_path, "sdf")))
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["height_um"], heights(), atol=1e-9)
    assert found.metadata["pitch_um"] == pytest.approx(PITCH)


def test_roughness_is_that_of_a_surface_of_known_spectrum_on_a_tilted_plane() -> None:
    count, length, sq = 512, 8.0, 0.1  # points, lag of 1/e in points, um
    f = np.fft.fftfreq(count)
    spectrum = np.exp(-((np.pi * length * np.hypot(f[:, None], f)) ** 2))
    noise = np.fft.fft2(np.random.default_rng(3).normal(size=(count, count)))
    map_um = np.fft.ifft2(noise * np.sqrt(spectrum)).real
    map_um *= sq / map_um.std()
    found = roughness(map_um + 0.02 * np.arange(count) + 5.0, (1.0, 1.0))
    # 2000 cells of the correlation: 3 % in the variance
    assert found.sq_um == pytest.approx(sq, rel=0.02)
    assert found.sdq == pytest.approx(2.0 * sq / length, rel=0.03)
    assert found.correlation_length_um == pytest.approx(length, rel=0.05)
    assert found.tilt_deg == pytest.approx(np.degrees(np.arctan(0.02)), rel=0.01)


def test_holes_in_a_plane_are_filled_by_the_plane() -> None:
    row, column = np.indices((30, 40))
    whole = 0.3 * row - 0.2 * column
    holed = whole.copy()
    holed[10:13, 20:22] = np.nan
    np.testing.assert_allclose(filled(holed), whole, atol=1e-6)


READINGS = json.loads((SHARED / "index.json").read_text()) if SHARED.exists() else []


@pytest.mark.skipif(not SHARED.exists(), reason="the shared files of instruments are not here")
def test_the_shared_files_are_read_as_their_readings_say() -> None:
    for entry in READINGS:
        reading, path = entry["right_reading"], SHARED / entry["file"]
        if reading.get("dim") == 1:
            with pytest.raises(NacreError):
                open_file(path)
            continue
        unit = reading["unit_in_file"]
        if unit is None:
            with pytest.raises(AmbiguousFileError):
                open_file(path)
        (found,) = open_file(path, ReadOptions(unit="um", pitch_um=(1.0, 1.0)) if unit is None else None)
        map_um = found.data["height_um"] / (length_um(unit) if unit else 1.0)
        corners = reading["corners"]
        assert list(map_um.shape) == reading["shape_rows_columns"], path
        wanted = [corners[key] for key in ("first", "row0_last", "last_row_first", "last")]
        got = [map_um[0, 0], map_um[0, -1], map_um[-1, 0], map_um[-1, -1]]
        np.testing.assert_allclose(got, wanted, rtol=DIGITS, atol=1e-12, err_msg=str(path))
        for place in reading["some"]:
            assert map_um[place["row"], place["column"]] == pytest.approx(place["z"], rel=DIGITS), path
        if reading.get("pixel_um"):
            np.testing.assert_allclose(found.metadata["pitch_um"], reading["pixel_um"], rtol=DIGITS)
            assert found.metadata["sq_um"] == pytest.approx(
                reading["plane_removed_rms"] * length_um(unit), rel=1e-4, abs=1e-9
            )


def test_text_of_other_programs_is_refused_by_name(tmp_path: Path) -> None:
    path = _file(tmp_path / "x.txt", b"Shimadzu SPM File Format Version 4.30\n1,2\n3,4\n")
    assert recognise(path)[0][1].id == "other"
    with pytest.raises(NacreError):
        open_file(path)


GRID = np.array([[0.1, 0.2, 0.3], [0.4, np.nan, 0.6]])  # rows from the top
HOLE = 1.70141e38


def surfer(kind: str) -> bytes:
    """A grid of 3 x 2 nodes, 0.5 x 2 apart, rows from the bottom."""
    rows = np.where(np.isnan(GRID), HOLE, GRID)[::-1]
    if kind == "text":
        lines = [" ".join(f"{value:g}" for value in row) for row in rows]
        return ("DSAA\r\n3 2\r\n10 11\r\n-1 1\r\n0.1 0.6\r\n" + "\r\n".join(lines) + "\r\n").encode()
    if kind == "6":
        return b"DSBB" + struct.pack("<2h6d", 3, 2, 10, 11, -1, 1, 0.1, 0.6) + rows.astype("<f4").tobytes()
    if kind == "7":
        grid = struct.pack("<2i8d", 2, 3, 10, -1, 0.5, 2, 0.1, 0.6, 0, HOLE)
        body = rows.astype("<f8").tobytes()
        return b"DSRB" + struct.pack("<2i", 4, 1) + b"GRID" + struct.pack("<i", 72) + grid + b"DATA" + struct.pack(
            "<i", len(body)
        ) + body  # fmt: skip
    lines = [" ".join(f"{value:g}" for value in row) for row in np.where(np.isnan(GRID), -9999, GRID)]
    head = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner -1\ndx 0.5\ndy 2\nNODATA_value -9999\n"
    return (head + "\n".join(lines) + "\n").encode()


@pytest.mark.parametrize("kind", ["text", "6", "7", "esri"])
def test_grids_of_surfer_and_esri(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.grd"
    path.write_bytes(surfer(kind))
    with pytest.raises(AmbiguousFileError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(unit="nm"))
    np.testing.assert_allclose(found.data["height_um"], GRID * 1e-3, rtol=1e-6)
    assert found.metadata["pitch_um"] == pytest.approx((0.5e-3, 2e-3)) and found.assumed
    (found,) = open_file(path, ReadOptions(unit="um", pitch_um=(0.8, 0.8)))
    assert found.metadata["pitch_um"] == (0.8, 0.8)
    for end in (30, -9):
        path.write_bytes(surfer(kind)[:end])
        with pytest.raises(NacreError):
            open_file(path, ReadOptions(unit="nm"))


def test_a_turned_grid_is_refused(tmp_path: Path) -> None:
    turned = bytearray(surfer("7"))
    turned[12 + 8 + 56 : 12 + 8 + 64] = struct.pack("<d", 30.0)
    (tmp_path / "a.grd").write_bytes(turned)
    with pytest.raises(NacreError):
        open_file(tmp_path / "a.grd", ReadOptions(unit="nm"))
