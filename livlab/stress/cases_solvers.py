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

    For the walks and the ledger `NAME z`: differences of R, T and each layer's absorption (the ledger: R and T) from
    adding–doubling over their standard errors. For the approximations `NAME R`: ratio of reflectances less 1
    (kubelka-munk: under diffuse light too), and `NAME valid`: 1 where the solver calls itself valid, 0 where it says
    it is not or refuses.
    """
    stack = made_stack(layers, n_above, n_below)
    exact = adding_doubling(stack, mu0=math.cos(angle))
    out: dict[str, Measured] = {}
    for estimator in ("expected", "analog"):
        out |= _walked(stack, exact, estimator, samples, angle)
    out |= _recorded(stack, exact, samples, angle)
    out |= _approximate("diffusion", diffusion, stack, exact, angle)
    out |= _approximate("kubelka-munk", kubelka_munk, stack, exact, angle)
    return out


def _walked(stack: OpticalStack, exact: xr.Dataset, estimator: str, samples: int, angle: float) -> dict[str, Measured]:
    from livlab.model.transport.walk.walk import Source, walk

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


def _recorded(stack: OpticalStack, exact: xr.Dataset, samples: int, angle: float) -> dict[str, Measured]:
    from livlab.model.transport.ledger.record_ledger import record
    from livlab.model.transport.source import Source

    ledger = record(stack, samples=samples // 4, seed=5, source=Source.collimated(angle), check_bias=False)
    r = ledger.spectrum(degenerate="mark")
    names = ("reflectance", "transmittance")
    found, error = (np.concatenate([r[f"{n}{end}"].to_numpy().ravel() for n in names]) for end in ("", "_se"))
    want = np.concatenate([exact[n].to_numpy().ravel() for n in names])
    return {
        "ledger z": Measured(_scores(found, want, error)),
        "ledger valid": Measured(r.valid.to_numpy().astype(np.float64)),
    }


@runner
def ledger_absorptions(
    absorption: list[float], scattering: float, g: float, n: float, samples: int
) -> dict[str, Measured]:
    """One recorded walk that answers for many absorptions of a half-space, against adding–doubling.

    `z` and `error` where the ledger calls itself valid; `valid`: at how many of the absorptions it does.
    """
    from livlab.model.tissue.phase.functions import HenyeyGreenstein
    from livlab.model.tissue.stack import Interaction, PlaneLayer
    from livlab.model.transport.ledger.record_ledger import record

    one = np.ones(len(absorption))
    phases = (HenyeyGreenstein(g),) * len(absorption)
    parts = (
        Interaction("absorber", np.array(absorption, dtype=np.float64), 0.0 * one, phases),
        Interaction("scatterer", scattering * one, one, phases),
    )
    wavelength = np.linspace(500.0, 600.0, len(absorption))
    stack = OpticalStack(wavelength, (PlaneLayer("bulk", math.inf, n * one, parts),), one, one)
    r = record(stack, samples=samples, seed=1, check_bias=False).spectrum(degenerate="mark")
    exact = adding_doubling(stack).reflectance.to_numpy()
    value, error, valid = (r[k].to_numpy() for k in ("reflectance", "reflectance_se", "valid"))
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.where(valid, (value - exact) / error, 0.0)
    return {
        "z": Measured(z),
        "error": Measured(np.where(valid, error, 0.0)),
        "valid": Measured(np.array([float(np.count_nonzero(valid))])),
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
