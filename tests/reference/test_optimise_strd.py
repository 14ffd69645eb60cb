"""NIST's certified nonlinear regressions: every digit that matters, from both starts, and no word that is not true.

Sums of squares are judged above 1e-20 only: Lanczos1's is rounding, and another order of operations has another one.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from strd import MODELS, Regression, regressions

from livlab.optimise import covariance_of_residuals, least_squares, minimise

SETS = regressions()
BOTH = [(name, start) for name in MODELS for start in (0, 1)]
DOCS = Path(__file__).parents[2] / "docs" / "optimise.md"


def solved(one: Regression, start: int, box: float | None = None, **options: Any) -> Any:
    return least_squares(one.residuals, one.parameters(start, box), warn=False, **options)


def test_the_certified_values_are_those_of_the_models() -> None:
    for one in SETS.values():
        values = {f"b{k}": b for k, b in enumerate(one.certified)}
        rss = float(np.sum(one.residuals(values) ** 2))
        assert rss == pytest.approx(one.rss, rel=1e-9) or rss < 1e-20, one.name


@pytest.mark.parametrize(("name", "start"), BOTH)
def test_six_certified_digits_from_both_starts(name: str, start: int) -> None:
    one = SETS[name]
    found = solved(one, start)
    assert one.digits(found) >= 6.0
    assert one.reached(found)
    assert found, found.stop
    assert found.polish is not None
    assert found.polish.after <= found.polish.before * (1 + 1e-9)


@pytest.mark.parametrize(("name", "start"), BOTH)
def test_the_same_in_a_box_around(name: str, start: int) -> None:
    one = SETS[name]
    found = solved(one, start, box=10.0)
    assert one.digits(found) >= 6.0
    assert found, found.stop


@pytest.mark.parametrize("how", ["start on a bound", "narrow", "logarithms", "LN_BOBYQA", "few evaluations", "float32"])
def test_converged_is_said_of_certified_sums_alone(how: str) -> None:
    # Boxes that hold less, searches that end early, residuals of seven digits: some miss, and say so.
    told = 0
    for name, start in BOTH[::2]:
        one = SETS[name]
        parameters, options, residuals = one.parameters(start), {}, one.residuals
        if how == "start on a bound":
            half = 0.5 * np.abs(one.certified)
            parameters = [
                type(p)(p.name, *sorted((p.start_value, c + (h if p.start_value <= c else -h))), p.start_value)
                for p, c, h in zip(parameters, one.certified, half, strict=True)
            ]
        elif how == "narrow":
            parameters = one.parameters(start, 1.0)
        elif how == "logarithms":
            positive = [c > 0 and s > 0 for c, s in zip(one.certified, one.starts[start], strict=True)]
            parameters = [
                type(p)(p.name, 0.0, np.inf, p.start, transform="log") if good else p
                for p, good in zip(parameters, positive, strict=True)
            ]
        elif how == "LN_BOBYQA":
            options = {"algorithm": "LN_BOBYQA"}
        elif how == "few evaluations":
            options = {"max_evaluations": 40}
        else:

            def residuals(values: Any, one: Regression = one) -> Any:
                with np.errstate(over="ignore"):
                    return one.residuals(values).astype(np.float32)

        found = least_squares(residuals, parameters, warn=False, **options)
        exact = float(np.sum(one.residuals(found.best) ** 2))
        if found:
            told += 1
            assert exact <= 1.001 * one.rss or exact < 1e-12, (name, start, found.stop)
    assert told >= (1 if how == "few evaluations" else 17)


def test_sums_of_squares_as_mere_numbers_are_never_falsely_converged_in_a_box() -> None:
    told = 0
    for name, start in BOTH[::2]:
        one = SETS[name]

        def rss(values: Any, one: Regression = one) -> Any:
            with np.errstate(over="ignore"):
                return np.sum(one.residuals(values) ** 2)

        found = minimise(rss, one.parameters(start, 1.0), warn=False, one_sigma=max(one.rss / one.y.size, 1e-12))
        told += bool(found)
        assert not found or found.value <= 1.001 * one.rss or found.value < 1e-20, (name, start, found.stop)
    assert told >= 10


@pytest.mark.parametrize("name", ["Misra1a", "Rat42", "Thurber"])
def test_a_jacobian_of_ones_own_serves_as_well(name: str) -> None:
    one = SETS[name]

    def jacobian(values: Any) -> Any:
        made = {}
        for key, value in values.items():
            h = 1e-6 * abs(value)
            ends = [one.residuals({**values, key: value + s * h}) for s in (-1, 1)]
            made[key] = (ends[1] - ends[0]) / (2 * h)
        return made

    found = solved(one, 0, jacobian=jacobian)
    assert found
    assert one.digits(found) >= 6.0
    # NIST certifies standard deviations, too.
    variance = 2 * found.value / (one.y.size - len(one.certified))
    sd = covariance_of_residuals(jacobian(found.best), one.parameters(0), found.best, variance=variance).sd
    assert max(sd.values()) > 0


def test_the_page_shows_what_is_found() -> None:
    rows = re.findall(r"^\| (\w+) \| (\d) \| ([12]) \|.*\| ([\d.]+) \| (\d+) \| yes \|$", DOCS.read_text("utf-8"), re.M)
    assert [(r[0], int(r[2]) - 1) for r in rows] == BOTH
    for name, count, _, digits, _ in rows:
        assert int(count) == len(SETS[name].certified)
        assert float(digits) >= 9.0
