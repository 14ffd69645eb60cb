"""Adding–doubling: every quantity's stated error holds its true one, on stacks drawn at random."""

import math

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.adding_doubling import LEVELS, adding_doubling, cone_error, cone_fraction
from livlab.model.transport.quadrature import AngularGrid

TOTALS = (
    "reflectance", "transmittance", "absorbed",
    "reflectance_diffuse_incidence", "transmittance_diffuse_incidence", "absorbed_diffuse_incidence",
)  # fmt: skip
ANGULAR = ("reflectance_angular", "transmittance_angular")
COUNTED = 1e-10
"""True errors below are those of the reference, too."""


def drawn(rng, near):
    """A stack: one to three layers, optical depths of 1e-6 to 1e3, g up to .99; or up to four about two indices."""
    layers = []
    bases = rng.uniform(1.3, 1.5, 2)
    for _ in range(int(rng.choice([2, 2, 3, 4] if near else [1, 1, 2, 3]))):
        n = float(rng.choice([1.0, 1.33, 1.4, 1.5, rng.uniform(1.0, 1.6)]))
        n = float(rng.choice(bases)) * (1 + float(rng.choice([-1, 1])) * 10 ** rng.uniform(-9, -1)) if near else n
        depth, thickness = 10 ** rng.uniform(-6, 3), 10 ** rng.uniform(-3, 1)
        albedo = float(rng.choice([1 - 10 ** rng.uniform(-6, 0), rng.uniform(0, 1)]))
        g = float(rng.choice([0, 0.5, 0.8, 0.9, 0.95, 0.99, rng.uniform(-0.5, 0.99)]))
        phase = HenyeyGreenstein(g) if g else Isotropic()
        layers.append((n, depth * (1 - albedo) / thickness, depth * albedo / thickness, thickness, phase))
    mu0 = float(rng.choice([1.0, 1.0, 1.0, rng.uniform(0.1, 1)]))
    return plain_stack(layers, n_below=float(rng.choice([1.0, 1.0, 1.5]))), mu0, float(rng.uniform(1, 30))


def shortfalls(seed, count, near=False, nodes=96):
    """Stated over true error of all that counts, by quantity."""
    rng = np.random.default_rng(seed)
    found = {name: [] for name in (*TOTALS, *ANGULAR, "cone", "asked cone")}
    for _ in range(count):
        stack, mu0, degrees = drawn(rng, near)
        mu_min = math.cos(math.radians(degrees))
        truth = adding_doubling(stack, mu0=mu0, nodes=nodes, tolerance=1e-9, order=1536)
        totals = adding_doubling(stack, mu0=mu0)
        asked = adding_doubling(stack, mu0=mu0, mu_min=mu_min)
        pairs = [(name, totals[name], totals[f"{name}_error"], truth[name]) for name in (*TOTALS, *ANGULAR)]
        for name, result in (("cone", totals), ("asked cone", asked)):
            pairs.append(
                (name, cone_fraction(result, mu_min), cone_error(result, mu_min), cone_fraction(truth, mu_min))
            )
        for name, value, stated, true in pairs:
            off = np.abs(value.to_numpy() - true.to_numpy())
            found[name] += list((stated.to_numpy() / np.maximum(off, 1e-300))[off > COUNTED])
    return {name: np.array(x) for name, x in found.items()}


def hold(found):
    for name, ratio in found.items():
        assert (ratio >= 1).all(), (name, np.sort(ratio)[:3])


@pytest.mark.parametrize(("seed", "near"), [(401, False), (402, True)])
def test_stated_errors_hold_the_true_ones(seed, near):
    hold(shortfalls(seed, count=4, near=near, nodes=72))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "near"), [(403, False), (404, True)])
def test_stated_errors_of_many_stacks(seed, near):
    found = shortfalls(seed, count=120, near=near, nodes=112)
    hold(found)
    # Not absurdly large either: what is stated is the error of the coarser count, some hundred times the own (more
    # next to near indices, where convergence is faster still).
    cautious = 500 if near else 300
    for name, ratio in found.items():
        assert np.median(ratio) < (1000 if name in ANGULAR else cautious), (name, np.median(ratio))


def test_a_narrow_cone_has_its_own_error():
    """Forward scattering mirrored at the bottom is a peak 3° wide, of which totals know nothing."""
    stack, mu_min = plain_stack([(1.4, 0.025, 20.7, 0.0295, HenyeyGreenstein(0.95))]), math.cos(math.radians(3))
    truth = float(cone_fraction(adding_doubling(stack, nodes=128, order=2048), mu_min)[0])
    totals = adding_doubling(stack, tolerance=1e-5)
    assert abs(float(cone_fraction(totals, mu_min)[0]) - truth) <= float(cone_error(totals, mu_min)[0])
    assert float(cone_error(totals, mu_min)[0]) > 10 * float(totals.error_estimate[0])
    for tolerance in (1e-4, 1e-5, 1e-6):
        asked = adding_doubling(stack, mu_min=mu_min, tolerance=tolerance)
        assert bool(asked.converged[0])
        assert float(asked.error_estimate[0]) == pytest.approx(float(cone_error(asked, mu_min)[0]))
        assert abs(float(cone_fraction(asked, mu_min)[0]) - truth) <= float(asked.error_estimate[0]) <= tolerance


def test_what_is_not_reached_is_said_and_ends():
    """A tolerance beyond double precision stops at the last count."""
    stack = plain_stack([(1.4, 0.025, 20.7, 0.0295, HenyeyGreenstein(0.95))])
    found = adding_doubling(stack, tolerance=1e-17)
    assert not bool(found.converged[0])
    assert int(found.nodes[0]) == 96
    assert "the wished error of 1e-17 was not reached at 500 nm with 96 nodes" in found.attrs["notes"]


def test_crossing_pairs_stay_finite():
    """Two pairs of nearly equal indices, whose corners lie in a narrow interval, too."""

    def solved(gap):
        phases = [HenyeyGreenstein(g) for g in (0.8, 0.9, 0.95, 0.9)]
        indices = (1.4, 1.4 + gap, 1.37, 1.37 + gap)
        rates = ((0.1, 10.0, 0.5), (0.2, 5.0, 1.0), (0.01, 10.0, 0.1), (0.5, 15.0, 5.0))
        return adding_doubling(plain_stack([(n, *r, p) for n, r, p in zip(indices, rates, phases, strict=True)]))

    equal = solved(0.0)
    for gap in GAPS[1:]:
        result = solved(gap)
        assert bool(result.converged[0])
        assert abs(float(result.residual[0])) < 1e-9
        for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence"):
            off = abs(float(result[name][0]) - float(equal[name][0]))
            assert off <= 0.5 * gap + float(result[f"{name}_error"][0]), (gap, name)


GAPS = (0.0, 1e-12, 1e-10, 2e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_nearly_equal_indices_cost_little_and_join_continuously(sign):
    """Two layers whose indices cross: as many nodes as three times the equal ones' at most, and no jump.

    What a difference δ does is in proportion to it: the light beyond the critical angle is 2δ/n of all.
    """

    def solved(gap):
        first, second = HenyeyGreenstein(0.8), HenyeyGreenstein(0.9)
        layers = [(1.4, 0.1, 10.0, 0.5, first), (1.4 + sign * gap, 0.2, 5.0, 1.0, second)]
        return adding_doubling(plain_stack(layers))

    def nodes(gap, result):
        """Of all counts that were solved, up to the last."""
        tried = [c for c in LEVELS if c <= int(result.nodes[0])]
        return sum(AngularGrid.of((1.0, 1.4, 1.4 + sign * gap), c, (1.0, 1.0)).size for c in tried)

    equal = solved(0.0)
    for gap in GAPS[1:]:
        result = solved(gap)
        assert nodes(gap, result) <= 3 * nodes(0.0, equal), gap
        for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence"):
            apart = abs(float(result[name][0]) - float(equal[name][0]))
            assert apart <= 0.5 * gap + 1e-7, (gap, name)
            assert float(result[f"{name}_error"][0]) <= 1e-6
