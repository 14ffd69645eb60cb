"""A BRDF that is not the model, a lamp that is not where it was told: is it said, and are good fits left in peace?

Cheap fits: some 240 to 500 samples of a sphere's directions, one channel, no pixels (40 ms each). `pytest -s -m ""`
prints the tables of docs/brdf-models.md. Seeds and cases were fixed before the first run.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from brdf_misfit_cases import Seen, anisotropic, clean, noisy, of, sphere
from scipy import stats

from livlab.brdf.fit.fit import fit
from livlab.brdf.models.model import model
from livlab.machine.llvm import choose_libllvm

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")


def coated(s):
    """Mitsuba's principled material with a clear coat and sheen, by its own code."""
    choose_libllvm()
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({
        "type": "principled", "base_color": {"type": "rgb", "value": [0.4] * 3}, "roughness": 0.5, "specular": 0.5,
        "clearcoat": 0.8, "clearcoat_gloss": 0.7, "sheen": 0.6,
    })  # fmt: skip
    context, found = mi.BSDFContext(), np.empty(len(s.wi))
    for k, (to_light, to_eye) in enumerate(zip(s.wi, s.wo, strict=True)):
        at = mi.SurfaceInteraction3f()
        at.wi = mi.Vector3f(*to_eye)
        found[k] = bsdf.eval(context, at, mi.Vector3f(*to_light))[0] / to_light[2]
    return found


PLAIN = of("lambert+ggx", kd=0.3, ks=0.9, alpha=0.25)


def light_strength(s):
    return PLAIN(s) * np.where(s.light == 3, 0.9, 1.0)


def gradient(s):
    return PLAIN(s) * (1 + 0.08 * s.normal[:, 0])


def veil(s):
    return PLAIN(s) + 0.004 / s.wi[:, 2]


def gamma(s):
    return (PLAIN(s) * s.wi[:, 2]) ** 1.06 / s.wi[:, 2]


@dataclass(frozen=True)
class Case:
    """What is seen, the model that is fitted, the residual over the noise; how far a lamp is turned."""

    truth: Callable[[Seen], np.ndarray]
    fitted: str
    ratio: float
    off_deg: float = 0.0


SEEN = {
    "anisotropic GGX .1/.3 as isotropic": Case(lambda s: anisotropic(s.wi, s.wo, 0.9, 0.1, 0.3), "ggx-mirror", 0.0),
    "plastic as Lambert + GGX": Case(of("plastic", kd=0.5, ks=1.0, alpha=0.2), "lambert+ggx", 0.0),
    "two lobes as one": Case(of("lambert+ggx+ggx", kd=0.2, ks=1.5, alpha=0.1, ks2=2.5, alpha2=0.4), "lambert+ggx", 0.0),
    "principled with coat and sheen as without": Case(coated, "principled", 0.0),
    "Oren-Nayar, full, as the qualitative": Case(of("oren-nayar", kd=0.7, sigma=0.5), "oren-nayar-qualitative", 0.0),
}
"""Of the issue, noise of 1 % of the rms."""

OWN = {
    "Beckmann as GGX": Case(of("lambert+beckmann", kd=0.3, ks=0.9, alpha=0.25), "lambert+ggx", 1.5),
    "Burley as Lambert": Case(of("burley", kd=0.5, alpha=0.4), "lambert", 2.0),
    "Oren-Nayar as Lambert": Case(of("oren-nayar", kd=0.5, sigma=0.3), "lambert", 3.0),
    "Schlick F0 .04 as no Fresnel term": Case(
        of("lambert+ggx-schlick", kd=0.3, F0=0.04, alpha=0.3), "lambert+ggx-mirror", 1.5
    ),
    "correlated shadowing as separable": Case(of("ggx-correlated", ks=0.9, alpha=0.7), "ggx", 2.0),
    "index 2.4 as 1.5": Case(of("lambert+ggx", kd=0.3, ks=0.4, alpha=0.3, eta=2.4), "lambert+ggx", 3.0),
    "Blinn-Phong as GGX": Case(of("lambert+blinn-phong", kd=0.3, ks=0.2, exponent=20.0), "lambert+ggx", 1.5),
    "anisotropy .2/.25 as isotropic": Case(
        lambda s: 0.1 + anisotropic(s.wi, s.wo, 0.1, 0.2, 0.25), "lambert+ggx-mirror", 2.0
    ),
    "a lamp 10 % too weak": Case(light_strength, "lambert+ggx", 1.5),
    "a lamp 3 degrees beside its place": Case(PLAIN, "lambert+ggx", 2.0, off_deg=3.0),
    "stray light": Case(veil, "lambert+ggx", 3.0),
    "a camera of gamma 1.06": Case(gamma, "lambert+ggx", 1.5),
    "albedo that changes by 8 % across": Case(gradient, "lambert+ggx", 3.0),
}
"""Mine: noise made such that the residual is `ratio` times it."""


def drawn(case, draws, seed, lights=10, each=50):
    """Fits of a case, new noise each time."""
    rng = np.random.default_rng(seed)
    s = sphere(lights, each, rng, off_rad=np.deg2rad(case.off_deg))
    value = case.truth(s)
    still = clean(s, value)
    exact = fit(still, case.fitted, warn=False)
    if case.ratio:
        sd = exact.rmse / np.sqrt(case.ratio**2 - 1)
    else:
        sd = 0.01 * np.sqrt(np.mean((value * s.told[:, 2]) ** 2))
    start = {n: v for n, v in exact.values.items() if exact.table.loc[n, "status"] != "fixed"}
    return [fit(noisy(s, value, sd, rng), case.fitted, starts=1, start=start, warn=False, seed=k) for k in range(draws)]


def line(name, found):
    ratio, relative = np.median([f.misfit.ratio for f in found]), np.median([f.relative_rmse for f in found])
    told, wide = sum(f.misfit.told for f in found), np.median([f.widened for f in found])
    where = found[0].misfit.where
    print(f"| {name} | {100 * relative:.2g} % | {ratio:.2g} | {told} of {len(found)} | {wide:.2g} | {where} |")


@pytest.mark.parametrize("name", SEEN)
def test_seen_cases_are_told(name):
    found = drawn(SEEN[name], 2, 21)
    line(name, found)
    for f in found:
        assert f.misfit.told and not f
        assert f.misfit.ratio > 3
        assert f.misfit.words in f.warnings
        assert f.summary().count(f.misfit.words) == 1
        assert f.misfit.words.endswith("the intervals hold only if the model is right")
        assert f.widened > 1


@pytest.mark.parametrize("name", ["a lamp 10 % too weak", "Beckmann as GGX", "stray light"])
def test_small_misfits_are_told(name):
    assert all(f.misfit.told for f in drawn(OWN[name], 3, 22))


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_small_misfits_are_told_in_nine_of_ten(name):
    found = drawn(OWN[name], 20, 23)
    line(name, found)
    assert 1.4 < np.median([f.misfit.ratio for f in found]) < 3.2
    assert sum(f.misfit.told for f in found) >= 18


def test_a_weak_lamp_is_named_and_an_anisotropic_ball_by_its_azimuth():
    f = drawn(OWN["a lamp 10 % too weak"], 1, 24)[0]
    assert min(f.misfit.structure, key=lambda x: x.p).name == "light"
    assert f.misfit.where == "at light 3"
    f = drawn(OWN["anisotropy .2/.25 as isotropic"], 1, 24)[0]
    assert next(x for x in f.misfit.structure if x.name == "azimuth").p < 1e-6


GOOD = {
    "lambert": {"kd": (0.1, 0.9)},
    "oren-nayar": {"kd": (0.3, 0.8), "sigma": (0.2, 0.6)},
    "lambert+ggx": {"kd": (0.1, 0.5), "ks": (0.5, 1.0), "alpha": (0.1, 0.4)},
    "ggx-mirror": {"ks": (0.3, 1.0), "alpha": (0.1, 0.5)},
    "lambert+ggx-schlick": {"kd": (0.1, 0.5), "F0": (0.03, 0.1), "alpha": (0.1, 0.4)},
    "lambert+blinn-phong": {"kd": (0.1, 0.5), "ks": (0.1, 0.4), "exponent": (10.0, 80.0)},
}


def good(count, seed, lights, each, **options):
    """Fits of random materials by their own model, with read noise and photon noise, each another sphere."""
    rng = np.random.default_rng(seed)
    names = list(GOOD)
    for k in range(count):
        name = names[k % len(names)]
        truth = {n: float(rng.uniform(*span)) for n, span in GOOD[name].items()}
        s = sphere(lights, each, rng)
        value = of(name, **truth)(s)
        y = value * s.wi[:, 2]
        sd = np.sqrt((0.01 * np.sqrt(np.mean(y**2))) ** 2 + (0.01**2 * y.mean()) * y)
        yield (
            name,
            truth,
            s,
            sd,
            fit(noisy(s, value, sd, rng), name, starts=1, start=truth, warn=False, seed=k, **options),
        )


def check_uniform(count, seed):
    found = [f.misfit for *_, f in good(count, seed, 8, 30)]
    by = {"chi2": [m.p for m in found]}
    for m in found:
        for s in m.structure:
            by.setdefault(s.name, []).append(s.p)
    chances = {name: stats.kstest(p, "uniform").pvalue for name, p in by.items()}
    told = sum(m.told for m in found)
    print(f"{count} good fits: KS p { ({n: round(float(c), 3) for n, c in chances.items()}) }, told {told}")
    assert min(chances.values()) > 0.005
    assert told <= stats.binom.ppf(0.999, count, 2e-3)


def test_p_is_uniform_over_good_fits_few():
    check_uniform(60, 31)


@pytest.mark.slow
def test_p_is_uniform_over_a_thousand_good_fits():
    check_uniform(1000, 32)


def bound(name, truth, s, sd):
    """Cramér–Rao: sds from the true model's derivatives by differences, none of the fit's code."""
    rows = []
    for n, value in truth.items():
        ends = [model(name).evaluate(s.wi, s.wo, {**truth, n: value * (1 + e)}).reshape(-1) for e in (1e-4, -1e-4)]
        rows.append((ends[0] - ends[1]) / (2e-4 * value) * s.wi[:, 2] / sd)
    return dict(zip(truth, np.sqrt(np.diag(np.linalg.inv(np.array(rows) @ np.array(rows).T))), strict=True))


def check_coverage(count, seed, loss):
    """Share of 95 % intervals that hold the truth, one parameter a fit drawn beforehand: cases are independent."""
    held, widths = [], []
    rng = np.random.default_rng(seed + 1)
    for name, truth, s, sd, f in good(count, seed, 12, 40, level=0.95, loss=loss):
        smallest = bound(name, truth, s, sd)
        asked = str(rng.choice(list(truth)))
        row = f.table.loc[asked]
        held.append(bool(row["lower"] <= truth[asked] <= row["upper"]))
        widths += [(f.table.loc[n, "upper"] - f.table.loc[n, "lower"]) / (2 * 1.96 * smallest[n]) for n in truth]
    share, width = np.mean(held), np.median(widths)
    print(
        f"{count} good fits, {loss}: {100 * share:.1f} % of 95 % intervals hold, median width {width:.2f} x the bound"
    )
    return share, width


def test_intervals_cover_few():
    share, width = check_coverage(40, 41, "chi2")
    assert share >= stats.binom.ppf(0.002, 40, 0.95) / 40
    assert width < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["cosine-weighted-l2", "chi2"])
def test_intervals_cover(loss):
    share, width = check_coverage(200, 42, loss)
    assert 0.915 <= share <= 0.98
    assert width < 1.5
