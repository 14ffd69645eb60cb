"""Instruments, their readouts, and the sampling plan, on a walk replaced by coin tosses of known chance."""

import math

import numpy as np
import pytest
import xarray as xr
from pydantic import TypeAdapter, ValidationError

from livlab.acquire.instruments import spectrometer
from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe, probe_weights
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import AddingDoublingSolver, Solver, WalkSolver
from livlab.acquire.instruments.spectrometer import measure
from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer

ONE = np.ones(1)
CHANCE = {500.0: 0.02, 600.0: 0.1, 700.0: 0.4}
"""Light that leaves the top, by wavelength, in the coin-toss walk; half of it within any cone."""


def stack(wavelengths=(500.0, 600.0, 700.0), n_above=1.0):
    w = np.array(wavelengths)
    one = np.ones(len(w))
    phase = (HenyeyGreenstein(0.5),) * len(w)
    parts = (Interaction("absorber", one, 0 * one, phase), Interaction("scatterer", 9 * one, one, phase))
    layers = (PlaneLayer("slab", 0.2, one, parts),)
    return OpticalStack(w, layers, n_above * one, one)


@pytest.fixture
def coins(monkeypatch):
    """`walk` by coin tosses: what it was asked comes back as a list."""
    asked = []

    def walk(stack, *, source, tally, samples, seed, estimator, half_width_mm, variant):
        asked.append((tuple(stack.wavelength_nm), samples, seed))
        rng = np.random.default_rng(seed)
        p = np.array([CHANCE.get(float(w), 0.0) for w in stack.wavelength_nm])
        up = rng.binomial(samples, p)
        seen = rng.binomial(up, 0.5)

        def pair(count):
            mean = count / samples
            return mean, np.sqrt(mean * (1 - mean) / (samples - 1))

        zero = np.zeros(len(p))
        counts = {"reflectance": up, "transmittance": samples - up}
        counts |= dict.fromkeys(("lost", "redirect_loss", "residual", "specular"), zero)
        data = {}
        for name, count in counts.items():
            data[name], data[f"{name}_se"] = (("wavelength", x) for x in pair(count))
        data["absorbed"] = data["absorbed_se"] = (("wavelength", "layer"), np.zeros((len(p), 1)))
        if tally.binned:
            spread = np.zeros((2, len(p), len(tally.theta) - 1, len(tally.radius) - 1))
            spread[:, :, 0, 0] = pair(seen)
            for end, values in zip(("", "_se"), spread, strict=True):
                data[f"reflectance_binned{end}"] = (("wavelength", "theta_o", "radius"), values)
        data["unfinished"] = ("wavelength", np.zeros(len(p), dtype=np.int64))
        data["unfinished_share"] = ("wavelength", zero)
        return xr.Dataset(data, attrs={"compile_seconds": 0.0})

    monkeypatch.setattr("livlab.model.transport.walk.walk.walk", walk)
    return asked


def solver(**values):
    return WalkSolver(pilot=10_000, **values)


def test_lambertian_reads_its_albedo_at_any_acceptance():
    """A Lambertian sends ρ sin²α of the light into the cone α."""
    for acceptance in (1.0, 30.0, 60.0, 90.0):
        view = Collinear(acceptance_deg=acceptance).readout(ONE)
        flux = 0.37 * math.sin(math.radians(acceptance)) ** 2
        assert flux * view.weights[0, 0] == pytest.approx(0.37)


def test_readout_of_each_instrument():
    thesis = Collinear().readout(ONE)
    assert thesis.half_width_mm == 5.0
    assert thesis.source.square_half_width_mm == 5.0
    assert thesis.specular_weight == 0.0
    pencil = Collinear(beam="pencil", specular="included").readout(ONE)
    assert pencil.source.square_half_width_mm == 0.0
    assert pencil.specular_weight == pytest.approx(4.0)  # 1 / sin² 30°
    assert Collinear(sample_side_mm="infinite").readout(ONE).half_width_mm is None

    sphere = IntegratingSphere(sample_side_mm=30.0).readout(ONE)
    assert (sphere.half_width_mm, sphere.tally.radius_edges, sphere.specular_weight) == (15.0, (0.0, 10.0), 1.0)
    assert IntegratingSphere(specular="excluded").readout(ONE).specular_weight == 0.0
    assert not IntegratingSphere(port_diameter_mm="infinite").readout(ONE).tally.binned

    # The mirror reflection of light from 45° misses the camera; from 8° it enters, unless the polarisers cross.
    assert HyperspectralCamera().readout(ONE).specular_weight == 0.0
    assert HyperspectralCamera(illumination_deg=8.0).readout(ONE).specular_weight > 1.0
    assert HyperspectralCamera(illumination_deg=8.0, polarisation="crossed").readout(ONE).specular_weight == 0.0
    assert HyperspectralCamera(illumination_deg=8.0, acceptance_deg=5.0).readout(ONE).specular_weight == 0.0

    probe = FibreProbe(numerical_aperture=0.5).readout(1.46 * ONE)
    assert probe.tally.theta_edges[1] == pytest.approx(math.asin(0.5 / 1.46))
    assert FibreProbe(numerical_aperture=1.2).readout(ONE).tally.theta_edges == ()
    assert not probe.notes
    assert FibreProbe().readout(np.array([1.45, 1.47])).notes


def test_probe_weights_of_a_small_detector_are_its_share_of_the_ring():
    """A pencil and a detector of radius a at distance d: summed over the bins times 2πr dr gives its area πa²."""
    for source in (0.0, 0.15):
        probe = FibreProbe(distance_mm=1.0, source_radius_mm=source, fibre_radius_mm=0.2)
        edges = np.linspace(1.0 - 0.2 - source, 1.2 + source, 49)
        weights = probe_weights(probe, edges)
        rings = math.pi * np.diff(edges**2)
        assert weights @ rings == pytest.approx(math.pi * 0.2**2, rel=2e-4)
        assert (weights >= 0).all()
        assert weights.max() < 1


def test_probe_weights_by_throwing_darts():
    """500 000 darts a bin: chances of a few percent are known to 1 %; the bins agree within 4.5 errors."""
    rng = np.random.default_rng(9)
    probe = FibreProbe(distance_mm=0.5, source_radius_mm=0.2, fibre_radius_mm=0.3)
    edges = np.linspace(0.0, 1.0, 11)
    n = 500_000
    for k, weight in enumerate(probe_weights(probe, edges)):
        r, phi = rng.uniform(edges[k], edges[k + 1], n), rng.uniform(0, 2 * np.pi, n)
        e, a = 0.2 * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        x, y = r * np.cos(phi) + e * np.cos(a) - 0.5, r * np.sin(phi) + e * np.sin(a)
        hits = np.mean(x * x + y * y < 0.09)
        assert abs(hits - weight) < 4.5 * math.sqrt(max(weight, 1e-6) / n) + 2e-4 * weight


def test_each_wavelength_gets_what_it_needs(coins):
    seen = measure(stack(), Collinear(sample_side_mm="infinite"), solver(relative=0.01))
    assert seen["converged"].all()
    top = float(seen["value"].max())
    errors = seen["standard_error"].to_numpy()
    assert (errors <= 0.01 * top * (1 + 1e-9)).all()
    # Half of the top light is seen at weight 4: value 0.8, error √(0.2·0.8·16/n), so n = 40 000 for 0.008.
    assert seen["samples"].values[2] == pytest.approx(40_000, rel=0.15)
    # The dark one meets its error with the pilot.
    assert seen["samples"].values[0] == 10_000
    assert seen["samples"].values[1] < 25_000
    assert seen.attrs["samples"] == int(seen["samples"].sum())
    assert len({seed for _, _, seed in coins}) == len(coins) == seen.attrs["launches"]


def test_absolute_target_and_fixed_samples(coins):
    seen = measure(stack(), Collinear(sample_side_mm="infinite"), solver(standard_error=0.005))
    assert (seen["standard_error"] <= 0.005).all()
    seen = measure(stack(), Collinear(sample_side_mm="infinite"), solver(samples=123_456))
    assert (seen["samples"] == 123_456).all()


def test_launches_stay_within_their_size(coins):
    measure(stack(), Collinear(), WalkSolver(pilot=1000, samples=100_000, largest_launch=30_000))
    assert max(samples * len(w) for w, samples, _ in coins) <= 30_000


def test_values_and_budget_merge_over_launches(coins):
    seen = measure(stack(), Collinear(sample_side_mm="infinite"), solver(samples=400_000, largest_launch=90_000))
    for name, expected in [("value", [0.04, 0.2, 0.8]), ("reflectance", [0.02, 0.1, 0.4])]:
        error = seen["standard_error" if name == "value" else "reflectance_se"].to_numpy()
        assert (np.abs(seen[name].to_numpy() - expected) < 4 * error).all()
    p = np.array([0.02, 0.1, 0.4])
    assert seen["reflectance_se"].to_numpy() == pytest.approx(np.sqrt(p * (1 - p) / 400_000), rel=0.02)
    assert seen["standard_error"].to_numpy() == pytest.approx(4 * np.sqrt(p / 2 * (1 - p / 2) / 400_000), rel=0.02)


def test_an_interrupted_walk_goes_on_as_if_it_had_not_been(coins, tmp_path):
    instrument, walk = HyperspectralCamera(illumination_deg=8.0), solver(relative=0.005)
    whole = measure(stack(), instrument, walk)

    def stop(partial, progress):
        assert 0 < progress.done <= 1
        if partial.attrs["launches"] == 2:
            partial.to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure(stack(), instrument, walk, on_round=stop)
    part = xr.load_dataset(tmp_path / "part.nc", engine="h5netcdf")
    assert not part["converged"].all()
    assert "not reached" in part.attrs["notes"]
    done = measure(stack(), instrument, walk, resume=part)
    for name in ("samples", "value", "standard_error", "reflectance", "reflectance_se", "absorbed"):
        np.testing.assert_allclose(done[name], whole[name], rtol=1e-9)
    assert done.attrs["launches"] == whole.attrs["launches"]
    before = len(coins)
    xr.testing.assert_allclose(measure(stack(), instrument, walk, resume=done), done, rtol=1e-9)
    assert len(coins) == before


def test_another_measurement_is_not_resumed(coins):
    seen = measure(stack(), Collinear(), solver(samples=10_000))
    for other, instrument, walk in [
        (stack(), Collinear(acceptance_deg=20.0), solver(samples=20_000)),
        (stack(), Collinear(), solver(samples=20_000, seed=2)),
        (stack(), Collinear(), solver(samples=20_000, estimator="analog")),
        (stack((500.0, 600.0)), Collinear(), solver(samples=20_000)),
    ]:
        with pytest.raises(InputError, match="is not this measurement's"):
            measure(other, instrument, walk, resume=seen)


def test_a_sensor_that_sees_nothing_says_so_and_ends(coins):
    seen = measure(stack((400.0, 410.0)), Collinear(), solver(relative=0.01))
    assert not seen["converged"].any()
    assert "not reached at 400, 410 nm" in seen.attrs["notes"]
    assert seen["samples"].values.max() <= 64 * 10_000


def test_a_dark_wavelength_beside_a_bright_one_is_no_trouble(coins):
    seen = measure(stack((400.0, 700.0)), Collinear(), solver(relative=0.01))
    assert seen["converged"].all()
    assert seen["value"].values[0] == 0.0


def test_limits_of_time_and_samples(coins):
    seen = measure(stack(), Collinear(), solver(relative=1e-5, max_samples=50_000))
    assert seen["samples"].values.max() <= 50_000
    assert not seen["converged"].values[2]
    seen = measure(stack(), Collinear(), solver(relative=1e-6, max_seconds=0.05))
    assert not seen["converged"].all()
    assert seen.attrs["seconds"] < 1.0


def test_errors_stay_honest_although_sampling_stops_by_them(coins):
    """200 adaptive measurements, three wavelengths: z has mean 0 ± 0.041 and spread 1 ± 0.029; 4 errors allowed."""
    z = []
    for seed in range(200):
        seen = measure(stack(), Collinear(sample_side_mm="infinite"), WalkSolver(pilot=2000, relative=0.02, seed=seed))
        z.append((seen["value"].to_numpy() - [0.04, 0.2, 0.8]) / seen["standard_error"].to_numpy())
    z = np.array(z)
    assert abs(z.mean()) < 4 / math.sqrt(z.size)
    assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)


def test_adding_doubling_fits_where_nothing_is_lateral():
    with pytest.raises(InputError, match="fibre probe"):
        measure(stack(), FibreProbe(), AddingDoublingSolver())
    endless = measure(stack(), Collinear(sample_side_mm="infinite"), AddingDoublingSolver())
    finite = measure(stack(), Collinear(), AddingDoublingSolver())
    assert endless.attrs["notes"] == ""
    assert "nothing is lost sideways" in finite.attrs["notes"]
    assert (endless["value"] == finite["value"]).all()
    assert "endless: nothing misses it" in measure(stack(), IntegratingSphere(), AddingDoublingSolver()).attrs["notes"]


def test_adding_doubling_readings_hang_together():
    tissue = stack((500.0,), n_above=1.0)
    whole = measure(tissue, Collinear(acceptance_deg=90.0), AddingDoublingSolver())
    total = float(whole["reflectance"][0])
    assert float(whole["value"][0]) == pytest.approx(total, abs=2e-6)
    sphere = IntegratingSphere(port_diameter_mm="infinite", incidence_deg=0.0)
    assert float(measure(tissue, sphere, AddingDoublingSolver())["value"][0]) == pytest.approx(total, abs=2e-6)
    parts = sum(float(whole[n].sum()) for n in ("reflectance", "specular", "transmittance", "absorbed", "residual"))
    assert parts == pytest.approx(1.0, abs=1e-9)
    assert (whole["standard_error"] == 0).all()


def test_specular_is_added_by_its_weight():
    glass = stack((500.0,))
    layers = (PlaneLayer("slab", 0.2, 1.5 * ONE, glass.layers[0].interactions),)
    glass = OpticalStack(glass.wavelength_nm, layers, ONE, ONE)
    without, added = (measure(glass, Collinear(specular=s), AddingDoublingSolver()) for s in ("excluded", "included"))
    assert float(added["value"][0] - without["value"][0]) == pytest.approx(0.04 / 0.25)


@pytest.mark.parametrize(
    "given",
    [
        {"kind": "collinear", "sample_side_mm": float("inf")},
        {"kind": "collinear", "sample_side_mm": 0.0},
        {"kind": "collinear", "acceptance_deg": 0.0},
        {"kind": "collinear", "acceptance_deg": 91.0},
        {"kind": "collinear", "side": 10.0},
        {"kind": "integrating-sphere", "beam_diameter_mm": 21.0},
        {"kind": "integrating-sphere", "sample_side_mm": 10.0},
        {"kind": "fibre-probe", "distance_mm": 0.1},
        {"kind": "hyperspectral-camera", "illumination_deg": 90.0},
        {"kind": "camera"},
        {},
    ],
)
def test_bad_instruments_are_refused(given):
    with pytest.raises(ValidationError):
        TypeAdapter(Instrument).validate_python(given)


@pytest.mark.parametrize(
    "given",
    [
        {"kind": "walk", "samples": 10_000, "relative": 0.01},
        {"kind": "walk", "samples": 10},
        {"kind": "walk", "relative": 0.0},
        {"kind": "walk", "seed": -1},
        {"kind": "walk", "max_seconds": 0.0},
        {"kind": "adding-doubling", "samples": 1000},
        {"kind": "diffusion"},
    ],
)
def test_bad_solvers_are_refused(given):
    with pytest.raises(ValidationError):
        TypeAdapter(Solver).validate_python(given)


def test_the_default_target_is_written_out():
    assert TypeAdapter(Solver).validate_python({"kind": "walk"}).relative == 0.002
    fixed = TypeAdapter(Solver).validate_python({"kind": "walk", "samples": 5000})
    assert fixed.relative is None
    assert TypeAdapter(Solver).validate_python(fixed.model_dump(exclude_none=True)) == fixed


def test_the_budget_names_every_end():
    assert set(spectrometer.BUDGET) | {"specular"} == {
        "reflectance", "specular", "transmittance", "absorbed", "lost", "redirect_loss", "residual",
    }  # fmt: skip
