"""A ledger made small: photons that no setting of the domain can tell apart become a few rows.

In a bin the sum of e^(θ·x) is replaced by points with the same weight, mean and covariance along the directions
in which θ differs over the domain (the principal axes of the exponents), as an unscented transform does (Julier &
Uhlmann 1997). What is lost is of fourth order in the spread of θ·x, about σ⁴/12 of the bin's weight; bins are
halved where most is lost, until all losses together stay below the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.transport.ledger.data import SIDES, Anchors, Coefficients, Compression, Detector, Entries
from livlab.model.transport.ledger.recording import SAYS, Recording
from livlab.units import FloatArray

R = TypeVar("R", bound=Recording)

_LEVELS = 40
_PROBES = 12
_NARROW = 0.2
_CHECKED = 192  # settings at which a compression is measured
_RANGE = (partial(np.min, axis=1), partial(np.max, axis=1))


@dataclass(frozen=True)
class AnchorDomain:
    """Settings that one anchor's rows must answer for.

    Attributes
    ----------
    theta
        (F, M) their exponents.
    weight
        (M,) |c| with which the anchor enters each.
    """

    theta: FloatArray
    weight: FloatArray

    @property
    def low(self) -> FloatArray:
        """(F,) least exponents."""
        return np.asarray(self.theta.min(axis=1))

    @property
    def high(self) -> FloatArray:
        """(F,) largest exponents."""
        return np.asarray(self.theta.max(axis=1))


def widened(served: Coefficients, absorption: float, scattering: float) -> Coefficients:
    """The settings served, and those again with one layer's coefficient at a time changed by ± a share.

    Of a layer without absorption the share is one of a hundredth of its reduced scattering.
    """
    layers = served.absorption.shape[1]
    reduced = served.scattering * (1.0 - served.anisotropy)
    size = np.where(served.absorption > 0, served.absorption, 0.01 * reduced)
    pairs = [(served.absorption, served.scattering)]
    for k, sign in ((k, sign) for k in range(layers) for sign in (-1.0, 1.0)):
        step = np.zeros(layers)
        step[k] = sign
        if absorption:
            pairs.append((np.maximum(served.absorption + absorption * step * size, 0.0), served.scattering))
        if scattering:
            pairs.append((served.absorption, served.scattering * (1.0 + scattering * step)))
    times = len(pairs)
    return Coefficients(
        np.tile(served.wavelength_nm, times),
        served.thickness_mm,
        np.concatenate([a for a, _ in pairs]),
        np.concatenate([s for _, s in pairs]),
        np.tile(served.anisotropy, (times, 1)),
        np.tile(served.index, (times, 1)),
    )


def anchor_domain(theta: FloatArray, c: FloatArray) -> AnchorDomain:
    """The part of the settings in which an anchor has a say: exponents (F, S), and its weights c (S,)."""
    use = np.abs(c) > SAYS
    return AnchorDomain(theta[:, use], np.abs(c[use]))


def compress(entries: Entries, anchors: Anchors, domains: list[AnchorDomain], tolerance: float) -> Entries:
    """Rows binned so that no answer of the domain is predicted to change by more than the tolerance.

    Raises
    ------
    InputError
        If the ledger is compressed already, or the tolerance is not positive.
    """
    if len(entries.cosine) != len(entries):
        raise InputError.of("ledger", "compressed", "is compressed already", "Compress the ledger as recorded.")
    if not tolerance > 0:
        raise InputError.of("tolerance", tolerance, "must be > 0", "Give a share of the incident light, such as 1e-4.")
    key = (entries.anchor.astype(np.int64) * len(SIDES) + entries.side) << 32 | (entries.bin.astype(np.int64) + 1)
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]]) if len(key) else np.empty(0, dtype=np.int64)
    ends = np.r_[starts[1:], len(key)]
    # Every anchor's own share of the light counts as one; classes share its tolerance by their rows.
    parts: list[list[NDArray[np.generic]]] = []
    for a, b in zip(starts, ends, strict=True):
        k = int(entries.anchor[a])
        whole = int((entries.anchor == k).sum())
        budget = tolerance * float(anchors.photons[k]) * (b - a) / whole
        x = entries.features[a:b].astype(np.float64)
        log_weight = entries.log_weight[a:b].astype(np.float64)
        made = _binned(x, log_weight, domains[k], budget)
        one = np.ones(len(made[1]), dtype=np.int64)
        parts.append([one * k, one * int(entries.side[a]), one * int(entries.bin[a]), *made])
    if not parts:
        return entries
    columns = [np.concatenate(c) for c in zip(*parts, strict=True)]
    return Entries(
        anchor=columns[0].astype(np.uint16),
        side=columns[1].astype(np.uint8),
        bin=columns[2].astype(np.int32),
        features=columns[3].astype(np.float32),
        log_weight=columns[4].astype(np.float32),
        concentration=columns[5].astype(np.float32),
        cosine=np.empty(0, dtype=np.float32),
        radius=np.empty(0, dtype=np.float32),
    )


def _binned(
    x: FloatArray, log_weight: FloatArray, where: AnchorDomain, budget: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Features, log weight and concentration of each bin."""
    centre = np.average(where.theta, axis=1, weights=where.weight)
    spread = (where.theta - centre[:, None]) * where.weight
    # What photons count: at the centre, and on average over a few settings.
    at_centre = log_weight + x @ centre
    probes = np.linspace(0, where.theta.shape[1] - 1, min(_PROBES, where.theta.shape[1])).astype(int)
    counts = np.exp(log_weight[:, None] + x @ where.theta[:, probes]) * where.weight[probes]
    heaviest = counts.max(axis=1)
    u, sigma, _ = np.linalg.svd(spread, full_matrices=False)
    used = sigma > 1e-6 * max(float(sigma[0]), 1e-300)
    # Largest, not mean, square of θ·x over the domain: every setting must be served.
    scale = np.abs(u[:, used].T @ spread).max(axis=1)
    z = (x @ u[:, used]) * scale
    label = _split(z, heaviest, budget)
    bins = int(label.max()) + 1
    shift = np.full(bins, -np.inf)
    np.maximum.at(shift, label, at_centre)
    relative = np.exp(at_centre - shift[label])
    total = np.bincount(label, relative, bins)
    square = np.bincount(label, relative**2, bins) / total**2

    def mean_of(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(label, relative * v, bins) for v in values.T], axis=1) / total[:, None]

    mean = mean_of(x)
    off_x, off_z = x - mean[label], z - mean_of(z)[label]
    covariance = np.stack([mean_of(off_z * z_i[:, None]) for z_i in off_z.T], axis=2)
    values, vectors = np.linalg.eigh(covariance)
    across = np.stack([mean_of(off_x * z_i[:, None]) for z_i in off_z.T], axis=2)
    # A direction so narrow that leaving it out costs little needs no points of its own.
    heavy = np.bincount(label, heaviest, bins)
    matters = 0.5 * heavy[:, None] * values > _NARROW * budget / values.size
    matters &= values > 1e-12
    made: list[tuple[FloatArray, ...]] = []
    for b in range(bins):
        axes = np.flatnonzero(matters[b])
        level = shift[b] + np.log(total[b])
        if not axes.size:
            points = mean[b][None]
        else:
            arms = np.sqrt(axes.size) * (across[b] @ vectors[b][:, axes] / np.sqrt(values[b, axes])).T
            points = np.concatenate([mean[b] + arms, mean[b] - arms])
        n = len(points)
        made.append((points, level - np.log(n) - points @ centre, np.full(n, n * square[b])))
    rows, weights, shares = (np.concatenate(c) for c in zip(*made, strict=True))
    return rows, weights, shares


def _split(z: FloatArray, heavy: FloatArray, budget: float) -> NDArray[np.int64]:
    """A bin for each row: halves again and again, at the mean of the widest direction, while too much is lost."""
    label = np.zeros(len(heavy), dtype=np.int64)
    active = np.arange(len(heavy))
    settled, bins = 0.0, 1
    for _ in range(_LEVELS):
        names, inner = np.unique(label[active], return_inverse=True)
        n = len(names)
        weight = np.bincount(inner, heavy[active], n)
        safe = np.maximum(weight, 1e-300)
        here = z[active]
        mean = np.stack([np.bincount(inner, heavy[active] * c, n) for c in here.T], axis=1) / safe[:, None]
        off = here - mean[inner]
        spread = np.stack([np.bincount(inner, heavy[active] * c * c, n) for c in off.T], axis=1)
        loss = weight * (spread / safe[:, None]).sum(axis=1) ** 2 / 12.0
        if settled + loss.sum() <= budget:
            break
        split = loss > 0.5 * max(budget - settled, 0.1 * budget) / n
        if not split.any():
            break
        settled += float(loss[~split].sum())
        axis = spread.argmax(axis=1)
        goes = split[inner]
        high = off[np.arange(len(active)), axis[inner]] > 0
        fresh = np.cumsum(split) - 1 + bins
        move = goes & high
        label[active[move]] = fresh[inner[move]]
        bins += int(split.sum())
        active = active[goes]
    return np.unique(label, return_inverse=True)[1].astype(np.int64)


def compress_ledger(
    ledger: R,
    tolerance: float | None,
    absorption_spread: float,
    scattering_spread: float,
    also: Sequence[Coefficients] = (),
) -> R:
    """A ledger binned until the error measured over its domain is within the tolerance: `Ledger.compressed`."""
    for name, value in (("absorption_spread", absorption_spread), ("scattering_spread", scattering_spread)):
        if not 0.0 <= value < 1.0:
            raise InputError.of(name, value, "must be within [0, 1)", "Give a share such as 0.2.")
    if tolerance is None:
        worst = ledger.answer(ledger.served, Detector.total()).standard_error.max()
        tolerance = max(0.1 * float(worst), 1e-9)
    sets = Coefficients.joined([widened(ledger.served, absorption_spread, scattering_spread), *also])
    c, theta = ledger.theta(sets)
    low, high = (np.stack([f(x.theta[:, np.abs(c[:, k]) > SAYS]) for k, x in enumerate(theta)]) for f in _RANGE)
    some = sets.take(np.arange(0, len(sets), max(1, len(sets) // _CHECKED)))
    c, theta = ledger.theta(some)
    domains = [anchor_domain(x.theta, c[:, k]) for k, x in enumerate(theta)]
    sides = [Detector.total("up"), Detector.total("down")]
    truth = [ledger.answer(some, x).value for x in sides]
    wanted = tolerance
    for _ in range(8):
        made = replace(ledger, entries=compress(ledger.entries, ledger.anchors, domains, wanted), _rows={})
        errors = [float(np.abs(made.answer(some, x).value - t).max()) for x, t in zip(sides, truth, strict=True)]
        if max(errors) <= tolerance:
            break
        wanted *= 0.5 * tolerance / max(errors)
    about = Compression(len(ledger.entries), tolerance, max(errors), low, high)
    return replace(made, compression=about, _rows={})
