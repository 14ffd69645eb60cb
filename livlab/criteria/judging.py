"""The rule by which a number with an error is held against its limits, and the samples that would settle it.

A verdict is a statement about the truth, and a sampled value is not the truth. So a verdict needs the value to lie
more than `SIGMAS` standard errors from the limit: wherever the truth is, a PASS that should be a FAIL, or a FAIL that
should be a PASS, comes up in 2.3 % of repetitions at most. Nearer than that it is TOO CLOSE.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["PASS", "FAIL", "TOO CLOSE", "MISSING"]
VERDICTS: tuple[Verdict, ...] = ("PASS", "FAIL", "TOO CLOSE", "MISSING")
"""In the order in which they are shown."""

SIGMAS = 2.0
"""A value must lie farther than this many standard errors from a limit for a verdict."""

SETTLED = 0.93
"""Chance with which the samples that are asked for settle a claim; told as 9 in 10, which leaves some room."""

NEAR = 0.97
"""Share of what endless samples settle at which more are no longer worth it."""

NARROW = 2.277
"""Standard errors for a FAIL of a claim whose two limits coincide: both tails count, 2 Φ(−2.277) = Φ(−2)."""

MOST_SAMPLES = 1e9
"""A factor beyond this is no advice."""


def below(z: float) -> float:
    """Normal distribution function Φ(z).

    >>> round(below(-2.0), 5)
    0.02275
    """
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


FALSE_ALARM = below(-SIGMAS)
"""Largest chance of a wrong verdict: 2.3 %."""


def judge(value: float, standard_error: float, at_least: float | None, at_most: float | None) -> Verdict:
    """The verdict on a number.

    Exact numbers pass on a limit or within. Others PASS where they lie within every limit by more than two standard
    errors, FAIL where they lie beyond one by more than that, and are TOO CLOSE otherwise. Of two limits nearer to each
    other than about two standard errors, both tails can make a false FAIL: there a FAIL needs `outside` < Φ(−2).

    >>> judge(0.98943, 0.00094, 0.99, None), judge(0.98, 0.00094, 0.99, None), judge(0.149, 0.0, None, 0.23)
    ('TOO CLOSE', 'FAIL', 'PASS')
    """
    low, high = _ends(at_least, at_most)
    slack = 1e-12 * max(abs(value), *(abs(x) for x in (low, high) if math.isfinite(x)), 0.0)
    inner, outer = min(value - low, high - value), max(low - value, value - high)
    if standard_error == 0:
        return "PASS" if outer <= slack else "FAIL"
    margin = SIGMAS * standard_error * (1 + 1e-9) + slack
    if inner > margin:
        return "PASS"
    if outer > margin and outside(value, standard_error, at_least, at_most) < FALSE_ALARM:
        return "FAIL"
    return "TOO CLOSE"


def outside(value: float, standard_error: float, at_least: float | None, at_most: float | None) -> float:
    """p-value of "the truth lies within its limits": chance of a value as far out, the truth being at the worst place.

    p = Φ(−d) + Φ(−d − w), d the distance beyond the nearer limit and w that between the limits, both in standard
    errors; below 0 inside. Small of a FAIL.

    >>> round(outside(1.2, 0.1, None, 1.0), 5), outside(0.5, 0.1, None, 1.0) > 0.999
    (0.02275, True)
    """
    low, high = _ends(at_least, at_most)
    out, width = max(low - value, value - high), high - low
    if standard_error == 0:
        return 1.0 if out <= 1e-12 * max(abs(value), 1e-300) else 0.0
    d = out / standard_error
    return min(1.0, below(-d) + below(-d - width / standard_error))


def inside(value: float, standard_error: float, at_least: float | None, at_most: float | None) -> float:
    """p-value of "the truth lies beyond a limit", the larger of the two sides (Schuirmann 1987). Small of a PASS.

    >>> round(inside(0.8, 0.1, None, 1.0), 5)
    0.02275
    """
    low, high = _ends(at_least, at_most)
    room = min(value - low, high - value)
    if standard_error == 0:
        return 0.0 if room >= 0 else 1.0
    return below(-room / standard_error)


@dataclass(frozen=True)
class Drawn:
    """A number judged, and how it would come out with more samples.

    With N times the samples the error is s = √((σ² − f²)/N + f²), f its part that no sample mends. The truth is not
    known better than the value tells, so the value then found is foreseen as normal about today's with the variance
    (σ² − f²)(1 + 1/N): another draw about a truth that today's value gives to within its error.

    Attributes
    ----------
    value, standard_error
        Today's.
    at_least, at_most
        The limits.
    fixed
        Part f of the standard error that more samples leave as it is: of the reference, of a systematic effect.
    """

    value: float
    standard_error: float
    at_least: float | None
    at_most: float | None
    fixed: float = 0.0

    @property
    def sampled(self) -> float:
        """The part of the standard error that samples mend."""
        return math.sqrt(max(self.standard_error**2 - self.fixed**2, 0.0))

    def settled(self, factor: float) -> float:
        """Chance that so many times the samples leave it no longer TOO CLOSE."""
        low, high = _ends(self.at_least, self.at_most)
        s = math.sqrt(self.sampled**2 / factor + self.fixed**2)
        spread = self.sampled * math.sqrt(1 + 1 / factor)
        near = SIGMAS if high - low > 4 * s else NARROW
        zones = [(x - near * s, x + near * s) for x in (low, high) if math.isfinite(x)]
        if len(zones) == 2 and zones[0][1] >= zones[1][0]:
            zones = [(zones[0][0], zones[1][1])]
        if spread == 0:
            return 1.0 - float(any(a <= self.value <= b for a, b in zones))
        return 1.0 - sum(below((b - self.value) / spread) - below((a - self.value) / spread) for a, b in zones)

    def needs(self) -> float:
        """How many times the samples settle it in 9 of 10 cases: the least factor of which `settled` is `SETTLED`.

        Where endless samples settle less, since a part of the error is fixed: the factor that comes near to what they
        do. Rounded up to two digits; inf where even they would not settle half of the cases.
        """
        most = self.settled(MOST_SAMPLES)
        aim = SETTLED if most >= SETTLED else NEAR * most
        if self.sampled == 0 or most < 0.5:
            return math.inf
        few, many = 0.0, math.log(MOST_SAMPLES)
        for _ in range(60):
            middle = (few + many) / 2
            few, many = (few, middle) if self.settled(math.exp(middle)) >= aim else (middle, many)
        return _up(math.exp(many))

    def if_it_stays(self) -> float:
        """How many times the samples would do if the value stayed where it is; inf if none would."""
        low, high = _ends(self.at_least, self.at_most)
        gap = min(abs(self.value - x) for x in (low, high)) / SIGMAS
        left = gap**2 - self.fixed**2
        factor = self.sampled**2 / left if left > 0 else math.inf
        return math.inf if factor > MOST_SAMPLES or factor == 0 else _up(factor)


def verdict_counts(rows: Iterable[Mapping[str, Any]]) -> tuple[tuple[str, int], ...]:
    """Number of claims by verdict, those that there are, in the order in which they are shown."""
    counts = Counter(row["verdict"] for row in rows)
    return tuple((v, counts[v]) for v in VERDICTS if counts[v])


def former_judge(value: float, standard_error: float, reference: float, tolerance: float) -> tuple[Verdict, str]:
    """Verdict and note by the rule before result version 4: |value − reference| ≤ tolerance, and enough power."""
    slack = 1e-12 * max(abs(value), abs(reference), tolerance)
    if standard_error > tolerance / 2 + slack:
        return "FAIL", f"underpowered: standard error {standard_error:g} exceeds half the tolerance {tolerance:g}"
    return ("PASS" if abs(value - reference) <= tolerance + slack else "FAIL"), ""


def _ends(at_least: float | None, at_most: float | None) -> tuple[float, float]:
    return -math.inf if at_least is None else at_least, math.inf if at_most is None else at_most


def _up(factor: float) -> float:
    """Rounded up to two digits."""
    step = 10.0 ** (math.floor(math.log10(factor)) - 1)
    return float(f"{math.ceil(factor / step - 1e-9) * step:.3g}")
