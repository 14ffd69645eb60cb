"""Which combinations of the parameters the data hold, and which they do not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from livlab.optimise.covariance import Covariance
from livlab.units import FloatArray

WEAK_CONDITION = 400.0
"""Of the scaled information: two parameters with |correlation| 0.995 have it."""

LOST_CONDITION = 1e5
"""The same for |correlation| 0.99998: what is left of the pair is one number."""

NAMED_SHARE = 0.25
"""A parameter is named in a combination from this share of the largest component on."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """A verdict: "held", "weak" or "not held".

    Attributes
    ----------
    verdict
        The worst found.
    condition
        Largest over smallest eigenvalue of the information scaled to unit diagonal; 1 for independent parameters.
    combination
        Parameters of the least held direction with their relative (log, logit: share; linear: unit) displacement.
    pairs
        (name, name, correlation) of pairs beyond 0.95, the worst first.
    alone
        Parameters that the data would not hold even if all others were known.
    sentences
        The same in words.
    """

    verdict: str
    condition: float
    combination: dict[str, float]
    pairs: tuple[tuple[str, str, float], ...]
    alone: tuple[str, ...]
    sentences: tuple[str, ...]

    def __bool__(self) -> bool:
        return self.verdict == "held"


def identifiability(
    found: Covariance, *, weak: float = WEAK_CONDITION, lost: float = LOST_CONDITION
) -> Identifiability:
    """Judge a fit by the eigenvectors of its information, scaled to unit diagonal (Belsley, Kuh & Welsch 1980, ch. 3).

    Parameters
    ----------
    found
        From `covariance` or `covariance_of_residuals`.
    weak, lost
        Condition numbers from which the verdict is "weak" and "not held".
    """
    names = list(found.matrix.index)
    information = found.information.to_numpy()
    if not names:
        return Identifiability("held", 1.0, {}, (), (), ())
    alone = tuple(name for k, name in enumerate(names) if _wider_than_box(found, name, information[k, k]))
    measured = [k for k, name in enumerate(names) if name not in alone]
    sentences = [
        f"the data do not hold {name}: moving it over half its range changes less than noise" for name in alone
    ]
    condition, combination = 1.0, {}
    verdict = "not held" if alone else "held"
    if len(measured) > 1:
        block = information[np.ix_(measured, measured)]
        scale = np.sqrt(np.diag(block))
        eigen, vectors = np.linalg.eigh(block / np.outer(scale, scale))
        condition = math.inf if eigen[0] <= 0 else float(eigen[-1] / eigen[0])
        if condition >= weak:
            verdict = "not held" if condition >= lost or alone else "weak"
            combination = _combination([names[k] for k in measured], vectors[:, 0], scale)
            sentences.append(_in_words(found, combination, condition, condition >= lost))
    pairs = _pairs(found)
    return Identifiability(verdict, condition, combination, pairs, alone, tuple(sentences))


def _wider_than_box(found: Covariance, name: str, curvature: float) -> bool:
    p = found.space.by_name[name]
    if not curvature > 0:
        return True
    width = p.inward(p.high) - p.inward(p.low)
    return math.isfinite(width) and 1.0 / math.sqrt(curvature) > 0.5 * width


def _combination(names: list[str], vector: FloatArray, scale: FloatArray) -> dict[str, float]:
    largest = float(np.abs(vector).max())
    kept = [k for k in range(len(names)) if abs(vector[k]) >= NAMED_SHARE * largest]
    moves = vector / scale
    first = moves[max(kept, key=lambda k: abs(vector[k]))]
    return {names[k]: float(moves[k] / first) for k in kept}


def _in_words(found: Covariance, combination: dict[str, float], condition: float, lost: bool) -> str:
    lead = next(name for name, move in combination.items() if move == 1.0)
    p = found.space.by_name[lead]
    size = 0.01 * max(abs(found.values[lead]), 1e-12) if p.transform == "linear" else 0.01
    parts = []
    for name, move in combination.items():
        change = size * move
        log = found.space.by_name[name].transform == "log"
        shown = f"{100 * change:+.3g} %" if log else f"{change:+.3g}"
        parts.append(f"{name} {shown}")
    how = "do not hold" if lost else "hardly hold"
    return f"the data {how} the combination {', '.join(parts)}: it changes next to nothing (condition {condition:.2g})"


def _pairs(found: Covariance) -> tuple[tuple[str, str, float], ...]:
    names = list(found.correlation.index)
    matrix = found.correlation.to_numpy()
    strong = [
        (names[a], names[b], float(matrix[a, b]))
        for a in range(len(names))
        for b in range(a)
        if abs(matrix[a, b]) > 0.95
    ]
    return tuple(sorted(strong, key=lambda entry: -abs(entry[2])))
