"""Claims: what is printed, what is judged, and what is refused."""

import math

import pytest

from livlab.criteria import (
    BOUNDS,
    COLUMNS,
    FORMER_COLUMNS,
    Claim,
    Criterion,
    format_value,
    format_with_error,
    judge,
    read_claims,
    round_to_error,
    wanted,
    write_claims,
)
from livlab.criteria.judging import former_judge
from livlab.errors import InputError

PEARSON = Criterion("pearson", "measured", "human liver", 1.0, 0.01, band_nm=(500, 720))


def test_name_says_metric_reading_reference_and_band():
    assert PEARSON.name == "pearson measured vs human liver 500-720"
    assert Criterion("colour difference", "thesis", "photograph", 0, 2).name == "colour difference thesis vs photograph"


@pytest.mark.parametrize(
    ("value", "error", "verdict"),
    [
        (0.995, 0.001, "PASS"),
        (0.99, 0.0, "PASS"),
        (0.9899, 0.0, "FAIL"),
        (0.99, 0.005, "TOO CLOSE"),
        (0.9899, 0.00001, "FAIL"),
        (0.98943, 0.00094, "TOO CLOSE"),
        (0.98, 0.004, "FAIL"),
        (0.992, 0.001, "TOO CLOSE"),  # at two standard errors, not beyond
        (0.9921, 0.001, "PASS"),
        (0.9879, 0.001, "FAIL"),
        (0.999, 0.0051, "TOO CLOSE"),
        (1.0, 0.5, "TOO CLOSE"),
    ],
)
def test_verdict(value, error, verdict):
    assert PEARSON.judge(value, error).verdict == verdict


def test_more_noise_never_helps():
    for value, without in ((0.992, "PASS"), (0.988, "FAIL")):
        verdicts = [PEARSON.judge(value, error).verdict for error in (0.0, 0.0009, 0.004, 0.006, 0.1)]
        assert verdicts == [without, without, "TOO CLOSE", "TOO CLOSE", "TOO CLOSE"]
    assert "needs about" in PEARSON.judge(0.992, 0.006).note
    assert PEARSON.judge(0.9, 0.001).note == ""


def test_missing_says_why():
    claim = PEARSON.missing("reference not available")
    assert (claim.verdict, claim.value, claim.note) == ("MISSING", None, "reference not available")
    with pytest.raises(InputError, match="must say why"):
        Claim.missing("x", " ")


def test_refused():
    for value, error in [(float("nan"), 0.1), (1.5, 0.1), (-2, 0.0)]:
        with pytest.raises(InputError, match="within"):
            PEARSON.judge(value, error)
    with pytest.raises(InputError, match="standard_error"):
        PEARSON.judge(0.9, float("nan"))
    with pytest.raises(InputError, match="standard_error"):
        PEARSON.judge(0.9, -0.1)
    with pytest.raises(InputError, match="the numbers say FAIL"):
        Claim("x", 2.0, 0.0, 0.0, 1.0, "PASS")
    with pytest.raises(InputError, match="one line"):
        Claim.of("a\nb", 1.0, 0.0, 1.0, 0.1)
    with pytest.raises(InputError, match="seconds"):
        Claim.of("x", 1.0, 0.0, 1.0, 0.1, seconds=-1)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.987654, 0.00123, "0.9877"),
        (0.987654, 0.00996, "0.988"),
        (0.987654, 0.0996, "0.99"),
        (0.987654, 3.0, "1.0"),
        (1.19, 0.004, "1.1900"),
        (9.83e-6, 2.5e-8, "9.830e-6"),
        (12345.6, 230.0, "12350"),
        (12345.6, 12.0, "12346"),
        (-0.04444, 0.001, "-0.0444"),
        (0.0, 0.01, "0.000"),
        (1 / 3, 0.0, "0.333333"),
        (1 / 3, None, "0.333333"),
        (None, None, "–"),
        (math.nan, 0.1, "–"),
        (math.inf, 0.1, "inf"),
        (1e300, 1.0, "1" + "0" * 300 + ".0"),
    ],
)
def test_format_value(value, error, shown):
    assert format_value(value, error) == shown


def test_format_with_error():
    assert format_with_error(0.987654, 0.00123) == "0.9877 ± 0.0012"
    assert format_with_error(0.5, 0.0) == "0.5"


def test_judged_as_printed(tmp_path):
    claim = Claim.of("x", 0.98996, 0.0012, 1.0, 0.01)
    assert (claim.value, claim.standard_error, claim.verdict) == (0.99, 0.0012, "TOO CLOSE")
    assert round_to_error(0.98996, 0.0012) == 0.99


def test_csv_round_trip(tmp_path):
    path = tmp_path / "claims.csv"
    claims = (
        PEARSON.judge(0.99512345, 0.00042, seconds=12.3456),
        Criterion("rmse", "thesis", 'liver, "ex vivo"', 0.0, 0.1).judge(0.19123, 0.0003),
        Claim.missing("brdf vs Nunes 2017", "não disponível"),
        Claim.of("exact", 1 / 3, 0.0, 1 / 3, 0.0),
        Claim.of("noisy", 0.5, 0.2, 0.5, 0.1),
    )
    write_claims(path, claims)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert lines[0].startswith("criterion,value,standard_error,reference,tolerance,verdict,seconds,group")
    assert lines[1] == "pearson measured vs human liver 500-720,0.99512,0.00042,1.0,0.01,PASS,12.35,agrees,0.99,,"
    back = read_claims(path)
    assert [c.criterion for c in back] == [c.criterion for c in claims]
    for a, b in zip(claims, back, strict=True):
        assert (a.value, a.standard_error, a.reference, a.tolerance, a.verdict, a.note) == (
            b.value,
            b.standard_error,
            b.reference,
            b.tolerance,
            b.verdict,
            b.note,
        )
        assert b.seconds == pytest.approx(a.seconds, rel=1e-3)


def test_old_notes_do_not_linger(tmp_path):
    path = tmp_path / "claims.csv"
    write_claims(path, [PEARSON.missing("reference not available")])
    write_claims(path, [PEARSON.judge(0.9, 0.0)])
    assert read_claims(path)[0].note == ""


def test_duplicate_names_are_refused(tmp_path):
    with pytest.raises(InputError, match="appears twice"):
        write_claims(tmp_path / "c.csv", [PEARSON.judge(0.9, 0.0)] * 2)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n", "columns must be"),
        ("", "columns must be"),
        (",".join(COLUMNS) + "\nx,1,0,1,0.1,MAYBE,0,checks,0.9,1.1,\n", "PASS, FAIL, TOO CLOSE or MISSING"),
        (",".join(COLUMNS) + "\nx,1,0,1,0.1\n", "cells"),
        (",".join(COLUMNS) + "\nx,one,0,1,0.1,PASS,0,checks,0.9,1.1,\n", "no number"),
        (",".join(COLUMNS) + "\nx,0.5,0,1,0.1,PASS,0,checks,0.9,1.1,\n", "the numbers say FAIL"),
        (",".join(COLUMNS) + "\nx,1,0,1,0.1,PASS,0,others,0.9,1.1,\n", "reproduces, agrees or checks"),
        (",".join(COLUMNS) + "\nx,1,0,,,PASS,0,checks,,,\n", "every value would pass"),
        (",".join(COLUMNS) + "\nx,,,1,0.1,PASS,0,checks,0.9,1.1,\n", "value = None"),
        (",".join(FORMER_COLUMNS) + "\nx,1,0,1,0.1,MAYBE,0\n", "PASS, FAIL or MISSING"),
        (",".join(FORMER_COLUMNS) + "\nx,1,0,1,0.1,TOO CLOSE,0\n", "PASS, FAIL or MISSING"),
        (",".join(FORMER_COLUMNS) + "\nx,one,0,1,0.1,PASS,0\n", "no number"),
        (",".join(FORMER_COLUMNS) + "\nx,0.5,0,1,0.1,PASS,0\n", "the numbers say FAIL"),
        (",".join(FORMER_COLUMNS) + "\nx,0.95,0.06,1,0.1,PASS,0\n", "the numbers say FAIL"),
        (",".join(FORMER_COLUMNS) + "\nx,,,1,0.1,PASS,0\n", "value = None"),
    ],
)
def test_a_damaged_table_is_refused(tmp_path, text, says):
    path = tmp_path / "claims.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_claims(path)


@pytest.mark.parametrize(
    ("metric", "reference", "tolerance", "group", "says"),
    [
        # The rule for files that do not say: what two like curves have is agreement, else a printed figure.
        ("rmse", 0.0, 0.1, "agrees", "at most 0.1"),
        ("mse", 0.0, 1e-4, "agrees", "at most 0.0001"),
        ("colour difference", 0.0, 2.0, "agrees", "at most 2"),
        ("pearson", 1.0, 0.01, "agrees", "at least 0.99"),
        ("amplitude ratio", 1.0, 0.1, "agrees", "1 ± 0.1"),
        ("rmse", 0.19, 0.04, "reproduces", "0.19 ± 0.04"),
        ("rmse", 0.03, 0.04, "reproduces", "at most 0.07"),
        ("pearson", 0.95, 0.03, "reproduces", "0.95 ± 0.03"),
        ("pearson", 0.97, 0.03, "reproduces", "at least 0.94"),
        ("pearson", -1.0, 0.15, "reproduces", "at most -0.85"),
        ("energy residual", 0.0, 1e-5, "checks", "at most 1e-05"),
        ("peak", 415.0, 2.0, "checks", "415 ± 2"),
        ("relative difference", 0.0, 0.1, "checks", "0 ± 0.1"),
        ("coverage", 0.945, 0.045, "checks", "0.945 ± 0.045"),
        ("settled", 1.0, 0.0, "checks", "at least 1"),
    ],
)
def test_old_criteria_mean_what_they_meant(metric, reference, tolerance, group, says):
    """Group and limits by the rule of docs/metrics.md; no exact value that the metric can have changes its verdict."""
    found = wanted(metric, reference, tolerance)
    assert (found.group, found.text) == (group, says)
    low, high = BOUNDS.get(metric, (-math.inf, math.inf))
    for step in (-2.0, -1.001, -1.0, -0.999, -0.5, 0.0, 0.5, 0.999, 1.0, 1.001, 2.0):
        value = reference + step * (tolerance or 0.1)
        if low <= value <= high:
            then, _ = former_judge(value, 0.0, reference, tolerance)
            assert judge(value, 0.0, found.at_least, found.at_most) == then, value


def test_agreement_is_one_sided_and_reproduction_is_not():
    """The issue's case: .149 is better than .19 ± .04. It agrees, and does not reproduce."""
    for error, reproduces in ((0.0, "FAIL"), (0.0003, "FAIL"), (0.003, "TOO CLOSE")):
        better = {"value": 0.149, "standard_error": error}
        assert Claim.of("rmse a vs liver", **better, reference=0.19, tolerance=0.04).verdict == reproduces
        assert Claim.of("rmse a vs liver", **better, reference=0.19, tolerance=0.04, group="agrees").verdict == "PASS"
        assert Claim.of("rmse a vs liver", **better, at_most=0.23).verdict == "PASS"
    assert Claim.of("pearson a vs liver", 0.999, 0.0001, 0.95, 0.03, group="agrees").verdict == "PASS"
    assert Claim.of("pearson a vs liver", 0.999, 0.0001, 0.95, 0.03).verdict == "FAIL"
    assert Claim.of("amplitude ratio a", 1.3, 0.01, 1.0, 0.1, group="agrees").verdict == "FAIL"  # has no better side
    assert Claim.of("rmse a", 0.3, 0.0, at_most=0.23).group == "agrees"
    assert Claim.of("rmse a", 0.3, 0.0, at_least=0.1, at_most=0.4).group == "reproduces"


def test_limits_that_do_not_hold_together_are_refused():
    for given, says in [
        ({}, "needs reference and tolerance, or at_least"),
        ({"reference": 1.0}, "needs reference and tolerance"),
        ({"reference": 1.0, "tolerance": 0.1, "at_most": 2.0}, "needs reference and tolerance"),
        ({"at_least": 2.0, "at_most": 1.0}, "at_least = 2"),
        ({"at_most": math.nan}, "finite"),
        ({"reference": 1.0, "tolerance": -0.1}, "≥ 0"),
    ]:
        with pytest.raises(InputError, match=says):
            wanted("rmse", **given)


def test_digits_follow_where_the_verdict_hangs_on_them(tmp_path):
    """2.004 standard errors are more than two, though both round to the limit of it; the table says the same."""
    claim = Claim.of("x", 0.2004, 0.1, at_least=0.0)
    assert (claim.value, claim.verdict) == (0.2004, "PASS")
    near = Claim.of("x", 0.19960, 0.1, at_least=0.0)
    assert near.verdict == "TOO CLOSE"
    for c in (claim, near):
        write_claims(tmp_path / "c.csv", [c])
        assert read_claims(tmp_path / "c.csv") == (c,)


def test_the_note_has_the_samples_and_the_table_too(tmp_path):
    claim = Claim.of("pearson a vs liver", 0.98943, 0.00094, 1.0, 0.01)
    assert "needs about 360 × the samples" in claim.note
    assert claim.needs == 360.0
    write_claims(tmp_path / "c.csv", [claim])
    (back,) = read_claims(tmp_path / "c.csv")
    assert (back.needs, back.note, back.wanted) == (360.0, claim.note, "at least 0.99")


def test_tables_of_the_former_rule_open_as_judged_then(tmp_path):
    path = tmp_path / "claims.csv"
    path.write_text(
        "criterion,value,standard_error,reference,tolerance,verdict,seconds\n"
        "rmse a vs human liver,0.0992,0.0046,0.0,0.1,PASS,1\n"
        "rmse b vs human liver,0.05,0.06,0.0,0.1,FAIL,1\n"
        "pearson sphere c vs goniometer,0.33,0.22,1.0,0.05,FAIL,1\n"
        '"pearson thesis vs human liver, processed curve",0.917,0.011,0.95,0.03,FAIL,1\n'
        "pearson d,,,1.0,0.05,MISSING,0\n"
    )
    claims = read_claims(path)
    assert [c.verdict for c in claims] == ["PASS", "FAIL", "FAIL", "FAIL", "MISSING"]
    assert [c.group for c in claims] == ["agrees", "agrees", "checks", "reproduces", "agrees"]
    assert [c.wanted for c in claims] == ["at most 0.1", "at most 0.1", "at least 0.95", "0.95 ± 0.03", "at least 0.95"]
    assert {c.rule for c in claims} == {"tolerance"}
