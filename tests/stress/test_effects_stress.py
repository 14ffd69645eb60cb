"""Plans of scenes at the ends of what is physical: finite, deterministic, never over the tolerance by themselves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.effects.lateral import missed
from livlab.effects.plan import plan
from livlab.effects.plane import plane_value
from livlab.effects.reduce import widened_phase
from livlab.effects.scene import OpticalScene
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, plain_stack

CAMERA = HyperspectralCamera()
FORWARD = HenyeyGreenstein(0.95)
SCENES = {
    "nothing absorbs, semi-infinite": plain_stack([(1.38, 0.0, 10.0, math.inf, FORWARD)]),
    "nothing at all": plain_stack([(1.38, 0.0, 0.0, 1.0, FORWARD)]),
    "nothing scatters": plain_stack([(1.38, 1.0, 0.0, math.inf, FORWARD)]),
    "albedo 1 − 1e-9": plain_stack([(1.38, 1e-8, 10.0, math.inf, Isotropic())]),
    "albedo 1e-9": plain_stack([(1.38, 10.0, 1e-8, math.inf, Isotropic())]),
    "optical depth 1e-8": plain_stack([(1.38, 1e-8, 1e-8, 1.0, FORWARD)]),
    "optical depth 1e6": plain_stack([(1.38, 1.0, 1e4, 100.0, FORWARD)]),
    "a film on a mountain": plain_stack([(1.38, 1.0, 10.0, 1e-6, FORWARD), (1.38, 1.0, 10.0, 1e5, FORWARD)]),
    "indices matched to 1e-9": plain_stack([(1.38, 1.0, 10.0, 1.0, FORWARD), (1.38 + 1e-9, 1.0, 10.0, 9.0, FORWARD)]),
    "rarer than the outside": plain_stack([(1.2, 1.0, 10.0, 1.0, FORWARD)], n_above=1.5, n_below=1.5),
    "no index step": plain_stack([(1.0, 1.0, 10.0, 1.0, FORWARD)]),
    "g = 0.9999": plain_stack([(1.38, 1.0, 1e4, 10.0, HenyeyGreenstein(0.9999))]),
    "g = −0.9": plain_stack([(1.38, 1.0, 10.0, 10.0, HenyeyGreenstein(-0.9))]),
}


SIDEWAYS = ("nothing at all", "nothing scatters", "albedo 1e-9", "a film on a mountain", "rarer than the outside")


@pytest.mark.parametrize(
    ("name", "instrument"),
    [*((name, CAMERA) for name in SCENES), *((name, Collinear(beam="pencil")) for name in SIDEWAYS)],
)
def test_a_plan_is_made_of_any_scene(name, instrument):
    made = plan(SCENES[name], instrument, 0.003)
    assert made.bound <= 0.003
    assert made.predicted_saving < 1.0
    table = made.table()
    kept = table[table.decision != "not applicable"]
    assert np.isfinite(kept.bound).all() and (kept.bound >= 0.0).all()
    assert np.isfinite(kept.predicted_saving).all()
    assert made.apply(SCENES[name]).layers


@pytest.mark.parametrize("tolerance", [1e-12, 1.0])
def test_extreme_tolerances(tolerance):
    bulk = plain_stack([(1.38, 0.6, 50.0, 140.0, FORWARD)])
    made = plan(bulk, CAMERA, tolerance)
    assert made.bound <= tolerance
    assert bool(made.dropped) == (tolerance == 1.0)


def test_every_effect_forced_off_leaves_a_stack():
    two = plain_stack([(1.35, 0.1, 10.0, 0.1, FORWARD), (1.38, 0.6, 50.0, 140.0, FORWARD)])
    made = plan(two, Collinear(), 0.003, {"*": "off"})
    assert len(made.apply(two).layers) == 1
    assert math.isfinite(made.bound)


def test_an_element_of_rate_zero_is_no_effect():
    bulk = plain_stack([(1.38, 0.6, 50.0, 140.0, FORWARD)])
    idle = Interaction("idle", np.zeros(1), np.ones(1), (FORWARD,))
    stack = replace(bulk, layers=(replace(bulk.layers[0], interactions=(*bulk.layers[0].interactions, idle)),))
    assert "idle" not in [r.effect for r in plan(stack, CAMERA, 0.003).rows]


@pytest.mark.parametrize("g", [0.0, 1e-9, 0.5, 0.99, 0.9999, 0.999999])
@pytest.mark.parametrize("angle", [0.01, 1.0, 45.0, 179.99])
def test_widened_phases_stay_positive_and_keep_the_turn(g, angle):
    wide, share = widened_phase(HenyeyGreenstein(g), angle)
    assert (wide.pdf(np.linspace(-1.0, 1.0, 2001)) >= 0.0).all()
    assert share * (1.0 - wide.anisotropy) == pytest.approx(1.0 - g, rel=1e-6)


def test_a_beam_as_wide_as_its_sample_may_lose_all():
    bulk = plain_stack([(1.38, 0.6, 50.0, 140.0, FORWARD)])
    sphere = IntegratingSphere(port_diameter_mm=5.0, beam_diameter_mm=5.0)
    value = plane_value(bulk, sphere)
    assert missed(OpticalScene(bulk, sphere), value) == pytest.approx(value.scattered)
    assert "lateral-loss" not in plan(bulk, sphere, 0.003).dropped
