"""Parts of a study's file: what varies, what is looked at, how points are laid, what is claimed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.config.schema import Label, Section, Text
from livlab.criteria import Wanted
from livlab.errors import InputError
from livlab.kinds.shared.criterion import Judged
from livlab.kinds.shared.sections import Wavelength
from livlab.model.tissue.readings import ReadingName

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from livlab.units import FloatArray

Positive = Annotated[float, Field(gt=0)]
Metric = Literal[
    "rmse",
    "mse",
    "squared error sum",
    "pearson",
    "amplitude ratio",
    "colour difference",
    "mean",
    "amplitude",
    "peak wavelength",
    "lightness",
    "a*",
    "b*",
]
COMPARING = ("rmse", "mse", "squared error sum", "pearson", "amplitude ratio", "colour difference")
"""Metrics that need a reference curve."""

COLOUR = ("colour difference", "lightness", "a*", "b*")
"""Metrics of the colour under D65 for the 2° observer, a perfect diffuser being white."""

MOST_GRID = 10_000
LEAST_BASE = 8


class LedgerSolver(Section):
    """One recorded walk for every point that shares a reading and an instrument (`livlab.fitting.forward`)."""

    kind: Literal["ledger"] = "ledger"
    standard_error: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        2e-3, description="Of the total reflectance in the recorded walk."
    )


class Factor(Section):
    """Something that varies: a value of the tissue, an option of the reading, or a field of the instrument."""

    path: str = Field(
        min_length=1,
        description="Value of the tissue (layers.NAME.elements.NAME.fraction), reading.OPTION or instrument.FIELD.",
    )
    label: Label | None = Field(None, description="How tables call it; the path's last words if not said.")
    unit: Text = Field("", description="Unit, for tables.")
    low: float | None = Field(None, description="Lower bound of a number.")
    high: float | None = Field(None, description="Upper bound of a number.")
    transform: Literal["linear", "log"] = Field("linear", description="Even in the number or in its logarithm.")
    count: Annotated[int, Field(ge=1, le=1000)] = Field(5, description="Values of a number in a grid.")
    values: tuple[float | bool | str, ...] | None = Field(
        None, strict=False, min_length=1, max_length=1000, description="Its values, in place of bounds."
    )

    @property
    def name(self) -> str:
        """Label, or the path's last two words."""
        return self.label or " ".join(self.path.split(".")[-2:]).replace("_", " ")

    @property
    def categorical(self) -> bool:
        """Whether it has a list of values, which count as equal bins."""
        return self.values is not None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.values is None) == (self.low is None or self.high is None):
            given = {k: v for k, v in self.model_dump(include={"low", "high", "values"}).items() if v is not None}
            raise InputError.of(f"factor {self.name}", given, "needs low and high, or values alone", "Give one of two.")
        if self.values is not None:
            if self.low is not None or self.high is not None:
                raise InputError.of(f"factor {self.name}", "values", "cannot stand beside a bound", "Drop one.")
            if len(set(map(str, self.values))) < len(self.values):
                raise InputError.of(f"factor {self.name}.values", self.values, "a value appears twice", "Drop one.")
            return self
        assert self.low is not None and self.high is not None
        if not self.low < self.high:
            crossed = f"must be above low = {self.low:g}" if self.low > self.high else f"equals low = {self.low:g}"
            raise InputError.of(f"factor {self.name}.high", self.high, crossed, "Give low < high.")
        if self.transform == "log" and not self.low > 0:
            raise InputError.of(f"factor {self.name}.low", self.low, "must be > 0 under a logarithm", "Raise it.")
        return self

    def ends(self) -> tuple[Any, ...]:
        """Both bounds, or every value."""
        return self.values if self.values is not None else (self.low, self.high)

    def at(self, share: float) -> Any:
        """The value at a share in [0, 1] of the way; a list has equal bins.

        >>> Factor(path="a.b", low=1.0, high=100.0, transform="log").at(0.5)
        10.0
        >>> Factor(path="reading.redirect_factor", values=["none", "cos", "abs_cos"]).at(0.5)
        'cos'
        """
        if self.values is not None:
            return self.values[min(int(share * len(self.values) + 1e-9), len(self.values) - 1)]
        assert self.low is not None and self.high is not None
        if share in (0.0, 1.0):
            return self.high if share else self.low
        if self.transform == "log":
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)

    def grid(self) -> tuple[Any, ...]:
        """Its values in a grid."""
        if self.values is not None:
            return self.values
        return tuple(self.at(k / (self.count - 1)) if self.count > 1 else self.at(0.5) for k in range(self.count))


class Output(Section):
    """A number that is made of each curve."""

    metric: Metric = Field(description="What is computed.")
    label: Label | None = Field(None, description="How tables call it.")
    against: Label | None = Field(None, description="Label of the reference, for metrics that compare.")
    band_nm: tuple[Wavelength, Wavelength] | None = Field(
        None, strict=False, description="First and last wavelength that counts; all if not said."
    )

    @property
    def name(self) -> str:
        """Label, or metric, reference and band."""
        band = "" if self.band_nm is None else f" {self.band_nm[0]:g}-{self.band_nm[1]:g}"
        return self.label or f"{self.metric}{f' vs {self.against}' if self.against else ''}{band}"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.metric in COMPARING) != (self.against is not None):
            bound = "needs the label of a reference" if self.metric in COMPARING else "compares with no reference"
            raise InputError.of("against", self.against, f"{self.metric} {bound}", "Give it, or leave it out.")
        if self.band_nm is not None and not self.band_nm[0] < self.band_nm[1]:
            raise InputError.of("band_nm", self.band_nm, "must rise", "Give [first, last].")
        return self

    def points(self, grid: FloatArray) -> NDArray[np.bool_]:
        """(W,) which wavelengths count.

        Raises
        ------
        InputError
            Fewer than the metric needs.
        """
        low, high = self.band_nm or (float(grid[0]), float(grid[-1]))
        use = (grid >= low) & (grid <= high)
        least = 3 if self.metric == "pearson" else 2 if self.metric in ("amplitude", "amplitude ratio") else 1
        if int(use.sum()) < least:
            raise InputError.of(
                f"output {self.name}", f"{int(use.sum())} wavelengths", f"{self.metric} needs {least} or more",
                "Widen its band, or sample more wavelengths.",
            )  # fmt: skip
        return use


class Sweep(Section):
    """How the points of a sweep lie."""

    design: Literal["grid", "sobol", "latin-hypercube"] = Field(
        "grid", description="Every combination of the factors' values, or points that fill the box."
    )
    points: Annotated[int, Field(ge=2, le=MOST_GRID)] = Field(64, description="Points, where it is no grid.")


class Sensitivity(Section):
    """How sensitivity indices are estimated (SALib)."""

    estimator: Literal["sobol", "morris"] = Field(
        "sobol", description="Shares of the variance, or elementary effects (a screening, cheaper)."
    )
    points: Annotated[int, Field(ge=2, le=65536)] = Field(
        64, description="Base points N: N (D + 2) evaluations for D factors; Morris: trajectories, N (D + 1)."
    )
    levels: Annotated[int, Field(ge=4, le=20, multiple_of=2)] = Field(4, description="Levels of Morris's grid.")
    resamples: Annotated[int, Field(ge=50, le=10_000)] = Field(300, description="Bootstrap resamples of the intervals.")
    level: Annotated[float, Field(gt=0.5, lt=1.0)] = Field(0.95, description="Coverage of the intervals.")
    converged: Positive = Field(
        0.1, description="Half-width of the widest interval, and largest change from N/2 to N, that count as converged."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.estimator == "sobol" and (self.points < LEAST_BASE or self.points & (self.points - 1)):
            near = max(LEAST_BASE, 2 ** round(math.log2(self.points)))
            raise InputError.of(
                "sensitivity.points", self.points, f"must be a power of 2 from {LEAST_BASE} on", f"Take {near}."
            )
        return self

    def jobs(self, factors: int) -> int:
        """Evaluations for so many factors."""
        return self.points * self.block(factors)

    def block(self, factors: int) -> int:
        """Evaluations that belong together: a base point and what is changed of it."""
        return factors + (2 if self.estimator == "sobol" else 1)


class Target(Section):
    """A number that a case may explain."""

    output: str = Field(min_length=1, description="Name of the output.")
    value: float = Field(description="What was printed or measured.")
    tolerance: Positive = Field(description="How far from it counts as one step away.")
    source: Text = Field("", description="Where it is from.")


class Ablation(Section):
    """Which options and effects are changed one by one."""

    bases: tuple[ReadingName, ...] = Field(
        (), strict=False, description="Readings to change options off, each; the experiment's own if not said."
    )
    choices: Literal["all", "named"] = Field(
        "all", description="Every choice of an option, or only those that a named reading makes."
    )
    options: tuple[str, ...] | None = Field(None, strict=False, description="Options to change; all if not said.")
    towards: ReadingName | None = Field(
        None, description="Also go all the way from the first base to this reading, an option at a time."
    )
    effects: bool = Field(True, description="Also leave each effect of the first base out.")
    target: tuple[Target, ...] = Field((), strict=False, description="Numbers that a case may explain.")

    @model_validator(mode="after")
    def _known(self) -> Self:
        from livlab.config.errors import nearest
        from livlab.model.tissue.readings import Reading

        known = [x for x in Reading.model_fields if x not in ("base", "name")]
        for option in self.options or ():
            if option not in known:
                raise InputError.of(
                    "ablation.options", option, "is no option of a reading", nearest(option, known) or "Drop it."
                )
        return self


class StudyCriterion(Judged):
    """A claim to judge."""

    output: str = Field(min_length=1, description="Name of the output.")
    statistic: Literal["value", "least", "largest", "first", "total", "mu star", "widest interval"] = Field(
        "value",
        description="value: of a case of an ablation; least, largest: over a sweep; first, total, mu star: index of a "
        "factor; widest interval: half-width over the factors.",
    )
    of: Label | None = Field(None, description="Case of an ablation, or factor.")

    @property
    def name(self) -> str:
        """The claim's name."""
        what = self.output if self.statistic == "value" else f"{self.statistic} of {self.output}"
        return f"{what}, {self.of}" if self.of else what

    def aim(self, outputs: Sequence[Output]) -> Wanted:
        """What it wants: of an output's own metric, or of an index."""
        if self.statistic not in ("value", "least", "largest"):
            return self.aims(self.statistic)
        return self.aims(next(o.metric for o in outputs if o.name == self.output))

    def check(self, method: str, field: str, factors: list[str]) -> None:
        """Whether it goes with a method.

        Raises
        ------
        InputError
            It does not, or names no factor.
        """
        known = {
            "ablation": ("value",),
            "sweep": ("least", "largest"),
            "sensitivity": ("first", "total", "mu star", "widest interval"),
        }[method]
        if self.statistic not in known:
            raise InputError.of(
                f"{field}.statistic", self.statistic, f"does not go with method = {method!r}", f"Use {known[0]!r}."
            )
        needed = self.statistic in ("value", "first", "total", "mu star")
        if needed != (self.of is not None):
            raise InputError.of(f"{field}.of", self.of, f"{self.statistic} does not go with it", "Give or drop it.")
        if method == "sensitivity" and self.of is not None and self.of not in factors:
            raise InputError.of(f"{field}.of", self.of, "names no factor", f"Known: {', '.join(factors)}.")
