"""Runner that holds every solver against adding–doubling, wherever both are valid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.diffusion import diffusion, dipole_profile, dipole_total
from livlab.model.transport.kubelka_munk import kubelka_munk
from livlab.model.transport.kubelka_munk import kubelka_munk_layer as solve_layer
from livlab.stress.inputs import stack as made_stack
from livlab.stress.measured import Measured, runner, values


@runner
def solvers(
    layers: list[list[Any]], samples: int, n_above: float = 1.0, n_below: float = 1.0, angle: float = 0.0
) -> dict[str, Measured]:
    """One stack by all solvers.

    For the walks `NAME z`: differences of R, T and each layer's absorption from adding–doubling over their standard
    errors. For the approximations `NAME R`: ratio of reflectances less 1 (kubelka-munk: under diffuse light too),
    and `NAME valid`: 1 where the solver calls itself valid, 0 where it says it is not or refuses.
    """
    stack = made_stack(layers, n_above, n_below)
    exact = adding_doubling(stack, mu0=math.cos(angle))
    out: dict[str, Measured] = {}
    for estimator in ("expected", "analog"):
        out |= _walked(stack, exact, estimator, samples, angle)
    out |= _approximate("diffusion", diffusion, stack, exact, angle)
    out |= _approximate("kubelka-munk", kubelka_munk, stack, exact, angle)
    return out


def _walked(stack: OpticalStack, exact: xr.Dataset, estimator: str, samples: int, angle: float) -> dict[str, Measured]:
    from livlab.model.transport.walk import Source, walk

    r = walk(
        stack,
        samples=samples,
        seed=77,
        estimator=estimator,  # type: ignore[arg-type]
        source=Source.collimated(angle),
    )
    names = ("reflectance", "transmittance", "absorbed")
    found, error = (np.concatenate([r[f"{n}{end}"].to_numpy().ravel() for n in names]) for end in ("", "_se"))
    want = np.concatenate([exact[n].to_numpy().ravel() for n in names])
    worst = float(r.reflectance_se[0])
    return {
        f"{estimator} walk": Measured(found, error),
        f"{estimator} walk z": Measured(_scores(found, want, error), np.zeros(1)),
        f"{estimator} walk error": Measured(np.array([worst])),
    }


def _scores(found: Any, want: Any, error: Any) -> Any:
    with np.errstate(invalid="ignore", divide="ignore"):
        z = (found - want) / error
    # What no photon did has no error of its own: it must then be as good as impossible.
    return np.where(error > 0, z, np.where(np.abs(found - want) < 1e-5, 0.0, np.inf))


def _approximate(name: str, solver: Any, stack: OpticalStack, exact: xr.Dataset, angle: float) -> dict[str, Measured]:
    try:
        r = solver(stack, mu0=math.cos(angle))
    except InputError as refusal:
        return {f"{name} valid": Measured(np.zeros(1), note=refusal.message)}
    ratio = r.reflectance.to_numpy() / exact.reflectance.to_numpy() - 1.0
    out = {f"{name} valid": Measured(r.valid.to_numpy().astype(np.float64)), f"{name} R": Measured(ratio)}
    if "reflectance_diffuse_incidence" in r:
        diffuse = r.reflectance_diffuse_incidence.to_numpy() / exact.reflectance_diffuse_incidence.to_numpy() - 1.0
        out[f"{name} diffuse R"] = Measured(diffuse)
    return out


@runner
def kubelka_munk_layer(K: list[float], S: list[float], thickness: list[float]) -> dict[str, Measured]:
    """Kubelka and Munk's layer without surfaces."""
    found = [solve_layer(k, s, d) for k, s, d in zip(K, S, thickness, strict=True)]
    return values(reflectance=[r for r, _ in found], transmittance=[t for _, t in found])


@runner
def dipole(absorption: list[float], reduced: float, n: float) -> dict[str, Measured]:
    """The dipole's total, and its value where the beam enters."""
    a = np.array(absorption)
    return values(total=dipole_total(a, reduced, n), at_beam=dipole_profile(0.0, a, reduced, n))
