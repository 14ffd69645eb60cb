"""One recording against many trusted values: closed forms, published numbers, adding-doubling."""

import math

import numpy as np
import pytest

from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.ledger.record_ledger import record
from livlab.model.transport.source import Source

pytestmark = pytest.mark.usefixtures("libllvm")


def many(layers, above=1.0, below=1.0):
    """Stack whose 'wavelengths' are settings: layers of (thickness, n, µ_a array, µ_s, phase)."""
    size = max(np.size(x[2]) for x in layers)
    one = np.ones(size)
    made = []
    for k, (thickness, n, mua, mus, phase) in enumerate(layers):
        parts = (
            Interaction("absorber", mua * one, 0 * one, (phase,) * size),
            Interaction("scatterer", mus * one, one, (phase,) * size),
        )
        made.append(PlaneLayer(f"layer {k}", thickness, n * one, parts))
    return OpticalStack(500.0 + np.arange(size), tuple(made), above * one, below * one)


# 1 − H(1) √(1 − a), isotropic scattering, matched index.
ALBEDO = np.array([0.2, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99])
HALF_SPACE = np.array([0.0352305, 0.1152259, 0.2852545, 0.4149475, 0.5355410, 0.6710837, 0.7527207])


def within(found, truth, least_power=3e-3, sigmas=4.0):
    """All values within so many standard errors, these small enough to tell."""
    value, error = found.reflectance.to_numpy(), found.reflectance_se.to_numpy()
    assert error.max() < least_power
    assert (np.abs(value - truth) <= sigmas * error + 1e-6).all(), (value - truth) / error


def test_half_spaces_of_every_albedo_from_one_recording():
    made = many([(math.inf, 1.0, 1.0 / ALBEDO - 1.0, 1.0, Isotropic())])
    ledger = record(made, samples=60_000, seed=11)
    assert len(ledger.anchors) == 1
    within(ledger.spectrum(), HALF_SPACE)


def test_mismatched_half_space_over_absorption():
    """Giovanelli 1955: 0.2600 with the specular 0.04 at µ_a 1, µ_s 9; scattering may vary with it."""
    scale = np.array([0.3, 1.0, 4.0])
    made = many([(math.inf, 1.5, 1.0 * scale, 9.0 * scale, Isotropic())])
    within(record(made, samples=60_000, seed=2).spectrum(), 0.2199186, 2e-3)


def test_two_layers_of_unequal_index_over_absorption():
    hg = HenyeyGreenstein(0.9)
    below = np.array([0.05, 0.5, 5.0])
    made = many([(0.1, 1.36, 0.01, 10.0, hg), (50.0, 1.38, below, 15.0, hg)])
    ledger = record(made, samples=40_000, seed=4)
    found = ledger.spectrum()
    within(found, np.array([0.462956, 0.145001, 0.040643]) - 0.0232692)
    thinner, thicker = (
        ledger.spectrum(many([(t, 1.36, 0.01, 10.0, hg), (50.0, 1.38, 0.5 * np.ones(3), 15.0, hg)]), degenerate="mark")
        for t in (0.08, 0.125)
    )
    for other, thickness in ((thinner, 0.08), (thicker, 0.125)):
        truth = adding_doubling(many([(thickness, 1.36, 0.01, 10.0, hg), (50.0, 1.38, 0.5, 15.0, hg)]))
        within(other, float(truth.reflectance[0]))


def test_slab_and_its_scattering():
    """A slab that light crosses: reflected, transmitted, and both at other scattering, from one recording."""
    hg = HenyeyGreenstein(0.75)
    made = many([(0.2, 1.0, np.array([0.5, 1.0, 3.0]), 9.0, hg)])
    ledger = record(made, samples=60_000, seed=9)
    found = ledger.spectrum()
    assert abs(float(found.reflectance[1]) - 0.0973946) < 4 * float(found.reflectance_se[1])
    assert abs(float(found.transmittance[1]) - 0.6609577) < 4 * float(found.transmittance_se[1])
    assert float(found.transmittance_se[1]) < 2e-3
    for mus in (7.0, 11.0):
        other = many([(0.2, 1.0, np.array([0.5, 1.0, 3.0]), mus, hg)])
        answer, truth = ledger.spectrum(other), adding_doubling(other)
        for name in ("reflectance", "transmittance"):
            off = np.abs(answer[name].to_numpy() - truth[name].to_numpy())
            assert (off < 4 * answer[f"{name}_se"].to_numpy()).all()


@pytest.mark.parametrize("source", [Source.collimated(1.0), Source.diffuse()])
def test_oblique_and_diffuse_light(source):
    hg = HenyeyGreenstein(0.6)
    made = many([(0.05, 1.36, 0.05, 8.0, hg), (math.inf, 1.4, np.array([0.1, 1.0]), 10.0, hg)])
    found = record(made, samples=40_000, seed=5, source=source).spectrum()
    if source.kind == "diffuse":
        truth = adding_doubling(made).reflectance_diffuse_incidence.to_numpy() - found.specular.to_numpy()
    else:
        truth = adding_doubling(made, mu0=math.cos(1.0)).reflectance.to_numpy()
    within(found, truth)


def test_gradients_against_differences_of_adding_doubling():
    hg = HenyeyGreenstein(0.8)

    def made(p):
        return many([(0.1, 1.36, p[0], p[1], hg), (math.inf, 1.38, p[2], p[3], hg)])

    at = np.array([0.05, 10.0, 0.4, 12.0])
    found = record(made(at), samples=200_000, seed=6)
    answer = found.evaluate(at[[0, 2]], at[[1, 3]], gradient=True)
    exact = np.concatenate([answer.d_absorption.to_numpy()[0], answer.d_scattering.to_numpy()[0]])[[0, 2, 1, 3]]
    error = np.concatenate([answer.d_absorption_se.to_numpy()[0], answer.d_scattering_se.to_numpy()[0]])[[0, 2, 1, 3]]
    for k in range(4):
        h = 0.01 * at[k]
        up, down = (
            float(adding_doubling(made(at + s * h * np.eye(4)[k]), tolerance=1e-8).reflectance[0]) for s in (1, -1)
        )
        truth = (up - down) / (2 * h)
        assert abs(exact[k] - truth) < 4 * error[k], k
        assert error[k] < 0.25 * abs(truth), k


# Whole liver in seven bands: what the polynomial between anchors leaves, and chance.
@pytest.mark.parametrize("name", ["thesis", "consistent", "measured"])
def test_liver_of_each_reading_without_capsule(name):
    band = np.arange(500.0, 721.0, 20.0)
    made = optical_stack(load_preset("liver").with_layers(("parenchyma",)), READINGS[name], band)
    ledger = record(made, standard_error=2e-3, seed=7)
    found, truth = ledger.spectrum(), adding_doubling(made, tolerance=1e-5).reflectance.to_numpy()
    bias = ledger.about["interpolation_bias"]
    assert found.reflectance_se.max() <= 2e-3
    off = np.abs(found.reflectance.to_numpy() - truth)
    assert (off <= bias + 3.5 * found.reflectance_se.to_numpy()).all()


def test_whole_liver_of_the_thesis():
    band = np.arange(500.0, 721.0, 10.0)
    made = optical_stack(load_preset("liver"), READINGS["thesis"], band)
    ledger = record(made, relative=0.01, seed=8)
    found, truth = ledger.spectrum(), adding_doubling(made, tolerance=1e-6).reflectance.to_numpy()
    assert len(ledger.anchors) <= 4
    # Adding-doubling takes short free paths as independent of the surface: a percent of the parenchyma's part.
    off = np.abs(found.reflectance.to_numpy() - truth)
    assert (off <= 1e-4 + 3.5 * found.reflectance_se.to_numpy()).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["thesis", "consistent", "measured"])
@pytest.mark.parametrize("whole", [True, False])
def test_spectra_of_221_wavelengths(name, whole):
    """Every reading, every nanometre from 500 to 720, against adding-doubling: bias and three standard errors."""
    tissue = load_preset("liver")
    made = optical_stack(
        tissue if whole else tissue.with_layers(("parenchyma",)), READINGS[name], np.arange(500.0, 720.5)
    )
    ledger = record(made, standard_error=1e-3, seed=3)
    found = ledger.spectrum()
    assert found.reflectance_se.max() <= 1e-3
    assert ledger.about["interpolation_bias"] <= 5e-4
    some = range(0, 221, 10 if whole and name != "thesis" else 1)
    truth = adding_doubling(made.at(list(some)), nodes=12, order=256).reflectance.to_numpy()
    off = np.abs(found.reflectance.to_numpy()[list(some)] - truth)
    assert (off <= 5e-4 + 3 * found.reflectance_se.to_numpy()[list(some)]).all()
