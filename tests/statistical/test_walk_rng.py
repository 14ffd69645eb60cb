"""The generator and its seeding: they pass what a known bad seeding fails."""

import numpy as np
import pytest
from scipy import stats

from livlab.model.transport import rng
from livlab.model.transport.device import device

LANES, DRAWS = 1 << 14, 8


@pytest.fixture(scope="module")
def d(libllvm):
    return device("llvm")


def draw(d, generator, count=DRAWS):
    """(count, lanes) 32-bit words."""
    return np.array([np.array(generator.next_uint32()) for _ in range(count)])


def naive(d, lanes, seed):
    """PCG32 from one start with consecutive sequence numbers: what the module's docstring warns of."""
    g = d.PCG32()
    g.state = d.UInt64(seed) + d.dr.zeros(d.UInt64, lanes)
    g.inc = (d.dr.arange(d.UInt64, lanes) << 1) | d.UInt64(1)
    return g


def streams_differ(words):
    """Smallest p value of three tests on uniforms that must not know of each other across lanes."""
    u = (words >> 8) * 2.0**-24
    p = [stats.chisquare(np.histogram(row, 64, (0, 1))[0]).pvalue for row in u]
    for lag in (1, 2, 3, 16):
        table = np.histogram2d(u[:, lag:].ravel(), u[:, :-lag].ravel(), bins=16, range=[(0, 1), (0, 1)])[0]
        p.append(stats.chisquare(table.ravel()).pvalue)
    ones = np.unpackbits(words.view(np.uint8), axis=None).mean()
    p.append(2 * stats.norm.sf(abs(ones - 0.5) * 2 * np.sqrt(words.size * 32)))
    return min(p)


@pytest.mark.parametrize("seed", [0, 1, 2, 12345, 1 << 40])
def test_streams_of_neighbouring_lanes_are_unrelated(d, seed):
    """13 p values each: one in 1500 runs of all five seeds would fall below 1e-5 by chance."""
    assert streams_differ(draw(d, rng.streams(d, LANES, seed, 0))) > 1e-5


def test_the_test_sees_a_bad_seeding(d):
    assert streams_differ(draw(d, naive(d, LANES, 42))) < 1e-12


def test_consecutive_seeds_and_batches_are_unrelated(d):
    first = [draw(d, rng.streams(d, LANES, s, b), 1)[0] for s, b in [(7, 0), (8, 0), (7, 1), (9, 0)]]
    stacked = np.array(first)
    assert len(np.unique(stacked)) > stacked.size * 0.999
    u = (stacked >> 8) * 2.0**-24 - 0.5
    r = np.corrcoef(u)[np.triu_indices(4, 1)]
    assert np.abs(r).max() * np.sqrt(LANES) < 4.5


def test_hash_is_a_bijection_and_avalanches():
    word = np.uint32
    with np.errstate(over="ignore"):
        a = np.arange(1 << 16, dtype=np.uint32)
        x0, x1 = rng.tea(a, np.zeros_like(a), word)
        assert len(np.unique(x0.astype(np.uint64) << np.uint64(32) | x1)) == a.size
        y0, y1 = rng.tea(a ^ np.uint32(1), np.zeros_like(a), word)
    flips = np.unpackbits((x0 ^ y0).view(np.uint8)).mean(), np.unpackbits((x1 ^ y1).view(np.uint8)).mean()
    assert np.abs(np.array(flips) - 0.5).max() < 4.5 * 0.5 / np.sqrt(a.size * 32)


def test_device_hash_is_the_same(d):
    a = np.arange(1000, dtype=np.uint32)
    with np.errstate(over="ignore"):
        want = rng.tea(a, a * np.uint32(77), np.uint32)
    got = rng.tea(d.dr.arange(d.UInt32, 1000), d.dr.arange(d.UInt32, 1000) * 77, d.UInt32)
    for x, y in zip(want, got, strict=True):
        assert (x == np.array(y)).all()


def test_uniform_and_exponential_at_their_ends(d):
    bits = d.UInt32(0, 1, 255, 256, 0xFFFFFFFF)
    u = np.array(rng.uniform(d, bits))
    assert u[0] == u[2] == 0.0
    assert u[-1] == np.float32(1 - 2.0**-24)
    e = np.array(rng.exponential(d, bits), float)
    assert np.isfinite(e).all()
    assert e.max() == pytest.approx(32 * np.log(2), rel=1e-6)
    assert 0 < e.min() < 1e-29


def test_exponential_is_exponential(d):
    e = np.sort(np.array(rng.exponential(d, rng.streams(d, 1 << 20, 3, 0).next_uint32()), float))
    assert stats.kstest(e, "expon").pvalue > 1e-4
    for power, want in ((1, 1.0), (2, 2.0), (3, 6.0)):
        x = e**power
        assert x.mean() == pytest.approx(want, abs=4 * x.std() / 1024)
