"""The walk's interface: what comes back, what is refused, what repeats."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.walk.walk import Source, Tally, merge, walk

pytestmark = pytest.mark.usefixtures("libllvm")

W = np.array([500.0, 550.0, 600.0])
ONE = np.ones(3)
BUDGET = ("reflectance", "specular", "transmittance", "lost", "redirect_loss", "residual")


def two_layers(absorption=0.1, redirect="none", short=0.0):
    hg, iso = (HenyeyGreenstein(0.8),) * 3, (Isotropic(),) * 3
    phase = hg if redirect == "none" else iso
    top = PlaneLayer("top", 0.1, 1.36 * ONE, (Interaction("s", 10 * ONE, ONE, phase, redirect),))
    parts = (
        Interaction("a", absorption * np.array([1.0, 2.0, 4.0]), 0 * ONE, iso),
        Interaction("s", 5 * ONE, 0.99 * ONE, phase, redirect, short),
    )
    return OpticalStack(W, (top, PlaneLayer("bulk", 2.0, 1.40 * ONE, parts)), ONE, ONE)


def energy(result):
    return sum(result[name] for name in BUDGET) + result.absorbed.sum("layer")


def test_result_has_the_dimensions_and_attributes_promised():
    tally = Tally(theta_edges=(0.0, 0.5, math.pi / 2), radius_edges=(0.0, 1.0, 2.0, math.inf))
    r = walk(two_layers(), samples=2000, seed=4, tally=tally)
    assert r.reflectance.dims == ("wavelength",)
    assert r.absorbed.dims == ("wavelength", "layer")
    assert r.layer.values.tolist() == ["top", "bulk"]
    assert r.reflectance_binned.dims == ("wavelength", "theta_o", "radius")
    assert dict(r.sizes) == {"wavelength": 3, "layer": 2, "theta_o": 2, "radius": 3}
    for name in (*BUDGET, "absorbed", "reflectance_binned", "transmittance_binned"):
        assert r[f"{name}_se"].dims == r[name].dims
        assert r[name].attrs["units"] == "1"
    assert {"samples", "seed", "variant", "estimator", "seconds", "compile_seconds"} <= set(r.attrs)
    assert r.attrs["samples"] == 2000


@pytest.mark.parametrize("estimator", ["expected", "analog"])
@pytest.mark.parametrize("redirect", ["none", "abs_cos", "cos", "clamped_cos"])
@pytest.mark.parametrize("half_width_mm", [None, 0.7])
def test_energy_closes(estimator, redirect, half_width_mm):
    """Every photon's account closes, so any number of them does: float32 rounding is all that is left."""
    r = walk(
        two_layers(redirect=redirect, short=0.02),
        samples=3000,
        seed=8,
        estimator=estimator,
        half_width_mm=half_width_mm,
        source=Source.diffuse(square_half_width_mm=0.5),
    )
    assert energy(r).values == pytest.approx(1.0, abs=1e-6)
    assert (r.redirect_loss.values != 0).all() == (redirect != "none")
    assert (r.lost.values > 0).all() == (half_width_mm is not None)
    assert (r.unfinished == 0).all()
    assert np.abs(r.residual.values).max() < 1e-8


def test_bins_hold_all_that_left():
    tally = Tally(theta_edges=tuple(np.linspace(0, math.pi / 2, 6)), radius_edges=(0.0, 0.3, 1.0, math.inf))
    r = walk(two_layers(), samples=20_000, seed=2, tally=tally)
    assert r.reflectance_binned.sum(("theta_o", "radius")).values == pytest.approx(r.reflectance.values, abs=1e-6)
    assert r.transmittance_binned.sum(("theta_o", "radius")).values == pytest.approx(r.transmittance.values, abs=1e-6)


def test_light_beyond_the_edges_counts_in_the_totals_only():
    narrow = walk(two_layers(), samples=20_000, seed=2, tally=Tally(theta_edges=(0.2, 0.4)))
    assert 0 < float(narrow.reflectance_binned[0].sum()) < 0.5 * float(narrow.reflectance[0])


def test_same_seed_same_bytes_other_seed_other_numbers():
    tally = Tally(radius_edges=(0.0, 0.5, 5.0))
    a, b, c = (walk(two_layers(), samples=30_000, seed=s, tally=tally, batch_photons=40_000) for s in (5, 5, 6))
    for name in a.data_vars:
        assert a[name].values.tobytes() == b[name].values.tobytes(), name
    assert (a.reflectance != c.reflectance).all()


def test_other_numbers_use_the_same_kernel():
    walk(two_layers(0.1), samples=3000, seed=1)
    other = walk(two_layers(0.3).at([0, 2]), samples=50_000, seed=9, max_steps=7777)
    assert other.attrs["compile_seconds"] < 5e-3


def test_merge_is_as_if_walked_at_once():
    parts = [walk(two_layers(), samples=n, seed=n, tally=Tally(theta_edges=(0, 1, 1.5))) for n in (5000, 20_000)]
    both = merge(parts)
    for name in ("reflectance", "absorbed", "reflectance_binned"):
        want = (5000 * parts[0][name] + 20_000 * parts[1][name]) / 25_000
        assert both[name].values == pytest.approx(want.values, rel=1e-12)
    ratio = both.reflectance_se / parts[1].reflectance_se
    assert ratio.values == pytest.approx(math.sqrt(20 / 25), rel=0.03)
    assert both.attrs["samples"] == 25_000
    assert both.attrs["seed"] == [5000, 20_000]


def test_merge_refuses_what_does_not_belong_together():
    a = walk(two_layers(), samples=100, seed=1)
    with pytest.raises(InputError, match="seed"):
        merge([a, a])
    with pytest.raises(InputError, match="estimator"):
        merge([a, walk(two_layers(), samples=100, seed=2, estimator="analog")])
    with pytest.raises(InputError, match="coordinates"):
        merge([a, walk(two_layers().at([0, 1]), samples=100, seed=3)])
    with pytest.raises(InputError, match="at least one"):
        merge([])


def test_progress_is_told_and_may_stop():
    seen = []
    walk(two_layers(), samples=4000, seed=1, batch_photons=3000, progress=seen.append)
    assert seen == [0.25, 0.5, 0.75, 1.0]

    def stop(fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        walk(two_layers(), samples=4000, seed=1, batch_photons=3000, progress=stop)


def test_one_photon():
    r = walk(two_layers(), samples=1, seed=3)
    assert energy(r).values == pytest.approx(1.0, abs=1e-6)
    assert np.isnan(r.reflectance_se.values).all()


def test_a_walk_that_does_not_end_is_given_up_and_counted():
    endless = plain_stack([(1.0, 0.0, 1.0, math.inf, Isotropic())])
    r = walk(endless, samples=2000, seed=1, max_steps=50)
    share = int(r.unfinished[0]) / 2000
    assert 0.02 < share < 0.3
    assert float(r.residual[0]) == pytest.approx(share, abs=1e-6)
    assert energy(r).values == pytest.approx(1.0, abs=1e-6)


def test_clear_layers_pass_light_on():
    """Nothing interacts: Fresnel's infinite series for a plate, and an endless clear layer swallows it."""
    plate = plain_stack([(1.5, 0.0, 0.0, 1.0, Isotropic())])
    r = walk(plate, samples=200_000, seed=1)
    assert float(r.specular[0]) == pytest.approx(0.04)
    want = 0.96 * 0.96 / (1 - 0.04**2)
    assert float(r.transmittance[0]) == pytest.approx(want, abs=4 * float(r.transmittance_se[0]))
    assert float(r.transmittance_se[0]) < 1e-3
    endless = walk(plain_stack([(1.5, 0.0, 0.0, math.inf, Isotropic())]), samples=1000, seed=1)
    assert float(endless.transmittance[0]) == pytest.approx(0.96, abs=1e-6)
    wide = walk(
        plain_stack([(1.5, 0.0, 0.0, math.inf, Isotropic())]),
        samples=1000,
        seed=1,
        source=Source.collimated(0.5),
        half_width_mm=3.0,
    )
    assert float(wide.lost[0]) == pytest.approx(1 - float(wide.specular[0]), abs=1e-6)


@pytest.mark.parametrize(
    ("bad", "field"),
    [
        ({"samples": 0}, "samples"),
        ({"seed": -1}, "seed"),
        ({"estimator": "guess"}, "estimator"),
        ({"half_width_mm": 0.0}, "half_width_mm"),
        ({"half_width_mm": math.inf}, "half_width_mm"),
        ({"half_width_mm": 1.0, "source": Source.collimated(square_half_width_mm=2.0)}, "source"),
        ({"variant": "metal"}, "variant"),
        ({"max_steps": 0}, "max_steps"),
        ({"batch_photons": 1 << 27}, "batch_photons"),
    ],
)
def test_bad_arguments_are_refused(bad, field):
    with pytest.raises(InputError, match=field):
        walk(two_layers(), **({"samples": 10, "seed": 0} | bad))
