"""What a minimisation found, how it went, and what to mistrust about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import pandas as pd


class FitWarning(UserWarning):
    """Something about a fit that its reader must know."""


@dataclass(frozen=True, eq=False)
class OptimiseResult:
    """Outcome of `minimise`; true in a condition if it converged to a finite value.

    Attributes
    ----------
    best
        Every parameter's value, fixed and tied ones too.
    value
        Objective at `best`, priors included.
    status
        Per parameter: free, fixed, tied to …, at lower bound, at upper bound, unchanged from start.
    evaluations, failures
        Calls of the objective, and how many of them raised or gave no finite number.
    seconds
        Wall time.
    stop
        Why it stopped, in words.
    converged
        Whether the last stage stopped by a tolerance (rounding included) rather than a limit or an interruption.
    interrupted
        Whether the user stopped it.
    path
        One row an evaluation: start, stage, seconds, value (infinite for a failure), best, and the parameters.
    starts
        One row a start: where it began, where it ended, its value, evaluations and stop reason.
    warnings
        Sentences.
    algorithm, seed, one_sigma
        What was run; the objective's rise that marks one standard deviation.
    """

    best: dict[str, float]
    value: float
    status: dict[str, str]
    evaluations: int
    failures: int
    seconds: float
    stop: str
    converged: bool
    interrupted: bool
    path: pd.DataFrame = field(repr=False)
    starts: pd.DataFrame = field(repr=False)
    warnings: tuple[str, ...]
    algorithm: str
    seed: int
    one_sigma: float

    def __bool__(self) -> bool:
        return self.converged and math.isfinite(self.value)

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter: value and status."""
        frame = pd.DataFrame({"value": self.best, "status": self.status})
        frame.index.name = "parameter"
        return frame

    def to_dict(self) -> dict[str, Any]:
        """Plain data without the path, for JSON."""
        return {
            "best": self.best,
            "value": self.value,
            "status": self.status,
            "evaluations": self.evaluations,
            "failures": self.failures,
            "seconds": self.seconds,
            "stop": self.stop,
            "converged": self.converged,
            "interrupted": self.interrupted,
            "warnings": list(self.warnings),
            "algorithm": self.algorithm,
            "seed": self.seed,
        }

    def summary(self) -> str:
        """A text table of the parameters, the cost and the warnings."""
        lines = [
            f"{'value':<12} {self.value:.8g}",
            f"{'algorithm':<12} {self.algorithm}",
            f"{'stopped':<12} {self.stop}",
            f"{'cost':<12} {self.evaluations} evaluations ({self.failures} failed), {self.seconds:.3g} s",
            "",
        ]
        wide = max([len(name) for name in self.best] + [9])
        lines += [f"{name:<{wide}}  {value:>14.7g}  {self.status[name]}" for name, value in self.best.items()]
        lines += [f"warning: {sentence}" for sentence in self.warnings]
        return "\n".join(lines)
