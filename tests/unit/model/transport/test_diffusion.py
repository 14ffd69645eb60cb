"""The dipole: its integral, its limits, what it refuses."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.diffusion import diffusion, dipole_profile, dipole_total

G9 = HenyeyGreenstein(0.9)


@pytest.mark.parametrize(("mua", "reduced", "n"), [(0.01, 1.0, 1.0), (0.1, 1.5, 1.38), (2.0, 0.5, 1.5)])
def test_profile_integrates_to_the_total(mua, reduced, n):
    x, w = np.polynomial.legendre.leggauss(400)
    # r = tan²: fine near the beam, far out at the end.
    angle, w = 0.25 * math.pi * (x + 1), 0.25 * math.pi * w
    r = np.tan(angle) ** 2
    dr = 2 * np.tan(angle) / np.cos(angle) ** 2
    total = (2 * math.pi * r * dr * w) @ dipole_profile(r, mua, reduced, n)
    assert total == pytest.approx(float(dipole_total(mua, reduced, n)), rel=1e-6)


def test_far_field_decays_with_the_effective_attenuation():
    mua, reduced = 0.02, 1.0
    effective = math.sqrt(3 * mua * (mua + reduced))
    near, far = dipole_profile(np.array([60.0, 61.0]), mua, reduced, 1.38)
    # R r² e^(µ_eff r) tends to a constant; the rest is of order 1/(µ_eff r).
    assert math.log(near / far) == pytest.approx(effective + 2 * math.log(61 / 60), rel=3e-2)


def test_limits():
    assert float(dipole_total(0.0, 1.0, 1.4)) == pytest.approx(1.0)
    assert float(dipole_total(1.0, 0.0, 1.4)) == 0.0
    mismatch = dipole_total(0.1, 1.0, np.float64(1.5)), dipole_total(0.1, 1.0, 1.0)
    assert mismatch[0] < mismatch[1]
    # r² + z², not r² − z²: finite and largest on the axis.
    profile = dipole_profile(np.linspace(0, 3, 50), 0.1, 1.0, 1.4)
    assert np.isfinite(profile).all() and (np.diff(profile) < 0).all()


def test_domain_flag():
    good = diffusion(plain_stack([(1.38, 0.01, 10.0, math.inf, G9)]))
    bad = diffusion(plain_stack([(1.38, 1.0, 10.0, math.inf, G9)]))
    assert bool(good.valid[0]) and not bool(bad.valid[0])
    assert float((good.reflectance + good.specular + good.absorbed)[0]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: dipole_total(-1.0, 1.0), "absorption"),
        (lambda: dipole_total(0.0, 0.0), "reduced_scattering"),
        (lambda: dipole_total(1.0, math.inf), "reduced_scattering"),
        (lambda: dipole_profile(-1.0, 1.0, 1.0), "radius_mm"),
        (lambda: diffusion(plain_stack([(1.4, 0.1, 1.0, 1.0, G9), (1.4, 0.1, 1.0, 1.0, G9)])), "layers"),
        (lambda: diffusion(plain_stack([(1.4, 0.1, 1.0, 1.0, G9)])), "thickness"),
        (lambda: diffusion(plain_stack([(1.4, 0.0, 1.0, 50.0, G9)])), "thickness"),
        (lambda: diffusion(plain_stack([(1.4, 0.1, 1.0, math.inf, G9)]), mu0=0.0), "mu0"),
    ],
)
def test_bad_input(call, field):
    with pytest.raises(InputError, match=field):
        call()
