"""Sobol indices and elementary effects against the Ishigami function, whose indices are known in closed form.

y = sin x1 + a sin² x2 + b x3⁴ sin x1 with x in [−π, π]³ (Ishigami & Homma 1990).
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.kinds.study.config_parts import Sensitivity
from livlab.kinds.study.sensitivity import growth, indices, settled, unit_design

A, B = 7.0, 0.1
NAMES = ["x1", "x2", "x3"]


def ishigami(unit):
    x = math.pi * (2.0 * unit - 1.0)
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def closed_form():
    v1 = 0.5 * (1 + B * math.pi**4 / 5) ** 2
    v2 = A**2 / 8
    v13 = B**2 * math.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / total, np.array([v1 + v13, v2, v13]) / total


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sobol_indices_are_those_in_closed_form(seed):
    spec = Sensitivity(points=4096)
    unit = unit_design(spec, 3, seed)
    assert unit.shape == (4096 * 5, 3)
    found = indices(spec, unit, ishigami(unit), NAMES, seed)
    first, total = closed_form()
    # Power: an interval of 0.05 tells the six values (0, 0.24, 0.31, 0.44, 0.56) apart.
    assert found[["first_interval", "total_interval"]].to_numpy().max() < 0.05
    assert np.abs(found["first"] - first).max() < 0.02
    assert np.abs(found["total"] - total).max() < 0.02
    assert (np.abs(found["first"] - first) <= 1.3 * found["first_interval"]).all()
    assert (np.abs(found["total"] - total) <= 1.3 * found["total_interval"]).all()


def test_the_stated_intervals_cover_the_truth():
    """95 % intervals of 40 small designs, 6 indices each: between 85 and 100 % cover.

    Indices from one design hang together and a quasi-random design is better than its bootstrap knows, so coverage
    may exceed its level; far below it, the intervals would be too narrow to be stated.
    """
    spec = Sensitivity(points=256, resamples=100)
    first, total = closed_form()
    inside = []
    for seed in range(40):
        unit = unit_design(spec, 3, seed)
        found = indices(spec, unit, ishigami(unit), NAMES, seed)
        inside += list(np.abs(found["first"] - first) <= found["first_interval"])
        inside += list(np.abs(found["total"] - total) <= found["total_interval"])
    assert len(inside) == 240
    assert np.mean(inside) > 0.85


def test_more_points_settle():
    wide = []
    for points in (64, 1024):
        spec = Sensitivity(points=points)
        unit = unit_design(spec, 3, 1)
        grown = growth(spec, unit, ishigami(unit), NAMES, 1)
        assert sorted(grown["points"].unique()) == [points // 4, points // 2, points]
        wide.append(settled(spec, grown))
    assert wide[1][0] < 0.4 * wide[0][0]
    assert wide[1][1] < 0.1


def test_elementary_effects_of_a_plane_are_its_slopes():
    spec = Sensitivity(estimator="morris", points=20)
    unit = unit_design(spec, 3, 1)
    assert unit.shape == (20 * 4, 3)
    found = indices(spec, unit, unit @ np.array([3.0, -2.0, 0.0]), NAMES, 1).set_index("factor")
    assert found["mu"].to_numpy() == pytest.approx([3.0, -2.0, 0.0], abs=1e-12)
    assert found["mu_star"].to_numpy() == pytest.approx([3.0, 2.0, 0.0], abs=1e-12)
    assert found["sigma"].to_numpy() == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_elementary_effects_see_the_interaction_and_not_more():
    spec = Sensitivity(estimator="morris", points=200)
    unit = unit_design(spec, 3, 1)
    found = indices(spec, unit, ishigami(unit), NAMES, 1).set_index("factor")
    # x3 acts through x1 alone, with either sign: its mean is far below its mean size.
    assert abs(found.loc["x3", "mu"]) < 0.4 * found.loc["x3", "mu_star"]
    assert found.loc["x3", "sigma"] > found.loc["x3", "mu_star"]


def test_undefined_indices_are_refused_and_not_invented():
    spec = Sensitivity(points=16)
    unit = unit_design(spec, 3, 1)
    with pytest.raises(InputError, match="flat: its indices are 0/0"):
        indices(spec, unit, np.full(len(unit), 0.3), NAMES, 1)
    with pytest.raises(InputError, match="nan at every point"):
        indices(spec, unit, np.full(len(unit), np.nan), NAMES, 1)
    holes = ishigami(unit)
    holes[::17] = np.nan
    with pytest.raises(InputError, match="blocks with a nan"):
        indices(spec, unit, holes, NAMES, 1)


def test_a_block_with_a_nan_is_left_out_whole():
    spec = Sensitivity(points=64)
    unit = unit_design(spec, 3, 1)
    y = ishigami(unit)
    y[7] = np.nan  # in the second block of five
    rest = np.delete(np.arange(len(y)), slice(5, 10))
    assert indices(spec, unit, y, NAMES, 1).equals(indices(spec, unit[rest], y[rest], NAMES, 1))
