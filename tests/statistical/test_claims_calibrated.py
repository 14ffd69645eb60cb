"""Verdicts are calibrated: simulated claims about a known truth, and the samples that they ask for."""

import math

import numpy as np
import pytest

from livlab.criteria import FALSE_ALARM, Claim, Drawn, family_error, holm, judge, sidak
from livlab.criteria.judging import SETTLED, inside, outside

SEED = 14_0401
REPEATS = 10_000
MOST = 0.023
"""The issue's bound on wrong verdicts of either sort; Φ(−2) is 0.02275."""

LIMITS = {
    "at most": (None, 1.0),
    "at least": (0.99, None),
    "wide": (0.15, 0.23),
    "as wide as four errors": (-2.0, 2.0),
    "as wide as two errors": (-1.0, 1.0),
    "narrow": (-0.05, 0.05),
    "of no width": (0.0, 0.0),
}
DISTANCES = (0.0, 0.02, 0.1, 0.3, 1.0, 2.0, 3.0, 5.0)
"""Of the truth from its limit, in standard errors; inwards as far as the limits allow, and outwards."""


def _binomial_slack(count: int) -> float:
    """Three standard errors of a share of Φ(−2)."""
    return 3 * math.sqrt(FALSE_ALARM * (1 - FALSE_ALARM) / count)


@pytest.mark.parametrize("name", LIMITS)
def test_wrong_verdicts_are_at_most_what_two_standard_errors_say_wherever_the_truth_is(name: str) -> None:
    """A FAIL of what holds and a PASS of what does not, at every distance; rounded as the table rounds."""
    low, high = LIMITS[name]
    error = {"at most": 0.03, "at least": 0.00094, "wide": 0.006}.get(name, 1.0)
    rng = np.random.default_rng(SEED)
    ends = [x for x in (low, high) if x is not None]
    for distance in DISTANCES:
        for end in ends:
            for sign in (-1, 1):
                truth = end + sign * distance * error
                holds = (low is None or truth >= low) and (high is None or truth <= high)
                found = [judge(v, error, low, high) for v in rng.normal(truth, error, REPEATS // 10)]
                wrong = found.count("FAIL" if holds else "PASS") / len(found)
                assert wrong <= MOST + _binomial_slack(len(found)), (name, distance, sign, wrong)


@pytest.mark.parametrize("name", LIMITS)
def test_the_rates_are_what_the_normal_distribution_says(name: str) -> None:
    """Exact, no draw: the worst place of the truth, over a fine grid of it, and limits from no width to endless."""
    low, high = LIMITS[name]
    values = np.linspace(-12.0, 12.0, 9601)  # of one truth, in standard errors
    weight = np.exp(-(values**2) / 2) / math.sqrt(2 * math.pi) * (values[1] - values[0])
    for error in (1.0, 0.3, 0.05):
        ends = [x for x in (low, high) if x is not None]
        for truth in {*ends, float(np.mean(ends)), *(e + s * 0.5 * error for e in ends for s in (-1, 1))}:
            holds = (low is None or truth >= low) and (high is None or truth <= high)
            wrong = np.array(
                [judge(truth + error * z, error, low, high) == ("FAIL" if holds else "PASS") for z in values]
            )
            assert (wrong * weight).sum() <= FALSE_ALARM + 2e-4, (name, error, truth)


def test_ten_thousand_claims_of_varied_distance_are_judged_as_written() -> None:
    """Through Claim.of, whose numbers are rounded: errors of every size, limits of either side, truths near and far."""
    rng = np.random.default_rng(SEED + 1)
    wrong = {"PASS": 0, "FAIL": 0}
    could = dict(wrong)
    for _ in range(REPEATS):
        error = 10 ** rng.uniform(-5, 1)
        limit = rng.uniform(-3, 3)
        truth = limit + error * rng.uniform(-4, 4)
        value = rng.normal(truth, error)
        above = bool(rng.integers(2))
        claim = Claim.of("x", value, error, **({"at_least": limit} if above else {"at_most": limit}))
        holds = truth >= limit if above else truth <= limit
        could["FAIL" if holds else "PASS"] += 1
        if claim.verdict in wrong and (claim.verdict == "PASS") != holds:
            wrong[claim.verdict] += 1
        again = judge(claim.value, claim.standard_error, claim.at_least, claim.at_most)
        assert again == claim.verdict == judge(value, error, claim.at_least, claim.at_most)
    for verdict, count in wrong.items():
        assert count / could[verdict] <= MOST, (verdict, count, could)
    assert sum(wrong.values()) > 0  # it can be wrong: 0.5 % of truths so spread


@pytest.mark.parametrize("law", ["even", "normal", "steps", "wide limits", "narrow limits"])
def test_the_samples_that_are_asked_for_settle_nine_of_ten(law: str) -> None:
    """Claims that came out TOO CLOSE are drawn again with so many times the samples, about the same truth."""
    rng = np.random.default_rng(SEED + 2)
    settled = close = 0
    for _ in range(3_000):
        low, high = {"wide limits": (-3.0, 3.0), "narrow limits": (-0.5, 0.5)}.get(law, (None, 0.0))
        truth = {
            "normal": lambda: rng.normal(0.0, 2.0),
            "steps": lambda: float(rng.choice([-3, -2, -1.5, -1, -0.5, -0.25, 0.25, 0.5, 1, 1.5, 2, 3])),
        }.get(law, lambda: rng.uniform(-6, 6))()
        value = rng.normal(truth, 1.0)
        if judge(value, 1.0, low, high) != "TOO CLOSE":
            continue
        close += 1
        factor = Drawn(value, 1.0, low, high).needs()
        error = 1 / math.sqrt(factor)
        settled += judge(rng.normal(truth, error), error, low, high) != "TOO CLOSE"
    assert close > 600
    assert settled / close >= 0.90, (law, settled, close)


def test_fewer_samples_than_asked_for_do_not() -> None:
    """The test above could fail: a tenth of the samples leaves far more than one in ten open."""
    rng = np.random.default_rng(SEED + 3)
    open_still = close = 0
    for truth in rng.uniform(-6, 6, 3_000):
        value = rng.normal(truth, 1.0)
        if judge(value, 1.0, None, 0.0) == "TOO CLOSE":
            close += 1
            error = 1 / math.sqrt(max(1.0, Drawn(value, 1.0, None, 0.0).needs() / 10))
            open_still += judge(rng.normal(truth, error), error, None, 0.0) == "TOO CLOSE"
    assert open_still / close > 0.15


def test_an_error_that_samples_do_not_mend_is_told() -> None:
    """Of an error that is partly the reference's: against a literal simulation, and without end where it decides."""
    rng = np.random.default_rng(SEED + 4)
    fixed, drawn = 0.2, math.sqrt(0.96)
    value = -1.95
    factor = Drawn(value, 1.0, None, 0.0, fixed).needs()
    assert 1 < factor < math.inf
    error = math.sqrt(drawn**2 / factor + fixed**2)
    truths = rng.normal(value, drawn, 20_000)  # of what this reference gives
    again = rng.normal(truths, drawn / math.sqrt(factor))
    settled = np.mean([judge(v, error, None, 0.0) != "TOO CLOSE" for v in again])
    assert settled >= SETTLED - 0.01
    partly = Drawn(-1.5, 1.0, None, 0.0, fixed=0.3)
    claim = Claim.of("x", -1.5, 1.0, at_most=0.0, fixed=0.3)
    assert claim.needs == partly.needs() < math.inf
    assert partly.settled(1e9) < SETTLED
    drawn = math.sqrt(1 - 0.09)
    again = rng.normal(rng.normal(-1.5, drawn, 20_000), drawn / math.sqrt(claim.needs))
    error = math.sqrt(0.91 / claim.needs + 0.09)
    share = np.mean([judge(v, error, None, 0.0) != "TOO CLOSE" for v in again])
    assert share == pytest.approx(partly.settled(claim.needs), abs=0.012)  # 4 standard errors
    assert f"which settle {100 * partly.settled(claim.needs):.0f} % of cases" in claim.note
    assert "More do not help, since of its error 1.0 a part of 0.30 is that of what it is held against." in claim.note
    none = Claim.of("x", -0.9, 1.0, at_most=0.0, fixed=0.8)
    assert none.needs == math.inf
    assert "no number of samples settles it" in none.note
    assert "5 × the samples and the measurements behind it would" in none.note  # (2/0.9)²


def test_p_values_against_draws() -> None:
    """p of a FAIL, of limits of any width: how often a truth at its worst place within gives a value so far out."""
    rng = np.random.default_rng(SEED + 5)
    z = rng.standard_normal(400_000)
    for width in (0.0, 0.3, 1.0, 5.0):
        for out in (0.2, 1.0, 2.1):
            p = outside(width + out, 1.0, 0.0, width)
            worst = max(np.mean(np.maximum(-(t + z), t + z - width) >= out) for t in np.linspace(0, width, 9))
            assert p == pytest.approx(worst, abs=4 * math.sqrt(p / len(z)))
    assert inside(0.8, 0.1, None, 1.0) == pytest.approx(np.mean(z > 2.0), abs=1e-3)


def test_family_wise_error_of_simulated_claims() -> None:
    """No truth is beyond its limit, and all lie at it: Šidák's chance of a false FAIL, and Holm keeps 5 %."""
    rng = np.random.default_rng(SEED + 6)
    m, repeats = 40, 2_000
    any_wrong = any_holm = 0
    for values in rng.standard_normal((repeats, m)):
        p = [outside(v, 1.0, None, 0.0) for v in values]
        any_wrong += min(p) < FALSE_ALARM
        any_holm += min(holm(p)) <= 0.05
    expected = sidak(m)
    assert any_wrong / repeats == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / repeats))
    assert any_holm / repeats <= 0.05 + 4 * math.sqrt(0.05 * 0.95 / repeats)
    assert any_holm > 0


def test_holm_against_its_definition() -> None:
    """Literal: at level α the smallest is held against α/m, the next against α/(m − 1), until one is larger."""
    rng = np.random.default_rng(SEED + 7)
    for _ in range(200):
        p = list(rng.uniform(0, 0.2, rng.integers(1, 9)))
        adjusted = holm(p)
        for alpha in (0.01, 0.05, 0.1, 0.3):
            rejected, left = set(), sorted(range(len(p)), key=lambda k: p[k])
            for step, k in enumerate(left):
                if p[k] > alpha / (len(p) - step):
                    break
                rejected.add(k)
            assert {k for k, a in enumerate(adjusted) if a <= alpha} == rejected
    assert holm([]) == ()


def test_a_family_counts_what_has_an_error_and_says_what_looking_again_takes() -> None:
    claims = [
        ("a", Claim.of("rmse a", 0.30, 0.01, at_most=0.2, seconds=3.0)),
        ("a", Claim.of("rmse b", 0.223, 0.01, at_most=0.2, seconds=5.0)),
        ("b", Claim.of("rmse c", 0.205, 0.01, at_most=0.2)),
        ("b", Claim.of("rmse d", 0.10, 0.01, at_most=0.2)),
        ("b", Claim.of("rmse e", 0.10, 0.0, at_most=0.2)),
        ("b", Claim.missing("rmse f", "no table", reference=0.0, tolerance=0.1)),
    ]
    family = family_error(claims)
    assert (family.claims, family.decided) == (4, 3)
    assert family.at_most == pytest.approx(1 - (1 - FALSE_ALARM) ** 4)
    assert [m.criterion for m in family.failed] == ["rmse b", "rmse a"]
    assert family.failed[0].again_seconds == 20.0
    assert family.failed[0].p == pytest.approx(0.0107, abs=1e-4)
    assert family.failed[0].p_holm == pytest.approx(2 * 0.0107, abs=2e-4)
    assert family.doubtful == ()
