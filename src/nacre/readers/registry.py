"""Formats that nacre reads, and their recognition by content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Kind, Measurement, ReadOptions

HEAD_BYTES = 65536
CERTAIN = 1.0  # a magic number or an unmistakable first line
LIKELY = 0.6  # typical keys
POSSIBLE = 0.2  # any table of numbers


@dataclass(frozen=True)
class FileHead:
    """The beginning of a file, from which a format is recognised."""

    path: Path
    data: bytes
    size: int

    @cached_property
    def lines(self) -> list[str]:
        """Text lines of the head; bytes that are no text become U+FFFD."""
        return self.data.decode("utf-8-sig", errors="replace").splitlines()


@dataclass(frozen=True)
class Format:
    """A readable format; its module has `sniff(head) -> float` and `read(path, options) -> list[Measurement]`."""

    id: str
    title: str
    kind: Kind
    module: str

    @property
    def sniff(self) -> Callable[[FileHead], float]:
        """Return the function that gives the confidence (0 to 1) that a file has this format."""
        return import_module(f"nacre.readers.{self.module}").sniff

    @property
    def read(self) -> Callable[[Path, ReadOptions], list[Measurement]]:
        """Return the function that reads a file of this format."""
        return import_module(f"nacre.readers.{self.module}").read


# one line per format, sorted by kind; the format of the highest confidence reads a file
FORMATS: tuple[Format, ...] = (
    Format("sdf", "ISO 25178-71 surface data (.sdf), ASCII and binary", "heights", "heights.sdf"),
    Format("gwyddion-text", "Gwyddion ASCII matrix", "heights", "heights.gwyddion_text"),
    Format("gwy", "Gwyddion (.gwy)", "heights", "heights.gwy"),
    Format("sur", "Digital Surf, MountainsMap (.sur)", "heights", "heights.digital_surf"),
    Format("al3d", "Alicona Imaging (.al3d)", "heights", "heights.alicona"),
    Format("nanoscope", "Bruker, Veeco Nanoscope (.spm, .001)", "heights", "heights.nanoscope"),
    Format("wsxm", "WSxM (.top, .stp)", "heights", "heights.wsxm"),
    Format("jpk", "JPK image scan (.jpk, .jpk-qi-image)", "heights", "heights.jpk"),
    Format("tmd", "TrueMap (.tmd)", "heights", "heights.truemap"),
    Format("ibw", "Igor binary wave, Asylum Research (.ibw)", "heights", "heights.igor"),
    Format("netcdf", "NetCDF, classic (.nc)", "heights", "heights.netcdf"),
    Format("opdx", "Bruker Vision64 (.OPDx)", "heights", "heights.opdx"),
    Format("zygo", "Zygo MetroPro (.dat)", "heights", "heights.zygo"),
    Format("x3p", "X3P, ISO 25178-72", "heights", "heights.x3p"),
    Format("topostats", "TopoStats (.topostats)", "heights", "heights.topostats"),
    Format("holography", "text matrix of digital holography", "heights", "heights.holography"),
    Format("xyz", "points x y z of a grid", "heights", "heights.xyz"),
    Format("matrix", "matrix of heights without a head", "heights", "heights.matrix"),
    Format("profile", "line profile (refused)", "heights", "heights.profile"),
)


def recognise(path: Path) -> list[tuple[float, Format]]:
    """Return the formats that a file may have with their confidences, highest first."""
    with path.open("rb") as file:
        head = FileHead(path, file.read(HEAD_BYTES), path.stat().st_size)
    found = [(confidence, entry) for entry in FORMATS if (confidence := entry.sniff(head)) > 0]
    return sorted(found, key=lambda pair: -pair[0])


def open_file(path: str | Path, options: ReadOptions | None = None) -> list[Measurement]:
    """Read a file of any known format.

    Returns:
        One measurement per spectrum, map, material, or colour list.

    Raises:
        NacreError: unknown format, or contents that cannot be read correctly; the message states the cause.
        AmbiguousFileError: the file can be read in several ways; `option` names the field that decides.
    """
    path = Path(path)
    found = recognise(path)
    if not found:
        raise NacreError(f"{path}: unknown format")
    return found[0][1].read(path, options or ReadOptions())
