"""Runners for light through stacks: adding–doubling and the walk, at the ends of what they take."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr

from livlab.model.transport.adding_doubling import adding_doubling as solve
from livlab.stress.inputs import stack
from livlab.stress.measured import Measured, runner, values

_CHANNELS = ("reflectance", "specular", "transmittance", "lost", "redirect_loss", "residual")


@runner
def adding_doubling(
    layers: list[list[Any]], mu0: float = 1.0, n_above: float = 1.0, n_below: float = 1.0
) -> dict[str, Measured]:
    """Totals of one stack, and by how much its account fails to close."""
    found = solve(stack(layers, n_above, n_below), mu0=mu0)
    names = (
        "reflectance",
        "specular",
        "transmittance",
        "reflectance_diffuse_incidence",
        "transmittance_diffuse_incidence",
    )
    out = values(**{name: found[name] for name in names}, absorbed=found.absorbed.sum())
    diffuse = found.reflectance_diffuse_incidence + found.transmittance_diffuse_incidence
    balance = max(float(abs(found.residual[0])), abs(float(diffuse[0] + found.absorbed_diffuse_incidence.sum()) - 1.0))
    return out | values(total=found.reflectance + found.specular, balance=balance)


@runner
def adding_doubling_sweep(
    absorption: float | list[float], scattering: float | list[float], thickness: float | list[float]
) -> dict[str, Measured]:
    """Index-matched slabs of isotropic scatterers, one a value of the sweep."""
    rows = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (absorption, scattering, thickness)))
    found = [solve(stack([[1.0, a, s, d, 0.0]])) for a, s, d in zip(*(x.ravel() for x in rows), strict=True)]
    names = ("reflectance", "transmittance", "reflectance_diffuse_incidence")
    return values(
        **{name: [float(r[name][0]) for r in found] for name in names},
        absorbed=[float(r.absorbed.sum()) for r in found],
        balance=max(float(abs(r.residual[0])) for r in found),
    )


@runner
def adding_doubling_monotone(what: str) -> dict[str, Measured]:
    """Steps in the wrong direction: T and 1 − R over thickness, R over albedo, both over 18 decades."""
    if what == "thickness":
        made = [solve(stack([[1.4, 0.01, 0.99, d, 0.8]])) for d in np.geomspace(1e-9, 1e9, 19)]
        rise = np.array([float(r.reflectance[0]) for r in made])
        fall = np.array([float(r.transmittance[0]) for r in made])
    else:
        losses = np.concatenate([np.geomspace(1e-12, 0.5, 9), 1.0 - np.geomspace(1e-12, 0.4, 9)[::-1]])
        made = [solve(stack([[1.4, a, 1.0 - a, math.inf, 0.8]])) for a in losses]
        rise = -np.array([float(r.reflectance[0]) for r in made])
        fall = -np.array([float(r.absorbed.sum()) for r in made])
    wrong = np.count_nonzero(np.diff(rise) < -1e-7) + np.count_nonzero(np.diff(fall) > 1e-7)
    return values(violations=wrong, not_finite=np.count_nonzero(~np.isfinite(np.concatenate([rise, fall]))))


@runner
def walk(
    layers: list[list[Any]],
    samples: int,
    n_above: float = 1.0,
    n_below: float = 1.0,
    estimator: str = "expected",
    angle: float = 0.0,
    source: str = "collimated",
    seed: int = 1,
    max_steps: int = 100_000,
) -> dict[str, Measured]:
    """Totals of one stack with their standard errors; `balance`: by how much the account fails to close.

    `returned` is reflectance and residual together (where photons are given up, the truth lies between
    reflectance and it). `stated`: 1 if every error is above 0 where its value is, and not a number for one photon.
    """
    from livlab.model.transport.walk.walk import Source
    from livlab.model.transport.walk.walk import walk as solve_walk

    beam = Source.diffuse() if source == "diffuse" else Source.collimated(angle)
    r = solve_walk(
        stack(layers, n_above, n_below),
        source=beam,
        samples=int(samples),
        seed=seed,
        estimator=estimator,  # type: ignore[arg-type]
        max_steps=max_steps,
    )
    out = {name: Measured(r[name].to_numpy().ravel(), r[f"{name}_se"].to_numpy().ravel()) for name in _CHANNELS}
    out["absorbed"] = Measured(np.array([float(r.absorbed.sum())]), np.array([_root_sum(r.absorbed_se.to_numpy())]))
    for k in range(len(layers)):
        out[f"absorbed_{k}"] = Measured(r.absorbed.to_numpy()[:, k], r.absorbed_se.to_numpy()[:, k])
    diffuse = r.reflectance + r.specular
    error = np.hypot(r.reflectance_se.to_numpy(), r.specular_se.to_numpy())
    out["reflectance_diffuse_incidence"] = Measured(diffuse.to_numpy(), error)
    returned = r.reflectance + r.residual
    out["returned"] = Measured(returned.to_numpy(), np.hypot(r.reflectance_se.to_numpy(), r.residual_se.to_numpy()))
    return out | values(balance=abs(closed(r) - 1.0).max(), stated=float(_stated(r, int(samples))))


@runner
def exits_sum(samples: int) -> dict[str, Measured]:
    """Bins of exit angle and radius against the totals that they divide."""
    from livlab.model.transport.walk.walk import Tally
    from livlab.model.transport.walk.walk import walk as solve_walk

    tally = Tally(theta_edges=(0.0, 0.3, 1.0, math.pi / 2), radius_edges=(0.0, 0.1, 1.0, math.inf))
    r = solve_walk(stack([[1.4, 0.1, 10.0, 1.0, 0.9]]), tally=tally, samples=samples, seed=3)
    apart = [abs(float(r[f"{n}_binned"].sum() - r[n].sum())) for n in ("reflectance", "transmittance")]
    return values(apart=max(apart))


def closed(r: xr.Dataset) -> Any:
    """The sum of everything that light can come to, a wavelength each."""
    parts = [r[name] for name in _CHANNELS if name in r]
    return (sum(parts[1:], parts[0]) + r.absorbed.sum("layer")).to_numpy()


def _root_sum(errors: Any) -> float:
    # Layers of one photon are not independent: the plain sum bounds what the root sum estimates.
    return float(np.sum(errors))


def _stated(r: xr.Dataset, samples: int) -> bool:
    errors = [r[f"{n}_se"].to_numpy().ravel() for n in ("reflectance", "transmittance", "absorbed")]
    found = [r[n].to_numpy().ravel() for n in ("reflectance", "transmittance", "absorbed")]
    if samples == 1:
        return all(np.isnan(e).all() for e in errors)
    certain = 1.0 - float(r.specular[0])
    return all(((e > 0) | (v == 0.0) | (abs(v - certain) < 1e-6)).all() for v, e in zip(found, errors, strict=True))
