"""Least squares over NLopt: the gradient from the residuals' Jacobian, the end polished on the residuals themselves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from livlab.optimise.differences import Differences
from livlab.optimise.levenberg import sum_of_squares
from livlab.optimise.parameters import Parameter, ParameterSpace
from livlab.optimise.result import OptimiseResult
from livlab.optimise.search import SearchOptions, search
from livlab.units import FloatArray

Residuals = Callable[[Mapping[str, float]], FloatArray]
Jacobian = Callable[[Mapping[str, float]], Mapping[str, FloatArray]]


class ResidualProblem:
    """½ Σ r² with its derivatives, remembering the last point so that value and gradient share one evaluation.

    Parameters
    ----------
    residuals, jacobian, space
        As of `least_squares`; derivatives by differences if there is no Jacobian.
    """

    def __init__(self, residuals: Residuals, jacobian: Jacobian | None, space: ParameterSpace) -> None:
        self.residuals, self.jacobian, self.space = residuals, jacobian, space
        self._key: tuple[float, ...] | None = None
        self._r = np.zeros(0)
        self._differences: Differences | None = None

    def at(self, values: Mapping[str, float]) -> FloatArray:
        """(m,) residuals."""
        key = tuple(values.values())
        if key != self._key:
            self._r = np.array(self.residuals(values), dtype=np.float64).ravel()
            self._key = key
        return self._r

    def value(self, values: Mapping[str, float]) -> float:
        """½ Σ r²."""
        return 0.5 * sum_of_squares(self.at(values))

    def gradient(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivatives of `value` by each parameter, those that are tied moving with theirs if by differences."""
        r = np.array(self.at(values))
        if self.jacobian is not None:
            return {name: float(np.ravel(column) @ r) for name, column in self.jacobian(values).items()}
        x = self.space.vector(values)
        slopes = self.space.slopes(x)
        by_x = self.matrix(x).T @ r
        return {n: float(g / s) if s != 0 else 0.0 for n, g, s in zip(self.space.names, by_x, slopes, strict=True)}

    def rescale(self, space: ParameterSpace) -> None:
        """See the parameters in other units from now on."""
        self.space, self._differences = space, None

    def vector(self, x: FloatArray) -> FloatArray:
        """(m,) residuals at x; nan where there are none."""
        try:
            return np.array(self.residuals(self.space.values(x)), dtype=np.float64).ravel()
        except Exception:
            return np.full(max(self._r.size, 1), np.nan)

    def matrix(self, x: FloatArray) -> FloatArray:
        """(m, n) derivatives of the residuals by x; nan where there are none."""
        if self.jacobian is None:
            return self.differences().matrix(x, self.space.sizes(x))
        try:
            return self.space.columns(x, self.jacobian(self.space.values(x)))
        except Exception:
            return np.full((max(self._r.size, 1), x.size), np.nan)

    def exact_matrix(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`matrix` with the best steps there are, and (n,) the errors of its columns, as lengths."""
        if self.jacobian is None:
            return self.differences().tune(x, self.space.sizes(x))
        found = self.matrix(x)
        return found, 1e-12 * np.linalg.norm(found, axis=0)

    def fine_matrix(self, x: FloatArray) -> FloatArray:
        """`matrix` with the steps that `exact_matrix` found."""
        return self.differences().fine(x) if self.jacobian is None else self.matrix(x)

    def differences(self) -> Differences:
        """Derivatives by differences."""
        if self._differences is None:
            self._differences = Differences(self.vector, self.space.low, self.space.high)
        return self._differences


def least_squares(
    residuals: Residuals,
    parameters: Sequence[Parameter] | ParameterSpace,
    *,
    jacobian: Jacobian | None = None,
    algorithm: str | tuple[str, ...] = "auto",
    **options: Any,
) -> OptimiseResult:
    """Minimise ½ Σ r²: NLopt with the gradient Jᵀr ("auto" is LD_SLSQP), then Levenberg–Marquardt from where it ended.

    Each parameter is first rescaled by its column of the Jacobian at the start, so that the quasi-Newton search begins
    with a curvature of order one in every direction (Moré 1978). Levenberg–Marquardt (in the box that the bounds make)
    also goes from the start itself, since NLopt may have left its valley; the lowest end counts, and is tested before
    it is called converged. The result's `polish` says what this changed.

    Parameters
    ----------
    residuals
        Takes all parameters by name, gives an array; divide by the standard deviations for a likelihood.
    jacobian
        Derivatives of the residuals by each parameter, by name; differences with steps chosen for each if not given.
    options
        As of `minimise`; `value` of the result is ½ Σ r² plus priors.

    Examples
    --------
    >>> x = np.linspace(0, 1, 9)
    >>> found = least_squares(lambda p: p["a"] * np.exp(-p["k"] * x) - 2 * np.exp(-3 * x),
    ...     [Parameter("a", 0.1, 10, 1.0), Parameter("k", 0.1, 10, 1.0, transform="log")])
    >>> round(found.best["a"], 5), round(found.best["k"], 5), bool(found)
    (2.0, 3.0, True)
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    problem = ResidualProblem(residuals, jacobian, space)
    problem.rescale(_rescaled(problem, space))
    asked = SearchOptions(algorithm=algorithm, **options)
    return search(problem.value, problem.space, asked, gradient=problem.gradient, residuals=problem)


def _rescaled(problem: ResidualProblem, space: ParameterSpace) -> ParameterSpace:
    """The same parameters in units in which each column of the Jacobian has the length of one standard residual."""
    if not space.free:
        return space
    try:
        start = problem.at(space.values(space.start))
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.linalg.norm(problem.matrix(space.start), axis=0)
    except Exception:  # a start that fails is the search's to tell
        return space
    if not np.all(np.isfinite(lengths)) or not np.any(lengths > 0):
        return space
    lengths = np.where(lengths > 1e-12 * lengths.max(), lengths, lengths.max())
    size = math.sqrt(sum_of_squares(start))
    unit = size if size > 0 else float(lengths.max())
    return space.rescaled(unit / lengths)
