"""Is a model that fits called one in a thousand times wrong, and is one that misses its data told?

Small fits by plain linear algebra and by scipy: thousands of them take seconds.
"""

import itertools

import numpy as np
import pytest
from scipy import optimize, stats

from livlab.errors import InputError
from livlab.optimise.misfit import LIMIT, misfit
from livlab.optimise.noise import effective_number, noise_of_neighbours, noise_of_repeats
from livlab.optimise.structure import Grouping, runs_p

NM = np.linspace(470, 690, 23)
BANDS = Grouping.bins("wavelength", NM, [460, 520, 580, 640, 700], "near {middle:g} nm")


def design(n, k, rng):
    return np.vander(np.linspace(-1, 1, n), k, increasing=True).T * rng.uniform(0.5, 2.0, (k, 1))


def linear(rng, n=40, k=4):
    """z and J of a straight least-squares fit."""
    rows = design(n, k, rng)
    y = rng.standard_normal(n)
    return y - np.linalg.lstsq(rows.T, y, rcond=None)[0] @ rows, rows


def decay(rng, n=40, sd=0.02):
    """z and J of a fit of a exp(-b x) + c, a nonlinear one."""
    x = np.linspace(0, 3, n)

    def f(p):
        return p[0] * np.exp(-p[1] * x) + p[2]

    y = f([1.0, 1.3, 0.2]) + sd * rng.standard_normal(n)
    found = optimize.least_squares(lambda p: (f(p) - y) / sd, [0.7, 1.0, 0.0], method="lm")
    return found.fun, found.jac.T


def uniform(chances):
    return stats.kstest(chances, "uniform").pvalue


@pytest.mark.parametrize("kind", [linear, decay])
def test_p_is_uniform_where_the_model_is_right(kind):
    rng = np.random.default_rng(101)
    groups = Grouping.of("fifth", np.arange(40) // 8)
    found = [misfit(*kind(rng), groups=[groups], series=[np.arange(40)]) for _ in range(1000)]
    assert uniform([m.p for m in found]) > 0.01
    assert uniform([m.structure[0].p for m in found]) > 0.01
    # Two false alarms of a thousand at most: eight have a chance of .001.
    assert sum(m.told for m in found) < 8
    assert np.mean([m.worst < 0.05 for m in found]) < 0.1 + 3 * np.sqrt(0.09 / 1000)
    assert abs(np.mean([m.chi2 for m in found]) / found[0].dof - 1) < 3 * np.sqrt(2 / found[0].dof / 1000)


def test_p_would_not_be_uniform_with_wrong_degrees_or_a_noise_a_tenth_off():
    rng = np.random.default_rng(102)
    pairs = [linear(rng) for _ in range(1000)]
    assert uniform([misfit(z).p for z, _ in pairs]) < 1e-6  # four parameters forgotten
    assert uniform([misfit(1.1 * z, rows).p for z, rows in pairs]) < 1e-6


def test_another_loss_is_judged_alike():
    """A fit by weights that are not the noise's: z keeps a part along J, which is taken out."""
    rng = np.random.default_rng(103)
    chances = []
    for _ in range(1000):
        rows, sd = design(30, 3, rng), rng.uniform(0.3, 3.0, 30)
        y = sd * rng.standard_normal(30)
        z = (y - np.linalg.lstsq(rows.T, y, rcond=None)[0] @ rows) / sd
        chances.append(misfit(z, rows / sd).p)
    assert uniform(chances) > 0.01


def test_groups_are_the_f_test_of_nested_models_done_the_long_way():
    rng = np.random.default_rng(104)
    labels = rng.integers(0, 6, 50)
    z, rows = linear(rng, 50, 4)
    dummies = (labels[:, None] == np.arange(6)).astype(float)
    both = np.column_stack([rows.T, dummies])
    rss = [float(np.sum((z - a @ np.linalg.lstsq(a, z, rcond=None)[0]) ** 2)) for a in (rows.T, both)]
    ranks = [np.linalg.matrix_rank(a) for a in (rows.T, both)]
    top, rest = ranks[1] - ranks[0], 50 - ranks[1]
    expected = stats.f.sf((rss[0] - rss[1]) / top / (rss[1] / rest), top, rest)
    found = misfit(z, rows, groups=[Grouping.of("six", labels)]).structure[0]
    assert (found.dof, found.p) == (top, pytest.approx(expected, rel=1e-9))


def test_degrees_of_freedom_are_of_the_rank():
    z, rows = linear(np.random.default_rng(105), 30, 3)
    m = misfit(z, np.vstack([rows, rows[0] + 2 * rows[1], 0 * rows[0]]))
    assert m.dof == 27
    assert m.p == pytest.approx(stats.chi2.sf(np.sum(z**2), 27), rel=1e-9)


def test_runs_are_counted_exactly():
    signs = [np.array(s, dtype=float) for s in set(itertools.permutations([1, 1, 1, 1, -1, -1, -1]))]
    runs = np.array([1 + np.sum(s[1:] != s[:-1]) for s in signs])
    for s, count in zip(signs, runs, strict=True):
        assert runs_p([s]) == pytest.approx(np.mean(runs < count) + 0.5 * np.mean(runs == count))
    rng = np.random.default_rng(106)
    chances = np.array([runs_p(list(rng.standard_normal((2, 300)))) for _ in range(1000)])
    assert uniform(chances) > 0.001
    assert np.isnan(runs_p([np.ones(5)]))


@pytest.mark.parametrize("size", [1.5, 2.0, 3.0])
def test_a_missing_band_is_told_and_named(size):
    """A bump of sd 15 nm at 630 nm that makes the whole residual `size` times the noise, four parameters fitted."""
    rng = np.random.default_rng(107)
    bump = np.exp(-0.5 * ((NM - 630) / 15) ** 2)
    rows = design(23, 4, rng)
    bump = bump - np.linalg.lstsq(rows.T, bump, rcond=None)[0] @ rows
    bump *= np.sqrt((size**2 - 1) * 19 / np.sum(bump**2))
    told, named = 0, 0
    for _ in range(200):
        y = bump + rng.standard_normal(23)
        z = y - np.linalg.lstsq(rows.T, y, rcond=None)[0] @ rows
        m = misfit(z, rows, groups=[BANDS], series=[np.arange(23)])
        told += m.told
        named += m.where == "near 610 nm" or m.where == "near 670 nm"
        assert not m.told or (m.words.startswith("the model misses the data") and m.words.endswith("is right"))
    # What chi2 alone must find (1.5: 46 %, 2: 97 %), less three standard errors; the pattern adds to it.
    power = stats.ncx2.sf(stats.chi2.isf(LIMIT, 19), 19, 19 * (size**2 - 1))
    assert told / 200 >= power - 3 * np.sqrt(power * (1 - power) / 200)
    assert size == 1.5 or named >= 180


def test_structure_is_told_without_any_noise_stated():
    rng = np.random.default_rng(108)
    wave = np.sin(np.linspace(0, 9, 60))
    m = misfit(0.01 * (wave + 0.3 * rng.standard_normal(60)), groups=[Grouping.of("fifth", np.arange(60) // 5)],
               known=False, noise="no errors given")  # fmt: skip
    assert m.told and not m.adequate and np.isnan(m.p) and "hang on fifth" in m.words
    chances = [
        misfit(7 * rng.standard_normal(60), groups=[Grouping.of("fifth", np.arange(60) // 5)], known=False)
        for _ in range(500)
    ]
    assert uniform([m.worst for m in chances]) > 0.01
    assert "cannot be told" in chances[0].words


def test_an_sd_from_few_repeats_makes_an_f():
    rng = np.random.default_rng(109)
    by_f, by_chi2 = [], []
    for _ in range(1000):
        z, rows = linear(rng, 20, 3)
        sd, dof = noise_of_repeats(rng.standard_normal((3, 3)), [0, 0, 0])
        assert dof == 6
        by_f.append(misfit(z / sd, rows, noise_dof=dof).p)
        by_chi2.append(misfit(z / sd, rows).p)
    assert uniform(by_f) > 0.01
    assert uniform(by_chi2) < 1e-6 and np.mean(np.array(by_chi2) < LIMIT) > 0.05


def test_an_sd_from_repeats_at_each_point_makes_a_t():
    """Six repeats a point: the t of each residual becomes a normal one; as χ² one case in three would be a misfit."""
    rng = np.random.default_rng(110)
    by_t, by_chi2 = [], []
    for _ in range(1000):
        rows = design(40, 3, rng)
        sd = np.sqrt(rng.chisquare(5, 40) / 5)
        y = rng.standard_normal(40)
        z = (y - np.linalg.lstsq((rows / sd).T, y / sd, rcond=None)[0] @ rows) / sd
        by_t.append(misfit(z, rows / sd, noise_dof=np.full(40, 5.0)).p)
        by_chi2.append(misfit(z, rows / sd).p)
    # Weights by the same sd's pull the fit to the points that look sure: chance stays within a third of what it says.
    assert 0.6 < np.mean(np.array(by_t) < 0.1) / 0.1 < 1.4
    assert np.mean(np.array(by_t) < LIMIT) < 0.005
    assert np.mean(np.array(by_chi2) < LIMIT) > 0.05


def test_correlated_noise_is_worth_fewer_numbers():
    rng = np.random.default_rng(111)

    def ar(n):
        e = rng.standard_normal(n + 50)
        for k in range(1, n + 50):
            e[k] = 0.6 * e[k - 1] + 0.8 * e[k]
        return e[50:]

    share = np.mean([effective_number(ar(4000)) for _ in range(20)]) / 4000
    assert abs(share / 0.25 - 1) < 0.1  # (1 - .6)/(1 + .6)
    groups, rows = Grouping.of("tenth", np.arange(200) // 20), design(200, 3, rng)
    alarms = {"as independent": 0, "as correlated": 0}
    for _ in range(400):
        z = ar(200)
        alarms["as independent"] += misfit(z, rows, groups=[groups]).worst < 0.05
        alarms["as correlated"] += misfit(z, rows, groups=[groups], effective=50).worst < 0.05
    assert alarms["as independent"] > 200
    assert alarms["as correlated"] <= stats.binom.ppf(0.999, 400, 0.05)


def test_noise_of_neighbours_and_its_degrees():
    rng = np.random.default_rng(112)
    curve = 3 * np.sin(np.linspace(0, 2, 120))
    found = np.array([noise_of_neighbours(curve + 0.2 * rng.standard_normal(120)) for _ in range(1000)])
    ratio = (found[:, 0] / 0.2) ** 2
    assert abs(ratio.mean() - 1) < 0.02
    # The variance of s²/σ² is 2/ν.
    assert abs(ratio.var() * found[0, 1] / 2 - 1) < 0.15


def test_words_and_record():
    z = np.linspace(-1, 1, 50)
    m = misfit(0.01 * np.sign(np.sin(np.arange(50.0))) * (1 + z), relative=0.05)
    assert m.overstated and "x larger than what scatters" in m.words and m.adequate and m.scale == 1
    m = misfit(9 * np.random.default_rng(0).standard_normal(50), relative=0.046)
    assert m.told and m.scale == m.ratio and "residual 4.6 %" in m.words and "x the noise" in m.words
    record = m.to_dict()
    assert record["adequate"] is False and record["structure"] == [] and record["where"] == ""
    with pytest.raises(InputError, match="must be more than the 3 parameters"):
        misfit(np.ones(3), np.eye(3))
    with pytest.raises(InputError, match="must have 3 labels"):
        misfit(np.ones(3), groups=[Grouping.of("light", [1, 2])])
