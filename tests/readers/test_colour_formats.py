"""Colour lists: small files in the form of each program, written here."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.light import srgb_decode, srgb_linear_to_xyz, white_xyz, xyz_to_lab
from nacre.optimise.colour_list import read_colours
from nacre.readers.registry import open_file

NM = np.arange(400, 701, 10)
LAB = np.array([[50.0, 20.0, -30.0], [70.0, -5.5, 60.25]])


def written(tmp_path: Path, data: str | bytes, name: str = "card") -> Path:
    path = tmp_path / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def cgats(fields: str, rows: list[str], keywords: str = "", first: str = "CGATS.17", count: int | None = None) -> str:
    sets = len(rows) if count is None else count
    body = "\n".join(rows)
    return (
        f'{first}\nORIGINATOR "x"\n{keywords}NUMBER_OF_FIELDS {len(fields.split())}\nBEGIN_DATA_FORMAT\n{fields}\n'
        f"END_DATA_FORMAT\nNUMBER_OF_SETS {sets}\nBEGIN_DATA\n{body}\nEND_DATA\n"
    )


LAB_ROWS = [f'{k} "patch {k}" {row[0]} {row[1]} {row[2]}' for k, row in enumerate(LAB, start=1)]
LAB_FIELDS = "SAMPLE_ID SAMPLE_NAME LAB_L LAB_A LAB_B"


@pytest.mark.parametrize("first", ["CGATS.17", "CTI3", "ISO28178", "LGOROWLENGTH 2"])
def test_cgats_and_its_kin(tmp_path: Path, first: str) -> None:
    light = 'WEIGHTING_FUNCTION "ILLUMINANT, D65"\nWEIGHTING_FUNCTION "OBSERVER, 10 degree"\n'
    (card,) = open_file(written(tmp_path, cgats(LAB_FIELDS, LAB_ROWS, light, first)))
    np.testing.assert_allclose(np.stack([card.data[name] for name in "Lab"], axis=1), LAB)
    assert card.metadata["names"] == ["patch 1", "patch 2"]
    assert (card.metadata["illuminant"], card.metadata["observer"]) == ("D65", "10deg")
    assert card.assumed == ()


def test_cgats_without_a_light_says_what_it_assumes(tmp_path: Path) -> None:
    (card,) = open_file(
        written(tmp_path, cgats("SAMPLE_ID XYZ_X XYZ_Y XYZ_Z", ["A1 10 20 30", "A2 40 50 60"], first="CTI3"))
    )
    assert card.data["Z"].tolist() == [30.0, 60.0]
    assert card.metadata["illuminant"] == "D50" and len(card.assumed) == 1


@pytest.mark.parametrize("band", ["nm{}", "SPEC_{}", "SPECTRAL_{}", "SPECTRAL_NM{}", "R_{}", "NM_{}"])
def test_cgats_spectra_in_per_cent(tmp_path: Path, band: str) -> None:
    fields = "SAMPLE_ID " + " ".join(band.format(nm) for nm in NM)
    row = "A " + " ".join(["45.5"] * len(NM))
    (card,) = open_file(written(tmp_path, cgats(fields, [row])))
    np.testing.assert_array_equal(card.data["wavelength_nm"], NM)
    np.testing.assert_allclose(card.data["spectra"], 0.455)


@pytest.mark.parametrize(
    "text",
    [
        cgats("SAMPLE_ID CMYK_C CMYK_M CMYK_Y CMYK_K", ["1 0 0 0 100"]),
        cgats("SAMPLE_ID SPEC_400 SPEC_500 SPEC_600", ["1 1 2 3"], first="CCSS"),
        cgats(LAB_FIELDS, LAB_ROWS, count=3),
        cgats(LAB_FIELDS, LAB_ROWS)[:-12],
        cgats(LAB_FIELDS, ["1 a 10 20"]),
        "'rs0024' ; Data Format\nicEncodeFloat ; Encoding\n0.1 0.2\n",
        "'CMYK' ; Data Format\nicEncodeValue ; Encoding\n0.1 0.2 0.3 0.4\n",
    ],
    ids=[
        "device values",
        "emission",
        "a row too few",
        "cut",
        "a cell too few",
        "no wavelengths",
        "device values of ICC",
    ],
)
def test_what_is_no_colour_of_a_surface_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(NacreError):
        open_file(written(tmp_path, text))


def test_icc_text(tmp_path: Path) -> None:
    (card,) = open_file(written(tmp_path, "'Lab ' ; Data Format\nicEncodeValue ; Encoding\n50 20 -30\n70 -5.5 60.25\n"))
    np.testing.assert_allclose(np.stack([card.data[name] for name in "Lab"], axis=1), LAB)


@pytest.mark.parametrize("prefix", ["", "cc:"])
def test_cxf_with_and_without_a_prefix(tmp_path: Path, prefix: str) -> None:
    p = prefix
    space = f'xmlns{":cc" if p else ""}="http://colorexchangeformat.com/CxF3-core"'
    values = " ".join(["0.25"] * len(NM))
    light = 'ColorSpecification="S"'
    objects = ""
    for k, row in enumerate(LAB):
        lab = "".join(f"<{p}{name}>{value}</{p}{name}>" for name, value in zip("LAB", row, strict=True))
        objects += f'<{p}Object Name="n{k}"><{p}ColorValues><{p}ColorCIELab {light}>{lab}</{p}ColorCIELab>'
        objects += f"<{p}ReflectanceSpectrum {light}>{values}</{p}ReflectanceSpectrum></{p}ColorValues></{p}Object>"
    text = (
        f'<?xml version="1.0"?><{p}CxF {space}><{p}Resources><{p}ObjectCollection>{objects}</{p}ObjectCollection>'
        f'<{p}ColorSpecification Id="S"><{p}Illuminant>D65</{p}Illuminant><{p}Observer>10_Degree</{p}Observer>'
        f'<{p}WavelengthRange StartWL="400" Increment="10"/></{p}ColorSpecification></{p}Resources></{p}CxF>'
    )
    (card,) = open_file(written(tmp_path, text))
    assert card.metadata["names"] == ["n0", "n1"]
    assert (card.metadata["illuminant"], card.metadata["observer"]) == ("D65", "10deg")
    np.testing.assert_allclose(np.stack([card.data[name] for name in "Lab"], axis=1), LAB)
    np.testing.assert_array_equal(card.data["wavelength_nm"], NM)


def ase(*swatches: tuple[str, bytes, tuple[float, ...]]) -> bytes:
    body = b""
    for name, space, values in swatches:
        text = (name + "\0").encode("utf-16-be")
        block = struct.pack(">H", len(name) + 1) + text + space + struct.pack(f">{len(values)}f", *values) + b"\0\0"
        body += struct.pack(">HI", 1, len(block)) + block
    return b"ASEF" + struct.pack(">HHI", 1, 0, len(swatches)) + body


def test_swatches_of_ase(tmp_path: Path) -> None:
    data = ase(("red", b"RGB ", (1, 0, 0)), ("blue", b"LAB ", (0.3, 10, -40)), ("ink", b"CMYK", (1, 0, 0, 0)))
    rgb, lab = open_file(written(tmp_path, data))
    np.testing.assert_allclose(rgb.data["srgb"], [[1.0, 0.0, 0.0]])
    assert lab.data["L"][0] == pytest.approx(30.0) and lab.data["b"][0] == pytest.approx(-40.0)
    assert rgb.left_out and "ink" in rgb.left_out[0]


def test_swatches_of_aco_are_read_once_with_their_names(tmp_path: Path) -> None:
    colours = [(0, 65535, 0, 0, 0), (7, 3000, 1000, 65536 - 4000, 0), (8, 5000, 0, 0, 0)]
    data = struct.pack(">HH", 1, 3) + b"".join(struct.pack(">5H", *colour) for colour in colours)
    data += struct.pack(">HH", 2, 3)
    for name, colour in zip(("red", "blue", "grey"), colours, strict=True):
        data += struct.pack(">5HI", *colour, len(name) + 1) + (name + "\0").encode("utf-16-be")
    rgb, lab = open_file(written(tmp_path, data))
    assert rgb.metadata["names"] == ["red", "grey"] and lab.metadata["names"] == ["blue"]
    np.testing.assert_allclose(rgb.data["srgb"], [[1.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
    assert [lab.data[name][0] for name in "Lab"] == [30.0, 10.0, -40.0]


@pytest.mark.parametrize(
    "text",
    [
        "GIMP Palette\nName: x\nColumns: 2\n#\n255 0 0\tred\n  0 128 255 sky\n",
        "JASC-PAL\n0100\n2\n255 0 0 red\n0 128 255 sky\n",
        "#ff0000 red\n#0080ff sky\n",
        '<ooo:color-table><draw:color draw:name="red" draw:color="#ff0000"/>\n'
        '<draw:color draw:name="sky" draw:color="#0080ff"/></ooo:color-table>',
    ],
    ids=["gpl", "jasc", "hex", "soc"],
)
def test_palettes_are_srgb(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    (card,) = open_file(path)
    np.testing.assert_allclose(card.data["srgb"], [[1.0, 0.0, 0.0], [0.0, 128 / 255, 1.0]])
    assert card.metadata["names"] == ["red", "sky"]
    # sRGB is defined for D65 and 2 degrees: the colours of a list for that light are its own
    wanted = xyz_to_lab(srgb_linear_to_xyz(srgb_decode(card.data["srgb"])), srgb_linear_to_xyz(np.ones(3)))
    np.testing.assert_allclose(np.concatenate([row.lab for row in read_colours(path, 1)]), wanted, atol=0.02)


def test_a_lamp_is_no_colour(tmp_path: Path) -> None:
    rows = "".join(f'<SpectralData wavelength="{nm}">1.0</SpectralData>' for nm in NM)
    text = '<?xml version="1.0"?><IESTM2714 xmlns="iestm2714"><SpectralDistribution><SpectralQuantity>relative'
    text += f"</SpectralQuantity>{rows}</SpectralDistribution></IESTM2714>"
    path = written(tmp_path, text)
    assert "irradiance" in open_file(path)[0].data
    with pytest.raises(NacreError):
        read_colours(path, 1)


def test_lists_under_another_light_are_adapted(tmp_path: Path) -> None:
    """White and greys have no hue under any light (Bradford maps white to white)."""
    path = written(tmp_path, cgats(LAB_FIELDS, ["1 white 100 0 0", "2 grey 40 0 0"]))
    for row, lightness in zip(read_colours(path, 2, ("A", "10deg")), (100.0, 40.0), strict=True):
        np.testing.assert_allclose(row.lab, [[lightness, 0, 0]] * 2, atol=1e-6)


def test_spectra_become_colours_under_the_light_of_the_target(tmp_path: Path) -> None:
    """A grey of 18.4 % has L* = 49.98 (CIE 15:2018, 8.2.1)."""
    text = "wavelength,grey,white\n" + "".join(f"{nm},18.4,100\n" for nm in NM)
    for light in (("D65", "2deg"), ("A", "10deg")):
        grey, white = read_colours(written(tmp_path, text), 1, light)
        np.testing.assert_allclose(grey.lab, [[49.98, 0, 0]], atol=0.02)
        np.testing.assert_allclose(white.lab, [[100, 0, 0]], atol=0.02)
        assert grey.name == "grey" and white_xyz(*light)[1] == pytest.approx(1.0)


def test_cgats_in_polar_coordinates_and_chromaticities(tmp_path: Path) -> None:
    (card,) = open_file(written(tmp_path, cgats("SAMPLE_ID LAB_L LAB_C LAB_H", ["1 50 20 90", "2 60 10 180"])))
    np.testing.assert_allclose([card.data["a"], card.data["b"]], [[0.0, -10.0], [20.0, 0.0]], atol=1e-12)
    (card,) = open_file(written(tmp_path, cgats("SAMPLE_ID XYY_X XYY_Y XYY_CAPY", ["1 0.3 0.4 20", "2 0 0 0"])))
    np.testing.assert_allclose(np.stack([card.data[name] for name in "XYZ"]), [[15.0, 0.0], [20.0, 0.0], [15.0, 0.0]])


@pytest.mark.parametrize("first, keywords", [("CTI1", ""), ("CTI3", 'DEVICE_CLASS "DISPLAY"\n')])
def test_targets_and_displays_are_named(tmp_path: Path, first: str, keywords: str) -> None:
    (card,) = open_file(written(tmp_path, cgats("SAMPLE_ID XYZ_X XYZ_Y XYZ_Z", ["1 95 100 108"], keywords, first)))
    assert len(card.assumed) == 2


def test_a_palette_with_a_fourth_channel(tmp_path: Path) -> None:
    text = "GIMP Palette\nChannels: RGBA\n#\n255 0 0 255 Red\n0 51 0 128\t3 green\n"
    (card,) = open_file(written(tmp_path, text, "a.gpl"))
    np.testing.assert_allclose(card.data["srgb"], [[1.0, 0.0, 0.0], [0.0, 0.2, 0.0]])
    assert card.metadata["names"] == ["Red", "3 green"]


@pytest.mark.parametrize("count, first", [(36, 380.0), (31, 400.0), (40, None)])
def test_cxf_spectra_without_an_increment_and_in_per_cent(tmp_path: Path, count: int, first: float | None) -> None:
    spectrum = " ".join(["45.5"] * count)
    path = written(tmp_path, (
        '<cc:CxF xmlns:cc="http://colorexchangeformat.com/CxF3-core"><cc:Resources><cc:ObjectCollection>'
        '<cc:Object Name="A" Id="1"><cc:ColorValues><cc:ReflectanceSpectrum>'
        f"{spectrum}</cc:ReflectanceSpectrum></cc:ColorValues></cc:Object></cc:ObjectCollection></cc:Resources></cc:CxF>"
    ), "a.mxf")  # fmt: skip
    if first is None:
        with pytest.raises(NacreError):
            open_file(path)
        return
    (card,) = open_file(path)
    assert card.data["wavelength_nm"][[0, 1]].tolist() == [first, first + 10.0]
    np.testing.assert_allclose(card.data["spectra"], 0.455)
    assert len(card.assumed) == 2


@pytest.mark.parametrize(
    "text, names",
    [("name,x,y,Y\nRed,0.3,0.4,20\nBlue,0.2,0.1,7\n", ["Red", "Blue"]),
     ("h V C x y Y\n10RP 1 2 0.3 0.4 20\n5R 1 2 0.2 0.1 7\n", ["1", "2"]),
     ("id;x;y;Y\n1;0,3;0,4;0,2\n2;0,2;0,1;0,07\n", ["1", "2"])],
)  # fmt: skip
def test_tables_of_chromaticities(tmp_path: Path, text: str, names: list[str]) -> None:
    (card,) = open_file(written(tmp_path, text, "x.csv"))
    np.testing.assert_allclose(np.stack([card.data[name] for name in "XYZ"]), [[15.0, 14.0], [20.0, 7.0], [15.0, 49.0]])
    assert card.metadata["names"] == names


def test_tables_of_red_green_and_blue(tmp_path: Path) -> None:
    (card,) = open_file(written(tmp_path, "Name\tR\tG\tB\nA\t255\t51\t0\n", "x.txt"))
    np.testing.assert_allclose(card.data["srgb"], [[1.0, 0.2, 0.0]])
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "Name\tR\tG\tB\nA\t50.5\t10.1\t0\n", "y.txt"))


def test_a_table_with_the_names_of_cgats_and_no_head(tmp_path: Path) -> None:
    text = "SAMPLE_ID\tSAMPLE_NAME\tRGB_R\tLAB_L\tLAB_A\tLAB_B\n1\tA1\t115\t37.99\t13.56\t14.06\n"
    (card,) = open_file(written(tmp_path, text, "x.txt"))
    assert card.metadata["names"] == ["A1"] and card.metadata["sample_ids"] == ["1"]
    assert (card.data["L"][0], card.data["b"][0]) == (37.99, 14.06)


def test_tristimulus_values_with_a_white_of_one(tmp_path: Path) -> None:
    (card,) = open_file(written(tmp_path, "name,X,Y,Z\nA,0.41,0.21,0.02\nB,0.18,0.07,0.95\n", "x.csv"))
    np.testing.assert_allclose(card.data["Y"], [21.0, 7.0])
    assert len(card.assumed) == 1


def test_dark_spectra_of_argyll_are_in_per_cent(tmp_path: Path) -> None:
    text = cgats("SAMPLE_ID XYZ_X XYZ_Y XYZ_Z SPEC_500 SPEC_550 SPEC_600", ["1 .5 .6 .4 .6 .6 .7"], first="CTI3")
    (card,) = open_file(written(tmp_path, text))
    np.testing.assert_allclose(card.data["spectra"], [[0.006, 0.006, 0.007]])
    text = cgats("SAMPLE_ID XYZ_X XYZ_Y XYZ_Z SPEC_500 SPEC_550 SPEC_600", ["1 50 60 40 .6 .6 .7"], first="CTI3")
    (card,) = open_file(written(tmp_path, text))
    np.testing.assert_allclose(card.data["spectra"], [[0.6, 0.6, 0.7]])


def test_names_of_cgats_below_remarks(tmp_path: Path) -> None:
    text = "Data of a card\nDate: 2005\n\nSampleID\tSAMPLE_NAME\tCMYK_C\tLAB_L\tLAB_A\tLAB_B\n1\tA1\t0\t95\t0\t-2\n"
    (card,) = open_file(written(tmp_path, text, "x.txt"))
    assert (card.data["L"][0], card.data["b"][0], card.metadata["names"]) == (95.0, -2.0, ["A1"])


def test_transmitted_light_is_named(tmp_path: Path) -> None:
    text = cgats("SPEC_400 SPEC_500", ["60 50"], 'MEAS_TYPE "TRANSMISSIVE"\nSPECTRAL_NORM "100"\n', "SPECT")
    (card,) = open_file(written(tmp_path, text, "x.sp"))
    np.testing.assert_allclose(card.data["spectra"], [[0.6, 0.5]])
    assert len(card.assumed) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name,L,C,h (rad)\ns,50,28.2843,5.497787\n", [50.0, 20.0, -20.0]),
        ("name,L,C,h\ns,50,28.2843,-45\n", [50.0, 20.0, -20.0]),
        ("name,X,Y,Z\ns,0.94811,1,1.07304\n", [100.0, 0.0, 0.0]),
        ("name,hex\ns,FFFFFF\n", [100.0, 0.0, 0.0]),
        ("name,hex\ns,#fff\n", [100.0, 0.0, 0.0]),
        ("name,hex\ns,000000\n", [0.0, 0.0, 0.0]),
    ],
)
def test_other_forms_of_a_colour_list(text: str, expected: list[float], tmp_path: Path) -> None:
    path = tmp_path / "labs.csv"
    path.write_text(text)
    (row,) = read_colours(path, 1, ("D65", "10deg"))
    np.testing.assert_allclose(row.lab[0], expected, atol=0.02)


@pytest.mark.parametrize("cells", ["0.5,0.2,-0.2", "127,148,108", "90,128,128"])
@pytest.mark.parametrize("heading", ["L,a,b\n", ""])
def test_colours_from_0_to_1_or_of_8_bits_are_refused(cells: str, heading: str, tmp_path: Path) -> None:
    path = tmp_path / "labs.csv"
    path.write_text(f"{heading}{cells}\n")
    with pytest.raises(NacreError, match="labs.csv"):
        read_colours(path, 1, ("D65", "10deg"))


@pytest.mark.parametrize(
    ("text", "light"),
    [
        ("Name\tIlluminant/Observer\tL*\ta*\tb*\nred\tD50/10°\t40,5\t50,2\t20,3\n", ("D50", "10deg")),
        ("Name,Illuminant,L*,a*,b*\nred,D65 10 Deg,40.5,50.2,20.3\n", ("D65", "10deg")),
        ("Name,L,a,b,Illuminant,Observer\nred,40.5,50.2,20.3,A,2\n", ("A", "2deg")),
        ("Name,L,C,h,Illuminant,Observer\nred,40.5,54.14822,22.01747,D65,1964\n", ("D65", "10deg")),
    ],
)
def test_columns_state_illuminant_and_observer(tmp_path: Path, text: str, light: tuple[str, str]) -> None:
    path = tmp_path / "a.txt"
    path.write_text(text, encoding="utf-8")
    (found,) = open_file(path)
    assert (found.metadata["illuminant"], found.metadata["observer"]) == light
    assert [float(found.data[k][0]) for k in "Lab"] == pytest.approx([40.5, 50.2, 20.3], abs=1e-3)
    path.write_text(text + text.splitlines()[1].replace(light[0], "C") + "\n", encoding="utf-8")
    with pytest.raises(NacreError):
        open_file(path)
