"""How the Monte Carlo errors of a ledger's spectrum hang together: the same photons answer at every wavelength."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.transport.ledger.record_ledger import Detector, Ledger

CHUNK = 1 << 14
"""Rows at a time."""


def covariance(ledger: Ledger, stack: OpticalStack, detectors: Sequence[tuple[Detector, float]]) -> FloatArray:
    """(W, W) covariance of Σ_d weight_d R_d(λ) over repetitions of the recorded walk.

    With e_i(λ) what photon i of N counts, an anchor's sum Σ_i e_i(λ) has covariance
    (Σ_i e_i(λ) e_i(λ') − (Σ e(λ)) (Σ e(λ'))/N) N/(N − 1); its diagonal is the answer's standard error squared. The
    anchors are walks of their own and add, each with its weight in the interpolation.

    Parameters
    ----------
    ledger, stack
        As recorded, and what it is asked about.
    detectors
        What counts, and how much; no photon is seen by two.

    Raises
    ------
    InputError
        A stack that the ledger cannot serve.
    """
    from livlab.model.transport.ledger.evaluate import select
    from livlab.model.transport.ledger.plan import specular
    from livlab.model.transport.ledger.tables import fitted

    sets = fitted(ledger, stack)
    blend, exponents = ledger.theta(sets)
    size, anchors = len(sets), len(ledger.anchors)
    enters = 1.0 - specular(sets.index, ledger.source)
    seen = [
        (select(ledger.entries, anchors, detector, ledger.tally, ledger.positions), weight)
        for detector, weight in detectors
    ]
    total = np.zeros((size, size))
    for k in range(anchors):
        photons = float(ledger.anchors.photons[k])
        entry = enters / (1.0 - specular(ledger.anchors.index[k : k + 1], ledger.source)[0])
        share = blend[:, k] * entry / photons
        theta = exponents[k].theta
        products, sums = np.zeros((size, size)), np.zeros(size)
        for rows_of, weight in seen:
            rows = rows_of[k]
            for start in range(0, len(rows.log_weight), CHUNK):
                part = slice(start, start + CHUNK)
                x = rows.features[part, : len(theta)].astype(np.float64)
                count = weight * np.exp(x @ theta + rows.log_weight[part, None])
                sums += count.sum(axis=0)
                products += (count * rows.concentration[part, None]).T @ count
        spread = (products - np.outer(sums, sums) / photons) * photons / (photons - 1.0)
        total += np.outer(share, share) * spread
    return total
