"""Interface tables of a stratified medium, with controlled interpolation errors.

Tables of an anisotropic stack hold unpolarised light, over the azimuth or as means over it.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from nacre.bsdf.angle_nodes import ALLOWED_ERROR, AngleErrors, Tabulated, tabulate
from nacre.bsdf.response import FINEST_LEVEL, InterfaceResponse, is_uniform
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.core.machine import check_memory
from nacre.light import delta_e_2000, spans_colour, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_powers
from nacre.matter.stack.inputs import clear_ambient
from nacre.matter.stack.solve import narrow_resonances
from nacre.matter.stack.stack import Medium, Stack, permittivity_of

TRANSPARENT_K = 1e-4  # 1 mm of the substrate then transmits more than 10 % at 550 nm
SAME_INDEX = 1e-3  # smaller index differences refract invisibly little
MOST_COS_NODES, LEAST_COS_NODES = 4097, 129
COS_NODES_VARYING, MOST_COS_NODES_VARYING = 65, 129
PROBED_NODES = 3  # values per varying number at which nodes over angle are chosen
TOTAL_NODES = 129
FLANKS = np.array([-3.3, -1.1, 0.0, 1.1, 3.3]) / 2**FINEST_LEVEL  # about a narrow resonance
METALLIC_K = 0.1  # media with a larger k guide no narrow modes by total reflection
CHECKED_ANGLES, LEAST_CHECKED = 450, 90
FEW_COSINES = np.array([1.0, 0.7, 0.4, 0.1])
LOSSLESS = 1e-9
MOST_CRITICAL, BESIDE = 48, np.array([-0.3, -0.04, 0.0, 0.04, 0.3]) / 512
DISPERSED_ANGLES, CRITICAL_QUANTILES = 60, (0.0, 0.25, 0.5, 0.75, 1.0)
COLOUR_ERROR = 0.5  # dE00 midway between parameter nodes
PARAMETER_NODES = (9, 17, 33, 65, 129, 257, 513)
MAX_STILL_VALUES = 2_000_000  # table size without varying parameters; reached only by films of tens of um
MAX_CHECKED_VALUES = 500_000
MAX_VARYING_VALUES = 6_000_000
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
        ratio = self.n[-1].real / self.n[0].real if transmits else np.ones(len(self.wavelengths_nm))
        relative = float(np.interp(570.0, self.wavelengths_nm, ratio))
        bends = bool(np.max(np.abs(ratio - 1.0)) > SAME_INDEX)
        self.flipped = bends and relative < 1.0
        relative = 1.0 / relative if self.flipped else relative
        self.eta = max(relative, 1.0 + SAME_INDEX) if bends else 1.0
        self.relative_index = (1.0 / ratio if self.flipped else ratio) if bends and np.ptp(ratio) > 0.0 else None

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

    def inside(self, thicknesses_nm: Array, in_plane: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, angle, wavelength]` for light in the denser medium.

        Args:
            in_plane: kx/k0 `[angle, wavelength]`.
        """
        n, d = self._from_outside(thicknesses_nm)
        n, d = n[::-1], d[..., ::-1]
        flags = self.incoherent if self.flipped else self.incoherent[::-1]
        rows = d.reshape(math.prod(d.shape[:-1]), d.shape[-1])
        in_plane = np.minimum(in_plane, n[0].real)
        reflected, passed = np.empty((2, len(rows), *in_plane.shape))
        for some in _blocks(len(rows), in_plane.size):
            if any(flags):
                powers = incoherent_powers(n, rows[some], flags, self.wavelengths_nm, kappa=in_plane)
            else:
                powers = solver.powers(n, rows[some], self.wavelengths_nm, kappa=in_plane)
            reflected[some], passed[some] = powers.reflectance, powers.transmittance
        shape = (*d.shape[:-1], *in_plane.shape)
        return reflected.reshape(shape), passed.reshape(shape)

    def _from_outside(self, thicknesses_nm: Array) -> tuple[ComplexArray, Array]:
        return (self.n[::-1], thicknesses_nm[..., ::-1]) if self.flipped else (self.n, thicknesses_nm)

    def build(self, thicknesses_nm: Array, nodes: int, parameters: tuple[ParameterAxis, ...] = ()) -> InterfaceResponse:
        """Tabulate both sides on `nodes` uniform cosines.

        Args:
            thicknesses_nm: `[*params, layer]`.
        """
        return self._on_nodes(thicknesses_nm, np.linspace(0.0, 1.0, nodes), parameters)

    def adaptive(self, thicknesses_nm: Array) -> InterfaceResponse:
        """Tabulate on nodes over angle that follow the optics; see `nacre.bsdf.angle_nodes`."""
        return self.with_error(thicknesses_nm)[0]

    def with_error(self, thicknesses_nm: Array) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate as `adaptive`, and return the differences of R or T from the solution.

        They are found at several hundred angles from both sides.
        """
        d = np.asarray(thicknesses_nm, dtype=float)
        count = len(self.wavelengths_nm)
        check_memory(
            float(BYTES_SOLVED) * LEAST_COS_NODES * count, f"a table of {LEAST_COS_NODES} angles x {count} wavelengths"
        )
        most = max(LEAST_COS_NODES, min(MOST_COS_NODES, MAX_STILL_VALUES // count))
        checked = int(np.clip(MAX_CHECKED_VALUES // count, LEAST_CHECKED, CHECKED_ANGLES))
        angles: Array = np.linspace(0.0, 0.5 * np.pi, 2 * checked + 1)[1::2]
        is_clear = self.transmits and self._is_lossless(d)
        critical, beyond_critical = self._critical()
        narrow, narrow_beyond = self._resonances(d, angles, is_clear)
        check = np.concatenate([np.cos(angles), critical, narrow])
        further = np.cos(0.5 * (angles[1:] + angles[:-1]))
        sides = tabulate(lambda cos: self._sides(d, cos, is_clear), most, check, further)
        total = np.ones((TOTAL_NODES if self.eta > 1.0 and self.transmits else 0, count))
        beyond = np.linspace(0.0, 1.0, len(total)) if len(total) else None
        outer = None
        if self.eta > 1.0 and self.transmits and not is_clear:
            x = np.concatenate([angles[::3] / (0.5 * np.pi), beyond_critical])
            x, further = np.concatenate([x, narrow_beyond]), 0.5 * (x[1:] + x[:-1])
            outer = tabulate(lambda at: self._beyond(d, at), most, x, further, fine_error=ALLOWED_ERROR)
            total, beyond = outer.values, outer.nodes
        reflected, passed, behind = np.moveaxis(sides.values, 1, 0)
        response = self._response(sides.nodes, reflected, passed, behind, total, beyond)
        return response, self._errors(sides, outer, self._errors_in_denser(response, d, angles[::3]))

    def with_parameters(
        self, thicknesses_nm: Array, parameters: tuple[ParameterAxis, ...]
    ) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate varying thicknesses on nodes over angle chosen at some of them; see `with_error`.

        Args:
            thicknesses_nm: `[*params, layer]`.
        """
        d = np.asarray(thicknesses_nm, dtype=float)
        count = len(self.wavelengths_nm)
        some = [np.unique(np.linspace(0, size - 1, PROBED_NODES).astype(int)) for size in d.shape[:-1]]
        probed = d[np.ix_(*some)].reshape(-1, d.shape[-1])
        most = min(MOST_COS_NODES_VARYING, MAX_VARYING_VALUES // (math.prod(d.shape[:-1]) * count))
        is_clear = self.transmits and self._is_lossless(probed)
        angles = (np.arange(LEAST_CHECKED) + 0.5) * (0.5 * np.pi / LEAST_CHECKED)
        levels = (COS_NODES_VARYING - 1).bit_length() - 1, (COS_NODES_VARYING - 1).bit_length()
        check = np.cos(angles)
        chosen = tabulate(
            lambda cos: self._sides(probed, cos, is_clear), most, check, check[:0], levels, fine_error=ALLOWED_ERROR
        )
        outer = None
        if self.eta > 1.0 and self.transmits and not is_clear:
            beyond = np.linspace(0.0, 1.0, TOTAL_NODES)
            nodes, middle = self._beyond(probed, beyond), 0.5 * (beyond[1:] + beyond[:-1])
            difference = self._beyond(probed, middle) - 0.5 * (nodes[1:] + nodes[:-1])
            outer = Tabulated(beyond, nodes, middle, np.abs(difference).max(axis=1))
        return self._on_nodes(d, chosen.nodes, parameters), self._errors(chosen, outer)

    def _errors(self, sides: Tabulated, beyond: Tabulated | None, *more: tuple[Array, Array]) -> AngleErrors:
        """Collect errors by angle; those of conjugate angles count on both sides."""
        outside = np.arccos(np.clip(sides.checked, 0.0, 1.0))[:, None]
        if not self.transmits:
            return AngleErrors((outside, sides.errors))
        eta = np.full(len(self.wavelengths_nm), self.eta) if self.relative_index is None else self.relative_index
        inside = [(np.arcsin(np.minimum(np.sin(outside) / eta, 1.0)), sides.errors), *more]
        if beyond is not None:
            critical = np.sqrt(np.maximum(0.0, 1.0 - 1.0 / eta**2))
            inside.append((np.arccos(critical * np.cos(0.5 * np.pi * beyond.checked)[:, None]), beyond.errors))
        angles, errors = (np.concatenate(part) for part in zip(*inside, strict=True))
        return AngleErrors((outside, sides.errors), (angles, errors))

    def _on_nodes(
        self, thicknesses_nm: Array, cos: Array, parameters: tuple[ParameterAxis, ...] = ()
    ) -> InterfaceResponse:
        d = np.asarray(thicknesses_nm, dtype=float)
        reflected, passed = self.outside(d, cos)
        behind = self._behind(d, cos, reflected) if self.transmits else np.zeros_like(reflected)
        total, beyond = np.zeros((*d.shape[:-1], 0, len(self.wavelengths_nm))), None
        if self.transmits and self.eta > 1.0:
            beyond = np.linspace(0.0, 1.0, TOTAL_NODES)
            total = np.moveaxis(self._beyond(d, beyond), 0, -2)
        return self._response(cos, reflected, passed, behind, total, beyond, parameters)

    def _response(
        self,
        cos: Array,
        reflected: Array,
        passed: Array,
        behind: Array,
        total: Array,
        beyond: Array | None,
        parameters: tuple[ParameterAxis, ...] = (),
    ) -> InterfaceResponse:
        return InterfaceResponse(
            wavelengths_nm=self.wavelengths_nm,
            cos_outside=cos,
            reflectance=np.clip(reflected, 0.0, 1.0),
            transmittance=np.clip(passed, 0.0, 1.0),
            reflectance_inside=np.clip(behind, 0.0, 1.0),
            total=np.clip(total, 0.0, 1.0),
            eta=self.eta,
            transmits=self.transmits,
            flipped=self.flipped,
            parameters=parameters,
            total_nodes=None if beyond is None or is_uniform(beyond) else beyond,
            relative_index=self.relative_index,
        )

    def _critical(self) -> tuple[Array, Array]:
        """Return cosines outside, and coordinates beyond the critical angle, beside the layers' critical angles."""
        rare = (self.n[-1] if self.flipped else self.n[0]).real
        dense = (self.n[0] if self.flipped else self.n[-1]).real
        layers = np.unique(np.concatenate([self.n[1:-1].real, dense[None]]), axis=0) ** 2
        rare, dense = rare**2, dense**2
        outside = np.sqrt(1.0 - np.minimum(layers / rare, 1.0)).ravel()
        nodes = [outside]
        if self.eta > 1.0:
            share = np.clip((layers - rare) / np.maximum(dense - rare, 1e-12), 0.0, 1.0)
            nodes.append(2.0 / np.pi * np.arcsin(np.sqrt(share)).ravel())
        nodes = [np.unique(np.round(at[(at > 0.0) & (at < 1.0)], 6)) for at in nodes]
        nodes = [at[:: -(-len(at) // MOST_CRITICAL) or 1] for at in nodes]
        beside = [np.clip(at[:, None] + BESIDE, 0.0, 1.0).ravel() for at in nodes]
        return beside[0], beside[-1]

    def _resonances(self, d: Array, angles: Array, is_clear: bool) -> tuple[Array, Array]:
        """Return cosines outside, and coordinates beyond the critical angle, of guided modes and narrow fringes."""
        n, d = self._from_outside(d)
        rare, dense = n[0].real, n[-1].real
        if not len(d) or any(self.incoherent) or np.min(n[1:-1].real) >= np.max(rare) and (is_clear or self.eta == 1.0):
            return np.zeros(0), np.zeros(0)
        below = np.sin(angles)[:, None] * rare
        runs = [below]
        if self.eta > 1.0 and self.transmits and not is_clear:
            runs.append(in_plane_beyond(rare, dense, angles / (0.5 * np.pi)))
        kappa = np.concatenate(runs)
        clear = np.where(n.imag < METALLIC_K, n.real, np.inf)
        kappa = kappa[np.any(kappa > np.min(clear, axis=0), axis=1)]
        wave, at = narrow_resonances(n, d, self.wavelengths_nm, kappa).T
        wave = wave.astype(int)
        is_below = at < rare[wave]
        cos = np.sqrt(1.0 - np.square(at[is_below] / rare[wave[is_below]]))
        wave, at = wave[~is_below], at[~is_below]
        share = (at**2 - rare[wave] ** 2) / np.maximum(dense[wave] ** 2 - rare[wave] ** 2, 1e-12)
        return _with_flanks(cos), _with_flanks(2.0 / np.pi * np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))))

    def _is_lossless(self, thicknesses_nm: Array) -> bool:
        """Whether R + T = 1 from outside at a few angles: R is then equal from both sides."""
        reflected, passed = self.outside(thicknesses_nm, FEW_COSINES)
        return bool(np.max(np.abs(reflected + passed - 1.0)) < LOSSLESS)

    def _behind(self, d: Array, cos: Array, reflected: Array) -> Array:
        """Return R from inside at the conjugate angles, `[*params, cos, wavelength]`."""
        rare = (self.n[-1] if self.flipped else self.n[0]).real
        behind, _ = self.inside(d, np.sqrt(1.0 - cos * cos)[:, None] * rare)
        return np.where(cos[:, None] == 0.0, reflected, behind) if self.eta == 1.0 else behind

    def _sides(self, d: Array, cos: Array, is_clear: bool) -> Array:
        """Return R and T from outside, and R from inside at the conjugate angles: `[cos, *params, 3, wavelength]`."""
        reflected, passed = self.outside(d, cos)
        behind = reflected if is_clear else np.zeros_like(reflected)
        if self.transmits and not is_clear:
            behind = self._behind(d, cos, reflected)
        return np.moveaxis(np.stack([reflected, passed, behind], axis=-2), -3, 0)

    def _beyond(self, d: Array, x: Array) -> Array:
        """Return R from inside beyond the critical angle, `[x, *params, wavelength]`."""
        rare = (self.n[-1] if self.flipped else self.n[0]).real
        dense = (self.n[0] if self.flipped else self.n[-1]).real
        reflected, _ = self.inside(d, in_plane_beyond(rare, dense, x))
        return np.moveaxis(np.where(x[:, None] == 1.0, 1.0, reflected), -2, 0)

    def _errors_in_denser(self, response: InterfaceResponse, d: Array, angles: Array) -> tuple[Array, Array]:
        """Return angles, and the largest differences of R or T from the solution for light in the denser medium."""
        if not self.transmits or self.eta == 1.0:
            return np.zeros((0, len(self.wavelengths_nm))), np.zeros((0, len(self.wavelengths_nm)))
        dense = (self.n[0] if self.flipped else self.n[-1]).real
        rare = (self.n[-1] if self.flipped else self.n[0]).real
        # the largest differences lie between the critical angles of the wavelengths and that of all
        critical = np.arcsin(np.clip([1.0 / self.eta, *np.quantile(rare / dense, CRITICAL_QUANTILES)], 0.0, 1.0))
        theta = np.concatenate([angles, np.linspace(critical.min(), critical.max(), DISPERSED_ANGLES), critical])
        exact = self.inside(d, np.sin(theta)[:, None] * dense)
        stored = response.resolved(np.cos(theta), np.ones(len(theta), dtype=bool))
        error = np.abs(np.stack(stored) - np.clip(np.stack(exact), 0.0, 1.0)).max(axis=0)
        return np.broadcast_to(theta[:, None], error.shape), error


def _with_flanks(at: Array) -> Array:
    """Return values in [0, 1] and points beside them, which differ by more than half the narrowest interval."""
    at = np.sort(np.clip(at[:, None] + FLANKS, 0.0, 1.0).ravel())
    return at[np.diff(at, prepend=-1.0) > 0.5 ** (FINEST_LEVEL + 1)] if len(at) else at


def in_plane_beyond(rare: Array, dense: Array, x: Array) -> Array:
    """Return kx / k0 `[x, wavelength]` beyond the critical angle, of media with the indices `[wavelength]`.

    It runs from critical (x = 0) to grazing (x = 1) at every wavelength: the squares are stretched to each wavelength's
    index, although all share one `eta`.
    """
    share = np.square(np.sin(0.5 * np.pi * x))[:, None]
    return np.asarray(np.sqrt(rare**2 + np.maximum(dense**2 - rare**2, 0.0) * share))


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


COS_NODES = 65
COS_NODES_SPREAD = 33  # a pitch spread averages the fringes out
SLICE_SHARE = 0.25  # fraction of a helix's slices that is used; the error grows to some 3e-4
LOSSLESS_K = 1e-9
AZIMUTHS = (3, 5, 9, 17)  # odd: even counts repeat the same values, as half a turn changes little
AZIMUTH_ERROR = 4e-3  # change of the mean reflectance allowed at the next count
CHECKED_COSINES = (np.array([12.0, 30.0, 47.0]) + 0.5) / 64  # midway between nodes
PROBE_COSINES = np.array([0.8, 0.45])
PROBE_WAVELENGTHS = 12
MOST_THETA, BESIDE_GRAZING = 0.5 * np.pi - 1e-6, 1e-10  # no wave runs exactly along the surface
PROBED_AZIMUTHS = 4  # azimuths in half a turn
LEAST_AZIMUTHS, MOST_AZIMUTHS = 8, 32  # with 32, cos(2 phi) is wrong by at most 0.02 of the amplitude


class AnisotropicTables(StackTables):
    """One stack with anisotropic layers, solved from both sides, with the mean over the azimuth.

    The mean of unpolarised light is reciprocal, since the powers of a path and of its reverse are equal. Light from an
    anisotropic substrate arrives from an isotropic medium of its mean permittivity.
    """

    def __init__(self, stack: Stack, wavelengths_nm: Array, transmits: bool, depends_on_azimuth: bool) -> None:
        lam = np.asarray(wavelengths_nm, dtype=float)
        below = stack.substrate
        self._below = below.isotropic() if isinstance(below, AnisotropicConstant) else below
        super().__init__(
            Stack(stack.ambient, [], self._below).indices(lam),
            [layer.incoherent for layer in stack.layers],
            lam,
            transmits,
        )
        self.stack = stack
        self._absorbs_nothing = all(_is_lossless(layer.material, lam) for layer in stack.layers)
        self.azimuths_rad = self._azimuths() if depends_on_azimuth else np.zeros(1)
        self._azimuths_inside = self.azimuths_rad

    def outside(self, thicknesses_nm: Array, cos_outside: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, cos, wavelength]` for light in the rarer medium."""
        theta = np.minimum(np.arccos(np.clip(cos_outside, 0.0, 1.0)), MOST_THETA)
        shape = (*thicknesses_nm.shape[:-1], len(theta), len(self.wavelengths_nm))
        rows = thicknesses_nm.reshape(math.prod(thicknesses_nm.shape[:-1]), thicknesses_nm.shape[-1])
        means = [self._mean(self.lit(row, from_above=not self.flipped), theta) for row in rows]
        reflected, passed = (np.stack([one[k] for one in means]).reshape(shape) for k in (0, 1))
        return reflected, passed if self.transmits else np.zeros_like(passed)

    def inside(self, thicknesses_nm: Array, in_plane: Array) -> tuple[Array, Array]:
        """Return R and T `[*params, angle, wavelength]` in the denser medium, at kx/k0 `[angle, wavelength]`."""
        rows = thicknesses_nm.reshape(math.prod(thicknesses_nm.shape[:-1]), thicknesses_nm.shape[-1])
        rare, dense = (self.n[-1], self.n[0]) if self.flipped else (self.n[0], self.n[-1])
        rare, dense = rare.real, dense.real
        in_plane = np.where(np.abs(in_plane / rare - 1.0) < BESIDE_GRAZING, rare * (1.0 + BESIDE_GRAZING), in_plane)
        theta = np.minimum(np.arcsin(np.clip(in_plane / dense, 0.0, 1.0)), MOST_THETA)
        stack_of = [self.lit(row, from_above=self.flipped) for row in rows]
        means = [self._mean(stack, theta, self._azimuths_inside) for stack in stack_of]
        shape = (*thicknesses_nm.shape[:-1], *in_plane.shape)
        return np.reshape([one[0] for one in means], shape), np.reshape([one[1] for one in means], shape)

    def _behind(self, d: Array, cos: Array, reflected: Array) -> Array:
        """Return R from inside at the conjugate angles, `[*params, cos, wavelength]`; equal to R without losses."""
        return reflected if self._absorbs_nothing else super()._behind(d, cos, reflected)

    def _beyond(self, d: Array, x: Array) -> Array:
        """Return R from inside beyond the critical angle, `[x, *params, wavelength]`; 1 without losses."""
        if self._absorbs_nothing:
            return np.ones((len(x), *d.shape[:-1], len(self.wavelengths_nm)))
        return super()._beyond(d, x)

    @property
    def cos_nodes(self) -> int:
        """Number of tabulated cosines."""
        has_spread = any(layer.helix is not None and layer.helix.deviation_nm > 0 for layer in self.stack.layers)
        return COS_NODES_SPREAD if has_spread else COS_NODES

    def lit(self, thicknesses_nm: Array, *, from_above: bool) -> Stack:
        """Return the stack with these thicknesses, seen from the light's side; from below, it is turned about u."""
        layers = [
            dataclasses.replace(e, thickness_nm=float(d))
            for e, d in zip(self.stack.layers, thicknesses_nm, strict=True)
        ]
        if from_above:
            return Stack(self.stack.ambient, layers, self.stack.substrate)
        return Stack(self.stack.ambient, layers, self._below).reversed()

    def _mean(self, stack: Stack, theta: Array, azimuths: Array | None = None) -> tuple[Array, Array]:
        """Return the means of R and T `[angle, wavelength]`."""
        chosen = self.azimuths_rad if azimuths is None else azimuths
        waves, share = self.wavelengths_nm, SLICE_SHARE
        responses = [stack.polarised(theta, waves, float(a), slice_share=share) for a in chosen]
        reflected = np.mean([one.mueller_reflected[..., 0, 0] for one in responses], axis=0)
        return reflected, np.mean([one.entering[..., 0] for one in responses], axis=0)

    def varies_visibly(self, thicknesses_nm: Array) -> bool:
        """Whether the colour of the reflected light at some azimuth differs from that of the mean by dE00 0.5."""
        if len(self.azimuths_rad) == 1:
            return False
        stack, theta = self.lit(thicknesses_nm, from_above=not self.flipped), np.arccos(PROBE_COSINES)
        azimuths = np.linspace(0.0, np.pi, PROBED_AZIMUTHS, endpoint=False)
        spectra = np.stack([self._mean(stack, theta, np.array([a]))[0] for a in azimuths])
        each, mean = (reflected_lab(r, self.wavelengths_nm) for r in (spectra, spectra.mean(axis=0)))
        return bool(np.max(delta_e_2000(each, np.broadcast_to(mean, each.shape))) > COLOUR_ERROR)

    def over_azimuth(self, thicknesses_nm: Array) -> InterfaceResponse:
        """Tabulate with the azimuth as a leading axis, as in `AlignedSpecular`.

        Uniform azimuths from 0 to 2 pi, both included, halved until the colour of the reflected light midway between
        them is exact to dE00 0.5 at a few angles, or there are `MOST_AZIMUTHS` intervals.

        Args:
            thicknesses_nm: `[layer]`.
        """
        d = np.asarray(thicknesses_nm, dtype=float)
        stack, theta = self.lit(d, from_above=not self.flipped), np.arccos(PROBE_COSINES)
        count = LEAST_AZIMUTHS
        while count < MOST_AZIMUTHS:
            at = np.linspace(0.0, np.pi, count + 1)  # nodes and the middles between them, in half a turn
            means = np.stack([self._mean(stack, theta, np.array([a]))[0] for a in at])
            between = 0.5 * (means[:-2:2] + means[2::2])
            exact, linear = (reflected_lab(r, self.wavelengths_nm) for r in (means[1::2], between))
            if float(np.max(delta_e_2000(linear, exact))) < COLOUR_ERROR:
                break
            count *= 2
        turn = count // 2 if self._is_even else count
        parts = [self._at_azimuth(a).build(d, self.cos_nodes) for a in 2.0 * np.pi * np.arange(turn) / count]
        parts = [*parts * (count // turn), parts[0]]
        names = ("reflectance", "transmittance", "reflectance_inside", "total")
        tables: dict[str, Any] = {name: np.stack([getattr(p, name) for p in parts]) for name in names}
        return dataclasses.replace(parts[0], **tables)

    def _at_azimuth(self, azimuth: float) -> AnisotropicTables:
        """Return the tables of one light azimuth outside; light from inside leaves towards it.

        A stack lit from below is turned about u, which reverses the azimuth.
        """
        one = copy.copy(self)
        one.azimuths_rad, one._azimuths_inside = np.array([azimuth]), np.array([-(azimuth + np.pi)])
        return one

    @property
    def _is_even(self) -> bool:
        """Whether opposite azimuths are equal: reflection by reciprocity, transmission then only without losses."""
        return self._absorbs_nothing or not self.transmits

    def _azimuths(self) -> Array:
        """Return uniform azimuths whose mean reflectance has converged."""
        waves = self.wavelengths_nm
        self.wavelengths_nm = waves[:: max(len(waves) // PROBE_WAVELENGTHS, 1)]
        theta, before = np.arccos(PROBE_COSINES), None
        period = np.pi if self._is_even else 2.0 * np.pi
        stack = self.lit(self.stack.thicknesses_nm, from_above=not self.flipped)
        for count in AZIMUTHS:
            azimuths = np.linspace(0.0, period, count, endpoint=False) + 0.25 * np.pi
            mean = self._mean(stack, theta, azimuths)[0]
            if before is not None and np.max(np.abs(mean - before)) < AZIMUTH_ERROR:
                break
            before, enough = mean, azimuths
        self.wavelengths_nm = waves
        return enough

    def with_error(self, thicknesses_nm: Array) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate on uniform cosines, and return the differences of R from the solution at a few angles."""
        d = np.asarray(thicknesses_nm, dtype=float)
        response = self.build(d, self.cos_nodes)
        return response, self.errors_of(response, d)

    def errors_of(self, response: InterfaceResponse, thicknesses_nm: Array) -> AngleErrors:
        """Return the errors in R of tables averaged over the azimuth, at a few angles of light from the ambient.

        Where the ambient is the denser medium, they are those at the conjugate angles in the rarer one.
        """
        exact = self.outside(np.asarray(thicknesses_nm, dtype=float), CHECKED_COSINES)[0]
        stored = response.lookup(CHECKED_COSINES, np.zeros(len(CHECKED_COSINES), dtype=bool))[0]
        theta, error = np.arccos(CHECKED_COSINES)[:, None], np.abs(stored - exact)
        if not self.flipped:
            return AngleErrors((theta, error))
        return AngleErrors((theta, error), (np.arcsin(np.sin(theta) / self.eta), error))

    def with_parameters(
        self, thicknesses_nm: Array, parameters: tuple[ParameterAxis, ...]
    ) -> tuple[InterfaceResponse, AngleErrors]:
        """Tabulate varying thicknesses; see `with_error`."""
        d = np.asarray(thicknesses_nm, dtype=float)
        middle = d[tuple(size // 2 for size in d.shape[:-1])]
        return self.build(d, self.cos_nodes, parameters), self.with_error(middle)[1]


def _is_lossless(medium: Medium, wavelengths_nm: Array) -> bool:
    return bool(np.max(np.abs(permittivity_of(medium, wavelengths_nm).imag)) < LOSSLESS_K)
