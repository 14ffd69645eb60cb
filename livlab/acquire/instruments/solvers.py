"""How the light is followed: what an experiment file says of solvers, and what each answers for itself."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from livlab.acquire.instruments.base import StrictSettings
from livlab.errors import InputError
from livlab.model.transport.accuracy import Accuracy


class _AnySolver(StrictSettings):
    """What any solver answers."""

    sampled: ClassVar[bool] = False
    """Whether it draws by chance whatever the scene."""

    is_auto: ClassVar[bool] = False
    """Whether it picks another solver, by an accuracy."""

    @property
    def literal(self) -> bool:
        """Whether photons live and die by chance, in place of carrying weights."""
        return False

    @property
    def own_seed(self) -> int | None:
        """The seed that it was given; None if it was given none."""
        return self.__dict__["seed"] if "seed" in self.model_fields_set else None

    def with_seed(self, seed: int) -> Self:
        """The same with another seed; itself if it draws nothing."""
        return self.model_copy(update={"seed": seed}) if "seed" in type(self).model_fields else self


class _Sampled(_AnySolver):
    """A solver by chance: exactly one of three rules says when it has sampled enough."""

    kind: str
    estimator: Literal["expected", "analog"] = "expected"
    samples: int | None = None
    standard_error: float | None = Field(None, gt=0.0, description="Standard error that every wavelength must meet.")
    relative: float | None = Field(None, gt=0.0, lt=1.0, description="The same, as a share of the curve's maximum.")
    max_samples: int
    max_seconds: float | None = Field(None, gt=0.0, description="Seconds after which it stops, unfinished.")
    seed: int = Field(1, ge=0, lt=2**31, description="Seed of every draw.")

    default_relative: ClassVar[float]
    """The rule if none is given."""

    sampled: ClassVar[bool] = True

    @property
    def literal(self) -> bool:
        """Whether the estimator is the literal one."""
        return self.estimator == "analog"

    @model_validator(mode="before")
    @classmethod
    def _one_target(cls, given: Any) -> Any:
        return _one_rule(given, cls.default_relative)


class WalkSolver(_Sampled):
    """Monte Carlo (`livlab.model.transport.walk`), each wavelength with as many samples as it needs.

    Exactly one of `samples`, `standard_error` and `relative` rules; `relative` 0.002 if none is given.
    """

    kind: Literal["walk"] = "walk"
    estimator: Literal["expected", "analog"] = Field("expected", description="Summed rates and weights, or literal.")
    samples: int | None = Field(None, ge=1000, le=10**10, description="Samples for every wavelength.")
    pilot: int = Field(65536, ge=1000, le=10**8, description="Samples that first gauge each wavelength's noise.")
    largest_launch: int = Field(4_000_000, ge=1000, le=10**9, description="Samples in one launch, all wavelengths.")
    max_samples: int = Field(10**9, ge=1000, le=10**11, description="Samples after which a wavelength is given up.")

    default_relative: ClassVar[float] = 0.002

    def rule(self, _: Accuracy | None = None) -> dict[str, Any]:
        """What its walk is sampled by (`livlab.model.transport.sampling.SamplingRule`): its own rule."""
        return self.model_dump(exclude={"kind"})


class TracerSolver(_Sampled):
    """The reference tracer: the sample as a block in a scene (`livlab.model.tracer.block`).

    A path serves all wavelengths. Exactly one of `samples`, `standard_error` and `relative` rules; `relative` 0.01 if
    none is given. It counts what the instrument reads, no budget of the rest.
    """

    kind: Literal["tracer"] = "tracer"
    estimator: Literal["expected", "analog"] = Field("expected", description="Survival by weight, or by chance.")
    samples: int | None = Field(None, ge=2048, le=10**10, description="Paths; each serves every wavelength.")
    launch: int = Field(131_072, ge=2048, le=10**8, description="Paths in one launch.")
    max_samples: int = Field(10**8, ge=2048, le=10**11, description="Paths after which it is given up.")

    default_relative: ClassVar[float] = 0.01


class AddingDoublingSolver(_AnySolver):
    """Adding–doubling: no noise, but laterally endless layers only (`livlab.model.transport.adding_doubling`)."""

    kind: Literal["adding-doubling"] = "adding-doubling"
    tolerance: float = Field(1e-6, gt=0.0, le=1e-2, description="Absolute error of the totals.")


class AutoSolver(_AnySolver):
    """The cheapest solver that can meet the experiment's `[accuracy]` (`livlab.model.transport.ladder`)."""

    kind: Literal["auto"] = "auto"
    pilot: int = Field(65536, ge=1000, le=10**8, description="Samples that first gauge each wavelength's noise.")
    largest_launch: int = Field(4_000_000, ge=1000, le=10**9, description="Samples in one launch, all wavelengths.")
    max_samples: int = Field(10**9, ge=1000, le=10**11, description="Samples after which a wavelength is given up.")
    max_seconds: float | None = Field(None, gt=0.0, description="Seconds after which a walk stops, unfinished.")
    seed: int = Field(1, ge=0, lt=2**31, description="Seed of every draw.")

    is_auto: ClassVar[bool] = True

    def rule(self, accuracy: Accuracy | None = None) -> dict[str, Any]:
        """What its walk is sampled by: the accuracy, or the default one."""
        return self.model_dump(exclude={"kind"}) | (accuracy or DEFAULT_ACCURACY).model_dump()


DEFAULT_ACCURACY = Accuracy(relative=WalkSolver.default_relative)
"""What an `AutoSolver` is to meet if an experiment has no wish: what `WalkSolver` aims at, too."""

Solver = Annotated[WalkSolver | AddingDoublingSolver | TracerSolver | AutoSolver, Field(discriminator="kind")]
"""How the light is followed, by `kind`."""


def _one_rule(given: Any, default: float) -> Any:
    """What a solver was given, with the default rule if it was given none."""
    if not isinstance(given, dict):
        return given
    rules = [key for key in ("samples", "standard_error", "relative") if given.get(key) is not None]
    if len(rules) > 1:
        raise InputError.of("solver", " and ".join(rules), "only one of them can rule", "Drop the others.")
    return given if rules else {**given, "relative": default}
