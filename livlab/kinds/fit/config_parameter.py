"""A parameter of a fit, as a file gives it."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.config.schema import Label, Section, Text

Positive = Annotated[float, Field(gt=0)]


class FitParameter(Section):
    """One parameter of a fit."""

    path: str = Field(min_length=1, description="Value of the tissue, e.g. layers.parenchyma.elements.blood.fraction.")
    label: Label | None = Field(None, description="How tables call it; the path's last words if not said.")
    unit: Text = Field("", description="Unit, for tables.")
    low: float = Field(description="Lower bound.")
    high: float = Field(description="Upper bound.")
    start: float | None = Field(None, description="First guess; the middle of the (transformed) bounds if not said.")
    transform: Literal["linear", "log", "logit"] = Field("linear", description="How the search sees it.")
    fixed: bool = Field(False, description="Keep it at its start.")
    tied: Label | None = Field(None, description="Label of the parameter that it follows.")
    factor: float = Field(1.0, description="Its value over that of the one it is tied to.")
    only: tuple[Label, ...] | None = Field(
        None, strict=False, min_length=1, description="Measurements whose tissue has it; all if not said."
    )
    prior_mean: float | None = Field(None, description="Mean of what is known beforehand.")
    prior_sd: Positive | None = Field(None, description="Standard deviation of what is known beforehand.")

    @property
    def name(self) -> str:
        """Label, or the path's last two words."""
        return self.label or " ".join(self.path.split(".")[-2:]).replace("_", " ")

    @property
    def key(self) -> str:
        """The path, and whose it is if not everyone's."""
        return self.path if self.only is None else f"{self.path} of {', '.join(self.only)}"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        self.parameter()
        return self

    def parameter(self, tied: str | None = None) -> Any:
        """As `livlab.optimise.Parameter`; `tied` is the key of the one it follows."""
        from livlab.optimise.parameters import Parameter

        return Parameter(
            self.key,
            self.low,
            self.high,
            self.start,
            transform=self.transform,
            fixed=self.fixed,
            tied=tied,
            factor=self.factor,
            prior_mean=self.prior_mean,
            prior_sd=self.prior_sd,
        )


__all__ = ["FitParameter", "Positive"]
