"""What the thesis does to a measured spectrum: interpolate, smooth, normalise; errors carried along exactly.

Interpolation and smoothing are matrices M, so a covariance C becomes M C Mᵀ with nothing neglected.
Normalisation divides by a number that is itself uncertain; its Jacobian is used (delta method, first order).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError, RangeError
from livlab.metrics import Normalisation, divisor
from livlab.units import FloatArray

Alignment = Literal["centred", "left", "right"]
"""Where an even window lies about its position i, for window 4:
centred: i−2 … i+2 with weights ½ 1 1 1 ½, the mean of the two below, which shifts nothing;
left: i−2 … i+1, as NumPy's and SciPy's convolutions place it, which moves the curve half a position up in wavelength;
right: i−1 … i+2, half a position down."""


@dataclass(frozen=True)
class Curve:
    """A spectrum with the covariance of its errors.

    Attributes
    ----------
    wavelength_nm
        (N,) strictly rising.
    value
        (N,) the curve.
    covariance
        (N, N) covariance of its errors; diagonal for Monte Carlo points, which are independent.
    """

    wavelength_nm: FloatArray
    value: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        check_grid("wavelength_nm", self.wavelength_nm)
        n = len(self.wavelength_nm)
        for name, array, shape in (("value", self.value, (n,)), ("covariance", self.covariance, (n, n))):
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError.of(name, array.shape, f"must be finite numbers of shape {shape}", "Mend the curve.")

    @classmethod
    def of(cls, wavelength_nm: ArrayLike, value: ArrayLike, standard_error: ArrayLike | None = None) -> Curve:
        """A curve whose points have independent errors (none if not given)."""
        grid, level = np.asarray(wavelength_nm, dtype=np.float64), np.asarray(value, dtype=np.float64)
        error = np.zeros_like(level) if standard_error is None else np.asarray(standard_error, dtype=np.float64)
        if error.shape != level.shape or not np.isfinite(error).all() or (error < 0).any():
            raise InputError.of(
                "standard_error", error.shape, f"must be {len(level)} finite numbers ≥ 0", "Give one a point."
            )
        return cls(grid, level, np.diag(np.square(error)))

    @property
    def standard_error(self) -> FloatArray:
        """(N,) standard errors: the root of the covariance's diagonal."""
        return np.sqrt(np.clip(np.diagonal(self.covariance), 0.0, None))

    def transformed(self, matrix: FloatArray, wavelength_nm: FloatArray) -> Curve:
        """The curve M v on another grid, with covariance M C Mᵀ."""
        return Curve(wavelength_nm, matrix @ self.value, matrix @ self.covariance @ matrix.T)


def regular_grid(start_nm: float, stop_nm: float, step_nm: float) -> FloatArray:
    """Wavelengths from start to stop, both included; the step must divide the band.

    >>> regular_grid(500, 520, 5)
    array([500., 505., 510., 515., 520.])
    """
    if not (np.isfinite([start_nm, stop_nm, step_nm]).all() and step_nm > 0 and stop_nm > start_nm):
        raise InputError.of("band", (start_nm, stop_nm, step_nm), "must rise by a step above 0", "Mend the band.")
    count = (stop_nm - start_nm) / step_nm
    if abs(count - round(count)) > 1e-6:
        raise InputError.of(
            "step_nm", step_nm, f"must divide the band {start_nm:g}–{stop_nm:g} nm evenly", "Choose another step."
        )
    return np.linspace(start_nm, stop_nm, round(count) + 1)


def interpolation_matrix(from_nm: ArrayLike, to_nm: ArrayLike) -> FloatArray:
    """(M, N) matrix of the linear interpolation from N wavelengths onto M others.

    Raises
    ------
    RangeError
        If a new wavelength lies outside the old ones: nothing is extrapolated.
    InputError
        If the old wavelengths do not rise strictly.

    Examples
    --------
    >>> interpolation_matrix([500, 520], [505])
    array([[0.75, 0.25]])
    """
    old, new = np.asarray(from_nm, dtype=np.float64), np.asarray(to_nm, dtype=np.float64)
    check_grid("from_nm", old)
    if new.ndim != 1 or not np.isfinite(new).all():
        raise InputError.of("to_nm", new.shape, "must be a list of finite wavelengths", "Mend the wavelengths.")
    outside = (new < old[0]) | (new > old[-1])
    if outside.any():
        raise RangeError.of(
            "wavelength_nm",
            float(new[outside][0]),
            f"must lie within {old[0]:g}–{old[-1]:g} nm",
            "Ask inside the measured band.",
        )
    matrix = np.zeros((len(new), len(old)))
    if len(old) == 1:
        return np.ones_like(matrix)
    below = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 2)
    share = (new - old[below]) / (old[below + 1] - old[below])
    rows = np.arange(len(new))
    matrix[rows, below] = 1.0 - share
    matrix[rows, below + 1] += share
    return matrix


def moving_average_matrix(size: int, window: int = 4, alignment: Alignment = "centred") -> FloatArray:
    """(N, N) matrix of a moving average over `window` positions.

    Rows sum to 1 everywhere: at the ends the window keeps the positions that exist and their weights are
    raised to match, so a constant stays constant (a plain convolution pads with zeros and darkens the ends).
    An odd window is centred under every alignment.

    Raises
    ------
    InputError
        If the window is not within 1 … size, or the alignment is unknown.

    Examples
    --------
    >>> moving_average_matrix(6, 4)[2] * 8
    array([1., 2., 2., 2., 1., 0.])
    """
    if not 1 <= window <= size:
        raise InputError.of("window", window, f"must lie within 1 … {size}, the curve's length", "Narrow the window.")
    if alignment not in ("centred", "left", "right"):
        raise InputError.of("alignment", alignment, "must be 'centred', 'left' or 'right'", "Choose one of them.")
    half = window // 2
    weights = dict.fromkeys(range(-half, half + 1), 1.0)
    if window % 2 == 0:
        ends = {"centred": (0.5, 0.5), "left": (1.0, 0.0), "right": (0.0, 1.0)}[alignment]
        weights[-half], weights[half] = ends
    matrix = np.zeros((size, size))
    for offset, weight in weights.items():
        matrix += weight * np.eye(size, k=offset)
    return np.asarray(matrix / matrix.sum(axis=1, keepdims=True), dtype=np.float64)


def interpolate(curve: Curve, wavelength_nm: ArrayLike) -> Curve:
    """Linear interpolation onto other wavelengths; errors as `interpolation_matrix`."""
    new = np.asarray(wavelength_nm, dtype=np.float64)
    return curve.transformed(interpolation_matrix(curve.wavelength_nm, new), new)


def moving_average(curve: Curve, window: int = 4, alignment: Alignment = "centred") -> Curve:
    """Moving average over positions of a regular grid; errors as `moving_average_matrix`.

    Raises
    ------
    InputError
        If the wavelengths are not regular: a window counted in positions would change its width along the curve.
    """
    steps = np.diff(curve.wavelength_nm)
    if steps.size and np.ptp(steps) > 1e-6 * steps.mean():
        raise InputError.of(
            "wavelength_nm", "irregular", "a window of positions needs a regular grid", "Interpolate onto one first."
        )
    return curve.transformed(moving_average_matrix(len(curve.value), window, alignment), curve.wavelength_nm)


def normalise(curve: Curve, by: Normalisation = "max") -> Curve:
    """Divide by the maximum, the sum or nothing, with J C Jᵀ for the covariance.

    J = (I − y eᵀ)/s with y the normalised curve and s = eᵀv: e picks the largest point, or adds all. The
    largest point so becomes 1 exactly, without error, and its error passes to all others. The maximum of a
    noisy curve is biased upwards by up to its standard error, so that error should be small.

    Raises
    ------
    InputError
        If the divisor is not above 0.
    """
    size = divisor(curve.value, by)
    n = len(curve.value)
    if by == "none":
        return curve
    picks = np.ones(n) if by == "sum" else np.eye(n)[int(np.argmax(curve.value))]
    scaled = curve.value / size
    jacobian = (np.eye(n) - np.outer(scaled, picks)) / size
    return Curve(curve.wavelength_nm, scaled, jacobian @ curve.covariance @ jacobian.T)


def thesis_curve(
    curve: Curve,
    *,
    step_nm: float = 5.0,
    window: int = 4,
    alignment: Alignment = "centred",
    by: Normalisation = "max",
) -> Curve:
    """Interpolate linearly, average over a window of 4 positions, normalise (Nunes 2019, section 7.1).

    The thesis names neither the finer grid nor where an even window lies. Assumed here: 5 nm, so that four
    positions span one of its 20 nm sampling intervals, and a centred window, which shifts nothing.

    Parameters
    ----------
    curve
        As measured.
    step_nm
        Spacing of the finer grid, which must divide the band.
    window, alignment
        See `moving_average_matrix`; window 1 smooths nothing.
    by
        Normalisation.

    Raises
    ------
    InputError
        From any of the three steps.
    """
    grid = regular_grid(float(curve.wavelength_nm[0]), float(curve.wavelength_nm[-1]), step_nm)
    return normalise(moving_average(interpolate(curve, grid), window, alignment), by)


def check_grid(name: str, wavelength_nm: FloatArray) -> None:
    """Refuse wavelengths that are not finite, above 0 and strictly rising."""
    if wavelength_nm.ndim != 1 or wavelength_nm.size == 0:
        raise InputError.of(name, wavelength_nm.shape, "must be a non-empty list of wavelengths", "Give some.")
    if not (np.isfinite(wavelength_nm).all() and wavelength_nm[0] > 0 and (np.diff(wavelength_nm) > 0).all()):
        raise InputError.of(name, wavelength_nm, "must rise strictly and be finite and above 0", "Sort and mend them.")
