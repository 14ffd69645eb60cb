"""Walks on the ladder against adding–doubling: wishes met, errors falling as 1/√n, one estimator against the other."""

import math

import numpy as np
import pytest

from livlab.acquire.instruments import FibreProbe, IntegratingSphere, WalkSolver
from livlab.acquire.readout import readout
from livlab.acquire.spectrometer import estimate, measure
from livlab.model.tissue.phase import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.ladder import solve
from livlab.model.transport.sampling import Sampling
from livlab.study.cost import FAR, cost, slope

W = np.linspace(500.0, 720.0, 8)
SPHERE = IntegratingSphere(port_diameter_mm="infinite", incidence_deg=0.0)


def scene():
    """Eight wavelengths from dark to bright, unequal indices."""
    one, phase = np.ones(8), (HenyeyGreenstein(0.7),) * 8
    parts = (Interaction("a", np.geomspace(2.0, 0.05, 8), 0 * one, phase), Interaction("s", 8 * one, one, phase))
    return OpticalStack(W, (PlaneLayer("bulk", 5.0, 1.38 * one, parts),), one, one)


@pytest.fixture(scope="module")
def truth():
    return estimate(scene(), SPHERE, Accuracy(standard_error=1e-7), "adding-doubling").value.to_numpy()


def test_a_relative_wish_is_met_and_the_error_is_honest(truth):
    """1 % of the maximum at every point. 8 values: each z within 3.7, χ² within 27.9 (false alarm in 1000 runs)."""
    wish = Accuracy(relative=0.01)
    found = estimate(scene(), SPHERE, wish, "walk expected", sampling=Sampling(relative=0.5, seed=3))
    error = found.error.to_numpy()
    assert (error <= 0.01 * found.value.to_numpy().max() * (1 + 1e-9)).all()
    z = (found.value.to_numpy() - truth) / error
    assert np.abs(z).max() < 3.7
    assert np.sum(z**2) < 27.9
    # Power: an offset of 5 % of the maximum, which another solver's slip would make, is five errors.
    assert (0.05 * truth.max() / error > 4.9).all()


def test_errors_fall_with_the_root_of_the_samples(truth):
    """Errors against adding–doubling at 1000 · 4^k samples, eight wavelengths × 12 seeds.

    Each root mean square of 96 errors is known to 7.2 %, so the slope over 4 counts to 0.023: four of those are
    allowed, and a slope of −0.4 would be refused.
    """
    counts = [1000 * 4**k for k in range(4)]
    rms = []
    for n in counts:
        off = [
            measure(scene(), SPHERE, WalkSolver(samples=n, pilot=n, seed=100 * n + s))["value"].to_numpy() - truth
            for s in range(12)
        ]
        rms.append(np.sqrt(np.mean(np.square(off))))
    x, y = np.log(counts), np.log(rms)
    fall = float(np.polyfit(x, y, 1)[0])
    error = 1 / math.sqrt(2 * 96 * np.sum((x - x.mean()) ** 2))
    assert error < 0.025
    assert abs(fall + 0.5) < 4 * error


def test_expected_values_say_more_a_sample_than_the_literal_walk():
    """Variances of 40 000 samples, known to some percent: less at every wavelength, most where little is absorbed."""
    found = {
        kind: measure(scene(), SPHERE, WalkSolver(estimator=kind, samples=40_000, pilot=40_000, seed=5))
        for kind in ("expected", "analog")
    }
    gain = np.square(found["analog"]["standard_error"] / found["expected"]["standard_error"]).to_numpy()
    assert (gain > 1.2).all()
    # What is absorbed scatters the literal walk's answers between 0 and 1; a value p has variance p(1 − p) there.
    p = found["analog"]["value"].to_numpy() - float(found["analog"]["specular"][0])
    literal = found["analog"]["standard_error"].to_numpy()
    np.testing.assert_allclose(literal, np.sqrt(p * (1 - p) / 40_000), rtol=0.03)


def test_the_cost_of_every_solver_on_one_scene():
    rows = cost(scene(), SPHERE, budget_seconds=4.0, seed=7)
    by = {r.solver: [x for x in rows if x.solver == r.solver] for r in rows}
    assert set(by) >= {"kubelka-munk", "adding-doubling", "walk expected", "walk analog"}
    assert {r.reference for r in rows} == {"adding-doubling"}
    exact = by["adding-doubling"][-1]
    assert exact.reference_error < 1e-6
    assert not exact.trusted
    assert any(r.pareto for r in by["adding-doubling"])
    for kind in ("walk expected", "walk analog"):
        walks = by[kind]
        assert len(walks) >= 3
        assert [r.samples for r in walks] == [8 * 1000 * 4**k for k in range(len(walks))]
        assert all(r.trusted and r.valid for r in walks)
        # Measured and stated agree: 8 errors or more each, so within a factor of 2.4 at four errors.
        assert all(1 / 2.4 < r.error / r.stated < 2.4 for r in walks)
        fall, error = slope(rows, kind)
        assert abs(fall + 0.5) < 4 * error
    crude = by["kubelka-munk"][0]
    assert not crude.valid
    assert crude.error > 10 * FAR * exact.reference_error


@pytest.mark.parametrize(("absorption", "n"), [(0.02, 1.0), (0.002, 1.4)])
def test_rings_of_the_dipole_are_off_by_less_than_it_says(absorption, n):
    """A wide-open fibre 6 transport paths away; the walk's own error is below 3 %."""
    scene = plain_stack([(n, absorption, 1.0, math.inf, Isotropic())])
    view = readout(FibreProbe(distance_mm=6.0, fibre_radius_mm=1.5, numerical_aperture=1.0), scene.n_above)
    dipole = solve(scene, view, solver="diffusion")
    walked = solve(scene, view, Accuracy(relative=0.03), "walk expected", sampling=Sampling(relative=0.03, seed=2))
    assert dipole.valid.all()
    off = abs(float(dipole.value[0] - walked.value[0]))
    assert off <= float(dipole.error[0]) + 3 * float(walked.error[0])
