"""Parameters of a fit that move nothing: whose whole range changes the curves by less than their error."""

from __future__ import annotations

import math

import numpy as np

from livlab.errors import LivlabError
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.problem import Problem

PLACES = 5
"""Values over a parameter's range that are tried, its ends included."""


def idle_parameters(problem: Problem, found: FitOutcome) -> dict[str, float]:
    """Free parameters that alone move the compared curves by less than one standard deviation, and by how much.

    With the others at the optimum, the change √(Σ (r(p) − r(p̂))²) over the standard deviation of a residual says how
    many standard deviations all data together would tell two values apart: less than one over the whole range means
    that no value of the parameter is preferred, however well the others were known. Only parameters whose interval
    reaches from bound to bound are tried; any other moves the curves.

    Parameters
    ----------
    problem, found
        The fit, with the recording that it ended on.
    """
    made = {}
    space = problem.space
    for k, name in enumerate(space.names):
        interval = found.profiled.get(name)
        if interval is None or not interval.spans:
            continue
        x = space.vector(found.best)
        base = problem.residuals(found.best)
        most = 0.0
        for place in np.linspace(space.low[k], space.high[k], PLACES):
            x[k] = place
            try:
                moved = problem.residuals(space.values(x)) - base
            except LivlabError:  # no tissue there
                continue
            most = max(most, float(moved @ moved)) if np.isfinite(moved).all() else math.inf
        size = math.sqrt(most / found.residual_scale) if found.residual_scale > 0 else math.inf
        if size < 1.0:
            made[name] = size
    return made


__all__ = ["idle_parameters"]
