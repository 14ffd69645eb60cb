"""Every instrument against the readings that its own file gives: published, or known in closed form."""

import numpy as np
import pytest

from livlab.acquire.instruments.models import INSTRUMENTS
from livlab.acquire.instruments.solvers import AddingDoublingSolver, WalkSolver
from livlab.acquire.instruments.spectrometer import measure

CASES = [(kind, case) for kind in INSTRUMENTS for case in kind.cases()]


@pytest.mark.parametrize(("kind", "case"), CASES, ids=[f"{kind.__name__}: {case.source}" for kind, case in CASES])
def test_an_instrument_reads_what_is_known(kind, case):
    """A walk's four standard errors lie within the tolerance, so that a reading beside it is seen."""
    assert isinstance(case.instrument, kind)
    assert (case.stack is None) != (case.light is None)
    if case.light is not None:
        view = case.instrument.readout(np.ones(1))
        read = float(np.sum(view.weights * case.light(view.tally)))
    elif case.samples:
        seen = measure(case.stack, case.instrument, WalkSolver(samples=case.samples, pilot=case.samples, seed=7))
        assert 4.0 * float(seen["standard_error"][0]) <= case.tolerance
        read = float(seen["value"][0])
    else:
        read = float(measure(case.stack, case.instrument, AddingDoublingSolver())["value"][0])
    assert abs(read - case.expected) <= case.tolerance


def test_every_instrument_has_cases():
    assert {kind for kind, _ in CASES} == set(INSTRUMENTS)
