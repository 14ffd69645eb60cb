"""An inverse-distribution table for kernels in single precision.

A kernel that samples any phase function by one look-up needs a table of 1 − cos θ against probability that
holds both a peak of 10⁻⁴ rad and a tail of probability 10⁻⁶. Points at equal probabilities cannot: the last
cell would carry most of 1 − g. Here cells halve towards both ends of the distribution, `per_octave` of them
to each halving, which is how a float's own exponent and leading mantissa bits count: the index costs one
shift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.units import FloatArray

_MANTISSA_BITS = 23


@dataclass(frozen=True, eq=False)
class KernelTable:
    """1 − cos θ at probabilities that halve towards both ends.

    With t = u for u < 1/2 (row 0, the backward half: u is the cdf of cos θ) and t = 1 − u otherwise (row 1,
    the forward half), the cell is j = 0 for t < 2^−(octaves+1), else
    j = 1 + (bits(t) >> shift) − (bits(2^−(octaves+1)) >> shift), bits being the float32 pattern and
    shift = 23 − log2(per_octave). The position f in the cell is t · 2^(octaves+1) for j = 0, else the low
    `shift` bits of t over 2^shift, and 1 − cos θ = values[row, j] (1 − f) + values[row, j + 1] f.

    Error: a cell holds at most the share 1/per_octave of the probability beyond it, so
    |F_table(w) − F(w)| ≤ min(F, 1 − F)/per_octave for probabilities above 2^−(octaves+1), and no more than
    2^−(octaves+1) below; where the phase function is smooth over a cell it falls with per_octave².
    Values carry float32 rounding, 6e-8 of 1 − cos θ itself.

    Attributes
    ----------
    values
        (2, octaves · per_octave + 3) float32, 1 − cos θ.
    octaves, per_octave
        The layout.
    """

    values: NDArray[np.float32]
    octaves: int
    per_octave: int

    @property
    def shift(self) -> int:
        """Right shift of a float32 pattern that leaves exponent and cell."""
        return _MANTISSA_BITS - (self.per_octave.bit_length() - 1)

    @property
    def base(self) -> int:
        """Shifted pattern of the smallest tabulated probability, 2^−(octaves+1): cell 1."""
        return int(np.float32(2.0 ** -(self.octaves + 1)).view(np.uint32)) >> self.shift

    @property
    def probabilities(self) -> FloatArray:
        """(octaves · per_octave + 2,) the t of the columns: 0, 2^−(octaves+1), …, 1/2."""
        return _probabilities(self.octaves, self.per_octave)

    @property
    def anisotropy(self) -> float:
        """Mean cosine of what the table samples, to hold against the phase function's own."""
        t = self.probabilities
        rows = self.values[:, : t.size].astype(np.float64)
        return 1.0 - float(np.sum(0.5 * (rows[:, 1:] + rows[:, :-1]) * np.diff(t)))

    def sample_complement(self, u: Any) -> NDArray[np.float32]:
        """1 − cos θ for u in [0, 1), in float32 as a kernel does it."""
        u = np.asarray(u, dtype=np.float32)
        forward = u >= np.float32(0.5)
        t = np.where(forward, np.float32(1.0) - u, u).astype(np.float32)
        bits = t.view(np.uint32)
        first = np.float32(2.0 ** -(self.octaves + 1))
        tail = t < first
        j = np.where(tail, 0, 1 + (bits >> np.uint32(self.shift)).astype(np.int64) - self.base)
        low = (bits & np.uint32((1 << self.shift) - 1)).astype(np.float32) * np.float32(2.0**-self.shift)
        f = np.where(tail, t / first, low).astype(np.float32)
        row = forward.astype(np.int64)
        left, right = self.values[row, j], self.values[row, j + 1]
        return np.asarray(left + (right - left) * f, dtype=np.float32)


def kernel_table(phase: Any, *, octaves: int = 20, per_octave: int = 64) -> KernelTable:
    """Table of 1 − cos θ against probability, for a float32 kernel.

    Parameters
    ----------
    phase
        A phase function (`livlab.model.tissue.phase.functions`); one without `quantile_complement` is sampled
        through its cosines and keeps only their digits.
    octaves
        Halvings of the probability on each side, 1 … 60.
    per_octave
        Cells a halving, a power of two up to 1024.

    Raises
    ------
    InputError
        If the layout is out of bounds.

    Examples
    --------
    >>> from livlab.model.tissue.phase.functions import HenyeyGreenstein
    >>> table = kernel_table(HenyeyGreenstein(0.95))
    >>> abs(table.anisotropy - 0.95) < 1e-5
    True
    """
    if not 1 <= octaves <= 60:
        raise InputError.of("octaves", octaves, "must be within [1, 60]", "Take 20.")
    if not (1 <= per_octave <= 1024 and per_octave & (per_octave - 1) == 0):
        raise InputError.of("per_octave", per_octave, "must be a power of two up to 1024", "Take 64.")
    t = _probabilities(octaves, per_octave)
    quantile = getattr(phase, "quantile_complement", None)
    if quantile is None:
        rows = [1.0 - phase.sample(t), 1.0 - phase.sample(np.minimum(1.0 - t, 1.0 - 1e-16))]
    else:
        rows = [quantile(1.0 - t), quantile(t)]
    values = np.array([np.append(row, row[-1]) for row in rows], dtype=np.float32)
    values.setflags(write=False)
    return KernelTable(values, octaves, per_octave)


def _probabilities(octaves: int, per_octave: int) -> FloatArray:
    inner = [2.0 ** -(k + 1) * (1.0 + np.arange(per_octave) / per_octave) for k in range(octaves, 0, -1)]
    return np.concatenate([[0.0], *inner, [0.5]])
