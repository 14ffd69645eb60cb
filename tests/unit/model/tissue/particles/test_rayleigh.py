"""Rayleigh's law: printed value, small limit of Mie, and where it stops."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.particles.rayleigh import SIZE_LIMIT, rayleigh, rayleigh_efficiency
from livlab.model.tissue.particles.sphere import mie, size_parameter


@pytest.mark.parametrize("m", [1.5, 1.5 / 1.35, 0.8, 1.5 - 0.2j, 1.0 + 1e-9])
def test_small_limit_of_mie(m: complex) -> None:
    x = np.array([1e-6, 1e-4, 1e-3])
    assert rayleigh_efficiency(m, x) == pytest.approx(mie(m, x).q_sca, rel=3e-6)


def test_error_grows_as_x_squared() -> None:
    x = np.array([0.05, 0.1])
    off = rayleigh_efficiency(1.11, x) / mie(1.11, x).q_sca - 1.0
    assert off[1] / off[0] == pytest.approx(4.0, rel=0.02)


def test_as_printed_for_elastin() -> None:
    """Eq. 6.8 with the absolute index 1.5 at d = 0.5 µm: an efficiency of tens, and flagged."""
    x = size_parameter(0.25e-3, np.array([500.0, 720.0]), 1.35)
    printed = rayleigh(1.5, x)
    assert float(printed.q_sca[0]) == pytest.approx(8.0 / 3.0 * float(x[0]) ** 4 * (1.25 / 4.25) ** 2, rel=1e-12)
    assert float(printed.q_sca[0]) > 60.0
    assert not printed.valid.any()
    assert (printed.q_sca > 4.0 * mie(1.5, x).q_sca).all()


def test_domain_is_a_tenth_of_the_wavelength() -> None:
    assert rayleigh(1.5, [SIZE_LIMIT * 0.999, SIZE_LIMIT * 1.001]).valid.tolist() == [True, False]


def test_nothing_scatters_nothing() -> None:
    assert rayleigh_efficiency(1.0, 0.3) == 0.0
    assert rayleigh_efficiency(1.5, 0.0) == 0.0


@pytest.mark.parametrize(("m", "x"), [(-1.5, 0.1), (float("nan"), 0.1), (1.5, -0.1), (1.5, float("nan"))])
def test_refusals(m: complex, x: float) -> None:
    with pytest.raises(InputError):
        rayleigh_efficiency(m, x)
