"""Write the CIE tables that nacre ships, from colour-science's data sets.

colour-science takes seconds to import, so the product never imports it: this script bakes its 1 nm tables
into `src/nacre/light/data/cie_1nm.npz` once. Observers are tabulated at 1 nm by the CIE itself; illuminants
are tabulated at 5 nm and aligned to 1 nm with colour-science's own rule (Sprague between samples as CIE 167
advises, the last value held up to 830 nm), so that both packages integrate the same numbers.

Run from the project's root: `python tools/make_light_tables.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

TARGET = Path(__file__).resolve().parents[1] / "src" / "nacre" / "light" / "data" / "cie_1nm.npz"
ILLUMINANTS = {"A": "A", "C": "C", "D50": "D50", "D65": "D65", "E": "E", "F2": "FL2", "F11": "FL11", "LED-B3": "LED-B3"}
OBSERVERS = {"2deg": "CIE 1931 2 Degree Standard Observer", "10deg": "CIE 1964 10 Degree Standard Observer"}


def tables() -> dict[str, np.ndarray]:
    """Return the arrays of the file: 360-830 nm, one row per nanometre."""
    import colour

    shape = colour.SpectralShape(360, 830, 1)
    arrays = {"wavelengths_nm": np.arange(360.0, 831.0)}
    for name, theirs in ILLUMINANTS.items():
        arrays[f"illuminant {name}"] = colour.SDS_ILLUMINANTS[theirs].copy().align(shape).values
    for name, theirs in OBSERVERS.items():
        arrays[f"observer {name}"] = colour.MSDS_CMFS[theirs].copy().align(shape).values
    return {key: np.ascontiguousarray(value, dtype=float) for key, value in arrays.items()}


def main() -> None:
    """Write the file."""
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(TARGET, **tables())


if __name__ == "__main__":
    main()
