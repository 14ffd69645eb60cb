"""Matrices of plane layers on the nodes of a `quadrature.AngularGrid`: a thin layer, doubled, and stacks added.

Entry [i, j] of a matrix is the flux that leaves in node i for unit flux that enters in node j, so column
sums are energy and a beam without width is simply a column. Absorption is carried along as a row of its
own and never formed as 1 − R − T: each loss keeps its own digits, at albedo 1 − 1e-9 as at 1e-9, and at
an optical depth of 1e6.

Sources: van de Hulst 1980, ch. 4 (doubling); Grant & Hunt 1969 (discrete space theory); Grassmann,
Taksar & Heyman 1985 (elimination without subtraction).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgesv, dgetrs

from livlab.model.transport.fresnel import fresnel
from livlab.model.transport.quadrature import AngularGrid, legendre_table
from livlab.units import FloatArray

_NEARLY_CLOSED = 1e-3
"""Below this loss a round trip's matrix is near singular: eliminate without subtraction."""


@dataclass(frozen=True)
class Below:
    """Everything below a level, seen from the medium there.

    Attributes
    ----------
    reflectance
        (nodes, nodes) of the medium.
    transmittance
        (nodes of the lowest medium, nodes): flux that leaves downwards.
    absorbed
        (layers below, nodes): flux each layer keeps.
    """

    reflectance: FloatArray
    transmittance: FloatArray
    absorbed: FloatArray

    @property
    def lost(self) -> FloatArray:
        """(nodes,) what does not come back up."""
        lost: FloatArray = self.transmittance.sum(axis=0) + self.absorbed.sum(axis=0)
        return lost


def redistribution(grid: AngularGrid, n: float, moments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forward and backward scattering matrices: share of light scattered out of node j that goes into i.

    S± = Σ_l (±1)^l (l + ½) χ_l V_l V_lᵀ over the nodes' solid angles. What quadrature leaves of the column
    sums is put on the forward diagonal, so that scattering conserves energy to rounding.

    Parameters
    ----------
    grid, n
        The nodes and the medium's index (a break of the grid).
    moments
        χ_0 … χ_L of the phase function, χ_0 = 1.
    """
    table = legendre_table(grid, n, len(moments) - 1)
    weighted = (np.arange(len(moments)) + 0.5) * moments
    even = (table[::2].T * weighted[::2]) @ table[::2]
    odd = (table[1::2].T * weighted[1::2]) @ table[1::2]
    active = grid.active(n)
    solid = grid.flux()[active] / (n * n * grid.cosines(n))
    beam = active == 0
    solid[beam] = 1.0
    forward, backward = (even + odd) / solid, (even - odd) / solid
    forward[beam], backward[beam] = 0.0, 0.0
    forward[np.diag_indices(len(active))] += 1.0 - forward.sum(axis=0) - backward.sum(axis=0)
    return forward, backward


def homogeneous_layer(
    mu: FloatArray, forward: FloatArray, backward: FloatArray, absorption: float, scattering: float, thickness: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reflection, transmission and absorption of one layer without its surfaces.

    Parameters
    ----------
    mu
        (N,) cosines of the nodes in the layer.
    forward, backward
        (N, N) from `redistribution`.
    absorption, scattering
        µ_a, µ_s in 1/mm.
    thickness
        mm; inf gives the half-space: T = 0, and R → 1 with no absorption.

    Returns
    -------
    reflectance, transmittance, absorbed
        (N, N), (N, N), (N,); the layer looks the same from both sides.
    """
    size = len(mu)
    extinction = absorption + scattering
    if extinction == 0.0:
        return np.zeros((size, size)), np.eye(size), np.zeros(size)
    if scattering == 0.0:
        depth = extinction * thickness / mu
        return np.zeros((size, size)), np.diag(np.exp(-depth)), -np.expm1(-depth)
    albedo, loss = scattering / extinction, absorption / extinction
    depth_total = extinction * thickness
    thin = 2.0 * float(mu.min())
    if math.isinf(depth_total):
        doublings = 200
    else:
        doublings = max(0, math.ceil(math.log2(depth_total / thin))) if depth_total > 0 else 0
        thin = math.ldexp(depth_total, -doublings)
    R, T, a = _thin_layer(mu, forward, backward, albedo, loss, thin)
    for _ in range(doublings):
        passed = T.sum(axis=0)
        if math.isinf(depth_total) and passed.max() < 1e-16:
            break
        inner = _round_trips(R @ R, (passed + a) @ R + (passed + a), T)
        back = R @ inner
        a = a + a @ inner + a @ back
        R = R + T @ back
        T = T @ inner
    if math.isinf(depth_total):
        T = np.zeros_like(T)
    return R, T, a


def _thin_layer(
    mu: FloatArray, forward: FloatArray, backward: FloatArray, albedo: float, loss: float, depth: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A layer thin enough for power series, exact to rounding: the matrix exponential by parity.

    With A = (1 − ω S⁺)/µ and B = ω S⁻/µ, light that enters equally from both sides obeys
    S″ = (A + B)(A − B) S, light that enters with opposite signs the same with the factors swapped.
    """
    size = len(mu)
    eye = np.eye(size)
    A = (eye - albedo * forward) / mu
    B = albedo * backward / mu
    minus, plus = A - B, A + B
    half = 0.5 * depth
    cosh, sinh = _cosh_sinh(plus @ minus, half)
    rise = minus @ sinh
    even = _right_divide(np.vstack([rise, (loss / mu) @ sinh]), cosh + rise)
    cosh, sinh = _cosh_sinh(minus @ plus, half)
    rise = plus @ sinh
    odd = _right_divide(rise, cosh + rise)
    a = 2.0 * even[size]
    R = odd - even[:size]
    T = -(odd + even[:size])
    diagonal = np.diag_indices(size)
    T[diagonal] = 0.0
    T[diagonal] = 1.0 - R.sum(axis=0) - T.sum(axis=0) - a
    return R, T, a


def _cosh_sinh(X: FloatArray, h: float) -> tuple[FloatArray, FloatArray]:
    """Power series of cosh(√X h) and sinh(√X h)/√X."""
    X = X * (h * h)
    term = np.eye(len(X))
    cosh, sinh = term.copy(), term.copy()
    for k in range(1, 40):
        term = term @ X
        term /= (2 * k - 1) * (2 * k)
        cosh += term
        sinh += term / (2 * k + 1)
        if np.abs(term).max() < 1e-17:
            break
    return cosh, h * sinh


def _right_divide(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply `left` by the inverse of `right` from the right."""
    return np.asarray(dgesv(right.T, left.T)[2].T, dtype=np.float64)


def _round_trips(Q: FloatArray, loss: FloatArray, right: FloatArray) -> FloatArray:
    """(1 − Q)⁻¹ · right, where the column sums of 1 − Q are known to be `loss`, without cancellation."""
    size = len(Q)
    if size == 0:
        return right
    if loss.min() > _NEARLY_CLOSED:
        return np.asarray(dgesv(np.eye(size) - Q, right)[2], dtype=np.float64)
    # Elimination where each pivot is the sum of what leaves its node, never 1 − Q_kk.
    lu = -np.array(Q)
    loss = np.array(loss)
    for k in range(size):
        out = loss[k] - lu[k + 1 :, k].sum()
        # A node that neither loses nor passes on anything: trapped in a clear layer, and never lit.
        pivot = out if out > 0.0 else 1.0
        lu[k, k] = pivot
        lu[k + 1 :, k] /= pivot
        lu[k + 1 :, k + 1 :] -= np.outer(lu[k + 1 :, k], lu[k, k + 1 :])
        loss[k + 1 :] -= (loss[k] / pivot) * lu[k, k + 1 :]
    return np.asarray(dgetrs(lu, np.arange(size), right)[0], dtype=np.float64)


def add_layer(layer: tuple[FloatArray, FloatArray, FloatArray], below: Below) -> Below:
    """Lay a layer (R, T, a) upon what is below it, in the same medium."""
    R, T, a = layer
    inner = _round_trips(R @ below.reflectance, (T.sum(axis=0) + a) @ below.reflectance + below.lost, T)
    back = below.reflectance @ inner
    return Below(
        R + T @ back,
        below.transmittance @ inner,
        np.vstack([a + a @ back, below.absorbed @ inner]),
    )


def add_interface(grid: AngularGrid, n_above: float, n_below: float, below: Below) -> Below:
    """Lay a Fresnel interface upon what is below it; nodes that only one side holds are totally reflected."""
    if n_above == n_below:
        return below
    upper, lower = grid.active(n_above), grid.active(n_below)
    shared, in_upper, in_lower = np.intersect1d(upper, lower, return_indices=True)
    r = fresnel(n_above, n_below, grid.cosines(n_above)[in_upper])
    r_inside = np.ones(len(lower))
    r_inside[in_lower] = r
    enter = np.zeros((len(lower), len(shared)))
    enter[in_lower, np.arange(len(shared))] = 1.0 - r
    Q = r_inside[:, None] * below.reflectance
    inner = _round_trips(Q, (1.0 - r_inside) @ below.reflectance + below.lost, enter)
    R = np.eye(len(upper))
    R[in_upper, in_upper] = r
    R[np.ix_(in_upper, in_upper)] += (1.0 - r)[:, None] * (below.reflectance @ inner)[in_lower]
    T = np.zeros((below.transmittance.shape[0], len(upper)))
    T[:, in_upper] = below.transmittance @ inner
    absorbed = np.zeros((below.absorbed.shape[0], len(upper)))
    absorbed[:, in_upper] = below.absorbed @ inner
    return Below(R, T, absorbed)


def clear_below(nodes: int) -> Below:
    """The half-space below the stack: everything passes, nothing returns."""
    return Below(np.zeros((nodes, nodes)), np.eye(nodes), np.zeros((0, nodes)))
