"""The ledger's parts: plans, weights, exponents, sums."""

import math

import numpy as np
import pytest
from ledger_tissue import W, layer, stack, tissue

from livlab.errors import InputError
from livlab.model.transport.ledger.data import OUTSIDE, Anchors, Coefficients, bins_of
from livlab.model.transport.ledger.evaluate import Rows, exponents, sums
from livlab.model.transport.ledger.plan import blend, degeneracy_of, levels, lobatto, make_plan, reference_stack, snap
from livlab.model.transport.tally import Tally


def test_weights_reproduce_polynomials_and_nothing_else():
    at = np.linspace(500, 720, 23)
    for count, degree in ((1, 0), (3, 2), (4, 3), (6, 2)):
        anchors = 610 + 110 * lobatto(count)
        c = blend(at, anchors, degree)
        for power in range(degree + 1):
            assert np.allclose(c @ (anchors / 600.0) ** power, (at / 600.0) ** power, rtol=1e-9)
        if count == degree + 1 > 1:
            off = c @ (anchors / 600.0) ** (degree + 1) - (at / 600.0) ** (degree + 1)
            assert np.abs(off).max() > 1e-4
        assert (np.abs(c).sum(1) < 2.0).all()


def test_lobatto_points():
    assert np.allclose(lobatto(4), [-1, -math.sqrt(0.2), math.sqrt(0.2), 1], atol=1e-12)
    assert np.allclose(lobatto(5), [-1, -math.sqrt(3 / 7), 0, math.sqrt(3 / 7), 1], atol=1e-12)


def test_anchors_are_distinct_even_where_wavelengths_are_sparse():
    assert snap(W, 8) == (0, 1, 2, 3, 5, 6, 7, 8)
    assert snap(np.array([500.0, 690.0, 695.0, 700.0]), 4) == (0, 1, 2, 3)
    assert snap(W[:1], 3) == (0,)


def test_coefficients_of_a_stack():
    made = tissue()
    found = Coefficients.of(made)
    assert np.allclose(found.absorption[:, 1], made.layers[1].absorption)
    assert np.allclose(found.scattering[:, 0], made.layers[0].scattering)
    assert np.allclose(found.anisotropy, [[0.9, 0.8]] * W.size)
    assert found.index.shape == (W.size, 4)
    assert (found.index[:, 3] == 1.38).all()  # below an endless layer there is only itself
    between = found.at(np.array([512.5]))
    assert between.absorption[0, 1] == pytest.approx(found.absorption[:2, 1].mean())
    with pytest.raises(InputError, match="within the recorded band"):
        found.at(np.array([499.0]))


def test_what_a_redirect_factor_takes_counts_as_absorption():
    made = stack(layer("bulk", math.inf, 1.3, 0.2, 2.0, 0.0, redirect="abs_cos"))
    found = Coefficients.of(made)
    assert found.scattering[0, 0] == pytest.approx(4.0 / math.pi)
    assert found.absorption[0, 0] == pytest.approx(0.2 + 2.0 * (1 - 2 / math.pi))


def plan_of(made, **options):
    sets = Coefficients.of(made)
    return make_plan(made, sets, **{"lateral": False, "reserve": 0.1, "degree": 0} | options), sets


def test_plan_takes_an_endless_last_layer_by_its_mean_free_path():
    plan, _ = plan_of(tissue(), degree=2)
    assert plan.scaled
    assert plan.counted == (0,)
    assert len(plan.rows) == 3
    assert plan.depth_bias == 0.0
    lateral, _ = plan_of(tissue(), lateral=True)
    assert not lateral.scaled
    assert lateral.counted == (0, 1)


def test_plan_does_not_scale_a_slab_that_light_crosses():
    thin, _ = plan_of(stack(layer("slab", 1.0, 1.4, 0.1, 5.0, 0.5)))
    assert not thin.scaled
    thick, _ = plan_of(stack(layer("slab", 200.0, 1.4, 0.1, 5.0, 0.5)))
    assert thick.scaled
    assert 0.0 < thick.depth_bias < 1e-6
    short, _ = plan_of(stack(layer("bulk", math.inf, 1.4, 0.1, 5.0, 0.0, absorb_below_mm=0.02)))
    assert not short.scaled


def test_reference_absorption_stays_below_what_is_served():
    plan, sets = plan_of(tissue())
    walked = reference_stack(tissue(), plan, False)
    ratio = sets.absorption[:, 1] / sets.scattering[:, 1]
    reference = plan.reference[0, 1] / walked.layers[1].scattering[0]
    assert reference == pytest.approx(0.9 * ratio.min())
    assert plan.reference[0, 0] == pytest.approx(0.9 * 0.02)


def test_reference_stack_meets_a_factor_by_its_mean_or_keeps_it():
    made = stack(layer("bulk", math.inf, 1.3, 0.2, 2.0, 0.0, redirect="abs_cos"))
    plan, _ = plan_of(made)
    for keep in (False, True):
        walked = reference_stack(made, plan, keep)
        assert walked.layers[0].scattering[0] == pytest.approx(4.0 / math.pi)
        assert {i.redirect for i in walked.layers[0].interactions if i.albedo.any()} == {"abs_cos" if keep else "none"}


def anchors_like(sets, rows):
    own = sets.take(rows)
    t = own.absorption * 0.5 + own.scattering
    return Anchors(own.wavelength_nm, own.scattering, t, own.anisotropy, own.index, np.full(len(rows), 1000))


@pytest.mark.parametrize("scaled", [True, False])
def test_exponents_are_log_ratios_of_path_densities(scaled):
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [4])
    counted = (0,) if scaled else (0, 1)
    c = blend(sets.wavelength_nm, anchors.wavelength_nm, 0)
    level = levels(anchors, c, np.ones(2))
    found = exponents(sets, anchors, 0, level[0], scaled, counted)
    path, count = np.array([0.3, 7.0]), np.array([4.0, 60.0])
    s, t = anchors.scattering[0], anchors.extinction[0]
    for w in range(len(sets)):
        s1, a1 = sets.scattering[w], sets.absorption[w]
        top = count[0] * np.log(s1[0] / s[0]) - (s1[0] + a1[0] - t[0]) * path[0]
        if scaled:
            # The same path in units of the mean free path, in an endless medium.
            rest = -(a1[1] / s1[1] - (t[1] - s[1]) / s[1]) * path[1] * s[1]
        else:
            rest = count[1] * np.log(s1[1] / s[1]) - (s1[1] + a1[1] - t[1]) * path[1]
        features = np.concatenate([path, count[list(counted)]])
        assert found.theta[:, w] @ features == pytest.approx(top + rest, rel=1e-12)


def test_derivatives_of_exponents():
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [0, 4, 8])
    c = blend(sets.wavelength_nm, anchors.wavelength_nm, 2)
    level = levels(anchors, c, np.array([0.3, 0.3]))
    layer_of = [0, 1, 0]
    base = exponents(sets, anchors, 1, level[1], True, (0,))
    for name, by in (("absorption", base.by_absorption), ("scattering", base.by_scattering)):
        for k in range(2):
            h = 1e-6
            moved = []
            for sign in (1, -1):
                values = getattr(sets, name).copy()
                values[:, k] += sign * h
                other = Coefficients(**{**sets.__dict__, name: values})
                moved.append(exponents(other, anchors, 1, level[1], True, (0,)).theta)
            numeric = (moved[0] - moved[1]) / (2 * h)
            exact = by * (np.array(layer_of) == k)[:, None]
            assert np.allclose(numeric, exact, rtol=1e-5, atol=1e-6)


def test_levels_share_a_change_so_that_the_blend_is_consistent():
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [0, 4, 8])
    c = blend(sets.wavelength_nm, anchors.wavelength_nm, 2)
    own = np.log(sets.scattering * (1 - sets.anisotropy))
    mine = np.log(anchors.scattering * (1 - anchors.anisotropy))
    for bear in (0.0, 0.4, 1.0):
        level = levels(anchors, c, np.full(2, bear))
        # ln s' at which each anchor answers; their blend is that of the setting.
        answered = mine[:, None, :] + own[None] - level
        assert np.allclose(np.einsum("sk,ksl->sl", c, answered), own, atol=1e-9)
    free = np.abs(own[None] - levels(anchors, c, np.zeros(2))).max()
    full = np.abs(own[None] - levels(anchors, c, np.ones(2))).max()
    assert free < 0.1 * full


def test_weight_degeneracy_is_the_log_variance_of_the_likelihood_ratio():
    """χ² of two Poisson processes, against its own definition summed over counts."""
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [4])
    level = levels(anchors, blend(sets.wavelength_nm, anchors.wavelength_nm, 0), np.ones(2))
    path = np.array([2.0, 0.0])
    found = degeneracy_of(sets, anchors, 0, level[0], True, path)
    s, s1 = anchors.scattering[0, 0], sets.scattering[2, 0]
    n = np.arange(400)
    log_p = n * math.log(s * path[0]) - s * path[0] - np.array([math.lgamma(k + 1) for k in n])
    ratio = n * math.log(s1 / s) - (s1 - s) * path[0]
    assert found[2] == pytest.approx(math.log(np.exp(log_p + 2 * ratio).sum()), rel=1e-6)
    assert found[4] == 0.0


def test_weight_degeneracy_is_infinite_where_scattering_appears():
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [4])
    anchors.scattering[0, 0] = 0.0
    level = levels(anchors, np.ones((len(sets), 1)), np.ones(2))
    assert np.isinf(degeneracy_of(sets, anchors, 0, level[0], True, np.ones(2))).all()


def random_rows(n, f, seed=0):
    rng = np.random.default_rng(seed)
    x = np.zeros((n, -(-f // 4) * 4), dtype=np.float32)
    x[:, :f] = rng.exponential(size=(n, f))
    return Rows(x, rng.normal(size=n).astype(np.float32), rng.random(n).astype(np.float32)), rng


@pytest.mark.parametrize(("n", "s"), [(0, 3), (1, 1), (13, 5), (40_001, 33), (77, 300)])
def test_sums_against_numpy(n, s):
    rows, rng = random_rows(n, 5)
    theta, turn = -rng.random((5, s)), rng.normal(size=(2, 5, s))
    found = sums(rows, theta, list(turn))
    x, q = rows.features[:, :5].astype(float), rows.concentration.astype(float)
    e = np.exp(x @ theta + rows.log_weight.astype(float)[:, None])
    assert np.allclose(found.count, e.sum(0), rtol=1e-12)
    assert np.allclose(found.square, q @ e**2, rtol=1e-12)
    assert np.allclose(found.features, x.T @ e, rtol=1e-12)
    for d in range(2):
        along = x @ turn[d]
        assert np.allclose(found.slope[d], (e * along).sum(0), rtol=1e-9, atol=1e-9)
        assert np.allclose(found.slope_square[d], q @ (e * along) ** 2, rtol=1e-12)


def test_sums_of_features_from_a_sample_of_many_rows():
    rows, rng = random_rows(200_000, 3)
    theta = -rng.random((3, 40))
    exact, rough = sums(rows, theta), sums(rows, theta, exact=False)
    assert np.array_equal(exact.count, rough.count)
    assert np.array_equal(exact.square, rough.square)
    assert np.allclose(rough.features, exact.features, rtol=0.1)
    assert not np.array_equal(rough.features, exact.features)


def test_sums_of_vanishing_and_huge_weights_stay_finite():
    rows, _ = random_rows(16, 4)
    theta = np.full((4, 2), -1e4)
    theta[:, 1] = 0.0
    found = sums(rows, theta)
    assert np.isfinite(found.count).all()
    assert found.count[0] < 1e-100


def test_bins_of_exits():
    tally = Tally((0.0, 0.5, 1.0), (0.5, 1.0, math.inf))
    cosine = np.cos([0.0, 0.49, 0.51, 1.2]).astype(np.float32)
    radius = np.array([0.7, 0.2, 5.0, 0.7], dtype=np.float32)
    assert bins_of(tally, cosine, radius).tolist() == [0, OUTSIDE, 3, OUTSIDE]
