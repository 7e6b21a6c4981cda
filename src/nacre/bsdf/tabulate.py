"""Interface tables of a stratified medium, with controlled interpolation errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from nacre.bsdf.grids import interpolate
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.core.memory import check_memory
from nacre.light import delta_e_2000, spans_colour, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_powers
from nacre.matter.stack.inputs import clear_ambient

TRANSPARENT_K = 1e-4  # 1 mm of the substrate then transmits more than 10 % at 550 nm
SAME_INDEX = 1e-3  # smaller index differences refract invisibly little
TABLE_ERROR = 1e-4  # absolute R and T error at the worst angle and wavelength, if node counts allow
COS_NODES = (129, 257, 513)
COS_NODES_VARYING = 65
TOTAL_NODES = 129
COLOUR_ERROR = 0.5  # dE00 midway between parameter nodes
PARAMETER_NODES = (9, 17, 33, 65, 129, 257, 513)
MAX_STILL_VALUES = 2_000_000  # table size without varying parameters; reached only by films of tens of um
MAX_TABLE_VALUES = 60_000_000  # 480 MB
BLOCK_VALUES = 2_000_000  # values solved at once
BYTES_A_VALUE = 72  # memory per table value: R and T from outside and inside, and their clipped copies
BYTES_SOLVED = 350  # memory per value during solution


class StackTables:
    """One stack of layers, solved from both sides on one wavelength grid.

    Attributes:
        n: complex indices `[medium, wavelength]`, ambient first.
        incoherent: one flag for each layer.
    """

    def __init__(self, n: ComplexArray, incoherent: Sequence[bool], wavelengths_nm: Array, transmits: bool) -> None:
        self.wavelengths_nm = np.asarray(wavelengths_nm, dtype=float)
        self.n = np.array(n, dtype=np.complex128)
        self.n[0] = clear_ambient(self.n[0])
        if transmits:
            # the absorption of a clear substrate belongs to its volume
            self.n[-1] = self.n[-1].real
        self.incoherent = list(incoherent)
        self.transmits = transmits
        ratio = self.n[-1].real / self.n[0].real
        relative = float(np.interp(570.0, self.wavelengths_nm, ratio)) if transmits else 1.0
        self.flipped = relative < 1.0 - SAME_INDEX
        relative = 1.0 / relative if self.flipped else relative
        self.eta = relative if relative > 1.0 + SAME_INDEX else 1.0

    def outside(self, thicknesses_nm: Array, cos_outside: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, cos, wavelength]` for light in the rarer medium."""
        n, d = self._from_outside(thicknesses_nm)
        flags = self.incoherent[::-1] if self.flipped else self.incoherent
        shape = (*d.shape[:-1], len(cos_outside), len(self.wavelengths_nm))
        rows = d.reshape(math.prod(d.shape[:-1]), d.shape[-1])
        reflected, passed = np.empty((len(rows), *shape[-2:])), np.zeros((len(rows), *shape[-2:]))
        for some in _blocks(len(rows), shape[-2] * shape[-1]):
            if any(flags):
                powers = incoherent_powers(n, rows[some], flags, self.wavelengths_nm, cos_i=cos_outside)
            else:
                powers = solver.powers(n, rows[some], self.wavelengths_nm, cos_i=cos_outside)
            reflected[some] = powers.reflectance
            if self.transmits:
                passed[some] = powers.transmittance
        return reflected.reshape(shape), passed.reshape(shape)

    def inside(self, thicknesses_nm: Array, in_plane: Array) -> Array:
        """Return R `[*params, angle, wavelength]` for light in the denser medium.

        Args:
            in_plane: kx/k0 `[angle, wavelength]`.
        """
        n, d = self._from_outside(thicknesses_nm)
        n, d = n[::-1], d[..., ::-1]
        if not any(self.incoherent):
            rows = d.reshape(math.prod(d.shape[:-1]), d.shape[-1])
            reflected = np.empty((len(rows), *in_plane.shape))
            for some in _blocks(len(rows), in_plane.size):
                solved = solver.amplitudes(n, rows[some], self.wavelengths_nm, kappa=in_plane)
                reflected[some] = 0.5 * (np.abs(solved.r_s) ** 2 + np.abs(solved.r_p) ** 2)
            return reflected.reshape(*d.shape[:-1], *in_plane.shape)
        flags = self.incoherent if self.flipped else self.incoherent[::-1]
        sin = np.clip(in_plane / n[0].real, 0.0, 1.0)
        columns_of = []
        for row in d.reshape(-1, d.shape[-1]):
            columns = [
                # each wavelength has its own angle inside for the common angle outside
                incoherent_powers(n[:, [l]], row, flags, self.wavelengths_nm[[l]], np.arcsin(sin[:, l])).reflectance
                for l in range(len(self.wavelengths_nm))
            ]
            columns_of.append(np.concatenate(columns, axis=-1))
        return np.reshape(columns_of, (*d.shape[:-1], *in_plane.shape))

    def _from_outside(self, thicknesses_nm: Array) -> tuple[ComplexArray, Array]:
        return (self.n[::-1], thicknesses_nm[..., ::-1]) if self.flipped else (self.n, thicknesses_nm)

    def build(self, thicknesses_nm: Array, nodes: int, parameters: tuple[ParameterAxis, ...] = ()) -> InterfaceResponse:
        """Tabulate both sides on `nodes` cosines.

        Args:
            thicknesses_nm: `[*params, layer]`.
        """
        d = np.asarray(thicknesses_nm, dtype=float)
        cos = np.linspace(0.0, 1.0, nodes)
        reflectance, transmittance = self.outside(d, cos)
        zero = np.zeros_like(reflectance)
        total = np.zeros((*d.shape[:-1], 0, len(self.wavelengths_nm)))
        behind = zero
        if self.transmits:
            rare = (self.n[-1] if self.flipped else self.n[0]).real
            dense = (self.n[0] if self.flipped else self.n[-1]).real
            behind = self.inside(d, np.sqrt(1.0 - cos * cos)[:, None] * rare)
            if self.eta == 1.0:
                behind = np.where(cos[:, None] == 0.0, reflectance[..., :1, :], behind)
            else:
                # in-plane wavevectors run from critical to grazing at every wavelength: stretch their squares to each
                # wavelength's index, although all share one eta
                share = np.square(np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, TOTAL_NODES)))[:, None]
                square = rare**2 + np.maximum(dense**2 - rare**2, 0.0) * share
                total = self.inside(d, np.sqrt(square))
                total[..., -1, :] = 1.0  # grazing inside
        return InterfaceResponse(
            wavelengths_nm=self.wavelengths_nm,
            cos_outside=cos,
            reflectance=np.clip(reflectance, 0.0, 1.0),
            transmittance=np.clip(transmittance, 0.0, 1.0),
            reflectance_inside=np.clip(behind, 0.0, 1.0),
            total=np.clip(total, 0.0, 1.0),
            eta=self.eta,
            transmits=self.transmits,
            flipped=self.flipped,
            parameters=parameters,
        )

    def adaptive(self, thicknesses_nm: Array) -> InterfaceResponse:
        """Tabulate on enough cosines for an R and T error below `TABLE_ERROR`, within `COS_NODES`."""
        count = len(self.wavelengths_nm)
        check_memory(
            float(BYTES_SOLVED) * COS_NODES[0] * count, f"a table of {COS_NODES[0]} angles x {count} wavelengths"
        )
        allowed = [nodes for nodes in COS_NODES if nodes * len(self.wavelengths_nm) <= MAX_STILL_VALUES] or COS_NODES[
            :1
        ]
        for nodes in allowed[:-1]:
            middle = (np.arange(nodes - 1) + 0.5) / (nodes - 1)
            response = self.build(thicknesses_nm, nodes)
            exact = self.outside(np.asarray(thicknesses_nm, dtype=float), middle)
            tables = (response.reflectance, response.transmittance)
            at = (middle * (nodes - 1),)
            error = max(float(np.max(np.abs(interpolate(t, at) - e))) for t, e in zip(tables, exact, strict=True))
            if error <= TABLE_ERROR:
                return response
        return self.build(thicknesses_nm, allowed[-1])


def _blocks(rows: int, values: int) -> Iterator[slice]:
    """Yield table rows in blocks of bounded size: amplitudes take twenty times a table's memory."""
    step = max(1, BLOCK_VALUES // values)
    for start in range(0, rows, step):
        yield slice(start, start + step)


def is_transparent(n: ComplexArray) -> bool:
    """Whether a macroscopic body with index `n` `[wavelength]` is transparent."""
    return bool(np.max(n.imag) < TRANSPARENT_K)


def comparison_xyz(spectra: Array, wavelengths_nm: Array) -> Array:
    """Return the colours `[..., 3]` of spectra `[..., wavelength]`, for error control of tables and grids.

    If the wavelengths do not span the visible range, each wavelength counts as a grey with that power:
    `[..., wavelength, 3]`. Linear in the spectra.
    """
    if spans_colour(wavelengths_nm):
        return np.asarray(spectrum_to_xyz(spectra, wavelengths_nm))
    return np.asarray(spectra, dtype=float)[..., None] * white_xyz()


def reflected_lab(reflectance: Array, wavelengths_nm: Array) -> Array:
    """Return CIELAB under D65 of `comparison_xyz` for spectra `[..., wavelength]`."""
    return np.asarray(xyz_to_lab(comparison_xyz(reflectance, wavelengths_nm)))


def interpolation_colour_error(spectra: Callable[[Array], Array], values: Array, wavelengths_nm: Array) -> float:
    """Return the largest dE00 midway between nodes.

    Args:
        spectra: maps parameter values to power `[value, ..., wavelength]`.
    """
    nodes = spectra(values)
    exact = spectra(0.5 * (values[1:] + values[:-1]))
    between = 0.5 * (nodes[1:] + nodes[:-1])
    difference = delta_e_2000(reflected_lab(between, wavelengths_nm), reflected_lab(exact, wavelengths_nm))
    return float(np.max(difference))


def choose_nodes(
    spectra: Callable[[Array], Array], low: float, high: float, wavelengths_nm: Array
) -> tuple[Array, float]:
    """Return uniform nodes of a parameter, fine enough for `COLOUR_ERROR`, and the dE00 reached.

    Args:
        spectra: maps parameter values to power `[value, ..., wavelength]`.
        low, high: parameter range.
    """
    values, worst = np.array([low, high]), 0.0
    for count in PARAMETER_NODES:
        values = np.linspace(low, high, count)
        worst = interpolation_colour_error(spectra, values, wavelengths_nm)
        if worst <= COLOUR_ERROR:
            break
    return values, worst


def check_size(counts: Sequence[int], cos_nodes: int, wavelengths: int) -> None:
    """Check that tables fit in memory before they are computed.

    Raises:
        UnsupportedError: the tables are too large; the message gives the sizes.
    """
    size = math.prod(counts) * cos_nodes * wavelengths
    if size > MAX_TABLE_VALUES:
        raise UnsupportedError(
            f"the varying numbers need {' x '.join(map(str, counts))} nodes x {cos_nodes} angles x {wavelengths} "
            f"wavelengths = {size} values; at most {MAX_TABLE_VALUES} fit: narrow the ranges or let one number vary"
        )
    check_memory(
        float(BYTES_A_VALUE) * size, f"the table of {' x '.join(map(str, counts))} nodes of the varying numbers"
    )
