"""What makes a line of the stress table pass, fail or go missing; and that the catalogue can tell right from wrong."""

import math

import numpy as np
import pytest

from livlab.errors import EnvironmentProblem, InputError
from livlab.stress import run as stress_run
from livlab.stress.catalogue import Case, Expectation, cases, select, trusted
from livlab.stress.measured import RUNNERS, Measured
from livlab.stress.runners import RUNNERS as ALL


def judged(value, error=0.0, **expect):
    """The line that a runner's one quantity gives."""
    expect = {"quantity": "q", "value": 2.0, "by": "arithmetic", **expect}
    case = Case(name="made/up", what="a test", run="made_up", expect=[Expectation(**expect)])
    RUNNERS["made_up"] = lambda: {"q": Measured(np.atleast_1d(np.asarray(value, float)), np.atleast_1d(error))}
    try:
        (line,) = stress_run.run_case(case)
    finally:
        del RUNNERS["made_up"]
    return line


@pytest.mark.parametrize(
    ("value", "error", "expect", "verdict"),
    [
        (2.0, 0.0, {}, "PASS"),
        (np.nextafter(2.0, 3.0), 0.0, {}, "PASS"),  # rounding of the comparison itself
        (2.0 + 1e-12, 0.0, {}, "FAIL"),
        (2.09, 0.0, {"allowed": 0.1}, "PASS"),
        (2.11, 0.0, {"allowed": 0.1}, "FAIL"),
        (2.19, 0.0, {"rule": "relative", "allowed": 0.1}, "PASS"),
        (2.21, 0.0, {"rule": "relative", "allowed": 0.1}, "FAIL"),
        (2.39, 0.1, {"rule": "sigma", "allowed": 4.0, "power": 0.2}, "PASS"),
        (2.41, 0.1, {"rule": "sigma", "allowed": 4.0, "power": 0.2}, "FAIL"),
        (2.0, 0.3, {"rule": "sigma", "allowed": 4.0, "power": 0.2}, "FAIL"),  # too noisy to show anything
        (2.0, math.nan, {"rule": "sigma", "allowed": 4.0, "power": 0.2}, "FAIL"),
        (2.1, 0.0, {"rule": "sigma", "allowed": 4.0, "power": 0.2}, "FAIL"),  # off, and sure of it
        (9.0, 0.1, {"rule": "at least", "allowed": 4.0}, "PASS"),
        (1.5, 0.1, {"rule": "at least", "allowed": 4.0}, "FAIL"),
        (1.0, 0.0, {"rule": "at most"}, "PASS"),
        (2.5, 0.1, {"rule": "at most", "allowed": 4.0}, "FAIL"),
        (math.nan, 0.0, {"allowed": 1e9}, "FAIL"),
        (math.inf, 0.0, {"allowed": 1e9}, "FAIL"),
        (math.nan, 0.0, {"rule": "at most", "allowed": 1.0}, "FAIL"),
        ([2.0, 2.0, 2.05], 0.0, {"allowed": 0.1}, "PASS"),
        ([2.0, 2.2, 2.0], 0.0, {"allowed": 0.1}, "FAIL"),
        ([2.2, math.nan, 2.0], 0.0, {"allowed": 0.1}, "FAIL"),
    ],
)
def test_verdicts(value, error, expect, verdict):
    assert judged(value, error, **expect).verdict == verdict


def test_the_worst_of_a_sweep_is_shown():
    line = judged([2.0, 2.05, 1.93], allowed=0.1)
    assert line.value == 1.93
    assert line.difference == pytest.approx(-0.07)
    assert math.isnan(judged([2.05, math.nan], allowed=0.1).value)


@pytest.mark.parametrize(
    ("trouble", "verdict"), [(EnvironmentProblem("no libLLVM"), "MISSING"), (ZeroDivisionError("oh"), "FAIL")]
)
def test_what_goes_wrong_is_a_line(monkeypatch, trouble, verdict):
    def broken():
        raise trouble

    monkeypatch.setitem(RUNNERS, "made_up", broken)
    case = Case(name="a/b", what="x", run="made_up", expect=[Expectation(quantity="q", value=1.0, by="x")] * 2)
    lines = stress_run.run((case,))
    assert [x.verdict for x in lines] == [verdict] * 2
    assert str(trouble) in lines[0].note


def test_a_quantity_that_the_runner_lacks_fails():
    case = Case(
        name="fresnel/none",
        what="x",
        run="fresnel",
        args={"n_from": 1.0, "n_to": 1.5, "mu": 1.0},
        expect=[Expectation(quantity="colour", value=0.0, by="x")],
    )
    (line,) = stress_run.run_case(case)
    assert (line.verdict, "colour" in line.note) == ("FAIL", True)


def test_the_catalogue_is_whole():
    found = cases()
    assert len(found) > 100
    for case in found:
        assert case.run in ALL, case.name
        for e in case.expect:
            values, by = trusted(case, e)
            assert values.size and by, (case.name, e.quantity)
    topics = {c.topic for c in found}
    assert {"mie", "cylinder", "fresnel", "walk", "adding-doubling", "energy", "sums", "solvers", "metrics"} <= topics


@pytest.mark.parametrize("name", ["mie/metal", "cylinder/grazing", "fresnel/index match", "walk/100 µm on 10 cm"])
def test_a_wrong_trusted_value_is_noticed(monkeypatch, name):
    """The reverse of a wrong result: shift what is trusted by three allowances, and every such line must fail."""
    (case,) = select(name)
    right = stress_run.run_case(case)
    if right[0].verdict == "MISSING":
        pytest.skip(right[0].note)

    def shifted(case, e):
        values, by = trusted(case, e)
        allowed = next(x.allowed for x in right if x.quantity == e.quantity)
        return values + 3 * max(allowed, 1e-12 * abs(values).max()), by

    monkeypatch.setattr(stress_run, "trusted", shifted)
    assert {x.verdict for x in stress_run.run_case(case)} == {"FAIL"}


def test_a_walk_that_drops_light_is_noticed(monkeypatch):
    """A kernel whose roulette is off by one part in a hundred cannot pass."""
    pytest.importorskip("drjit")
    from livlab.model.transport.walk import observers as walk_observers

    plain = walk_observers.Register.moments

    def leaky(sums, wavelengths, samples):
        m = plain(sums, wavelengths, samples)
        return type(m)(m.n, m.total * 0.99, m.squares)

    monkeypatch.setattr(walk_observers.Register, "moments", staticmethod(leaky))
    (case,) = select("walk/100 µm on 10 cm")
    lines = {x.quantity: x for x in stress_run.run_case(case)}
    if lines["balance"].verdict == "MISSING":
        pytest.skip(lines["balance"].note)
    assert lines["balance"].verdict == "FAIL"
    assert lines["reflectance"].verdict == "FAIL"


@pytest.mark.parametrize(
    "bad",
    [
        {"quantity": "q"},
        {"quantity": "q", "value": 1.0},
        {"quantity": "q", "value": 1.0, "reference": "sphere", "by": "x"},
        {"quantity": "q", "value": 1.0, "by": "x", "rule": "sigma", "allowed": 3.0},
        {"quantity": "q", "value": 1.0, "by": "x", "power": 1.0},
        {"quantity": "q", "value": 1.0, "by": "x", "rule": "nearly"},
    ],
)
def test_expectations_that_say_too_little_are_refused(bad):
    with pytest.raises(ValueError, match=r"q|rule"):
        Expectation(**bad)


def test_selection():
    assert {c.topic for c in select("mie")} == {"mie"}
    assert {c.topic for c in select("energy/*")} == {"energy"}
    assert not any(c.slow for c in select())
    assert any(c.slow for c in select(slow=True))
    with pytest.raises(InputError, match="matches no case"):
        select("gravity")
