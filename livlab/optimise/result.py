"""What a minimisation found, how it went, and what to mistrust about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import pandas as pd


class FitWarning(UserWarning):
    """Something about a fit that its reader must know."""


@dataclass(frozen=True)
class Convergence:
    """Whether the end of a search is a minimum, by test; true in a condition if it is.

    Attributes
    ----------
    converged
        The verdict.
    words
        Why.
    decrease
        What the quadratic model about the end still promises within the bounds, in the objective's unit; nan if the end
        was not tested.
    noise
        Standard deviation of the objective's errors by chance or rounding; nan if the end was not tested.
    flat
        Whether nothing changes the objective there.
    """

    converged: bool
    words: str
    decrease: float = math.nan
    noise: float = math.nan
    flat: bool = False

    def __bool__(self) -> bool:
        return self.converged


@dataclass(frozen=True)
class Polish:
    """What Levenberg–Marquardt made of the end of a least-squares search.

    Attributes
    ----------
    origin
        Where it began: "the search's end", or "the start" where that led lower.
    before, after
        The objective at the search's end, and at its own.
    steps, evaluations
        How many steps it took from there, and evaluations of the objective in all.
    """

    origin: str
    before: float
    after: float
    steps: int
    evaluations: int

    def __str__(self) -> str:
        return (
            f"polished by Levenberg–Marquardt from {self.before:.8g} to {self.after:.8g} in {self.steps} steps from "
            f"{self.origin}"
        )


@dataclass(frozen=True, eq=False)
class OptimiseResult:
    """Outcome of `minimise`; true in a condition if its end was shown to be a minimum.

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
        Why it stopped, in words; with "stopped, not converged" and the reason where the end is no minimum by test.
    converged
        Whether its end was tested and is a minimum, see `convergence`.
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
    convergence
        The test and its reason.
    polish
        What was polished, from what to what; None where no residuals are known.
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
    convergence: Convergence = Convergence(False, "the end was not tested")
    polish: Polish | None = None

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
            "convergence": self.convergence.words,
            "interrupted": self.interrupted,
            "polish": str(self.polish) if self.polish is not None else None,
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
            f"{'converged':<12} {'yes' if self else 'no'}: {self.convergence.words}",
            f"{'cost':<12} {self.evaluations} evaluations ({self.failures} failed), {self.seconds:.3g} s",
            "",
        ]
        wide = max([len(name) for name in self.best] + [9])
        lines += [f"{name:<{wide}}  {value:>14.7g}  {self.status[name]}" for name, value in self.best.items()]
        lines += [f"warning: {sentence}" for sentence in self.warnings]
        return "\n".join(lines)
