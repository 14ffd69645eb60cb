"""Sums that do not drift: long walks against what is known exactly."""

import math

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.device import device
from livlab.model.transport.tally import LANE_PHOTONS
from livlab.model.transport.walk.observers import Register
from livlab.model.transport.walk.walk import Source, Tally, walk

pytestmark = pytest.mark.usefixtures("libllvm")


@pytest.mark.parametrize("value", [0.1, 1 / 3, 0.7, 0.96, 1.0, 1e-3])
def test_a_constant_adds_up(value):
    """A lane's worst case: the same number over and over, where rounding never averages out."""
    d = device("llvm")
    sums = Register.start(d, 16)
    k = d.UInt32(0) + d.dr.zeros(d.UInt32, 16)
    state = (k, *sums)
    v = d.dr.opaque(d.Float, value)
    _, *sums = d.dr.while_loop(
        state, lambda k, *_: k < LANE_PHOTONS, lambda k, *s: (k + 1, *Register.add(d, s, d.Bool(True), v))
    )
    m = Register.moments(sums, 1, 16 * LANE_PHOTONS)
    assert m.mean[0] == pytest.approx(value, abs=2.0**-23)
    # What float32 alone would have made of it over a launch is three orders of magnitude worse.
    plain = np.cumsum(np.full(1 << 20, value, dtype=np.float32))[-1]
    if value not in (1.0,):
        assert abs(plain / 2**20 - value) > 20 * abs(m.mean[0] - value)


def beer(samples, **options):
    """An index-matched absorber of optical depth 1: T = 1/e, drawn by chance or carried as weight."""
    slab = plain_stack([(1.0, 1.0, 0.0, 1.0, Isotropic())])
    return walk(slab, samples=samples, seed=11, **options)


def test_beer_lambert():
    """Standard error 1.1e-4."""
    r = beer(20_000_000)
    se = float(r.transmittance_se[0])
    assert se == pytest.approx(math.sqrt(math.exp(-1) * (1 - math.exp(-1)) / 2e7), rel=0.01)
    assert float(r.transmittance[0]) == pytest.approx(math.exp(-1), abs=3 * se)
    assert float(r.absorbed[0, 0] + r.transmittance[0]) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.slow
def test_a_billion_photons_do_not_drift():
    """Standard error 1.5e-5, with bins; a float32 sum would have stalled at 1.7e7."""
    tally = Tally(theta_edges=(0.0, 0.5, math.pi / 2))
    r = beer(1_000_000_000, tally=tally)
    for name in ("transmittance", "transmittance_binned"):
        value = float(r[name].sum())
        assert value == pytest.approx(math.exp(-1), abs=3 * float(r.transmittance_se[0])), name
    assert float(r.transmittance_se[0]) < 1.6e-5
    assert float(r.absorbed[0, 0] + r.transmittance[0]) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.slow
def test_standard_errors_are_right_over_many_seeds():
    """Spread of 200 results against the error each states: χ² of 200, and no outlier."""
    slab = plain_stack([(1.4, 0.5, 5.0, 1.0, Isotropic())])
    runs = [walk(slab, samples=4000, seed=s, source=Source.diffuse()) for s in range(200)]
    for name in ("reflectance", "transmittance", "absorbed", "specular"):
        values = np.array([float(r[name].to_numpy().ravel()[0]) for r in runs])
        errors = np.array([float(r[f"{name}_se"].to_numpy().ravel()[0]) for r in runs])
        z = (values - values.mean()) / errors
        assert 0.70 < (z**2).sum() / 199 < 1.35, name
        assert np.abs(z).max() < 4.5, name
