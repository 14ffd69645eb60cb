"""What the kernel computes in single precision, against the same in double."""

import numpy as np
import pytest

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh, kernel_table
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport import fresnel as exact
from livlab.model.transport.device import device
from livlab.model.transport.walk import events
from livlab.model.transport.walk.tables import CELLS_PER_OCTAVE, tables


@pytest.fixture(scope="module")
def d(libllvm):
    return device("llvm")


@pytest.fixture(scope="module")
def u():
    """Multiples of 2⁻²⁴, as the kernel draws them, with both ends."""
    inner = np.random.default_rng(3).integers(0, 1 << 24, 20_000)
    return np.concatenate([[0, 1, 2, (1 << 24) - 2, (1 << 24) - 1], inner]) * 2.0**-24


@pytest.mark.parametrize("g", [-0.9, -1e-4, 0.0, 1e-6, 0.5, 0.9, 0.99, 0.999])
def test_henyey_greenstein_keeps_its_digits(d, u, g):
    w = np.array(events.henyey_greenstein(d, d.Float(g), d.load(d.Float, u)), dtype=float)
    rounded = HenyeyGreenstein(float(np.float32(g)))
    assert w == pytest.approx(rounded.quantile_complement(1.0 - u), rel=2e-6, abs=1e-12)


def test_rayleigh_is_the_closed_form(d, u):
    w = np.array(events.rayleigh(d, d.load(d.Float, u)), dtype=float)
    assert w == pytest.approx(Rayleigh().quantile_complement(1.0 - u), abs=2e-6)


def test_look_up_is_that_of_the_table(d, u):
    phase = mie_phase(1.1, 25.0)
    stack = plain_stack([(1.0, 1.0, 1.0, 1.0, phase)])
    t = tables(stack, "expected")
    w = np.array(
        events.tabulated(d, t, d.load(d.Float, t.table), d.UInt32(int(t.offset[0, 0, 0])), d.load(d.Float, u)), float
    )
    table = kernel_table(phase, per_octave=CELLS_PER_OCTAVE)
    assert w == pytest.approx(table.sample_complement(u), rel=1e-6)


@pytest.mark.parametrize("phase", [HenyeyGreenstein(0.95), HenyeyGreenstein(0.99), mie_phase(1.1, 25.0)])
def test_tables_keep_the_distance_of_g_from_1(phase):
    """1e-5 of 1 − g moves a reflectance by less than 1e-5 of itself."""
    table = kernel_table(phase, per_octave=CELLS_PER_OCTAVE)
    assert (1 - table.anisotropy) / (1 - phase.anisotropy) == pytest.approx(1.0, abs=1e-5)


def test_fresnel_against_double_precision(d):
    c = np.concatenate([[1.0, 0.0, 1e-6, 1e-3], np.random.default_rng(5).random(5000)])
    for n1, n2 in [(1.0, 1.5), (1.5, 1.0), (1.38, 1.36), (1.36, 1.38), (1.4, 1.4), (1.0, 1.0 + 1e-7), (1.0, 3.0)]:
        eta = n1 / n2
        r, behind = events.fresnel(d, d.Float(eta), d.Float((1 - eta) * (1 + eta)), d.load(d.Float, c))
        c32 = np.float32(c).astype(float)
        want = exact.refracted_cosine(n1, n2, c32)
        # Near the critical angle the cosine behind is the root of a difference, so its square is what
        # single precision keeps, and the reflectance inherits the root's error.
        assert np.abs(np.array(behind, float) ** 2 - want**2).max() < 5e-7, (n1, n2)
        error = np.abs(np.array(r, float) - exact.fresnel(n1, n2, c32))
        assert (error * want)[c32 > 0].max() < 5e-7, (n1, n2)


def test_total_reflection_is_total(d):
    eta = 1.5
    c = np.linspace(0.0, 0.745, 1000)  # critical cosine 0.74536
    r, behind = events.fresnel(d, d.Float(eta), d.Float((1 - eta) * (1 + eta)), d.load(d.Float, c))
    assert (np.array(r) == 1.0).all()
    assert (np.array(behind) == 0.0).all()


def test_rotation_keeps_length_and_angle(d):
    rng = np.random.default_rng(7)
    v = rng.normal(size=(3, 4000))
    v[:, :4] = np.array([[0, 0, 1], [0, 0, -1], [1e-4, 0, 1], [1, 0, 0]]).T
    v /= np.linalg.norm(v, axis=0)
    w = 2.0 * rng.random(4000) ** 4
    phi = 2 * np.pi * rng.random(4000)
    u0 = tuple(d.load(d.Float, x) for x in v)
    out = events.rotate(d, u0, d.load(d.Float, w), d.load(d.Float, np.cos(phi)), d.load(d.Float, np.sin(phi)))
    turned = np.array([np.array(x, float) for x in out])
    assert np.linalg.norm(turned, axis=0) == pytest.approx(1.0, abs=3e-7)
    assert (turned * v).sum(0) == pytest.approx(1.0 - w, abs=6e-7)


def test_length_stays_one_over_ten_thousand_turns(d):
    dr = d.dr
    u0 = (d.Float(0.6), d.Float(0.0), d.Float(0.8))
    u0 = tuple(x + dr.zeros(d.Float, 64) for x in u0)
    rng = np.random.default_rng(9)
    state = (d.load(d.Float, rng.random(64)), d.UInt32(0), *u0)

    def body(w, k, x, y, z):
        c, s = events.turn(d, w * 0.5)
        x, y, z = events.rotate(d, (x, y, z), w, c, s)
        w = w * 3.9 * (1.0 - w)  # chaotic, so that the turns differ
        return w, k + 1, x, y, z

    *_, x, y, z = dr.while_loop(state, lambda w, k, *_: k < 10_000, body)
    assert np.array(x * x + y * y + z * z) == pytest.approx(1.0, abs=1e-6)


def test_turns_are_even(d, u):
    c, s = (np.array(x, float) for x in events.turn(d, d.load(d.Float, u)))
    assert c * c + s * s == pytest.approx(1.0, abs=1.5e-6)
    grid = (np.arange(4096) + 0.5) / 4096
    c, s = (np.array(x, float) for x in events.turn(d, d.load(d.Float, grid)))
    for moment in (c, s, c * s, c**2 - 0.5, c**3, s**3):
        assert abs(moment.mean()) < 1e-6
    one = np.array(events.cosine_of_turn(d, d.load(d.Float, grid)), float)
    assert np.sort(one) == pytest.approx(np.sort(np.cos(np.pi * grid)), abs=1e-6)


def test_isotropic_is_uniform_in_the_cosine(d, u):
    t = tables(plain_stack([(1.0, 1.0, 1.0, 1.0, Isotropic())]), "expected")
    w = np.array(events.polar(d, t, None, None, None, None, d.load(d.Float, u)), float)
    assert w == pytest.approx(2.0 * (1.0 - u), rel=1e-6)
