"""Compiled Legendre moments of a weighted set of directions."""

from __future__ import annotations

import numpy as np

from livlab.core.compiled import compiled
from livlab.units import FloatArray


@compiled
def moments(w: FloatArray, mass: FloatArray, order: int) -> FloatArray:
    """Σ mass · P_l(1 − w) / Σ mass for l = 0 … order; χ_0 is 1 exactly.

    The recurrence on P_{l+1} − P_l sees w itself, so a narrow forward peak keeps its digits.
    """
    chi = np.zeros(order + 1)
    n = np.arange(order + 1)
    keep = n / (n + 1.0)
    turn = (2.0 * n + 1.0) / (n + 1.0)
    total = 0.0
    for k in range(w.size):
        total += mass[k]
        p = 1.0
        step = -w[k]
        for j in range(1, order + 1):
            p += step
            chi[j] += mass[k] * p
            step = keep[j] * step - turn[j] * w[k] * p
    chi /= total
    chi[0] = 1.0
    return chi
