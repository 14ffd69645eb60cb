"""How far a result on finite nodes is off, by what it was on fewer: each quantity by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from livlab.model.transport.angular import ANGLES
from livlab.model.transport.moments import LayerOptics
from livlab.model.transport.quadrature import AngularGrid
from livlab.units import FloatArray

ANGULAR = frozenset({"reflectance_angular", "transmittance_angular"})
"""Quantities by angle (…, M): flux per solid angle."""

CHANCE = 0.05
"""Two counts may agree by chance: never claim less than this share of the step before, and by angle:"""

CHANCE_BY_ANGLE = 0.3

SHARED = 0.5
"""Totals go wrong together: none claims less than this share of the largest step of any, absolute or (if that is less)
relative."""

SLOW = 5.0
"""A step larger than 1/`SLOW` of the one before announces slow convergence: as many times the step is claimed."""

REACH = 10.0
BOUNDARY_LAYER = 3.0
BOUNDARY_STEPS = 10.0
"""A layer thinner than `REACH` times the smallest cosine µ of the nodes is opaque only below it: all counts miss the
light there alike, `BOUNDARY_LAYER` τ² ln(REACH µ/τ) at most; `BOUNDARY_STEPS` steps were seen to hold it (twice as many
by angle)."""

CUT = 0.1
CUT_BY_ANGLE = 4.0
"""Moments of the phase functions below a limit are left out: what that does to totals, and to the flux per solid angle
as a share of all flux, in units of the limit."""

NEIGHBOURS = 3
BY_ANGLE = 4.0
BY_EDGE = 3.0
"""Directions on either side that share an error by angle, and how many times the step is claimed there: a step crosses
zero somewhere, and is no more than a sample of the error elsewhere. Next to the normal (forward peaks) and to critical
angles (square roots), the ends of the panels, it is `BY_EDGE` times more."""

Quantities = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Unresolved:
    """What the nodes of a count cannot see.

    Attributes
    ----------
    layer, by_angle
        Bounds of the light below the smallest cosine, in totals and by angle.
    negligible
        Limit of the moments left out.
    """

    layer: float
    by_angle: float
    negligible: float

    @classmethod
    def of(cls, grid: AngularGrid, media: Sequence[LayerOptics], negligible: float) -> Unresolved:
        """Of a count's nodes in a stack."""
        totals = by_angle = 0.0
        for m in media:
            depth = (m.absorption + m.scattering) * m.thickness if m.absorption + m.scattering > 0 else 0.0
            reach = REACH * float(grid.cosines(m.n).min())
            if 0.0 < depth < reach:
                totals += BOUNDARY_LAYER * depth * depth * math.log(reach / depth)
                by_angle += depth
        return cls(totals, by_angle, negligible)


def stated_errors(found: Sequence[Quantities], missed: Unresolved) -> dict[str, FloatArray]:
    """Stated error of each quantity of the last of some results at rising node counts (three are looked at).

    The step from the last count but one is the error of that; the last one's own is usually 10 to 1000 times less,
    where convergence is geometric. Without any step nothing is known: NaN.
    """
    last = found[-1]
    if len(found) < 2:
        return {name: np.full_like(value, math.nan) for name, value in last.items()}
    steps = {name: np.abs(value - found[-2][name]) for name, value in last.items()}
    totals = [name for name in steps if name not in ANGULAR]
    moved = np.concatenate([np.ravel(steps[name]) for name in totals])
    level = np.concatenate([np.ravel(np.abs(last[name])) for name in totals])
    largest = float(moved.max())
    relative = float(np.max(moved[level > 0] / level[level > 0], initial=0.0))
    made = {}
    for name, change in steps.items():
        step, by_angle = change, name in ANGULAR
        before = np.abs(found[-2][name] - found[-3][name]) if len(found) > 2 else np.zeros_like(step)
        if by_angle:
            step, before = _spread(step), _spread(before)
        pace = np.divide(SLOW * step, before, out=np.ones_like(step), where=before > 0)
        error = np.maximum(step * np.clip(pace, 1.0, SLOW), (CHANCE_BY_ANGLE if by_angle else CHANCE) * before)
        seen = (2.0 if by_angle else 1.0) * BOUNDARY_STEPS * np.maximum(step, 0.3 * before)
        error = np.maximum(error, np.minimum(missed.by_angle if by_angle else missed.layer, seen))
        if not by_angle:
            error = np.maximum(error, SHARED * np.minimum(largest, relative * np.abs(last[name])))
        all_flux = float(last[name.removesuffix("_angular")]) if by_angle else 1.0
        made[name] = error + (CUT_BY_ANGLE if by_angle else CUT) * missed.negligible * min(all_flux, 1.0)
    return made


def _spread(values: FloatArray) -> FloatArray:
    """What is claimed by angle: the largest of a value and its neighbours, times `BY_ANGLE` and more at ends."""
    most = values.copy()
    for k in range(1, NEIGHBOURS + 1):
        np.maximum(most[k:], values[:-k], out=most[k:])
        np.maximum(most[:-k], values[k:], out=most[:-k])
    place = np.arange(values.size) % ANGLES
    return np.asarray(BY_ANGLE * np.where(np.minimum(place, ANGLES - 1 - place) < 2, BY_EDGE, 1.0) * most)
