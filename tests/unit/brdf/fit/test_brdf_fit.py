import json
import math

import numpy as np
import pytest
from brdf_fit_rig import lights, pictures

from livlab.brdf.angles import direction, from_half_angles
from livlab.brdf.fit.fit import compare, fit, pack
from livlab.brdf.fit.problem import BrdfProblem, Choices, Layout
from livlab.brdf.models.model import model
from livlab.brdf.samples import sample_dataset
from livlab.brdf.sphere import by_light, extract
from livlab.errors import InputError, Interrupted
from livlab.optimise import FitWarning, bootstrap

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")

TRUTH = {
    "lambert": {"kd": 0.4},
    "oren-nayar": {"kd": 0.7, "sigma": 0.35},
    "oren-nayar-qualitative": {"kd": 0.7, "sigma": 0.35},
    "lambert+blinn-phong": {"kd": 0.3, "ks": 0.2, "exponent": 40.0},
    "lambert+blinn-phong-classic": {"kd": 0.3, "ks": 0.2, "exponent": 40.0},
    "ashikhmin-shirley-coupled": {"kd": 0.3, "Rs": 0.06, "exponent": 80.0},
    "nunes-2017": {"kd": 0.3, "Rs": 0.06, "exponent": 80.0},
    "lambert+ggx": {"kd": 0.3, "ks": 0.9, "alpha": 0.17},
    "lambert+ggx-schlick": {"kd": 0.3, "F0": 0.06, "alpha": 0.17},
    "ggx-mirror": {"ks": 0.9, "alpha": 0.4},
    "ggx-correlated": {"ks": 0.9, "alpha": 0.4},
    "lambert+beckmann": {"kd": 0.3, "ks": 0.9, "alpha": 0.17},
    "lambert+lafortune": {"kd": 0.3, "ks": 0.2, "exponent": 25.0, "ratio": 0.85},
    "lambert+ggx+ggx": {"kd": 0.2, "ks": 1.5, "alpha": 0.08, "ks2": 2.5, "alpha2": 0.4},
    "principled": {"kd": 0.3, "ks": 0.9, "alpha": 0.17},
    "plastic": {"kd": 0.3, "ks": 0.9, "alpha": 0.17},
}


def directions(count=3000, seed=0, most_d=1.2):
    rng = np.random.default_rng(seed)
    theta_h = np.where(rng.random(count) < 0.5, rng.uniform(0, 1.2, count), 0.3 * rng.random(count))
    wi, wo = from_half_angles(theta_h, most_d * rng.random(count), rng.uniform(-np.pi, np.pi, count))
    good = (wi[:, 2] > 0.17) & (wo[:, 2] > 0.17)
    return wi[good], wo[good]


def made(name, values, *, noise=0.0, seed=0, most_d=1.2, **more):
    wi, wo = directions(seed=seed, most_d=most_d)
    f = model(name).evaluate(wi, wo, values)
    rng = np.random.default_rng(seed + 1)
    return sample_dataset(
        wi, wo, f + noise * rng.standard_normal(f.shape) / wi[:, 2].reshape(-1, *[1] * (f.ndim - 1)), **more
    )


@pytest.mark.parametrize("name", TRUTH)
def test_a_model_recovers_itself(name):
    found = fit(made(name, TRUTH[name]), name)
    got = {k: v for k, v in found.values.items() if k in TRUTH[name]}
    if name == "lambert+ggx+ggx" and got["alpha"] > got["alpha2"]:
        got = {**got, "ks": got["ks2"], "ks2": got["ks"], "alpha": got["alpha2"], "alpha2": got["alpha"]}
    assert got == pytest.approx(TRUTH[name], rel=2e-4)
    assert found.relative_rmse < 1e-5
    assert found.search.converged


@pytest.mark.parametrize("loss", ["cosine-weighted-l2", "log", "cube-root"])
def test_every_loss_finds_the_truth_and_says_what_it_is(loss):
    found = fit(made("lambert+ggx", TRUTH["lambert+ggx"]), "lambert+ggx", loss=loss)
    assert found.values["alpha"] == pytest.approx(0.17, rel=1e-4)
    assert found.loss.startswith(f"{loss}: squares of")
    assert ("eps" in found.loss) == (loss == "log")


def test_the_loss_moves_a_roughness_where_the_model_is_not_the_truth():
    samples = made("lambert+beckmann", {"kd": 0.05, "ks": 1.0, "alpha": 0.2})
    found = {
        loss: fit(samples, "lambert+ggx", loss=loss).values["alpha"]
        for loss in ("cosine-weighted-l2", "log", "cube-root")
    }
    assert max(found.values()) / min(found.values()) > 1.1


def test_chi2_weighs_by_the_standard_errors():
    wi, wo = directions()
    f = model("lambert").evaluate(wi, wo, {"kd": 0.5})
    error = np.where(np.arange(len(f)) % 2, 1e-4, 1.0)
    wrong = np.where(np.arange(len(f)) % 2, f, 2 * f)
    found = fit(sample_dataset(wi, wo, wrong, standard_error=error), "lambert", loss="chi2")
    assert found.values["kd"] == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(InputError, match="needs a standard error"):
        fit(sample_dataset(wi, wo, f), "lambert", loss="chi2")


def test_channels_share_the_shape_or_what_they_are_told():
    values = {"kd": [0.1, 0.2, 0.3], "ks": [0.5, 0.7, 0.9], "alpha": 0.17}
    samples = made("lambert+ggx", values, channels=["R", "G", "B"])
    found = fit(samples, "lambert+ggx")
    expected = {"kd[R]": 0.1, "kd[G]": 0.2, "kd[B]": 0.3, "ks[R]": 0.5, "ks[G]": 0.7, "ks[B]": 0.9, "alpha": 0.17}
    assert {k: found.values[k] for k in expected} == pytest.approx(expected, rel=1e-4)
    assert found.parameters()["kd"].values == pytest.approx([0.1, 0.2, 0.3], rel=1e-4)
    assert found.table.loc["kd[G]", "channel"] == "G"
    alone = fit(samples, "lambert+ggx", shared="none")
    assert {"alpha[R]", "alpha[G]", "alpha[B]"} <= set(alone.values)
    assert alone.values["alpha[B]"] == pytest.approx(0.17, rel=1e-3)
    lit = fit(samples, "lambert+ggx", shared={"alpha", "eta", "ks"})
    assert {"ks", "kd[R]", "alpha"} <= set(lit.values)
    one = fit(samples, "lambert+ggx", shared="all")
    assert set(one.values) == {"kd", "ks", "alpha", "eta"}


def test_fixed_free_bounds_and_starts_are_obeyed():
    samples = made("lambert+ggx", {"kd": 0.3, "ks": 0.9, "alpha": 0.17, "eta": 1.7})
    found = fit(samples, "lambert+ggx", free=["eta"], fixed={"ks": 0.9}, start={"alpha": 0.3})
    assert found.values["eta"] == pytest.approx(1.7, rel=1e-4)
    assert found.table.loc["ks", "status"] == "fixed"
    with pytest.warns(FitWarning, match="sits at lower bound"):
        bound = fit(samples, "lambert+ggx", bounds={"alpha": (0.2, 0.9)})
    assert bound.table.loc["alpha", "status"] == "at lower bound"
    assert "alpha = 0.2 sits at lower bound" in bound.summary()
    metal = fit(samples, "ggx-conductor", fixed={"eta": [0.2], "k": 3.9})
    assert metal.values["k"] == 3.9
    for wrong in (
        {"fixed": {"x": 1}},
        {"free": ["x"]},
        {"bounds": {"x": (0, 1)}},
        {"start": {"x": 1}},
        {"shared": {"x"}},
    ):
        with pytest.raises(InputError, match="no such parameter"):
            fit(samples, "lambert+ggx", **wrong)


def test_reflectance_and_scale_are_not_both_printed_where_only_their_product_is_measured():
    values = {"kd": 0.1, "ks": 0.8, "alpha": 0.2, "F0": 0.05}
    narrow = made("lambert+ggx-schlick", values, most_d=math.radians(12), noise=1e-4)
    options = {"fixed": {}, "free": ["ks"], "bounds": {"ks": (0.01, 5.0)}}
    found = fit(narrow, "lambert+ggx-schlick", **options)
    assert found.identifiability.verdict == "not held"
    assert set(found.identifiability.combination) == {"ks", "F0"}
    assert not found.table.loc["ks", "held"]
    assert not found
    text = found.summary()
    line = next(x for x in text.splitlines() if x.startswith("ks "))
    assert "not held by itself" in line
    assert not any(c.isdigit() for c in line.replace("ks", ""))
    assert "theta_d spans only" in text
    name, value = found.combinations[0].split(" = ")
    assert "ks" in name
    assert "F0" in name
    assert float(value.split()[0]) == pytest.approx(0.04, rel=0.02)
    wide = fit(made("lambert+ggx-schlick", values, noise=1e-4), "lambert+ggx-schlick", **options)
    assert wide.identifiability.verdict != "not held"
    assert wide.values["F0"] == pytest.approx(0.05, rel=0.05)


def test_sd_and_interval_are_of_the_same_blocks_and_say_so():
    rng = np.random.default_rng(5)
    samples = made("lambert+ggx", TRUTH["lambert+ggx"], noise=5e-3)
    light = rng.integers(0, 8, samples.sizes["sample"])
    samples["value"] = samples["value"] * (1 + 0.05 * rng.standard_normal(8))[light][:, None]
    samples = samples.assign_coords(light=("sample", light))
    expected = {"lights": "whole lights (8)", "tiles": "cells of 4 x 4 deg", "samples": "single samples"}
    kd = {}
    for drawn, words in expected.items():
        found = fit(samples, "lambert+ggx", bootstrap=drawn, widening=False)
        assert found.resampled.startswith(words)
        kd[drawn] = row = found.table.loc["kd"]
        assert (row["upper"] - row["lower"]) / 2 == pytest.approx(row["sd"], rel=0.25)
        assert found.uncertainty in found.summary()
        assert f"not in them: {found.left_out}" in found._repr_html_()
        assert json.loads(found.to_json())["not_in_sd_and_intervals"] == found.left_out
    assert kd["lights"]["sd"] > 3 * kd["samples"]["sd"]
    assert fit(samples, "lambert+ggx").table.loc["kd", "sd"] == kd["lights"]["sd"]
    plain = fit(samples, "lambert+ggx", bootstrap=None)
    assert plain.table.loc["kd", "sd"] == kd["lights"]["sd"]
    # Student's t of seven degrees of freedom: 1.077 for one sd.
    width = plain.table.loc["kd", "upper"] - plain.table.loc["kd", "lower"]
    assert width / 2 == pytest.approx(1.077 * kd["lights"]["sd"], rel=1e-3)
    few = samples.isel(sample=light < 5)
    assert fit(few, "lambert+ggx").resampled.startswith("cells of 4 x 4 deg")
    assert "a whole light shares" in fit(few, "lambert+ggx").left_out


def test_two_equal_lobes_are_told():
    found = fit(made("lambert+ggx", TRUTH["lambert+ggx"], noise=1e-3), "lambert+ggx+ggx")
    told = found.identifiability.verdict != "held" or any("bound" in s for s in found.warnings)
    assert told


def test_comparing_ranks_the_truth_first():
    table, results = compare(
        made("lambert+ggx", TRUTH["lambert+ggx"], noise=2e-3),
        ["lambert", "lambert+blinn-phong", "lambert+beckmann", "lambert+ggx", "lambert+ggx+ggx"],
    )
    assert table.index[0] == "lambert+ggx"
    assert table["delta_bic"].iloc[0] == 0
    assert table.loc["lambert", "delta_bic"] > 100
    assert set(results) == set(table.index)
    assert table.loc["lambert+ggx+ggx", "aic"] < table.loc["lambert+beckmann", "aic"]


def test_the_result_as_text_table_and_json():
    found = fit(made("lambert+ggx", TRUTH["lambert+ggx"], noise=1e-3), "lambert+ggx", replicates=50)
    data = json.loads(found.to_json())
    assert data["model"] == "lambert+ggx"
    assert {p["parameter"] for p in data["parameters"]} == {"kd", "ks", "alpha", "eta"}
    assert data["parameters"][-1]["sd"] is None  # fixed
    text = found.summary()
    for word in ("cosine-weighted-l2", "AIC", "theta_d", "alpha", "sd and 68.27 % intervals", "not in them"):
        assert word in text
    row = found.to_frame().loc["alpha"]
    assert row["lower"] < row["value"] < row["upper"]
    up = direction(0.3, 0.0)
    expected = model("lambert+ggx").evaluate(up, up, {k: found.values[k] for k in ("kd", "ks", "alpha", "eta")})
    assert float(found.evaluate(up, up)[0]) == pytest.approx(float(expected))
    samples = made("lambert+ggx", TRUTH["lambert+ggx"])
    assert found.predict(samples).dims == ("sample", "channel")


def test_derivatives_are_those_of_the_loss():
    samples = made("plastic", TRUTH["plastic"], noise=1e-2)
    data = pack(samples)
    for name in ("lambert+ggx", "oren-nayar", "nunes-2017", "lambert+lafortune"):
        layout = Layout(model(name), data.channels, Choices())
        values = layout.space.values(layout.space.start)
        for loss in ("cosine-weighted-l2", "log", "cube-root"):
            problem = BrdfProblem(layout, data, loss)
            slope = problem.gradient(values)
            for key, found in slope.items():
                step = 1e-5 * max(abs(values[key]), 0.1)
                ends = [problem.value({**values, key: values[key] + s * step}) for s in (-1, 1)]
                assert found == pytest.approx(
                    (ends[1] - ends[0]) / (2 * step), rel=2e-4, abs=1e-7 * problem.value(values)
                )


def test_the_linear_bootstrap_is_the_refitted_one():
    rng = np.random.default_rng(5)
    samples = made("lambert+ggx", TRUTH["lambert+ggx"], noise=5e-3)
    light = rng.integers(0, 12, samples.sizes["sample"])
    level = 1 + 0.02 * rng.standard_normal(12)
    samples["value"] = samples["value"] * level[light][:, None]
    samples = samples.assign_coords(light=("sample", light))
    found = fit(samples, "lambert+ggx", replicates=400, bootstrap="lights", widening=False)
    data = pack(samples)
    layout = found.layout

    def refit(weights):
        from livlab.optimise import minimise

        problem = BrdfProblem(layout, data, "cosine-weighted-l2", weights)
        space = problem.scaled_space(found.values)
        return minimise(problem.value, space, gradient=problem.gradient, warn=False).best

    slow = bootstrap(refit, data.light, replicates=60, seed=3).sd
    for name in ("kd", "ks", "alpha"):
        fast = (found.table.loc[name, "upper"] - found.table.loc[name, "lower"]) / 2
        assert fast == pytest.approx(slow[name], rel=0.35)
    # Lights that differ by 2 % are no independent samples.
    assert found.table.loc["kd", "upper"] - found.table.loc["kd", "lower"] > 4 * found.table.loc["kd", "sd_independent"]


@pytest.fixture(scope="module")
def narrow():
    images, eye, lamps, sphere = pictures("lambert+ggx", {"kd": 0.2, "ks": 1.0, "alpha": 0.06}, lights(4))
    return extract(images, eye, lamps, sphere), (images, eye, lamps, sphere)


def test_pixels_are_integrated(narrow):
    samples, _ = narrow
    found = {f: fit(samples, "lambert+ggx", footprint=f, starts=1).values for f in ("auto", 8, None)}
    assert found["auto"]["alpha"] == pytest.approx(0.06, rel=1e-3)
    assert found["auto"]["ks"] == pytest.approx(1.0, rel=2e-3)
    assert found["auto"]["kd"] == pytest.approx(0.2, rel=1e-4)
    assert found[8]["alpha"] == pytest.approx(0.06, rel=1e-3)
    # Two pixels and a half to the roughness: centres read it too wide.
    assert found[None]["alpha"] > 1.015 * 0.06
    assert any("not integrated" in s for s in fit(samples, "lambert+ggx", footprint=None, starts=1).warnings)


def test_squares_lose_nothing(narrow):
    samples, _ = narrow
    whole, auto = pack(samples, 8), pack(samples)
    assert auto.pixels.sum() == whole.size == samples.sizes["sample"]
    assert auto.size < 0.7 * whole.size
    # The predicted mean over each square is that of its pixels, for a lobe as narrow as this.
    values = {"kd": 0.2, "ks": 1.0, "alpha": 0.06, "eta": 1.5}
    one = model("lambert+ggx")
    merged = auto.averaged(one.at(auto.at, values))
    single = whole.averaged(one.at(whole.at, values))
    total = np.sum(merged * auto.pixels * auto.cos_i)
    assert total == pytest.approx(np.sum(single * whole.cos_i), rel=2e-4)
    error = np.abs(merged - auto.value[:, 0]) / auto.value[:, 0]
    assert np.quantile(error, 0.99) < 1e-3


def test_light_by_light_is_the_same_fit(narrow):
    samples, rig = narrow
    one, other = fit(samples, "lambert+ggx", starts=1), fit(by_light(*rig), "lambert+ggx", starts=1)
    assert other.values == pytest.approx(one.values, rel=1e-9)
    assert other.pixels == one.pixels


def test_distant_lights_and_colours_over_pixels():
    values = {"kd": np.array([0.1, 0.2, 0.3]), "ks": 1.0, "alpha": 0.2}
    images, eye, lamps, sphere = pictures("lambert+ggx", values, lights(3, 3, near=False), radius_px=25, inside=6)
    found = fit(extract(images, eye, lamps, sphere), "lambert+ggx")
    assert [found.values[f"kd[{c}]"] for c in range(3)] == pytest.approx([0.1, 0.2, 0.3], rel=2e-4)
    assert found.values["alpha"] == pytest.approx(0.2, rel=1e-3)


def test_what_cannot_be_fitted_is_refused(narrow):
    samples, _ = narrow
    with pytest.raises(InputError, match="is no lobe"):
        fit(samples, "gxx")
    with pytest.raises(InputError, match="loss"):
        fit(samples, "lambert", loss="l3")
    with pytest.raises(InputError, match="footprint"):
        fit(samples, "lambert", footprint=0)
    with pytest.raises(InputError, match="shared"):
        fit(samples, "lambert", shared="some")
    with pytest.raises(InputError, match="too few"):
        fit(samples.isel(sample=slice(0, 3)), "lambert+ggx+ggx")
    with pytest.raises(InputError, match="no finite sample"):
        fit(samples.assign(value=samples["value"] * np.nan), "lambert")
    with pytest.raises(InputError, match="at least two lights"):
        fit(samples.isel(sample=samples["light"].values == 0), "lambert", bootstrap="lights")
    holes = samples.copy()
    holes["value"] = holes["value"].where(np.arange(holes.sizes["sample"])[:, None] % 7 > 0)
    found = fit(holes, "lambert+ggx", starts=1)
    assert any("left out" in s for s in found.warnings)
    assert found.values["kd"] == pytest.approx(0.2, rel=1e-3)


def test_ctrl_c_stops_all_of_it(monkeypatch):
    calls = []
    original = BrdfProblem.value

    def counted(self, values):
        calls.append(1)
        if len(calls) == 40:
            raise KeyboardInterrupt
        return original(self, values)

    monkeypatch.setattr(BrdfProblem, "value", counted)
    with pytest.raises(Interrupted):
        fit(made("lambert+ggx", TRUTH["lambert+ggx"]), "lambert+ggx")
    assert len(calls) == 40


def test_a_time_limit_gives_a_result_that_says_so():
    found = fit(made("lambert+ggx", TRUTH["lambert+ggx"]), "lambert+ggx", max_seconds=1e-6)
    assert not found
    assert any("did not converge" in s for s in found.warnings)


def test_a_light_wider_than_the_lobe_is_told():
    images, eye, lamps, sphere = pictures("lambert+ggx", {"kd": 0.2, "alpha": 0.05}, lights(1), radius_px=20, inside=3)
    pixels = extract(images, eye, lamps, sphere)
    pixels["source_solid_angle"] = ("sample", np.full(pixels.sizes["sample"], np.pi * 0.03**2))
    assert any("angular radius of 1.7 deg" in s for s in fit(pixels, "lambert+ggx").warnings)
    assert not any("angular radius" in s for s in fit(pixels, "lambert").warnings)
