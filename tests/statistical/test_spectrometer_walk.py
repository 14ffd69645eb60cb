"""Virtual spectrometers by the walk, against adding–doubling and against plain ring counts."""

import math

import numpy as np
import pytest

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.solvers import AddingDoublingSolver, WalkSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.walk.walk import Tally, walk

W = np.array([500.0, 600.0, 700.0])


def liver_like():
    """A thin scattering layer on a bulk that absorbs less and less, with unequal indices."""
    one, phase = np.ones(3), (HenyeyGreenstein(0.7),) * 3

    def layer(name, thickness, n, absorption, scattering):
        parts = (Interaction("a", absorption, 0 * one, phase), Interaction("s", scattering * one, one, phase))
        return PlaneLayer(name, thickness, n * one, parts)

    bulk = np.array([2.0, 0.8, 0.3])
    return OpticalStack(W, (layer("top", 0.1, 1.35, 0.01 * one, 10.0), layer("bulk", 20.0, 1.38, bulk, 8.0)), one, one)


@pytest.mark.parametrize(
    "instrument",
    [
        Collinear(sample_side_mm="infinite"),
        Collinear(sample_side_mm="infinite", acceptance_deg=90.0, specular="included"),
        IntegratingSphere(port_diameter_mm="infinite", incidence_deg=8.0),
        HyperspectralCamera(illumination_deg=45.0),
        HyperspectralCamera(illumination_deg=10.0, polarisation="crossed"),
    ],
)
def test_walk_and_adding_doubling_read_the_same(instrument):
    """Standard error 0.4 % of the maximum; each z within 3.5 (one false alarm in 150 runs), χ² of three within 18."""
    exact = measure(liver_like(), instrument, AddingDoublingSolver())
    drawn = measure(liver_like(), instrument, WalkSolver(relative=0.004, seed=3))
    assert drawn["converged"].all()
    assert (drawn["standard_error"] <= 0.004 * drawn["value"].max()).all()
    z = ((drawn["value"] - exact["value"]) / drawn["standard_error"]).to_numpy()
    assert np.abs(z).max() < 3.5
    assert np.sum(z**2) < 18
    for name in ("reflectance", "absorbed"):
        z = ((drawn[name] - exact[name]) / drawn[f"{name}_se"]).to_numpy()
        assert np.abs(z).max() < 4.0


def test_light_through_the_sides_is_lost_and_counted():
    """A smaller sample reads less; what it misses is counted, and every photon's account closes."""
    endless = measure(liver_like(), Collinear(sample_side_mm="infinite"), AddingDoublingSolver())
    before = endless["value"].to_numpy()
    lost_before = np.zeros(3)
    for side in (30.0, 10.0, 3.0):
        seen = measure(liver_like(), Collinear(sample_side_mm=side), WalkSolver(relative=0.005, seed=1))
        total = sum(seen[n] for n in ("reflectance", "specular", "transmittance", "lost", "redirect_loss", "residual"))
        assert np.abs(total + seen["absorbed"].sum("layer") - 1).max() < 1e-6
        value, error = seen["value"].to_numpy(), seen["standard_error"].to_numpy()
        assert (value < before + 3 * error).all()
        assert (seen["lost"].to_numpy() > lost_before).all()
        before, lost_before = value, seen["lost"].to_numpy()
    # Power: at 3 mm the loss is far above the error, at every wavelength.
    assert (value < endless["value"].to_numpy() - 10 * error).all()


def test_a_small_port_misses_light():
    whole = measure(liver_like(), IntegratingSphere(port_diameter_mm="infinite"), AddingDoublingSolver())
    seen = measure(
        liver_like(), IntegratingSphere(port_diameter_mm=3.0, beam_diameter_mm=2.0), WalkSolver(relative=0.004, seed=5)
    )
    missed = ((whole["value"] - seen["value"]) / seen["standard_error"]).to_numpy()
    # At 500 nm (absorption length 0.5 mm) light hardly spreads; at 700 nm it does.
    assert missed[0] > -3
    assert missed[1] > 5
    assert missed[2] > 20
    # Light outside the port still left the sample: it is in the reflectance, and nothing went through sides.
    outside = (seen["reflectance"] + seen["specular"] - seen["value"]).to_numpy()
    assert (np.diff(outside) > 0).all()
    assert outside[0] > 0
    assert (seen["lost"] == 0).all()


def test_probe_reads_the_ring_it_sits_on():
    """A thin pencil and a wide-open fibre: value = flux in a narrow ring × the fibre's share of the ring's area.

    The ring is counted by `walk` itself with another seed. The flux falls steeply with distance, so the ring is
    weighted as the fibre is: over a fibre of radius 0.1 at 1 mm the curvature's part is below 1 %.
    """
    tissue = liver_like()
    probe = FibreProbe(distance_mm=1.0, source_radius_mm=0.0, fibre_radius_mm=0.1, numerical_aperture=1.0)
    seen = measure(tissue, probe, WalkSolver(samples=1_000_000, seed=2))
    ring = walk(tissue, tally=Tally(radius_edges=(0.95, 1.05)), samples=1_000_000, seed=77)
    share = math.pi * 0.1**2 / (math.pi * (1.05**2 - 0.95**2))
    expected = share * ring["reflectance_binned"].to_numpy()[:, 0, 0]
    error = np.hypot(share * ring["reflectance_binned_se"].to_numpy()[:, 0, 0], seen["standard_error"].to_numpy())
    assert (np.abs(seen["value"].to_numpy() - expected) < 3.5 * error + 0.01 * expected).all()
    # Power: an error of 10 % in the geometry would be seen.
    assert (error < 0.03 * expected).all()


def test_probe_error_is_that_of_repeats():
    """24 seeds: their spread is known to 15 %, so a ratio within 1 ± 0.6 at 4 errors."""
    tissue = liver_like()
    probe = FibreProbe(distance_mm=0.5, source_radius_mm=0.2, fibre_radius_mm=0.2, numerical_aperture=1.0)
    seen = [measure(tissue, probe, WalkSolver(samples=20_000, pilot=20_000, seed=s)) for s in range(24)]
    values = np.array([x["value"].to_numpy() for x in seen])
    stated = np.array([x["standard_error"].to_numpy() for x in seen]).mean(axis=0)
    ratio = values.std(axis=0, ddof=1) / stated
    assert ((ratio > 0.4) & (ratio < 1.6)).all()


def test_a_launch_split_in_two_is_resumed_to_the_same_numbers():
    tissue, instrument = liver_like(), Collinear()
    solver = WalkSolver(samples=60_000, pilot=20_000, seed=4, largest_launch=60_000)
    parts = []
    whole = measure(tissue, instrument, solver, on_round=lambda part, _: parts.append(part))
    again = measure(tissue, instrument, solver, resume=parts[0])
    for name in ("value", "standard_error", "lost", "absorbed"):
        np.testing.assert_allclose(again[name], whole[name], rtol=1e-9, atol=1e-15)
