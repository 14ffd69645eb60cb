"""The walk against trusted values: published, closed forms, and adding–doubling (1e-6)."""

import math

import numpy as np
import pytest
from scipy import stats

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.walk.walk import Source, Tally, walk

pytestmark = pytest.mark.usefixtures("libllvm")

HG = HenyeyGreenstein
INF = math.inf


def capsule_on_bulk(absorption=0.5, thickness=0.1):
    return plain_stack([(1.36, 0.01, 10.0, thickness, HG(0.9)), (1.38, absorption, 15.0, 50.0, HG(0.9))])


CASES = {
    "i": (plain_stack([(1.0, 1.0, 9.0, 0.2, HG(0.75))]), 0.0973946, 0.6609577, 0.19109),
    "ii": (plain_stack([(1.5, 1.0, 9.0, INF, Isotropic())]), 0.2199186, 0.0, 0.30789),
    "iii": (capsule_on_bulk(), 0.1217318, 0.0, 0.200838),
}


def agrees(result, name, want, most, sigma=3.0):
    """Within `sigma` standard errors, and the standard error small enough for that to mean something."""
    value, error = float(result[name].to_numpy().ravel()[0]), float(result[f"{name}_se"].to_numpy().ravel()[0])
    assert error <= most, f"standard error of {name} {error:.2g} above {most:.2g}: the check has no power"
    assert abs(value - want) <= sigma * error + 1e-7, f"{name} {value:.6f} ± {error:.6f}, want {want:.6f}"


@pytest.mark.parametrize("estimator", ["expected", "analog"])
@pytest.mark.parametrize(
    ("case", "samples", "most"),
    [
        ("i", 24_000_000, 7e-5),
        ("ii", 8_000_000, 1.5e-4),
        ("iii", 2_500_000, 2.1e-4),
        pytest.param("i", 100_000_000, 3e-5, marks=pytest.mark.slow),
        pytest.param("ii", 80_000_000, 5e-5, marks=pytest.mark.slow),
        pytest.param("iii", 45_000_000, 5e-5, marks=pytest.mark.slow),
    ],
)
def test_trusted_values(case, samples, most, estimator):
    stack, reflectance, transmittance, _ = CASES[case]
    r = walk(stack, samples=samples, seed=2024, estimator=estimator)
    agrees(r, "reflectance", reflectance, most)
    agrees(r, "transmittance", transmittance, 2 * most)
    assert (r.unfinished == 0).all()


@pytest.mark.parametrize("case", list(CASES))
def test_diffuse_light(case):
    stack, *_, want = CASES[case]
    r = walk(stack, samples={"i": 4_000_000, "ii": 2_000_000, "iii": 500_000}[case], seed=5, source=Source.diffuse())
    total = float(r.reflectance[0] + r.specular[0])
    # The two parts of one photon are anticorrelated: the sum of the errors is a bound.
    error = math.hypot(float(r.reflectance_se[0]), float(r.specular_se[0]))
    assert error <= 6e-4
    assert abs(total - want) <= 3 * error


@pytest.mark.parametrize("absorption", [0.05, 5.0])
def test_what_lies_under_the_capsule_counts(absorption):
    want = {0.05: 0.462956, 5.0: 0.040643}[absorption]
    r = walk(capsule_on_bulk(absorption), samples={0.05: 100_000, 5.0: 1_000_000}[absorption], seed=3)
    agrees(r, "reflectance", want - float(r.specular[0]), 1.3e-3)


@pytest.mark.parametrize(("thickness", "want"), [(0.025, 0.134961), (0.4, 0.194291)])
def test_the_capsule_s_thickness_counts(thickness, want):
    r = walk(capsule_on_bulk(thickness=thickness), samples=1_000_000, seed=3)
    agrees(r, "reflectance", want - float(r.specular[0]), 4e-4)


@pytest.mark.parametrize(
    ("albedo", "phase", "want"),
    [
        (0.2, Isotropic(), 0.0352305),
        (0.9, Isotropic(), 0.4149475),
        (0.99, Isotropic(), 0.7527207),
        (0.9, HG(0.0), 0.4149475),
    ],
)
def test_half_space_of_isotropic_scatterers(albedo, phase, want):
    """R = 1 − H(1)√(1 − a)."""
    stack = plain_stack([(1.0, 1.0 - albedo, albedo, INF, phase)])
    agrees(walk(stack, samples=1_000_000 if albedo < 0.95 else 300_000, seed=6), "reflectance", want, 8e-4)


@pytest.mark.parametrize(("g", "reflected", "passed"), [(0.0, 0.48652, 0.49163), (0.5, 0.61996, 0.30605)])
def test_oblique_light(g, reflected, passed):
    """Van de Hulst 1980, µ0 = 1/2, a = 0.99; b = 1, and b = 4 for g = 1/2."""
    depth = 1.0 if g == 0.0 else 4.0
    stack = plain_stack([(1.0, 0.01, 0.99, depth, HG(g))])
    r = walk(stack, samples=2_000_000, seed=6, source=Source.collimated(math.pi / 3))
    agrees(r, "reflectance", reflected, 4e-4)
    agrees(r, "transmittance", passed, 4e-4)


def liver_like():
    """Four thin sublayers on a bulk, at two wavelengths, with every kind of phase function."""
    one = np.ones(2)
    mie = (mie_phase(1.5 / 1.35, 20.0), mie_phase(1.5 / 1.35, 12.0))
    top = tuple(
        PlaneLayer(
            f"c{k}",
            0.02,
            1.35 * one,
            (
                Interaction("collagen", np.array([60.0, 30.0]), one, mie),
                Interaction("elastin", (5.0 + k) * one, one, (Rayleigh(),) * 2),
                Interaction("water", (0.2 + 0.2 * k) * one, 0 * one, (Isotropic(),) * 2),
            ),
        )
        for k in range(4)
    )
    bulk = PlaneLayer(
        "bulk",
        5.0,
        np.array([1.38, 1.40]),
        (
            Interaction("blood", np.array([2.0, 0.3]), 0 * one, (Isotropic(),) * 2),
            Interaction("cell", 12.0 * one, 0.98 * one, (HG(0.9), HG(0.85))),
        ),
    )
    return OpticalStack(np.array([500.0, 700.0]), (*top, bulk), one, 1.33 * one)


@pytest.mark.parametrize("angle", [0.0, 1.0])
def test_everything_at_once_against_adding_doubling(angle):
    """Totals, what each of five layers absorbs, and the specular part; z of 13 numbers or more and their χ²."""
    stack = liver_like()
    exact = adding_doubling(stack, mu0=math.cos(angle), tolerance=1e-5)
    r = walk(stack, samples=700_000, seed=12, source=Source.collimated(angle))
    assert r.specular.values == pytest.approx(exact.specular.values, abs=1e-9)
    assert float(r.reflectance_se.max()) < 6e-4
    z = [(r[n] - exact[n]) / r[f"{n}_se"] for n in ("reflectance", "transmittance", "absorbed")]
    z = np.concatenate([x.to_numpy().ravel() for x in z])
    z = z[np.isfinite(z)]
    assert z.size >= 13
    assert np.abs(z).max() < 3.5
    assert stats.chi2.sf(np.sum(z**2), z.size) > 1e-4


def test_exit_angles_against_adding_doubling():
    """Flux into ten bands of exit angle above and below a slab, from the radiance at the quadrature's cosines."""
    stack = plain_stack([(1.4, 0.5, 10.0, 0.5, HG(0.8))], n_below=1.2)
    exact = adding_doubling(stack, tolerance=1e-6)
    edges = np.linspace(0.0, math.pi / 2, 6)
    r = walk(stack, samples=4_000_000, seed=21, tally=Tally(theta_edges=tuple(edges)))
    for binned, radiance, cosine, weight, plain in (
        ("reflectance_binned", "reflectance_angular", "mu_o", "solid_angle", "unscattered_reflectance"),
        ("transmittance_binned", "transmittance_angular", "mu_t", "solid_angle_below", "unscattered_transmittance"),
    ):
        mu, flux = exact[cosine].to_numpy(), exact[radiance].to_numpy()[0]
        order = np.argsort(mu)
        total = float(np.sum(flux * exact[weight].to_numpy())) + float(exact[plain][0])
        assert float(r[binned].sum()) == pytest.approx(total, abs=1e-3)
        fine = np.linspace(0.0, math.pi / 2, 5 * 2000 + 1)
        at = np.interp(np.cos(fine), mu[order], flux[order]) * 2 * math.pi * np.sin(fine)
        bands = np.array([np.trapezoid(at[k * 2000 : (k + 1) * 2000 + 1], dx=fine[1]) for k in range(5)])
        bands[0] += float(exact[plain][0])
        got, error = r[binned].to_numpy()[0, :, 0], r[f"{binned}_se"].to_numpy()[0, :, 0]
        assert np.abs(got - bands).max() < 3.5 * error.max() + 2e-4 * total, (binned, got - bands, error)


def test_thin_layer_on_a_thick_one_keeps_its_digits():
    """100 µm on 10 cm and on 1 km: the depth below is beyond reach, so nothing may change but noise.

    Depth from the stack's top in single precision would place photons in the kilometre to 6 cm.
    """
    results = []
    for depth in (100.0, 1e6):
        stack = plain_stack([(1.36, 0.01, 10.0, 0.1, HG(0.9)), (1.38, 0.5, 15.0, depth, HG(0.9))])
        results.append(walk(stack, samples=500_000, seed=3))
    assert results[0].reflectance.values.tobytes() == results[1].reflectance.values.tobytes()
    flipped = plain_stack([(1.0, 0.0, 0.0, 1e6, Isotropic()), (1.0, 1.0, 9.0, 0.2, HG(0.75))])
    agrees(walk(flipped, samples=2_000_000, seed=3), "reflectance", 0.0973946, 2.5e-4)


def test_scale_of_lengths_does_not_matter():
    for scale in (1e-4, 1e4):
        stack = plain_stack([(1.0, 1.0 / scale, 9.0 / scale, 0.2 * scale, HG(0.75))])
        agrees(walk(stack, samples=2_000_000, seed=4), "reflectance", 0.0973946, 2.5e-4)


def test_sides_of_a_sample_that_only_absorbs():
    """Oblique beam over the whole face: a share t/L of it has a path t to the side, so all is an integral."""
    angle, half, depth, mua = 0.7, 1.0, 5.0, 0.8
    stack = plain_stack([(1.0, mua, 0.0, depth, Isotropic())])
    source = Source.collimated(angle, square_half_width_mm=half)
    r = walk(stack, samples=1_000_000, seed=8, source=source, half_width_mm=half, estimator="analog")
    x = (np.arange(200_000) + 0.5) / 200_000 * 2 * half
    path = x / math.sin(angle)
    below = depth / math.cos(angle)
    agrees(r, "lost", float(np.mean(np.where(path < below, np.exp(-mua * path), 0.0))), 6e-4)
    agrees(r, "transmittance", float(np.mean(np.where(path >= below, math.exp(-mua * below), 0.0))), 6e-4)
    wide = walk(stack, samples=1_000_000, seed=8, source=Source.collimated(angle))
    agrees(wide, "transmittance", math.exp(-mua * below), 6e-4)


@pytest.mark.parametrize("shape", ["pencil", "square", "disc"])
def test_radius_of_what_comes_out(shape):
    """A clear plate only shifts a refracted beam; bins see a point, a square or a disc moved aside."""
    angle, depth = 0.6, 3.0
    stack = plain_stack([(1.4, 0.0, 0.0, depth, Isotropic())], n_below=1.4)
    shift = depth * math.tan(math.asin(math.sin(angle) / 1.4))
    options = {"square": {"square_half_width_mm": 1.0}, "disc": {"disc_radius_mm": 1.0}}.get(shape, {})
    edges = (0.0, 0.8, 1.2, shift - 1e-4, shift + 1e-4, 2.5, 5.0)
    r = walk(
        stack,
        samples=400_000,
        seed=5,
        source=Source.collimated(angle, **options),
        tally=Tally(radius_edges=edges),
    )
    got, error = r.transmittance_binned.to_numpy()[0, 0], r.transmittance_binned_se.to_numpy()[0, 0]
    side = (np.arange(3000) + 0.5) / 1500 - 1.0
    x, y = np.meshgrid(side, side)
    inside = x < 2.0 if shape == "square" else x**2 + y**2 < 1.0
    if shape == "pencil":
        x = y = inside = np.zeros(1)
        inside = inside == 0
    radius = np.hypot(x[inside] + shift, y[inside])
    want = np.histogram(radius, edges)[0] / radius.size * float(1 - r.specular[0])
    assert np.abs(got - want).max() < 3.5 * error.max() + 1e-4


def test_strong_peak_by_table_and_by_formula():
    """The same Henyey–Greenstein g = 0.99 as a closed form and as a look-up: 1 − g enters R directly."""
    from livlab.model.tissue.phase.functions import Tabulated

    w = np.concatenate([[0.0], np.geomspace(1e-9, 2.0, 6000)])
    w[-1] = 2.0
    table = Tabulated.from_complement(w, HG(0.99).pdf_complement(w))
    assert 1 - table.anisotropy == pytest.approx(0.01, rel=2e-4)
    results = [
        walk(plain_stack([(1.38, 0.05, 40.0, 3.0, p)]), samples=150_000, seed=s) for s, p in ((1, HG(0.99)), (2, table))
    ]
    error = math.hypot(*(float(r.reflectance_se[0]) for r in results))
    assert error < 1.2e-3
    assert abs(float(results[0].reflectance[0] - results[1].reflectance[0])) < 3 * error
