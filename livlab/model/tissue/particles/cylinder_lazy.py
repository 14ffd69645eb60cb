"""A cylinder's phase function whose table is made when somebody first looks at an angle.

A table takes near a tenth of a second, its anisotropy (`cylinder_mean`) a thousandth. A ledger walks at a few of a
band's wavelengths and needs the rest's anisotropies only, so most tables are never made.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.model.tissue.particles.cylinder import cylinder_mean, cylinder_phase
from livlab.model.tissue.phase.base import PhaseFunction, checked_order
from livlab.model.tissue.phase.tabulated import Tabulated
from livlab.units import FloatArray


@dataclass(frozen=True)
class LazyCylinder(PhaseFunction):
    """Phase function of cylinders with axes in all directions alike, as `cylinder_phase` gives it.

    Parameters
    ----------
    m, x
        Index relative to the medium and size parameter.
    g
        Mean cosine, from the efficiencies; the table's own agrees to 1e-4.

    Examples
    --------
    >>> phase, = lazy_cylinders([1.5 / 1.35], [5.0])
    >>> abs(phase.anisotropy - phase.table.anisotropy) < 1e-4
    True
    """

    m: complex
    x: float
    g: float

    @property
    def table(self) -> Tabulated:
        """The table itself, kept once made."""
        return cylinder_phase(self.m, self.x)

    @property
    def anisotropy(self) -> float:
        """Mean cosine g of the scattering angle."""
        return self.g

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w."""
        return self.table.pdf_complement(w)

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w."""
        return self.table.cdf_complement(w)

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """The w whose `cdf_complement` is v."""
        return self.table.quantile_complement(v)

    def legendre(self, order: int) -> FloatArray:
        """Moments of the table; the first two are known without it."""
        return np.array([1.0, self.g])[: order + 1] if checked_order(order) < 2 else self.table.legendre(order)


def lazy_cylinders(m: Any, x: Any) -> tuple[LazyCylinder, ...]:
    """One phase function for each of (W,) relative indices and size parameters; their anisotropies are worked out.

    Raises
    ------
    InputError
        As `cylinder_mean`.
    """
    g = np.atleast_1d(cylinder_mean(m, x).anisotropy)
    index, size = np.broadcast_arrays(np.atleast_1d(m), np.atleast_1d(x))
    return tuple(
        LazyCylinder(complex(a), float(b), float(c))
        for a, b, c in zip(index.tolist(), size.tolist(), g.tolist(), strict=True)
    )


def prepare(phases: Iterable[object]) -> None:
    """Make the tables that will be needed side by side: most of the work lets other threads run."""
    wanted = list({p: None for p in phases if isinstance(p, LazyCylinder)})
    if len(wanted) < 2:
        return
    with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
        list(pool.map(lambda p: p.table, wanted))


def settled(phase: Any) -> Any:
    """The phase function itself, a table in place of a promise of one."""
    return phase.table if isinstance(phase, LazyCylinder) else phase
