"""Run hard cases and judge them: one line a case and quantity."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from livlab.errors import EnvironmentProblem
from livlab.runs.files import write_whole
from livlab.stress.catalogue import Case, Expectation, trusted
from livlab.stress.measured import Measured
from livlab.units import FloatArray

Verdict = Literal["PASS", "FAIL", "MISSING"]

COLUMNS = (
    "criterion",
    "value",
    "standard_error",
    "reference",
    "tolerance",
    "verdict",
    "seconds",
    "difference",
    "at",
    "what",
    "trusted_by",
    "note",
)
"""Columns of the CSV: those of claims.csv, then what a reader of the table needs beside them."""


@dataclass(frozen=True)
class Line:
    """One line of the table: the worst value of a quantity over the case's sweep.

    Attributes
    ----------
    case, quantity
        What was run and looked at; together the criterion.
    value, standard_error, trusted, allowed
        The number found, its error (0 for deterministic ones), what it is held against, and the largest
        difference that passes; NaN where nothing was found.
    at
        Where in the sweep, or empty.
    seconds
        What the case cost, on its first line.
    note
        Why it failed or is missing.
    """

    case: str
    quantity: str
    what: str
    value: float
    standard_error: float
    trusted: float
    allowed: float
    verdict: Verdict
    seconds: float
    at: str
    trusted_by: str
    note: str = ""

    @property
    def criterion(self) -> str:
        """Case and quantity."""
        return f"{self.case}: {self.quantity}"

    @property
    def difference(self) -> float:
        """Value less trusted value."""
        return self.value - self.trusted


def run(chosen: Sequence[Case], progress: Callable[[Case, Sequence[Line]], None] | None = None) -> tuple[Line, ...]:
    """Run cases one after the other; `progress` hears of each as it is done.

    A case that fails does not stop the others: an exception of any kind is a line that says so. What the machine
    lacks (no libLLVM) makes its lines MISSING.
    """
    lines: list[Line] = []
    for case in chosen:
        made = run_case(case)
        lines += made
        if progress is not None:
            progress(case, made)
    return tuple(lines)


def run_case(case: Case) -> tuple[Line, ...]:
    """The lines of one case."""
    from livlab.stress.runners import RUNNERS

    started = time.perf_counter()
    try:
        found = RUNNERS[case.run](**case.args)
    except EnvironmentProblem as problem:
        return _without(case, "MISSING", str(problem), time.perf_counter() - started)
    except Exception as error:  # the point of a hard case is what goes wrong in it
        return _without(case, "FAIL", f"{type(error).__name__}: {error}", time.perf_counter() - started)
    spent = time.perf_counter() - started
    return tuple(_judge(case, e, found.get(e.quantity), spent * (k == 0)) for k, e in enumerate(case.expect))


def write_csv(path: Path, lines: Iterable[Line]) -> None:
    """Write the table, `COLUMNS`, whole or not at all; `livlab.reports.stress` reads it.

    Raises
    ------
    EnvironmentProblem
        The file cannot be written.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for x in lines:
        numbers = ["" if math.isnan(v) else repr(v) for v in (x.value, x.standard_error, x.trusted, x.allowed)]
        off = "" if math.isnan(x.difference) else repr(x.difference)
        words = (x.at, x.what, x.trusted_by, x.note)
        writer.writerow([x.criterion, *numbers, x.verdict, f"{x.seconds:.4g}", off, *words])
    write_whole(path, out.getvalue())


def _without(case: Case, verdict: Verdict, note: str, spent: float) -> tuple[Line, ...]:
    nan = math.nan
    return tuple(
        _line(
            case, e, e.by, verdict, spent * (k == 0), value=nan, standard_error=nan, trusted=nan, allowed=nan, note=note
        )
        for k, e in enumerate(case.expect)
    )


def _judge(case: Case, e: Expectation, found: Measured | None, spent: float) -> Line:
    want, by = trusted(case, e)
    fail = partial(_line, case, e, by, "FAIL", spent, value=math.nan, standard_error=math.nan, allowed=0.0)
    if found is None:
        return fail(trusted=float(want[0]), note=f"the runner {case.run} gives no {e.quantity}")
    value, error = np.broadcast_arrays(found.value, found.error)
    value, error = value.ravel(), error.ravel()
    if want.size not in (1, value.size):
        return fail(trusted=math.nan, note=f"{value.size} values, {want.size} trusted ones: compute them anew")
    want = np.broadcast_to(want, value.shape)
    allowed = _allowance(e, want, error)
    k = _worst(_excess(e, value, want), allowed)
    # Rounding of the comparison itself: 1 − 0.99 is 0.010000000000000009.
    slack = 4e-16 * max(abs(float(value[k])), abs(float(want[k])))
    note = found.note
    verdict: Verdict = "PASS"
    if not math.isfinite(value[k]) and value[k] != want[k]:
        verdict, note = "FAIL", "not a finite number"
    elif e.power is not None and not float(error.max()) <= e.power:
        verdict, note = "FAIL", f"proves nothing: standard error {error.max():.2g} above {e.power:g}"
    elif value[k] != want[k] and not _excess(e, value, want)[k] <= allowed[k] + slack:
        verdict = "FAIL"
    return _line(
        case,
        e,
        by,
        verdict,
        spent,
        value=float(value[k]),
        standard_error=float(error[k]),
        trusted=float(want[k]),
        allowed=float(allowed[k]),
        at=case.label(k) if value.size > 1 else "",
        note=note,
    )


def _line(case: Case, e: Expectation, by: str, verdict: Verdict, spent: float, **found: Any) -> Line:
    """A line of a case's expectation; `found` has its numbers, and `at` and `note` where there are such."""
    return Line(
        case=case.name,
        quantity=e.quantity,
        what=case.what,
        verdict=verdict,
        seconds=spent,
        trusted_by=by,
        **{"at": "", **found},
    )


def _allowance(e: Expectation, want: FloatArray, error: FloatArray) -> FloatArray:
    if e.rule == "relative":
        return e.allowed * np.abs(want)
    if e.rule in ("sigma", "at least", "at most"):
        return e.allowed * error
    return np.full(want.shape, e.allowed)


def _excess(e: Expectation, value: FloatArray, want: FloatArray) -> FloatArray:
    """How far a value is off, in the direction that counts; equal infinities are not."""
    with np.errstate(invalid="ignore"):
        off = np.where(value == want, 0.0, value - want)
    return -off if e.rule == "at least" else off if e.rule == "at most" else np.abs(off)


def _worst(excess: FloatArray, allowed: FloatArray) -> int:
    """Index of the value that uses most of its allowance; one that is no number before all others."""
    with np.errstate(invalid="ignore", divide="ignore"):
        used = excess / allowed
    used = np.where(excess <= 0.0, np.minimum(np.nan_to_num(used, nan=0.0), 0.0), used)
    return int(np.argmax(np.where(np.isnan(used), math.inf, used)))
