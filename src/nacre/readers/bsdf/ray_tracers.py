"""Scatter files of ray tracing programs: FRED, LightTools, TracePro, Zemax."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, angles_deg
from nacre.core.errors import NacreError
from nacre.readers.bsdf.gonio_table import DEGREES, axis, measurement, numbers, pairs_of, wavelengths_in_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.text_table import load_text, row_of_numbers

# FRED tabulated scatter: `type bsdf_data`, a line `format`, then blocks of scattered directions.
#
# A line of two numbers begins a block with the polar angle and incidence azimuth; lines of three numbers hold polar
# angle, azimuth and value. The file does not say on which side its mirror direction lies: the largest values decide.

FIRST = re.compile(r"(?im)^[^\S\n]*type\s+bsdf_data\b")
KNOWN = {"angles": ("deg", "rad"), "bsdf": ("value",)}
STEEP_DEG, NEAR_DEG, CONTRAST = 15.0, 60.0, 1.5  # limits of incidence and azimuth, and ratio of the two sides


def sniff_fred(head: FileHead) -> float:
    """Recognise the type line."""
    return CERTAIN if FIRST.search(head.text[:8000]) else 0.0


def read_fred(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the directions.

    Raises:
        NacreError: a line is invalid, or the format has other angles or values.
    """
    form: dict[str, str] = {}
    incidence: list[float] = []
    rows = []
    for number, line in enumerate(load_text(path).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words or words[0].lower() == "type":
            continue
        if words[0].lower() == "format":
            form = dict(word.lower().partition("=")[::2] for word in words[1:])
            continue
        values = row_of_numbers(path, number, line, words)
        if len(values) == 2:
            incidence = values
        elif len(values) == 3 and incidence:
            rows.append([*incidence, *values])
        else:
            raise NacreError(f"{path}: line {number} has {len(values)} numbers; allowed: 2 (incidence), 3 (scatter)")
    for key, allowed in KNOWN.items():
        if form.get(key, allowed[0]) not in allowed:
            raise NacreError(f'{path}: format {key} = "{form[key][:20]}" is not read; allowed: {", ".join(allowed)}')
    if not rows:
        raise NacreError(f"{path}: holds no scattered directions")
    table = np.array(rows)
    angles = np.degrees(table[:, :4]) if form.get("angles") == "rad" else table[:, :4]
    pairs, note = _turned(angles, table[:, 4])
    scale = float(form.get("scale") or 1.0)
    scatter = "btdf" if np.all(pairs[:, 2] > 90.0) else "brdf"
    notes = [note, "the file names no wavelength; one value stands for all"]
    return [measurement(path, pairs, None, scale * table[:, 4:], {"scatter": scatter}, assumed=notes)]


def _turned(angles: Array, values: Array) -> tuple[Array, str]:
    """Return pairs whose mirror direction is at an azimuth difference of 180 degrees, and a remark."""
    difference = (angles[:, 3] - angles[:, 1]) % 360.0
    is_oblique = (angles[:, 0] >= STEEP_DEG) & (angles[:, 2] >= STEEP_DEG)
    near = is_oblique & (np.minimum(difference, 360.0 - difference) <= NEAR_DEG)
    far = is_oblique & (np.abs(difference - 180.0) <= NEAR_DEG)
    at_zero, at_half = (float(values[side].max()) if np.any(side) else 0.0 for side in (near, far))
    is_turned = at_zero > CONTRAST * at_half
    pairs = angles.copy()
    pairs[:, 3] = (angles[:, 3] + (180.0 if is_turned else 0.0)) % 360.0
    if not is_turned and not at_half > CONTRAST * at_zero:
        return pairs, "the mirror direction is taken opposite to the azimuth of incidence; the values do not decide"
    side = "at" if is_turned else "opposite to"
    return pairs, f"the mirror direction is {side} the azimuth of incidence, where the values are largest"


# LightTools BSDF text: common scatter angles, then blocks by incidence, side, scatter type and channel.
#
# Angles are polar angles from the normal and azimuths in degrees; the light of a file without incidence azimuths
# comes from azimuth 90. Source: the reader of libbsdf (Kimura, MPL 2.0).

LIGHTTOOLS_AXES = ("ScatterAzimuth", "ScatterRadial")
LIGHT_AZIMUTH = 90.0
TRISTIMULUS = {"trisx": 0, "trisy": 1, "trisz": 2}
ALLOWED = {"Side": ("front", "back"), "ScatterType": ("brdf", "btdf")}


@dataclass
class _Block:
    """Values `[azimuth, radial]` of one incidence and channel, and the words of its head."""

    head: dict[str, str] = field(default_factory=dict)
    values: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def series(self) -> tuple[str, str]:
        """Side and scatter type."""
        return self.head.get("Side", "front"), self.head.get("ScatterType", "brdf")


def sniff_lighttools(head: FileHead) -> float:
    """Return 1 for the keys of a LightTools head with blocks of incidence, which Zemax' tables have not."""
    words = set(head.text[:16000].split())
    return CERTAIN if {*LIGHTTOOLS_AXES, "AOI", "DataBegin"} <= words and "SampleRotation" not in words else 0.0


def read_lighttools(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one measurement per side and scatter type.

    Raises:
        NacreError: the file is damaged, or blocks are missing.
    """
    text = re.sub(r"(?m)^\s*#.*$", "", load_text(path))
    words = iter(text.split())
    try:
        head, azimuth, radial = _head(words)
        blocks = _blocks(words, len(azimuth), len(radial))
    except (ValueError, IndexError, KeyError, StopIteration):
        raise NacreError(f"{path}: the LightTools file is damaged, or of a form that is not known") from None
    if not blocks:
        raise NacreError(f"{path}: holds no block of values")
    is_xyz = head.get("SpectralContent", "").lower() == "xyz"
    return [
        _one_lighttools(path, series, [b for b in blocks if b.series == series], (azimuth, radial), head, is_xyz)
        for series in dict.fromkeys(block.series for block in blocks)
    ]


def _head(words: Iterator[str]) -> tuple[dict[str, str], Array, Array]:
    head: dict[str, str] = {}
    axes: dict[str, Array] = {}
    for word in words:
        if word == "DataBegin":
            break
        if word in LIGHTTOOLS_AXES:
            axes[word] = axis(words, int(next(words)))
        elif word in ("Symmetry", "SpectralContent", "Source"):
            head[word] = next(words)
    return head, axes[LIGHTTOOLS_AXES[0]], axes[LIGHTTOOLS_AXES[1]]


def _blocks(words: Iterator[str], rows: int, columns: int) -> list[_Block]:
    blocks: list[_Block] = []
    block = _Block()
    for word in words:
        if word == "DataEnd":
            return blocks
        value = next(words)
        if word == "TIS":
            block.values = numbers(words, rows * columns).reshape(rows, columns)
            block.head["TIS"] = value
            blocks.append(block)
            block = _Block()
        elif word in ("AOI", "POI", "Side", "Wavelength", "ScatterType", "TristimulusValue"):
            block.head[word] = value.lower()
            if word in ALLOWED and value.lower() not in ALLOWED[word]:
                raise ValueError(word)
        else:
            raise ValueError(word)
    raise ValueError("DataEnd is missing")


def _one_lighttools(
    path: Path, series: tuple[str, str], blocks: list[_Block], axes: tuple[Array, Array], head: dict[str, str],
    is_xyz: bool,
) -> Measurement:  # fmt: skip
    """Return the measurement for one side and scatter type; channels are wavelengths or X, Y, Z."""
    side, scatter = series
    azimuth, radial = axes
    incidence_of = [(float(b.head.get("AOI", 0)), float(b.head.get("POI", 0))) for b in blocks]
    incidences = sorted(set(incidence_of))
    channel = "TristimulusValue" if is_xyz else "Wavelength"
    names = sorted({b.head.get(channel, "") for b in blocks}, key=lambda name: (len(name), name))
    if is_xyz and set(names) != set(TRISTIMULUS):
        raise NacreError(f"{path}: holds {', '.join(names)[:60]}; XYZ needs TrisX, TrisY and TrisZ")
    place = TRISTIMULUS if is_xyz else {name: k for k, name in enumerate(sorted(names, key=lambda n: float(n or 0)))}
    values = np.full((len(incidences), len(azimuth), len(radial), len(place)), np.nan)
    for block, incidence in zip(blocks, incidence_of):
        values[incidences.index(incidence), ..., place[block.head.get(channel, "")]] = block.values
    if np.isnan(values).any():
        raise NacreError(f"{path}: a block of {scatter.upper()} of the {side} is missing, or a value is not a number")
    theta_i, phi_i = (np.array(column)[:, None, None] for column in zip(*incidences, strict=True))
    polar = 180.0 - radial if scatter == "btdf" else radial
    pairs = pairs_of(theta_i, phi_i, polar[None, None, :], (azimuth[None, :, None] - LIGHT_AZIMUTH + phi_i) % 360.0)
    waves: Array | None = None
    notes: tuple[str, ...] = ()
    if not is_xyz and all(names):
        waves, notes = wavelengths_in_nm(path, np.array(sorted(float(name) for name in names)), None)
    metadata = {"scatter": scatter, "side": side, "symmetry": head.get("Symmetry", ""),
                "tis": [float(b.head["TIS"]) for b in blocks]}  # fmt: skip
    assumed = ["the light comes from azimuth 90, as in LightTools files of isotropic surfaces", *notes]
    table, colour = values.reshape(len(pairs), -1), "xyz" if is_xyz else None
    return measurement(path, pairs, waves, table, metadata, name=side, colour=colour, assumed=assumed)


# TracePro surface properties as text: a table of coefficients, and `Table_BSDF_Data` with BRDF and BTDF.
#
# `ScatterBeta` is |beta - beta0|, the distance between scattered and specular direction in direction cosines.
# `ScatterAzimuth` is the azimuth about the specular direction, 0 towards larger beta. Wavelengths are in um.

TABLE = ("Temperature", "Wavelength", "IncAngle", "AziAngle", "ScatterBeta", "ScatterAzimuth", "BRDF", "BTDF")


def sniff_tracepro(head: FileHead) -> float:
    """Recognise the first line."""
    return CERTAIN if head.lines and head.lines[0].strip().startswith("TracePro Surface Property") else 0.0


def read_tracepro(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the tabulated BSDF; directions beyond the unit circle of direction cosines are left out.

    Raises:
        NacreError: the property has no table of a BSDF, or rows do not fit.
    """
    lines = load_text(path).splitlines()
    start = next((i for i, line in enumerate(lines) if line.strip() == "Table_BSDF_Data"), None)
    if start is None:
        raise NacreError(f"{path}: holds parameters of a surface property (A, B, g) and no Table_BSDF_Data")
    names = lines[start + 1].split() if start + 1 < len(lines) else []
    missing = [name for name in TABLE[1:7] if name not in names]
    if missing:
        raise NacreError(f"{path}: column {missing[0]} of Table_BSDF_Data is missing")
    rows = []
    for number, line in enumerate(lines[start + 2 :], start=start + 3):
        words = line.split()
        if not words:
            continue
        if len(words) != len(names):
            raise NacreError(f"{path}: line {number} has {len(words)} cells, the heading {len(names)}")
        rows.append(row_of_numbers(path, number, line, words))
    if not rows:
        raise NacreError(f"{path}: Table_BSDF_Data holds no rows")
    table = {name: np.array(column) for name, column in zip(names, np.array(rows).T, strict=True)}
    title = next((line.partition("\t")[2].strip() for line in lines if line.startswith("Name\t")), "")
    parts = [_one_tracepro(path, table, scatter, title) for scatter in ("brdf", "btdf") if scatter.upper() in table]
    return [part for part in parts if np.any(part.data["bsdf"] != 0)] or parts[:1]


def _one_tracepro(path: Path, table: dict[str, Array], scatter: str, title: str) -> Measurement:
    incidence, azimuth = table["IncAngle"], np.radians(table["ScatterAzimuth"])
    # direction cosines of the scattered direction, the light from azimuth 0
    x = -np.sin(np.radians(incidence)) - table["ScatterBeta"] * np.cos(azimuth)
    y = -table["ScatterBeta"] * np.sin(azimuth)
    inside = x * x + y * y <= 1.0
    theta = np.degrees(np.arcsin(np.sqrt(np.minimum(x * x + y * y, 1.0))))
    turn = table.get("AziAngle", np.zeros(len(x)))
    columns = (incidence, turn, 180.0 - theta if scatter == "btdf" else theta,
               (np.degrees(np.arctan2(y, x)) + turn) % 360.0)  # fmt: skip
    data = {name: column[inside] for name, column in zip(DEGREES, columns, strict=True)}
    data |= {"wavelength_nm": 1e3 * table["Wavelength"][inside], "bsdf": table[scatter.upper()][inside]}
    beyond = int(np.sum(~inside))
    left_out = (f"{beyond} rows lie beyond the unit circle of direction cosines",) if beyond else ()
    assumed = ("ScatterAzimuth is counted from the direction of larger beta",)
    metadata = {"scatter": scatter, "pairs": int(np.sum(inside))}
    return Measurement(path, "bsdf", data, title, metadata, assumed, left_out)


# Zemax tabular BSDF files: scatter about the specular direction, monochrome or XYZ.
#
# `AngleOfIncidence` is the angle of the specular ray; radial angles are counted from it, azimuth 0 points from it
# towards the surface normal and grows counter-clockwise (Radiant's BSDF data interchange format). For a BTDF the
# specular ray is the directly transmitted one. The order of values is channel, sample rotation, incidence, azimuth,
# radial angle.

CHANNELS = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
SYMMETRIES = ("planesymmetrical", "asymmetrical", "asymmetrical4d")
KEYS = ("Source", "Symmetry", "SpectralContent", "ScatterType")
ZEMAX_AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")


@dataclass(frozen=True)
class ZemaxBsdf:
    """A tabular BSDF.

    Attributes:
        incidence_deg: `[incidence]`; azimuth_deg: `[azimuth]`; radial_deg: `[radial]`.
        values: `[channel, incidence, azimuth, radial]`, 1/sr, for the first sample rotation.
        tis: `[channel, incidence]`, total integrated scatter.
        scatter_type: "BRDF" or "BTDF".
        symmetry: as in the file.
        rotation_deg: `[rotation]`, sample rotations.
        rotated: `[channel, rotation, incidence, azimuth, radial]`, values of all rotations; None for one rotation.
    """

    incidence_deg: Array
    azimuth_deg: Array
    radial_deg: Array
    values: Array
    tis: Array
    scatter_type: str = "BRDF"
    symmetry: str = "PlaneSymmetrical"
    rotation_deg: Array = field(default_factory=lambda: np.zeros(1))
    rotated: Array | None = None

    @property
    def spectral_content(self) -> str:
        """ "Monochrome" for one channel, "XYZ" for three."""
        return "Monochrome" if len(self.values) == 1 else "XYZ"

    @property
    def is_plane_symmetrical(self) -> bool:
        """Whether the azimuths cover one side of the plane of incidence only."""
        return self.symmetry.lower() == SYMMETRIES[0] or float(self.azimuth_deg[-1]) <= 180.0


def scatter_direction(incidence_deg: Array, azimuth_deg: Array, radial_deg: Array) -> Array:
    """Return unit vectors `[..., 3]` for scatter angles about the mirror direction; the light comes from +x."""
    theta, phi, rho = np.radians(incidence_deg), np.radians(azimuth_deg), np.radians(radial_deg)
    specular = np.stack([-np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    to_normal = np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    across = np.stack([np.zeros_like(theta), -np.ones_like(theta), np.zeros_like(theta)], axis=-1)
    ring = np.cos(phi)[..., None] * to_normal + np.sin(phi)[..., None] * across
    return np.asarray(np.cos(rho)[..., None] * specular + np.sin(rho)[..., None] * ring)


def sniff_zemax(head: FileHead) -> float:
    """Recognise the four keys of the head."""
    words = [line.split()[0] for line in head.lines if line.strip() and not line.startswith("#")]
    return CERTAIN if [w.lower() for w in words[:4]] == [k.lower() for k in KEYS] else 0.0


def read_zemax_table(path: str | Path) -> ZemaxBsdf:
    """Read a tabular BSDF.

    Raises:
        NacreError: the file is invalid.
    """
    path = Path(path)
    lines = [line.strip() for line in load_text(path).splitlines()]
    words = iter([w for line in lines if line and not line.startswith("#") for w in line.split()])
    try:
        return _parse(words)
    except StopIteration:
        raise NacreError(f"{path}: Zemax tabular BSDF ends too early; it is cut") from None
    except (ValueError, KeyError, IndexError, MemoryError) as error:
        cause = str(error)[:100] or "damaged"
        raise NacreError(f"{path}: is not a whole Zemax tabular BSDF: {cause}") from None


def _parse(words: Iterator[str]) -> ZemaxBsdf:
    header = {name: _named(words, name) for name in KEYS}
    axes: dict[str, Array] = {}
    for name in ZEMAX_AXES:
        count = int(_named(words, name))
        if not 1 <= count <= 100_000:
            raise ValueError(f"{name} has {count} angles")
        axes[name] = numbers(words, count)
        if np.any(np.diff(axes[name]) <= 0):
            raise ValueError(f"the angles of {name} do not ascend")
    content = _one_of(header, "SpectralContent", tuple(CHANNELS))
    _one_of(header, "Symmetry", SYMMETRIES)
    _one_of(header, "ScatterType", ("BRDF", "BTDF"))
    rotation, incidence, azimuth, radial = (axes[name] for name in ZEMAX_AXES)
    shape = (len(CHANNELS[content]), len(rotation), len(incidence))
    values, tis = np.zeros((*shape, len(azimuth), len(radial))), np.zeros(shape)
    for channel in range(shape[0]):
        next(words)
        _named_only(words, "DataBegin")
        for place in np.ndindex(*shape[1:]):
            tis[channel][place] = float(_named(words, "TIS"))
            values[channel][place] = numbers(words, len(azimuth) * len(radial)).reshape(len(azimuth), len(radial))
        _named_only(words, "DataEnd")
    if not np.all(np.isfinite(values)):
        raise ValueError("values are not finite")
    return ZemaxBsdf(
        incidence, azimuth, radial, values[:, 0], tis[:, 0], header["ScatterType"].upper(), header["Symmetry"],
        rotation, values if len(rotation) > 1 else None,
    )  # fmt: skip


def _named(words: Iterator[str], name: str) -> str:
    _named_only(words, name)
    return next(words)


def _named_only(words: Iterator[str], name: str) -> None:
    word = next(words)
    if word.lower() != name.lower():
        raise ValueError(f'"{word[:20]}" stands in the place of {name}')


def _one_of(header: dict[str, str], key: str, allowed: tuple[str, ...]) -> str:
    name = next((name for name in allowed if name.lower() == header[key].lower()), None)
    if name is None:
        raise ValueError(f"{key} = {header[key][:30]}; allowed: {', '.join(allowed)}")
    return name


def read_zemax(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all rotations; directions below the surface keep their place in the order, with theta_o above 90."""
    table = read_zemax_table(path)
    values = table.rotated if table.rotated is not None else table.values[:, None]
    rotation, incidence, azimuth, radial = np.meshgrid(
        table.rotation_deg, table.incidence_deg, table.azimuth_deg, table.radial_deg, indexing="ij"
    )
    out = angles_deg(scatter_direction(incidence, azimuth, radial))
    theta_o = 180.0 - out[..., 0] if table.scatter_type == "BTDF" else out[..., 0]
    angles = pairs_of(incidence, rotation, theta_o, (out[..., 1] + rotation) % 360.0)
    colour = "xyz" if len(values) == 3 else None
    first = float(table.incidence_deg[0])
    metadata = {
        "scatter": table.scatter_type.lower(), "symmetry": table.symmetry,
        "spectral_content": table.spectral_content, "tis": table.tis,
        "sample_rotation_deg": table.rotation_deg, "angle_of_incidence_deg": table.incidence_deg,
        "scatter_azimuth_deg": table.azimuth_deg, "scatter_radial_deg": table.radial_deg,
        "shape": values.shape[1:] if len(table.rotation_deg) > 1 else values.shape[2:],
    }  # fmt: skip
    assumed = [f"below {first:g} degrees nothing was measured"] if first > 0 else []
    assumed += [] if colour else ["the file names no wavelength; one value stands for all"]
    return [
        measurement(path, angles, None, values.reshape(len(values), -1).T, metadata, colour=colour, assumed=assumed)
    ]
