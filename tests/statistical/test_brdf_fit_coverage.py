"""Do a fit's intervals cover the truth as often as they say, and would the test notice if they did not?"""

import numpy as np
from scipy import stats

from livlab.brdf.angles import from_half_angles
from livlab.brdf.fit.fit import fit
from livlab.brdf.models.model import model
from livlab.brdf.samples import sample_dataset

TRUTH = {"kd": 0.3, "ks": 0.9, "alpha": 0.2}
LEVEL = 0.6827


def clean(lights, each, seed):
    rng = np.random.default_rng(seed)
    theta_h = rng.uniform(0, 0.9, lights * each)
    wi, wo = from_half_angles(theta_h, rng.uniform(0, 1.1, theta_h.size), rng.uniform(-np.pi, np.pi, theta_h.size))
    good = (wi[:, 2] > 0.2) & (wo[:, 2] > 0.2)
    light = np.repeat(np.arange(lights), each)[good]
    wi, wo = wi[good], wo[good]
    samples = sample_dataset(wi, wo, model("lambert+ggx").evaluate(wi, wo, TRUTH))
    return samples.assign_coords(light=("sample", light)), wi[:, 2]


def power(draws, level, factor, alpha=0.003):
    """Chance that a binomial test refuses intervals that are `factor` times too wide."""
    z = stats.norm.ppf(0.5 + level / 2)
    true = 2 * stats.norm.cdf(factor * z) - 1
    counts = np.arange(draws + 1)
    refused = np.array([stats.binomtest(int(c), draws, level).pvalue <= alpha for c in counts])
    return stats.binom.pmf(counts, draws, true)[refused].sum()


def test_intervals_cover_with_independent_noise():
    samples, cos = clean(3, 300, 2)
    exact, draws = samples["value"].values.copy(), 120
    hits = {"bootstrap": 0, "sandwich": 0}
    rng = np.random.default_rng(9)
    for k in range(draws):
        samples["value"] = samples["value"].copy(data=exact + 4e-3 * rng.standard_normal(exact.shape) / cos[:, None])
        found = fit(
            samples, "lambert+ggx", starts=1, start=TRUTH, bootstrap="samples", replicates=120, seed=k, warn=False
        )
        row = found.table.loc["alpha"]
        hits["bootstrap"] += row["lower"] <= TRUTH["alpha"] <= row["upper"]
        hits["sandwich"] += abs(row["value"] - TRUTH["alpha"]) <= row["sd"]
    for count in hits.values():
        assert stats.binomtest(count, draws, LEVEL).pvalue > 0.003
    assert power(draws, LEVEL, 0.6) > 0.9
    assert power(draws, LEVEL, 1.8) > 0.9


def test_drawing_lights_covers_when_lights_are_off():
    """Each light's intensity is wrong by 5 %: whole lights are what is independent, samples are not."""
    samples, cos = clean(16, 120, 3)
    exact, light = samples["value"].values.copy(), samples["light"].values
    rng = np.random.default_rng(4)
    draws, hits, naive = 80, 0, 0
    for k in range(draws):
        level = 1 + 0.05 * rng.standard_normal(16)[light][:, None]
        samples["value"] = samples["value"].copy(
            data=exact * level + 2e-3 * rng.standard_normal(exact.shape) / cos[:, None]
        )
        found = fit(
            samples, "lambert+ggx", starts=1, start=TRUTH, bootstrap="lights", replicates=120, seed=k, warn=False
        )
        row = found.table.loc["kd"]
        hits += row["lower"] <= TRUTH["kd"] <= row["upper"]
        naive += abs(row["value"] - TRUTH["kd"]) <= row["sd_independent"]
    assert stats.binomtest(hits, draws, LEVEL).pvalue > 0.003
    assert stats.binomtest(naive, draws, LEVEL).pvalue < 1e-6
