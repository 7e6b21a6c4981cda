"""Optical constants from any file that `nacre.readers` reads: text tables, WVASE, Zemax, spectral pairs."""

from __future__ import annotations

import logging
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.core.files import plain, why_unreadable
from nacre.matter.indices.models import Table
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file

MAX_BYTES = 20_000_000
FORM = 'write a header "wavelength_nm,n,k" (or wavelength_um, energy_eV) and one row of numbers per wavelength'
logger = logging.getLogger("nacre")


def read_index_file(path: Path, options: ReadOptions) -> Table:
    """Read n and k; what was assumed is logged.

    Raises:
        NacreError: the file cannot be read, holds no optical constants, or several materials of which none is chosen;
            the message starts with the file's name.
    """
    try:
        found = _constants(path, options)
    except NacreError as error:
        raise NacreError(f"{path.name}: {str(error).removeprefix(f'{path}: ')}") from None
    said = "; ".join(found.assumed + found.left_out)
    if said:
        logger.warning("%s: %s", path.name, said)
    return Table.sorted(found.data["wavelength_nm"], found.data["n"], found.data["k"])


def _constants(path: Path, options: ReadOptions) -> Measurement:
    try:
        size = plain(path).stat().st_size
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    if size > MAX_BYTES:
        raise NacreError(f"{path}: is larger than {MAX_BYTES // 1_000_000} MB; is it a table of n and k?")
    if size == 0:
        raise NacreError(f"{path}: is empty: column n is missing; {FORM}")
    found = open_file(path, options)
    usable = [measurement for measurement in found if measurement.kind == "constants"]
    if not usable:
        raise NacreError(f"{path}: holds {found[0].kind}, neither header nor row of optical constants; {FORM}")
    if len(usable) > 1:
        names = [measurement.name or str(i + 1) for i, measurement in enumerate(usable)]
        if options.spectrum is None:
            raise AmbiguousFileError(
                f'{path}: holds {len(usable)} materials ({", ".join(names)[:200]}); name one: spectrum = "{names[0]}"',
                "spectrum",
                tuple(names),
            )
        from nacre.readers.table import chosen_block

        return usable[chosen_block(path, options.spectrum, names)]
    return usable[0]
