"""Runners for chromophores, spheroids, datasets, metrics, and for what must be refused by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from livlab import datasets, metrics
from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.particles import spheroid as spheroids
from livlab.model.tissue.particles.cylinder import cylinder, cylinder_mean, cylinder_phase
from livlab.model.tissue.particles.sphere import mie, mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Tabulated
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.fresnel import fresnel
from livlab.stress.inputs import curve, stack
from livlab.stress.measured import Measured, index, runner, values


@runner
def packaging(radius_mm: Any, sigma: Any) -> dict[str, Measured]:
    """The packaging factor, and how often it rises or leaves [0, 1] over 1000 depths from 1e-300 to 1e300."""
    rows = np.broadcast_arrays(np.asarray(radius_mm, dtype=np.float64), np.asarray(sigma, dtype=np.float64))
    found = [float(chromophores.packaging(float(r), np.array([float(s)]))[0]) for r, s in np.nditer(rows)]
    swept = chromophores.packaging(0.5, np.geomspace(1e-300, 1e300, 1000))
    bad = np.count_nonzero(np.diff(swept) > 0) + np.count_nonzero(~((swept >= 0) & (swept <= 1)))
    return values(factor=found, violations=bad)


@runner
def spheroid(a: Any, b: Any) -> dict[str, Measured]:
    """The shape term."""
    rows = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    return values(term=[spheroids.surface_term(float(p), float(q)) for p, q in np.nditer(rows)])


@runner
def penalised(sigma_per_mm: list[float]) -> dict[str, Measured]:
    """The penalised rate of the hepatocyte."""
    return values(rate=spheroids.penalised_rate(np.array(sigma_per_mm)))


@runner
def dataset_ends() -> dict[str, Measured]:
    """Every spectrum at its first and last wavelength, a float's step beyond them, and a millionth beyond.

    `wrong`: answers at (or a step beyond) an end that are not the table's own entry. `accepted`: wavelengths
    farther outside, or none at all, that were answered.
    """
    wrong, accepted, seen = 0, 0, 0
    for name in datasets.names():
        table = datasets.load(name)
        for column in table.value_columns if table.is_spectrum else ():
            entries = table.column(column)
            low, high = table.range_nm
            ends = np.array([low, np.nextafter(low, 0.0), high, np.nextafter(high, np.inf)])
            got = table.interpolate(column, ends)
            wrong += int(np.count_nonzero(got != entries[[0, 0, -1, -1]]))
            for w in (low * (1 - 1e-6), high * (1 + 1e-6), math.nan):
                accepted += not _refused(partial(table.interpolate, column, np.array([w])))
            seen += 1
    return values(wrong=wrong, accepted=accepted, seen=float(seen > 0))


@runner
def pearson(level: Any, variation: Any, noise: float, points: int) -> dict[str, Measured]:
    """Pearson's coefficient of curves that hardly vary."""
    rows = np.broadcast_arrays(np.asarray(level, dtype=np.float64), np.asarray(variation, dtype=np.float64))
    return values(
        pearson=[metrics.pearson(*curve(float(top), float(part), noise, points)) for top, part in np.nditer(rows)]
    )


@runner
def flat_objective(points: int = 111) -> dict[str, Measured]:
    """Distances of constant curves: exact zeros and exact steps, whatever the level; refusals where none exists."""
    levels = (1e-300, 1e-8, 0.1, 1.0, 1e8, 1e300)
    same = [metrics.rmse(np.full(points, x), np.full(points, x)) for x in levels]
    steps = [metrics.rmse(np.full(points, x), np.zeros(points)) / x for x in levels]
    refused = 0
    for attempt in (
        lambda: metrics.pearson(np.full(points, 0.1), np.linspace(0.0, 1.0, points)),
        lambda: metrics.pearson(np.linspace(0.0, 1.0, points), np.full(points, 0.1)),
        lambda: metrics.amplitude_ratio(np.linspace(0.0, 1.0, points), np.full(points, 0.1)),
        lambda: metrics.normalise(np.zeros(points)),
    ):
        refused += _refused(attempt)
    return values(same=same, step=steps, refused=refused)


@runner
def refusals(attempts: list[list[Any]]) -> dict[str, Measured]:
    """How many of the attempts [function, field, arguments…] are refused by an error that names the field."""
    found = [_refused(partial(_ATTEMPTS[a[0]], *a[2:]), a[1]) for a in attempts]
    missed = [f"{a[0]}{tuple(a[2:])!r}" for a, good in zip(attempts, found, strict=True) if not good]
    return {"refused": Measured(np.array([float(np.mean(found))]), note="; ".join(f"accepted: {x}" for x in missed))}


_ATTEMPTS: dict[str, Callable[..., Any]] = {
    "mie": lambda m, x: mie(index(m), x),
    "mie_phase": lambda m, x: mie_phase(index(m), x),
    "cylinder": lambda m, x, zeta: cylinder(index(m), x, zeta),
    "cylinder_mean": lambda m, x: cylinder_mean(index(m), x),
    "cylinder_phase": lambda m, x: cylinder_phase(index(m), x),
    "fresnel": fresnel,
    "henyey_greenstein": HenyeyGreenstein,
    "tabulated": Tabulated,
    "packaging": lambda r, s: chromophores.packaging(r, np.array([s])),
    "blood": lambda f, s, r: chromophores.blood(f, np.array([s]), r),
    "spheroid": spheroids.surface_term,
    "penalised": lambda s: spheroids.penalised_rate(np.array([s])),
    "stack": lambda *layers: stack(list(layers)),
    "ledger": lambda *layers: _record(list(layers)),
    "adding_doubling": lambda mu0: adding_doubling(stack([[1.0, 1.0, 1.0, 1.0, 0.0]]), mu0=mu0),
    "pearson": lambda level, variation: metrics.pearson(*curve(level, variation, 0.1, 50)),
    "rmse": metrics.rmse,
}


def _record(layers: list[list[Any]]) -> Any:
    from livlab.model.transport.ledger.record_ledger import record

    return record(stack(layers), samples=2000, check_bias=False)


def _refused(attempt: Callable[[], Any], field: str = "") -> bool:
    """Whether an attempt is refused by livlab's own error, naming the field."""
    try:
        attempt()
    except InputError as error:
        return field in error.message and bool(error.remedy)
    return False
