"""Scattering by an infinite circular cylinder at normal and oblique incidence, and its mean over orientations.

Bohren & Huffman 1983, section 8.4. Case I (TM): the electric field lies in the plane of axis and incident
direction; case II (TE): it is perpendicular to both. ζ is the angle between incident direction and axis, π/2
at normal incidence.

An efficiency is the cross section per length over the diameter, Q = C/(2 r L), at every ζ (Bohren & Huffman,
p. 203: W/(2 a L I)); the cylinder's shadow is 2 r L sin ζ, so a large cylinder has Q_ext → 2 sin ζ. For axes
in all directions alike the mean is ∫ Q sin ζ dζ over 0 … π/2, and fibres of volume fraction f_v and diameter d
scatter σ_s = 4 Q_sca f_v/(π d).

Conventions: m = n − ik relative to the medium (k ≥ 0 absorbs), x = 2π r n_medium/λ0.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.particles.sphere import sphere_arguments
from livlab.model.tissue.particles.sphere_series import ComplexArray
from livlab.model.tissue.phase.functions import Tabulated
from livlab.units import FloatArray

MEAN_TOLERANCE = 3e-5
"""Error allowed in a mean over orientations, as a share of the mean."""
_NARROWEST = 1e-9
_NOTHING = 1e-100
"""Stands for m² − 1 = 0: it scatters less than 1e-190, with the anisotropy of the limit."""
_MAX_PHASE_X = 500.0
_PHASE_TOLERANCE = 1e-4

# Kronrod's 15 points and weights on [−1, 1], and Gauss's weights at every other point (Piessens et al. 1983, QUADPACK).
_POINTS = np.array(
    [
        0.991455371120812639206854697526329,
        0.949107912342758524526189684047851,
        0.864864423359769072789712788640926,
        0.741531185599394439863864773280788,
        0.586087235467691130294144691258380,
        0.405845151377397166906606412076961,
        0.207784955007898467600689403773245,
        0.0,
    ]
)
_KRONROD = np.array(
    [
        0.022935322010529224963732008058970,
        0.063092092629978553290700663189204,
        0.104790010322250183839876322541518,
        0.140653259715525918745189590510238,
        0.169004726639267902826583426598550,
        0.190350578064785409913256402421014,
        0.204432940075298892414161999234649,
        0.209482141084727828012999174891714,
    ]
)
_GAUSS = np.array(
    [
        0.129484966168869693270611432679082,
        0.279705391489276667901467771423780,
        0.381830050505118944950369775488975,
        0.417959183673469387755102040816327,
    ]
)


class CylinderEfficiencies(NamedTuple):
    """Cross sections per length over the diameter, each of the broadcast shape of the arguments."""

    q_ext_tm: FloatArray
    """Extinction, case I."""
    q_ext_te: FloatArray
    """Extinction, case II."""
    q_sca_tm: FloatArray
    """Scattering, case I."""
    q_sca_te: FloatArray
    """Scattering, case II."""
    anisotropy_tm: FloatArray
    """Mean cosine of the scattering angle, case I."""
    anisotropy_te: FloatArray
    """Mean cosine of the scattering angle, case II."""

    @property
    def q_ext(self) -> FloatArray:
        """Extinction of unpolarised light."""
        return 0.5 * (self.q_ext_tm + self.q_ext_te)

    @property
    def q_sca(self) -> FloatArray:
        """Scattering of unpolarised light."""
        return 0.5 * (self.q_sca_tm + self.q_sca_te)

    @property
    def anisotropy(self) -> FloatArray:
        """Mean cosine for unpolarised light; 1 where nothing is scattered at all."""
        turn = self.q_sca_tm * self.anisotropy_tm + self.q_sca_te * self.anisotropy_te
        total = np.asarray(self.q_sca_tm + self.q_sca_te)
        return np.divide(turn, total, out=np.ones_like(total), where=total > 0.0)


def cylinder(m: Any, x: Any, zeta: Any = 0.5 * math.pi) -> CylinderEfficiencies:
    """Efficiencies of infinite cylinders (Bohren & Huffman 1983, eqs. 8.36, 8.37).

    Scattered light leaves on a cone about the axis, cos Θ = cos²ζ + sin²ζ cos φ.

    Parameters
    ----------
    m
        Index relative to the medium, n − ik with n > 0, k ≥ 0; any shape.
    x
        Size parameter, 0 < x ≤ 1e6; any shape that broadcasts with m.
    zeta
        Angle between incident direction and axis, 0 ≤ ζ ≤ π/2; any shape that broadcasts. At 0 the
        limit, no scattering.

    Returns
    -------
    CylinderEfficiencies
        Of the broadcast shape. Without absorption q_ext is q_sca. At m = 1 the efficiencies are
        below 1e-190 and the anisotropy is its limit; at ζ = 0 they are 0 and 1, the cone having closed.

    Raises
    ------
    InputError
        If an argument is out of bounds or not finite.

    Examples
    --------
    >>> q = cylinder(1.55, 5.2128)
    >>> round(float(q.q_sca_tm), 4), round(float(q.q_sca_te), 4)
    (2.0972, 1.9279)
    """
    index, size = sphere_arguments(m, x)
    angle = np.asarray(zeta, dtype=np.float64)
    bad = ~((angle >= 0.0) & (angle <= 0.5 * math.pi))
    if bad.any():
        raise InputError.of("zeta", float(angle[bad].flat[0]), "must lie within [0, pi/2]", "Give it in radians.")
    shape = np.broadcast_shapes(index.shape, angle.shape)
    angle = np.broadcast_to(angle, shape).ravel()
    index, size = np.broadcast_to(index, shape).ravel(), np.broadcast_to(size, shape).ravel()
    return _collect(_rows(index, size, np.sin(angle), np.cos(angle)), shape)


def cylinder_mean(m: Any, x: Any) -> CylinderEfficiencies:
    """Efficiencies of infinite cylinders averaged over all directions of the axis, ∫ Q sin ζ dζ.

    Adaptive Gauss–Kronrod rule in ζ, halving where the two rules differ by more than 3e-5 of the mean. A
    transparent cylinder denser than its medium guides light and has ever narrower resonances in ζ; those the
    rule does not see leave an error of about 1e-5 to 1e-4 (measured at m = 1.5, x = 30 … 100). Elsewhere it is
    below 1e-6.

    Parameters
    ----------
    m, x
        As in `cylinder`.

    Returns
    -------
    CylinderEfficiencies
        Of the broadcast shape; a large cylinder has q_ext → π/2.

    Raises
    ------
    InputError
        As `cylinder`.

    Examples
    --------
    >>> q = cylinder_mean(1.5 / 1.35, [5.0, 29.7])
    >>> q.q_sca.round(3), q.anisotropy.round(3)
    (array([0.919, 1.195]), array([0.958, 0.949]))
    """
    index, size = sphere_arguments(m, x)
    rows = np.array([_mean_row(complex(a), float(b)) for a, b in zip(index.ravel(), size.ravel(), strict=True)])
    return _collect(rows.reshape(-1, 6), index.shape)


def cylinder_phase(m: complex, x: float) -> Tabulated:
    """Phase function of infinite cylinders with axes in all directions alike, for unpolarised light.

    See `livlab.model.tissue.particles.cylinder_cone`. It grows as 1/sin(Θ/2) towards Θ = 0; the table follows it
    down to 1e-5 of 1/x and keeps the mass of its first cell. Angles are doubled until its
    anisotropy agrees with that of `cylinder_mean` to 1e-4. Results are cached.

    Parameters
    ----------
    m, x
        As in `cylinder`, scalars, x ≤ 500 (about 0.1 s at 30, a minute at 500).

    Raises
    ------
    InputError
        As `cylinder`, and if m or x is no scalar or x is above 500.

    Examples
    --------
    >>> phase = cylinder_phase(1.5 / 1.35, 29.7)
    >>> abs(phase.anisotropy - float(cylinder_mean(1.5 / 1.35, 29.7).anisotropy)) < 1e-4
    True
    """
    index, size = sphere_arguments(m, x)
    if index.ndim:
        raise InputError.of("m, x", index.shape, "must be scalars", "Call once for each cylinder.")
    if size > _MAX_PHASE_X:
        raise InputError.of("x", float(size), f"must be <= {_MAX_PHASE_X:g} for a phase function", "Use a thinner one.")
    return _phase(complex(index), float(size))


@lru_cache(maxsize=512)
def _phase(m: complex, x: float) -> Tabulated:
    from livlab.model.tissue.particles.cylinder_cone import orientation_table

    g = float(cylinder_mean(m, x).anisotropy)
    table: Tabulated = orientation_table(m.conjugate(), x, 0)
    for level in range(1, 4):
        if abs(table.anisotropy - g) <= _PHASE_TOLERANCE:
            break
        table = orientation_table(m.conjugate(), x, level)
    return table


@lru_cache(maxsize=32)
def _panels(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Gauss's rule on [-1, 1] in panels of at most 64 nodes: the plain rule of thousands costs minutes to make."""
    count = max(1, nodes // 64)
    t, w = np.polynomial.legendre.leggauss(min(nodes, 64))
    centres = (2.0 * np.arange(count) + 1.0) / count - 1.0
    return (centres[:, None] + t / count).ravel(), np.tile(w / count, count)


def _mean_row(m: complex, x: float) -> FloatArray:
    points = np.concatenate([-_POINTS[:-1], _POINTS[::-1]])
    kronrod = np.concatenate([_KRONROD[:-1], _KRONROD[::-1]])[:, None]
    gauss = np.zeros((15, 1))
    gauss[1::2, 0] = np.concatenate([_GAUSS[:-1], _GAUSS[::-1]])
    edges = np.linspace(0.0, 0.5 * math.pi, 1 + min(256, 8 + int(0.5 * x)))
    if m.real < 1.0:  # total reflection begins at cos ζ = m
        edges = np.unique(np.append(edges, math.acos(m.real)))
    low, high = edges[:-1], edges[1:]
    total = np.zeros(6)
    while low.size:
        half = 0.5 * (high - low)[:, None]
        zeta = (0.5 * (low + high)[:, None] + half * points).ravel()
        m_here, x_here = np.full(zeta.size, m, dtype=np.complex128), np.full(zeta.size, x, dtype=np.float64)
        rows = _rows(m_here, x_here, np.sin(zeta), np.cos(zeta))
        values = (rows * np.sin(zeta)[:, None]).reshape(low.size, 15, 6)
        fine = half * (values * kronrod).sum(axis=1)
        error = np.abs(fine - half * (values * gauss).sum(axis=1))
        allowed = MEAN_TOLERANCE * np.abs(total + fine.sum(axis=0)) * half * (4.0 / math.pi)
        again = (error > allowed).any(axis=1) & (high - low > _NARROWEST)
        total = total + fine[~again].sum(axis=0)
        middle = 0.5 * (low + high)[again]
        low, high = np.concatenate([low[again], middle]), np.concatenate([middle, high[again]])
    return total


def _rows(index: ComplexArray, size: FloatArray, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """(N, 6) Q_ext, Q_sca and Q_sca g of cases I and II, one cylinder a row."""
    from livlab.model.tissue.particles.cylinder_kernels import bessel_pair, efficiencies

    contrast: ComplexArray = np.conj((index - 1.0) * (index + 1.0)).astype(np.complex128)
    contrast[contrast == 0.0] = _NOTHING
    rows = efficiencies(contrast, size, sine, cosine, bessel_pair(size * sine))
    rows[:, 4:] = cosine[:, None] ** 2 * rows[:, 2:4] + sine[:, None] ** 2 * rows[:, 4:]
    clear = index.imag == 0.0
    rows[clear, :2] = rows[clear, 2:4]  # below x = 1e-6 the real part of b_n is lost to rounding
    return np.asarray(rows)


def _collect(rows: FloatArray, shape: tuple[int, ...]) -> CylinderEfficiencies:
    q_sca = rows[:, 2:4]
    g = np.divide(rows[:, 4:], q_sca, out=np.ones_like(q_sca), where=q_sca > 0.0)
    columns = [*rows[:, :4].T, *g.T]
    return CylinderEfficiencies(*(np.ascontiguousarray(c).reshape(shape) for c in columns))
