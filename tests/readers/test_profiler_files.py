"""Height maps of optical profilers and of SPIP, written here from the descriptions of their formats."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file, recognise

ROWS, COLUMNS = 5, 7
PITCH = (0.25, 0.5)  # um
SINGLE = 1e-6
NM = np.round(3.0 * np.indices((ROWS, COLUMNS))[1] + 20.0 * np.indices((ROWS, COLUMNS))[0] + 1.0)  # without symmetry
HEIGHTS = NM * 1e-3
HOLE = (1, 2)


def rows_of(values: np.ndarray, mark: str = " ", form: str = "{:.6g}") -> str:
    return "\n".join(mark.join(form.format(v) for v in row) for row in values) + "\n"


def opd(kind: str = "<f4", aspect: bool = True) -> bytes:
    # half a nm per unit
    stored = (NM * 2.0)[::-1].T.astype(kind)
    stored[HOLE[1], ROWS - 1 - HOLE[0]] = 2e38 if kind == "<f4" else 32767
    fields = {
        b"Wavelength": (7, struct.pack("<f", 1.0)), b"Mult": (6, struct.pack("<h", 2)),
        b"Title": (5, b"made here\0"), b"Empty": (5, b""),
        b"RAW_DATA": (3, struct.pack("<3H", COLUMNS, ROWS, stored.itemsize) + stored.tobytes()),
        b"Intensity": (3, struct.pack("<3H", COLUMNS, ROWS, 1) + bytes(ROWS * COLUMNS)),
        b"Pixel_size": (7, struct.pack("<f", PITCH[0] * 1e-3)),
    }  # fmt: skip
    if aspect:
        fields[b"Aspect"] = (7, struct.pack("<f", PITCH[1] / PITCH[0]))
    blocks = [(b"Directory", 1, 24 * (1 + len(fields)), 0xFFFF)]
    blocks += [(name, number, len(data), 0) for name, (number, data) in fields.items()]
    head = b"".join(struct.pack("<16shlH", *block) for block in blocks)
    return b"\x01\0" + head + b"".join(data for _, data in fields.values())


def opd_text(is_nm: bool = False) -> bytes:
    values = (NM if is_nm else NM / 2.0)[::-1].T
    body = rows_of(values, "\t").splitlines()
    cells = body[HOLE[1]].split("\t")
    cells[ROWS - 1 - HOLE[0]] = "Bad"
    body[HOLE[1]] = "\t".join(cells)
    head = (
        f"Wyko ASCII Data File Format 0\t{int(is_nm)}\t1\nX Size\t{COLUMNS}\nY Size\t{ROWS}\n"
        f"Block Name\tType\tLength\tValue\nWavelength\t7\t4\t4\nMult\t6\t2\t2\nAspect\t7\t4\t2\n"
        f"Pixel_size\t7\t4\t{PITCH[0] * 1e-3}\nTitle\t5\t20\tmade here\nRAW_DATA\t3\t140\n"
    )
    return (head + "\n".join(body) + "\n").encode()


def spip(keys: str = "# z-unit = nm\n", factor: float = 1.0, void: bool = True) -> bytes:
    mask = np.zeros((ROWS, COLUMNS))
    mask[HOLE] = 1.0
    head = (
        "# File Format = ASCII\n# Created by SPIP 6.3.2\n"
        f"# x-pixels = {COLUMNS}\n# y-pixels = {ROWS}\n# x-length = {COLUMNS * PITCH[0] * 1e3}\n"
        f"# y-length = {ROWS * PITCH[1] * 1e3}\n{keys}# voidpixels ={int(void)}\n# Start of Data:\n"
    )
    return (head + rows_of(NM * factor) + (rows_of(mask) if void else "")).encode()


def attocube() -> bytes:
    head = (
        f"# Daisy frame view snapshot\n# 2009-07-14T10:12:34\n# x-pixels: {COLUMNS}\n# y-pixels: {ROWS}\n"
        f"# x-length: {COLUMNS * PITCH[0]}\n# y-length: {ROWS * PITCH[1]}\n# x-unit: um\n# y-unit: um\n"
        "# z-unit: nm\n# display: Topography\n# Start of Data:\n"
    )
    return (head + rows_of(NM)).encode()


def nova() -> bytes:
    head = (
        f"File Format = ASCII\r\nCreated by Nova\r\nNX = {COLUMNS}\r\nNY = {ROWS}\r\nScale X = {PITCH[0]}\r\n"
        f"Scale Y = {PITCH[1]}\r\nUnit X = um\r\nUnit Data = nm\r\nScale Data = 1\r\nDataScaleNeeded = no\r\n"
        "Start of Data :\r\n"
    )
    return (head + rows_of(NM)).encode()


def bcr(encoding: str = "latin-1", kind: str = "<i2") -> bytes:
    name = "bcrstm" if kind.endswith("i2") else "bcrf"
    name += "_unicode" if encoding != "latin-1" else ""
    text = (
        f"fileformat = {name}\nheadersize = 2048\nxpixels = {COLUMNS}\nypixels = {ROWS}\n%remark = 1\n"
        f"xlength = {COLUMNS * PITCH[0] * 1e3}\nylength = {ROWS * PITCH[1] * 1e3}\nxunit = nm\nyunit = nm\nzunit = nm\n"
        f"bit2nm = 0.5\nintelmode = {int(kind[0] == '<')}\nvoidpixels = 1\n"
    )
    values = (NM * (2.0 if kind.endswith("i2") else 1.0)).astype(kind)  # floats are in zunit whatever bit2nm says
    values[HOLE] = 32767 if kind.endswith("i2") else 1.7014118e38
    return text.ljust(2048).encode(encoding) + values.tobytes()


def zygo_head(form: str) -> str:
    return (
        f'Zygo {form}\n1 8 1 1 "Tue Aug 25 16:59:23 2026"\n0 0 2 1 1 255\n10 20 {COLUMNS} {ROWS}\n"a # b"\n""\n""\n'
        f'0 0.5 8.192e-06 0 1 0 {PITCH[0] * 1e-6} 1787677163\n9 9 0 0 0 0 ""\n0 0 0 0 0 0 0 0 0 0\n'
        '0 1 20 2 0 0 0 0 0\n0 ""\n1 0\n'
    )


def zygo_xyz() -> bytes:
    points = "".join(
        f"{10 + column} {20 + row} {'No Data' if (row, column) == HOLE else f'{HEIGHTS[row, column]:.4f}'}\n"
        for row in range(ROWS)
        for column in range(COLUMNS)
    )
    return (zygo_head("XYZ Data File - Format 1") + "#\n" + points + "#\n").encode()


def zygo_ascii() -> bytes:
    values = NM.copy()  # 8.192 um, reflection: 1 nm per unit of 1/4096
    values[HOLE] = 2147483640
    words = [f"{v:.0f}" for v in values.ravel()]
    lines = "\n".join(" ".join(words[k : k + 10]) for k in range(0, len(words), 10))
    return (zygo_head("ASCII Data File - Format 2") + f'"1X"\n#\n17 18\n#\n{lines}\n#\n').encode()


def vk(version: str = "VK4_") -> bytes:
    offsets = [0] * (17 if version == "VK3_" else 18)
    offsets[0] = 12 + 4 * len(offsets)
    settings = [0] * 76
    settings[42:45] = [int(PITCH[0] * 1e6), int(PITCH[1] * 1e6), 500]
    offsets[6] = offsets[0] + 4 * len(settings)
    heights = (NM * 2).astype("<u4")  # 500 pm per digit
    head = struct.pack("<7I", COLUMNS, ROWS, 32, 0, heights.nbytes, 0, 0) + bytes(768)
    table = struct.pack(f"<{len(offsets)}I", *offsets) + struct.pack(f"<{len(settings)}I", *settings)
    return version.encode() + bytes(8) + table + head + heights.tobytes()


def vk6() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("Vk4File", vk())
    return b"VK6" + struct.pack("<I", 4) + b"BM12" + out.getvalue()


def vk_csv(mark: str = ",") -> bytes:
    rows = "\n".join(mark.join(f'"{v:.3f}"' for v in row) for row in HEIGHTS)
    lines = [
        ("Measure date", "2026/08/25 16:59"), ("Model", "VK-X200"), ("Data type", "ImageDataCsv"),
        ("XY Calibration", f"{PITCH[0] * 1e3}", "nm/pixel"), ("Output image data", "Height"),
        ("Horizontal", str(COLUMNS)), ("Vertical", str(ROWS)), ("Unit", "um"), ("Height",),
    ]  # fmt: skip
    text = "\n".join(mark.join(f'"{cell}"' for cell in line) for line in lines) + "\n" + rows + "\n"
    return (text.replace(".", ",") if mark == ";" else text).encode("utf-8-sig")


def compressed_sur() -> bytes:
    raw = NM.astype("<i4")
    range_ = int(raw.min()), int(raw.max())
    head = struct.pack("<12s4H30s30s5H8xH4iI3f", b"DSCOMPRESSED", 0, 1, 1, 2, b"", b"microscope", 0, 0, 0, 1, 0,
                       32, *range_, COLUMNS, ROWS, raw.size, PITCH[0], PITCH[1], 1.0)  # fmt: skip
    units = [b"X", b"Y", b"Z", b"um", b"um", b"nm", b"um", b"um", b"nm"]
    head += b"".join(unit.ljust(16) for unit in units) + struct.pack("<3f3H", 1, 1, 1, 0, 0, 0)
    streams = [raw.tobytes()[:60], raw.tobytes()[60:]]
    packed = [zlib.compress(stream) for stream in streams]
    table = struct.pack("<I", 2) + b"".join(struct.pack("<2I", len(a), len(b)) for a, b in zip(streams, packed))
    return head.ljust(512, b"\0") + table + b"".join(packed)


def gsf(unit: str = "m", title: str = "Topo") -> bytes:
    head = (
        f"Gwyddion Simple Field 1.0\nXRes = {COLUMNS}\nYRes = {ROWS}\nXReal = {COLUMNS * PITCH[0] * 1e-6}\n"
        f"YReal = {ROWS * PITCH[1] * 1e-6}\nXYUnits = m\nZUnits = {unit}\nTitle = {title}\n"
    ).encode()
    return head + bytes(4 - len(head) % 4) + (NM * 1e-9).astype("<f4").tobytes()


def datx(path: Path, unit: str = "NanoMeters") -> None:
    with h5py.File(path, "w") as file:
        values = NM.copy()
        values[HOLE] = 1.7e308
        surface = file.create_dataset("Data/Surface/{1}", data=values)
        pair = np.dtype([("Category", "S20"), ("BaseUnit", "S20"), ("Parameters", "f8", (4,))])
        for axis, step in zip("XY", PITCH):
            surface.attrs[f"{axis} Converter"] = np.array(
                [("LateralCat", "Pixels", [0, step * 1e-6, 0, 0])], dtype=pair
            )
        surface.attrs["No Data"] = [1.7e308]
        surface.attrs["Unit"] = np.array([unit.encode()])
        # two nanometres a fringe
        for name, value in (("Wavelength", 2e-9), ("Interferometric Scale Factor", 0.5), ("Obliquity Factor", 1.0)):
            surface.attrs[name] = [value]


FILES: dict[str, Callable[[], bytes]] = {
    "wyko": opd, "wyko integers": lambda: opd("<i2"), "wyko text": opd_text, "wyko nm": lambda: opd_text(True),
    "spip": spip, "spip bit2nm": lambda: spip("# Bit2nm = 0.5\n", 2.0),
    "spip um": lambda: spip("# z-unit = um\n", 1e-3), "spip attocube": attocube, "spip nova": nova, "bcr": bcr,
    "bcr motorola": lambda: bcr(kind=">i2"), "bcr unicode": lambda: bcr("utf-16-le", "<f4"),
    "zygo-text xyz": zygo_xyz, "zygo-text ascii": zygo_ascii, "keyence": vk, "keyence vk3": lambda: vk("VK3_"),
    "keyence vk6": vk6, "keyence csv": vk_csv, "keyence comma": lambda: vk_csv(";"), "sur": compressed_sur,
    "gsf": gsf, "gsf padded": lambda: gsf(title="Topog"),
}  # fmt: skip
SQUARE = ("zygo-text xyz", "zygo-text ascii", "keyence csv", "keyence comma")
COMPLETE = ("gsf", "keyence", "sur", "spip attocube", "spip nova")  # files without a hole


@pytest.mark.parametrize("name", FILES)
def test_a_map_has_its_heights_pitch_and_holes(tmp_path: Path, name: str) -> None:
    path = tmp_path / "scan.bin"
    path.write_bytes(FILES[name]())
    (found,) = open_file(path)
    assert (found.format, found.kind) == (name.split()[0], "heights")
    expected = HEIGHTS.copy()
    if not name.startswith(COMPLETE):
        expected[HOLE] = np.nan
    np.testing.assert_allclose(found.data["height_um"], expected, rtol=SINGLE, atol=1e-12)
    np.testing.assert_allclose(found.metadata["pitch_um"], (PITCH[0],) * 2 if name in SQUARE else PITCH, rtol=SINGLE)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_ends_early_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "scan.bin"
    path.write_bytes(FILES[name]()[:-70])
    if name == "wyko" or name == "wyko integers":
        path.write_bytes(FILES[name]()[:-4])
    with pytest.raises(NacreError):
        open_file(path)


def test_surfaces_of_mx_in_nm_and_in_fringes(tmp_path: Path) -> None:
    for unit, factor in (("NanoMeters", 1.0), ("Fringes", 1.0), ("Waves", 2.0)):
        datx(tmp_path / "a.bin", unit)
        (found,) = open_file(tmp_path / "a.bin")
        expected = HEIGHTS * factor
        expected[HOLE] = np.nan
        assert found.format == "datx"
        np.testing.assert_allclose(found.data["height_um"], expected, rtol=1e-9)
        np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)
    datx(tmp_path / "a.bin", "Degrees")
    with pytest.raises(NacreError):
        open_file(tmp_path / "a.bin")


def test_the_unit_of_xyz_points_is_assumed_or_stated(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(zygo_xyz())
    (found,) = open_file(path)
    (stated,) = open_file(path, ReadOptions(unit="nm"))
    assert found.assumed and not stated.assumed
    np.testing.assert_allclose(stated.data["height_um"], found.data["height_um"] * 1e-3)


@pytest.mark.parametrize(
    ("data", "option"),
    [
        (spip("", void=False), "unit"),
        (gsf(""), "unit"),
        (zygo_xyz().replace(f"{PITCH[0] * 1e-6}".encode(), b"0"), "pitch_um"),
    ],
)
def test_what_a_head_lacks_is_asked_for(tmp_path: Path, data: bytes, option: str) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    with pytest.raises(AmbiguousFileError) as asked:
        open_file(path)
    assert asked.value.option == option


@pytest.mark.parametrize(
    "data",
    [
        spip("# z-unit = V\n"),
        gsf("V"),
        bcr().replace(b"zunit = nm", b"zunit = V "),
        vk_csv().replace(b'"Height"', b'"Light"', 1),
    ],
)
def test_maps_of_other_quantities_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    assert recognise(path)[0][0] == 1.0
    with pytest.raises(NacreError):
        open_file(path)


def test_several_exports_of_gwyddion_in_one_file_are_several_channels(tmp_path: Path) -> None:
    def block(name: str, unit: str, factor: float) -> str:
        sides = f"# Width: {COLUMNS * PITCH[0]} µm\n# Height: {ROWS * PITCH[1]} µm\n"
        return f"# Channel: {name}\n{sides}# Value units: {unit}\n{rows_of(NM * factor)}\n"

    path = tmp_path / "a.txt"
    path.write_text(block("Phase", "deg", 1.0) + block("Topo", "nm", 1.0) + block("Back", "nm", 2.0), encoding="utf-8")
    found = open_file(path)
    assert [each.name for each in found] == ["Topo", "Back"]
    np.testing.assert_allclose(found[0].data["height_um"], HEIGHTS)
    np.testing.assert_allclose(found[1].data["height_um"], 2 * HEIGHTS)
    assert open_file(path, ReadOptions(channel="Back"))[0].name == "Back"


def test_records_of_x3p_in_a_namespace_are_read(tmp_path: Path) -> None:
    text = (
        '<ISO5436_2 xmlns="http://www.opengps.eu/2008/ISO5436_2"><Record1><FeatureType>SUR</FeatureType><Axes>'
        f"<CX><Increment>{PITCH[0] * 1e-6}</Increment></CX><CY><Increment>{PITCH[1] * 1e-6}</Increment></CY>"
        "<CZ><DataType>D</DataType></CZ></Axes></Record1><Record3><MatrixDimension>"
        f"<SizeX>{COLUMNS}</SizeX><SizeY>{ROWS}</SizeY><SizeZ>1</SizeZ></MatrixDimension>"
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></ISO5436_2>"
    )
    with zipfile.ZipFile(tmp_path / "a.x3p", "w") as archive:
        archive.writestr("main.xml", text)
        archive.writestr("bindata/data.bin", (HEIGHTS * 1e-6).astype("<f8").tobytes())
    (found,) = open_file(tmp_path / "a.x3p")
    np.testing.assert_allclose(found.data["height_um"], HEIGHTS)


def points(form: str, mark: str = "\t") -> str:
    places = ((row, column) for row in range(ROWS) for column in range(COLUMNS))
    cells = ((column * PITCH[0], row * PITCH[1], NM[row, column]) for row, column in places)
    return form + "".join(mark.join(f"{cell:.4f}" for cell in each) + "\n" for each in cells)


@pytest.mark.parametrize("form", ["X\tY\tZ\nµm\tµm\tnm\n", "# x[µm] y[µm] z[nm]\n", "x (um)\ty (um)\theight (nm)\n"])
def test_units_of_points_stand_in_or_below_the_heading(tmp_path: Path, form: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(points(form), encoding="utf-8")
    (found,) = open_file(path)
    assert found.format == "xyz"
    np.testing.assert_allclose(found.data["height_um"], HEIGHTS)
    np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)


def test_surface_data_with_decimal_commas(tmp_path: Path) -> None:
    head = f"NumPoints = {COLUMNS}\nNumProfiles = {ROWS}\nXscale = {PITCH[0] * 1e-6}\n"
    head += f"Yscale = {PITCH[1] * 1e-6}\nZscale = 2.0E-9\nZresolution = -1\nCompression = 0\nDataType = 3\n*\n"
    path = tmp_path / "a.sdf"
    path.write_text("aBCR-1.0\n" + (head + rows_of(NM / 2, form="{:.2f}") + "*\n").replace(".", ","))
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["height_um"], HEIGHTS)
    np.testing.assert_allclose(found.metadata["pitch_um"], PITCH)


def test_a_keyence_table_without_calibration_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "k.csv"
    path.write_text('"Measure date","2020"\n"Output image data","Height"\n"XY Calibration"\n"Unit","um"\n1,2\n3,4\n')
    with pytest.raises(NacreError) as caught:
        open_file(path)
    assert "k.csv" in str(caught.value) and "\n" not in str(caught.value)
