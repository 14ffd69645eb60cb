"""Walks that take longer than anyone waits: roulette keeps them without bias, what is given up is told as an error."""

import math
from functools import partial

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.geometry import Readout, total_reflectance
from livlab.model.transport.ladder.solve import solve
from livlab.model.transport.ledger import record_ledger
from livlab.model.transport.sampling import SamplingRule, Walks
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.model.transport.walk import roulette
from livlab.model.transport.walk.walk import merge, walk

G8, G9, ISO = HenyeyGreenstein(0.8), HenyeyGreenstein(0.9), Isotropic()
PARTS = ("reflectance", "transmittance", "absorbed")


def closed(r):
    parts = ("reflectance", "specular", "transmittance", "lost", "redirect_loss", "residual")
    return sum(r[x].to_numpy() for x in parts) + r.absorbed.sum("layer").to_numpy()


@pytest.mark.parametrize("estimator", ["expected", "analog"])
def test_roulette_is_unbiased_and_the_account_closes(monkeypatch, estimator):
    """Roulette from the 16th step on, so that it plays often: the totals stay those of adding–doubling."""
    stack = plain_stack([(1.4, 0.01, 10.0, 1.0, G8), (1.33, 0.001, 20.0, 2.0, ISO)])
    monkeypatch.setattr(roulette, "FROM", 16)
    found, exact = walk(stack, samples=200_000, seed=11, estimator=estimator), adding_doubling(stack, tolerance=1e-7)
    z = []
    for name in PARTS:
        z += list(np.ravel((found[name].to_numpy() - exact[name].to_numpy()) / found[f"{name}_se"].to_numpy()))
    z.append(float(found.residual[0] / found.residual_se[0]))
    assert float(found.residual_se[0]) > 1e-4  # it did play
    assert max(map(abs, z)) < 4
    assert float(found.reflectance_se[0]) < 4e-3
    assert abs(closed(found) - 1).max() < 1e-6
    assert int(found.unfinished[0]) == 0


def test_heaviest_weight():
    assert roulette.heaviest(1) == roulette.heaviest(roulette.FROM) == 1.0
    assert roulette.heaviest(roulette.FROM + 1) == pytest.approx(256 / 181)
    assert roulette.heaviest(1 << 24) == pytest.approx((256 / 181) ** 7)


def test_what_is_given_up_bounds_every_part():
    stack = plain_stack([(1.4, 0.01, 10.0, 5.0, G8), (1.4, 0.0, 20.0, math.inf, G8)])
    found = walk(stack, samples=20_000, seed=5, max_steps=300)
    share = float(found.unfinished_share[0])
    assert share == int(found.unfinished[0]) / 20_000 > 0.01
    assert float(found.residual[0]) <= share
    truth = float(adding_doubling(stack).reflectance[0])
    assert float(found.reflectance[0]) - 4 * float(found.reflectance_se[0]) < truth
    assert truth < float(found.reflectance[0]) + share + 4 * float(found.reflectance_se[0])
    two = merge([found, walk(stack, samples=20_000, seed=6, max_steps=300)])
    assert float(two.unfinished_share[0]) == int(two.unfinished[0]) / 40_000


def cut(monkeypatch, max_steps):
    """Walks of the ladder give up so early."""
    monkeypatch.setattr("livlab.model.transport.walk.walk.walk", partial(walk, max_steps=max_steps))
    monkeypatch.setattr(record_ledger, "record", partial(record_ledger.record, max_steps=max_steps))


@pytest.mark.parametrize("solver", ["walk expected", "walk analog", "ledger"])
def test_an_estimate_tells_what_was_given_up(monkeypatch, solver):
    stack = plain_stack([(1.4, 0.01, 10.0, 5.0, G8)])
    truth = float(adding_doubling(stack).reflectance[0])
    cut(monkeypatch, 100)
    sampling = SamplingRule(samples=1, pilot=20_000, seed=4)
    found = solve(stack, total_reflectance(), Accuracy(standard_error=4e-3), solver, sampling=sampling)
    off = abs(float(found.value[0]) - truth)
    assert off > 4 * float(found.standard_error[0])  # what was given up is missed
    assert off <= float(found.systematic[0]) + 2 * float(found.standard_error[0])
    assert any("given up" in note and "systematic" in note for note in found.notes)
    assert any("was not met" in note for note in found.notes)


def test_each_part_of_the_budget_has_its_own_share(monkeypatch):
    cut(monkeypatch, 100)
    clear = plain_stack([(1.4, 0.0, 10.0, 5.0, G8), (1.4, 0.01, 10.0, math.inf, G8)])
    walks = Walks(clear, total_reflectance(), SamplingRule(samples=5000))
    walks.go()
    share = walks.unfinished_share
    assert (share > 0).all()
    np.testing.assert_array_equal(walks.systematic("reflectance"), share)
    np.testing.assert_array_equal(walks.systematic("transmittance"), 0.0)  # endless
    np.testing.assert_array_equal(walks.systematic("lost"), 0.0)  # no sides
    np.testing.assert_array_equal(walks.systematic("redirect_loss"), 0.0)
    np.testing.assert_array_equal(walks.systematic("absorbed"), np.stack([0 * share, share], axis=1))


def cone(degrees):
    edges = (0.0, math.radians(degrees))
    return Readout(Source.collimated(), Tally(theta_edges=edges), None, np.ones((1, 1)), 0.0, True)


LONG = {
    "thick slab": ([(1.4, 1e-5, 10.0, 500.0, G8)], {}, 2e-3),
    "thick slab, isotropic": ([(1.33, 1e-5, 1.0, 1000.0, ISO)], {}, 2e-3),
    "thick slab, Rayleigh": ([(1.0, 3e-6, 1.0, 2000.0, Rayleigh())], {}, 3e-3),
    "half-space of albedo 1 - 1e-6": ([(1.4, 1e-5, 10.0, math.inf, G9)], {}, 2e-3),
    "half-space of albedo 1 - 1e-7": ([(1.0, 1e-7, 1.0, math.inf, ISO)], {}, 4e-3),
    "half-space without absorption": ([(1.4, 0.0, 10.0, math.inf, ISO)], {}, 4e-3),
    "film, 1e-6 mm": ([(1.4, 1.0, 10.0, 1e-6, ISO)], {}, 3e-4),
    "film, 1e-7 mm": ([(1.4, 1.0, 10.0, 1e-7, G8)], {}, 3e-4),
    "nearly matched guide": ([(1.4, 1.0, 100.0, 1e-5, ISO)], {"n_above": 1.3999, "n_below": 1.3999}, 3e-4),
    "guide of two films": ([(1.4, 1.0, 10.0, 1e-6, ISO), (1.4001, 0.5, 20.0, 1e-6, G8)], {}, 3e-4),
    "film on a slab": ([(1.5, 1.0, 10.0, 1e-6, ISO), (1.33, 1e-4, 10.0, 30.0, G8)], {}, 2e-3),
    "deep under a clear plate": ([(1.5, 0.0, 0.0, 1.0, ISO), (1.4, 1e-5, 10.0, 300.0, G8)], {"n_below": 1.5}, 2e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", LONG)
def test_long_walks_within_what_they_state(case):
    """Value and every part within four of what is stated of them: standard error and systematic together."""
    layers, outside, wish = LONG[case]
    stack = plain_stack(layers, **outside)
    exact = adding_doubling(stack, tolerance=1e-8)
    walks = Walks(stack, total_reflectance(), SamplingRule(standard_error=wish, pilot=8192, seed=17))
    walks.go()
    for name in PARTS:
        off = np.abs(walks.mean(name) - exact[name].to_numpy())
        stated = np.hypot(walks.standard_error(name), walks.systematic(name))
        least = 3.0 / walks.samples[0]  # rare events that no photon saw
        assert (off <= 4 * np.maximum(stated, least)).all(), (name, off, stated)
    assert float(walks.error()[0]) <= wish * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [10.0, 30.0])
def test_long_walks_read_by_a_cone(degrees):
    stack, view = plain_stack([(1.4, 1e-5, 10.0, 200.0, G8)]), cone(degrees)
    sampling = SamplingRule(samples=1, pilot=8192, seed=19)
    exact = solve(stack, view, Accuracy(standard_error=1e-6), "adding-doubling")
    found = solve(stack, view, Accuracy(standard_error=2e-3), "walk expected", sampling=sampling)
    assert abs(float(found.value[0] - exact.value[0])) <= 4 * float(found.error[0])


@pytest.mark.slow
def test_light_trapped_in_a_film():
    """A = (µ_a + µ_s c (1 − ω)/(1 − c ω)) d, c = √(1 − 1/n²) the share of directions that stay inside; 1e-6 mm.

    The beam's mean path is d whatever the surfaces reflect; what is scattered into the guide ends at a collision.
    """
    absorption, scattering, thickness, n = 1.0, 10.0, 1e-6, 1.4
    albedo = scattering / (absorption + scattering)
    trapped = math.sqrt(1 - 1 / n**2)
    exact = (absorption + scattering * trapped * (1 - albedo) / (1 - trapped * albedo)) * thickness
    stack = plain_stack([(n, absorption, scattering, thickness, ISO)])
    assert float(adding_doubling(stack).absorbed[0, 0]) == pytest.approx(exact, rel=1e-3)
    found = walk(stack, samples=40_000_000, seed=23)
    error = float(found.absorbed_se[0, 0])
    assert error < 0.12 * exact  # 43 % of it used to be given up
    assert abs(float(found.absorbed[0, 0]) - exact) < 4 * error
