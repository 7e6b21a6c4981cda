"""The pearl material: strata of resin, flakes and dye over a base, and the lobe that follows from them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.contract import Lobe
from nacre.bsdf.layered import Layered
from nacre.bsdf.spectrum import Spectrum
from nacre.errors import NacreError, UnsupportedError
from nacre.light import default_wavelengths
from nacre.matter.indices import OpticalConstant
from nacre.matter.stratified import powers
from nacre.pearl.dye import Dye, DyeResponse, dye_response
from nacre.pearl.glints import Glints, glint_arrays
from nacre.pearl.interface import interface_loss
from nacre.pearl.medium import (
    COS_NODES,
    MAX_COS_NODES,
    TABLE_ERROR,
    FlakeNormals,
    cos_nodes,
    mean_extinction,
    optical_number,
    visible_weights,
)
from nacre.pearl.platelet import Platelet, PlateletResponse, platelet_response

Array = NDArray[np.float64]
logger = logging.getLogger("nacre")

INDEX_NM = 550.0  # directions are refracted with the index at this wavelength, for all colours alike
STEP_NM = 5.0  # wavelength step where thickness varies over the flakes and washes fringes out
BASE_NODES = 129
EDGE_ON = 0.2  # cosine between mean flake normal and surface normal below which a note is made
PLATELET_DEG = np.linspace(0.0, 90.0, 91)
NO_SPREAD = 1e-3  # a smaller deviation would be a mirror; issue's narrowest pigment has 0.01


@dataclass(frozen=True)
class Flakes:
    """One kind of flake in a stratum.

    Attributes:
        platelet: its layers.
        volume_fraction: of the stratum's volume.
        normals: distribution of the normals in the surface frame.
        diameter_um: median face diameter, for glints; without them the flakes are too small to be seen one by one.
    """

    platelet: Platelet
    volume_fraction: float
    normals: FlakeNormals
    diameter_um: float | None = None


@dataclass(frozen=True)
class Interface:
    """Roughness of an interface."""

    alpha_x: float = 0.0
    alpha_y: float = 0.0
    distribution: str = "ggx"
    compensate: bool = False


@dataclass(frozen=True)
class Stratum:
    """A layer of resin with what is in it; `surface` is its upper interface."""

    resin: OpticalConstant
    thickness_nm: float
    surface: Interface = Interface()
    flakes: tuple[Flakes, ...] = ()
    dye: Dye | None = None


@dataclass(frozen=True)
class Base:
    """What lies below.

    Attributes:
        kind: "none", "diffuse", "specular" or "lobes".
        albedo: of a diffuse base: a number, or (wavelengths_nm, albedo) of a coloured one.
        metal: material of a specular base.
        film: a solved opaque film as base: (wavelengths_nm, cos, reflectance[cos, wavelength]).
        surface: roughness of a specular base, or of the lower face of an open stack.
        other: of "lobes", an opaque material of any family, built with the last resin as its ambient.
        refuse: makes the error of an `other` that cannot serve, from the reason.
    """

    kind: str = "diffuse"
    albedo: float | tuple[Array, Array] = 0.0
    metal: OpticalConstant | None = None
    film: tuple[Array, Array, Array] | None = None
    surface: Interface = Interface()
    other: Any = None
    refuse: Callable[[str], NacreError] = UnsupportedError

    @cached_property
    def default_lobes(self) -> tuple[Lobe, ...]:
        """The other material's lobes on wavelengths of its own choice."""
        return self.lobes(None)

    def lobes(self, wavelengths_nm: Array | None) -> tuple[Lobe, ...]:
        """Return the other material's lobes at given wavelengths.

        Raises:
            NacreError: it lets light through, or is a random walk itself.
        """
        if self.other is None:
            return ()
        lobes: tuple[Lobe, ...] = self.other.bsdf(wavelengths_nm).lobes
        if any(_is_pearl(lobe) for lobe in lobes):
            raise self.refuse("holds a pearl; a pearl cannot be a base: write its strata below these ones instead")
        if any(lobe.transmits for lobe in lobes):
            raise self.refuse("lets light through; a base should be opaque, on a metal or with a base of its own")
        return lobes


@dataclass(frozen=True)
class Pearl:
    """Strata from the light's side inward, and the base.

    Attributes:
        strata, base: see there.
        quality: "reference", the walk, or "fast", noise-free tables of it where they can be made.
        glints: flakes of the uppermost stratum seen one by one, or None.
    """

    strata: tuple[Stratum, ...]
    base: Base
    quality: str = "reference"
    glints: Glints | None = None

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid: 5 nm, finer where flakes of one thickness are thick enough to need it."""
        fixed = [
            flakes.platelet.optical_height_nm(INDEX_NM)
            for stratum in self.strata
            for flakes in stratum.flakes
            if flakes.platelet.thickness.is_fixed
        ]
        grid = default_wavelengths(max(fixed, default=0.0))
        grid = grid if grid[1] - grid[0] <= STEP_NM else default_wavelengths(step_nm=STEP_NM)
        if self.base.other is None:
            return grid
        # a base that is known in less than the whole range, such as a measurement, sets the ends
        known = self.base.default_lobes[0].wavelengths_nm
        low, high = max(float(known[0]), grid[0]), min(float(known[-1]), grid[-1])
        return np.concatenate([[low], grid[(grid > low + 1e-6) & (grid < high - 1e-6)], [high]])

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on settings that work but may surprise."""
        found = []
        for i, stratum in enumerate(self.strata):
            kinds = len(stratum.flakes)
            if kinds > 8:
                found.append(f"strata[{i}]: {kinds} kinds of platelets work, but rendering gets slower with each")
            for j, flakes in enumerate(stratum.flakes):
                if flakes.diameter_um is not None and (self.glints is None or i > 0):
                    found.append(f"strata[{i}].platelets[{j}]: diameter_um has no effect without glints")
                if abs(flakes.normals.frame[2, 2]) < EDGE_ON:
                    found.append(f"strata[{i}].platelets[{j}]: the rotation turns the flakes nearly edge-on")
        return tuple(found)

    def platelet_tables(self, wavelengths_nm: Array) -> Array:
        """R and T of all kinds, `[kind, cos, wavelength, 2]`, over nodes uniform in sqrt(cos)."""
        kinds = [(stratum, flakes) for stratum in self.strata for flakes in stratum.flakes]
        count = COS_NODES
        responses = [_response(stratum, flakes, count, wavelengths_nm) for stratum, flakes in kinds]
        coarse = wavelengths_nm[:: max(1, len(wavelengths_nm) // 8)]
        while count < MAX_COS_NODES and any(_table_error(s, f, count, coarse) > TABLE_ERROR for s, f in kinds):
            count = 2 * (count - 1) + 1
            responses = [_response(stratum, flakes, count, wavelengths_nm) for stratum, flakes in kinds]
        tables = [np.stack(response.unpolarised(), axis=-1) for response in responses]
        return np.clip(np.stack(tables), 0.0, 1.0) if tables else np.zeros((0, 2, len(wavelengths_nm), 2))

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve platelets, media and interfaces into one layered lobe, and bake it if `quality` is "fast".

        Args:
            wavelengths_nm: `[wavelength]`, ascending; default: `self.wavelengths_nm`.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        response = self.platelet_tables(lam)
        kinds = [(i, stratum, flakes) for i, stratum in enumerate(self.strata) for flakes in stratum.flakes]
        extinctions = []
        for (_, _, flakes), table in zip(kinds, response, strict=True):
            weights = visible_weights(flakes.normals, table.shape[0])
            extinctions.append(mean_extinction(weights, table[..., 1]))
        extinctions = _same_azimuths(extinctions)
        interfaces = [stratum.surface for stratum in self.strata] + [self.base.surface]
        alpha = np.array([[face.alpha_x, face.alpha_y] for face in interfaces])
        index = np.array([_index(stratum.resin, i) for i, stratum in enumerate(self.strata)])
        dye, phase, quantile = self._dyes(lam)
        lobe = Layered(
            wavelengths_nm=lam,
            index=index,
            alpha=alpha,
            is_beckmann=np.array([face.distribution == "beckmann" for face in interfaces], dtype=np.int64),
            flake_stratum=np.array([i for i, _, _ in kinds], dtype=np.int64),
            flake_number=np.array(
                [optical_number(f.volume_fraction, s.thickness_nm, f.platelet.height_nm) for _, s, f in kinds]
            ),
            flake_axes=np.array([f.normals.axes for _, _, f in kinds]).reshape(-1, 3),
            flake_frame=np.array([f.normals.frame for _, _, f in kinds]).reshape(-1, 3, 3),
            flake_response=response,
            flake_extinction=np.stack(extinctions) if extinctions else np.zeros((0, 1, 2, len(lam))),
            base=self.base.kind,
            base_reflectance=self._base_table(lam),
            loss=self._loss(interfaces, index),
            dye=dye,
            dye_phase=phase,
            dye_quantile=quantile,
            base_lobes=self.base.default_lobes if wavelengths_nm is None else self.base.lobes(lam),
        )
        if self.glints is not None:
            lobe = self._with_glints(lobe)
        lobe.check()
        notes = list(self.notes)
        found: Lobe = lobe
        if self.quality == "fast":
            from nacre.pearl.fast import bake, obstacle

            reason = obstacle(lobe)
            if reason is None:
                found = baked = bake(lobe)
                notes.append(
                    f"fast route: error {100 * baked.error.mean():.2f} % on average over wavelengths, at most "
                    f"{100 * baked.error.max():.2f} % (L2 of f cos, three incidences, against the walk)"
                )
                logger.info("%s", notes[-1])
            else:
                notes.append(f"fast route: not made, since {reason}; this is the reference")
                logger.warning("the fast route cannot be made, since %s; the reference is used", reason)
        return Bsdf((found,), {"notes": notes} if notes else {})

    def _with_glints(self, lobe: Layered) -> Layered:
        assert self.glints is not None
        upper = lobe.flake_stratum == 0
        # met along the normal, averaged over wavelengths
        extinct = lobe.flake_extinction[upper, 0, -1].mean(axis=-1)
        numbers, radii, ratio = glint_arrays(
            self.glints, self.strata[0], float(lobe.index[0]), lobe.flake_number[upper], extinct
        )
        return replace(lobe, glint_numbers=numbers, glint_radii=radii, glint_ratio=ratio)

    def _dyes(self, lam: Array) -> tuple[Array | None, Array | None, Array | None]:
        """Extinction of dye and resin, and the dye's phase function, all `[stratum, ...]`."""
        responses: list[DyeResponse] = []
        for stratum in self.strata:
            n = stratum.resin.n_complex(lam)
            absorbed = 4 * np.pi * n.imag * stratum.thickness_nm / lam
            found = DyeResponse(absorbed, np.zeros(len(lam)))
            if stratum.dye is not None:
                dye = dye_response(stratum.dye, n.real, stratum.thickness_nm, lam)
                found = DyeResponse(absorbed + dye.extinction, dye.scattering, dye.phase, dye.quantile)
            responses.append(found)
        if not any(np.any(r.extinction > 0) for r in responses):
            return None, None, None
        table = np.stack([np.stack([r.extinction, r.scattering], axis=-1) for r in responses])
        model = next((r for r in responses if r.phase is not None), None)
        if model is None or model.phase is None or model.quantile is None:
            return table, None, None
        # a stratum without scattering dye needs rows of its own; isotropic ones are never used
        isotropic = np.full_like(model.phase, 0.25 / np.pi)
        flat = np.repeat(np.linspace(-1, 1, len(model.quantile))[:, None], len(lam), axis=1)
        phase = np.stack([isotropic if r.phase is None else r.phase for r in responses])
        quantile = np.stack([flat if r.quantile is None else r.quantile for r in responses])
        return table, phase, quantile

    def _base_table(self, lam: Array) -> Array:
        base = self.base
        if base.kind in ("none", "lobes"):
            return np.zeros((1, len(lam)))
        if base.kind == "diffuse":
            if isinstance(base.albedo, tuple):
                return np.interp(lam, *base.albedo)[None]
            return np.full((1, len(lam)), float(base.albedo))
        cos = np.linspace(0.0, 1.0, BASE_NODES)
        if base.film is not None:
            wavelengths, nodes, reflectance = base.film
            rows = np.stack([np.interp(lam, wavelengths, row) for row in reflectance])
            return np.stack([np.interp(cos, nodes, rows[:, i]) for i in range(len(lam))], axis=1)
        assert base.metal is not None
        resin = self.strata[-1].resin.n_complex(lam).real + 0j
        n = np.stack([resin, base.metal.n_complex(lam)])
        return powers(n, np.zeros(0), lam, cos_i=cos).reflectance

    def _loss(self, interfaces: list[Interface], index: Array) -> Array | None:
        if not any(face.compensate for face in interfaces):
            return None
        n = np.concatenate([[1.0], index, [1.0]])
        bottom = self.base.kind == "none"
        tables = []
        for i, face in enumerate(interfaces):
            wanted = face.compensate and face.alpha_x > 0 and (i < len(index) or bottom)
            tables.append(interface_loss(face, float(n[i]), float(n[i + 1])) if wanted else np.zeros((2, 65)))
        return np.stack(tables)

    def spectrum(self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0) -> Spectrum:
        """Reflectance and transmittance of the whole, from the walk; another `seed` gives independent noise.

        Raises:
            UnsupportedError: s or p light (the walk carries unpolarised light), or no LLVM for the walk.
        """
        if polarisation != "both":
            raise UnsupportedError("a pearl scatters light many times and is known for unpolarised light only")
        from nacre.bsdf.hemisphere import bsdf_spectrum

        return bsdf_spectrum(self.bsdf(wavelengths_nm), theta_rad, seed=seed)

    def figure_data(self, kind: str, **options: Any) -> dict[str, NDArray[Any]]:
        """Arrays of a figure: "platelet" gives R and T of each kind of flake in its resin.

        Args:
            kind: "platelet".
            options: `angles_deg` in the resin (default 0 to 90), `wavelengths_nm` (default: the material's).

        Returns:
            `wavelengths_nm[wavelength]`, `angles_deg[angle]` in the resin, `reflectance[kind, angle, wavelength]`,
            `transmittance[...]`, `names[kind]`.

        Raises:
            UnsupportedError: another kind.
        """
        if kind != "platelet":
            raise UnsupportedError(f'a pearl has no figure of kind "{kind}" of its own; it has "platelet"')
        lam = np.asarray(options.get("wavelengths_nm", self.wavelengths_nm), dtype=float)
        angles = np.atleast_1d(np.asarray(options.get("angles_deg", PLATELET_DEG), dtype=float))
        cos = np.where(angles == 90.0, 0.0, np.cos(np.deg2rad(angles)))
        reflect, transmit, names = [], [], []
        for i, stratum in enumerate(self.strata):
            for j, flakes in enumerate(stratum.flakes):
                found = platelet_response(flakes.platelet, stratum.resin.n_complex(lam).real, cos, lam).unpolarised()
                reflect.append(found[0])
                transmit.append(found[1])
                names.append(f"strata[{i}].platelets[{j}]")
        empty = np.zeros((0, len(angles), len(lam)))
        return {
            "wavelengths_nm": lam,
            "angles_deg": angles,
            "reflectance": np.stack(reflect) if reflect else empty,
            "transmittance": np.stack(transmit) if transmit else empty,
            "names": np.array(names),
        }


def _is_pearl(lobe: Lobe) -> bool:
    """Tell whether a lobe is a pearl's, masked or not."""
    inner = getattr(lobe, "inner", None)
    return lobe.kind in ("layered", "flaked") or (inner is not None and _is_pearl(inner))


def _index(resin: OpticalConstant, stratum: int) -> float:
    found = float(resin.n_complex(np.array([INDEX_NM]))[0].real)
    if found < 1:  # a metal, or a slip: light is not followed in what is thinner than the air around
        raise NacreError(
            f"strata[{stratum}].resin has an index of {found:.4g} at {INDEX_NM:g} nm; it must be at least 1"
        )
    return found


def _response(stratum: Stratum, flakes: Flakes, count: int, lam: Array) -> PlateletResponse:
    return platelet_response(flakes.platelet, stratum.resin.n_complex(lam).real, cos_nodes(count), lam)


def _table_error(stratum: Stratum, flakes: Flakes, count: int, lam: Array) -> float:
    """Largest error of linear interpolation half way between nodes, weighted by cos: what a ray meets."""
    fine = cos_nodes(2 * count - 1)
    n = stratum.resin.n_complex(lam).real
    reflect, _ = platelet_response(flakes.platelet, n, fine, lam).unpolarised()
    middle = (reflect[:-2:2] + reflect[2::2]) / 2
    return float(np.max(np.abs(middle - reflect[1::2]) * fine[1::2, None]))


def _same_azimuths(tables: list[Array]) -> list[Array]:
    """Give all kinds the same number of azimuths, so that they stack."""
    most = max((len(table) for table in tables), default=1)
    return [np.repeat(table, most, axis=0) if len(table) == 1 and most > 1 else table for table in tables]
