"""Kernels have the same bytes whatever else a process compiled, and machine code of another version is never run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUM = """
import hashlib
import numpy as np
from livlab.model.tissue.particles.sphere_kernels import intensity, matched_coefficients
from livlab.model.tissue.phase.moments import moments

rng = np.random.default_rng(1)
a, b = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
w = np.linspace(0.0, 2.0, 301)
values = intensity(a, b, w)
told = hashlib.sha256(values.tobytes())
for one in matched_coefficients(0.02 + 0.001j, 7.0):
    told.update(one.tobytes())
told.update(moments(w, values, 12).tobytes())
print(told.hexdigest())
"""

FIRST = """
import numba

@numba.njit(fastmath={flags})
def square(x):
    return x**2 + x**3

square(2.0)
"""

KERNEL = """
from livlab.core.compiled import compiled
from steps import STEP, turn

@compiled
def kernel(x: float) -> float:
    return turn(x) + STEP
"""

STEPS = """
from livlab.core.compiled import compiled

STEP = {step}

@compiled
def turn(x: float) -> float:
    return {turn}
"""


def _python(code: str, cache: Path, *folders: Path) -> str:
    told = {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": os.pathsep.join(map(str, folders))}
    env = {**os.environ, **told, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    cache = tmp_path_factory.mktemp("alone")
    return _python(SUM, cache), cache


@pytest.mark.parametrize("flags", ["False", "True"])
def test_bytes_do_not_depend_on_what_was_compiled_before(alone: tuple[str, Path], tmp_path: Path, flags: str) -> None:
    """numba's helpers are compiled once a process by the flags of whoever calls them first."""
    assert _python(FIRST.format(flags=flags) + SUM, tmp_path) == alone[0]


def test_bytes_are_the_same_where_nothing_can_be_kept(alone: tuple[str, Path], tmp_path: Path) -> None:
    refuse = """
import numba
real = numba.njit
def njit(*args, cache=False, **options):
    if cache and not args:
        raise RuntimeError("no locator available")
    return real(*args, **options)
numba.njit = njit
import livlab.core.compiled
numba.njit = njit
"""
    assert _python(refuse + SUM, tmp_path) == alone[0]


def test_a_changed_constant_or_kernel_of_another_module_is_compiled_anew(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL, encoding="utf-8")
    steps = tmp_path / "steps.py"
    ask = "from kernel import kernel; print(kernel(3.0))"
    answers = []
    for step, turn in ((1.0, "2.0 * x"), (5.0, "2.0 * x"), (5.0, "9.0 * x")):
        steps.write_text(STEPS.format(step=step, turn=turn), encoding="utf-8")
        os.utime(steps, (1e9, 1e9))  # what numba goes by: the time and the size stay the same
        answers.append(float(_python(ask, tmp_path / "cache", tmp_path)))
    assert answers == [7.0, 11.0, 32.0]


def test_what_was_kept_serves_again(alone: tuple[str, Path]) -> None:
    result, cache = alone
    before = sorted(cache.rglob("*.nbc"))
    assert before
    assert _python(SUM, cache) == result
    assert sorted(cache.rglob("*.nbc")) == before
