"""χ² of every sampler against its own density, with a wrong sampler that must fail.

200 000 samples in 40 cells of about equal share. A shift of 1 % of the probability from one half of the cells to
the other has noncentrality 200000 · 0.02² = 80 and is rejected at 1e-4 with a power above 0.99; the wrong samplers
below are of that size.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, ncx2

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.base import PhaseFunction
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh, Tabulated, kernel_table, mixture
from livlab.units import FloatArray

SAMPLES, CELLS, LEVEL = 200_000, 40, 1e-4
PHASES: list[PhaseFunction] = [
    Isotropic(),
    Rayleigh(),
    HenyeyGreenstein(0.9),
    HenyeyGreenstein(-0.5),
    HenyeyGreenstein(0.9999),
    Tabulated([-1.0, -0.2, 0.5, 1.0], [0.3, 0.0, 1.0, 4.0]),
    mie_phase(1.5 / 1.35, 8.0),
    mixture([HenyeyGreenstein(0.99), Rayleigh(), Tabulated([-1.0, 1.0], [1.0, 0.0])], [2.0, 1.0, 1.0]),  # type: ignore[list-item]
]


def p_value(phase: PhaseFunction, sampler: Callable[[FloatArray], FloatArray]) -> float:
    """χ² of 1 − cos θ from `sampler` against shares integrated from `phase`'s density alone."""
    u = np.random.default_rng(20).random(SAMPLES)
    edges = phase.quantile_complement(np.linspace(0.0, 1.0, CELLS + 1))
    edges[0], edges[-1] = 0.0, 2.0
    shares = []
    for low, high in itertools.pairwise(edges):
        inner = np.unique(np.concatenate([[low], np.geomspace(max(low, 1e-12), high, 30)[1:-1], [high]]))
        if isinstance(phase, Tabulated):
            inner = np.unique(
                np.concatenate([inner, phase.complement[(phase.complement > low) & (phase.complement < high)]])
            )
        shares.append(2.0 * math.pi * sum(_gauss(phase, a, b) for a, b in itertools.pairwise(inner)))
    expected = SAMPLES * np.array(shares)
    assert expected.sum() == pytest.approx(SAMPLES, rel=1e-5)
    found, _ = np.histogram(sampler(u), bins=edges)
    assert found.sum() == SAMPLES
    return float(chi2.sf(float(((found - expected) ** 2 / expected).sum()), CELLS - 1))


def _gauss(phase: PhaseFunction, low: float, high: float) -> float:
    node, weight = np.polynomial.legendre.leggauss(6)
    half = 0.5 * (high - low)
    return float(half * (weight @ phase.pdf_complement(low + half * (node + 1.0))))


@pytest.mark.parametrize("phase", PHASES, ids=repr)
def test_samplers(phase: PhaseFunction) -> None:
    assert p_value(phase, lambda u: phase.quantile_complement(1.0 - u)) > LEVEL


@pytest.mark.parametrize("phase", PHASES, ids=repr)
def test_kernel_samplers(phase: PhaseFunction) -> None:
    table = kernel_table(phase)
    assert p_value(phase, lambda u: table.sample_complement(u.astype(np.float32)).astype(float)) > LEVEL


def test_a_wrong_sampler_fails() -> None:
    wrong = HenyeyGreenstein(0.89)
    assert p_value(HenyeyGreenstein(0.9), wrong.quantile_complement) < LEVEL
    assert p_value(Rayleigh(), Isotropic().quantile_complement) < LEVEL
    coarse = kernel_table(HenyeyGreenstein(0.9), octaves=3, per_octave=2)
    assert p_value(HenyeyGreenstein(0.9), lambda u: coarse.sample_complement(u).astype(float)) < LEVEL
    table = mie_phase(1.5 / 1.35, 8.0)
    near = HenyeyGreenstein(table.anisotropy)
    assert p_value(table, near.quantile_complement) < LEVEL


def test_the_power_stated_above() -> None:
    critical = chi2.isf(LEVEL, CELLS - 1)
    assert ncx2.sf(critical, CELLS - 1, SAMPLES * 0.02**2) > 0.9


def test_density_of_a_table_is_what_its_sampler_follows() -> None:
    phase = Tabulated([-1.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    share = 2.0 * math.pi * quad(lambda c: float(phase.pdf(np.array(c))), 0.5, 1.0)[0]
    assert share == pytest.approx(0.125, abs=1e-12)
    mu = phase.sample(np.random.default_rng(3).random(SAMPLES))
    assert float((mu > 0.5).mean()) == pytest.approx(0.125, abs=4.0 * math.sqrt(0.125 * 0.875 / SAMPLES))
