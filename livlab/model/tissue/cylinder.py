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
from livlab.model.tissue.mie import sphere_arguments
from livlab.model.tissue.mie_series import ComplexArray
from livlab.units import FloatArray

MEAN_TOLERANCE = 1e-6
_FIRST_NODES = 32
_MAX_NODES = 8192


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
        """Mean cosine for unpolarised light; NaN where nothing is scattered."""
        turn = self.q_sca_tm * self.anisotropy_tm + self.q_sca_te * self.anisotropy_te
        total = self.q_sca_tm + self.q_sca_te
        return np.divide(turn, total, out=np.full_like(total, np.nan), where=total > 0.0)


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
        Of the broadcast shape. Without absorption q_ext is q_sca. The anisotropy of what does not scatter
        is NaN.

    Raises
    ------
    InputError
        If an argument is out of bounds or not finite.

    Examples
    --------
    >>> q = cylinder(1.55, 5.2128)
    >>> round(float(q.q_sca_tm), 4), round(float(q.q_sca_te), 4)
    (2.0972, 1.9278)
    """
    index, size = sphere_arguments(m, x)
    angle = np.asarray(zeta, dtype=np.float64)
    bad = ~((angle >= 0.0) & (angle <= 0.5 * math.pi))
    if bad.any():
        raise InputError.of("zeta", float(angle[bad].flat[0]), "must lie within [0, pi/2]", "Give it in radians.")
    index, size, angle = np.broadcast_arrays(index, size, angle)
    flat = [v.ravel() for v in (index, size, angle)]
    rows = _rows(flat[0], flat[1], np.sin(flat[2]), np.cos(flat[2]))
    return _collect(rows, index.shape)


def cylinder_mean(m: Any, x: Any) -> CylinderEfficiencies:
    """Efficiencies of infinite cylinders averaged over all directions of the axis, ∫ Q sin ζ dζ.

    Gauss's rule in ζ, doubled until extinction, scattering and anisotropy settle to 1e-6 of themselves (1e-4
    where 8192 angles do not reach that); below m = 1 the range is cut at the critical angle cos ζ = m.

    Parameters
    ----------
    m, x
        As in `cylinder`.

    Returns
    -------
    CylinderEfficiencies
        Of the broadcast shape; a large transparent cylinder has q_ext → π/2.

    Raises
    ------
    InputError
        As `cylinder`; also if the mean does not settle.

    Examples
    --------
    >>> q = cylinder_mean(1.5 / 1.35, [5.0, 29.7])
    >>> q.q_sca.round(4), q.anisotropy.round(4)
    (array([0.3843, 1.4749]), array([0.9331, 0.9781]))
    """
    index, size = sphere_arguments(m, x)
    shape = index.shape
    index, size = index.ravel(), size.ravel()
    found = np.full((index.size, 6), np.nan)
    todo = np.arange(index.size)
    before = found.copy()
    nodes = _FIRST_NODES
    while todo.size and nodes <= _MAX_NODES:
        batch = max(1, 400_000 // nodes)
        for at in range(0, todo.size, batch):
            chosen = todo[at : at + batch]
            found[chosen] = _mean_rows(index[chosen], size[chosen], nodes)
        last = nodes * 2 > _MAX_NODES
        settled = _settled(before[todo], found[todo], 100.0 * MEAN_TOLERANCE if last else MEAN_TOLERANCE)
        before[todo] = found[todo]
        todo = todo[~settled]
        nodes *= 2
    if todo.size:
        raise InputError.of(
            "m, x",
            (complex(index[todo[0]]), float(size[todo[0]])),
            f"the orientation mean does not settle with {_MAX_NODES} angles",
            "Take a smaller size parameter.",
        )
    return _collect(found, shape)


def bessel_pair(xi: FloatArray) -> FloatArray:
    """(N, 4) J0, Y0, J1, Y1 at ξ, as the kernels want them; 1, 0, 0, 0 at ξ = 0, where no kernel asks."""
    from scipy.special import j0, j1, y0, y1

    safe = np.where(xi > 0.0, xi, 1.0)
    return np.stack([j0(safe), y0(safe), j1(safe), y1(safe)], axis=-1)


@lru_cache(maxsize=32)
def _panels(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Gauss's rule on [-1, 1] in panels of at most 64 nodes: the plain rule of thousands costs minutes to make."""
    count = max(1, nodes // 64)
    t, w = np.polynomial.legendre.leggauss(min(nodes, 64))
    centres = (2.0 * np.arange(count) + 1.0) / count - 1.0
    return (centres[:, None] + t / count).ravel(), np.tile(w / count, count)


def gauss_angles(m: complex, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Angles ζ and weights (sin ζ included) for the mean over orientations, in one panel or two."""
    t, w = _panels(nodes)
    edges = [0.0, math.acos(m.real), 0.5 * math.pi] if m.real < 1.0 else [0.0, 0.5 * math.pi]
    zeta = np.concatenate([0.5 * (a + b) + 0.5 * (b - a) * t for a, b in zip(edges[:-1], edges[1:], strict=True)])
    weight = np.concatenate([0.5 * (b - a) * w for a, b in zip(edges[:-1], edges[1:], strict=True)])
    return zeta, weight * np.sin(zeta)


def _mean_rows(index: ComplexArray, size: FloatArray, nodes: int) -> FloatArray:
    rules = [gauss_angles(complex(m), nodes) for m in index]
    counts = [z.size for z, _ in rules]
    zeta, weight = (np.concatenate(part) for part in zip(*rules, strict=True))
    rows = _rows(np.repeat(index, counts), np.repeat(size, counts), np.sin(zeta), np.cos(zeta))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.asarray(np.add.reduceat(rows * weight[:, None], starts, axis=0))


def _settled(before: FloatArray, after: FloatArray, tolerance: float) -> Any:
    return (np.abs(after - before) <= tolerance * np.abs(after)).all(axis=1)


def _rows(index: ComplexArray, size: FloatArray, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """(N, 6) Q_ext, Q_sca and Q_sca g of cases I and II, one cylinder a row."""
    from livlab.model.tissue.cylinder_kernels import efficiencies

    inside = np.conj(index)
    contrast = (inside - 1.0) * (inside + 1.0)
    rows = efficiencies(contrast, size, sine, cosine, bessel_pair(size * sine))
    rows[:, 4:] = cosine[:, None] ** 2 * rows[:, 2:4] + sine[:, None] ** 2 * rows[:, 4:]
    clear = index.imag == 0.0
    rows[clear, :2] = rows[clear, 2:4]  # below x = 1e-6 the real part of b_n is lost to rounding
    return np.asarray(rows)


def _collect(rows: FloatArray, shape: tuple[int, ...]) -> CylinderEfficiencies:
    q_sca = rows[:, 2:4]
    g = np.divide(rows[:, 4:], q_sca, out=np.full_like(q_sca, np.nan), where=q_sca > 0.0)
    columns = [*rows[:, :4].T, *g.T]
    return CylinderEfficiencies(*(np.ascontiguousarray(c).reshape(shape) for c in columns))
