"""Where a value passes, and what a claim is about: what the thesis prints, a measured curve, or livlab itself."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from livlab.criteria.rounding import format_value
from livlab.errors import InputError

Group = Literal["reproduces", "agrees", "checks"]
GROUPS: tuple[Group, ...] = get_args(Group)
"""Sorts of claims, in the order in which reports show them."""

BOUNDS: dict[str, tuple[float, float]] = {
    "pearson": (-1.0, 1.0),
    "rmse": (0.0, math.inf),
    "mse": (0.0, math.inf),
    "squared error sum": (0.0, math.inf),
    "amplitude ratio": (0.0, math.inf),
    "colour difference": (0.0, math.inf),
    "energy residual": (0.0, math.inf),
    "relative error": (0.0, math.inf),
    "relative rms": (0.0, math.inf),
    "log ratio": (0.0, math.inf),
    "phase rmse": (0.0, math.inf),
    "anisotropy": (-1.0, 1.0),
    "chroma": (0.0, math.inf),
    "lightness": (0.0, 100.0),
    "seconds": (0.0, math.inf),
    "speed": (0.0, math.inf),
    "memory": (0.0, math.inf),
    "settled": (0.0, 1.0),
    "coverage": (0.0, 1.0),
    "widest interval": (0.0, math.inf),
    "checks that fail": (0.0, math.inf),
    "largest error over what it states": (0.0, math.inf),
}
"""Where a metric's value can lie at all. A limit there, or beyond, is none."""

COMPARING = {"rmse": 0.0, "mse": 0.0, "squared error sum": 0.0, "colour difference": 0.0, "pearson": 1.0,
             "amplitude ratio": 1.0}  # fmt: skip
"""Metrics that hold a curve or colour against another, and what they are where the two are alike."""

_SPELT = {"sum of squares": "squared error sum", "eqm": "mse", "correlation": "pearson"}
_OWN = re.compile(r" vs (goniometer|fit|rayleigh|bsdf\.eval|stochastic|cie|conservation|its maximum|oxyhaem)")


@dataclass(frozen=True)
class Wanted:
    """What a claim wants of its value.

    Attributes
    ----------
    group
        "reproduces" (a figure that the thesis prints), "agrees" (with a measurement), or "checks" (livlab's own).
    at_least, at_most
        Where the value passes; None: no limit on that side.
    reference, tolerance
        As the criterion gave them, if it did: what the limits were made of.
    """

    group: Group
    at_least: float | None
    at_most: float | None
    reference: float | None = None
    tolerance: float | None = None

    @property
    def text(self) -> str:
        """In words.

        >>> wanted("rmse", 0.0, 0.1).text, wanted("rmse", 0.19, 0.04).text, wanted("hue", at_least=15, at_most=60).text
        ('at most 0.1', '0.19 ± 0.04', '15 to 60')
        """
        return in_words(self.at_least, self.at_most, self.reference, self.tolerance)


def wanted(
    metric: str,
    reference: float | None = None,
    tolerance: float | None = None,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    group: Group | None = None,
) -> Wanted:
    """What a criterion wants, by the rule of docs/metrics.md.

    Limits that are given stand. From a reference and a tolerance they are reference ± tolerance, less

    - a limit that lies where the metric cannot go beyond (an RMSE of 0, a Pearson of 1): it is none;
    - where the criterion says that it is about agreement, the limit on the side of the better: an RMSE, mean square
      or colour difference cannot be too small, a Pearson not too large.

    Parameters
    ----------
    metric
        "rmse", "pearson", …; one that is not in `BOUNDS` can lie anywhere.
    reference, tolerance
        A two-sided form, or
    at_least, at_most
        one or two limits.
    group
        Which sort of claim it is. Not said: of a metric that compares, "agrees" where the reference is what two like
        curves have (0 of an error, 1 of a Pearson) or one limit is given, else "reproduces"; of any other, "checks".

    Raises
    ------
    InputError
        Neither or both forms are given, a number is not finite, the tolerance is below 0, or the limits do not rise.

    Examples
    --------
    >>> wanted("rmse", 0.19, 0.04).group, wanted("pearson", 1.0, 0.01).at_least
    ('reproduces', 0.99)
    >>> wanted("rmse", 0.19, 0.04, group="agrees").text
    'at most 0.23'
    """
    check_limits(reference, tolerance, at_least, at_most, about=f"{metric}: ")
    best = COMPARING.get(metric)
    if group is None:
        about = (at_least is None) != (at_most is None) if reference is None else reference == best
        group = "checks" if best is None else "agrees" if about else "reproduces"
    low, high = at_least, at_most
    if reference is not None and tolerance is not None:
        low, high = _that_bind(metric, _clean(reference - tolerance), _clean(reference + tolerance))
        least, most = BOUNDS.get(metric, (-math.inf, math.inf))
        if group == "agrees" and best == least and high is not None:
            low = None
        elif group == "agrees" and best == most and low is not None:
            high = None
    return Wanted(group, low, high, reference, tolerance)


def in_words(
    at_least: float | None, at_most: float | None, reference: float | None = None, tolerance: float | None = None
) -> str:
    """Limits in words: "at most 0.1", "0.19 ± 0.04", "15 to 60"; "–" where there is none."""
    if at_least is not None and at_most is not None:
        if reference is not None and tolerance is not None:
            return f"{format_value(reference)} ± {format_value(tolerance)}"
        return f"{format_value(at_least)} to {format_value(at_most)}"
    if at_least is not None:
        return f"at least {format_value(at_least)}"
    return "–" if at_most is None else f"at most {format_value(at_most)}"


def group_title(group: str, tissue: str = "liver") -> str:
    """Heading of a group of claims.

    >>> group_title("reproduces"), group_title("agrees"), group_title("agrees", "skin")
    ('Reproduces the thesis', 'Agrees with measured liver', 'Agrees with measured skin')
    """
    titles = {"reproduces": "Reproduces the thesis", "agrees": f"Agrees with measured {tissue}"}
    return titles.get(group, "Livlab's own checks")


def measured_tissue(config: Mapping[str, Any]) -> str:
    """The organ of an experiment, without "human"; "liver" where it names none.

    >>> measured_tissue({"tissue": {"inline": {"name": "human skin"}}}), measured_tissue({})
    ('skin', 'liver')
    """
    tissue = config.get("tissue")
    inline = tissue.get("inline") if isinstance(tissue, Mapping) else None
    name = str(inline.get("name", "")) if isinstance(inline, Mapping) else ""
    return "liver" if not name or "liver" in name.lower() else name.removeprefix("human ")


def metric_named(criterion: str) -> str:
    """The metric that a claim's name begins with, or its first word: names are all that an older table has.

    >>> metric_named("amplitude ratio, thesis"), metric_named("least of RMSE"), metric_named("peak of Hb")
    ('amplitude ratio', 'rmse', 'peak')
    """
    text = re.sub(r"^(least|largest) of ", "", criterion.strip().lower())
    text = "widest interval" if text.startswith("widest interval") else text
    known = [m for m in (*BOUNDS, *_SPELT) if re.match(rf"{re.escape(m)}(?!\w| difference)", text)]
    found = max(known, key=len, default=text.split(" ")[0].strip(",:") if text else "")
    return _SPELT.get(found, found)


def wanted_then(criterion: str, reference: float | None, tolerance: float | None) -> Wanted:
    """What a claim of an older table wants, told by its name."""
    group: Group | None = "checks" if _OWN.search(criterion.lower()) else None
    if reference is None or tolerance is None:
        return Wanted(group or ("reproduces" if metric_named(criterion) in COMPARING else "checks"), None, None)
    return wanted(metric_named(criterion), reference, tolerance, group=group)


def check_limits(
    reference: float | None,
    tolerance: float | None,
    at_least: float | None,
    at_most: float | None,
    *,
    about: str = "",
) -> None:
    """Whether one of the two forms is given, and holds together.

    Raises
    ------
    InputError
        Neither or both are, a number is not finite, the tolerance is below 0, or the limits do not rise.
    """
    given = {"reference": reference, "tolerance": tolerance, "at_least": at_least, "at_most": at_most}
    for what, number in given.items():
        if number is not None and (not math.isfinite(number) or (what == "tolerance" and number < 0)):
            bound = "must be a finite number" + (" ≥ 0" if what == "tolerance" else "")
            raise InputError.of(f"{about}{what}", number, bound, "Leave it out where there is none.")
    two = reference is not None and tolerance is not None
    limits = at_least is not None or at_most is not None
    if two == limits or (reference is None) != (tolerance is None):
        said = {k: v for k, v in given.items() if v is not None}
        bound = "needs reference and tolerance, or at_least, at_most or both"
        raise InputError.of(f"{about}limits", said, bound, "Give one of the two forms.")
    if at_least is not None and at_most is not None and not at_least <= at_most:
        raise InputError.of(f"{about}at_most", at_most, f"must not be below at_least = {at_least:g}", "Swap them.")


def within(metric: str, low: float, high: float, group: Group | None = None) -> Wanted:
    """What [low, high] wants; a limit where the metric cannot go beyond is none.

    >>> within("chroma", 0.0, 8.0).text, within("hue", 15.0, 60.0).text
    ('at most 8', '15 to 60')
    """
    least, most = _that_bind(metric, low, high)
    return wanted(metric, at_least=least, at_most=most, group=group)


def _that_bind(metric: str, low: float, high: float) -> tuple[float | None, float | None]:
    """Limits less those where the metric cannot go beyond; both, where that would leave none."""
    least, most = BOUNDS.get(metric, (-math.inf, math.inf))
    if low <= least and high >= most:
        return low, high
    return (low if low > least else None), (high if high < most else None)


def _clean(number: float) -> float:
    """1 − 0.99 is 0.010000000000000009 in binary: a limit is what a person would write."""
    return float(f"{number:.12g}")
