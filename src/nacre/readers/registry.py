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
    Format("accurion", "Accurion EP3, EP4 text", "ellipsometry", "ellipsometry.accurion"),
    Format("film-sense", "Film Sense text", "ellipsometry", "ellipsometry.film_sense"),
    Format("horiba", "Horiba DeltaPsi text (.spe)", "ellipsometry", "ellipsometry.horiba"),
    Format("nexus-ellipsometry", "NeXus NXellipsometry", "ellipsometry", "ellipsometry.nexus"),
    Format("regress-pro", "regress-pro text (SE)", "ellipsometry", "ellipsometry.regress_pro"),
    Format("spectraray", "Sentech SpectraRay text", "ellipsometry", "ellipsometry.spectraray"),
    Format("woollam-dat", "Woollam WVASE, CompleteEASE data", "ellipsometry", "ellipsometry.woollam_dat"),
    Format("woollam-text", "Woollam WVASE text export", "ellipsometry", "ellipsometry.woollam_text"),
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
