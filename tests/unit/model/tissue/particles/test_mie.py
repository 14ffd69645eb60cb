"""Mie: shapes, extremes, limits, refusals, the table's anisotropy, and the thesis's Figs. 3.3 and 3.4."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.particles.sphere import _miepython, mie, mie_intensity, mie_phase, size_parameter
from livlab.model.tissue.phase.functions import Rayleigh, Tabulated


def test_shapes_broadcast() -> None:
    got = mie(np.array([[1.1], [1.2 - 0.01j]]), [0.01, 0.5, 20.0])
    assert all(part.shape == (2, 3) for part in got)
    assert float(got.q_sca[1, 2]) == float(mie(1.2 - 0.01j, 20.0).q_sca)
    assert mie(1.1, 1.0).q_ext.shape == ()


@pytest.mark.parametrize(
    "m", [1.5 / 1.35, 1.0, 1.0 + 1e-12, 0.3, 0.9999, 1.5 - 1e-12j, 1.5 - 1j, 0.05 - 3j, 5.0 - 1000j, 30.0]
)
def test_no_nan_from_1e_8_to_1e5(m: complex) -> None:
    x = np.concatenate([10.0 ** np.arange(-8.0, 4.1, 0.5), [0.0999999, 0.1, 1e5]])
    got = mie(m, x)
    for part in got:
        assert np.isfinite(part).all()
    assert (got.q_sca >= 0.0).all()
    assert (got.q_ext >= got.q_sca * (1.0 - 1e-9)).all()
    assert (np.abs(got.anisotropy) <= 1.0).all()
    if complex(m).imag == 0.0:
        assert got.q_ext == pytest.approx(got.q_sca, rel=1e-12)


@pytest.mark.parametrize("m", [1.5, 1.11, 0.75, 1.5 - 0.2j, 8.0])
def test_series_meets_the_recurrence(m: complex) -> None:
    below, above = mie(m, 0.1 * (1.0 - 1e-9)), mie(m, 0.1 * (1.0 + 1e-9))
    for a, b in zip(below, above, strict=True):
        assert float(a) == pytest.approx(float(b), rel=1e-6)


@pytest.mark.parametrize("x", [0.2, 3.0, 50.0, 3000.0])
def test_matched_recurrence_meets_the_general_one(x: float) -> None:
    for m in (1.001, 0.999, 1.0 - 0.001j):
        inside, outside = mie(1.0 + (m - 1.0) * 0.99999, x), mie(1.0 + (m - 1.0) * 1.00001, x)
        assert float(inside.q_sca) == pytest.approx(float(outside.q_sca), rel=2e-4)
        assert float(inside.anisotropy) == pytest.approx(float(outside.anisotropy), abs=1e-5)


def test_matched_index_scatters_nothing_with_a_limit() -> None:
    x = np.array([1e-3, 1.0, 100.0])
    none, little = mie(1.0, x), mie(1.0 + 1e-9, x)
    assert (none.q_sca == 0.0).all()
    assert (none.q_ext == 0.0).all()
    assert none.anisotropy == pytest.approx(little.anisotropy, abs=1e-8)
    assert mie(1.0 + 2e-9, x).q_sca == pytest.approx(4.0 * little.q_sca, rel=1e-6)


def test_large_spheres_take_twice_their_shadow() -> None:
    assert mie([1.33, 1.5 - 0.1j], 1e5).q_ext == pytest.approx([2.0, 2.0], abs=2e-3)


@pytest.mark.parametrize(
    ("m", "x", "says"),
    [
        (1.5 + 0.1j, 1.0, "k >= 0"),
        (0.0, 1.0, "real part"),
        (-1.5, 1.0, "real part"),
        (float("nan"), 1.0, "finite"),
        (1.5, 0.0, "x = 0.0"),
        (1.5, -1.0, "x = -1.0"),
        (1.5, float("nan"), "x = nan"),
        (1.5, 1e7, "x = 1"),
    ],
)
def test_refusals(m: complex, x: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        mie(m, x)
    with pytest.raises(InputError, match=says):
        mie_phase(m, x)


def test_phase_refuses_arrays_and_one_angle() -> None:
    with pytest.raises(InputError, match="scalars"):
        mie_phase([1.1, 1.2], 1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="n_angles"):
        mie_phase(1.1, 1.0, n_angles=1)


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.5, 0.75, 1.5 - 0.1j, 1.0 + 1e-8, 1.0])
@pytest.mark.parametrize("x", [1e-8, 0.05, 0.5, 3.0, 29.7, 100.0, 1000.0])
def test_phase_has_the_anisotropy_of_the_coefficients(m: complex, x: float) -> None:
    phase = mie_phase(m, x)
    assert phase.anisotropy == pytest.approx(float(mie(m, x).anisotropy), abs=2e-5)
    assert phase is mie_phase(m, x)


def test_phase_peaks_forward_as_the_amplitude_says() -> None:
    m, x = 1.5, 200.0
    q = mie(m, x)
    forward = float(mie_intensity(m, x, 1.0)) / (np.pi * x**2 * float(q.q_sca))
    assert float(mie_phase(m, x).pdf(np.array(1.0))) == pytest.approx(forward, rel=1e-4)


def test_small_sphere_is_rayleigh() -> None:
    mu = np.linspace(-1.0, 1.0, 21)
    assert mie_phase(1.5, 1e-4).pdf(mu) == pytest.approx(Rayleigh().pdf(mu), rel=3e-5)


def test_figure_3_3_phase_functions() -> None:
    """Thesis Fig. 3.3: a sphere of 0.05 µm looks like Rayleigh's law, one of 0.5 µm does not."""
    mu = np.linspace(-1.0, 1.0, 181)
    small, large = (mie_phase(1.5, float(size_parameter(r, 600.0))) for r in (0.05e-3, 0.5e-3))
    off_small = np.abs(small.pdf(mu) / Rayleigh().pdf(mu) - 1.0).max()
    off_large = np.abs(large.pdf(mu) / Rayleigh().pdf(mu) - 1.0).max()
    assert off_small < 0.35
    assert off_large > 10.0


def test_figure_3_4_scattering_spectra() -> None:
    """Thesis Fig. 3.4: scattering falls as λ⁻⁴ for the small sphere only."""
    wavelength = np.array([500.0, 720.0])
    slopes = []
    for r in (0.05e-3, 0.5e-3):
        q = mie(1.5, size_parameter(r, wavelength)).q_sca
        slopes.append(float(np.log(q[1] / q[0]) / np.log(wavelength[1] / wavelength[0])))
    assert slopes[0] == pytest.approx(-4.0, abs=0.35)
    assert abs(slopes[1]) < 2.0


def test_same_values_where_nothing_can_be_cached() -> None:
    """numba refuses to decorate where it can cache nowhere; miepython must then run uncompiled, own kernels compile."""
    code = (
        "import warnings; warnings.simplefilter('ignore')\n"
        "from numba.core import caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "from livlab.model.tissue.particles.sphere import _miepython, mie\n"
        "print(_miepython().is_compiled, *(float(v) for v in mie([1.5, 1.0 + 1e-6], 3.0).q_sca))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    jit, *values = done.stdout.split()
    assert jit == "False"
    assert _miepython().is_compiled
    assert [float(v) for v in values] == pytest.approx(mie([1.5, 1.0 + 1e-6], 3.0).q_sca.tolist(), rel=1e-9)


def test_tables_are_what_transport_expects() -> None:
    phase = mie_phase(1.5 / 1.35, 10.0)
    assert isinstance(phase, Tabulated)
    chi = phase.legendre(64)
    assert chi[0] == pytest.approx(1.0, abs=1e-14)
    assert abs(chi[60]) < 1e-4
