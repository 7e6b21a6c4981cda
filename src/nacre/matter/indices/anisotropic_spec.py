"""Recipe form of an anisotropic medium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import pydantic
from pydantic import Field

from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

OF_AXES = ("axis_polar_deg", "axis_azimuth_deg")


class AnisotropicSpec(RecipeModel):
    """An anisotropic medium: three principal indices with Euler angles, or a uniaxial one with its optic axis.

    The principal axes are the columns of Rz(a) Rx(b) Rz(c) for `euler_deg = [a, b, c]`; x lies along u, y along v, z
    along the outward normal.
    """

    noun: ClassVar[str] = "anisotropic medium"
    one_of: ClassVar[tuple[str, ...]] = ("principal", "ordinary")

    principal: tuple[IndexSpec, ...] | None = Field(
        default=None,
        min_length=3,
        max_length=3,
        description="the three principal optical constants",
        examples=[[1.51, 1.55, 1.66]],
    )
    euler_deg: tuple[float, ...] = Field(
        default=(0.0, 0.0, 0.0),
        min_length=3,
        max_length=3,
        description="Euler angles a, b, c of the principal axes, the columns of Rz(a) Rx(b) Rz(c)",
        examples=[[30, 60, 0]],
    )
    ordinary: IndexSpec | None = Field(default=None, description="optical constant across the optic axis")
    extraordinary: IndexSpec | None = Field(default=None, description="optical constant along the optic axis")
    axis_polar_deg: Annotated[float, Field(ge=0.0, le=180.0)] = Field(
        default=0.0, description="angle of the optic axis to the normal; 90: in the surface", examples=[90]
    )
    axis_azimuth_deg: float = Field(
        default=0.0, description="azimuth of the optic axis, from u towards v", examples=[20]
    )

    def model_post_init(self, _: Any) -> None:
        pair = (self.ordinary is not None, self.extraordinary is not None)
        if (self.principal is None) != all(pair) or (any(pair) and not all(pair)):
            raise ValueError(
                "gives neither form of an anisotropic medium alone; write principal = [n1, n2, n3] with euler_deg, or "
                "ordinary and extraordinary with axis_polar_deg and axis_azimuth_deg"
            )
        if self.principal is None and "euler_deg" in self.model_fields_set:
            raise ValueError(".euler_deg belongs to principal; give axis_polar_deg and axis_azimuth_deg")
        stray = next((key for key in OF_AXES if key in self.model_fields_set), None)
        if self.principal is not None and stray is not None:
            raise ValueError(f".{stray} belongs to ordinary and extraordinary; give euler_deg")

    def build(self, context: RecipeContext) -> AnisotropicConstant:
        """Return the medium."""
        if self.principal is not None:
            one, two, three = (spec.build(context) for spec in self.principal)
            a, b, c = self.euler_deg
            return AnisotropicConstant((one, two, three), (a, b, c), f"{one.name}, {two.name}, {three.name}")
        assert self.ordinary is not None and self.extraordinary is not None
        ordinary, extraordinary = self.ordinary.build(context), self.extraordinary.build(context)
        name = f"{ordinary.name}, {extraordinary.name}"
        return AnisotropicConstant.uniaxial(ordinary, extraordinary, self.axis_polar_deg, self.axis_azimuth_deg, name)


def _medium_form(value: Any) -> str:
    keys = ("principal", "ordinary", "extraordinary", "euler_deg", *OF_AXES)
    is_tensor = isinstance(value, AnisotropicSpec) or (isinstance(value, Mapping) and any(k in value for k in keys))
    return "Anisotropic" if is_tensor else "Isotropic"


MediumSpec = Annotated[
    Annotated[IndexSpec, pydantic.Tag("Isotropic")] | Annotated[AnisotropicSpec, pydantic.Tag("Anisotropic")],
    pydantic.Discriminator(_medium_form),
]
