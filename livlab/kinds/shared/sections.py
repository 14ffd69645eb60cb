"""Tables of an experiment file that several kinds have: wavelengths, what is done to a curve, measured curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from livlab.config.schema import Label, Section
from livlab.errors import InputError
from livlab.metrics import Normalisation, ReferenceErrors

if TYPE_CHECKING:
    from livlab.units import FloatArray

Wavelength = Annotated[float, Field(gt=0, lt=1e5)]
MOST_WAVELENGTHS = 10_000


class Wavelengths(Section):
    """Where the spectrum is sampled: a regular band, or a list."""

    start_nm: Wavelength | None = Field(None, description="First wavelength in nm.")
    stop_nm: Wavelength | None = Field(None, description="Last wavelength in nm, included.")
    step_nm: Annotated[float, Field(gt=0)] | None = Field(None, description="Step in nm; must divide the band.")
    list_nm: tuple[Wavelength, ...] | None = Field(
        None, strict=False, min_length=1, max_length=MOST_WAVELENGTHS, description="Wavelengths in nm, rising."
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        band = (self.start_nm, self.stop_nm, self.step_nm)
        if (self.list_nm is None) == any(x is None for x in band) or (
            self.list_nm is not None and any(x is not None for x in band)
        ):
            given = {k: v for k, v in self.model_dump().items() if v is not None}
            raise InputError.of(
                "wavelengths", given, "needs start_nm, stop_nm and step_nm, or list_nm alone", "Give one of the two."
            )
        if self.start_nm is not None and self.stop_nm is not None and self.step_nm is not None:
            if self.stop_nm <= self.start_nm:
                raise InputError.of("stop_nm", self.stop_nm, f"must be above start_nm = {self.start_nm:g}", "Raise it.")
            if (self.stop_nm - self.start_nm) / self.step_nm >= MOST_WAVELENGTHS:
                raise InputError.of(
                    "step_nm", self.step_nm, f"makes more than {MOST_WAVELENGTHS} wavelengths", "Take a larger step."
                )
        self.grid()
        return self

    def grid(self) -> FloatArray:
        """(W,) the wavelengths in nm.

        Raises
        ------
        InputError
            They do not rise, or the step does not divide the band.
        """
        import numpy as np

        from livlab.curves import check_grid, regular_grid

        if self.list_nm is not None:
            grid = np.asarray(self.list_nm, dtype=np.float64)
            check_grid("list_nm", grid)
            return grid
        assert self.start_nm is not None and self.stop_nm is not None and self.step_nm is not None
        return regular_grid(self.start_nm, self.stop_nm, self.step_nm)


class Processing(Section):
    """What is done to a measured curve before it is shown and, beside the raw points, compared."""

    interpolate_nm: Annotated[float, Field(gt=0)] = Field(5.0, description="Step of the linear interpolation in nm.")
    moving_average: Annotated[int, Field(ge=1, le=1000)] = Field(
        4, description="Positions of the moving average; 1 smooths nothing (thesis: 4)."
    )
    alignment: Literal["centred", "left", "right"] = Field("centred", description="Where an even window lies.")
    normalise: Normalisation = Field("max", description="Divide each curve by its maximum, its sum, or nothing.")


class Reference(Section):
    """A measured curve to hold the readings against."""

    label: Label = Field(description="How criteria and reports call it, e.g. human liver.")
    dataset: str = Field(min_length=1, description="Dataset by name (`livlab data list`, `livlab data add`).")
    column: str = Field("reflectance", min_length=1, description="Column with the curve.")
    sd_column: str | None = Field(None, description="Column with its standard deviation over subjects.")
    subjects: Annotated[int, Field(ge=1)] = Field(
        1, description="Subjects behind the mean: its standard error is SD/√subjects."
    )
    errors: ReferenceErrors = Field(
        "independent", description="Whether the mean's errors are independent, or one draw that moves all points."
    )
