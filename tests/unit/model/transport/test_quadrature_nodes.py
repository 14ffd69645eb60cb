"""Nodes in the transverse sine: weights, order, projections of Legendre polynomials."""

import math

import numpy as np
import pytest

from livlab.model.transport.doubling import redistribution
from livlab.model.transport.quadrature import AngularGrid, gauss_legendre, lagrange, legendre_table

NORMAL = (1.0, 1.0)


@pytest.mark.parametrize("count", [4, 7, 24, 96, 200])
def test_cardinal_polynomials(count):
    at = np.concatenate([np.linspace(0, 1, 31), gauss_legendre(count)[0][:3]])
    basis = lagrange(count, at)
    np.testing.assert_allclose(basis.sum(axis=1), 1, atol=1e-12)
    nodes = gauss_legendre(count)[0]
    np.testing.assert_allclose(basis @ nodes**3, at**3, atol=1e-12)
    np.testing.assert_array_equal(lagrange(count, nodes), np.eye(count))


@pytest.mark.parametrize("indices", [(1.0,), (1.0, 1.36, 1.38), (1.0, 1 + 1e-6), (0.8, 1.0, 1.5)])
def test_fluxes_are_those_of_isotropic_radiance(indices):
    grid = AngularGrid.of(indices, 16, NORMAL)
    flux = grid.flux()
    assert flux.sum() == pytest.approx(max(indices) ** 2 / 2, rel=1e-12)
    for n in indices:
        active, mu = grid.active(grid.snap(n)), grid.cosines(grid.snap(n))
        assert len(active) == len(mu)
        assert mu[0] == pytest.approx(math.sqrt(1 - 0.0)) and flux[0] == 0.0
        assert np.all(mu[1:] > 0) and np.all(np.diff(mu[1:]) < 0)
        # Snell: n sinθ is the node, in every medium.
        assert flux[active].sum() == pytest.approx(n**2 / 2, rel=1e-12)
        solid = flux[active][1:] / (n * n * mu[1:])
        assert solid.sum() == pytest.approx(1.0, abs=3e-5)


def test_projections_are_the_integrals():
    n = 1.38
    grid = AngularGrid.of((1.0, 1.36, n), 8, (1.0, 0.6))
    table = legendre_table(grid, n, 60)
    assert table.shape == (61, grid.size)
    inside = math.sqrt(1 - (0.8 / n) ** 2)
    np.testing.assert_allclose(table[:, 0], [np.polynomial.Legendre.basis(k)(inside) for k in range(61)], atol=1e-12)
    # Σ_i V_li = ∫₀¹ P_l dµ, in closed form (P_{l−1}(0) − P_{l+1}(0))/(2l + 1).
    zero = [np.polynomial.Legendre.basis(k)(0.0) for k in range(62)]
    want = [1.0] + [(zero[k - 1] - zero[k + 1]) / (2 * k + 1) for k in range(1, 61)]
    np.testing.assert_allclose(table[:, 1:].sum(axis=1), want, atol=1e-12)


def test_beam_that_cannot_enter_a_rare_medium():
    grid = AngularGrid.of((0.8, 1.0), 8, (1.0, 0.5))
    assert grid.beam_cosine(0.8) is None
    assert grid.active(0.8)[0] == 1
    assert grid.active(1.0)[0] == 0
    assert len(grid.cosines(0.8)) == len(grid.active(0.8))


def test_grazing_beam_keeps_its_digits():
    grid = AngularGrid.of((1.0, 1.4), 8, (1.0, 1e-6))
    assert grid.beam_cosine(1.0) == pytest.approx(1e-6, rel=1e-14)


def test_near_indices_are_soft_and_equal_ones_merged():
    assert AngularGrid.of((1.0, 1.4), 8, NORMAL).soft == (0.0, 0.0)
    near = AngularGrid.of((1.0, 1 + 1e-6), 8, NORMAL)
    assert near.soft[0] > 0
    assert near.size < 2 * AngularGrid.of((1.0,), 8, NORMAL).size + 4
    assert len(AngularGrid.of((1.0, 1 + 1e-13, 1.0), 8, NORMAL).breaks) == 1


@pytest.mark.parametrize("apart", [1e-8, 1e-6, 1e-4, 1e-2])
def test_a_soft_interval_integrates_both_cosines(apart):
    """∫ µ s ds in closed form in the rarer and in the denser medium, whose cosine is almost a corner."""
    low, high, denser = 1.0, 1.4, 1.4 * (1 + apart)
    grid = AngularGrid.of((low, high, denser), 16, (low, 1.0))
    interval, count = grid.intervals[1]
    assert interval.soft > 0
    t, w = gauss_legendre(count)
    np.testing.assert_allclose(interval.place(np.sqrt(high**2 - interval.rest(t))), t, atol=1e-6)
    assert w @ interval.flux(t) == pytest.approx((high**2 - low**2) / 2, rel=1e-12)
    for n in (high, denser):
        exact = ((n * n - low * low) ** 1.5 - (n * n - high * high) ** 1.5) / (3 * n)
        assert (w * interval.flux(t)) @ interval.cosines(n, t) == pytest.approx(exact, rel=3e-9)


def test_scattering_between_nodes_stays_bounded_next_to_near_corners():
    """Tiny nodes' shares are not the rounding of large ones: with shares beyond all bounds doubling overflows."""
    rng = np.random.default_rng(5)
    moments = 0.95 ** np.arange(338)
    for _ in range(40):
        indices = [rng.uniform(1.3, 1.5)]
        for _ in range(3):
            indices.append(rng.choice(indices) * (1 + 10 ** rng.uniform(-9, -1.3) * rng.choice([-1, 1])))
        for nodes in (8, 12, 16):
            grid = AngularGrid.of((1.0, *indices), nodes, NORMAL)
            for n in grid.breaks[1:]:
                forward, backward = redistribution(grid, n, moments)
                assert min(forward.min(), backward.min()) > -4
                np.testing.assert_allclose(forward.sum(axis=0) + backward.sum(axis=0), 1.0, atol=1e-9)


def test_rounding_never_makes_a_cosine_above_one():
    rng = np.random.default_rng(2)
    for a, b in rng.uniform(0.8, 2.0, (300, 2)):
        grid = AngularGrid.of((a, b), 16, (a, 1.0))
        assert max(grid.cosines(a).max(), grid.cosines(b).max()) <= 1.0
