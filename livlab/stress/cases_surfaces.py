"""Runners for surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from livlab.model.transport import fresnel as surfaces
from livlab.stress.measured import Measured, runner, values


@runner
def fresnel(n_from: Any, n_to: Any, mu: Any) -> dict[str, Measured]:
    """Reflectance of unpolarised light."""
    return values(reflectance=surfaces.fresnel(n_from, n_to, mu))


@runner
def fresnel_kernel(n_from: Any, n_to: Any, mu: Any) -> dict[str, Measured]:
    """The same in the walk's single precision, and whether the cosine behind stays within [0, 1]."""
    from livlab.model.transport.device import device
    from livlab.model.transport.walk import events as walk_events

    d = device("llvm")
    a, b, c = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (n_from, n_to, mu)))
    eta = (a / b).ravel()
    r, behind = walk_events.fresnel(
        d, d.load(d.Float, eta), d.load(d.Float, (1.0 - eta) * (1.0 + eta)), d.load(d.Float, c)
    )
    cosine = np.array(behind, dtype=np.float64)
    outside = np.count_nonzero(~((cosine >= 0.0) & (cosine <= 1.0 + 1e-6)))
    return values(reflectance=np.array(r, dtype=np.float64), outside=outside)


@runner
def fresnel_rises(n_from: float, n_to: float) -> dict[str, Measured]:
    """Values off [0, 1] and falls of R_s from normal to grazing, on 20 000 angles packed towards both ends and µ_c."""
    t = np.linspace(0.0, 1.0, 10_000)
    mu = np.unique(np.concatenate([t**4, 1.0 - t**4]))[::-1]
    s, p = surfaces.fresnel_polarised(n_from, n_to, mu)
    outside = np.count_nonzero(~((s >= 0) & (s <= 1) & (p >= 0) & (p <= 1)))
    return values(outside=outside, falls=np.count_nonzero(np.diff(s) < -1e-14))


@runner
def diffuse_fresnel(n_from: list[float], n_to: list[float]) -> dict[str, Measured]:
    """Reflectance for diffuse light."""
    return values(reflectance=[surfaces.diffuse_fresnel(a, b) for a, b in zip(n_from, n_to, strict=True)])


@runner
def plates(n: Any, mu0: float = 1.0) -> dict[str, Measured]:
    """Clear plates."""
    rows = n if isinstance(n[0], list) else [n]
    found = [surfaces.incoherent_stack(row, mu0) for row in rows]
    return values(
        reflectance=[r for r, _ in found], transmittance=[t for _, t in found], balance=[r + t for r, t in found]
    )
