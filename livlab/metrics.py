"""How far two curves are apart: RMSE, MSE, Pearson, amplitude, colour difference, and the error of each.

Every sum is taken in float64 about the mean (two passes), so a curve that rides on a large level loses nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError
from livlab.units import FloatArray

Normalisation = Literal["max", "sum", "none"]
"""What a curve is divided by before it is compared."""

ReferenceErrors = Literal["independent", "common"]
"""How the reference's errors hang together: each point its own draw, or one draw that moves all points."""

NEARLY_CONSTANT = 1e-10
"""Spread below this share of the level counts as constant: rounding alone then moves Pearson by ~1e-6."""


def mse(values: ArrayLike, reference: ArrayLike, *, weights: ArrayLike | None = None) -> float:
    """Mean squared error Σ w (a − b)² / Σ w, the thesis's EQM (Nunes 2019, section 7.1).

    A mean over curves within [0, 1] cannot exceed 1: the 1.19 printed for Fig. 7.2 is no mean of squares,
    which is why `squared_error_sum` stands beside this.

    Parameters
    ----------
    values, reference
        (N,) numbers in one unit, N ≥ 1; the result has that unit squared.
    weights
        (N,) non-negative weights; equal ones if not given.

    Raises
    ------
    InputError
        On NaN or infinite entries, unequal lengths, or weights that are negative or all zero.

    Examples
    --------
    >>> mse([0.0, 1.0], [0.0, 3.0])
    2.0
    """
    a, b, w = _pair(values, reference, weights, at_least=1)
    return float(np.sum(w * np.square(a - b)))


def rmse(values: ArrayLike, reference: ArrayLike, *, weights: ArrayLike | None = None) -> float:
    """Root of the mean squared error, in the unit of the curves; arguments and errors as `mse`.

    >>> rmse([0.0, 1.0], [0.0, 3.0]) == 2**0.5
    True
    """
    a, b, w = _pair(values, reference, weights, at_least=1)
    difference = a - b
    scale = float(np.max(np.abs(difference)))
    if scale == 0.0:
        return 0.0
    return scale * math.sqrt(float(np.sum(w * np.square(difference / scale))))


def squared_error_sum(values: ArrayLike, reference: ArrayLike) -> float:
    """Sum of squared differences Σ (a − b)², the accumulated residual that the thesis's prose describes.

    >>> squared_error_sum([0.0, 1.0], [0.0, 3.0])
    4.0
    """
    a, b, _ = _pair(values, reference, None, at_least=1)
    return float(np.sum(np.square(a - b)))


def pearson(values: ArrayLike, reference: ArrayLike, *, weights: ArrayLike | None = None) -> float:
    """Pearson's correlation Σ w (a − ā)(b − b̄) / √(Σ w (a − ā)² Σ w (b − b̄)²), within [−1, 1].

    Parameters
    ----------
    values, reference
        (N,) numbers, N ≥ 3: two points always lie on a line.
    weights
        (N,) non-negative weights; equal ones if not given.

    Raises
    ------
    InputError
        On NaN, unequal lengths, fewer than three points, or a (nearly) constant curve, which has no correlation.

    Examples
    --------
    >>> round(pearson([1, 2, 3], [2, 4, 6]), 12)
    1.0
    >>> pearson([1, 2, 3], [5, 5, 5])  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    livlab.errors.InputError: reference = 'spread 0, level 5': is constant: it has no Pearson correlation. ...
    """
    a, b, w = _pair(values, reference, weights, at_least=3)
    if np.count_nonzero(w) < 3:
        raise InputError.of(
            "weights", int(np.count_nonzero(w)), "must leave at least 3 points", "Give more points a weight above 0."
        )
    ca = _standardised("values", a, w)
    cb = _standardised("reference", b, w)
    return float(min(1.0, max(-1.0, np.sum(w * ca * cb))))


def amplitude(values: ArrayLike) -> float:
    """Largest minus smallest value.

    >>> amplitude([0.25, 0.75, 0.5])
    0.5
    """
    a = _curve("values", values, at_least=1)
    return float(np.max(a) - np.min(a))


def amplitude_ratio(values: ArrayLike, reference: ArrayLike) -> float:
    """Amplitude of the curve over that of the reference; the thesis calls Fig. 7.2 "about half".

    Raises
    ------
    InputError
        If the reference is constant.

    Examples
    --------
    >>> amplitude_ratio([0.0, 1.0], [0.0, 2.0])
    0.5
    """
    below = amplitude(reference)
    if below == 0.0:
        raise InputError.of("reference", "amplitude 0", "is constant: no ratio to it exists", "Give one that varies.")
    return amplitude(values) / below


def normalise(values: ArrayLike, by: Normalisation = "max") -> FloatArray:
    """The curve divided by its maximum, by its sum, or left alone.

    The sum depends on the grid: two curves normalised by it compare only on equal grids.

    Raises
    ------
    InputError
        If the divisor is not above 0, or `by` is unknown.

    Examples
    --------
    >>> normalise([1.0, 2.0, 4.0])
    array([0.25, 0.5 , 1.  ])
    """
    a = _curve("values", values, at_least=1)
    return a / divisor(a, by)


def divisor(values: FloatArray, by: Normalisation) -> float:
    """What `normalise` divides by; errors as there."""
    if by == "none":
        return 1.0
    if by not in ("max", "sum"):
        raise InputError.of("normalisation", by, "must be 'max', 'sum' or 'none'", "Choose one of them.")
    size = float(np.max(values)) if by == "max" else math.fsum(values)
    if not size > 0.0 or not math.isfinite(float(np.max(np.abs(values))) / size):
        raise InputError.of(
            f"{by} of the curve", size, "must be above 0 to divide by", "Use normalisation 'none', or mend the curve."
        )
    return size


def colour_difference(lab_a: ArrayLike, lab_b: ArrayLike) -> FloatArray:
    """CIEDE2000 between CIE L*a*b* colours (Sharma, Wu & Dalal 2005; computed by colour-science).

    Parameters
    ----------
    lab_a, lab_b
        (..., 3) L* (0 to 100), a*, b*; both shapes broadcast.

    Returns
    -------
    FloatArray
        (...) difference; about 1 is just noticeable, below 2.3 is commonly called a match.

    Raises
    ------
    InputError
        If the last axis is not 3 long, or an entry is NaN or infinite.
    """
    given = {"lab_a": np.asarray(lab_a, dtype=np.float64), "lab_b": np.asarray(lab_b, dtype=np.float64)}
    for name, lab in given.items():
        if lab.ndim == 0 or lab.shape[-1] != 3:
            raise InputError.of(name, lab.shape, "must end in an axis of 3: L*, a*, b*", "Give L*a*b* colours.")
        if not np.isfinite(lab).all():
            raise InputError.of(name, "NaN or infinite", "every entry must be a finite number", "Mend the colours.")
    return ciede2000(*given.values())


def ciede2000(lab_a: FloatArray, lab_b: FloatArray) -> FloatArray:
    """`colour_difference` of (..., 3) arrays as they are: nothing is checked, NaN stays NaN."""
    with np.printoptions():  # colour-science sets them
        from colour.difference import delta_E_CIE2000
    return np.asarray(delta_E_CIE2000(lab_a, lab_b), dtype=np.float64)


@dataclass(frozen=True)
class Interval:
    """A metric with its bootstrap error.

    Attributes
    ----------
    estimate
        The metric on the data as given.
    standard_error
        Standard deviation over the resamples.
    low, high
        Percentile interval at `level`.
    bias
        Mean over the resamples minus the estimate. Noise lifts an RMSE and lowers a Pearson: where this is
        not small against the standard error, the noise is part of the estimate too.
    """

    estimate: float
    standard_error: float
    low: float
    high: float
    level: float
    bias: float
    resamples: int
    seed: int


def bootstrap_interval(
    metric: Callable[[FloatArray, FloatArray], float],
    values: ArrayLike,
    reference: ArrayLike,
    *,
    values_error: ArrayLike | None = None,
    reference_error: ArrayLike | None = None,
    reference_errors: ReferenceErrors = "independent",
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Interval:
    """Parametric bootstrap of a metric over Monte Carlo error and the reference's own (Efron & Tibshirani 1993, ch. 6).

    Each resample adds normal noise of the stated size to both curves and takes the metric anew. Whatever
    the metric should see of a normalisation belongs inside `metric`, so that it is redone each time.

    Parameters
    ----------
    metric
        Called as metric(values, reference).
    values, reference
        (N,) curves.
    values_error
        (N,) standard errors, or an (N, N) covariance where smoothing has tied the points together; 0 if not given.
    reference_error
        (N,) standard deviations of the reference, or an (N, N) covariance; 0 if not given.
    reference_errors
        "independent": each point its own draw. "common": one draw moves all points together, as a shared
        scale or calibration error does. Ignored where a covariance is given.
    level
        Coverage of the interval, within (0, 1).
    resamples
        At least 100.
    seed
        Seed of NumPy's PCG64.

    Raises
    ------
    InputError
        On a bad curve, error, level or number of resamples; and whatever `metric` raises on a resample.

    Examples
    --------
    >>> found = bootstrap_interval(rmse, [0.0, 0.0], [3.0, 4.0], values_error=[0.1, 0.1])
    >>> round(found.estimate, 4), abs(found.standard_error - 0.0707) < 0.004
    (3.5355, True)
    """
    a = _curve("values", values, at_least=1)
    b = _curve("reference", reference, at_least=1)
    if not 0.0 < level < 1.0:
        raise InputError.of("level", level, "must lie within (0, 1)", "Give 0.95, say.")
    if resamples < 100:
        raise InputError.of("resamples", resamples, "must be at least 100", "Give 1000 or more.")
    if reference_errors not in ("independent", "common"):
        raise InputError.of(
            "reference_errors", reference_errors, "must be 'independent' or 'common'", "Choose one of them."
        )
    generator = np.random.default_rng(seed)
    noise_a = _noise(generator, "values_error", values_error, len(a), resamples, common=False)
    noise_b = _noise(
        generator, "reference_error", reference_error, len(b), resamples, common=reference_errors == "common"
    )
    estimate = float(metric(a, b))
    drawn = np.array([metric(a + da, b + db) for da, db in zip(noise_a, noise_b, strict=True)], dtype=np.float64)
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2])
    return Interval(
        estimate,
        float(np.std(drawn, ddof=1)) if np.ptp(drawn) > 0 else 0.0,  # the mean of equal numbers is rounded
        float(low),
        float(high),
        level,
        float(np.mean(drawn)) - estimate,
        resamples,
        seed,
    )


def _noise(
    generator: np.random.Generator, name: str, error: ArrayLike | None, size: int, resamples: int, *, common: bool
) -> FloatArray:
    if error is None:
        return np.zeros((resamples, size))
    given = np.asarray(error, dtype=np.float64)
    if given.shape not in ((size,), (size, size)) or not np.isfinite(given).all():
        raise InputError.of(
            name, given.shape, f"must be finite, of shape ({size},) or ({size}, {size})", "Give one error a point."
        )
    if given.ndim == 1:
        if (given < 0).any():
            raise InputError.of(name, float(given.min()), "must not be negative", "Give standard errors.")
        draws = generator.standard_normal((resamples, 1 if common else size))
        return np.asarray(draws * given, dtype=np.float64)
    if not np.allclose(given, given.T, rtol=1e-9, atol=0.0):
        raise InputError.of(name, "asymmetric", "a covariance must be symmetric", "Mend the covariance.")
    # A smoothed curve's covariance is singular, so a root by eigenvalues and not by Cholesky.
    eigenvalues, vectors = np.linalg.eigh(given)
    if eigenvalues[0] < -1e-9 * max(float(eigenvalues[-1]), np.finfo(float).tiny):
        raise InputError.of(name, float(eigenvalues[0]), "a covariance has no eigenvalue below 0", "Mend it.")
    root = vectors * np.sqrt(np.clip(eigenvalues, 0.0, None))
    return np.asarray(generator.standard_normal((resamples, size)) @ root.T, dtype=np.float64)


def _standardised(name: str, x: FloatArray, w: FloatArray) -> FloatArray:
    live = x[w > 0]
    level = float(np.max(np.abs(live)))
    if float(np.ptp(live)) == 0.0:
        raise _no_pearson(name, 0.0, level, "constant")
    exponent = math.frexp(level)[1]
    # By a power of two, which rounds nothing.
    scaled = np.ldexp(np.where(w > 0, x, 0.0), -exponent)
    centred = scaled - np.sum(w * scaled)
    # The first mean is rounded; taking out what it left makes the second pass exact to rounding.
    centred = centred - np.sum(w * centred)
    spread = math.sqrt(float(np.sum(w * np.square(centred))))
    if spread <= NEARLY_CONSTANT:
        what = f"nearly constant (below {NEARLY_CONSTANT:g} of its level)"
        raise _no_pearson(name, math.ldexp(spread, exponent), level, what)
    return np.asarray(centred / spread, dtype=np.float64)


def _no_pearson(name: str, spread: float, level: float, what: str) -> InputError:
    return InputError.of(
        name,
        f"spread {spread:g}, level {level:g}",
        f"is {what}: it has no Pearson correlation",
        "Compare it by RMSE, or give a curve that varies.",
    )


def _curve(name: str, values: ArrayLike, *, at_least: int) -> FloatArray:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError.of(name, values, "must be numbers", "Give a one-dimensional list of numbers.") from error
    if array.ndim != 1:
        raise InputError.of(name, array.shape, "must be one-dimensional", "Give one number a wavelength.")
    if len(array) < at_least:
        raise InputError.of(name, f"{len(array)} points", f"at least {at_least} are needed", "Give more points.")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InputError.of(
            f"{name}[{bad[0]}]", float(array[bad[0]]), "must be a finite number", "Drop the point from both curves."
        )
    return array


def _pair(
    values: ArrayLike, reference: ArrayLike, weights: ArrayLike | None, *, at_least: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    a = _curve("values", values, at_least=at_least)
    b = _curve("reference", reference, at_least=at_least)
    if len(a) != len(b):
        raise InputError.of(
            "values", f"{len(a)} points", f"must be as long as the reference ({len(b)})", "Interpolate onto one grid."
        )
    if weights is None:
        return a, b, np.full(len(a), 1.0 / len(a))
    w = _curve("weights", weights, at_least=at_least)
    if len(w) != len(a) or (w < 0).any() or not w.sum() > 0:
        raise InputError.of(
            "weights", weights, f"must be {len(a)} numbers, none negative and not all 0", "Mend the weights."
        )
    return a, b, w / w.sum()
