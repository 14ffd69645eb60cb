import contextlib
import os

# Before numpy is loaded: its matrices are small here, and threads that wait for each other on cores that the other
# worker keeps busy cost up to ten times what they save. Programs that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from livlab.errors import EnvironmentProblem
from livlab.machine.llvm import choose_libllvm

os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples every time, and no deadline that a busy machine would miss.
settings.register_profile("livlab", derandomize=True, deadline=None)
settings.load_profile("livlab")

# Before any test imports drjit or mitsuba by itself: a bad libLLVM would end the whole test run.
with contextlib.suppress(EnvironmentProblem):
    choose_libllvm()


@pytest.fixture(scope="session")
def libllvm():
    """A libLLVM that Dr.Jit can use; the test is skipped where there is none."""
    try:
        return choose_libllvm()
    except EnvironmentProblem as problem:
        pytest.skip(str(problem))
