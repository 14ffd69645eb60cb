"""What round trips say: how often intervals held the truth, with binomial intervals, and what is not identifiable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from livlab.kinds.fit.round_trip import Held, Trip

MOSTLY = 0.5
"""Share of the tissues from which on a parameter is named as not held, or not held apart from another."""

PARAMETERS = (
    "parameter",
    "tissues",
    "inside",
    "coverage",
    "coverage_low",
    "coverage_high",
    "normal_coverage",
    "width",
    "spans",
    "partner",
    "together",
    "verdict",
)
TISSUES = ("tissue", "parameter", "truth", "value", "lower", "upper", "open", "inside", "chi2_truth", "chi2", "numbers")


def by_parameter(trips: Sequence[Trip], labels: Mapping[str, str]) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """A row a parameter: coverage with its 95 % binomial interval (Clopper & Pearson 1934), and what is not held.

    `width` is the median width of the intervals as a share of the (transformed) box; `normal_coverage` that of the
    intervals that the covariance alone gives, where it gives any.
    """
    rows: list[dict[str, object]] = []
    for name in _names(trips):
        held = _of(trips, name)
        inside = sum(h.inside for h in held)
        low, high = binomial(inside, len(held))
        normal = [h.normal for h in held if h.normal is not None]
        partners = Counter(h.partner for h in held if h.partner)
        partner, together = partners.most_common(1)[0] if partners else ("", 0)
        rows.append(
            {
                "parameter": labels.get(name, name),
                "tissues": len(held),
                "inside": inside,
                "coverage": inside / len(held),
                "coverage_low": low,
                "coverage_high": high,
                "normal_coverage": float(np.mean(normal)) if normal else None,
                "width": float(np.median([h.width for h in held])),
                "spans": sum(h.spans for h in held),
                "partner": labels.get(partner, partner),
                "together": together,
                "verdict": _verdict(held, together),
            }
        )
    return PARAMETERS, rows


def by_tissue(trips: Sequence[Trip], labels: Mapping[str, str]) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """A row a tissue and parameter."""
    rows: list[dict[str, object]] = [
        {
            "tissue": k + 1,
            "parameter": labels.get(h.parameter, h.parameter),
            "truth": h.truth,
            "value": h.value,
            "lower": h.interval.lower,
            "upper": h.interval.upper,
            "open": {(0, 0): "", (1, 0): "below", (0, 1): "above", (1, 1): "both"}[
                int(h.interval.open_below), int(h.interval.open_above)
            ],
            "inside": h.inside,
            "chi2_truth": trip.chi2_truth,
            "chi2": trip.chi2_best,
            "numbers": trip.numbers,
        }
        for k, trip in enumerate(trips)
        for h in trip.held
    ]
    return TISSUES, rows


def overall(trips: Sequence[Trip]) -> tuple[float, float] | None:
    """Share of intervals that hold the truth, of all that say anything, and its standard error; None if none does.

    Those from bound to bound are left out. The error is binomial, with one more of each kind so that it is not 0 where
    all hold.
    """
    said = [h.inside for trip in trips for h in trip.held if not h.spans]
    if not said:
        return None
    share = (sum(said) + 1.0) / (len(said) + 2.0)
    return float(np.mean(said)), float(np.sqrt(share * (1.0 - share) / len(said)))


def sentences(trips: Sequence[Trip], labels: Mapping[str, str]) -> list[str]:
    """What cannot be identified, by name."""
    told = []
    for name in _names(trips):
        held = _of(trips, name)
        spans = sum(h.spans for h in held)
        if spans > MOSTLY * len(held):
            told.append(
                f"{labels.get(name, name)} cannot be identified: in {spans} of {len(held)} simulated tissues its "
                "interval reaches from bound to bound."
            )
    seen = set()
    for name in _names(trips):
        held = _of(trips, name)
        for partner, count in Counter(h.partner for h in held if h.partner).items():
            pair = frozenset((name, partner))
            if count > MOSTLY * len(held) and pair not in seen:
                seen.add(pair)
                told.append(
                    f"{labels.get(name, name)} and {labels.get(partner, partner)} cannot be told apart: they correlate "
                    f"beyond 0.95 in {count} of {len(held)} simulated tissues."
                )
    return told


def binomial(successes: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Exact interval of a share (Clopper & Pearson 1934).

    >>> [round(x, 3) for x in binomial(47, 50)]
    [0.835, 0.987]
    """
    from scipy.stats import binomtest

    found = binomtest(successes, trials).proportion_ci(level, method="exact")
    return float(found.low), float(found.high)


def _names(trips: Sequence[Trip]) -> list[str]:
    return list(dict.fromkeys(h.parameter for trip in trips for h in trip.held))


def _of(trips: Sequence[Trip], name: str) -> list[Held]:
    return [h for trip in trips for h in trip.held if h.parameter == name]


def _verdict(held: Sequence[Held], together: int) -> str:
    if sum(h.spans for h in held) > MOSTLY * len(held):
        return "not identifiable"
    return "not alone" if together > MOSTLY * len(held) else "identifiable"


__all__ = ["binomial", "by_parameter", "by_tissue", "overall", "sentences"]
