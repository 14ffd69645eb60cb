"""Closed forms in many digits: surfaces, spheroids, packaging, phase functions, curves."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from livlab.stress.inputs import curve

from .precise import mpmath, spread

DIGITS = 50


def fresnel(n_from: Any, n_to: Any, mu: Any) -> dict[str, list[Any]]:
    """Reflectance of unpolarised light at the very doubles given (Born & Wolf 1999, section 1.5.2)."""
    mp = mpmath()
    with mp.workdps(DIGITS):
        return {"reflectance": [_fresnel(mp, *map(mp.mpf, row)) for row in spread(n_from, n_to, mu)]}


def _fresnel(mp: Any, n1: Any, n2: Any, c1: Any) -> Any:
    if n1 == n2:
        return mp.mpf(0)
    square = 1 - (n1 / n2) ** 2 * (1 - c1**2)
    if square <= 0 or c1 == 0:
        return mp.mpf(1)
    c2 = mp.sqrt(square)
    r_s = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2)
    r_p = (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
    return +((r_s**2 + r_p**2) / 2)


def diffuse_fresnel(n_from: Any, n_to: Any) -> dict[str, list[Any]]:
    """2 ∫ R(µ) µ dµ by tanh–sinh quadrature, broken at the critical angle."""
    mp = mpmath()
    out = []
    with mp.workdps(25):
        for n1, n2 in spread(n_from, n_to):
            a, b = mp.mpf(n1), mp.mpf(n2)
            edge = mp.sqrt(1 - (b / a) ** 2) if b < a else mp.mpf(0)
            inner = mp.quad(lambda c, a=a, b=b: 2 * c * _fresnel(mp, a, b, c), [edge, (edge + 1) / 2, 1])
            out.append(edge**2 + inner)
    return {"reflectance": out}


def plates(n: Any, mu0: float = 1.0) -> dict[str, list[Any]]:
    """Reflectance and transmittance of clear plates whose reflections add up as powers (Stokes 1862)."""
    mp = mpmath()
    out: dict[str, list[Any]] = {"reflectance": [], "transmittance": []}
    with mp.workdps(DIGITS):
        for row in n if isinstance(n[0], list) else [n]:
            indices = [mp.mpf(x) for x in row]
            sine = indices[0] * mp.sqrt(1 - mp.mpf(mu0) ** 2)
            r_below, t_below = mp.mpf(0), mp.mpf(1)
            for n1, n2 in reversed(list(pairwise(indices))):
                r = _fresnel(mp, n1, n2, mp.sqrt(1 - (sine / n1) ** 2))
                r_below, t_below = (
                    r + (1 - r) ** 2 * r_below / (1 - r * r_below),
                    (1 - r) * t_below / (1 - r * r_below),
                )
            out["reflectance"].append(r_below)
            out["transmittance"].append(t_below)
    return out


def packaging(radius_mm: Any, sigma: Any) -> dict[str, list[Any]]:
    """C = (1 − e^(−2Rσ))/(2Rσ), 1 at 0 and 0 at infinity (Nunes 2019, eq. 6.13)."""
    mp = mpmath()
    out = []
    with mp.workdps(DIGITS):
        for R, s in spread(radius_mm, sigma):
            depth = 2 * mp.mpf(R) * mp.mpf(s) if s else mp.mpf(0)
            out.append(mp.mpf(1) if depth == 0 else mp.mpf(0) if mp.isinf(depth) else -mp.expm1(-depth) / depth)
    return {"factor": out}


def spheroid(a: Any, b: Any) -> dict[str, list[Any]]:
    """a/b + asin(c)/c, c = √(1 − a²/b²), and its continuation for a > b (Nunes 2019, eq. 6.16, 6.17)."""
    mp = mpmath()
    out = []
    with mp.workdps(DIGITS):
        for p, q in spread(a, b):
            ratio = mp.mpf(p) / mp.mpf(q)
            c = mp.sqrt(mp.mpc(1 - ratio**2))
            out.append(ratio + (mp.mpf(1) if c == 0 else mp.re(mp.asin(c) / c)))
    return {"term": out}


def penalised(sigma_per_mm: Any) -> dict[str, list[Any]]:
    """1/log10(σ_t + 1) with σ_t and the rate in 1/cm, turned to 1/mm; 0 at 0 (Nunes 2019, eq. 6.19)."""
    mp = mpmath()
    with mp.workdps(DIGITS + 300):
        return {"rate": [1 / mp.log10(1 + 10 * mp.mpf(s)) / 10 if s else mp.mpf(0) for s in sigma_per_mm]}


def quantile(phase: list[Any], v: list[float]) -> dict[str, list[Any]]:
    """The 1 − cos θ below which a share v of the light is scattered: Henyey–Greenstein, Rayleigh, isotropic."""
    mp = mpmath()
    with mp.workdps(700):  # 1 - cos of 1e-308
        kind, g = phase[0], mp.mpf(phase[1]) if len(phase) > 1 else mp.mpf(0)
        out = []
        for share in map(mp.mpf, v):
            if kind == "rayleigh":
                p = (4 - 8 * share) / 2
                root = mp.sqrt(p * p + 1)
                out.append(1 - (mp.cbrt(p + root) - mp.cbrt(root - p)))
            elif g == 0:
                out.append(2 * share)
            else:
                t = (1 - g**2) / (1 + g - 2 * g * share)
                out.append(1 - (1 + g**2 - t**2) / (2 * g))
        return {"complement": [x if abs(x) > mp.mpf(10) ** -600 else mp.mpf(0) for x in out]}


def peak(width: list[float]) -> dict[str, list[Any]]:
    """1 − g of a peak falling linearly to 0 over `width` in 1 − cos θ, on a floor a millionth as high over the rest."""
    mp = mpmath()
    with mp.workdps(DIGITS):
        out = []
        for w in map(mp.mpf, width):
            floor = mp.mpf(1e-6)
            # From w = 0 at height 1 down to the floor at w, then flat to 2.
            mass = w * (1 + floor) / 2 + floor * (2 - w)
            first = w**2 * (1 + 2 * floor) / 6 + floor * (4 - w**2) / 2
            out.append(first / mass)
        return {"one_less_anisotropy": out}


def pearson(level: Any, variation: Any, noise: float, points: int) -> dict[str, list[Any]]:
    """Pearson's coefficient of the very doubles that `inputs.curve` makes."""
    mp = mpmath()
    with mp.workdps(DIGITS):
        out = []
        for top, part in spread(level, variation):
            a, b = ([mp.mpf(float(x)) for x in c] for c in curve(top, part, noise, points))
            da, db = ([x - mp.fsum(c) / len(c) for x in c] for c in (a, b))
            covariance = mp.fsum(x * y for x, y in zip(da, db, strict=True))
            out.append(covariance / mp.sqrt(mp.fsum(x * x for x in da) * mp.fsum(x * x for x in db)))
        return {"pearson": out}


def beer(absorption: float, thickness: Any) -> dict[str, list[Any]]:
    """Transmittance e^(−µ_a d) and absorption of an index-matched absorber."""
    mp = mpmath()
    with mp.workdps(DIGITS):
        depths = [mp.mpf(absorption) * mp.mpf(d) for (d,) in spread(thickness)]
        return {"transmittance": [mp.exp(-t) for t in depths], "absorbed": [-mp.expm1(-t) for t in depths]}
