"""The cylinders' phase function against the amplitudes summed directly on a grid of ζ and φ."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.particles.cylinder import cylinder_mean, cylinder_phase
from livlab.model.tissue.particles.cylinder_kernels import bessel_pair, coefficient_table

CASES = [(1.5 / 1.35, 5.0), (1.5 / 1.35, 22.7), (1.534 / 1.35, 4.2), (1.5, 0.1), (1.5 - 0.1j, 10.0), (0.75, 8.0)]


EDGES = np.array([0.999, 0.99, 0.9, 0.5, 0.0, -0.5])
ORDERS = (1, 2, 5)


def direct(m: complex, x: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares below EDGES and moments of ORDERS, from |T|² at midpoints of ζ and φ; the cell an edge cuts is shared."""
    zeta = (np.arange(600) + 0.5) / 600 * np.pi / 2
    phi = (np.arange(3600) + 0.5) / 3600 * np.pi
    inside = np.conj(complex(m))
    sine, cosine = np.sin(zeta), np.cos(zeta)
    b1, a1, a2 = coefficient_table((inside - 1) * (inside + 1), x, sine, cosine, bessel_pair(x * sine))
    n = np.arange(1, b1.shape[1])
    even, odd = 2 * np.cos(np.outer(n, phi)), 2j * np.sin(np.outer(n, phi))
    t1 = b1[:, :1] + b1[:, 1:] @ even
    t2 = a2[:, :1] + a2[:, 1:] @ even
    t3 = a1[:, 1:] @ odd
    w = (abs(t1) ** 2 + abs(t2) ** 2 + 2 * abs(t3) ** 2) * sine[:, None]
    w /= w.sum()
    mu = cosine[:, None] ** 2 + sine[:, None] ** 2 * np.cos(phi)
    moments = [(w * np.polynomial.Legendre.basis(order)(mu)).sum() for order in ORDERS]
    above = np.pad(np.cumsum(w, axis=1), ((0, 0), (1, 0)))
    shares = []
    for edge in EDGES:  # μ falls with φ, so all beyond the angle at which it meets the edge lies below
        cut = np.arccos(np.clip((edge - cosine**2) / sine**2, -1.0, 1.0)) / np.pi * phi.size
        cell = np.minimum(cut.astype(int), phi.size - 1)
        row = np.arange(zeta.size)
        shares.append(1.0 - (above[row, cell] + (cut - cell) * w[row, cell]).sum())
    return np.array(shares), np.array(moments)


@pytest.mark.parametrize(("m", "x"), CASES)
def test_shares_and_moments_are_those_of_the_amplitudes(m: complex, x: float) -> None:
    shares, moments = direct(m, x)
    phase = cylinder_phase(m, x)
    np.testing.assert_allclose(phase.cdf(EDGES), shares, rtol=0, atol=2e-4)
    for order, moment in zip(ORDERS, moments, strict=True):
        # The table promises g to 1e-4; near the forward direction 1 - P_l is l(l + 1)/2 times 1 - cos.
        assert phase.legendre(order)[order] == pytest.approx(moment, abs=1e-4 * order * (order + 1) / 2)


@pytest.mark.parametrize(("m", "x"), CASES)
def test_anisotropy_is_that_of_the_coefficients(m: complex, x: float) -> None:
    assert cylinder_phase(m, x).anisotropy == pytest.approx(float(cylinder_mean(m, x).anisotropy), abs=1e-4)


def test_bad_arguments_are_named() -> None:
    with pytest.raises(InputError, match="for a phase function"):
        cylinder_phase(1.1, 501.0)
    with pytest.raises(InputError, match="must be scalars"):
        cylinder_phase([1.1, 1.2], 5.0)  # type: ignore[arg-type]
