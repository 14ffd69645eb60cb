"""The ledger's parts: plans, weights, exponents, sums, detectors, refusals."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.ledger import Detector, record
from livlab.model.transport.ledger_compress import Domain, compress, widened
from livlab.model.transport.ledger_data import (
    OUTSIDE,
    Anchors,
    Coefficients,
    Entries,
    bins_of,
    sort_entries,
)
from livlab.model.transport.ledger_evaluate import Rows, exponents, select, sums
from livlab.model.transport.ledger_plan import blend, levels, lobatto, make_plan, reference_stack, snap, wear_of
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

W = np.linspace(500.0, 700.0, 9)
ONE = np.ones_like(W)


def layer(name, thickness, n, mua, mus, g, **options):
    n, mua, mus, g = (np.broadcast_to(np.asarray(x, float), W.shape) for x in (n, mua, mus, g))
    phases = tuple(HenyeyGreenstein(float(x)) if x else Isotropic() for x in g)
    parts = (
        Interaction("blood", np.array(mua), 0 * ONE, phases),
        Interaction("cells", np.array(mus), ONE, phases, **options),
    )
    return PlaneLayer(name, thickness, np.array(n), parts)


def stack(*layers, above=1.0, below=1.0):
    return OpticalStack(W, tuple(layers), above * ONE, below * ONE, "made up")


def tissue(mua=1.0, mus=1.0, thickness=0.1, g=0.8):
    falling = np.linspace(1.0, 0.1, W.size)
    capsule = layer("capsule", thickness, 1.36, 0.02 * mua, 12.0 * mus * (W / 600.0) ** -0.5, 0.9)
    bulk = layer("bulk", math.inf, 1.38, 0.5 * mua * falling, 10.0 * mus * (W / 600.0) ** -1.0, g)
    return stack(capsule, bulk)


@pytest.fixture(scope="module")
def ledger(libllvm):
    return record(tissue(), samples=20_000, seed=3, tally=Tally(theta_edges=(0.0, 0.5, 1.0, math.pi / 2)))


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


def test_wear_is_the_log_variance_of_the_likelihood_ratio():
    """χ² of two Poisson processes, against its own definition summed over counts."""
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [4])
    level = levels(anchors, blend(sets.wavelength_nm, anchors.wavelength_nm, 0), np.ones(2))
    path = np.array([2.0, 0.0])
    found = wear_of(sets, anchors, 0, level[0], True, path)
    s, s1 = anchors.scattering[0, 0], sets.scattering[2, 0]
    n = np.arange(400)
    log_p = n * math.log(s * path[0]) - s * path[0] - np.array([math.lgamma(k + 1) for k in n])
    ratio = n * math.log(s1 / s) - (s1 - s) * path[0]
    assert found[2] == pytest.approx(math.log(np.exp(log_p + 2 * ratio).sum()), rel=1e-6)
    assert found[4] == 0.0


def test_wear_is_infinite_where_scattering_appears():
    sets = Coefficients.of(tissue())
    anchors = anchors_like(sets, [4])
    anchors.scattering[0, 0] = 0.0
    level = levels(anchors, np.ones((len(sets), 1)), np.ones(2))
    assert np.isinf(wear_of(sets, anchors, 0, level[0], True, np.ones(2))).all()


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
    thick = ledger.spectrum(tissue(thickness=0.11), worn="mark")
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
        up, down = (ledger.spectrum(make({**at, name: value + d}), worn="mark") for d in (h, -h))
        numeric = (up.reflectance - down.reflectance).to_numpy() / (2 * h)
        assert np.allclose(found.gradient.sel(parameter=name), numeric, rtol=1e-3), name


def test_a_worn_ledger_refuses_and_says_why(ledger):
    served = ledger.served.take([4])
    white = served.absorption * 0.0
    marked = ledger.evaluate(white, served.scattering, wavelength_nm=600.0)
    assert not marked.valid.any()
    assert marked.wear[0] > 2.0
    with pytest.raises(InputError, match="added log variance"):
        ledger.evaluate(white, served.scattering, wavelength_nm=600.0, worn="raise")
    dense = served.scattering * [3.0, 1.0]
    assert not ledger.evaluate(served.absorption, dense, wavelength_nm=600.0).valid.any()
    with pytest.raises(InputError, match="effective samples"):
        ledger.spectrum(least_samples=1e9)


def test_walking_again_where_worn(ledger):
    dense = tissue(mus=np.where(W > 620, 3.0, 1.0))
    marked = ledger.spectrum(dense, worn="mark")
    assert 0 < int(marked.valid.sum()) < W.size
    again = ledger.spectrum(dense, worn="walk")
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
    other = ledger.spectrum(tissue(g=0.5, mus=1.0), worn="mark")
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
    with pytest.raises(InputError, match="worn"):
        ledger.evaluate(good, good, worn="walk")


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


def test_compression_keeps_answers_within_its_tolerance(ledger):
    small = ledger.compressed(1e-4, scattering_spread=0.02)
    assert len(small) < 0.5 * len(ledger)
    assert small.compression.error <= 1e-4
    rng = np.random.default_rng(0)
    served = ledger.served
    for _ in range(5):
        a = served.absorption * (1 + 0.2 * rng.uniform(-1, 1, 2))
        s = served.scattering * (1 + 0.02 * rng.uniform(-1, 1, 2))
        before, after = (x.evaluate(a, s, wavelength_nm=served.wavelength_nm, gradient=True) for x in (ledger, small))
        assert np.abs(after.value - before.value).max() < 2e-4
        assert np.allclose(after.value_se, before.value_se, rtol=0.1)
        for name in ("d_absorption", "d_scattering"):
            off = np.abs(after[name] - before[name]) / before[f"{name}_se"]
            assert float(off.max()) < 0.5
    assert np.allclose(small.spectrum().reflectance_binned, ledger.spectrum().reflectance_binned, atol=2e-4)


def test_a_finer_tolerance_keeps_more_rows(ledger):
    sizes = [len(ledger.compressed(t)) for t in (1e-3, 1e-4, 1e-5)]
    assert sizes[0] < sizes[1] < sizes[2]


def test_a_compressed_ledger_knows_its_bounds(ledger):
    small = ledger.compressed(1e-3)
    served = ledger.served
    assert small.spectrum().valid.all()
    far = served.absorption.max(axis=0) * [1.0, 3.0]
    assert not small.evaluate(far, served.scattering[4], wavelength_nm=600.0).valid.any()
    assert ledger.evaluate(far, served.scattering[4], wavelength_nm=600.0).valid.all()
    small.answer(served, Detector("up", (0.0, 0.5)))
    with pytest.raises(InputError, match="knows only the bins"):
        small.answer(served, Detector("up", (0.0, 0.4)))
    with pytest.raises(InputError, match="compressed already"):
        small.compressed()


def test_compression_of_one_exponent_is_a_histogram():
    """Rows that differ in one feature only, over a wide domain: few rows do."""
    rng = np.random.default_rng(1)
    n = 20_000
    x = rng.exponential(5.0, (n, 1)).astype(np.float32)
    zero = np.zeros(n)
    rows = sort_entries(
        Entries(
            zero.astype(np.uint16),
            zero.astype(np.uint8),
            zero.astype(np.int32),
            x,
            zero.astype(np.float32),
            np.ones(n, np.float32),
            np.ones(n, np.float32),
            np.empty(0, np.float32),
        )
    )
    anchors = Anchors(np.array([500.0]), *(np.ones((1, 1)) for _ in range(4)), np.array([n]))
    theta = -np.linspace(0.0, 2.0, 41)[None, :]
    small = compress(rows, anchors, [Domain(theta, np.ones(41))], 1e-5)
    assert len(small) < 400
    truth = np.exp(x.astype(float) @ theta).mean(0)
    lots = [Rows(np.pad(r.features, ((0, 0), (0, 3))), r.log_weight, r.concentration) for r in (rows, small)]
    found = [sums(r, theta) for r in lots]
    # The tolerance is met by a prediction; `Ledger.compressed` measures and repeats.
    assert np.abs(found[1].count / n - truth).max() < 2e-5
    assert np.allclose(found[1].square, found[0].square, rtol=0.02)


def test_widened_changes_one_coefficient_at_a_time():
    served = Coefficients.of(tissue())
    found = widened(served, 0.2, 0.05)
    assert len(found) == len(served) * (1 + 2 * 2 * 2)
    changed = np.concatenate([found.absorption, found.scattering], axis=1).reshape(-1, len(served), 4)
    differs = (np.abs(changed / changed[0] - 1.0) > 1e-12).any(1).sum(1)
    assert sorted(differs.tolist()) == [0] + [1] * 8


def test_select_keeps_rows_of_each_walk_apart(ledger):
    rows = select(ledger.entries, len(ledger.anchors), Detector.total(), ledger.tally, False)
    assert sum(len(r.log_weight) for r in rows) == int((ledger.entries.side == 0).sum())
