"""Answers of a ledger's rows: exponents from coefficients, sums over rows, and their derivatives.

A row drawn with density ∝ sⁿ e^(−tℓ) counts, at scattering s' and extinction t', the ratio (s'/s)ⁿ e^(−(t'−t)ℓ)
in each layer: its logarithm is linear in the row's features. In an endless last layer lengths scale with the
mean free path instead: ℓ counts e^(−(µ_a' s/s' − µ_ref) ℓ), whatever n.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.transport.ledger.data import SIDES, Anchors, Coefficients, Detector, Entries
from livlab.model.transport.ledger.plan import similar
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

_LOADS = 4  # features that the compiled loop takes at a time
_ROWS = 1 << 14
_SETS = 256
_LINE = 32  # settings that the compiled loop takes at a time; a rest would go one by one
_SAMPLED = 8  # one tile in so many tells mean paths
_WORTH_THREADS = 1 << 20
_NOTHING = -1e4  # ln of the ratio where scattering vanishes: any scattered row counts nothing


@dataclass(frozen=True)
class Exponents:
    """ln of a row's count is θ·features, for each of S settings, with the derivatives of θ.

    Attributes
    ----------
    theta
        (F, S).
    by_absorption, by_scattering
        (F, S) dθ_f by the coefficient of feature f's own layer.
    """

    theta: FloatArray
    by_absorption: FloatArray
    by_scattering: FloatArray


def exponents(
    sets: Coefficients, anchors: Anchors, k: int, level: FloatArray, scaled: bool, counted: tuple[int, ...]
) -> Exponents:
    """Those of anchor k's rows; `level` (S, L) from `plan.levels`."""
    factor = similar(sets, anchors, k, level, scaled)
    s = sets.scattering * factor
    own, extinction = anchors.scattering[k], anchors.extinction[k]
    absorption = sets.absorption
    path = -(absorption + s - extinction)
    path_a, path_s = -np.ones_like(s), -factor
    if scaled:
        stretch = own[-1] / s[:, -1]
        path[:, -1] = anchors.absorption[k, -1] - absorption[:, -1] * stretch
        path_a[:, -1] = -stretch
        path_s[:, -1] = absorption[:, -1] * stretch / sets.scattering[:, -1]
    some = list(counted)
    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.where(own[some] > 0, np.log(s[:, some] / own[some]), 0.0)
        count_s = np.where(s[:, some] > 0, factor[:, some] / s[:, some], 0.0)
    count = np.maximum(count, _NOTHING)
    return Exponents(
        np.concatenate([path, count], axis=1).T.copy(),
        np.concatenate([path_a, np.zeros_like(count)], axis=1).T.copy(),
        np.concatenate([path_s, count_s], axis=1).T.copy(),
    )


@dataclass(frozen=True)
class Sums:
    """Sums over the rows of one anchor: of counts e, of e², of e·features, and of e·(θ'·features) and its square.

    Shapes (S,), (S,), (F, S), (D, S), (D, S) for D directions θ'.
    """

    count: FloatArray
    square: FloatArray
    features: FloatArray
    slope: FloatArray
    slope_square: FloatArray

    @classmethod
    def zeros(cls, features: int, directions: int, settings: int) -> Sums:
        """Nothing summed yet."""
        shapes = ((settings,), (settings,), (features, settings), (directions, settings), (directions, settings))
        return cls(*(np.zeros(x) for x in shapes))


@dataclass(frozen=True)
class Rows:
    """Rows of one anchor: (N, F) with F filled up for the compiled loop, (N,), (N,)."""

    features: NDArray[np.float32]
    log_weight: NDArray[np.float32]
    concentration: NDArray[np.float32]


def select(entries: Entries, anchors: int, detector: Detector, tally: Tally, positions: bool) -> list[Rows]:
    """Rows that a detector sees, for each anchor.

    Raises
    ------
    InputError
        A compressed ledger asked for other than whole bins, or places that were not recorded.
    """
    code = SIDES.index(detector.side)
    compressed = len(entries.cosine) != len(entries)
    if detector.radius != (0.0, np.inf) and not positions:
        raise InputError.of(
            "detector.radius", detector.radius, "places were not recorded", "Record with radius_edges in the tally."
        )
    bins = None
    if compressed and not detector.everything:
        bins = _whole_bins(detector, tally)
    found = []
    key = entries.anchor.astype(np.int64) * len(SIDES) + entries.side
    for k in range(anchors):
        a, b = np.searchsorted(key, [k * len(SIDES) + code, k * len(SIDES) + code + 1])
        part = slice(int(a), int(b))
        keep = np.ones(part.stop - part.start, dtype=bool)
        if bins is not None:
            keep = np.isin(entries.bin[part], bins)
        elif not detector.everything:
            keep = _seen(detector, entries.cosine[part], entries.radius[part] if positions else None)
        chosen = entries.features[part][keep]
        features = np.zeros((len(chosen), -(-chosen.shape[1] // _LOADS) * _LOADS), dtype=np.float32)
        features[:, : chosen.shape[1]] = chosen
        found.append(Rows(features, entries.log_weight[part][keep], entries.concentration[part][keep]))
    return found


def _seen(detector: Detector, cosine: NDArray[np.float32], radius: NDArray[np.float32] | None) -> NDArray[np.bool_]:
    """Which photons leave within a detector's ranges."""
    low, high = np.cos(detector.theta[1]), np.cos(detector.theta[0])
    keep = (cosine > low) | (detector.theta[1] >= np.pi / 2)
    if detector.theta[0] > 0.0:
        keep &= cosine <= high
    if radius is not None:
        keep &= (radius >= detector.radius[0]) & (radius < detector.radius[1])
    return np.asarray(keep)


def _whole_bins(detector: Detector, tally: Tally) -> list[int]:
    """Bins of the tally that make up a detector exactly."""
    picked = []
    for name, edges, wanted in (
        ("theta", np.asarray(tally.theta), detector.theta),
        ("radius", np.asarray(tally.radius), detector.radius),
    ):
        low = int(np.searchsorted(edges, wanted[0] - 1e-9))
        high = int(np.searchsorted(edges, wanted[1] - 1e-9))
        fits = high < len(edges) and low < len(edges) and np.allclose([edges[low], edges[high]], wanted, atol=1e-9)
        if np.isinf(wanted[1]):
            fits = np.isinf(edges[-1]) and abs(edges[low] - wanted[0]) < 1e-9
            high = len(edges) - 1
        if not fits:
            raise InputError.of(
                f"detector.{name}",
                wanted,
                f"a compressed ledger knows only the bins {[float(e) for e in edges]}",
                "Ask for whole bins, or use the ledger as recorded.",
            )
        picked.append(range(low, high))
    radii = len(tally.radius) - 1
    return [t * radii + r for t in picked[0] for r in picked[1]]


def sums(rows: Rows, theta: FloatArray, directions: Sequence[FloatArray] = (), exact: bool = True) -> Sums:
    """Sums over rows at each setting, on all cores.

    Parameters
    ----------
    rows
        Of one anchor.
    theta
        (F, S) exponents.
    directions
        (F, S) each: θ' along which slopes are wanted.
    exact
        Whether the sums of features are wanted of all rows; else of a sample where there are many.
    """
    from livlab.model.transport.ledger.kernel import accumulate

    width, count = theta.shape
    features, settings = rows.features.shape[1], -(-count // _LINE) * _LINE
    padded = np.zeros((features, settings))
    padded[:width, :count] = theta
    along = np.zeros((len(directions), features, settings))
    for d, direction in enumerate(directions):
        along[d, :width, :count] = direction
    tasks = [
        (slice(r, r + _ROWS), slice(c, c + _SETS))
        for c in range(0, settings, _SETS)
        for r in range(0, len(rows.log_weight), _ROWS)
    ]
    total = Sums.zeros(features, len(along), settings)

    every = 1 if exact or len(rows.log_weight) < _ROWS else _SAMPLED

    def work(task: tuple[slice, slice]) -> Sums:
        r, c = task
        some, turned = np.ascontiguousarray(padded[:, c]), np.ascontiguousarray(along[:, :, c])
        part = Sums.zeros(features, len(along), some.shape[1])
        sums_of = (part.count, part.square, part.features, part.slope, part.slope_square)
        accumulate(rows.features[r], rows.log_weight[r], rows.concentration[r], some, turned, every, *sums_of)
        return part

    workers = min(os.cpu_count() or 1, len(tasks))
    if workers > 1 and len(rows.log_weight) * settings > _WORTH_THREADS:
        with ThreadPoolExecutor(workers) as pool:
            parts = list(pool.map(work, tasks))
    else:
        parts = [work(t) for t in tasks]
    for (_, c), part in zip(tasks, parts, strict=True):
        for name in Sums.__dataclass_fields__:
            getattr(total, name)[..., c] += getattr(part, name)
    return Sums(
        total.count[:count],
        total.square[:count],
        total.features[:width, :count],
        total.slope[:, :count],
        total.slope_square[:, :count],
    )
