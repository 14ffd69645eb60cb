"""Infinite cylinders: shapes, extremes, limits, refusals and the averaged phase function."""

from __future__ import annotations

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.particles.cylinder import cylinder, cylinder_mean, cylinder_phase


def test_shapes_broadcast() -> None:
    got = cylinder(np.array([1.1, 1.2])[:, None, None], np.array([0.5, 3.0])[:, None], [0.3, 0.7, 1.5])
    assert all(part.shape == (2, 2, 3) for part in got)
    assert got.q_ext.shape == got.q_sca.shape == got.anisotropy.shape == (2, 2, 3)
    assert float(got.q_sca_tm[1, 0, 2]) == float(cylinder(1.2, 0.5, 1.5).q_sca_tm)
    assert cylinder_mean(1.1, [[1.0], [2.0]]).q_ext.shape == (2, 1)
    assert cylinder_mean(1.1, 1.0).anisotropy.shape == ()


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.0, 1.0 + 1e-12, 0.3, 0.5, 0.9999, 1.5 - 1e-9j, 1.5 - 1j, 0.05 - 3j, 10.0])
def test_no_nan_from_1e_6_to_1e4_at_any_angle(m: complex) -> None:
    x = np.concatenate([10.0 ** np.arange(-6.0, 3.6, 0.5), [1e4]])
    zeta = np.array([0.0, 1e-30, 1e-8, 1e-3, 0.5, math.pi / 3.0, 1.2, 0.5 * math.pi - 1e-9, 0.5 * math.pi])
    got = cylinder(m, x[:, None], zeta)
    for part in (*got, got.q_ext, got.q_sca, got.anisotropy):
        assert np.isfinite(part).all()
    assert (got.q_sca >= 0.0).all()
    assert (got.q_ext >= got.q_sca * (1.0 - 1e-8) - 1e-30).all()
    assert (np.abs(got.anisotropy) <= 1.0 + 1e-12).all()
    if complex(m).imag == 0.0:
        assert (got.q_ext == got.q_sca).all()


def test_no_step_where_the_formulas_change() -> None:
    """|q| = 1 (cos ζ with |m² − cos²ζ| = sin²ζ) and m = cos ζ: values on both sides agree."""
    for m in (0.75, 0.6):
        for zeta in (math.acos(m), math.acos(math.sqrt((1.0 + m * m) / 2.0)), 0.5 * math.pi):
            low, high = cylinder(m, 6.0, zeta - 1e-7), cylinder(m, 6.0, min(zeta + 1e-7, 0.5 * math.pi))
            for a, b in zip(low, high, strict=True):
                assert float(a) == pytest.approx(float(b), rel=2e-6)


def test_polarisations_meet_at_grazing_incidence() -> None:
    one = cylinder(1.3, 2.0, [1e-2, 1e-4, 1e-8, 1e-12])
    assert one.q_sca_tm == pytest.approx(one.q_sca_te, rel=1e-3)
    assert (np.diff(one.q_sca_tm) < 0.0).all()
    assert float(cylinder(1.3, 2.0, 0.0).q_ext) == 0.0


@pytest.mark.parametrize("zeta", [0.5, 1.0, 0.5 * math.pi])
def test_large_cylinder_takes_twice_its_shadow(zeta: float) -> None:
    """The diameter, not the shadow, is the reference: Q → 2 sin ζ."""
    for m in (1.33 - 0.05j, 1.5 - 1j):
        got = cylinder(m, 1e4, zeta)
        assert float(got.q_ext) == pytest.approx(2.0 * math.sin(zeta), rel=3e-3)
    assert float(cylinder_mean(1.5 - 1j, 2000.0).q_ext) == pytest.approx(0.5 * math.pi, rel=8e-3)


def test_matched_cylinder_has_a_limit() -> None:
    x = np.array([1e-3, 1.0, 30.0])
    none, little = cylinder_mean(1.0, x), cylinder_mean(1.0 + 1e-8, x)
    assert (none.q_ext < 1e-180).all()
    assert none.anisotropy == pytest.approx(little.anisotropy, abs=1e-6)
    assert cylinder_mean(1.0 + 2e-8, x).q_sca == pytest.approx(4.0 * little.q_sca, rel=1e-6)


@pytest.mark.parametrize(
    ("m", "x", "zeta", "says"),
    [
        (1.5 + 0.1j, 1.0, 1.0, "k >= 0"),
        (0.0, 1.0, 1.0, "real part"),
        (1.5, 0.0, 1.0, "x = 0.0"),
        (1.5, float("nan"), 1.0, "x = nan"),
        (1.5, 1.0, -0.1, "zeta = -0.1"),
        (1.5, 1.0, 1.6, "zeta = 1.6"),
        (1.5, 1.0, float("nan"), "zeta = nan"),
    ],
)
def test_refusals(m: complex, x: float, zeta: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        cylinder(m, x, zeta)


def test_phase_refusals() -> None:
    with pytest.raises(InputError, match="x = 600"):
        cylinder_phase(1.1, 600.0)
    with pytest.raises(InputError, match="scalars"):
        cylinder_phase(1.1, [1.0, 2.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.5, 0.75, 1.5 - 0.1j, 1.0])
@pytest.mark.parametrize("x", [1e-4, 0.5, 4.0, 29.7])
def test_phase_has_the_anisotropy_of_the_coefficients(m: complex, x: float) -> None:
    phase = cylinder_phase(m, x)
    assert phase.anisotropy == pytest.approx(float(cylinder_mean(m, x).anisotropy), abs=1e-4)
    assert phase is cylinder_phase(m, x)


def test_phase_grows_as_one_over_the_angle() -> None:
    """Every cone holds the forward direction: p ∝ 1/sin(Θ/2) and a share ∝ sin(Θ/2) within Θ."""
    phase = cylinder_phase(1.5 / 1.35, 5.0)
    w = 2.0 * np.sin(0.5 * np.array([1e-5, 1e-4, 1e-3])) ** 2
    p, share = phase.pdf_complement(w), phase.cdf_complement(w)
    assert p[:-1] / p[1:] == pytest.approx([10.0, 10.0], rel=5e-3)
    assert share[1:] / share[:-1] == pytest.approx([10.0, 10.0], rel=5e-3)


def test_thin_cylinder_phase_by_hand() -> None:
    """x → 0, m → 1: unpolarised dipoles, 1 + cos²Θ, on cones: p ∝ (1 + cos²Θ)/sin(Θ/2)."""
    phase = cylinder_phase(1.0 + 1e-6, 1e-4)
    mu = np.linspace(-1.0, 0.99, 40)
    shape = (1.0 + mu**2) / np.sqrt(0.5 * (1.0 - mu))
    ratio = phase.pdf(mu) / shape
    assert ratio == pytest.approx(np.full_like(ratio, ratio[0]), rel=2e-3)
