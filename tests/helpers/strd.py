"""NIST's certified nonlinear regressions as problems for `livlab.optimise`; run as a script, prints how each is met.

The numbers are in strd.toml, the models here.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from livlab.optimise import OptimiseResult, Parameter, least_squares

TINY = 1e-20
"""Residual sum of squares below which rounding alone decides: not judged."""


def peaks(b: Any, x: Any) -> Any:
    """A falling background under two Gaussian peaks."""
    first, second = (b[k] * np.exp(-(((x - b[k + 1]) / b[k + 2]) ** 2)) for k in (2, 5))
    return b[0] * np.exp(-b[1] * x) + first + second


def decays(b: Any, x: Any) -> Any:
    """Three exponentials."""
    return sum(b[k] * np.exp(-b[k + 1] * x) for k in (0, 2, 4))


def cycles(b: Any, x: Any) -> Any:
    """A year's cycle and two of unknown length."""
    made = b[0] + b[1] * np.cos(2 * np.pi * x / 12) + b[2] * np.sin(2 * np.pi * x / 12)
    for k in (3, 6):
        made = made + b[k + 1] * np.cos(2 * np.pi * x / b[k]) + b[k + 2] * np.sin(2 * np.pi * x / b[k])
    return made


def ratio(b: Any, x: Any, above: int) -> Any:
    """A polynomial of `above` coefficients over one that begins with 1."""
    top = sum(c * x**k for k, c in enumerate(b[:above]))
    return top / (1.0 + sum(c * x ** (k + 1) for k, c in enumerate(b[above:])))


MODELS: dict[str, Callable[[Any, Any], Any]] = {
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Chwirut1": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": cycles,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": peaks,
    "Gauss2": peaks,
    "Kirby2": lambda b, x: ratio(b, x, 3),
    "Lanczos1": decays,
    "Lanczos3": decays,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "Misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + 0.5 * b[1] * x) ** -2.0),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Thurber": lambda b, x: ratio(b, x, 4),
}


@dataclass(frozen=True, eq=False)
class Regression:
    """A set: its model, observations, starts and certified values."""

    name: str
    x: Any
    y: Any
    starts: Any
    certified: Any
    rss: float

    def residuals(self, values: Any) -> Any:
        """(m,) model minus observations."""
        with np.errstate(all="ignore"):  # a search may ask for what overflows
            return MODELS[self.name](np.array(list(values.values())), self.x) - self.y

    def parameters(self, start: int, box: float | None = None) -> list[Parameter]:
        """From a start; in a box about it and the certified values, `box` times as far on each side, or unbounded."""
        made = []
        for k, (first, truth) in enumerate(zip(self.starts[start], self.certified, strict=True)):
            low, high = -np.inf, np.inf
            if box is not None:
                width = box * max(abs(first), abs(truth))
                low, high = min(first, truth) - width, max(first, truth) + width
            made.append(Parameter(f"b{k + 1}", low, high, first))
        return made

    def digits(self, found: OptimiseResult) -> float:
        """Certified digits that the worst parameter has."""
        off = np.abs(np.array(list(found.best.values())) / self.certified - 1.0)
        return float(-np.log10(max(off.max(), 1e-11)))

    def reached(self, found: OptimiseResult) -> bool:
        """Whether Σ r² is the certified one; where that is rounding, whether it is as small."""
        rss = 2.0 * found.value
        return rss <= max(1.001 * self.rss, TINY)


def regressions() -> dict[str, Regression]:
    """All sets by name."""
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    made = {}
    for name, numbers in table.items():
        x = np.array(numbers["x"]) if "x" in numbers else np.array([numbers["x1"], numbers["x2"]])
        # Nelson's model is of the logarithm.
        y = np.log(numbers["y"]) if name == "Nelson" else np.array(numbers["y"])
        starts = np.array([numbers["start1"], numbers["start2"]])
        made[name] = Regression(name, x, y, starts, np.array(numbers["certified"]), numbers["rss"])
    return made


def table() -> str:
    """How each set is met from both starts, as docs/optimise.md shows it."""
    lines = [
        "| set | parameters | start | Σ r² before the polish, over the certified | digits of the worst parameter | "
        "evaluations | converged |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, one in regressions().items():
        for start in (0, 1):
            found = least_squares(one.residuals, one.parameters(start), warn=False)
            assert found.polish is not None
            before = "rounding" if one.rss < TINY else f"{2 * found.polish.before / one.rss:.4g}"
            lines.append(
                f"| {name} | {len(one.certified)} | {start + 1} | {before} | {one.digits(found):.1f} | "
                f"{found.evaluations} | {'yes' if found else 'no'} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
