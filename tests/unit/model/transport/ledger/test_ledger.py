"""A ledger as a whole: detectors, answers, gradients, refusals, accuracy."""

import math

import numpy as np
import pytest
from ledger_tissue import ONE, W, layer, stack, tissue

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, PlaneLayer
from livlab.model.transport.ledger.record_ledger import Detector, record
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally


@pytest.fixture(scope="module")
def ledger(libllvm):
    return record(tissue(), samples=20_000, seed=3, tally=Tally(theta_edges=(0.0, 0.5, 1.0, math.pi / 2)))


def test_detectors_divide_the_light(ledger):
    whole = ledger.answer(ledger.served, Detector.total()).value
    rings = [Detector("up", (a, b)) for a, b in ((0.0, 0.3), (0.3, 0.5), (0.5, math.pi / 2))]
    parts = [ledger.answer(ledger.served, r).value for r in rings]
    assert np.allclose(np.sum(parts, axis=0), whole, rtol=1e-6)
    assert (ledger.answer(ledger.served, Detector.cone(0.3)).value < 0.2 * whole).all()


def test_detector_bounds():
    with pytest.raises(InputError, match=r"detector\.theta"):
        Detector("up", (0.5, 0.2))
    with pytest.raises(InputError, match=r"detector\.side"):
        Detector("left")
    assert Detector.annulus(1.0, 2.0).radius == (1.0, 2.0)
    assert not Detector.annulus(1.0, 2.0).everything


def test_places_that_were_not_recorded_are_refused(ledger):
    with pytest.raises(InputError, match="places were not recorded"):
        ledger.answer(ledger.served, Detector.annulus(0.0, 1.0))


def test_spectrum_has_the_walks_names_and_closes_the_account(ledger):
    found = ledger.spectrum()
    assert found.wavelength.to_numpy().tolist() == W.tolist()
    parts = ("reflectance", "specular", "transmittance", "lost", "residual", "taken")
    assert np.allclose(sum(found[n] for n in parts), 1.0, atol=1e-12)
    for name in ("reflectance", "transmittance", "lost", "residual"):
        assert (found[f"{name}_se"] >= 0).all()
    assert (found.transmittance == 0).all()
    assert found.reflectance_binned.shape == (W.size, 3, 1)
    assert np.allclose(found.reflectance_binned.sum(("theta_o", "radius")), found.reflectance, rtol=1e-6)
    assert found.valid.all()
    assert {"samples", "seed", "variant", "anchors_nm", "interpolation_bias"} <= set(found.attrs)


def test_evaluate_at_what_is_served_is_the_spectrum(ledger):
    served = ledger.served
    found = ledger.evaluate(served.absorption, served.scattering, wavelength_nm=served.wavelength_nm)
    assert np.allclose(found.value, ledger.spectrum().reflectance, rtol=1e-12)


def test_same_seed_same_ledger_and_another_seed_another(libllvm):
    one, two, other = (record(tissue(), samples=3000, seed=s) for s in (5, 5, 6))
    assert one.entries.digest() == two.entries.digest()
    assert one.entries.digest() != other.entries.digest()


def test_constant_optics_need_one_anchor(libllvm):
    made = stack(layer("bulk", math.inf, 1.4, np.linspace(0.1, 2.0, W.size), 8.0, 0.5))
    found = record(made, samples=2000)
    assert len(found.anchors) == 1
    assert found.degree == 0


def test_bias_is_told_where_only_the_mixture_of_phase_functions_changes(libllvm):
    """Two scatterers of one mean cosine and other shapes: nothing but their shares changes with the wavelength."""
    shares = np.linspace(0.0, 1.0, W.size)
    parts = (
        Interaction("blood", 0.2 * ONE, 0 * ONE, (Isotropic(),) * W.size),
        Interaction("even", 3.0 * shares + 1e-9, ONE, (Isotropic(),) * W.size),
        Interaction("dipole", 3.0 * (1 - shares) + 1e-9, ONE, (Rayleigh(),) * W.size),
    )
    mixed = record(stack(PlaneLayer("slab", 0.3, 1.4 * ONE, parts)), samples=2000)
    assert len(mixed.anchors) == 1
    assert 1e-5 < mixed.about["interpolation_bias"] < 1e-2
    same = record(stack(layer("slab", 0.3, 1.4, 0.2, 3.0, 0.0)), samples=2000)
    assert same.about["interpolation_bias"] == 0.0
    strict = record(stack(PlaneLayer("slab", 0.3, 1.4 * ONE, parts)), standard_error=3e-4)
    assert len(strict.anchors) > 1
    assert strict.about["interpolation_bias"] <= 1.5e-4


def test_thickness_acts_through_optical_depth(ledger):
    """A layer of twice the thickness is one of twice the coefficients: exactly so in the ledger."""
    thick = ledger.spectrum(tissue(thickness=0.11), degenerate="mark")
    served = ledger.served
    a, s = served.absorption.copy(), served.scattering.copy()
    a[:, 0] *= 1.1
    s[:, 0] *= 1.1
    same = ledger.evaluate(a, s, wavelength_nm=served.wavelength_nm)
    assert np.allclose(thick.reflectance, same.value, rtol=1e-9)


def test_gradients_are_those_of_the_answers(ledger):
    served = ledger.served.take([1, 4, 7])
    at = {"wavelength_nm": served.wavelength_nm}
    found = ledger.evaluate(served.absorption, served.scattering, gradient=True, **at)
    for name, k in (("absorption", 0), ("absorption", 1), ("scattering", 0), ("scattering", 1)):
        values = {"absorption": served.absorption, "scattering": served.scattering}
        h = 1e-3 * values[name][:, k]
        moved = []
        for sign in (1, -1):
            changed = values[name].copy()
            changed[:, k] += sign * h
            moved.append(ledger.evaluate(**{**values, name: changed}, **at).value.to_numpy())
        numeric = (moved[0] - moved[1]) / (2 * h)
        exact = found[f"d_{name}"].to_numpy()[:, k]
        assert np.allclose(exact, numeric, rtol=1e-3), (name, k)
        assert (found[f"d_{name}_se"].to_numpy()[:, k] > 0).all()


def test_gradients_by_parameters_follow_the_chain_rule(ledger):
    def make(p):
        return tissue(p["blood"], p["cells"], p["capsule_mm"])

    at = {"blood": 1.2, "cells": 1.01, "capsule_mm": 0.1}
    found = ledger.gradient(make, at)
    assert found.gradient.dims == ("parameter", "wavelength")
    for name, value in at.items():
        h = 2e-3 * value
        up, down = (ledger.spectrum(make({**at, name: value + d}), degenerate="mark") for d in (h, -h))
        numeric = (up.reflectance - down.reflectance).to_numpy() / (2 * h)
        assert np.allclose(found.gradient.sel(parameter=name), numeric, rtol=1e-3), name


def test_a_ledger_whose_weights_degenerate_refuses_and_says_why(ledger):
    served = ledger.served.take([4])
    white = served.absorption * 0.0
    marked = ledger.evaluate(white, served.scattering, wavelength_nm=600.0)
    assert not marked.valid.any()
    assert marked.degeneracy[0] > 2.0
    with pytest.raises(InputError, match="added log variance"):
        ledger.evaluate(white, served.scattering, wavelength_nm=600.0, degenerate="raise")
    dense = served.scattering * [3.0, 1.0]
    assert not ledger.evaluate(served.absorption, dense, wavelength_nm=600.0).valid.any()
    with pytest.raises(InputError, match="effective samples"):
        ledger.spectrum(least_samples=1e9)


def test_walking_again_where_weights_degenerate(ledger):
    dense = tissue(mus=np.where(W > 620, 3.0, 1.0))
    marked = ledger.spectrum(dense, degenerate="mark")
    assert 0 < int(marked.valid.sum()) < W.size
    again = ledger.spectrum(dense, degenerate="walk")
    assert again.valid.all()
    assert again.attrs["walked_again_nm"] == W[~marked.valid.to_numpy()].tolist()
    kept = marked.valid.to_numpy()
    assert np.array_equal(again.reflectance[kept], marked.reflectance[kept])
    assert (again.reflectance[~kept] != marked.reflectance[~kept]).all()


def test_other_stacks_are_refused(ledger):
    with pytest.raises(InputError, match="has 2 layers"):
        ledger.spectrum(stack(layer("bulk", math.inf, 1.38, 0.5, 10.0, 0.8)))
    glass = stack(layer("capsule", 0.1, 1.5, 0.02, 12.0, 0.9), layer("bulk", math.inf, 1.38, 0.5, 10.0, 0.8))
    with pytest.raises(InputError, match="indices differ"):
        ledger.spectrum(glass)
    slab = stack(layer("capsule", 0.1, 1.36, 0.02, 12.0, 0.9), layer("bulk", 3.0, 1.38, 0.5, 10.0, 0.8), below=1.38)
    with pytest.raises(InputError, match="thickness"):
        ledger.spectrum(slab)
    other = ledger.spectrum(tissue(g=0.5, mus=1.0), degenerate="mark")
    assert not other.valid.any()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"samples": 1}, "samples"),
        ({"samples": 10, "standard_error": 1e-3}, "samples"),
        ({"standard_error": 0.0}, "standard_error"),
        ({"relative": 2.0}, "relative"),
        ({"reserve": 1.0}, "reserve"),
        ({"anchors": 0}, "anchors"),
        ({"anchors": 10}, "anchors"),
        ({"half_width_mm": 0.0}, "half_width_mm"),
        ({"half_width_mm": 1.0, "source": Source.collimated(disc_radius_mm=2.0)}, "source"),
        ({"max_steps": 0}, "max_steps"),
        ({"samples": 10, "variant": "metal"}, "variant"),
    ],
)
def test_bad_arguments(options, named):
    with pytest.raises(InputError, match=named):
        record(tissue(), **options)


def test_stacks_that_no_ledger_serves(libllvm):
    with pytest.raises(InputError, match="too little absorption"):
        record(stack(layer("bulk", math.inf, 1.4, 0.0, 8.0, 0.5)), samples=2000)
    thick = layer("slab", 20.0, 1.4, 1e-4, np.where(np.arange(W.size) % 2, 8.0, 16.0), 0.0)
    with pytest.raises(InputError, match="changes too much"):
        record(stack(thick), samples=2000, anchors=2)
    assert len(record(stack(thick), samples=2000).anchors) == W.size  # each its own


def test_a_white_slab_and_a_pale_half_space(libllvm):
    slab = record(stack(layer("slab", 1.0, 1.4, 0.0, 9.0, 0.0)), samples=20_000, seed=1).spectrum()
    assert np.allclose(slab.taken, 0.0, atol=4 * math.hypot(slab.reflectance_se.max(), slab.transmittance_se.max()))
    pale = record(stack(layer("bulk", math.inf, 1.0, 1e-4, 10.0, 0.0)), samples=20_000, seed=1).spectrum()
    # 1 − H(1) √(1 − a) at a = 1 − 1e-5, H(1) = 2.908
    assert (np.abs(pale.reflectance - (1 - 2.89 * math.sqrt(1e-5))) < 4 * pale.reflectance_se + 1e-4).all()


def test_evaluate_checks_its_arrays(ledger):
    good = np.ones((2, 2))
    for a, s, named in (
        (np.ones((2, 3)), good, "absorption"),
        (good, -good, "scattering"),
        (good, np.ones((3, 2)), "scattering"),
        (good * np.nan, good, "absorption"),
        (good, good * [1.0, 0.0], "scattering"),
    ):
        with pytest.raises(InputError, match=named):
            ledger.evaluate(a, s)
    with pytest.raises(InputError, match="anisotropy"):
        ledger.evaluate(good, good, anisotropy=good)
    with pytest.raises(InputError, match="degenerate"):
        ledger.evaluate(good, good, degenerate="walk")


def test_accuracy_asked_is_met(libllvm):
    absolute = record(tissue(), standard_error=2e-3, seed=1)
    assert absolute.spectrum().reflectance_se.max() <= 2e-3
    relative = record(tissue(), relative=0.02, seed=1).spectrum()
    assert (relative.reflectance_se / relative.reflectance).max() <= 0.02


def test_recording_stops_at_the_most_photons(libllvm):
    found = record(tissue(), standard_error=1e-5, most_photons=40_000)
    assert found.photons <= 40_000
    assert found.spectrum().reflectance_se.max() > 1e-5


def test_progress_may_stop_it(libllvm):
    class Enough(Exception):
        pass

    def stop(done):
        raise Enough

    with pytest.raises(Enough):
        record(tissue(), samples=100_000, progress=stop)
