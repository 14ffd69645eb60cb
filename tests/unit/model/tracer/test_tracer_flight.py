"""A flight through layers told by depth."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.geometry import total_reflectance

STACK = plain_stack([(1.3, 0.1, 1.0, 0.5, Isotropic()), (1.4, 0.1, 1.0, 1e3, Isotropic())])


@pytest.mark.parametrize("slope", [0.0, -0.0, 1e-20, -1e-20])
def test_a_level_flight_comes_to_no_interface(slope: float) -> None:
    from livlab.model.tracer.block import Block

    tracer = Block(STACK, total_reflectance(), "expected", "llvm_ad_spectral").tracer
    mi, dr, kernel = tracer.mi, tracer.dr, tracer.kernel
    from livlab.model.transport.rng import streams

    state = kernel.start(streams(tracer.d, 2, 1, 0), 2)
    depth = mi.Float([0.2, 3.0])  # one in each layer
    state.medium = mi.UInt32([1, 2])
    state.d = mi.Vector3f(1.0, 0.0, -slope)
    state.place.inward = mi.Vector3f(0.0, 0.0, -1.0) + dr.zeros(mi.Vector3f, 2)
    state.place.depth, state.place.trust, state.place.clear = depth, depth, depth
    state.tau = mi.Float([0.1, 0.1])
    flight = tracer.flights.fly(state)
    assert not np.array(flight.barrier).any()
    np.testing.assert_allclose(np.array(flight.reach), 0.1 / 1.1, rtol=1e-5)
    assert np.array(flight.collides).all()
    assert np.array(flight.layer).tolist() == [0, 1]
