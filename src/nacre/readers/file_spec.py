"""A file of measured data in a recipe or target: its name, or a table that also says what the file does not state."""

from collections.abc import Mapping
from typing import Any, ClassVar

import pydantic

from nacre.readers.measurement import ReadOptions
from nacre.recipe.model import RecipeModel, show_value


class FileSpec(RecipeModel):
    """A file of measured data, by its name or with the statements that it lacks."""

    noun: ClassVar[str] = "measured file"
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ({"type": "string"},)

    file: str = pydantic.Field(description="the file, beside the recipe", examples=["data.csv"])
    columns: tuple[str, ...] = pydantic.Field(
        default=(),
        description='what its columns are, one name each, where no heading says it; "-" leaves one out',
        examples=[["wavelength_nm", "reflectance"]],
    )
    ignore: tuple[str, ...] = pydantic.Field(
        default=(), description="headings of columns that are left out", examples=[["batch"]]
    )
    unit: str | None = pydantic.Field(
        default=None, description="unit of its wavelengths or energies, if it names none", examples=["um"]
    )
    spectrum: str | None = pydantic.Field(
        default=None, description="name or number of one of its spectra", examples=["red"]
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_name(cls, data: Any) -> Any:
        if isinstance(data, str) and cls.shorthands:
            return {"file": data}
        if not isinstance(data, Mapping | FileSpec):
            raise ValueError(f'= {show_value(data)} is no file; write "data.csv" or {{file = "data.csv", ...}}')
        return data

    @property
    def options(self) -> ReadOptions:
        """The statements for the reader."""
        return ReadOptions(columns=self.columns, ignore=self.ignore, unit=self.unit, spectrum=self.spectrum)
