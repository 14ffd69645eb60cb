"""Every case of the catalogue holds on this machine."""

import pytest

from livlab.stress.catalogue import cases
from livlab.stress.run import run_case


def _marked(case):
    return pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else [])


@pytest.mark.parametrize("case", [_marked(case) for case in cases()])
def test_case(case):
    lines = run_case(case)
    if any(x.verdict == "MISSING" for x in lines):
        pytest.skip(lines[0].note)
    failed = [
        f"{x.quantity}: {x.value!r} ± {x.standard_error:g}, trusted {x.trusted!r} ({x.trusted_by}), "
        f"allowed {x.allowed:g} {x.at} {x.note}"
        for x in lines
        if x.verdict != "PASS"
    ]
    assert lines
    assert not failed, "\n".join(failed)
