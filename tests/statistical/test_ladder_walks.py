"""Walks on the ladder against adding–doubling: wishes met, errors falling as 1/√n, one estimator against the other."""

import math

import numpy as np
import pytest

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.solvers import WalkSolver
from livlab.acquire.instruments.spectrometer import estimate, measure
from livlab.kinds.checks.cost import FAR, cost, slope
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.ladder.solve import pick, solve
from livlab.model.transport.sampling import SamplingRule

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
    found = estimate(scene(), SPHERE, wish, "walk expected", sampling=SamplingRule(relative=0.5, seed=3))
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


def many(count=24):
    """More wavelengths, unequal layers, absorption over two decades."""
    x, one, phase = np.linspace(0, 1, count), np.ones(count), (HenyeyGreenstein(0.8),) * count
    layers = []
    for name, thick, n, low, scattering in (("top", 0.1, 1.36, 0.02, 12.0), ("bulk", math.inf, 1.4, 0.05, 20.0)):
        absorption = low * 40 ** (0.5 + 0.5 * np.cos(5 * x))
        parts = (Interaction("a", absorption, 0 * one, phase), Interaction("s", scattering - 4 * x, one, phase))
        layers.append(PlaneLayer(name, thick, n * one, parts))
    return OpticalStack(500 + 220 * x, tuple(layers), one, one)


@pytest.mark.parametrize("view", [SPHERE, HyperspectralCamera(illumination_deg=0.0, acceptance_deg=40.0)])
def test_the_ledger_meets_a_wish_for_many_wavelengths(view):
    """One record answers 24 wavelengths: errors that go together, so a bound on each, 3.5, and none on their sum."""
    exact = estimate(many(), view, Accuracy(standard_error=1e-6), "adding-doubling").value.to_numpy()
    wish = Accuracy(relative=0.01)
    found = estimate(many(), view, wish, "ledger", sampling=SamplingRule(relative=0.1, seed=4))
    assert found.solver == "ledger"
    assert found.valid.all()
    error = found.error.to_numpy()
    assert (error <= 0.01 * found.value.to_numpy().max() * 1.05).all()
    assert (np.abs(found.value.to_numpy() - exact) < 3.5 * error).all()
    # Power: an offset of 5 % of the maximum would be seen at every wavelength.
    assert (0.05 * exact.max() > 4.5 * error).all()


def test_a_ledger_of_a_sample_with_sides_reads_what_walks_do():
    """5 mm wide, where 6 to 39 % of what an endless one shows is lost: 8 wavelengths, each within 3.5 errors."""
    view = Collinear(sample_side_mm=5.0, acceptance_deg=60.0)
    wish = Accuracy(relative=0.01)
    kept, walked = (
        estimate(scene(), view, wish, solver, sampling=SamplingRule(relative=0.1, seed=6))
        for solver in ("ledger", "walk expected")
    )
    assert (np.abs(kept.value - walked.value) < 3.5 * np.hypot(kept.error, walked.error)).all()
    endless = estimate(scene(), view, wish, "adding-doubling", outside="warn")
    # Power: the light lost at the brightest wavelength is far above the error.
    assert float(endless.value[-1] - kept.value[-1]) > 8 * float(kept.error[-1])


def test_the_ledger_is_taken_for_many_wavelengths_where_it_is_sooner_done(monkeypatch):
    """Adding–doubling out of the way, 24 wavelengths to 0.03 %: a walk each, or one record for all."""
    monkeypatch.setattr("livlab.model.transport.ladder.pick.WORTH_NO_WALK", 0.0)
    view = SPHERE.readout(np.ones(24))
    picked = pick(many(), view, Accuracy(relative=0.0003), sampling=SamplingRule(relative=0.1, seed=2))
    assert {x for x in ("adding-doubling", "walk expected", "ledger") if x in picked.notes[0]} == {
        "adding-doubling",
        "walk expected",
        "ledger",
    }
    assert picked.solver in ("adding-doubling", "ledger")
    few = pick(scene().at([0, 4]), view, Accuracy(relative=0.003), account=True)
    assert few.solver != "ledger"


def test_the_cost_of_every_solver_on_one_scene():
    rows = cost(scene(), SPHERE, budget_seconds=4.0, seed=7)
    by = {r.solver: [x for x in rows if x.solver == r.solver] for r in rows}
    assert set(by) >= {"kubelka-munk", "adding-doubling", "ledger", "walk expected", "walk analog"}
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
    view = FibreProbe(distance_mm=6.0, fibre_radius_mm=1.5, numerical_aperture=1.0).readout(scene.n_above)
    dipole = solve(scene, view, solver="diffusion")
    walked = solve(scene, view, Accuracy(relative=0.03), "walk expected", sampling=SamplingRule(relative=0.03, seed=2))
    assert dipole.valid.all()
    off = abs(float(dipole.value[0] - walked.value[0]))
    assert off <= float(dipole.error[0]) + 3 * float(walked.error[0])
