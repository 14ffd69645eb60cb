"""Many claims at once: how sure the verdicts are together, and what a false alarm costs.

A verdict by the rule of two standard errors is wrong in 2.3 % of repetitions at most; among many, one will be.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from livlab.criteria.claim import Claim
from livlab.criteria.judging import FALSE_ALARM

LEVEL = 0.05
"""Family-wise level against which Holm's p-values are held."""

AGAIN = 4.0
"""A verdict in doubt is looked at again with so many times the samples: half the error."""


def holm(p: Sequence[float]) -> tuple[float, ...]:
    """p-values adjusted for being many (Holm 1979, Scand. J. Stat. 6, 65): holds whatever their dependence.

    Of m, the k-th smallest is multiplied by m − k + 1, made to rise, and cut at 1. One is below α where a family-wise
    error of α allows to reject.

    >>> holm([0.01, 0.04, 0.03])
    (0.03, 0.06, 0.06)
    """
    order = sorted(range(len(p)), key=lambda k: p[k])
    adjusted, largest = [0.0] * len(p), 0.0
    for rank, k in enumerate(order):
        largest = max(largest, (len(p) - rank) * p[k])
        adjusted[k] = min(1.0, largest)
    return tuple(adjusted)


def sidak(count: int, alpha: float = FALSE_ALARM) -> float:
    """Chance of at least one false alarm of `count` independent ones, each of chance alpha: 1 − (1 − α)^m (Šidák 1967).

    >>> round(sidak(1), 4), round(sidak(100), 2)
    (0.0228, 0.9)
    """
    return float(1.0 - (1.0 - alpha) ** count)


@dataclass(frozen=True)
class InFamily:
    """A statistical claim among the others.

    Attributes
    ----------
    where, criterion, verdict, group
        Experiment, claim, and what was found.
    p
        Of a FAIL: p-value of "the truth lies within the limits". Of a PASS: of "it lies beyond one".
    p_holm
        The same, adjusted for all statistical claims: how sure this verdict is among them.
    again_seconds
        What it takes to look again, with `AGAIN` times the samples.
    """

    where: str
    criterion: str
    verdict: str
    group: str
    p: float
    p_holm: float
    again_seconds: float


@dataclass(frozen=True)
class FamilyError:
    """What the verdicts of many claims are worth together.

    Attributes
    ----------
    claims
        Statistical ones: those whose value has an error.
    decided
        Those of them that PASS or FAIL.
    at_most
        Chance of at least one wrong verdict among them if every truth lay at its limit: Šidák's, for independent ones.
    bonferroni
        The same whatever their dependence: m α, at most 1.
    members
        Every statistical claim; those that FAIL first, then by p.
    """

    claims: int
    decided: int
    at_most: float
    bonferroni: float
    members: tuple[InFamily, ...]

    @property
    def failed(self) -> tuple[InFamily, ...]:
        """Those that FAIL."""
        return tuple(m for m in self.members if m.verdict == "FAIL")

    @property
    def doubtful(self) -> tuple[InFamily, ...]:
        """Those that FAIL and could be a false alarm: not below `LEVEL` after Holm."""
        return tuple(m for m in self.failed if m.p_holm > LEVEL)


def family_error(claims: Iterable[tuple[str, Claim]]) -> FamilyError:
    """Family-wise error of the statistical claims among those given with their experiment.

    Each is a test of "the truth lies on the other side": of a FAIL that it lies within the limits, of any other that it
    lies beyond one. Holm's adjustment is over all of them.
    """
    found = [(where, c) for where, c in claims if c.statistical]
    p = [float((c.p_within if c.verdict == "FAIL" else c.p_beyond) or 0.0) for _, c in found]
    members = [
        InFamily(where, c.criterion, c.verdict, c.group, one, adjusted, AGAIN * c.seconds)
        for (where, c), one, adjusted in zip(found, p, holm(p), strict=True)
    ]
    members.sort(key=lambda m: (m.verdict != "FAIL", m.verdict != "TOO CLOSE", -m.p))
    m = len(found)
    decided = sum(c.verdict in ("PASS", "FAIL") for _, c in found)
    return FamilyError(m, decided, sidak(m), min(1.0, m * FALSE_ALARM), tuple(members))
