"""Exact transport where it is known in closed form, and adding–doubling at high order where it is not."""

from __future__ import annotations

from typing import Any

import numpy as np

from livlab.stress.inputs import liver, stack

from .forms import diffuse_fresnel
from .precise import mpmath, spread

NODES = 64
DIGITS = 25


def half_space(absorption: Any, scattering: Any) -> dict[str, list[Any]]:
    """Index-matched half-space of isotropic scatterers: R = 1 − H(1)√(1 − a) (Chandrasekhar 1950, ch. 5).

    Under diffuse light R = 1 − 2√(1 − a) ∫ H(µ) µ dµ.
    """
    mp = mpmath()
    out: dict[str, list[Any]] = {"reflectance": [], "absorbed": [], "reflectance_diffuse_incidence": []}
    with mp.workdps(DIGITS):
        rule = [((mp.mpf(float(x)) + 1) / 2, w) for x, w in zip(*np.polynomial.legendre.leggauss(20), strict=True)]
        for mua, mus in spread(absorption, scattering):
            a, s = mp.mpf(mua), mp.mpf(mus)
            loss = a / (a + s)
            lost = _h(mp, loss, mp.mpf(1)) * mp.sqrt(loss)
            out["absorbed"].append(lost)
            out["reflectance"].append(1 - lost)
            # µ = t⁴ smooths H's µ ln µ at 0.
            first = mp.fsum(float(w) * 2 * t**7 * _h(mp, loss, t**4) for t, w in rule)
            out["reflectance_diffuse_incidence"].append(1 - 2 * mp.sqrt(loss) * first)
    return out


def _h(mp: Any, loss: Any, mu: Any) -> Any:
    """Chandrasekhar's H function: exp(−µ/π ∫ ln(1 − aθ cot θ)/(cos²θ + µ² sin²θ) dθ), a = 1 − loss."""
    if mu == 0:
        return mp.mpf(1)

    def integrand(t: Any) -> Any:
        # 1 − aθ cot θ = (1 − θ cot θ) + loss·θ cot θ keeps its digits at both ends.
        turn = t * mp.cot(t) if t else mp.mpf(1)
        open_ = t * t / 3 + t**4 / 45 + 2 * t**6 / 945 if t < mp.mpf(10) ** -4 else 1 - turn
        return mp.log(open_ + loss * turn) / (mp.cos(t) ** 2 + (mu * mp.sin(t)) ** 2)

    edges = [mp.mpf(0), mp.mpf("1e-5"), mp.mpf("1e-4"), mp.mpf("1e-3"), mp.mpf("0.01"), mp.mpf("0.1"), mp.mpf(1)]
    edges += [mp.mpf("1.5"), mp.mpf("1.56"), mp.pi / 2]
    return mp.exp(-mu / mp.pi * mp.quad(integrand, edges))


def thin_slab(absorption: Any, scattering: Any, thickness: Any) -> dict[str, list[Any]]:
    """An index-matched slab of isotropic scatterers so thin that light scatters once; the rest is of second order."""
    mp = mpmath()
    out: dict[str, list[Any]] = {"reflectance": [], "absorbed": []}
    with mp.workdps(DIGITS):
        for mua, mus, d in spread(absorption, scattering, thickness):
            extinction = mp.mpf(mua) + mp.mpf(mus)
            depth, albedo = extinction * mp.mpf(d), mp.mpf(mus) / extinction
            small = min(mp.mpf(1) / 2, depth)

            def back(mu: Any, depth: Any = depth) -> Any:
                return mu / (1 + mu) * -mp.expm1(-depth * (1 + 1 / mu)) if mu else mp.mpf(0)

            once = albedo / 2 * mp.quad(back, [0, small, mp.sqrt(small), 1])
            out["reflectance"].append(once)
            out["absorbed"].append((1 - albedo) * -mp.expm1(-depth))
    return out


def thick_slab(scattering: Any, thickness: Any) -> dict[str, list[Any]]:
    """What passes an index-matched conservative slab of isotropic scatterers so thick that only diffusion is left.

    T = 4 K(1)/(3 (b + 2q)), K(1) = √3 H(1)/4, Hopf's q = 0.71044609 (van de Hulst 1980, section 8.3); the rest
    falls as e^(−b).
    """
    mp = mpmath()
    with mp.workdps(DIGITS):
        escape = mp.sqrt(3) / 4 * _h(mp, mp.mpf(0), mp.mpf(1))
        # q(∞) = 6/π² + 1/π ∫ (3/θ² − 1/(1 − θ cot θ)) dθ over 0 … π/2 (Hopf 1934).
        rest = mp.quad(
            lambda t: 3 / t**2 - 1 / (1 - t * mp.cot(t)) if t > 0.01 else mp.mpf(1) / 5 + t**2 / 175,
            [0, 0.01, mp.pi / 4, mp.pi / 2],
        )
        hopf = 6 / mp.pi**2 + rest / mp.pi
        depths = [mp.mpf(s) * mp.mpf(d) for s, d in spread(scattering, thickness)]
        return {"transmittance": [4 * escape / (3 * (b + 2 * hopf)) for b in depths]}


def adding_doubling(
    layers: list[list[Any]], mu0: float = 1.0, n_above: float = 1.0, n_below: float = 1.0
) -> dict[str, list[Any]]:
    """Livlab's own adding–doubling at 64 nodes an interval, four times what it takes for 1e-6.

    It is held to exact values by the cases above, and serves those that have none.
    """
    from livlab.model.transport.adding_doubling import adding_doubling as solve

    found = solve(stack(layers, n_above, n_below), mu0=mu0, nodes=NODES)
    names = ("reflectance", "transmittance", "reflectance_diffuse_incidence", "transmittance_diffuse_incidence")
    out: dict[str, list[Any]] = {name: [float(found[name][0])] for name in names}
    out["absorbed"] = [float(found.absorbed.sum())]
    out["specular"] = [float(found.specular[0])]
    for k in range(len(layers)):
        out[f"absorbed_{k}"] = [float(found.absorbed[0, k])]
    return out


def redirect_loss(
    reading: str, wavelength_nm: list[float], options: dict[str, Any] | None = None
) -> dict[str, list[Any]]:
    """What Algorithm 2's factor takes from the light in the liver, by adding–doubling.

    To transport the factor is a lower albedo. Of what a layer absorbs, the factor's share is that of its rates:
    Σ σ_i ω_i (1 − mean factor) over all absorption. Absorption of short free paths is left out of both.
    """
    from livlab.model.tissue.stack import REDIRECT_MEAN
    from livlab.model.transport.adding_doubling import adding_doubling as solve

    made = liver(reading, wavelength_nm, options)
    absorbed = solve(made, nodes=32).absorbed.to_numpy()
    found = np.zeros(len(wavelength_nm))
    for k, layer in enumerate(made.layers):
        total = np.where(layer.absorption > 0, layer.absorption, 1.0)
        for i in layer.interactions:
            found += absorbed[:, k] * i.rate * i.albedo * (1.0 - REDIRECT_MEAN[i.redirect]) / total
    return {"redirect_loss": found.tolist()}


def kubelka_munk_layer(K: list[float], S: list[float], thickness: list[float]) -> dict[str, list[Any]]:
    """Kubelka's hyperbolic form (1948): R = 1/(a + b coth bSd), T = b/(a sinh bSd + b cosh bSd), and its limits."""
    mp = mpmath()
    out: dict[str, list[Any]] = {"reflectance": [], "transmittance": []}
    with mp.workdps(400):
        for k, s, d in ((mp.mpf(x), mp.mpf(y), mp.mpf(z)) for x, y, z in zip(K, S, thickness, strict=True)):
            if s == 0:
                r, t = mp.mpf(0), mp.exp(-k * d)
            elif k == 0:
                r, t = s * d / (1 + s * d), 1 / (1 + s * d)
            else:
                a = 1 + k / s
                b = mp.sqrt(a * a - 1)
                r = 1 / (a + b * mp.coth(b * s * d))
                t = b / (a * mp.sinh(b * s * d) + b * mp.cosh(b * s * d))
            out["reflectance"].append(r)
            out["transmittance"].append(t)
    return out


def dipole(absorption: list[float], reduced: float, n: float) -> dict[str, list[Any]]:
    """Total and value at the beam's own place of the dipole (Farrell, Patterson & Wilson 1992), A by quadrature."""
    mp = mpmath()
    inside = diffuse_fresnel(n, 1.0)["reflectance"][0]
    out: dict[str, list[Any]] = {"total": [], "at_beam": []}
    with mp.workdps(50):
        mismatch = (1 + inside) / (1 - inside)
        for mua in map(mp.mpf, absorption):
            transport = mua + mp.mpf(reduced)
            albedo, effective = mp.mpf(reduced) / transport, mp.sqrt(3 * mua * transport)
            source = 1 / transport
            image = source * (1 + 4 * mismatch / 3)
            # Each pole's part of the total is the integral of z (1 + μd) e^(−μd)/d³ r dr = e^(−μz), halved.
            out["total"].append(albedo / 2 * sum(mp.exp(-effective * z) for z in (source, image)))
            out["at_beam"].append(
                albedo / (4 * mp.pi) * sum((1 + effective * z) * mp.exp(-effective * z) / z**2 for z in (source, image))
            )
    return out
