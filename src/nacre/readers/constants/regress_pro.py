"""Dispersion libraries of regress-pro: oscillator models, which are recognised and refused by name."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.text_table import load_text

_MODEL = re.compile(r'(?:^|\s)(ho|tauc-lorentz|kramers|cauchy|bruggeman|fb|lookup)\s+"([^"]*)"')


def sniff(head: FileHead) -> float:
    """Return 0.95 for a library or a single model."""
    first = next((line.strip() for line in head.lines if line.strip()), "")
    return 0.95 if re.match(r"dispers-library\s+\d+", first) or _MODEL.match(first) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the models.

    Raises:
        NacreError: always; names the models.
    """
    models = [f"{name} ({kind})" for kind, name in _MODEL.findall(load_text(path, 20_000_000))]
    raise NacreError(
        f"{path}: is a dispersion library of regress-pro with models ({', '.join(models)[:120]}), which are not read; "
        "export a table of n and k (.mat)"
    )
