"""The thesis's literal walk and the fast one estimate the same numbers."""

import math

import numpy as np
import pytest
from scipy import stats

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.walk.walk import Source, Tally, walk

pytestmark = pytest.mark.usefixtures("libllvm")

W = np.array([500.0, 600.0, 700.0])
ONE = np.ones(3)
ISO = Isotropic()
FALLING = np.array([1.5, 1.0, 0.3])


def element(name, rate, albedo, phase, **options):
    return Interaction(name, rate * ONE, albedo * ONE, (phase,) * 3, **options)


def as_in_the_thesis(redirect, phase=ISO):
    """Capsule thin to light, absorbers, and a hepatocyte that attenuates: absorbs after a short free path."""
    capsule = PlaneLayer(
        "capsule",
        0.05,
        1.35 * ONE,
        (
            element("collagen", 8.0, 1.0, phase, redirect=redirect),
            element("elastin", 3.0, 1.0, phase if phase is ISO else Rayleigh(), redirect=redirect),
        ),
    )
    bulk = PlaneLayer(
        "parenchyma",
        math.inf,
        1.383 * ONE,
        (
            element("blood", FALLING, 0.0, ISO),
            element("bile", 0.1, 0.0, ISO),
            element("hepatocyte", 2.0, 1.0, ISO, redirect=redirect, absorb_below_mm=0.05),
        ),
    )
    return OpticalStack(W, (capsule, bulk), ONE, ONE)


def consistent():
    """Fibres with Mie's peaks in four sublayers, cells with an albedo."""
    fibres = mie_phase(1.5 / 1.35, 20.0)
    capsule = tuple(
        PlaneLayer(
            f"capsule {k}",
            0.02,
            1.35 * ONE,
            (element("collagen", 60.0 - 10 * k, 1.0, fibres), element("elastin", 10.0 * k, 1.0, Rayleigh())),
        )
        for k in range(4)
    )
    bulk = PlaneLayer(
        "parenchyma",
        10.0,
        1.383 * ONE,
        (
            element("blood", FALLING, 0.0, ISO),
            element("water", 0.02, 0.0, ISO),
            element("hepatocyte", 20.0, 0.98, HenyeyGreenstein(0.9)),
        ),
    )
    return OpticalStack(W, (*capsule, bulk), ONE, ONE)


def everything_mixed():
    """Different factors, phase functions, albedos and shortest paths in one layer, and a lower index next."""
    a = PlaneLayer(
        "a",
        0.3,
        1.4 * ONE,
        (
            element("x", 5.0, 1.0, ISO, redirect="abs_cos"),
            element("y", 3.0, 0.9, HenyeyGreenstein(0.5), redirect="clamped_cos"),
            element("z", FALLING, 0.0, ISO),
        ),
    )
    b = PlaneLayer(
        "b",
        1.0,
        1.2 * ONE,
        (element("p", 4.0, 0.8, Rayleigh(), absorb_below_mm=0.02), element("q", 4.0, 1.0, ISO, absorb_below_mm=0.1)),
    )
    return OpticalStack(W, (a, b), ONE, 1.3 * ONE)


STACKS = {
    "abs_cos": lambda: as_in_the_thesis("abs_cos"),
    "cos": lambda: as_in_the_thesis("cos"),
    "clamped_cos": lambda: as_in_the_thesis("clamped_cos"),
    "no factor": lambda: as_in_the_thesis("none"),
    "factor with a peaked phase": lambda: as_in_the_thesis("abs_cos", HenyeyGreenstein(0.8)),
    "consistent": consistent,
    "mixed": everything_mixed,
}
LIGHT = {
    "pencil": {},
    "square sample": {"half_width_mm": 0.5, "source": Source.collimated(0.5, square_half_width_mm=0.5)},
    "diffuse, binned": {
        "source": Source.diffuse(),
        "tally": Tally(theta_edges=(0.0, 0.6, math.pi / 2), radius_edges=(0.0, 0.05, 0.3, math.inf)),
    },
}
QUANTITIES = ("reflectance", "transmittance", "absorbed", "lost", "redirect_loss", "specular", "reflectance_binned")


def compare(stack, most, **options):
    """z of every quantity; those that both know exactly, or nearly never see, are held to 1e-6."""
    fast = walk(stack, seed=31, estimator="expected", **options)
    plain = walk(stack, seed=32, estimator="analog", **options)
    assert float(np.hypot(fast.reflectance_se, plain.reflectance_se).max()) <= most, "no power"
    assert int(fast.unfinished.sum() + plain.unfinished.sum()) == 0
    for name in (x for x in QUANTITIES if x in fast):
        error = np.hypot(fast[f"{name}_se"], plain[f"{name}_se"]).to_numpy().ravel()
        difference = (fast[name] - plain[name]).to_numpy().ravel()
        seen = error > 1e-6
        assert np.abs(difference[~seen]).max(initial=0.0) < 1e-5, name
        z = difference[seen] / error[seen]
        assert np.abs(z).max(initial=0.0) < 3.7, (name, z)
        assert z.size == 0 or stats.chi2.sf(np.sum(z**2), z.size) > 1e-4, (name, z)
    return fast, plain


@pytest.mark.parametrize("light", LIGHT)
@pytest.mark.parametrize("name", STACKS)
def test_both_walks_agree(name, light):
    """Combined standard error of R at most 1.6e-3; up to 40 z values each."""
    compare(STACKS[name](), 1.6e-3, samples=160_000, **LIGHT[light])


def test_the_comparison_sees_a_wrong_factor():
    """Power: taking the mean of the factor for a clamped one, or forgetting short paths, does not pass."""
    with pytest.raises(AssertionError):
        compare_two(as_in_the_thesis("abs_cos"), as_in_the_thesis("clamped_cos"))
    bare = as_in_the_thesis("abs_cos")
    parts = tuple(Interaction(i.name, i.rate, i.albedo, i.phases, i.redirect) for i in bare.layers[1].interactions)
    long = OpticalStack(W, (bare.layers[0], PlaneLayer("parenchyma", math.inf, 1.383 * ONE, parts)), ONE, ONE)
    with pytest.raises(AssertionError):
        compare_two(bare, long)


def compare_two(a, b):
    x, y = (walk(s, samples=120_000, seed=k) for k, s in enumerate((a, b)))
    z = (x.reflectance - y.reflectance) / np.hypot(x.reflectance_se, y.reflectance_se)
    assert np.abs(z).max() < 3.7


def test_plain_cosine_averages_to_nothing():
    """The factor as printed: what scatters once or more contributes nothing on average, in either walk."""
    stack = as_in_the_thesis("cos")
    fast, _ = compare(stack, 1.0e-3, samples=400_000)
    # What is left is light that the two interfaces reflect without a scattering between them.
    assert float(fast.reflectance_se.max()) < 1e-4
    assert np.abs(fast.reflectance.values).max() < 2e-4


@pytest.mark.slow
@pytest.mark.parametrize("light", ["pencil", "square sample"])
@pytest.mark.parametrize("name", STACKS)
def test_both_walks_agree_at_1e_4(name, light):
    """Standard error of R at most 1e-4 in each walk, at the first wavelength."""
    compare(STACKS[name]().at([0]), 1.42e-4, samples=26_000_000, **LIGHT[light])


def liver(reading_name, wavelength_nm):
    from livlab.model.tissue.optics import optical_stack
    from livlab.model.tissue.presets import load_preset
    from livlab.model.tissue.readings import reading

    return optical_stack(load_preset("liver"), reading(reading_name), wavelength_nm)


@pytest.mark.parametrize("reading_name", ["thesis", "consistent", "measured"])
def test_both_walks_agree_on_liver(reading_name):
    """Every reading, square sample of 1 cm² under collimated light: combined standard error at most 1.5e-3."""
    beam = Source.collimated(square_half_width_mm=5.0)
    compare(liver(reading_name, W), 1.5e-3, samples=200_000, half_width_mm=5.0, source=beam)


@pytest.mark.slow
@pytest.mark.parametrize("reading_name", ["thesis", "consistent", "measured"])
def test_both_walks_agree_on_liver_at_1e_4(reading_name):
    beam = Source.collimated(square_half_width_mm=5.0)
    compare(liver(reading_name, W[:1]), 1.42e-4, samples=26_000_000, half_width_mm=5.0, source=beam)
