"""Contents of one measured spectrum, map, material or colour list, in canonical names and units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from nacre.core.errors import NacreError

Kind = Literal["ellipsometry", "constants", "spectrum", "heights", "colours", "bsdf", "tmatrix", "table"]


@dataclass(frozen=True)
class Measurement:
    """One data set of a file.

    Attributes:
        path: the file.
        format: identifier of the format in `registry.FORMATS`.
        kind: class of instrument or data.
        data: arrays by canonical name; the name ends with the unit (`wavelength_nm`, `angle_of_incidence_deg`,
            `psi_deg`, `height_um`); dimensionless quantities lack a unit (`reflectance`, `n`, `k`, `m12`). Arrays of a
            table have equal lengths; a height map is one array [row, column], row 0 at the picture's top.
        name: name of the sample, spectrum, channel or material in the file; empty if there is none.
        metadata: other statements of the file: instrument, date, white reference, illuminant, observer, polarisation,
            `pitch_um`.
        assumed: one sentence for each property that the file does not state.
        left_out: one sentence for each part of the file that was not read.
    """

    path: Path
    format: str
    kind: Kind
    data: Mapping[str, NDArray[Any]]
    name: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReadOptions:
    """Properties that a user states because a file does not (options of `nacre read`, keys of recipes).

    Attributes:
        quantity: canonical name of the dependent quantity (`reflectance`, `transmittance`, `n`, `eps1`, ...).
        unit: abscissa unit (`nm`, `um`, `eV`, `1/cm`) or, for heights, of the heights.
        angle_deg: incidence angle.
        delta_convention: Delta sign: `positive` or `negative` (see `docs`).
        channel: channel of a file with several (heights, zones).
        spectrum: name or number of one spectrum, material or block.
        pitch_um: lateral distance of height samples, (x, y).
        columns: canonical column names of a table without headings; `-` ignores a column.
        ignore: headings of columns to ignore.
        format: identifier in `registry.FORMATS`; recognised from the content by default.
        wavelengths: file of the wavelengths of a spectrum of the USGS library, which is one column.
        expects: kind that the caller needs; decides the columns of a table without headings.
        assumed_quantity: quantity of a table of two columns without headings, which the caller's key states.
    """

    quantity: str | None = None
    unit: str | None = None
    angle_deg: float | None = None
    delta_convention: str | None = None
    channel: str | None = None
    spectrum: str | None = None
    pitch_um: tuple[float, float] | None = None
    columns: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    format: str | None = None
    wavelengths: str | None = None
    expects: Kind | None = None
    assumed_quantity: str | None = None


class AmbiguousFileError(NacreError):
    """A file can be read in several ways; the command line asks on a terminal.

    Attributes:
        option: name of the `ReadOptions` field that decides.
        choices: allowed values; empty if any value of the type is.
    """

    def __init__(self, message: str, option: str, choices: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.option = option
        self.choices = choices


# The beginning of a file, from which its format is recognised.

# images, documents and archives whose first bytes may be printable
PRINTABLE_MAGIC = (b"\x89PNG", b"GIF8", b"%PDF", b"PK\x03\x04", b"\xff\xd8\xff", b"Rar!", b"7z\xbc\xaf", b"{\\rtf")
UTF_16_SHARE = 0.3  # of one parity of bytes, NUL: UTF-16 without a mark


def utf_16_order(data: bytes) -> str | None:
    """Return "utf-16-le" or "utf-16-be" for UTF-16 without a byte order mark, or None."""
    sample = data[:4000]
    if len(sample) < 4 or b"\0" not in sample:
        return None
    even, odd = (sample[i::2].count(0) / max(1, len(sample[i::2])) for i in (0, 1))
    text = sample.replace(b"\0", b"")
    if sum(byte < 9 or 13 < byte < 32 for byte in text) > 0.02 * len(text):
        return None
    if odd > UTF_16_SHARE and even < 0.1 * odd:
        return "utf-16-le"
    return "utf-16-be" if even > UTF_16_SHARE and odd < 0.1 * even else None


@dataclass(frozen=True)
class FileHead:
    """The beginning of a file, from which a format is recognised."""

    path: Path
    data: bytes
    size: int

    @cached_property
    def text(self) -> str:
        """Text of the head; UTF-16 is decoded, other bytes that are no UTF-8 become U+FFFD."""
        encoding = "utf-16" if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") else utf_16_order(self.data) or "utf-8-sig"
        return self.data.decode(encoding, errors="replace")

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text."""
        return self.text.splitlines()

    @cached_property
    def is_text(self) -> bool:
        """Whether the head is text: few control characters."""
        if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") or utf_16_order(self.data) is not None:
            return True
        sample = self.data[:4096]
        if sample.startswith(PRINTABLE_MAGIC):
            return False
        if self.size <= len(sample):
            sample = sample.rstrip(b"\0")  # padding
        controls = sum(byte < 9 or 13 < byte < 32 for byte in sample.replace(b"\0", b""))
        return sample.count(0) <= 0.1 * len(sample) and controls <= 0.02 * len(sample)
