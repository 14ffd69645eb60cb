"""The ledger against the walk that it replaces, and its standard errors against its own scatter."""

import math

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.ledger.record_ledger import Detector, record
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.model.transport.walk.walk import walk

pytestmark = pytest.mark.usefixtures("libllvm")

W = np.array([500.0, 560.0, 620.0, 680.0])
ONE = np.ones(4)
FALLING = np.array([1.0, 0.7, 0.3, 0.15])


def element(name, rate, albedo, phase, **options):
    return Interaction(name, rate * ONE, albedo * ONE, (phase,) * 4, **options)


def capsule(redirect="none", phase=Isotropic()):  # noqa: B008
    parts = (
        element("collagen", 8.0 * (W / 600) ** -1.0, 1.0, phase, redirect=redirect),
        element("elastin", 3.0, 1.0, Rayleigh() if redirect == "none" else phase, redirect=redirect),
    )
    return PlaneLayer("capsule", 0.05, 1.35 * ONE, parts)


def bulk(thickness=math.inf, redirect="none", phase=Isotropic(), rate=6.0, **options):  # noqa: B008
    parts = (
        element("blood", FALLING, 0.0, phase),
        element("cells", rate * (W / 600) ** -0.5, 1.0, phase, redirect=redirect, **options),
    )
    return PlaneLayer("bulk", thickness, 1.38 * ONE, parts)


def stack(*layers, below=1.0):
    return OpticalStack(W, tuple(layers), ONE, below * ONE)


def agree(one, other, names, power):
    """Two independent estimates within 4 joint standard errors (4.5 in scores of bins), precise enough to tell."""
    for name in names:
        sigmas = 4.0 if one[name].size < 10 else 4.5
        a, b = one[name].to_numpy(), other[name].to_numpy()
        error = np.hypot(one[f"{name}_se"].to_numpy(), other[f"{name}_se"].to_numpy())
        assert (error < power * np.maximum(np.abs(b).max(), 1e-12)).all(), (name, error, b)
        assert (np.abs(a - b) <= sigmas * error + 1e-9).all(), (name, (a - b) / error)


def test_as_in_the_thesis():
    """Redirect factors, and hepatocytes that absorb after a short free path: long enough to matter here."""
    made = stack(capsule("abs_cos"), bulk(redirect="abs_cos", rate=2.0, absorb_below_mm=0.15))
    ledger = record(made, samples=150_000, seed=1)
    assert not ledger.scaled
    found, truth = ledger.spectrum(), walk(made, samples=300_000, seed=2)
    agree(found, truth, ["reflectance"], 0.01)
    without = walk(stack(capsule("abs_cos"), bulk(redirect="abs_cos", rate=2.0)), samples=100_000, seed=3)
    assert (without.reflectance - found.reflectance > 6 * found.reflectance_se).all()


def test_steered_factor_and_side_losses():
    """A factor that depends on direction, met by a forward phase function, in a small sample."""
    hg = HenyeyGreenstein(0.7)
    made = stack(capsule("abs_cos", hg), bulk(3.0, "abs_cos", hg), below=1.2)
    options = {"half_width_mm": 0.4, "source": Source.collimated(square_half_width_mm=0.1)}
    found = record(made, samples=120_000, seed=4, **options).spectrum()
    truth = walk(made, samples=120_000, seed=5, **options)
    agree(found, truth, ["reflectance", "lost"], 0.03)


def test_slab_with_transmission_angles_and_radii():
    tally = Tally((0.0, 0.4, 0.9, math.pi / 2), (0.0, 0.1, 0.4, 1.0))
    made = stack(capsule(), bulk(0.4, phase=HenyeyGreenstein(0.8), rate=12.0), below=1.33)
    ledger = record(made, samples=150_000, seed=6, tally=tally)
    found, truth = ledger.spectrum(), walk(made, samples=300_000, seed=7, tally=tally)
    agree(found, truth, ["reflectance", "transmittance", "reflectance_binned", "transmittance_binned"], 0.05)
    ring = ledger.answer(ledger.served, Detector("up", (0.4, 0.9), (0.1, 0.4)))
    assert np.allclose(ring.value, found.reflectance_binned.to_numpy()[:, 1, 1], rtol=1e-5)


def test_diffuse_light_on_layers():
    made = stack(capsule(), bulk())
    found = record(made, samples=100_000, seed=8, source=Source.diffuse()).spectrum()
    truth = walk(made, samples=200_000, seed=9, source=Source.diffuse())
    agree(found, truth, ["reflectance"], 0.01)
    assert np.allclose(found.specular, truth.specular, atol=5 * float(truth.specular_se.max()))


def test_standard_errors_are_honest():
    """Scatter of 60 small ledgers about the truth, where reweighting is mild and where it is strong."""
    made = stack(bulk(0.5, phase=HenyeyGreenstein(0.5), rate=10.0))
    served = adding_doubling(made).reflectance.to_numpy()
    a = made.layers[0].absorption[0]
    s = 0.75 * made.layers[0].scattering[0]
    far = OpticalStack(
        W[:1],
        (
            PlaneLayer(
                "bulk",
                0.5,
                1.38 * ONE[:1],
                (
                    Interaction("blood", np.array([a]), np.zeros(1), (HenyeyGreenstein(0.5),)),
                    Interaction("cells", np.array([s]), np.ones(1), (HenyeyGreenstein(0.5),)),
                ),
            ),
        ),
        ONE[:1],
        ONE[:1],
    )
    distant = adding_doubling(far).reflectance.to_numpy()
    scores = []
    for seed in range(60):
        ledger = record(made, samples=2000, seed=seed, check_bias=False)
        found = ledger.answer(ledger.served, Detector.total())
        other = ledger.evaluate(np.array([a]), np.array([s]), wavelength_nm=500.0)
        assert bool(other.valid[0])
        scores.append(
            [
                *((found.value - served) / found.standard_error)[[0, 3]],
                (float(other.value[0]) - distant[0]) / float(other.value_se[0]),
            ]
        )
    z = np.array(scores)
    # Mean of 60 unit normals: 0.13; their variance: 1 ± 0.18.
    assert (np.abs(z.mean(0)) < 0.55).all(), z.mean(0)
    assert ((z.var(0, ddof=1) > 0.45) & (z.var(0, ddof=1) < 1.8)).all(), z.var(0)


def test_gradient_errors_are_honest():
    made = stack(bulk(0.5, phase=HenyeyGreenstein(0.5), rate=10.0))
    h = 1e-3
    layer = made.layers[0]

    def shifted(da, ds):
        parts = (
            Interaction("blood", layer.interactions[0].rate + da, 0 * ONE, layer.interactions[0].phases),
            Interaction("cells", layer.interactions[1].rate + ds, ONE, layer.interactions[1].phases),
        )
        return stack(PlaneLayer("bulk", 0.5, layer.n, parts))

    truth = [
        (
            adding_doubling(shifted(*d), tolerance=1e-8).reflectance
            - adding_doubling(shifted(*(-x for x in d)), tolerance=1e-8).reflectance
        ).to_numpy()[1]
        / (2 * h)
        for d in ((h, 0.0), (0.0, h))
    ]
    scores = []
    for seed in range(50):
        ledger = record(made, samples=2000, seed=100 + seed, check_bias=False)
        one = ledger.served.take([1])
        found = ledger.evaluate(one.absorption, one.scattering, wavelength_nm=one.wavelength_nm, gradient=True)
        scores.append(
            [
                (float(found[n][0, 0]) - t) / float(found[f"{n}_se"][0, 0])
                for n, t in zip(("d_absorption", "d_scattering"), truth, strict=True)
            ]
        )
    z = np.array(scores)
    assert (np.abs(z.mean(0)) < 0.6).all(), z.mean(0)
    assert ((z.var(0, ddof=1) > 0.4) & (z.var(0, ddof=1) < 1.9)).all(), z.var(0)


def test_interpolation_bias_is_what_is_left_with_many_photons():
    """Strongly changing phase functions and few anchors: the bias told is the bias found."""
    g = np.linspace(0.5, 0.8, 4)
    parts = (
        Interaction("blood", FALLING, 0 * ONE, (Isotropic(),) * 4),
        Interaction("cells", 10.0 * ONE, ONE, tuple(HenyeyGreenstein(float(x)) for x in g)),
    )
    made = stack(PlaneLayer("slab", 1.0, 1.38 * ONE, parts))
    from livlab.model.transport.ledger.bias import interpolation_bias
    from livlab.model.transport.source import Source as Light

    ledger = record(made, samples=300_000, seed=1, anchors=2, check_bias=False)
    assert ledger.anchors.wavelength_nm.tolist() == [500.0, 680.0]
    told = interpolation_bias(
        made, ledger.anchors, (0, 3), ledger.degree, ledger.bear, ledger.scaled, Light.collimated(), at=[1, 2]
    )
    found = ledger.spectrum(degenerate="mark")
    off = found.reflectance.to_numpy()[1:3] - adding_doubling(made).reflectance.to_numpy()[1:3]
    error = found.reflectance_se.to_numpy()[1:3]
    assert (np.abs(off - told) < 4 * error).all(), (off, told, error)
    assert np.abs(told).max() > 5 * error.max()  # there is something to find
