"""Lorenz–Mie scattering by a homogeneous sphere, for size parameters from 1e-8 to 1e5 and beyond.

Three ways lead to the coefficients a_n, b_n: a power series below x = 0.1, a recurrence that does not
cancel near m = 1, and miepython (compiled) everywhere else.

Conventions: m = n − ik relative to the medium (k ≥ 0 absorbs), x = 2π r n_medium/λ0. Efficiencies are cross
sections over π r² (Bohren & Huffman 1983, eqs. 4.61, 4.62, 4.82).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.particles.sphere_series import (
    SMALL_MX,
    SMALL_X,
    ComplexArray,
    MieCoefficients,
    small_coefficients,
)
from livlab.model.tissue.phase.functions import Tabulated
from livlab.units import FloatArray

MAX_X = 1e6
MATCHED = 1e-3
"""Contrast |m − 1| below which the cancellation-free recurrence replaces miepython."""
MIN_ANGLES = 360
ANGLES_PER_X = 4.0 * math.pi
_DOUBLINGS = 5
_PEER_SERIES = 0.11


class MieEfficiencies(NamedTuple):
    """Efficiencies of a sphere, each of the broadcast shape of m and x."""

    q_ext: FloatArray
    """Extinction cross section over π r²."""
    q_sca: FloatArray
    """Scattering cross section over π r²."""
    q_back: FloatArray
    """Radar backscattering cross section over π r², 4π |dC/dΩ(180°)|/(π r²)."""
    anisotropy: FloatArray
    """Mean cosine g; its limit where nothing scatters (m = 1)."""


def size_parameter(radius_mm: Any, wavelength_nm: Any, n_medium: Any = 1.0) -> FloatArray:
    """Size parameter x = 2π r n_medium/λ0 (Nunes 2019, eq. 3.11; Bohren & Huffman 1983, ch. 4).

    >>> round(float(size_parameter(1.75e-3, 500.0, 1.35)), 3)
    29.688
    """
    return np.asarray(2e6 * np.pi * np.asarray(radius_mm) * np.asarray(n_medium) / np.asarray(wavelength_nm))


def mie(m: Any, x: Any) -> MieEfficiencies:
    """Efficiencies and anisotropy of spheres (Bohren & Huffman 1983, eqs. 4.61, 4.62, 4.82 and p. 120).

    Parameters
    ----------
    m
        Index relative to the medium, n − ik with n > 0, k ≥ 0; any shape.
    x
        Size parameter, 0 < x ≤ 1e6; any shape that broadcasts with m.

    Returns
    -------
    MieEfficiencies
        q_ext, q_sca, q_back, anisotropy of the broadcast shape. Relative accuracy about 1e-13 below
        x = 0.1, 1e-7 elsewhere (the truncation of the series).

    Raises
    ------
    InputError
        If m or x is out of bounds or not finite.

    Examples
    --------
    >>> q = mie(1.5 - 1j, [1.0, 100.0])
    >>> q.q_ext.round(6), q.anisotropy.round(6)
    (array([2.336321, 2.097502]), array([0.192136, 0.850252]))
    """
    index, size = sphere_arguments(m, x)
    shape = index.shape
    index, size = index.ravel(), size.ravel()
    out = np.empty((4, size.size))
    small = _is_small(index, size)
    if small.any():
        out[:, small] = _efficiencies(small_coefficients(np.conj(index[small]), size[small]), index[small], size[small])
    near = ~small & (np.abs(index - 1.0) < MATCHED)
    for k in np.flatnonzero(near):
        one = slice(k, k + 1)
        out[:, one] = _efficiencies(_matched(index[k], size[k]), index[one], size[one])
    rest = ~small & ~near
    # There miepython itself would take its series for small spheres, whatever x is.
    hollow = rest & (np.abs(index) * size < _PEER_SERIES)
    for k in np.flatnonzero(hollow):
        one = slice(k, k + 1)
        out[:, one] = _efficiencies(_coefficients(complex(index[k]), float(size[k])), index[one], size[one])
    rest = np.flatnonzero(rest & ~hollow)
    if rest.size:
        single_sphere = _miepython().single_sphere
        for k in rest:
            out[:, k] = single_sphere(complex(index[k]), float(size[k]), 0, True)
    q_ext, q_sca, q_back, g = (np.asarray(row.reshape(shape)) for row in out)
    return MieEfficiencies(q_ext, q_sca, q_back, g)


def vacuum_efficiency(q: Any, n_medium: Any) -> FloatArray:
    """What Nunes 2019, eq. 6.5 gives with the vacuum wavenumber of eq. 6.6: Q n_medium².

    Q = 1/(k² r²) ∫ (|S1|² + |S2|²) sin θ dθ is an efficiency with k in the medium; the vacuum's k is smaller by
    n_medium. Kept as an option of the thesis's reading.
    """
    return np.asarray(np.asarray(q) * np.asarray(n_medium) ** 2)


def mie_phase(m: complex, x: float, n_angles: int | None = None) -> Tabulated:
    """Phase function of a sphere for unpolarised light, (|S1|² + |S2|²)/(2π x² Q_sca), as a table.

    Points lie a quarter of 1/x apart, half a degree at most, and closer in the forward lobe (`peaked_grid`):
    they follow lobe and ripple. They are doubled until the table's anisotropy agrees with that of the
    coefficients to 2e-5. Results are cached.

    Parameters
    ----------
    m, x
        As in `mie`, scalars. Time and memory grow as x² and x: 0.1 s at 1000, some seconds at 10⁴.
    n_angles
        Fixed number of angles from 0 to 180°, at least 2; None chooses.

    Raises
    ------
    InputError
        As `mie`, and if n_angles is below 2.

    Examples
    --------
    >>> phase = mie_phase(1.5 / 1.35, 29.7)
    >>> abs(phase.anisotropy - float(mie(1.5 / 1.35, 29.7).anisotropy)) < 2e-5
    True
    """
    if n_angles is not None and n_angles < 2:
        raise InputError.of("n_angles", n_angles, "must be >= 2", "Leave it out to have it chosen.")
    index, size = sphere_arguments(m, x)
    if index.ndim:
        raise InputError.of("m, x", index.shape, "must be scalars", "Call once for each sphere.")
    return _phase(complex(index), float(size), n_angles)


def mie_intensity(m: complex, x: float, cos_theta: Any) -> FloatArray:
    """Unpolarised intensity (|S1|² + |S2|²)/2 at the given cosines (Bohren & Huffman 1983, eq. 4.77).

    Its integral over the sphere is π x² Q_sca. Raises `InputError` as `mie`.
    """
    from livlab.model.tissue.particles.sphere_kernels import intensity

    index, size = sphere_arguments(m, x)
    made = _coefficients(complex(index), float(size))
    w = 1.0 - np.asarray(cos_theta, dtype=np.float64)
    value = intensity(made.a.ravel(), made.b.ravel(), w.ravel()) * abs(made.scale[0]) ** 2
    return np.asarray(value).reshape(w.shape)


def sphere_arguments(m: Any, x: Any) -> tuple[ComplexArray, FloatArray]:
    """Index and size parameter as broadcast arrays, or an `InputError` naming what is wrong."""
    index, size = np.broadcast_arrays(np.asarray(m, dtype=np.complex128), np.asarray(x, dtype=np.float64))
    _refuse("m", index, ~(np.isfinite(index) & (index.real > 0.0)), "must be finite with a real part > 0", "Mend it.")
    _refuse("m", index, index.imag > 0.0, "must be n - ik with k >= 0", "Change the sign of the imaginary part.")
    _refuse("x", size, ~((size > 0.0) & (size <= MAX_X)), f"must lie in (0, {MAX_X:g}]", "Check radius and wavelength.")
    return index, size


def _refuse(field: str, values: Any, bad: Any, bound: str, remedy: str) -> None:
    if np.any(bad):
        raise InputError.of(field, values[bad].flat[0].item(), bound, remedy)


def _is_small(index: ComplexArray, size: FloatArray) -> Any:
    return (size < SMALL_X) & (np.abs(index) * size < SMALL_MX)


def _matched(m: complex, x: float) -> MieCoefficients:
    from livlab.model.tissue.particles.sphere_kernels import matched_coefficients

    contrast = complex(m - 1.0).conjugate()
    a, b = matched_coefficients(contrast, float(x))
    return MieCoefficients(a[None, :], b[None, :], np.array([contrast]))


def _coefficients(m: complex, x: float) -> MieCoefficients:
    index, size = np.array([m]), np.array([x])
    if _is_small(index, size)[0]:
        return small_coefficients(np.conj(index), size)
    if abs(m - 1.0) < MATCHED:
        return _matched(m, x)
    # miepython hands a_n and b_n out with the sign of exp(−iωt), whatever the sign of k.
    a, b = _miepython().an_bn(complex(m), float(x), 0)
    return MieCoefficients(a[None, :], b[None, :], np.ones(1, dtype=np.complex128))


def _efficiencies(made: MieCoefficients, m: ComplexArray, x: FloatArray) -> FloatArray:
    """Rows q_ext, q_sca, q_back, g from coefficients along the last axis."""
    a, b, scale = made
    n = np.arange(1, a.shape[-1] + 1)
    norm = np.abs(scale) ** 2 / x**2
    power = ((2 * n + 1) * (np.abs(a) ** 2 + np.abs(b) ** 2)).sum(axis=-1)
    q_sca = 2.0 * norm * power
    q_ext = 2.0 / x**2 * (scale[:, None] * (2 * n + 1) * (a + b)).real.sum(axis=-1)
    q_ext = np.where(m.imag == 0.0, q_sca, q_ext)
    q_back = norm * np.abs(((2 * n + 1) * (-1.0) ** n * (a - b)).sum(axis=-1)) ** 2
    same = n[:-1] * (n[:-1] + 2) / (n[:-1] + 1)
    cross = (2 * n + 1) / (n * (n + 1))
    turn = (same * (a[:, :-1] * a[:, 1:].conj() + b[:, :-1] * b[:, 1:].conj()).real).sum(axis=-1)
    turn = turn + (cross * (a * b.conj()).real).sum(axis=-1)
    return np.array([q_ext, q_sca, q_back, 2.0 * turn / power])


@lru_cache(maxsize=512)
def _phase(m: complex, x: float, n_angles: int | None) -> Tabulated:
    from livlab.model.tissue.particles.sphere_kernels import intensity

    made = _coefficients(m, x)
    a, b = made.a.ravel(), made.b.ravel()

    def table(count: int) -> Tabulated:
        w = peaked_grid(count, x)
        return Tabulated.from_complement(w, intensity(a, b, w))

    if n_angles is not None:
        return table(n_angles)
    g = float(_efficiencies(made, np.array([m]), np.array([x]))[3, 0])
    return finest(table, x, g)


def peaked_grid(count: int, x: float) -> FloatArray:
    """1 − cos θ at `count` scattering angles from 0 to 180°, closer in the forward lobe.

    A table linear in cos θ overrates a convex peak by h² p(0)/6, h being the step in θ there. The map
    θ = s − (1 − c) L tanh(s/L) of equal steps in s makes that step c = 1/8 of the others, the change spread
    over L = 80/x (1 at most), some twenty lobes.
    """
    width = 80.0 / max(x, 80.0)
    end = math.pi
    for _ in range(50):  # s at 180°
        end = math.pi + 0.875 * width * math.tanh(end / width)
    s = np.linspace(0.0, end, count)
    theta = s - 0.875 * width * np.tanh(s / width)
    w = 2.0 * np.sin(0.5 * theta) ** 2
    w[-1] = 2.0
    return w


def finest(table: Callable[[int], Tabulated], x: float, g: float, tolerance: float = 2e-5) -> Tabulated:
    """The first of ever finer tables whose anisotropy meets g; the finest if none does."""
    count = 281 + max(MIN_ANGLES, math.ceil(ANGLES_PER_X * x))  # 280 points more make the lobe's finer steps
    made = table(count)
    for _ in range(_DOUBLINGS):
        if abs(made.anisotropy - g) <= tolerance:
            break
        count = 2 * count - 1
        made = table(count)
    return made


class _Library(NamedTuple):
    single_sphere: Callable[..., tuple[float, float, float, float]]
    an_bn: Callable[..., tuple[ComplexArray, ComplexArray]]
    is_compiled: bool


@lru_cache(maxsize=1)
def _miepython() -> _Library:
    """The library's compiled kernels, taken from their own module.

    The package itself chooses between plain and compiled kernels once, by an environment variable at its first
    import, which may have happened elsewhere. Where numba can write its cache nowhere the compiled module cannot
    be imported; then the plain kernels serve, a hundred times slower, with a warning.
    """
    import warnings

    import miepython

    try:
        with _kept_kernels():
            from miepython import mie_jit

        return _Library(mie_jit._single_sphere_nb, mie_jit._an_bn_nb, True)
    except (ImportError, AttributeError, RuntimeError) as trouble:
        warnings.warn(f"miepython runs uncompiled: {trouble}", UserWarning, stacklevel=2)
        return _Library(miepython.single_sphere, miepython.an_bn, False)


@contextmanager
def _kept_kernels() -> Iterator[None]:
    """While this lasts, what numba compiles is kept on disk unless it is told not to.

    One kernel of miepython's, which is not even needed here, does not ask for it, and took each process that
    imports them 1.5 s.
    """
    import numba

    njit = numba.njit
    numba.njit = lambda *signature, **options: njit(*signature, **{"cache": True, **options})
    try:
        yield
    finally:
        numba.njit = njit
