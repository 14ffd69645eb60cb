"""What every criterion of an experiment file says of its value: where it passes, and which sort of claim it is."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from livlab.config.schema import Section
from livlab.criteria import Group, Wanted, wanted
from livlab.criteria.limits import check_limits

GROUP = (
    "reproduces: a figure that the thesis prints; agrees: with a measurement, where less error is never too little; "
    "checks: livlab itself. By the metric and the reference if not said (docs/metrics.md)."
)


class Judged(Section):
    """A criterion's limits: reference ± tolerance, or at_least and at_most."""

    reference: float | None = Field(None, description="Value expected, with `tolerance`.")
    tolerance: Annotated[float, Field(ge=0)] | None = Field(None, description="How far from it passes.")
    at_least: float | None = Field(None, description="Lower limit, in place of reference and tolerance.")
    at_most: float | None = Field(None, description="Upper limit, in place of reference and tolerance.")
    group: Group | None = Field(None, description=GROUP)

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        check_limits(self.reference, self.tolerance, self.at_least, self.at_most)
        return self

    def aims(self, metric: str, group: Group | None = None) -> Wanted:
        """What it wants of a metric; `group` is what it is about where it does not say."""
        return wanted(
            metric,
            self.reference,
            self.tolerance,
            at_least=self.at_least,
            at_most=self.at_most,
            group=self.group or group,
        )


__all__ = ["Judged"]
