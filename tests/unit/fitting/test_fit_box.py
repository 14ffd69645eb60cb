"""Boxes that are partly no tissue, against half-spaces whose cut is known in closed form."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.fitting.box import POINTS, refused, survey, why_not


def halfspace(weights, most):
    def at(u):
        total = float(np.dot(weights, u))
        if total > most:
            raise InputError.of("fractions", total, f"must sum to at most {most}", "Lower one.")

    return at


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5, 9])
def test_a_box_without_walls_is_whole(dimensions):
    found = survey(halfspace(np.ones(dimensions), dimensions + 1e-9), np.full(dimensions, 0.5))
    assert found.empty == 0.0
    assert found.error is None and not found.limits


@pytest.mark.parametrize(("dimensions", "most"), [(2, 1.2), (3, 1.5), (4, 2.5), (8, 5.0)])
def test_the_share_that_is_cut_off_is_its_volume(dimensions, most):
    # The volume of Σ u ≤ t in the unit cube is Irwin and Hall's distribution.
    kept = sum((-1) ** k * math.comb(dimensions, k) * (most - k) ** dimensions for k in range(int(most) + 1))
    expected = 1.0 - kept / math.factorial(dimensions)
    found = survey(halfspace(np.ones(dimensions), most), np.full(dimensions, 0.1), seed=3)
    assert not found.limits
    assert found.empty == pytest.approx(expected, abs=3.0 * math.sqrt(expected * (1 - expected) / POINTS))


@pytest.mark.parametrize(("weights", "most"), [([1.0, 0.0], 0.3), ([1.0, 0.2, 0.1], 0.7), ([0.4, 0.0, 2.0, 0.0], 1.3)])
def test_an_end_that_nothing_reaches_is_found_where_it_is(weights, most):
    found = survey(halfspace(weights, most), np.full(len(weights), 0.1))
    k = int(np.argmax(weights))
    assert [x.dimension for x in found.limits] == [k]
    assert found.limits[0].high
    assert found.limits[0].at[k] == pytest.approx(most / weights[k], abs=1e-6)  # with the others at their least
    assert why_not(halfspace(weights, most), found.limits[0].at) is None


def test_a_lower_end_can_be_out_of_reach():
    found = survey(halfspace([-1.0, 0.0], -0.25), np.array([0.5, 0.5]))
    assert [(x.dimension, x.high) for x in found.limits] == [(0, False)]
    told = str(refused(found.limits[0], "parameter water", "low", 0.2, 0.25, "water"))
    assert "parameter water.low = 0.2: does not fit" in told
    assert "no tissue below water = 0.25" in told
    assert "Give low = 0.25" in told


def test_an_open_bound_is_no_wall():
    def at(u):
        if not u.min() > 0.0:
            raise InputError.of("thickness_mm", 0.0, "must be greater than 0", "Give more.")

    found = survey(at, np.full(2, 0.5))
    assert found.error is None and not found.limits
