"""What a fit searches on: a forward model's answers, the residuals of all targets, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError, LivlabError
from livlab.fitting.targets import ROUNDING, CurveTarget
from livlab.optimise import Parameter, ParameterSpace
from livlab.units import FloatArray

CORNERS = 8
"""Points of the box that a recording is to serve beside its centre."""


class Prediction(Protocol):
    """What a forward model answers."""

    @property
    def value(self) -> FloatArray:
        """(W,) the curve."""

    @property
    def standard_error(self) -> FloatArray:
        """(W,) its Monte Carlo error."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(W,) whether it can be trusted."""

    @property
    def slopes(self) -> Mapping[str, FloatArray]:
        """(W,) derivative by each parameter, if asked for."""


class Forward(Protocol):
    """A curve as a function of parameters, by common random numbers that `record` draws anew."""

    def record(
        self,
        centre: Mapping[str, float],
        others: Sequence[Mapping[str, float]] = (),
        *,
        seed: int = 1,
        coarser: float = 1.0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Draw anew about a centre, so that `others` are served too, with `coarser` times the standard error."""

    def answer(self, values: Mapping[str, float], *, gradient: bool = False) -> Prediction:
        """The curve at given values."""


class Problem:
    """Residuals of all targets and their Jacobian, from a forward model; the last point is remembered.

    Parameters
    ----------
    forward, targets
        What answers, and the measured curves it is held against.
    parameters
        With bounds.
    eager
        Whether each answer comes with its derivatives at once, because the search asks for both.

    Raises
    ------
    InputError
        No target.
    """

    def __init__(
        self,
        forward: Forward,
        targets: Sequence[CurveTarget],
        parameters: Sequence[Parameter] | ParameterSpace,
        *,
        eager: bool = False,
    ) -> None:
        if not targets:
            raise InputError.of("measurement", (), "at least one must be fitted", "Give one with role = 'fit'.")
        self.forward, self.targets, self.eager = forward, tuple(targets), eager
        self.space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
        self.noise: FloatArray | None = None
        self.whitening: list[FloatArray | None] = [None] * len(self.targets)
        self._at: tuple[float, ...] | None = None
        self._answer: Prediction | None = None
        self.evaluations = 0
        narrow = getattr(forward, "focus", None)
        if narrow is not None:
            narrow(np.any([t.use for t in self.targets], axis=0))

    @property
    def by_residuals(self) -> bool:
        """Whether the noise of a residual is taken from the residuals: not every loss has standard errors."""
        return not all(t.loss == "chi2" for t in self.targets)

    def refresh(self) -> None:
        """Forget what an older recording answered."""
        self._at = None

    def release(self) -> None:
        """Let the forward model answer everywhere again."""
        narrow = getattr(self.forward, "focus", None)
        if narrow is not None:
            narrow(None)
        self.refresh()

    def freeze_errors(self, values: Mapping[str, float]) -> None:
        """Take the model's errors at one point for the whole search: weights must not move with the parameters."""
        noise = getattr(self.forward, "noise_covariance", None)
        found = self.answer(values)
        if not all(found.valid[t.use].all() for t in self.targets):
            return
        self.noise = np.array(noise(values)) if noise is not None else np.diag(np.square(found.standard_error))
        self.whitening = [t.whitening(found.value, self.noise) for t in self.targets]

    def answer(self, values: Mapping[str, float], *, gradient: bool = False) -> Prediction:
        """The forward model's answer."""
        key = tuple(values.values())
        if self._at != key or self._answer is None or (gradient and not self._answer.slopes):
            self._answer = self.forward.answer(values, gradient=gradient or self.eager)
            self._at = key
            self.evaluations += 1
        return self._answer

    def residuals(self, values: Mapping[str, float]) -> FloatArray:
        """(N,) residuals; nan where the forward model cannot answer."""
        found = self.answer(values)
        parts = []
        for target, white in zip(self.targets, self.whitening, strict=True):
            r = target.residuals(found.value, white)
            parts.append(r if found.valid[target.use].all() else np.full_like(r, np.nan))
        return np.concatenate(parts)

    def jacobian(self, values: Mapping[str, float]) -> dict[str, FloatArray]:
        """Derivative of the residuals by each parameter that the forward model knows."""
        found = self.answer(values, gradient=True)
        return {name: self.along(found.value, slope) for name, slope in found.slopes.items()}

    def along(self, model: FloatArray, slope: FloatArray) -> FloatArray:
        """(N,) derivative of the residuals along a change of the modelled curve."""
        return np.concatenate([t.slope(model, slope, w) for t, w in zip(self.targets, self.whitening, strict=True)])

    def least_variance(self, values: Mapping[str, float]) -> float:
        """Variance that rounding alone gives a residual: no data are known better than the curves' last digits."""
        model = self.answer(values).value
        rounded = model * (1.0 + ROUNDING * np.where(np.arange(len(model)) % 2, 1.0, -1.0))
        return float(np.mean((self._residuals(rounded) - self._residuals(model)) ** 2))

    def _residuals(self, model: FloatArray) -> FloatArray:
        return np.concatenate([t.residuals(model, w) for t, w in zip(self.targets, self.whitening, strict=True)])

    def shaken(self, values: Mapping[str, float]) -> FloatArray:
        """(N, K) roots of the covariance that the forward model's errors give to the residuals.

        Zero in residuals that weigh those errors in already.
        """
        size = len(self.residuals(values))
        if self.noise is None:
            return np.zeros((size, 0))
        use = np.any([t.use for t in self.targets], axis=0)
        eigen, vectors = np.linalg.eigh(self.noise[np.ix_(use, use)])
        model, columns = self.answer(values).value, []
        blind = np.concatenate(
            [np.full(len(t.residuals(model, w)), w is None) for t, w in zip(self.targets, self.whitening, strict=True)]
        )
        for value, vector in zip(eigen, vectors.T, strict=True):
            if value > 1e-6 * eigen[-1]:
                along = np.zeros(len(use))
                along[use] = np.sqrt(value) * vector
                columns.append(np.where(blind, self.along(model, along), 0.0))
        return np.array(columns).reshape(-1, size).T


def corners(
    forward: Forward,
    space: ParameterSpace,
    seed: int,
    about: Mapping[str, float] | None = None,
    reach: float = 1.0,
) -> list[dict[str, float]]:
    """Points of the box at which the tissue holds together, for a recording to serve: its corners by chance.

    Parameters
    ----------
    forward, space
        The model (its `stack` tells whether a tissue holds together), and the parameters.
    seed
        Of the choice.
    about, reach
        A smaller box: its middle, and half its side as a share of the box's; the whole box if not given.
    """
    rng = np.random.default_rng(seed)
    found: list[dict[str, float]] = []
    finite = np.isfinite(space.low) & np.isfinite(space.high)
    low, high = space.low, space.high
    if about is not None:
        middle, room = space.vector(about), reach * np.where(finite, space.high - space.low, 1.0)
        low, high = np.maximum(low, middle - room), np.minimum(high, middle + room)
    for _ in range(8 * CORNERS):
        side = rng.random(len(space.free)) < 0.5
        values = space.values(np.where(finite, np.where(side, low, high), space.start))
        if not is_tissue(forward, values):
            continue
        found.append(values)
        if len(found) == CORNERS:
            break
    return found


def is_tissue(forward: Forward, values: Mapping[str, float]) -> bool:
    """Whether the tissue holds together at given values; of a model without a `stack`, all do."""
    stack = getattr(forward, "stack", None)
    try:
        if stack is not None:
            stack(values)
    except LivlabError:
        return False
    return True
