"""The recipe of a relief."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from nacre.core.errors import RecipeError
from nacre.families.relief.diffraction_orders import CoherenceSpec
from nacre.families.relief.height_file import MAX_HEIGHT_UM, HeightOptions, scan_of, tile_of
from nacre.families.relief.material import Relief
from nacre.families.relief.structures import MAX_PERIOD_NM
from nacre.families.relief.vector import VectorRelief
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.periodic.structure import MAX_UNKNOWNS
from nacre.recipe.model import Positive, RecipeContext, RecipeModel

AUTO_UNKNOWNS = 800  # unknowns of blocks up to which `auto` chooses vector optics: some seconds per direction


class ReliefModelSpec(RecipeModel):
    """Theory of diffraction."""

    forms: ClassVar[tuple[str, ...]] = ('{optics = "vector"}', '{optics = "auto"}')

    optics: Literal["scalar", "vector", "auto"] = Field(
        default="scalar",
        description="scalar diffraction; Maxwell's equations, for heights that vary along one axis and for few blocks "
        "with vertical walls; or the latter where scalar theory is not valid",
    )
    tolerance: Annotated[float, Field(ge=1e-6, le=0.1)] | None = Field(
        default=None,
        description="for vector optics: largest estimated error of an order's efficiency; default: 2e-4, of narrow "
        "walls 1e-3, of blocks 4e-3",
        examples=[1e-3],
    )


class ReliefSpec(RecipeModel):
    """A height map with an opaque coating: a periodic tile, or the scan of an instrument.

    `heights` is a .npy array `[x, y]` in um, a grey image (row = x) with heights from 0 (black) to `height_scale_um`
    (white), or a file of a profilometer or scanning probe microscope (x along its rows, y upward). Files of
    instruments are scans, not periods: the mean over coherence windows describes them.
    """

    example: ClassVar[Mapping[str, Any]] = {
        "family": "relief",
        "heights": "heights.npy",
        "feature_um": 2,
        "blur_um": 0.6,
        "coherence": {"sigma": 5},
    }

    family: Literal["relief"] = Field(default="relief", description="the family's name")
    heights: str = Field(
        description="the heights: a .npy array [x, y] in um, a grey image (row = x), or the scan of an instrument",
        examples=["heights.npy", "heights.png", "scan.sdf"],
    )
    height_scale_um: Annotated[float, Field(gt=0.0, le=MAX_HEIGHT_UM)] | None = Field(
        default=None, description="height of white over black in an image; required for images", examples=[0.5]
    )
    feature_um: Positive | None = Field(
        default=None,
        description="side of one square feature, a pixel of the heights; required unless the file states its pitch",
        examples=[2],
    )
    blur_um: Positive | None = Field(
        default=None,
        description="standard deviation of the Gaussian blur of the process; required unless the heights are a scan",
        examples=[0.6],
    )
    periodic: bool | None = Field(
        default=None,
        description="whether the heights are one period, with sharp features, or a scan; default: files of "
        "instruments, heights that are not square and heights that do not close at their edges are scans",
    )
    level: Literal["plane", "none"] | None = Field(
        default=None,
        description="for a scan: remove the least-squares plane, or keep it; default: remove that of an "
        "instrument's file",
    )
    statistics: Literal["scan", "random", "isotropic"] | None = Field(
        default=None,
        description="for a scan: diffraction by the scan itself, or by random heights with its power spectral density, "
        "also averaged over azimuth; default: by its heights and autocovariance",
    )
    height_unit: Literal["nm", "um", "mm", "m"] | None = Field(
        default=None, description="unit of the heights, if the file states none; a .npy array is in um by default"
    )
    channel: str | None = Field(default=None, description="channel of a file with several", examples=["Height"])
    coating: IndexSpec = Field(
        default_factory=lambda: IndexSpec.model_validate("Al"), description="opaque metal of the surface"
    )
    prefactor: Literal["kirchhoff", "published"] = Field(
        default="kirchhoff",
        description="prefactor of the diffraction integral: the one that conserves energy, or the one as published",
    )
    coherence: CoherenceSpec = Field(
        description="coherence of the light, given by the angular size of the light source"
    )
    accuracy: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        default=3e-3, description="accuracy of the interpolation in the third component of wi + wo"
    )
    bounded: bool = Field(
        default=True, description="limit strong reliefs to the coating's reflectance at grazing light"
    )

    model: ReliefModelSpec = Field(default=ReliefModelSpec(), description="theory of diffraction")

    def build(self, context: RecipeContext) -> Relief | VectorRelief:
        """Read the heights and return the material.

        Raises:
            RecipeError: the heights are unusable, or unsuitable for the requested theory.
        """
        options = HeightOptions(
            self.heights, self.feature_um, self.blur_um, self.height_scale_um, self.periodic, self.level,
            self.statistics, self.height_unit, self.channel,
        )  # fmt: skip
        heights = options.read(context)
        if heights.is_periodic:
            for key in ("level", "statistics"):
                if getattr(self, key) is not None:
                    raise RecipeError(f"{context.source}: {key} is of a scan; the heights are one period")
        surface = tile_of(heights, options, context) if heights.is_periodic else scan_of(heights, options, context)
        scalar = Relief(
            surface, self.coherence.build(), self.coating.build(context), self.prefactor, self.accuracy, self.bounded,
            context.ambient,
        )  # fmt: skip
        return self._with_optics(scalar, context)

    def _with_optics(self, scalar: Relief, context: RecipeContext) -> Relief | VectorRelief:
        if self.model.optics == "scalar":
            if self.model.tolerance is not None:
                raise context.fail("model.tolerance", self.model.tolerance, 'is of model.optics = "vector"; remove it')
            return scalar
        pattern = scalar.pattern
        is_auto = self.model.optics == "auto"
        obstacle = scalar.vector_obstacle(AUTO_UNKNOWNS if is_auto else MAX_UNKNOWNS)
        if is_auto:
            if pattern is None or obstacle:
                return replace(scalar, remark=f'optics = "scalar": {obstacle}')
            if not scalar.validity.is_outside:
                return replace(scalar, remark='optics = "scalar": it is valid for this relief')
            reason = f'optics = "vector": scalar diffraction is not valid for these {pattern.noun}'
            return VectorRelief(scalar, pattern, self.model.tolerance, reason)
        if pattern is None or obstacle:
            raise context.fail(
                "model.optics", "vector", f"does not fit: {obstacle}; allowed: a period of heights that vary along "
                f"one axis, up to {MAX_PERIOD_NM / 1e3:g} um, few blocks with vertical walls, or scalar",
            )  # fmt: skip
        for key in ("prefactor", "bounded", "accuracy"):
            if key in self.model_fields_set:
                raise context.fail(key, getattr(self, key), 'is of scalar theory; remove it or model.optics = "vector"')
        return VectorRelief(scalar, pattern, self.model.tolerance)
