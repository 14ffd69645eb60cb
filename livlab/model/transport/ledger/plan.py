"""Which walks a ledger needs: anchors, reference absorption, and how their answers are put together.

Phase functions and refractive indices of a recorded path cannot be changed, so several walks, each at the optics
of an anchor wavelength, are put together with weights c_a(λ) that reproduce polynomials: what stays of the change
of phase functions and indices is of one order more.

A change of scattering is a ratio of densities whose weights degenerate: their variance grows with the number of
scatterings. So the polynomial carries what it can of that change too. With ln s' = P(λ) + r(λ), P the polynomial
through the anchors' own reduced scattering, an anchor only has to be reweighted by the small rest r (and by a
share `bear` of P, as much as costs little): Σ c_a R_a(s_a e^r) is then exact but for the curvature of R along P.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.model.tissue.stack import REDIRECT_MEAN, Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.ledger.data import Anchors, Coefficients
from livlab.model.transport.source import Source
from livlab.units import FloatArray

MAX_DEGREE = 8
DEEP = 1e-6
"""A last layer is endless for reflected light if less than this share can have been at its bottom."""

LEAST_ABSORPTION = 1e-7
"""Least reference absorption of an endless layer over its reduced scattering, so that every walk ends."""

CHEAP = 0.2
"""Log variance that reweighting may add to bear what interpolation could."""

ACCEPTED = 0.75
"""Log variance that reweighting may add in all before more anchors are taken."""

LEAST_SHARE = 0.55
"""Least absorption of an endless layer that an anchor can answer for, over its reference absorption."""

_MAINLY = 0.35  # share of the largest |c| from which on an anchor mainly answers

LARGEST_DEGENERACY = 2.0
"""Largest log of the variance that a reweighting may add."""


@dataclass(frozen=True)
class RecordingPlan:
    """What to walk.

    Attributes
    ----------
    rows
        (K,) wavelengths of the stack that are anchors.
    degree
        Of the polynomials in wavelength that the answers' weights reproduce.
    scaled
        Whether the last layer is endless to light, so that its paths scale with the mean free path, exactly.
    counted
        Layers whose scatterings are counted, for the ratio of densities.
    reference
        (K, L) absorption to walk with, 1/mm.
    depth_bias
        Bound of what `scaled` may change.
    """

    rows: tuple[int, ...]
    degree: int
    scaled: bool
    counted: tuple[int, ...]
    reference: FloatArray
    depth_bias: float


def lobatto(count: int) -> FloatArray:
    """Points on [−1, 1], the ends among them, from which a polynomial is known best (Guest 1958).

    >>> lobatto(3).tolist()
    [-1.0, 0.0, 1.0]
    """
    if count == 1:
        return np.zeros(1)
    inner = np.polynomial.legendre.Legendre.basis(count - 1).deriv().roots()
    points: FloatArray = np.concatenate([[-1.0], np.sort(np.real(inner)), [1.0]])
    return 0.5 * (points - points[::-1]) + 0.0


def blend(wavelength_nm: FloatArray, anchors_nm: FloatArray, degree: int) -> FloatArray:
    """(S, K) least-squares weights that sum to 1 and reproduce polynomials up to a degree.

    With degree + 1 anchors these are Lagrange's.

    Parameters
    ----------
    wavelength_nm
        (S,).
    anchors_nm
        (K,), K > degree.

    Examples
    --------
    >>> blend(np.array([550.0]), np.array([500.0, 600.0, 700.0]), 2).round(3).tolist()
    [[0.375, 0.75, -0.125]]
    """
    low, high = float(anchors_nm.min()), float(anchors_nm.max())
    half = max(0.5 * (high - low), 1e-9)
    of_anchor = np.polynomial.chebyshev.chebvander((anchors_nm - 0.5 * (low + high)) / half, degree)
    wanted = np.polynomial.chebyshev.chebvander((wavelength_nm - 0.5 * (low + high)) / half, degree)
    weights: FloatArray = wanted @ np.linalg.pinv(of_anchor)
    weights[np.abs(weights) < 1e-12] = 0.0
    return weights


def levels(anchors: Anchors, c: FloatArray, bear: FloatArray) -> FloatArray:
    """(K, S, L) ln of the reduced scattering for which an anchor's own scattering stands at each setting.

    (1 − b) Σ c_a ln s'_a + b ln s'_a, b the share that reweighting bears ((L,), 1 where an anchor is clear).
    """
    with np.errstate(divide="ignore"):
        own = np.log(anchors.scattering * (1.0 - anchors.anisotropy))
    clear = ~np.isfinite(own).all(axis=0)
    b = np.where(clear, 1.0, bear)
    smooth = c @ np.where(clear, 0.0, own)
    return np.asarray((1.0 - b) * smooth + np.where(np.isfinite(own), b * own, 0.0)[:, None, :])


def similar(sets: Coefficients, anchors: Anchors, k: int, level: FloatArray, scaled: bool) -> FloatArray:
    """(S, L) factor from a setting's scattering to the one at which anchor k answers for it.

    It keeps the reduced scattering: s_a (1 − g) e^(−level), 1 where the anchor is clear; the endless layer has no
    level but its own.
    """
    own = anchors.scattering[k]
    factor = own * (1.0 - sets.anisotropy) * np.exp(-level)
    if scaled:
        factor[:, -1] = (1.0 - sets.anisotropy[:, -1]) / (1.0 - anchors.anisotropy[k, -1])
    return np.asarray(np.where((own > 0) & (sets.scattering > 0), factor, 1.0))


def degeneracy_of(
    sets: Coefficients, anchors: Anchors, k: int, level: FloatArray, scaled: bool, paths: FloatArray
) -> FloatArray:
    """(S,) weight degeneracy: the log of the variance that a change of coefficients adds.

    Σ ℓ̄ [(s' − s)²/s + max(µ_ref − µ', 0)]. The first is exact for the Poisson process of scatterings along a path of
    mean length ℓ̄ ((S, L) or (L,), mm), infinite where scattering appears in a layer that had none.
    """
    s = sets.scattering * similar(sets, anchors, k, level, scaled)
    own, absorbed = anchors.scattering[k], sets.absorption.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.where(s == own, 0.0, (s - own) ** 2 / own)
        if scaled:
            change[:, -1] = 0.0
            absorbed[:, -1] *= own[-1] / s[:, -1]
        total = (change + np.maximum(anchors.absorption[k] - absorbed, 0.0)) * paths
        if math.isinf(sets.thickness_mm[-1]) or scaled:
            # Endless paths: from half the reference absorption down the variance has no bound, whatever a sample says.
            total[:, -1] = np.where(absorbed[:, -1] < LEAST_SHARE * anchors.absorption[k, -1], math.inf, total[:, -1])
    return np.asarray(np.where(np.isnan(total), 0.0, total).sum(axis=1))


def make_plan(
    stack: OpticalStack,
    sets: Coefficients,
    *,
    lateral: bool,
    reserve: float,
    degree: int,
    anchors: int | None = None,
) -> RecordingPlan:
    """What to walk with polynomials of a degree.

    Parameters
    ----------
    stack
        Where phase functions are taken from, wavelengths sorted.
    sets
        Everything to be served, the stack's own wavelengths first.
    lateral
        Whether places matter (sides, radii): paths then do not scale.
    reserve
        Share by which the reference absorption stays below the least one served.
    degree
        See `smoothness`.
    anchors
        Their number, at least degree + 1.
    """
    own = sets.take(range(len(stack.wavelength_nm)))
    deep = depth_bias(sets)
    short = any(i.absorb_below_mm > 0 for i in stack.layers[-1].interactions)
    scaled = deep <= DEEP and not lateral and not short and bool((sets.scattering[:, -1] > 0).all())
    rows = snap(own.wavelength_nm, max(anchors or 0, degree + 1))
    degree = min(degree, len(rows) - 1)
    layers = range(len(stack.layers) - 1 if scaled else len(stack.layers))
    counted = tuple(k for k in layers if bool((own.scattering[list(rows), k] > 0).any()))
    reference = _reference(own.take(rows), sets, degree, scaled, reserve)
    return RecordingPlan(rows, degree, scaled, counted, reference, deep if scaled else 0.0)


def depth_bias(sets: Coefficients) -> float:
    """Bound of the share of light that reaches the bottom of the last layer and returns.

    4 e^(−κ d), κ the smaller of the diffusion's decay and the reduced extinction.
    """
    d = float(sets.thickness_mm[-1])
    if math.isinf(d):
        return 0.0
    mua = sets.absorption[:, -1]
    total = mua + sets.scattering[:, -1] * (1.0 - sets.anisotropy[:, -1])
    kappa = np.minimum(np.sqrt(3.0 * mua * total), total)
    return float(4.0 * np.exp(-kappa * d).max())


def smoothness(own: Coefficients, tolerance: float) -> int:
    """Degree at which polynomials through as many anchors hold ln(1 − g), and indices to a twentieth, within it."""
    width = len(own)
    columns = [np.log1p(-np.minimum(own.anisotropy, 1.0 - 1e-9)), 20.0 * own.index]
    proxies = np.concatenate(columns, axis=1)
    proxies = proxies[:, np.ptp(proxies, axis=0) > 0]
    if not proxies.size:
        return 0
    for degree in range(min(MAX_DEGREE, width - 1) + 1):
        rows = snap(own.wavelength_nm, degree + 1)
        c = blend(own.wavelength_nm, own.wavelength_nm[list(rows)], len(rows) - 1)
        if float(np.abs(c @ proxies[list(rows)] - proxies).max()) <= tolerance:
            return degree
    return min(MAX_DEGREE, width - 1)


@dataclass(frozen=True)
class Share:
    """How a change of scattering is shared between reweighting and interpolation.

    Attributes
    ----------
    bear
        (L,) share of the polynomial part that reweighting bears.
    degeneracy
        What the reweighting then adds at most to the log variance of an anchor that mainly answers.
    curvature
        Largest relative error of interpolating the rest of the polynomial part's exponential.
    """

    bear: FloatArray
    degeneracy: float
    curvature: float


def share(sets: Coefficients, anchors: Anchors, degree: int, scaled: bool, paths: FloatArray) -> Share:
    """Let reweighting bear as much as adds little variance."""
    c = blend(sets.wavelength_nm, anchors.wavelength_nm, degree)
    mainly = np.abs(c) >= _MAINLY * np.abs(c).max(axis=1, keepdims=True)

    def degeneracy(bear: FloatArray) -> float:
        level = levels(anchors, c, bear)
        each = [degeneracy_of(sets, anchors, k, level[k], scaled, paths) for k in range(len(anchors))]
        return float(np.stack(each, axis=1)[mainly].max())

    layers = len(paths)
    free, full = degeneracy(np.zeros(layers)), degeneracy(np.ones(layers))
    bear = np.ones(layers)
    if full - free > CHEAP:
        bear *= math.sqrt(CHEAP / (full - free))
    layers = layers - 1 if scaled else layers
    s = (anchors.scattering * (1.0 - anchors.anisotropy))[:, :layers]
    some = s.min(axis=0) > 0
    if not some.any():
        return Share(bear, degeneracy(bear), 0.0)
    left = ((1.0 - bear[:layers]) * np.log(np.where(some, s, 1.0)))[:, some]
    curvature = float(np.abs((c @ np.exp(left)) / np.exp(c @ left) - 1.0).max())
    return Share(bear, degeneracy(bear), curvature)


def reference_stack(stack: OpticalStack, plan: RecordingPlan, keep_factor: bool) -> OpticalStack:
    """The stack to walk: the anchors' scatterers, and the reference absorption instead of all that absorbs.

    Unless `keep_factor`, a factor of Algorithm 2 is met by its mean, as a smaller rate.
    """
    chosen = stack.at(plan.rows)
    layers = []
    for k, layer in enumerate(chosen.layers):
        parts = []
        absorbing = plan.reference[:, k]
        for i in layer.interactions:
            factor = REDIRECT_MEAN[i.redirect]
            scattering = i.rate * i.albedo
            if not scattering.any():
                continue
            one = np.ones_like(scattering)
            if keep_factor:
                parts.append(Interaction(i.name, scattering, one, i.phases, i.redirect, i.absorb_below_mm))
                absorbing = np.maximum(absorbing - scattering * (1.0 - factor), 0.0)
            elif factor > 0:
                parts.append(Interaction(i.name, scattering * factor, one, i.phases, "none", i.absorb_below_mm))
        if layer.interactions:
            zero = np.zeros_like(absorbing)
            parts.append(Interaction("reference absorber", absorbing, zero, layer.interactions[0].phases))
        layers.append(PlaneLayer(layer.name, layer.thickness_mm, layer.n, tuple(parts)))
    return OpticalStack(chosen.wavelength_nm, tuple(layers), chosen.n_above, chosen.n_below, stack.name)


def anchors_of(walked: OpticalStack, photons: NDArray[np.int64]) -> Anchors:
    """The densities of a reference stack."""
    found = Coefficients.of(walked)
    extinction = [sum((i.rate for i in x.interactions), np.zeros_like(x.n)) for x in walked.layers]
    return Anchors(
        found.wavelength_nm, found.scattering, np.stack(extinction, axis=1), found.anisotropy, found.index, photons
    )


def specular(index: FloatArray, source: Source) -> FloatArray:
    """(S,) reflectance of the first surface for the source's light."""
    from livlab.model.transport.fresnel import diffuse_fresnel, fresnel

    if source.kind == "diffuse":
        return np.array([diffuse_fresnel(float(a), float(b)) for a, b in index[:, :2]])
    return fresnel(index[:, 0], index[:, 1], np.full(len(index), math.cos(source.angle_rad)))


def snap(wavelength_nm: FloatArray, count: int) -> tuple[int, ...]:
    """Rows of the wavelengths nearest to the best points of the band, each once."""
    low, high = wavelength_nm[0], wavelength_nm[-1]
    wanted = 0.5 * (low + high) + 0.5 * (high - low) * lobatto(min(count, len(wavelength_nm)))
    rows: list[int] = []
    for x in wanted:
        near = np.argsort(np.abs(wavelength_nm - x), kind="stable")
        rows.append(next(int(k) for k in near if k not in rows))
    return tuple(sorted(rows))


def _reference(anchors: Coefficients, sets: Coefficients, degree: int, scaled: bool, reserve: float) -> FloatArray:
    """(K, L) absorption to walk with, in each anchor's own lengths.

    A little below the least of what an anchor mainly answers for; and low enough for all, as the variance of weights
    e^((µ_ref − µ_a) ℓ) that can exceed one is finite below 2 µ_a only.
    """
    c = np.abs(blend(sets.wavelength_nm, anchors.wavelength_nm, degree))
    mainly = c >= _MAINLY * c.max(axis=1, keepdims=True)
    least = np.empty((len(anchors), sets.absorption.shape[1]))
    for k in range(len(anchors)):
        own = sets.absorption.copy()
        if scaled:
            s = sets.scattering[:, -1] * (1.0 - sets.anisotropy[:, -1]) / (1.0 - anchors.anisotropy[k, -1])
            own[:, -1] *= anchors.scattering[k, -1] / s
        least[k] = np.minimum(own[mainly[:, k]].min(axis=0), own.min(axis=0) / LEAST_SHARE)
    least *= 1.0 - reserve
    if math.isinf(sets.thickness_mm[-1]):
        floor = LEAST_ABSORPTION * anchors.scattering[:, -1] * (1.0 - anchors.anisotropy[:, -1])
        least[:, -1] = np.maximum(least[:, -1], floor)
    return least
