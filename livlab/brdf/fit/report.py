"""From an optimum to what its reader is told: the table of parameters, what is measured together, the warnings."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from livlab.brdf.fit.data import Packed, in_words
from livlab.brdf.fit.problem import BrdfProblem, Layout
from livlab.brdf.fit.spread import Spread
from livlab.optimise import Identifiability, OptimiseResult
from livlab.optimise.misfit import Misfit


def parameter_table(
    layout: Layout,
    values: Mapping[str, float],
    status: Mapping[str, str],
    sure: Spread,
    held: Identifiability,
) -> pd.DataFrame:
    """One row a parameter."""
    meanings = {p.name: p.meaning for p in layout.model.parameters}
    loose = not_held(held)
    rows = []
    for p in layout.parameters:
        base = layout.base_name[p.name]
        label = p.name[len(base) :].strip("[]")
        span = sure.intervals if p.name in sure.intervals.index else None
        rows.append(
            {
                "parameter": p.name,
                "value": values[p.name],
                "sd": sure.robust.sd.get(p.name, math.nan),
                "sd_independent": sure.independent.sd.get(p.name, math.nan),
                "lower": math.nan if span is None else float(span["lower"][p.name]),
                "upper": math.nan if span is None else float(span["upper"][p.name]),
                "widened": sure.widened.get(p.name, 1.0),
                "status": status[p.name],
                "held": p.name not in loose,
                "channel": label,
                "meaning": meanings[base],
            }
        )
    return pd.DataFrame(rows).set_index("parameter")


def not_held(held: Identifiability) -> set[str]:
    """Parameters whose value means nothing by itself."""
    return {*held.alone, *(held.combination if held.verdict == "not held" else ())}


def combinations_in_words(
    layout: Layout, values: Mapping[str, float], sure: Spread, held: Identifiability
) -> tuple[str, ...]:
    """The product that stays put while two logarithmic (or scale) parameters trade against each other."""
    if held.verdict != "not held" or len(held.combination) != 2:
        return ()
    (a, move_a), (b, move_b) = held.combination.items()
    # Relative moves; a scale is linear in the table but acts as a factor.
    space = layout.space
    relative = {
        n: m if space.by_name[n].transform == "log" else m / values[n] if values[n] else math.nan
        for n, m in ((a, move_a), (b, move_b))
    }
    if not all(math.isfinite(m) and m != 0 for m in relative.values()):
        return ()
    power = -relative[a] / relative[b]
    product = values[a] * values[b] ** power
    matrix = sure.robust.matrix
    grad = np.array([1.0 / values[a], power / values[b]])
    moments = matrix.loc[[a, b], [a, b]].to_numpy(dtype=np.float64)
    share = math.sqrt(max(float(grad @ moments @ grad), 0.0))
    name = f"{a} x {b}" if abs(power - 1) < 0.02 else f"{a} x {b}^{power:.3g}"
    return (f"{name} = {product:.6g} +- {product * share:.2g}",)


def sentences(
    problem: BrdfProblem,
    found: OptimiseResult,
    held: Identifiability,
    sure: Spread,
    missed: Misfit,
) -> list[str]:
    """Warnings, the gravest first."""
    data = problem.data
    notes = [missed.words, *data.notes] if missed.told else list(data.notes)
    low, high = np.degrees([data.theta_d.min(), data.theta_d.max()])
    fresnel = {"eta", "k", "F0", "Rs"}
    if held.verdict == "not held":
        bases = {problem.layout.base_name[n] for n in not_held(held)}
        why = f"; theta_d spans only {low:.1f} to {high:.1f} deg" if bases & fresnel else ""
        notes += [f"{s}{why}" for s in held.sentences]
    elif held.verdict == "weak":
        notes += list(held.sentences)
    for name, word in found.status.items():
        if word.startswith("at "):
            notes.append(f"{name} = {found.best[name]:.6g} sits {word}: widen it, fix it, or mistrust the model")
    if not found.converged:
        notes.append(f"the search did not converge: {found.stop}")
    if data.dropped:
        notes.append(f"{data.dropped} samples were left out: not finite, or below the surface")
    if problem.loss.clipped:
        notes.append(f"{problem.loss.clipped} values were too far below zero for the log and were raised")
    if data.footprint == in_words(None):
        notes.append("pixels were not integrated: a lobe of few pixels is read too wide")
    narrow = _narrowest(problem.layout, found.best)
    if data.source_rad > 0.4 * narrow:
        notes.append(
            f"the lights' angular radius of {math.degrees(data.source_rad):.2g} deg is not integrated: a lobe as "
            f"narrow as {narrow:.2g} is read too wide"
        )
    notes += _too_narrow(data, narrow)
    if np.unique(data.light).size == 1 and sure.effective < 200:
        notes.append(f"one light and {sure.effective:.0f} independent residuals: intervals and criteria are rough")
    return notes


PIXELS_A_LOBE = 4.5
"""Radius of the sphere in pixels, times alpha, from which its core is read to 1 % (-0.2 / (R alpha)² at centres)."""

UNSAID_LAMP_RAD = math.radians(5.0)
"""Angular radius of a lamp that nobody would overlook; where a lobe allows more, an unknown size is not told."""


def _too_narrow(data: Packed, narrow: float) -> list[str]:
    """What the narrowest lobe asks of the sphere's picture and of the lamps."""
    notes = []
    needed = PIXELS_A_LOBE / narrow
    if data.radius_px < needed:
        notes.append(
            f"a lobe of alpha {narrow:.2g} on a ball of {data.radius_px:.0f} px radius: 1 % in its core needs "
            f"{needed:.0f} px (4.5 / alpha), so alpha and the lobe's height rest on how pixels are integrated"
        )
    limit = 0.4 * narrow
    if not data.source_known and data.source_rad == 0 and limit < UNSAID_LAMP_RAD:
        notes.append(
            f"the lamps' size was not said (solid_angle_sr): a lobe of alpha {narrow:.2g} is read to 1 % if their "
            f"angular radius is below {math.degrees(limit):.2g} deg, and too wide otherwise"
        )
    return notes


def _narrowest(layout: Layout, values: Mapping[str, float]) -> float:
    """Width of the narrowest lobe as a roughness; exponents count as sqrt(2 / (n + 2)) (Walter et al. 2007, p. 8).

    A disc of angular radius r widens alpha squared by about r²/16, 1 % of alpha from r = 0.4 alpha on.
    """
    widths = [math.inf]
    for label, value in values.items():
        name = layout.base_name[label].rstrip("0123456789")
        if name == "alpha":
            widths.append(value)
        elif name == "exponent":
            widths.append(math.sqrt(2.0 / (value + 2.0)))
    return min(widths)
