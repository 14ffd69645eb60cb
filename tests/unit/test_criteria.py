"""Claims: what is printed, what is judged, and what is refused."""

import math

import pytest

from livlab.criteria import (
    COLUMNS,
    FORMER_COLUMNS,
    Claim,
    Criterion,
    format_value,
    format_with_error,
    read_claims,
    round_to_error,
    write_claims,
)
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
