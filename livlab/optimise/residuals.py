"""Least squares over NLopt: the gradient from the residuals' Jacobian, the scales from its columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from livlab.optimise.driver import minimise
from livlab.optimise.parameters import Parameter, ParameterSpace
from livlab.optimise.result import OptimiseResult
from livlab.units import FloatArray

Residuals = Callable[[Mapping[str, float]], FloatArray]
Jacobian = Callable[[Mapping[str, float]], Mapping[str, FloatArray]]

DIFFERENCE_STEP = 1e-6
"""Central-difference step in the scaled parameters: about the cube root of float64's rounding."""


class _LeastSquares:
    """½ Σ r² with its gradient, remembering the last point so that value and gradient share one evaluation."""

    def __init__(self, residuals: Residuals, jacobian: Jacobian | None, space: ParameterSpace) -> None:
        self.residuals, self.jacobian, self.space = residuals, jacobian, space
        self._key: tuple[float, ...] | None = None
        self._r = np.zeros(0)

    def at(self, values: Mapping[str, float]) -> FloatArray:
        key = tuple(values.values())
        if key != self._key:
            self._r = np.asarray(self.residuals(values), dtype=np.float64).ravel()
            self._key = key
        return self._r

    def value(self, values: Mapping[str, float]) -> float:
        r = self.at(values)
        return 0.5 * float(r @ r)

    def columns(self, values: Mapping[str, float]) -> Mapping[str, FloatArray]:
        if self.jacobian is not None:
            return self.jacobian(values)
        return difference_jacobian(self.residuals, self.space, values)

    def gradient(self, values: Mapping[str, float]) -> dict[str, float]:
        r = self.at(values)
        return {name: float(np.ravel(column) @ r) for name, column in self.columns(values).items()}


def difference_jacobian(
    residuals: Residuals, space: ParameterSpace, values: Mapping[str, float]
) -> dict[str, FloatArray]:
    """Derivatives of the residuals by each free parameter (its ties moving along), by central differences.

    Steps are taken in the transformed parameter and turned inwards at a bound.
    """
    x = space.vector(values)
    slopes = space.slopes(x)
    found = {}
    for k, name in enumerate(space.names):
        ends = []
        for sign in (-1.0, 1.0):
            moved = x.copy()
            moved[k] = min(max(moved[k] + sign * DIFFERENCE_STEP, space.low[k]), space.high[k])
            ends.append((moved[k], np.asarray(residuals(space.values(moved)), dtype=np.float64).ravel()))
        slope = slopes[k] if slopes[k] != 0 else 1.0
        found[name] = (ends[1][1] - ends[0][1]) / ((ends[1][0] - ends[0][0]) * slope)
    return found


def least_squares(
    residuals: Residuals,
    parameters: Sequence[Parameter] | ParameterSpace,
    *,
    jacobian: Jacobian | None = None,
    algorithm: str | tuple[str, ...] = "auto",
    **options: Any,
) -> OptimiseResult:
    """Minimise ½ Σ r² by NLopt with the gradient Jᵀr; "auto" is LD_SLSQP.

    Each parameter is first rescaled by its column of the Jacobian at the start, so that the quasi-Newton search begins
    with a curvature of order one in every direction (Moré 1978).

    Parameters
    ----------
    residuals
        Takes all parameters by name, gives an array; divide by the standard deviations for a likelihood.
    jacobian
        Derivatives of the residuals by each parameter, by name; central differences if not given.
    options
        As of `minimise`; `value` of the result is ½ Σ r² plus priors.

    Examples
    --------
    >>> x = np.linspace(0, 1, 9)
    >>> found = least_squares(lambda p: p["a"] * np.exp(-p["k"] * x) - 2 * np.exp(-3 * x),
    ...     [Parameter("a", 0.1, 10, 1.0), Parameter("k", 0.1, 10, 1.0, transform="log")])
    >>> round(found.best["a"], 5), round(found.best["k"], 5)
    (2.0, 3.0)
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    problem = _LeastSquares(residuals, jacobian, space)
    scaled = _rescaled(problem, space)
    return minimise(problem.value, scaled, gradient=problem.gradient, algorithm=algorithm, **options)


def _rescaled(problem: _LeastSquares, space: ParameterSpace) -> ParameterSpace:
    """The same parameters in units in which each column of the Jacobian has the length of one standard residual."""
    if not space.free:
        return space
    values = space.values(space.start)
    try:
        columns = problem.columns(values)
        slopes = space.slopes(space.start)
        lengths = np.array([np.linalg.norm(columns[name]) for name in space.names]) * np.abs(slopes)
    except Exception:  # a start that fails is the search's to tell
        return space
    if not np.all(np.isfinite(lengths)) or not np.any(lengths > 0):
        return space
    lengths = np.where(lengths > 1e-12 * lengths.max(), lengths, lengths.max())
    size = math.sqrt(float(problem.at(values) @ problem.at(values)))
    unit = size if size > 0 else float(lengths.max())
    return space.rescaled(unit / lengths)
