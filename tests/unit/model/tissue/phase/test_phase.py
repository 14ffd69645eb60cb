"""Phase functions: closed forms, limits, tables, mixtures, and what they refuse."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import (
    HenyeyGreenstein,
    Isotropic,
    PhaseMixture,
    Rayleigh,
    Tabulated,
    kernel_table,
    mixture,
)

U = np.linspace(0.0, 1.0, 10_001)[:-1]
ALL = [
    Isotropic(),
    Rayleigh(),
    HenyeyGreenstein(0.0),
    HenyeyGreenstein(-0.7),
    HenyeyGreenstein(0.95),
    HenyeyGreenstein(0.9999),
    Tabulated([-1.0, -0.2, 0.5, 1.0], [0.3, 0.0, 1.0, 4.0]),
    mixture([HenyeyGreenstein(0.95), Rayleigh()], [3.0, 1.0]),
]


@pytest.mark.parametrize("phase", ALL, ids=repr)
def test_protocol_and_normalisation(phase: Phase) -> None:
    assert isinstance(phase, Phase)
    edges = 1.0 - np.concatenate([[0.0], np.geomspace(1e-10, 2.0, 60)])
    total = sum(quad(lambda c: float(phase.pdf(np.array(c))), b, a)[0] for a, b in itertools.pairwise(edges))
    assert 2.0 * math.pi * total == pytest.approx(1.0, abs=2e-7)
    assert phase.cdf(np.array([-1.0, 1.0])) == pytest.approx([0.0, 1.0], abs=1e-15)
    assert phase.legendre(1) == pytest.approx([1.0, phase.anisotropy], abs=1e-12)


@pytest.mark.parametrize("phase", ALL, ids=repr)
def test_sample_inverts_cdf(phase: Phase) -> None:
    mu = phase.sample(U)
    assert (np.diff(mu) >= 0.0).all()
    # A cosine near 1 carries an error of 1e-16, the cdf's slope there times that is the best one can ask.
    slope = 2.0 * math.pi * float(phase.pdf(np.array(1.0)))
    assert np.abs(phase.cdf(mu) - U).max() <= 1e-13 + 4e-16 * slope


def test_henyey_greenstein_keeps_its_digits() -> None:
    import mpmath as mp

    for g in (1e-14, -1e-9, 0.3, 0.9999, -0.9999):
        phase = HenyeyGreenstein(g)
        for v in (1e-9, 0.2, 0.9):
            w = float(phase.quantile_complement(np.array(v)))
            with mp.workdps(40):
                exact_g = mp.mpf(g)
                mu = 1 - mp.mpf(w)
                below = (1 - exact_g**2) / (2 * exact_g)
                below *= 1 / mp.sqrt(1 + exact_g**2 - 2 * exact_g * mu) - 1 / (1 + exact_g)
                # w itself is rounded: a peak at w = 2 cannot keep more than this.
                rounding = 2.3e-16 * w * 2.0 * math.pi * float(phase.pdf_complement(np.array(w))) / v
                assert abs(float((1 - below) / v - 1)) <= 2e-14 + 2.0 * rounding
                p = (1 - exact_g**2) / (4 * mp.pi * (1 + exact_g**2 - 2 * exact_g * mu) ** mp.mpf(1.5))
            assert float(phase.pdf_complement(np.array(w))) == pytest.approx(float(p), rel=1e-11)


def test_henyey_greenstein_at_zero_is_isotropic() -> None:
    phase, flat = HenyeyGreenstein(0.0), Isotropic()
    mu = np.linspace(-1.0, 1.0, 11)
    assert phase.pdf(mu) == pytest.approx(flat.pdf(mu), rel=1e-15)
    assert phase.sample(U) == pytest.approx(flat.sample(U), abs=1e-15)
    assert phase.legendre(3) == pytest.approx([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("g", [1.0, -1.0, 2.0, math.nan])
def test_henyey_greenstein_refuses(g: float) -> None:
    with pytest.raises(InputError, match=r"HenyeyGreenstein\.g"):
        HenyeyGreenstein(g)


def test_rayleigh_moments() -> None:
    assert Rayleigh().legendre(4) == pytest.approx([1.0, 0.0, 0.1, 0.0, 0.0], abs=1e-15)
    assert Rayleigh().legendre(0) == pytest.approx([1.0])


def test_table_of_a_straight_line() -> None:
    # p ∝ 1 + µ: cdf (1 + µ)²/4, g = 1/3, all higher moments 0.
    phase = Tabulated([-1.0, 1.0], [0.0, 7.0])
    mu = np.linspace(-1.0, 1.0, 9)
    assert phase.cdf(mu) == pytest.approx((1.0 + mu) ** 2 / 4.0, abs=1e-15)
    assert phase.sample(U) == pytest.approx(2.0 * np.sqrt(U) - 1.0, abs=1e-14)
    assert phase.legendre(6) == pytest.approx([1.0, 1.0 / 3.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-14)


def test_table_takes_either_order_and_any_scale() -> None:
    up = Tabulated([-1.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    down = Tabulated([1.0, 0.0, -1.0], [30.0, 20.0, 10.0])
    assert up == down
    assert hash(up) == hash(down)
    assert up != Tabulated([-1.0, 0.0, 1.0], [1.0, 2.0, 4.0])
    assert down.cos_theta == pytest.approx([1.0, 0.0, -1.0])


def test_table_moments_are_exact() -> None:
    # Integrals of a straight line times P_l in closed form, in 60 digits.
    import mpmath as mp

    w = np.concatenate([[0.0], np.geomspace(1e-9, 2.0, 40)])
    p = 1.0 / (1e-6 + w) ** 1.5
    phase = Tabulated.from_complement(w, p)
    order = 300
    chi = phase.legendre(order)
    with mp.workdps(60):
        mu = [1 - mp.mpf(float(v)) for v in phase.complement]
        values = [mp.mpf(float(v)) for v in phase.values]

        def second(n: int, t: mp.mpf) -> mp.mpf:  # ∫∫ P_n, from P_n = (P'_{n+1} − P'_{n−1})/(2n + 1)
            up = (mp.legendre(n + 2, t) - mp.legendre(n, t)) / (2 * n + 3)
            low = (mp.legendre(n, t) - mp.legendre(n - 2, t)) / (2 * n - 1)
            return (up - low) / (2 * n + 1)

        for n in (2, 17, order):
            at = [second(n, t) for t in mu]
            exact = mp.mpf(0)
            for k in range(len(mu) - 1):
                slope = (values[k + 1] - values[k]) / (mu[k + 1] - mu[k])
                exact -= slope * (at[k] - at[k + 1])
            assert chi[n] == pytest.approx(float(2 * mp.pi * exact), abs=1e-11)


@pytest.mark.parametrize(
    ("cosines", "values", "says"),
    [
        ([-1.0, 1.0], [1.0, -1.0], "pdf = -1.0"),
        ([-1.0, 1.0], [1.0, math.nan], "pdf = nan"),
        ([-1.0, 1.0], [1.0, math.inf], "pdf = inf"),
        ([-1.0, 1.0], [0.0, 0.0], "zero everywhere"),
        ([-1.0, 0.5, 0.5, 1.0], [1.0] * 4, "strictly monotonic"),
        ([-1.0, 0.5, 0.2, 1.0], [1.0] * 4, "strictly monotonic"),
        ([-0.9, 1.0], [1.0, 1.0], "span all angles"),
        ([-1.0, 0.0, 1.0], [1.0, 1.0], "equal length"),
        ([1.0], [1.0], "equal length"),
        ([-1.0, math.nan, 1.0], [1.0] * 3, "strictly monotonic"),
    ],
)
def test_table_refuses(cosines: list[float], values: list[float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Tabulated(cosines, values)


def test_table_cannot_be_changed() -> None:
    phase = Tabulated([-1.0, 1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="read-only"):
        phase.values[0] = 2.0


def test_arguments_outside_are_refused() -> None:
    for phase in ALL:
        with pytest.raises(InputError, match=r"cos_theta = 1\.5"):
            phase.pdf(np.array([0.0, 1.5]))
        with pytest.raises(InputError, match="u = nan"):
            phase.sample(np.array([math.nan]))
        with pytest.raises(InputError, match="order = -1"):
            phase.legendre(-1)


def test_mixture_simplifies() -> None:
    a, b, c = HenyeyGreenstein(0.9), Isotropic(), Rayleigh()
    assert mixture([], []) == Isotropic()
    assert mixture([a, b], [0.0, 0.0]) == Isotropic()
    assert mixture([a, b], [0.0, 2.0]) is b
    assert mixture([a, HenyeyGreenstein(0.9)], [1.0, 2.0]) == a
    nested = mixture([mixture([a, b], [1.0, 1.0]), b, c], [2.0, 1.0, 1.0])
    assert nested == PhaseMixture((a, b, c), (0.25, 0.5, 0.25))
    assert hash(nested) == hash(mixture([a, b, c], [1.0, 2.0, 1.0]))
    assert mixture([a, b], [1e-320, 1.0]) == b or mixture([a, b], [1e-320, 1.0]).anisotropy < 1e-300


@pytest.mark.parametrize("weight", [-1.0, math.nan, math.inf])
def test_mixture_refuses(weight: float) -> None:
    with pytest.raises(InputError, match="weights"):
        mixture([Isotropic(), Rayleigh()], [1.0, weight])
    with pytest.raises(InputError, match="2 entries"):
        mixture([Isotropic(), Rayleigh()], [1.0])


def test_mixture_is_the_weighted_mean() -> None:
    parts = [HenyeyGreenstein(0.99), Rayleigh(), Tabulated([-1.0, 1.0], [1.0, 0.0])]
    phase = mixture(parts, [2.0, 1.0, 1.0])
    mu = np.linspace(-1.0, 1.0, 7)
    assert phase.pdf(mu) == pytest.approx(0.5 * parts[0].pdf(mu) + 0.25 * (parts[1].pdf(mu) + parts[2].pdf(mu)))
    assert phase.anisotropy == pytest.approx(0.5 * 0.99 - 0.25 / 3.0)


PEAKED = [*ALL, mixture([HenyeyGreenstein(0.9999), Isotropic()], [1.0, 1e-3])]


@pytest.mark.parametrize("phase", PEAKED, ids=repr)
@pytest.mark.parametrize("per_octave", [16, 64])
def test_kernel_table_keeps_its_bound(phase: Phase, per_octave: int) -> None:
    table = kernel_table(phase, octaves=16, per_octave=per_octave)
    rng = np.random.default_rng(5)
    ends = 10.0 ** rng.uniform(-4.8, -0.4, 20_000)
    u = np.concatenate([ends, 1.0 - ends, [0.0, 0.5, 0.5 - 2.0**-25]]).astype(np.float32)
    w = table.sample_complement(u).astype(np.float64)
    assert ((w >= 0.0) & (w <= 2.0)).all()
    forward = phase.cdf_complement(np.minimum(w, 2.0))  # type: ignore[attr-defined]
    tail = np.minimum(u, np.float32(1.0) - u).astype(np.float64)
    error = np.abs((1.0 - forward) - u.astype(np.float64))
    assert (error <= tail / per_octave + 1e-6).all()
    if per_octave == 64:
        table = kernel_table(phase)
        assert abs(table.anisotropy - phase.anisotropy) <= 2e-4 * (1.0 - abs(phase.anisotropy))


def test_kernel_table_index_is_the_float_pattern() -> None:
    table = kernel_table(HenyeyGreenstein(0.8), octaves=8, per_octave=4)
    t = table.probabilities
    assert table.values.shape == (2, t.size + 1)
    assert table.sample_complement(t[:-1]) == pytest.approx(table.values[0, : t.size - 1], rel=1e-6)
    assert table.sample_complement(1.0 - t[1:]) == pytest.approx(table.values[1, 1 : t.size], rel=1e-6)


@pytest.mark.parametrize(("octaves", "per_octave"), [(0, 64), (61, 64), (10, 3), (10, 2048)])
def test_kernel_table_refuses(octaves: int, per_octave: int) -> None:
    with pytest.raises(InputError, match="octave"):
        kernel_table(Isotropic(), octaves=octaves, per_octave=per_octave)
