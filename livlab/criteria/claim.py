"""A claim as an object: a number with its error, held against limits, and the verdict that follows.

What is written is what was judged: a value has the digits that its standard error supports, and more where the verdict
hangs on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from livlab.criteria.judging import (
    MOST_SAMPLES,
    SETTLED,
    SIGMAS,
    Drawn,
    Verdict,
    former_judge,
    inside,
    judge,
    outside,
)
from livlab.criteria.limits import BOUNDS, Group, Wanted, metric_named, wanted, wanted_then
from livlab.criteria.rounding import format_value, round_to_error
from livlab.errors import InputError

Rule = Literal["two errors", "tolerance"]
"""How a verdict came about: by its distance from the limits in standard errors, or, before result version 4, by
|value − reference| ≤ tolerance with a standard error of at most half the tolerance."""


@dataclass(frozen=True)
class Claim:
    """One line of claims.csv.

    Attributes
    ----------
    criterion
        Its name: metric, reading and reference ("pearson measured vs human liver 500-720").
    value, standard_error
        The number found and its standard error (0 for an exact number); None where it is MISSING.
    reference, tolerance
        What the limits were made of, where the criterion gave them.
    verdict
        PASS or FAIL where the value lies more than two standard errors within or beyond its limits, TOO CLOSE
        between; an exact number PASSes on a limit or within. MISSING where there is nothing to judge.
    seconds
        What it cost.
    note
        What would settle it where it is too close, or why it is missing; kept beside the CSV, not in it.
    group
        "reproduces" the thesis, "agrees" with a measurement, or "checks" of livlab itself.
    at_least, at_most
        The limits; None where there is none on that side.
    needs
        Where it is TOO CLOSE: how many times today's samples settle it in 9 of 10 cases. Where none settle so many,
        since a part of the error is the reference's: beyond how many more do not help, or inf.
    rule
        "tolerance" for a claim of an older run, whose verdict is shown as it was given then.
    """

    criterion: str
    value: float | None
    standard_error: float | None
    reference: float | None
    tolerance: float | None
    verdict: Verdict
    seconds: float = 0.0
    note: str = ""
    group: Group = "checks"
    at_least: float | None = None
    at_most: float | None = None
    needs: float | None = None
    rule: Rule = "two errors"

    def __post_init__(self) -> None:
        if not self.criterion.strip() or any(c in self.criterion for c in "\r\n\0"):
            raise InputError.of("criterion", self.criterion, "must be one line of text", "Name the criterion.")
        if not (math.isfinite(self.seconds) and self.seconds >= 0):
            raise InputError.of(f"{self.criterion}: seconds", self.seconds, "must be finite and ≥ 0", "Mend it.")
        if self.at_least is None and self.at_most is None:
            known = wanted_then(self.criterion, self.reference, self.tolerance)
            object.__setattr__(self, "at_least", known.at_least)
            object.__setattr__(self, "at_most", known.at_most)
        if self.verdict == "MISSING":
            return
        value, error = _numbers(self.criterion, self.value, self.standard_error)
        if self.rule == "tolerance":
            expected = former_judge(value, error, *_former_numbers(self))[0]
        else:
            _limits(self.criterion, self.at_least, self.at_most)
            expected = judge(value, error, self.at_least, self.at_most)
        if self.verdict != expected:
            raise InputError.of(
                f"{self.criterion}: verdict", self.verdict, f"the numbers say {expected}", "Use Claim.of, which judges."
            )

    @classmethod
    def of(
        cls,
        criterion: str,
        value: float,
        standard_error: float,
        reference: float | None = None,
        tolerance: float | None = None,
        *,
        at_least: float | None = None,
        at_most: float | None = None,
        group: Group | None = None,
        seconds: float = 0.0,
        fixed: float = 0.0,
        samples: str = "samples",
    ) -> Claim:
        """Judge a number, and say of one that is too close what would settle it.

        Parameters
        ----------
        criterion
            Its name; the metric is what it begins with.
        value, standard_error
            The number and its error, 0 for an exact one.
        reference, tolerance, at_least, at_most, group
            As `wanted`.
        seconds
            What it cost.
        fixed
            Part of the standard error that more samples do not mend (the reference's).
        samples
            What is drawn more of ("samples", "round trips").

        Examples
        --------
        >>> Claim.of("pearson", 0.99512, 0.0004, 1.0, 0.01).verdict
        'PASS'
        >>> Claim.of("rmse a vs liver", 0.149, 0.004, at_most=0.23).verdict
        'PASS'
        >>> close = Claim.of("pearson", 0.98943, 0.00094, 1.0, 0.01)
        >>> close.verdict, close.needs
        ('TOO CLOSE', 360.0)
        >>> print(close.note)
        0.606 standard errors from its limit 0.99: needs about 360 × the samples, which settle 9 cases in 10; 11 × if the value stays where it is.
        """  # noqa: E501
        aim = wanted(
            metric_named(criterion), reference, tolerance, at_least=at_least, at_most=at_most, group=group
        )  # fmt: skip
        return cls.judged(criterion, value, standard_error, aim, seconds=seconds, fixed=fixed, samples=samples)

    @classmethod
    def judged(
        cls,
        criterion: str,
        value: float,
        standard_error: float,
        aim: Wanted,
        *,
        seconds: float = 0.0,
        fixed: float = 0.0,
        samples: str = "samples",
    ) -> Claim:
        """Judge a number against what is wanted of it; arguments as those of `Claim.of`."""
        value, standard_error = _numbers(criterion, float(value), float(standard_error))
        _limits(criterion, aim.at_least, aim.at_most)
        low, high = aim.at_least, aim.at_most
        verdict = judge(value, standard_error, low, high)
        note, needs = "", None
        if verdict == "TOO CLOSE":
            needs, note = _what_settles(Drawn(value, standard_error, low, high, fixed), samples)
        value, standard_error = _written(value, standard_error, aim, verdict)
        return cls(
            criterion=criterion,
            value=value,
            standard_error=standard_error,
            reference=aim.reference,
            tolerance=aim.tolerance,
            verdict=verdict,
            seconds=float(seconds),
            note=note,
            group=aim.group,
            at_least=low,
            at_most=high,
            needs=needs,
        )

    @classmethod
    def missing(
        cls,
        criterion: str,
        reason: str,
        *,
        reference: float | None = None,
        tolerance: float | None = None,
        aim: Wanted | None = None,
        seconds: float = 0.0,
    ) -> Claim:
        """A claim that cannot be judged, with the reason; `aim` stands for reference and tolerance.

        >>> Claim.missing("pearson thesis vs Nachabé 2011", "reference not available").verdict
        'MISSING'
        """
        if not reason.strip():
            raise InputError.of(f"{criterion}: reason", reason, "a missing claim must say why", "Give the reason.")
        aim = aim or wanted_then(criterion, reference, tolerance)
        return cls(
            criterion=criterion,
            value=None,
            standard_error=None,
            reference=aim.reference if reference is None else reference,
            tolerance=aim.tolerance if tolerance is None else tolerance,
            verdict="MISSING",
            seconds=seconds,
            note=reason,
            group=aim.group,
            at_least=aim.at_least,
            at_most=aim.at_most,
        )

    @property
    def wanted(self) -> str:
        """What passes, in words: "at most 0.1", "0.19 ± 0.04"."""
        return Wanted(self.group, self.at_least, self.at_most, self.reference, self.tolerance).text

    @property
    def statistical(self) -> bool:
        """Whether it was judged on a number that has an error."""
        return self.verdict != "MISSING" and bool(self.standard_error)

    @property
    def p_within(self) -> float | None:
        """p-value of "the truth lies within the limits": small of a FAIL; None of one that is missing."""
        if self.value is None or self.standard_error is None:
            return None
        return outside(self.value, self.standard_error, self.at_least, self.at_most)

    @property
    def p_beyond(self) -> float | None:
        """p-value of "the truth lies beyond a limit": small of a PASS; None of one that is missing."""
        if self.value is None or self.standard_error is None:
            return None
        return inside(self.value, self.standard_error, self.at_least, self.at_most)


@dataclass(frozen=True)
class Criterion:
    """What is to be judged: a metric of one reading against one reference over a band.

    Attributes
    ----------
    metric
        "pearson", "rmse", "mse", "amplitude ratio", "colour difference", or another name.
    reading
        The reading or model judged.
    against
        The reference as people call it ("human liver").
    reference, tolerance
        Two-sided: |value − reference| ≤ tolerance (Pearson: 1 and 0.01; RMSE: 0 and 0.1).
    band_nm
        First and last wavelength, or None where it does not apply.
    bounds
        Where the value can lie at all; by default the metric's own (`BOUNDS`).
    at_least, at_most
        Limits in place of reference and tolerance.
    group
        Which sort of claim it is; by the rule of `wanted` if not said.

    Examples
    --------
    >>> Criterion("pearson", "measured", "human liver", 1.0, 0.01, band_nm=(500, 720)).name
    'pearson measured vs human liver 500-720'
    >>> Criterion("rmse", "measured", "human liver", at_most=0.23).judge(0.149, 0.01).verdict
    'PASS'
    """

    metric: str
    reading: str
    against: str
    reference: float | None = None
    tolerance: float | None = None
    band_nm: tuple[float, float] | None = None
    bounds: tuple[float, float] | None = None
    at_least: float | None = None
    at_most: float | None = None
    group: Group | None = None

    @property
    def name(self) -> str:
        """Metric, reading, reference and band in one line."""
        band = "" if self.band_nm is None else f" {self.band_nm[0]:g}-{self.band_nm[1]:g}"
        return f"{self.metric} {self.reading} vs {self.against}{band}"

    @property
    def aim(self) -> Wanted:
        """What it wants of a value."""
        limits = {"at_least": self.at_least, "at_most": self.at_most}
        return wanted(self.metric, self.reference, self.tolerance, **limits, group=self.group)

    def judge(self, value: float, standard_error: float, *, seconds: float = 0.0) -> Claim:
        """The claim that a value makes.

        Raises
        ------
        InputError
            If the value is no number or lies where the metric cannot.
        """
        low, high = self.bounds or BOUNDS.get(self.metric, (-math.inf, math.inf))
        if not low <= value <= high:
            raise InputError.of(
                f"{self.name}: value", value, f"must lie within [{low:g}, {high:g}]", "The metric was not computed."
            )
        return Claim.judged(self.name, value, standard_error, self.aim, seconds=seconds)

    def missing(self, reason: str, *, seconds: float = 0.0) -> Claim:
        """The claim where the value or its reference is not available."""
        return Claim.missing(self.name, reason, aim=self.aim, seconds=seconds)


def _written(value: float, error: float, aim: Wanted, verdict: Verdict) -> tuple[float, float]:
    """The value to two digits of its error; to more, where the verdict hangs on them."""
    for digits in range(2, 18):
        shown = round_to_error(value, error, digits), round_to_error(error, error, digits)
        if judge(*shown, aim.at_least, aim.at_most) == verdict:
            return shown
    return value, error


def _what_settles(d: Drawn, samples: str) -> tuple[float, str]:
    """How many times the samples, and what is told of it."""
    limit = min((x for x in (d.at_least, d.at_most) if x is not None), key=lambda x: abs(d.value - x))
    told = f"{abs(d.value - limit) / d.standard_error:.3g} standard errors from its limit {format_value(limit)}: "
    needs, stays, most = d.needs(), d.if_it_stays(), d.settled(MOST_SAMPLES)
    part = (
        f"of its error {format_value(d.standard_error, d.standard_error)} a part of {format_value(d.fixed, d.fixed)} "
        "is that of what it is held against"
    )
    if math.isinf(needs):
        why = part if d.fixed > 0 else "its limits lie too near to each other"
        both = replace(d, fixed=0.0).if_it_stays()
        also = f" {both:g} × the {samples} and the measurements behind it would, if the value stays where it is."
        also = also if d.fixed > 0 and math.isfinite(both) else ""
        return needs, told + f"no number of {samples} settles it, since {why}.{also}"
    told += f"needs about {needs:g} × the {samples}, which settle "
    told += "9 cases in 10" if most >= SETTLED else f"{100 * d.settled(needs):.0f} % of cases"
    told += f"; {stays:g} × if the value stays where it is" if stays < needs else ""
    return needs, told + ("." if most >= SETTLED else f". More do not help, since {part}.")


def _numbers(name: str, value: float | None, standard_error: float | None) -> tuple[float, float]:
    for what, number in {"value": value, "standard_error": standard_error}.items():
        if number is None or not math.isfinite(number) or (number < 0 and what == "standard_error"):
            bound = "must be a finite number" + (" ≥ 0" if what == "standard_error" else "")
            raise InputError.of(f"{name}: {what}", number, bound, "Use Claim.missing where there is none.")
    assert value is not None and standard_error is not None
    return value, standard_error


def _limits(name: str, at_least: float | None, at_most: float | None) -> None:
    if at_least is None and at_most is None:
        raise InputError.of(
            f"{name}: limits", None, "must be one or two: every value would pass", "Give at_least or at_most."
        )


def _former_numbers(claim: Claim) -> tuple[float, float]:
    if claim.reference is None or claim.tolerance is None:
        given = {"reference": claim.reference, "tolerance": claim.tolerance}
        raise InputError.of(f"{claim.criterion}: limits", given, "must both be numbers", "Write the table anew.")
    return claim.reference, claim.tolerance


__all__ = ["SIGMAS", "Claim", "Criterion", "Rule"]
