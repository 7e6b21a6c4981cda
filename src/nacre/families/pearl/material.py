"""The pearl material: strata of resin, platelets and dye over a base, and the layered lobe that follows."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.compensation import interface_losses
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.substrate import Substrate
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError
from nacre.families.contract import EnergyDefect, Figure, Model, ResolvedFlakes, Strata, Surrogate, Traits
from nacre.families.pearl.doubling import NARROWEST, RELATIVE_ERROR
from nacre.families.pearl.flake_texture import FlakeTexture, Glints, glint_arrays
from nacre.families.pearl.platelet import (
    COS_NODES,
    MAX_COS_NODES,
    PUBLISHED,
    TABLE_ERROR,
    PlateletResponse,
    cos_nodes,
    mean_extinction,
    optical_number,
    platelet_response,
    visible_weights,
)
from nacre.families.pearl.random_walk import energy_defect
from nacre.families.pearl.strata import DyeResponse, Flakes, Stratum, dye_response
from nacre.families.pearl.surrogate import BASE_LOBES_ALBEDO, PearlSurrogate
from nacre.families.pearl.tables import bake, largest_power_error
from nacre.light import default_wavelengths
from nacre.matter.indices.constant import OpticalConstant

logger = logging.getLogger("nacre")

INDEX_NM = 550.0  # all wavelengths are refracted with the index at this one
STEP_NM = 5.0  # wavelength step for platelets with varying thickness, whose fringes average out
EDGE_ON = 0.2  # cosine between mean platelet normal and surface normal below which a note is made
PLATELET_DEG = np.linspace(0.0, 90.0, 91)
TABLES, SURROGATE, ESTIMATE, DEFECT = "tables", "surrogate", "estimate", "energy defect"
MIN_DEVIATION = 1e-3  # smaller normal deviations would be a mirror; the narrowest pigment so far has 0.01


@dataclass(frozen=True)
class Pearl(Model, Strata, Surrogate, EnergyDefect, ResolvedFlakes):
    """Strata from the light inward, and the base.

    Attributes:
        strata, base: resin layers, and the base below.
        quality: "reference", the random walk, or "fast", noise-free tables if they apply.
        glints: resolved platelets in the uppermost stratum.
    """

    traits = Traits(
        noun="pearl",
        unpolarised_reason="scatters light many times and is known for unpolarised light only",
        default_geometry="45as15",  # the interface's specular reflection is colourless
    )

    strata: tuple[Stratum, ...]
    base: Substrate
    quality: str = "reference"
    glints: Glints | None = None

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid: 5 nm, finer for thick platelets with one thickness."""
        fixed = [
            flakes.platelet.optical_height_nm(INDEX_NM)
            for stratum in self.strata
            for flakes in stratum.flakes
            if flakes.platelet.thickness.is_fixed
        ]
        grid = default_wavelengths(max(fixed, default=0.0))
        grid = grid if grid[1] - grid[0] <= STEP_NM else default_wavelengths(step_nm=STEP_NM)
        return self.base.known_in(grid)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on valid settings with surprising effects."""
        notes = []
        for i, stratum in enumerate(self.strata):
            kinds = len(stratum.kinds)
            if kinds > 8:
                notes.append(f"strata[{i}]: {kinds} types of platelets work, but each slows rendering down")
            for j, flakes in enumerate(stratum.flakes):
                if flakes.diameter_um is not None and (self.glints is None or i > 0):
                    notes.append(f"strata[{i}].platelets[{j}]: diameter_um has no effect on pictures without glints")
                if abs(flakes.normals.frame[2, 2]) < EDGE_ON:
                    notes.append(f"strata[{i}].platelets[{j}]: the rotation turns the platelets nearly edge-on")
        return tuple(notes)

    def platelet_tables(self, wavelengths_nm: Array) -> Array:
        """R and T for all distinct pigments, `[kind, cos, wavelength, 2]`, on uniform sqrt(cos) nodes."""
        kinds = [(stratum, flakes) for stratum in self.strata for flakes in stratum.kinds]
        count = COS_NODES
        responses = [_response(stratum, flakes, count, wavelengths_nm) for stratum, flakes in kinds]
        coarse = wavelengths_nm[:: max(1, len(wavelengths_nm) // 8)]
        while count < MAX_COS_NODES and any(_table_error(s, f, count, coarse) > TABLE_ERROR for s, f in kinds):
            count = 2 * (count - 1) + 1
            responses = [_response(stratum, flakes, count, wavelengths_nm) for stratum, flakes in kinds]
        tables = [np.stack(response.unpolarised(), axis=-1) for response in responses]
        return np.clip(np.stack(tables), 0.0, 1.0) if tables else np.zeros((0, 2, len(wavelengths_nm), 2))

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve platelets, media and interfaces into one layered lobe, and tabulate it if `quality` is "fast".

        Args:
            wavelengths_nm: `[wavelength]`, ascending; default: `self.wavelengths_nm`.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
        """
        lobe = self._layered(wavelengths_nm)
        notes = list(self.notes)
        stated: dict[str, Any] = {}
        compiled: Lobe = lobe
        if self.quality == "fast":
            reason = self.inapplicable_reason(TABLES)
            if reason is None:
                compiled = baked = bake(lobe)
                error = largest_power_error(lobe, baked)
                stated = {"angle_table": {"angles": baked.flakes.shape[1], "largest_error": round(error, 6)}}
                notes.append(
                    f"noise-free form: error {100 * baked.error.mean():.2f} % on average over wavelengths, at most "
                    f"{100 * baked.error.max():.2f} % (L2 of f cos, three incidences, against the walk)"
                )
                logger.info("%s", notes[-1])
            else:
                notes.append(f'quality = "fast" was not possible, since {reason}; this is "reference"')
                logger.warning('quality = "fast" is not possible, since %s; "reference" is used', reason)
        return Bsdf((compiled,), {"notes": notes, **stated} if notes else {})

    def inapplicable_reason(self, method: str) -> str | None:
        """Return why a method does not apply to this pearl, or None.

        Args:
            method: TABLES, for `quality = "fast"`; SURROGATE; ESTIMATE, the surrogate's random walk; or DEFECT, the
                walk in `energy_defect`.
        """
        first = self.strata[0]
        faces = [first.surface, *([self.base.surface] if method == DEFECT else [])]
        normals = [] if method == DEFECT else [flakes.normals for flakes in first.flakes]
        is_random_walk = method != SURROGATE
        reasons = {
            "it has several strata": len(self.strata) > 1,
            "its base is not a diffuse one": method in (TABLES, ESTIMATE) and self.base.kind != "diffuse",
            "its base is another material": method == DEFECT and self.base.kind in ("lobes", "strata"),
            "its dye scatters": is_random_walk and first.dye is not None and first.dye.radius is not None,
            "its interface is compensated": is_random_walk and any(f.compensate and not f.is_smooth for f in faces),
            "its interface is anisotropic": any(face.alpha_x != face.alpha_y for face in faces),
            "its interface is of the Beckmann kind": any(f.alpha_x > 0 and f.distribution != "ggx" for f in faces),
            "its flakes are anisotropic": any(not each.is_isotropic for each in normals),
            "its flakes are rotated": any(abs(each.frame[2, 2]) <= 1.0 - 1e-12 for each in normals),
            "its resin has the index of the ambient": method != DEFECT and _index(first.resin, 0) <= 1.0,
        }
        return next((reason for reason, applies in reasons.items() if applies), None)

    def energy_defect(self, theta_rad: Array, wavelengths_nm: Array, seed: int = 0) -> Array | None:
        """Return the light share lost by the "published" energy balance, `[angle, wavelength]`, if a pigment uses it.

        A warning states the reason if the loss cannot be computed.
        """
        published = np.array([f.platelet.energy_balance == PUBLISHED for s in self.strata for f in s.kinds], dtype=bool)
        if not published.any():
            return None
        reason = self.inapplicable_reason(DEFECT)
        if reason is not None:
            logger.warning("the loss of the published energy balance is not known for this pearl, since %s", reason)
            return None
        lobe = self._layered(np.asarray(wavelengths_nm, dtype=float))
        return np.stack([energy_defect(lobe, published, direction(float(t)), seed=seed) for t in theta_rad])

    def _layered(self, wavelengths_nm: Array | None) -> Layered:
        """Return the layered lobe, with glints."""
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        response = self.platelet_tables(lam)
        kinds = [(i, stratum, flakes) for i, stratum in enumerate(self.strata) for flakes in stratum.kinds]
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
            base=self.base.walk_kind,
            base_reflectance=self._base_table(lam),
            loss=interface_losses(interfaces, index, self.base.walk_kind == "none"),
            dye=dye,
            dye_phase=phase,
            dye_quantile=quantile,
            base_lobes=self.base.default_lobes if wavelengths_nm is None else self.base.lobes(lam),
        )
        if self.glints is not None:
            lobe = self._with_glints(lobe)
        lobe.check()
        return self.base.continued(lobe)

    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the layered lobe, at any quality."""
        return self._layered(wavelengths_nm)

    def single_flakes(self, wavelengths_nm: Array, weights: Array) -> FlakeTexture:
        """Return the individual flakes, for sparkle and graininess."""
        return FlakeTexture(self.strata, self.glints, wavelengths_nm, weights)

    @property
    def over_black(self) -> Pearl:
        """The same strata over a black base, without glints, which do not change the mean."""
        return replace(self, base=Substrate(albedo=0.0), glints=None)

    def surrogate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
    ) -> tuple[Array, Array] | None:
        """Return first-order reflection, and the rest by two streams (`surrogate`) or by `doubling`."""
        if self.inapplicable_reason(SURROGATE) is not None:
            return None
        return self._surrogate(wavelengths_nm).radiance(wi, wo, is_fine)

    @property
    def surrogate_error(self) -> float | None:
        """Error of `doubling` from rough interfaces and angular steps."""
        is_known = self._is_estimated and all(kind.normals.deviation[0] >= NARROWEST for kind in self.strata[0].kinds)
        return RELATIVE_ERROR if is_known else None

    def estimate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, walks: int, seed: int
    ) -> tuple[Array, Array] | None:
        """Return the BRDF and its standard error by next-event estimation towards all viewers at once."""
        return self._surrogate(wavelengths_nm).estimate(wi, wo, walks, seed) if self._is_estimated else None

    @property
    def _is_estimated(self) -> bool:
        return (self.inapplicable_reason(SURROGATE) or self.inapplicable_reason(ESTIMATE)) is None

    def _surrogate(self, lam: Array) -> PearlSurrogate:
        dye = self._dyes(lam)[0]
        if self.base.kind in ("lobes", "strata"):
            albedo = np.full(len(lam), BASE_LOBES_ALBEDO)
        else:
            albedo = np.ascontiguousarray(self._base_table(lam).mean(axis=0))
        absorb = np.zeros(0) if dye is None else np.ascontiguousarray(dye[0, :, 0])
        return PearlSurrogate(self.strata[0], _index(self.strata[0].resin, 0), lam, absorb, albedo)

    def _with_glints(self, lobe: Layered) -> Layered:
        assert self.glints is not None
        upper = lobe.flake_stratum == 0
        # along the normal, averaged over wavelengths
        extinct = lobe.flake_extinction[upper, 0, -1].mean(axis=-1)
        numbers, radii, ratio = glint_arrays(
            self.glints, self.strata[0], float(lobe.index[0]), lobe.flake_number[upper], extinct
        )
        return replace(lobe, glint_numbers=numbers, glint_radii=radii, glint_ratio=ratio)

    def _dyes(self, lam: Array) -> tuple[Array | None, Array | None, Array | None]:
        """Return the extinction by dye and resin, and the dye's phase function, all `[stratum, ...]`."""
        responses: list[DyeResponse] = []
        for stratum in self.strata:
            n = stratum.resin.n_complex(lam)
            absorbed = 4 * np.pi * n.imag * stratum.thickness_nm / lam
            response = DyeResponse(absorbed, np.zeros(len(lam)))
            if stratum.dye is not None:
                dye = dye_response(stratum.dye, n.real, stratum.thickness_nm, lam)
                response = DyeResponse(absorbed + dye.extinction, dye.scattering, dye.phase, dye.quantile)
            responses.append(response)
        if not any(np.any(r.extinction > 0) for r in responses):
            return None, None, None
        table = np.stack([np.stack([r.extinction, r.scattering], axis=-1) for r in responses])
        model = next((r for r in responses if r.phase is not None), None)
        if model is None or model.phase is None or model.quantile is None:
            return table, None, None
        # strata without scattering dye get isotropic rows, which are never used
        isotropic = np.full_like(model.phase, 0.25 / np.pi)
        flat = np.repeat(np.linspace(-1, 1, len(model.quantile))[:, None], len(lam), axis=1)
        phase = np.stack([isotropic if r.phase is None else r.phase for r in responses])
        quantile = np.stack([flat if r.quantile is None else r.quantile for r in responses])
        return table, phase, quantile

    def _base_table(self, lam: Array) -> Array:
        return self.base.reflectance(lam, self.strata[-1].resin.n_complex)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """R and T for each pigment in its resin: "platelet"."""
        return {"platelet": self._platelets}

    def _platelets(
        self, wavelengths_nm: Array | None = None, angles_deg: Array = PLATELET_DEG
    ) -> dict[str, NDArray[Any]]:
        """Return R and T for each pigment.

        Args:
            wavelengths_nm: default: the material's.
            angles_deg: in the resin.

        Returns:
            `wavelengths_nm[wavelength]`, `angles_deg[angle]` in the resin, `reflectance[kind, angle, wavelength]`,
            `transmittance[...]`, `names[kind]`.
        """
        lam = np.asarray(self.wavelengths_nm if wavelengths_nm is None else wavelengths_nm, dtype=float)
        angles = np.atleast_1d(np.asarray(angles_deg, dtype=float))
        cos = np.where(angles == 90.0, 0.0, np.cos(np.deg2rad(angles)))
        reflect, transmit, names = [], [], []
        for i, stratum in enumerate(self.strata):
            for j, flakes in enumerate(stratum.flakes):
                response = platelet_response(flakes.platelet, stratum.resin.n_complex(lam).real, cos, lam).unpolarised()
                reflect.append(response[0])
                transmit.append(response[1])
                names.append(f"strata[{i}].platelets[{j}]")
        empty = np.zeros((0, len(angles), len(lam)))
        return {
            "wavelengths_nm": lam,
            "angles_deg": angles,
            "reflectance": np.stack(reflect) if reflect else empty,
            "transmittance": np.stack(transmit) if transmit else empty,
            "names": np.array(names),
        }


def _index(resin: OpticalConstant, stratum: int) -> float:
    index = float(resin.n_complex(np.array([INDEX_NM]))[0].real)
    if index < 1:  # a metal, or a mistake
        raise NacreError(
            f"strata[{stratum}].resin has an index of {index:.4g} at {INDEX_NM:g} nm; it must be at least 1"
        )
    return index


def _response(stratum: Stratum, flakes: Flakes, count: int, lam: Array) -> PlateletResponse:
    return platelet_response(flakes.platelet, stratum.resin.n_complex(lam).real, cos_nodes(count), lam)


def _table_error(stratum: Stratum, flakes: Flakes, count: int, lam: Array) -> float:
    """Return the largest interpolation error midway between nodes, weighted by the projected area."""
    fine = cos_nodes(2 * count - 1)
    n = stratum.resin.n_complex(lam).real
    reflect, _ = platelet_response(flakes.platelet, n, fine, lam).unpolarised()
    middle = (reflect[:-2:2] + reflect[2::2]) / 2
    return float(np.max(np.abs(middle - reflect[1::2]) * fine[1::2, None]))


def _same_azimuths(tables: list[Array]) -> list[Array]:
    """Give all tables equally many azimuths."""
    most = max((len(table) for table in tables), default=1)
    return [np.repeat(table, most, axis=0) if len(table) == 1 and most > 1 else table for table in tables]
