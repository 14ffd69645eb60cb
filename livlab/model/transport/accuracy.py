"""How exact an answer is wished for: an error, an error relative to the answer, or a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from livlab.errors import InputError

if TYPE_CHECKING:
    from livlab.units import FloatArray


class Accuracy(BaseModel):
    """A wish for the error of every wavelength, or for the time all of them may take. Exactly one rules.

    >>> import numpy as np
    >>> Accuracy(relative=0.01).target(np.array([0.1, 0.4]))
    0.004
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    standard_error: float | None = Field(None, gt=0.0, description="Error that every wavelength must meet.")
    relative: float | None = Field(None, gt=0.0, lt=1.0, description="The same, as a share of the curve's maximum.")
    seconds: float | None = Field(
        None, gt=0.0, le=1e6, description="Time that all wavelengths of a reading may take, by the clock."
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        wishes = [key for key, value in self if value is not None]
        if len(wishes) != 1:
            raise InputError.of(
                "accuracy",
                " and ".join(wishes) or None,
                "needs exactly one of standard_error, relative and seconds",
                "Keep one." if wishes else "Write relative = 0.01, say.",
            )
        return self

    def target(self, value: FloatArray) -> float | None:
        """Error that the wish allows at every wavelength, given the curve's (W,) values; None if time rules."""
        if self.standard_error is not None:
            return self.standard_error
        if self.relative is not None:
            return self.relative * float(max(value))
        return None

    @property
    def text(self) -> str:
        """The wish in words."""
        if self.standard_error is not None:
            return f"error of at most {self.standard_error:g}"
        if self.relative is not None:
            return f"error of at most {100 * self.relative:g} % of the maximum"
        return f"at most {self.seconds:g} s"
