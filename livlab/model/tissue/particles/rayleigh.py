"""Rayleigh scattering by small spheres, as printed in the thesis and as physics has it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray

SIZE_LIMIT = 0.2 * np.pi
"""Size parameter up to which the thesis itself allows the law: r < λ/10, so x = 2π r/λ < 0.2 π."""


class RayleighEfficiency(NamedTuple):
    """Scattering efficiency, and where its size parameter lies inside the law's domain."""

    q_sca: FloatArray
    valid: np.ndarray[Any, np.dtype[np.bool_]]


def rayleigh_efficiency(m: Any, x: Any) -> FloatArray:
    """Scattering efficiency of a small sphere, Q = 8/3 x⁴ |(m² − 1)/(m² + 2)|².

    Nunes 2019, eq. 6.8; Bohren & Huffman 1983, eq. 5.8. The thesis prints m as the particle's absolute index;
    physics asks for its index relative to the medium (THESIS row 4): the caller chooses which to give.

    Parameters
    ----------
    m
        Index, real or complex, positive real part.
    x
        Size parameter 2π r η_med/λ (eq. 6.9), ≥ 0.

    Returns
    -------
    FloatArray
        Of the broadcast shape. Nothing bounds it: beyond `SIZE_LIMIT` it is a number, not an efficiency.

    Raises
    ------
    InputError
        m or x is not finite, m has no positive real part, or x is negative.

    Examples
    --------
    >>> float(rayleigh_efficiency(1.5, 0.1).round(9))
    2.3068e-05
    """
    index, size = np.broadcast_arrays(np.asarray(m, dtype=complex), np.asarray(x, dtype=float))
    bad = ~(np.isfinite(index) & (index.real > 0.0))
    if bad.any():
        raise InputError.of("m", complex(index[bad].flat[0]), "must be finite with a positive real part", "Mend it.")
    bad = ~(np.isfinite(size) & (size >= 0.0))
    if bad.any():
        raise InputError.of("x", float(size[bad].flat[0]), "must be finite and at least 0", "Mend it.")
    # (m - 1)(m + 1) keeps its digits where m is near 1.
    contrast = (index - 1.0) * (index + 1.0) / (index * index + 2.0)
    return np.asarray(8.0 / 3.0 * size**4 * np.abs(contrast) ** 2)


def rayleigh(m: Any, x: Any) -> RayleighEfficiency:
    """`rayleigh_efficiency`, with whether each size parameter is small enough for it (r < λ/10)."""
    q = rayleigh_efficiency(m, x)
    return RayleighEfficiency(q, np.broadcast_to(np.asarray(x, dtype=float) < SIZE_LIMIT, q.shape))
