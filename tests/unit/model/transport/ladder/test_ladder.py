"""The ladder: which solver answers, which refuses, how a wish is met; by a clock and a walk that are both made up."""

import dataclasses
import math

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.solvers import AutoSolver
from livlab.acquire.instruments.spectrometer import estimate, measure
from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport import adding_doubling as exact
from livlab.model.transport.diffusion import dipole_profile, dipole_total
from livlab.model.transport.geometry import total_reflectance
from livlab.model.transport.ladder import approximate
from livlab.model.transport.ladder.solve import SOLVERS, Accuracy, Estimate, domain, pick, solve
from livlab.model.transport.sampling import SamplingRule, Walks

SPHERE = IntegratingSphere(port_diameter_mm="infinite")
CHANCE = {500.0: 0.02, 600.0: 0.1, 700.0: 0.4}


def stack(wavelengths=(500.0, 600.0, 700.0), scattering=9.0, absorption=1.0, thickness=2.0, **more):
    w = np.array(wavelengths)
    one, phase = np.ones(len(w)), (HenyeyGreenstein(0.5),) * len(w)
    parts = (
        Interaction("absorber", absorption * one, 0 * one, phase),
        Interaction("scatterer", scattering * one, one, phase, **more),
    )
    return OpticalStack(w, (PlaneLayer("slab", thickness, one, parts),), one, one)


def half_space(absorption=0.01, reduced=1.0, n=1.4):
    return plain_stack([(n, absorption, reduced, math.inf, Isotropic())])


class Lab:
    """A clock, and a walk of coin tosses that lets it run: so much a launch, and so much a sample."""

    def __init__(self, launch, sample):
        self.now, self.launch, self.sample, self.walked = 0.0, launch, sample, 0

    def clock(self):
        return self.now

    def walk(self, stack, *, samples, seed, tally, **_):
        self.now += self.launch + self.sample * samples * len(stack.wavelength_nm)
        self.walked += samples * len(stack.wavelength_nm)
        p = np.array([CHANCE.get(float(w), 0.2) for w in stack.wavelength_nm])
        up = np.random.default_rng(seed).binomial(samples, p) / samples
        data = {"reflectance": up, "transmittance": 1 - up}
        data |= dict.fromkeys(("lost", "redirect_loss", "residual"), 0 * up)
        out = {"specular": ("wavelength", 0 * up), "unfinished": ("wavelength", np.zeros(len(p), dtype=int))}
        out["unfinished_share"] = ("wavelength", 0 * up)
        for name, mean in data.items():
            out[name] = ("wavelength", mean)
            out[f"{name}_se"] = ("wavelength", np.sqrt(mean * (1 - mean) / (samples - 1)))
            if tally.binned and name == "reflectance":
                dims = ("wavelength", "theta_o", "radius")
                out["reflectance_binned"] = (dims, out[name][1][:, None, None])
                out["reflectance_binned_se"] = (dims, out[f"{name}_se"][1][:, None, None])
        out["absorbed"] = out["absorbed_se"] = (("wavelength", "layer"), np.zeros((len(p), 1)))
        return xr.Dataset(out, attrs={"compile_seconds": 0.0})


@pytest.fixture
def lab(monkeypatch):
    def make(launch=0.1, sample=1e-6):
        made = Lab(launch, sample)
        monkeypatch.setattr("livlab.model.transport.walk.walk.walk", made.walk)
        return made

    return make


def slow_adding_doubling(monkeypatch, lab, seconds):
    """Adding–doubling that takes so long a wavelength by the lab's clock."""
    real = exact.adding_doubling

    def slow(stack, **given):
        lab.now += seconds * len(stack.wavelength_nm)
        return real(stack, **given)

    monkeypatch.setattr(exact, "adding_doubling", slow)


@pytest.mark.parametrize("wish", [{"relative": 0.01}, {"standard_error": 1e-5}, {"seconds": 5.0}])
def test_an_endless_sphere_is_answered_by_adding_doubling(lab, wish):
    walker = lab()
    found = solve(stack(), SPHERE.readout(np.ones(3)), Accuracy(**wish), clock=walker.clock)
    assert found.solver == "adding-doubling"
    assert found.samples == walker.walked == 0
    assert (found.standard_error == 0).all()
    assert found.valid.all()
    assert float(found.error.max()) < 1e-5
    assert "auto: adding-doubling" in found.notes[0]


def test_a_loose_wish_takes_the_cheapest_rung_that_holds():
    seen = total_reflectance()
    assert solve(half_space(), seen, Accuracy(relative=0.05)).solver == "diffusion"
    assert solve(half_space(), seen, Accuracy(relative=0.02)).solver == "adding-doubling"
    layers = plain_stack([(1.4, 0.01, 5.0, 1.0, Isotropic()), (1.4, 0.01, 8.0, 9.0, Isotropic())])
    loose = solve(layers, seen, Accuracy(relative=0.2))
    assert loose.solver == "kubelka-munk"
    fine = solve(layers, seen, Accuracy(relative=0.001))
    assert abs(float(loose.value[0] - fine.value[0])) <= float(loose.error[0])


def test_two_fluxes_refuse_a_thin_layer_and_say_what_to_use():
    thin = half_space(reduced=10.0)
    thin = dataclasses.replace(thin, layers=(dataclasses.replace(thin.layers[0], thickness_mm=0.1),))
    with pytest.raises(InputError, match=r"reduced depth of 1 .* Use 'adding-doubling'"):
        solve(thin, total_reflectance(), solver="kubelka-munk")
    warned = solve(thin, total_reflectance(), solver="kubelka-munk", outside="warn")
    assert not warned.valid.any()
    assert np.isnan(warned.systematic).all()
    assert warned.text()[0].endswith("?")
    assert any("too thin" in note for note in warned.notes)


def test_diffusion_refuses_where_absorption_meets_scattering():
    with pytest.raises(InputError, match=r"reduced albedo of 0\.5"):
        solve(half_space(absorption=1.0), total_reflectance(), solver="diffusion")
    with pytest.raises(InputError, match="half-space"):
        solve(stack(), total_reflectance(), solver="diffusion", outside="warn")
    assert "deep" in domain("diffusion", half_space(), total_reflectance(0.5)).reasons[0]
    probe = FibreProbe(distance_mm=2.0, numerical_aperture=1.0).readout(np.ones(1))
    assert "not yet diffuse" in domain("diffusion", half_space(), probe).reasons[0]
    far = FibreProbe(distance_mm=6.0, numerical_aperture=1.0).readout(np.ones(1))
    assert domain("diffusion", half_space(), far).valid.all()


def test_a_rung_holds_at_some_wavelengths_and_says_which():
    w, one = np.array([500.0, 700.0]), np.ones(2)
    parts = (
        Interaction("a", np.array([1.0, 0.001]), 0 * one, (Isotropic(),) * 2),
        Interaction("s", one, one, (Isotropic(),) * 2),
    )
    found = solve(
        OpticalStack(w, (PlaneLayer("x", math.inf, one, parts),), one, one), total_reflectance(), solver="diffusion"
    )
    assert found.valid.values.tolist() == [False, True]
    assert np.isnan(found.systematic.values[0])
    assert np.isfinite(found.systematic.values[1])
    assert found.text()[0].endswith("?")
    assert any("at 500 nm" in note for note in found.notes)


def test_adding_doubling_knows_no_distance_and_no_sides():
    for how in ("refuse", "warn"):
        with pytest.raises(InputError, match=r"lateral distance.* Use 'walk expected'"):
            estimate(stack(), FibreProbe(), None, "adding-doubling", outside=how)
    with pytest.raises(InputError, match="nothing is lost sideways"):
        estimate(stack(), Collinear(), None, "adding-doubling")
    assert not estimate(stack(), Collinear(), None, "adding-doubling", outside="warn").valid.any()
    view = SPHERE.readout(np.ones(3))
    assert not domain("adding-doubling", stack(absorb_below_mm=0.01), view).valid.any()
    assert not domain("adding-doubling", stack(redirect="abs_cos"), view).valid.any()
    isotropic = Interaction("s", np.ones(1), np.ones(1), (Isotropic(),), redirect="abs_cos")
    turned = OpticalStack(np.array([500.0]), (PlaneLayer("x", 1.0, np.ones(1), (isotropic,)),), np.ones(1), np.ones(1))
    assert domain("adding-doubling", turned, view).valid.all()


def test_unknown_solvers_are_told_the_known_ones():
    with pytest.raises(InputError, match="kubelka-munk, diffusion"):
        solve(stack(), total_reflectance(), solver="diffsion")
    with pytest.raises(InputError, match="kubelka-munk, diffusion"):
        domain("difusion", stack(), total_reflectance())


def test_a_sample_with_sides_is_walked_until_the_wish_is_met(lab):
    walker = lab()
    for wish in (Accuracy(relative=0.005), Accuracy(standard_error=0.003)):
        found = estimate(stack(), Collinear(acceptance_deg=90.0), wish)
        assert found.solver == "walk expected"
        assert float(found.error.max()) <= wish.target(found.value.to_numpy()) * (1 + 1e-9)
        assert not any("not met" in note for note in found.notes)
        assert "sideways" in found.notes[0]
    assert walker.walked > 0


def test_a_wish_that_cannot_be_met_is_said(lab):
    lab()
    found = estimate(
        stack(), Collinear(), Accuracy(relative=1e-5), sampling=SamplingRule(relative=0.1, max_samples=100_000)
    )
    assert any("was not met" in note for note in found.notes)


@pytest.mark.parametrize("seconds", [2.0, 10.0, 60.0])
@pytest.mark.parametrize(("launch", "sample"), [(0.02, 1e-7), (0.1, 1e-6), (0.3, 5e-6)])
def test_a_wish_for_time_is_kept(lab, launch, sample, seconds):
    """By a clock that the walk moves: between 0.8 and 1.1 of the wish, a first launch of 1 s aside."""
    walker = lab(launch, sample)
    found = solve(
        stack(), Collinear(acceptance_deg=90.0).readout(np.ones(3)), Accuracy(seconds=seconds), clock=walker.clock
    )
    assert found.solver == "walk expected"
    first = launch + sample * 200_000
    assert 0.8 * seconds < walker.now < 1.1 * seconds + first
    assert found.seconds == pytest.approx(walker.now)
    # Time goes where the noise is: no wavelength is left more than twice as uncertain as another, of which √(p(1−p))
    # alone would make 3.5.
    if seconds > 5 * first:
        assert float(found.error.max() / found.error.min()) < 2.0


def test_a_wish_for_time_takes_adding_doubling_if_it_fits(lab, monkeypatch):
    walker = lab()
    slow_adding_doubling(monkeypatch, walker, 0.5)
    view = SPHERE.readout(np.ones(3))
    assert solve(stack(), view, Accuracy(seconds=5.0), clock=walker.clock).solver == "adding-doubling"
    start = walker.now
    found = solve(stack(), view, Accuracy(seconds=1.2), clock=walker.clock)
    assert found.solver == "walk expected"
    assert any("would take about" in note for note in found.notes)
    assert walker.now - start < 1.2 * 1.1 + 0.5


def test_the_faster_of_walk_and_adding_doubling_is_taken(lab, monkeypatch):
    """Ten seconds a wavelength of adding–doubling lose to a quick walk, and win against a slow one."""
    view = SPHERE.readout(np.ones(3))
    quick = lab(0.1, 1e-7)
    slow_adding_doubling(monkeypatch, quick, 10.0)
    picked = pick(stack(), view, Accuracy(relative=0.01), clock=quick.clock)
    assert picked.solver == "walk expected"
    assert picked.walks.launches == 1  # its pilot is not thrown away
    quick.sample = 1e-3
    assert pick(stack(), view, Accuracy(relative=0.0005), clock=quick.clock).solver == "adding-doubling"


def test_the_light_s_whole_account_is_not_asked_of_crude_rungs():
    loose = Accuracy(relative=0.5)
    assert pick(half_space(), total_reflectance(), loose).solver == "diffusion"
    assert pick(half_space(), total_reflectance(), loose, account=True).solver == "adding-doubling"


def test_an_instrument_takes_the_solver_that_meets_the_wish(lab):
    walker = lab()
    seen = measure(stack(), SPHERE, AutoSolver(), accuracy=Accuracy(relative=0.01))
    assert (seen.attrs["rung"], walker.walked) == ("adding-doubling", 0)
    rounds = []
    seen = measure(
        stack(), Collinear(), AutoSolver(), accuracy=Accuracy(relative=0.003), on_round=lambda x, p: rounds.append(x)
    )
    assert seen.attrs["rung"] == "walk expected"
    assert (seen["standard_error"] <= 0.003 * seen["value"].max() * (1 + 1e-9)).all()
    assert "auto: walk expected" in seen.attrs["notes"]
    assert len(seen.attrs["trace_error"]) == seen.attrs["launches"] == len(rounds)
    again = measure(stack(), Collinear(), AutoSolver(), accuracy=Accuracy(relative=0.003), resume=rounds[0])
    np.testing.assert_allclose(again["value"], seen["value"], rtol=1e-12)
    np.testing.assert_allclose(again.attrs["trace_error"], seen.attrs["trace_error"], rtol=1e-9)


@pytest.mark.parametrize("given", [{}, {"relative": 0.1, "seconds": 1.0}, {"relative": 0.0}, {"seconds": -1.0}])
def test_a_wish_is_one_and_positive(given):
    with pytest.raises(ValidationError):
        Accuracy(**given)


def test_a_sampling_has_one_rule():
    with pytest.raises(InputError, match="exactly one rule"):
        SamplingRule()
    with pytest.raises(InputError, match="exactly one rule"):
        SamplingRule(samples=1000, seconds=1.0)


def record(value, error, systematic=0.0, valid=True, wavelengths=(500.0,)):
    def column(x):
        return xr.DataArray([x], coords={"wavelength": [500.0]}, dims="wavelength")

    other = column(error).assign_coords(wavelength=list(wavelengths))
    return Estimate(column(value), other, column(systematic), 1.0, 10, column(valid), "walk expected")


@given(st.floats(1e-9, 1.0), st.floats(1e-12, 0.5), st.floats(0.0, 0.5))
def test_digits_never_exceed_the_error(value, error, systematic):
    """A step of the last digit shown is at least a hundredth of the whole error: two digits of it, no more."""
    made = record(value, error, systematic)
    shown = made.text()[0]
    mantissa, _, exponent = shown.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    total = math.hypot(error, systematic)
    assert 10.0**-decimals > total / 100 * (1 - 1e-9)
    assert abs(float(shown) - value) <= 0.051 * total + 1e-15


def test_an_estimate_holds_together():
    made = record(0.5, 0.01, 0.02)
    assert float(made.error[0]) == pytest.approx(math.hypot(0.01, 0.02))
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.samples = 3
    with pytest.raises(InputError, match="other wavelengths"):
        record(0.5, 0.01, wavelengths=(501.0,))
    with pytest.raises(InputError, match=">= 0"):
        record(0.5, -0.01)
    data = made.dataset()
    assert set(data) == {"value", "standard_error", "systematic", "valid"}
    assert data.attrs["samples"] == 10


def test_rings_of_the_dipole_are_the_integral_of_its_profile():
    """Trapezoids of 2πr R(r) between two radii, to 1e-6."""
    for absorption, n in ((0.001, 1.0), (0.02, 1.4)):
        ends = np.array([0.5, 6.0, math.inf])
        beyond = approximate.dipole_beyond(ends, absorption, 1.0, n)
        r = np.linspace(ends[0], ends[1], 40_001)
        ring = np.trapezoid(2 * np.pi * r * dipole_profile(r, absorption, 1.0, n), r)
        assert beyond[0] - beyond[1] == pytest.approx(float(ring), rel=1e-6)
        assert beyond[2] == 0.0
        assert approximate.dipole_beyond(np.zeros(1), absorption, 1.0, n)[0] == pytest.approx(
            float(dipole_total(absorption, 1.0, n))
        )


def draw(rng, layers):
    out = []
    for k in range(layers):
        g, reduced = rng.choice([0.0, 0.5, 0.8, 0.9]), 10 ** rng.uniform(-0.5, 1)
        absorption = reduced * 10 ** rng.uniform(-4, math.log10(1 / 0.98 - 1))
        thick = math.inf if k == layers - 1 and rng.random() < 0.5 else 10 ** rng.uniform(-1, 1)
        out.append((rng.uniform(1.0, 1.5), absorption, reduced / (1 - g), thick, HenyeyGreenstein(g)))
    return plain_stack(out)


@pytest.mark.parametrize(
    ("solver", "bound", "of"),
    [
        ("kubelka-munk", approximate.KUBELKA_MUNK_BOUND, approximate.kubelka_munk_value),
        ("diffusion", approximate.DIFFUSION_BOUND, approximate.diffusion_value),
    ],
)
def test_what_a_crude_rung_is_off_stays_within_what_it_says(solver, bound, of):
    """60 stacks of one to three layers and three angles against adding–doubling; and outside it does not stay."""
    rng, worst, outside = np.random.default_rng(11), 0.0, 0.0
    inside = 0
    for k in range(60):
        drawn = draw(rng, 1 if solver == "diffusion" else 1 + k % 3)
        view = total_reflectance(float(rng.choice([1.0, 0.97, 0.94] if solver == "diffusion" else [1.0, 0.9, 0.75])))
        truth = exact.adding_doubling(drawn, mu0=math.cos(view.source.angle_rad), tolerance=1e-4)
        off = abs(float(of(drawn, view)[0] / view.of_endless(truth)[0]) - 1) if _possible(solver, drawn, view) else 0.0
        if domain(solver, drawn, view).valid[0]:
            inside, worst = inside + 1, max(worst, off)
        else:
            outside = max(outside, off)
    assert inside >= 20
    assert worst <= bound
    assert worst > 0.3 * bound  # the bound is not idle
    if solver == "kubelka-munk":
        assert outside > bound


def _possible(solver, drawn, view):
    return domain(solver, drawn, view).possible


def test_every_rung_answers_the_same_question(lab):
    """Where all hold (a bright half-space, upright light) they agree within what they say of themselves."""
    scene, seen = half_space(0.002), total_reflectance()
    truth = float(solve(scene, seen, Accuracy(standard_error=1e-7), "adding-doubling").value[0])
    for solver in ("kubelka-munk", "diffusion"):
        found = solve(scene, seen, solver=solver)
        assert found.valid.all()
        assert abs(float(found.value[0]) - truth) <= float(found.error[0])
    assert set(SOLVERS) >= {"kubelka-munk", "diffusion", "adding-doubling", "walk analog", "walk expected"}


def test_the_walks_start_small_against_the_clock(lab):
    """221 wavelengths with the usual pilot would be 14 million samples before anyone looks at the clock."""
    walker = lab(0.1, 1e-6)
    many = stack(tuple(np.linspace(500, 720, 221)))
    walks = Walks(many, Collinear().readout(np.ones(221)), SamplingRule(seconds=3.0), clock=walker.clock)
    walks.go()
    assert 2.4 < walker.now < 3.3


def test_a_camera_at_an_angle_is_answered_too():
    found = estimate(stack(), HyperspectralCamera(), Accuracy(relative=0.001))
    assert found.solver == "adding-doubling"
    assert (found.value > 0).all()
