"""What a fit says of its misfit: where noise is from, intervals at bounds and where a model misses, words, tables."""

import json

import numpy as np
import pytest
from brdf_fit_rig import lights, pictures
from brdf_misfit_cases import clean, noisy, of, sphere
from scipy import stats

from livlab.brdf.fit.data import pack
from livlab.brdf.fit.fit import compare, fit
from livlab.brdf.fit.judge import groupings
from livlab.brdf.fit.noise import of_neighbours, variance_curve
from livlab.brdf.fit.result import adequate_in_words
from livlab.brdf.sphere import extract

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")

TRUTH = {"kd": 0.3, "ks": 0.9, "alpha": 0.25}
OTHER = {"kd": 0.5, "ks": 1.0, "alpha": 0.2}


@pytest.fixture(scope="module")
def ball():
    """Pictures with read and photon noise of which nothing is said."""
    images, *rig = pictures("lambert+ggx", TRUTH, lights(4), radius_px=36, inside=5)
    sd = 0.004 * np.sqrt(0.3 + np.maximum(images, 0))
    return images + sd * np.random.default_rng(1).standard_normal(images.shape), rig, sd


def test_noise_is_read_from_neighbouring_pixels(ball):
    images, rig, sd = ball
    samples = extract(images, *rig)
    data = pack(samples)
    assert data.noise_from == "estimated from neighbouring pixels"
    assert np.isnan(data.error).all()
    single = pack(samples, None)
    at = [samples[n].values for n in ("light", "row", "column")]
    true = sd.values[at[0], at[1], at[2], 0] / (images.values[at[0], at[1], at[2], 0] / samples["value"].values[:, 0])
    # Within a tenth for 95 of 100 pixels; at a lobe's peak, where few pixels are so bright, up to half.
    off = np.abs(single.noise[:, 0] / true - 1)
    assert np.quantile(off, 0.95) < 0.1 and off.max() < 0.5
    found = fit(data, "lambert+ggx")
    assert found.misfit.adequate and found
    assert found.misfit.ratio == pytest.approx(1.0, abs=0.03)
    assert found.noise_floor == pytest.approx(found.relative_rmse, rel=0.05)
    wrong = fit(data, "lambert+beckmann")
    assert wrong.misfit.told and not wrong
    # Every other row and column, as a thinned extraction leaves them.
    thin = samples.isel(sample=np.flatnonzero((at[1] % 2 == 0) & (at[2] % 2 == 0)))
    assert pack(thin, None).noise_from == "estimated from neighbouring pixels"
    # By chance: no neighbours.
    few = samples.isel(sample=np.sort(np.random.default_rng(2).choice(len(at[0]), 300, replace=False)))
    assert pack(few, None).noise_from.startswith("samples without")


def test_a_variance_is_a_curve_of_brightness():
    rng = np.random.default_rng(3)
    level = rng.uniform(0, 2, 40_000)
    square = (0.01 + 0.02 * level) * rng.chisquare(1, level.size)
    assert variance_curve(level, square)[:2] == pytest.approx([0.01, 0.02], rel=0.15)
    assert of_neighbours(np.zeros(4, int), np.arange(4), np.ones((4, 1))) is None


def test_samples_that_say_nothing_of_noise_are_judged_by_their_pattern():
    rng = np.random.default_rng(4)
    s = sphere(8, 60, rng)
    value = of("lambert+ggx", **TRUTH)(s)
    right = clean(s, value + 0.004 * rng.standard_normal(value.shape) / s.wi[:, 2])
    found = fit(right, "lambert+ggx")
    assert found and found.misfit.adequate and "cannot be told" in found.misfit.words and np.isnan(found.misfit.ratio)
    assert found.to_dict()["misfit"]["residual_over_noise"] is None
    wrong = clean(s, of("plastic", **OTHER)(s) + 0.004 * rng.standard_normal(value.shape) / s.wi[:, 2])
    found = fit(wrong, "lambert+ggx")
    assert found.misfit.told and not found and "residuals are not random" in found.misfit.words
    exact = fit(clean(s, value), "lambert+ggx")
    assert exact and exact.misfit.adequate


def test_repeated_directions_show_their_noise():
    rng = np.random.default_rng(5)
    s = sphere(4, 40, rng)
    s = type(s)(*(np.repeat(a, 3, axis=0) for a in s))
    value = of("lambert+ggx", **TRUTH)(s)
    found = fit(clean(s, value + 0.004 * rng.standard_normal(value.shape) / s.wi[:, 2]), "lambert+ggx")
    assert found.misfit.noise == "estimated from repeated directions"
    assert found.misfit.adequate and found.misfit.ratio == pytest.approx(1.0, abs=0.15)


def test_at_a_bound_the_interval_is_told():
    """No lobe at all: half of the fits end at ks = 0; their interval ends as a normal cut off there does."""
    rng = np.random.default_rng(6)
    s = sphere(10, 60, rng)
    value = of("lambert", kd=0.5)(s)
    rows = np.stack([of("lambert", kd=1.0)(s), of("ggx", ks=1.0, alpha=0.2)(s)]) * s.wi[:, 2] / 0.004
    moments = np.linalg.inv(rows @ rows.T)
    sd, ratios, skewed = np.sqrt(moments[1, 1]), [], []
    for k in range(12):
        samples = noisy(s, value, 0.004, rng)
        options = {"fixed": {"alpha": 0.2}, "starts": 1, "level": 0.95, "bootstrap": "samples"}
        found = fit(samples, "lambert+ggx", **options, seed=k)
        row, kd = found.table.loc["ks"], found.table.loc["kd"]
        assert 0 <= row["lower"] < row["upper"]
        if row["status"] == "at lower bound":
            without = (moments @ rows @ (samples["value"].values[:, 0] * s.wi[:, 2] / 0.004))[1]
            ratios.append(row["upper"] / stats.truncnorm.ppf(0.95, -without / sd, np.inf, without, sd))
            assert f"[0, {row['upper']:.5g}]" in repr(found)
            assert f"{row['upper']:.6g}" in found._repr_html_() and f"0 to {row['upper']:.6g}" in found.summary()
            skewed.append((kd["value"] - kd["lower"]) / (kd["upper"] - kd["value"]))
    assert len(ratios) >= 4
    # kd goes down where ks goes up.
    assert np.mean(skewed) > 1.1
    assert np.all(np.abs(np.array(ratios) - 1) < 0.25), ratios


def test_a_widened_interval_holds_what_refits_without_parts_of_the_data_scatter():
    rng = np.random.default_rng(7)
    s = sphere(8, 80, rng)
    value = of("plastic", **OTHER)(s)
    data = pack(noisy(s, value, 0.003, rng))
    found = fit(data, "lambert+ggx")
    assert "widened up to" in found.uncertainty
    largest = dict.fromkeys(("kd", "ks", "alpha"), 0.0)
    start = {n: found.values[n] for n in largest}
    for g in groupings(data):
        kept = [np.flatnonzero(g.index != k) for k in np.unique(g.index)]
        refits = [fit(data.select(i), "lambert+ggx", starts=1, start=start, bootstrap=None).values for i in kept]
        for n in largest:
            x = np.array([r[n] for r in refits])
            largest[n] = max(largest[n], float(np.sqrt((len(x) - 1) * np.mean((x - x.mean()) ** 2))))
    for n, sd in largest.items():
        row = found.table.loc[n]
        assert 0.5 < row["sd"] / sd < 2.0
        assert row["widened"] >= 1
    plain = fit(data, "lambert+ggx", widening=False)
    assert plain.misfit.told and plain.widened == 1
    assert plain.table.loc["kd", "sd"] * found.table.loc["kd", "widened"] == pytest.approx(found.table.loc["kd", "sd"])


def test_compare_says_which_models_are_adequate():
    rng = np.random.default_rng(8)
    s = sphere(8, 60, rng)
    table, found = compare(
        noisy(s, of("plastic", **OTHER)(s), 0.004, rng), ["lambert", "plastic", "lambert+ggx"], warn=False
    )
    assert table.index[0] == "plastic"
    assert table["adequate"].to_dict() == {"plastic": True, "lambert": False, "lambert+ggx": False}
    assert table.loc["plastic", "over_noise"] == pytest.approx(1.0, abs=0.15)
    assert table.attrs["noise_floor"] == pytest.approx(found["plastic"].relative_rmse, rel=0.15)
    lines = adequate_in_words(found)
    assert lines[0].startswith("noise floor: ") and lines[1] == "adequate: plastic"
    assert any(line.startswith("lambert+ggx: the model misses the data by") for line in lines)
    poor = adequate_in_words({"lambert": found["lambert"]})
    assert poor[1] == "adequate: none of these models describes the data to the noise"
    record = json.loads(found["lambert"].to_json())
    assert record["misfit"]["adequate"] is False and record["intervals_widened"] >= 1
    assert "misses the data" in found["lambert"]._repr_html_() and "misses the data" in repr(found["lambert"])
