"""The thesis's equations of chapter 6 written out once more, number by number and in its own units."""

import cmath
import math
from functools import cache

import numpy as np
import pytest
from scipy.special import spherical_jn, spherical_yn

from livlab import datasets
from livlab.model.tissue.optics import coefficients
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS

WAVELENGTHS = (500.0, 580.0, 720.0)
CAPSULE = [(0.051, 0.192), (0.189, 0.110), (0.254, 0.001), (0.087, 0.007)]


def coefficients_ab(x, y, count):
    """a_n, b_n of eq. 3.7–3.10 with ψ = z j_n (row 1), η the particle and η_med the medium (row 13)."""
    eta, eta_med = 1.5, 1.35
    made = []
    for n in range(1, count + 1):

        def psi(z, n=n):
            return z * spherical_jn(n, z)

        def dpsi(z, n=n):
            return spherical_jn(n, z) + z * spherical_jn(n, z, derivative=True)

        def zeta(z, n=n):
            return z * (spherical_jn(n, z) - 1j * spherical_yn(n, z))

        def dzeta(z, n=n):
            return (spherical_jn(n, z) - 1j * spherical_yn(n, z)) + z * (
                spherical_jn(n, z, derivative=True) - 1j * spherical_yn(n, z, derivative=True)
            )

        a = (eta_med * dpsi(y) * psi(x) - eta * psi(y) * dpsi(x)) / (
            eta_med * dpsi(y) * zeta(x) - eta * psi(y) * dzeta(x)
        )
        b = (eta * dpsi(y) * psi(x) - eta_med * psi(y) * dpsi(x)) / (
            eta * dpsi(y) * zeta(x) - eta_med * psi(y) * dzeta(x)
        )
        made.append((a, b))
    return made


def amplitudes(theta, ab):
    """S1, S2 of eq. 3.3, 3.4 with π_n, τ_n of eq. 3.5, 3.6."""
    mu = math.cos(theta)
    pi_before, pi_now = 0.0, 1.0
    s1 = s2 = 0j
    for n, (a, b) in enumerate(ab, start=1):
        tau = n * mu * pi_now - (n + 1) * pi_before
        weight = (2 * n + 1) / (n * (n + 1))
        s1 += weight * (a * pi_now + b * tau)
        s2 += weight * (a * tau + b * pi_now)
        pi_before, pi_now = pi_now, ((2 * n + 1) * mu * pi_now - (n + 1) * pi_before) / n
    return s1, s2


@cache
def mie_efficiency(wavelength_nm):
    """Eq. 6.5, 6.6 with k in the medium, in µm."""
    wavelength = wavelength_nm / 1000
    r = 3.5 / 2
    x, y = 2 * math.pi * r * 1.35 / wavelength, 2 * math.pi * r * 1.5 / wavelength
    k = 2 * math.pi * 1.35 / wavelength
    ab = coefficients_ab(x, y, int(x + 4 * x ** (1 / 3) + 10))
    nodes, weights = np.polynomial.legendre.leggauss(120)
    total = 0.0
    for t, w in zip(nodes, weights, strict=True):
        s1, s2 = amplitudes(math.acos(t), ab)
        total += w * (abs(s1) ** 2 + abs(s2) ** 2)  # ∫ … sin θ dθ = ∫ … dcos θ
    return total / (k * k * r * r)


def collagen_per_cm(wavelength_nm, f_v):
    """Eq. 6.3, 6.7."""
    d = 3.5
    p = 4 * f_v / (math.pi * d * d)
    return mie_efficiency(wavelength_nm) * p * math.pi * (d / 2) ** 2


def elastin_per_cm(wavelength_nm, f_v):
    """Eq. 6.3, 6.8–6.10 as printed: the absolute index."""
    d = 0.5
    r = d / 2
    x = 2 * math.pi * r * 1.35 / (wavelength_nm / 1000)
    q = 8 / 3 * x**4 * abs((1.5**2 - 1) / (1.5**2 + 2)) ** 2
    p = 4 * f_v / (math.pi * d * d)
    return q * p * math.pi * r * r


def absorbers_per_cm(wavelength_nm):
    """Eq. 6.12–6.15 in 1/cm, R in cm."""
    table = datasets.load("haemoglobin_prahl")
    hbo2 = 2.303 * float(table.interpolate("hbo2", wavelength_nm)) * 150 / 64500
    hb = 2.303 * float(table.interpolate("hb", wavelength_nm)) * 150 / 64500
    sigma = 0.08 * hbo2 + (1 - 0.08) * hb
    r = 50e-4
    c = (1 - math.exp(-2 * r * sigma)) / (2 * r * sigma)
    lipid = float(datasets.load("lipid_vanveen2004").interpolate("absorption_per_cm", wavelength_nm))
    water = float(datasets.load("water_pope_fry1997").interpolate("absorption_per_cm", wavelength_nm))
    bile = float(datasets.load("bile_nachabe2011").interpolate("absorption_per_cm", wavelength_nm))
    return {
        "blood": 0.084 * sigma * c,
        "lipid_and_water": 0.779 * (0.019 * lipid + (1 - 0.019) * water),
        "bile": bile * 0.039,
    }


def hepatocyte_rate_per_cm():
    """Eq. 6.16, 6.17, 6.19 with the diameters as printed, in cm."""
    a, b = 20e-4, 30e-4
    c = cmath.sqrt(1 - a**2 / b**2)
    sigma = (3 / (2 * a) * (a / b + cmath.asin(c) / c) * 0.8 / 4).real
    return 1 / math.log10(sigma + 1)


@pytest.fixture(scope="module")
def found():
    return coefficients(load_preset("liver"), READINGS["thesis"], WAVELENGTHS) * 10


@pytest.mark.parametrize("wavelength", WAVELENGTHS)
@pytest.mark.parametrize("sublayer", range(4))
def test_the_capsule_under_the_thesis_reading(found, wavelength, sublayer):
    elastin, collagen = CAPSULE[sublayer]
    layer = found.scattering.sel(layer=f"capsule {sublayer + 1}", wavelength=wavelength)
    assert float(layer.sel(element="elastin")) == pytest.approx(elastin_per_cm(wavelength, elastin), rel=1e-12)
    assert float(layer.sel(element="collagen")) == pytest.approx(collagen_per_cm(wavelength, collagen), rel=1e-9)


@pytest.mark.parametrize("wavelength", WAVELENGTHS)
def test_the_parenchyma_under_the_thesis_reading(found, wavelength):
    layer = found.sel(layer="parenchyma", wavelength=wavelength)
    for name, value in absorbers_per_cm(wavelength).items():
        assert float(layer.absorption.sel(element=name)) == pytest.approx(value, rel=1e-12), name
        assert float(layer.scattering.sel(element=name)) == 0.0
    assert float(layer.rate.sel(element="hepatocyte")) == pytest.approx(hepatocyte_rate_per_cm(), rel=1e-12)
