"""Sources, bins, and sums that keep their digits."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.transport.source import Source
from livlab.model.transport.tally import SampleMoments, Tally


def test_sources_know_their_reach():
    assert not Source.collimated(0.3).extended
    assert Source.collimated(square_half_width_mm=5.0).reach_mm == 5.0
    assert Source.diffuse(disc_radius_mm=2.0).reach_mm == 2.0


@pytest.mark.parametrize(
    "bad",
    [
        {"angle_rad": -0.1},
        {"angle_rad": math.pi / 2},
        {"angle_rad": math.nan},
        {"square_half_width_mm": -1.0},
        {"disc_radius_mm": math.inf},
        {"square_half_width_mm": 1.0, "disc_radius_mm": 1.0},
        {"kind": "laser"},
    ],
)
def test_a_source_out_of_bounds_is_refused(bad):
    with pytest.raises(InputError, match="source"):
        Source(**bad)


@pytest.mark.parametrize("edges", [(0.0,), (0.2, 0.1), (0.0, 0.0), (-0.1, 0.5), (0.0, 2.0), (0.0, math.nan)])
def test_bad_angle_edges_are_refused(edges):
    with pytest.raises(InputError, match="theta_edges"):
        Tally(theta_edges=edges)


def test_edges_default_to_everything():
    assert Tally().theta == (0.0, math.pi / 2)
    assert Tally().radius == (0.0, math.inf)
    assert not Tally().binned
    assert Tally(radius_edges=[0, 1]).radius == (0.0, 1.0)


def test_moments_are_those_of_numpy_and_add():
    x = np.random.default_rng(1).exponential(size=(3, 1000))
    whole = SampleMoments.of(x)
    assert whole.mean == pytest.approx(x.mean(1))
    assert whole.standard_error == pytest.approx(x.std(1, ddof=1) / math.sqrt(1000))
    both = SampleMoments.of(x[:, :300]) + SampleMoments.of(x[:, 300:])
    assert both.standard_error == pytest.approx(whole.standard_error)
    again = SampleMoments.from_mean(1000, whole.mean, whole.standard_error)
    assert again.squares == pytest.approx(whole.squares)


def test_one_photon_has_a_mean_and_no_error():
    one = SampleMoments.of(np.array([0.25]))
    assert one.mean == 0.25
    assert math.isnan(one.standard_error)
    two = SampleMoments.from_mean(1, one.mean, one.standard_error) + SampleMoments.of(np.array([0.75]))
    assert two.mean == 0.5
    assert two.standard_error == pytest.approx(0.25)
