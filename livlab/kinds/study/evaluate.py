"""What the jobs of a study answer: the curve of one point, or of many points from one recorded walk."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import Solver
from livlab.acquire.instruments.spectrometer import measure
from livlab.errors import EnvironmentProblem, LivlabError
from livlab.fitting.forward import LedgerForward
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.tissue import Tissue, override

_INSTRUMENT: TypeAdapter[Any] = TypeAdapter(Instrument)
_SOLVER: TypeAdapter[Any] = TypeAdapter(Solver)


def spectrum(payload: Mapping[str, Any]) -> dict[str, Any]:
    """The curve of one point.

    Parameters
    ----------
    payload
        tissue, changes (value by path), reading, wavelengths_nm, instrument, solver, variant, without (names of
        effects left out).

    Returns
    -------
    value, standard_error (W,), seconds, samples, rung, notes; or error, the reason why there is no curve.
    """
    begun = time.perf_counter()
    try:
        reading = Reading.model_validate(payload["reading"])
        tissue = Tissue.model_validate(payload["tissue"])
        if payload["changes"]:
            tissue = override(tissue, payload["changes"], by="study")
        instrument = _INSTRUMENT.validate_python(payload["instrument"])
        stack = optical_stack(tissue, reading, np.asarray(payload["wavelengths_nm"], dtype=np.float64))
        if payload["without"]:
            from livlab.effects.catalogue import catalogue
            from livlab.effects.plan import without
            from livlab.effects.scene import OpticalScene

            scene = OpticalScene(stack, instrument)
            scene = without(scene, catalogue(scene, tissue, reading), frozenset(payload["without"]))
            stack, instrument = scene.stack, scene.instrument
        done = measure(stack, instrument, _SOLVER.validate_python(payload["solver"]), variant=payload["variant"])
    except EnvironmentProblem:
        raise  # a fault of this machine is no answer: another machine, or this one mended, can give one
    except LivlabError as error:
        return {"error": error.message, "seconds": time.perf_counter() - begun}
    value, se = done["value"].to_numpy(), done["standard_error"].to_numpy()
    if not np.isfinite(value).all():
        return {"error": "the curve is not finite", "seconds": time.perf_counter() - begun}
    return {
        "value": [float(x) for x in value],
        "standard_error": [float(x) for x in se],
        "seconds": time.perf_counter() - begun,
        "solving_seconds": float(done.attrs["seconds"]) - float(done.attrs["compile_seconds"]),
        "samples": int(done.attrs["samples"]),
        "rung": str(done.attrs["rung"]),
        "notes": [n for n in str(done.attrs["notes"]).split("\n") if n],
    }


def ledger(payload: Mapping[str, Any]) -> dict[str, Any]:
    """The curves of many points that one recorded walk serves.

    Parameters
    ----------
    payload
        tissue, reading, wavelengths_nm, instrument, variant, names (paths), centre, others (points that the walk is
        to serve), standard_error, seed, points (P, names).

    Returns
    -------
    curves, one a point, each as `spectrum` answers; recording (photons, rows, seconds).
    """
    import json

    recipe = {k: v for k, v in payload.items() if k != "points"}
    begun = time.perf_counter()
    try:
        forward = _recorded(json.dumps(recipe, sort_keys=True))
    except EnvironmentProblem:
        raise
    except LivlabError as error:
        failed = {"error": error.message, "seconds": 0.0}
        return {"curves": [failed for _ in payload["points"]], "recording": {}, "seconds": time.perf_counter() - begun}
    about = forward.recordings[-1]
    curves = [_answered(forward, dict(zip(payload["names"], point, strict=True))) for point in payload["points"]]
    return {
        "curves": curves,
        "recording": {"photons": int(str(about["photons"])), "rows": int(str(about["rows"]))},
        "seconds": time.perf_counter() - begun,
    }


def _answered(forward: LedgerForward, values: Mapping[str, float]) -> dict[str, Any]:
    begun = time.perf_counter()
    try:
        found = forward.answer(values)
    except LivlabError as error:
        return {"error": error.message, "seconds": time.perf_counter() - begun}
    if not found.valid.all() or not np.isfinite(found.value).all():
        short = ", ".join(f"{x:g}" for x in forward.wavelength_nm[~found.valid][:4])
        return {"error": f"outside what the ledger can answer at {short} nm", "seconds": time.perf_counter() - begun}
    return {
        "value": [float(x) for x in found.value],
        "standard_error": [float(x) for x in found.standard_error],
        "seconds": time.perf_counter() - begun,
        "samples": 0,
        "rung": "ledger",
        "notes": [],
    }


@lru_cache(maxsize=2)
def _recorded(recipe: str) -> LedgerForward:
    """A recorded walk; the same recipe gives the same draws, so keeping it changes no answer."""
    import json

    given = json.loads(recipe)
    forward = LedgerForward(
        Tissue.model_validate(given["tissue"]),
        Reading.model_validate(given["reading"]),
        np.asarray(given["wavelengths_nm"], dtype=np.float64),
        _INSTRUMENT.validate_python(given["instrument"]),
        given["names"],
        standard_error=given["standard_error"],
        variant=given["variant"],
    )

    def at(point: list[float]) -> dict[str, float]:
        return dict(zip(given["names"], point, strict=True))

    forward.record(at(given["centre"]), [at(p) for p in given["others"]], seed=given["seed"])
    return forward
