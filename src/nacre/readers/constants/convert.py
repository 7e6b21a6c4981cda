"""n and k from the quantities of a table: dielectric function, absorption coefficient, signs."""

from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.columns import Columns, sorted_by_wavelength
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.units import UNITS, Floats

QUANTITIES = ("n", "k", "eps1", "eps2", "alpha")
MAX_INDEX = 100.0  # far above any optical material
NOISE_K = 0.01  # k of a clear film scatters about 0 by less in ellipsometry and photometry


def index_of_permittivity(eps1: Floats, eps2: Floats) -> tuple[Floats, Floats]:
    """Return n and k of a dielectric function: n + ik = sqrt(eps1 + i eps2), with k >= 0 for eps2 >= 0."""
    root = np.sqrt(eps1 + 1j * eps2)
    return np.asarray(root.real), np.asarray(root.imag)


def constants(columns: Columns, options: ReadOptions, nm: Floats, format_id: str, name: str = "") -> Measurement:
    """Return the optical constants of one table as a measurement of kind "constants", ascending in wavelength.

    Raises:
        NacreError: one of n and k without the other, quantities that contradict each other, or impossible numbers.
    """
    path = columns.path
    found = {quantity: columns.one(quantity) for quantity in QUANTITIES}
    given = {quantity: column.values for quantity, column in found.items() if column is not None}
    assumed = list(columns.assumed)
    alpha = found["alpha"]
    if alpha is not None:
        if not alpha.unit:
            raise AmbiguousFileError(
                f'{path}: "{alpha.heading}" has no unit; write "{alpha.heading} (1/cm)"', "columns"
            )
        given["alpha"] = alpha.values * UNITS[alpha.unit][1] * nm / (4.0 * np.pi)
    is_missing = np.isnan(nm) | np.any([np.isnan(v) for v in given.values()], axis=0) if given else np.isnan(nm)
    left_out = [*(f'"{heading}" is not used' for heading in columns.unused)]
    left_out += [f'"{heading}" is ignored' for heading in columns.ignored]
    if is_missing.any():
        if is_missing.all():
            raise NacreError(f"{path}: no row has numbers in all columns: n or k is missing or not finite")
        left_out.append(f"{int(is_missing.sum())} rows with missing cells")
    negative = np.flatnonzero(given["n"] < 0.0) if "n" in given else np.empty(0, int)
    if negative.size:
        line, value = columns.table.lines[int(negative[0])], given["n"][negative[0]]
        raise NacreError(f"{path}: line {line}: n = {value:g} should not be negative; are these eps1 and eps2?")
    nm, given = nm[~is_missing], {quantity: values[~is_missing] for quantity, values in given.items()}
    nm, given = sorted_by_wavelength(path, nm, given)
    n, k = _n_and_k(path, given, columns)
    n, k = checked(path, nm, n, k, assumed, "eps2" in given)
    data: dict[str, Floats] = {"wavelength_nm": nm, "n": n, "k": k}
    data |= {quantity: given[quantity] for quantity in ("eps1", "eps2") if quantity in given}
    return Measurement(path, format_id, "constants", data, name, {}, tuple(assumed), tuple(left_out))


def _n_and_k(path: Path, given: dict[str, Floats], columns: Columns) -> tuple[Floats, Floats]:
    n, k, eps1, eps2 = (given.get(quantity) for quantity in ("n", "k", "eps1", "eps2"))
    if k is None:
        k = given.get("alpha")
    if eps1 is not None and eps2 is None or (eps2 is not None and eps1 is None and n is None):
        one, other = ("eps1", "eps2") if eps2 is None else ("eps2", "eps1")
        raise NacreError(
            f"{path}: has {one} without {other}; both are needed; the columns are {columns.table.shown_headings}"
        )
    if eps1 is not None and eps2 is not None:
        from_eps = index_of_permittivity(eps1, eps2)
        for name, mine, theirs in (("n", n, from_eps[0]), ("k", k, from_eps[1])):
            if mine is not None and not np.allclose(mine, theirs, rtol=0.02, atol=0.02):
                raise NacreError(f"{path}: {name} contradicts eps1 and eps2; ignore one of them")
        return (from_eps[0] if n is None else n), (from_eps[1] if k is None else k)
    if n is not None and eps2 is not None:
        from_eps2 = eps2 / (2.0 * n)
        if k is not None and not np.allclose(k, from_eps2, rtol=0.02, atol=0.02):
            raise NacreError(f"{path}: k contradicts eps2 = 2 n k; ignore one of them")
        return n, from_eps2 if k is None else k
    if n is None:
        what = "k alone" if k is not None else "neither n nor eps1"
        raise NacreError(
            f"{path}: column n is missing or not finite: it has {what}; constants need n, or eps1 and eps2; the "
            f"columns are {columns.table.shown_headings}"
        )
    return n, np.zeros_like(n) if k is None else k


def checked(
    path: Path, nm: Floats, n: Floats, k: Floats, assumed: list[str], is_permittivity: bool = False
) -> tuple[Floats, Floats]:
    """Refuse impossible constants, which may follow from a permittivity; k that scatters about 0 is set to 0.

    Raises:
        NacreError: negative k beyond noise.
    """
    if max(n.max(), k.max()) > MAX_INDEX:
        name, values = ("n", n) if n.max() > MAX_INDEX else ("k", k)
        what = "are these other quantities, such as eps1, eps2 or alpha?"
        raise NacreError(f"{path}: {name} = {values.max():g} is larger than any index; {what}")
    if k.min() >= 0.0:
        return n, k
    at = int(np.argmin(k))
    if -k.min() <= NOISE_K:
        assumed.append(f"k scatters about 0 (least {k.min():g}); negative k are set to 0")
        return n, np.maximum(k, 0.0)
    names = '"wavelength_nm", "eps1", "-eps2"' if is_permittivity else '"wavelength_nm", "n", "-k"'
    form = "eps1 - i eps2" if is_permittivity else "n - ik"
    sign = f"if the file holds {form}, name the columns: columns = [{names}]"
    raise NacreError(f"{path}: k = {k[at]:g} at {nm[at]:.6g} nm should be 0 or positive (n + ik); {sign}")
