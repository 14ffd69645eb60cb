"""Tables and the NetCDF of a study."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.jobs.jobs import Answer
from livlab.kinds.study.ablation import AblationCase, distance
from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.config_parts import Sensitivity, Target
from livlab.kinds.study.idle import Move, changes_nothing, idle
from livlab.kinds.study.outputs import Number, Outputs, finite

if TYPE_CHECKING:
    import pandas as pd

Table = tuple[tuple[str, ...], list[dict[str, object]]]
COSTS = ("stage", "seconds", "evaluations", "samples", "solver")
NOT_REACHED = "the wanted standard error was not reached at some wavelengths; the errors shown say by how much"
MOST_NAMED = 8
"""Cases that a sentence names."""

_OWN = ("case", "label", "seconds", "error")


def result(
    config: StudyExperiment,
    points: Sequence[Mapping[str, Any]],
    curves: Sequence[Answer],
    made: Sequence[Mapping[str, Number]],
    outputs: Outputs,
    labels: Sequence[str] = (),
) -> xr.Dataset:
    """Curves (case, wavelength), outputs and factors (case)."""
    grid = config.wavelengths.grid()
    nothing = np.full(len(grid), np.nan)
    data: dict[str, Any] = {
        "reflectance": (("case", "wavelength"), np.array([c.get("value", nothing) for c in curves], dtype=float)),
        "reflectance_se": (
            ("case", "wavelength"), np.array([c.get("standard_error", nothing) for c in curves], dtype=float),
        ),
    }  # fmt: skip
    for k, f in enumerate(config.factor):
        values = [p[f.path] for p in points]
        kept = [str(v) for v in values] if f.categorical and not _numeric(values) else np.array(values, dtype=float)
        data[f"factor_{k}"] = ("case", kept, {"long_name": f.name, "path": f.path, "units": f.unit or "1"})
    for k, name in enumerate(outputs.names):
        about = {"long_name": name, "metric": config.output[k].metric}
        data[f"output_{k}"] = ("case", [m[name].value for m in made], about)
        data[f"output_{k}_se"] = ("case", [m[name].standard_error for m in made], {"long_name": f"{name}, error"})
    known = [k for k in outputs.known if k.dataset is not None]
    coords: dict[str, Any] = {
        "wavelength": ("wavelength", grid, {"units": "nm"}),
        "case": np.arange(len(curves)),
    }
    if labels:
        coords["label"] = ("case", list(labels))
    if known:
        data["reference"] = (("reference_name", "wavelength"), np.array([k.at(grid)[0] for k in known]))
        coords["reference_name"] = [k.spec.label for k in known]
    return xr.Dataset(
        data,
        coords,
        attrs={
            "method": config.method,
            "normalisation": config.normalise,
            "instrument": config.instrument.model_dump_json(),
            "solver": config.solver.model_dump_json(exclude_none=True),
            "seed": config.seed,
        },
    )


def results(
    config: StudyExperiment,
    points: Sequence[Mapping[str, Any]],
    curves: Sequence[Answer],
    made: Sequence[Mapping[str, Number]],
    labels: Sequence[str] = (),
) -> Table:
    """One row a point: its factors, its outputs, what it took, and why it failed if it did."""
    factors = [(_column(f.name), f.path) for f in config.factor]
    names = [o.name for o in config.output]
    errors = [n for n in names if any(m[n].standard_error > 0 for m in made)]
    rows: list[dict[str, object]] = []
    for k, (point, curve, numbers) in enumerate(zip(points, curves, made, strict=True)):
        row: dict[str, object] = {"case": k, **{name: point[path] for name, path in factors}}
        if labels:
            row["label"] = labels[k]
        row |= {n: finite(numbers[n].value) for n in names}
        row |= {f"{n} error": finite(numbers[n].standard_error) for n in errors}
        row |= {"seconds": float(curve["seconds"]), "error": curve.get("error")}
        rows.append(row)
    columns = ("case", *(["label"] if labels else []), *(n for n, _ in factors), *names)
    return (*columns, *(f"{n} error" for n in errors), "seconds", "error"), rows


def factors(config: StudyExperiment, moved: Mapping[str, Sequence[Move]]) -> Table:
    """What varies, between which bounds, whether it moves anything, and what is to be said if it does not."""
    told = idle(config, moved)
    rows: list[dict[str, object]] = [
        {
            "factor": f.name,
            "column": _column(f.name),
            "path": f.path,
            "unit": f.unit,
            "low": f.low,
            "high": f.high,
            "transform": "" if f.categorical else f.transform,
            "values": ", ".join(str(v) for v in f.values or ()),
            "moves": ("no" if f.name in told else "yes") if moved.get(f.name) else "",
            "largest_move": max((m.share for m in moved.get(f.name, ())), default=None),
            "told": told.get(f.name, ""),
        }
        for f in config.factor
    ]
    columns = ("factor", "column", "path", "unit", "low", "high", "transform", "values", "moves", "largest_move")
    return (*columns, "told"), rows


def indices(grown: Mapping[str, pd.DataFrame]) -> Table:
    """Indices by output, number of base points and factor."""
    columns: dict[str, None] = {"output": None, "points": None, "factor": None}
    rows: list[dict[str, object]] = []
    for name, frame in grown.items():
        columns |= dict.fromkeys(map(str, frame.columns))
        rows += [{"output": name, **{str(k): v for k, v in r.items()}} for r in frame.to_dict("records")]
    return tuple(columns), rows


def settling(spec: Sensitivity, grown: Mapping[str, pd.DataFrame], why: Mapping[str, str]) -> Table:
    """By output: widest interval, largest change since half the points, and the verdict."""
    from livlab.kinds.study.sensitivity import settled

    rows: list[dict[str, object]] = []
    for name, frame in grown.items():
        widest, change = settled(spec, frame)
        ok = widest <= spec.converged and change <= spec.converged
        row: dict[str, object] = {
            "output": name,
            "points": int(frame["points"].max()),
            "widest_interval": widest,
            "change_from_half": finite(change),
            "verdict": "converged" if ok else "not converged",
            "wanted": spec.converged,
        }
        if spec.estimator == "sobol":
            last = frame[frame["points"] == frame["points"].max()]
            row["sum_of_first"] = float(last["first"].sum())
        rows.append(row)
    rows += [{"output": name, "verdict": "undefined", "reason": text} for name, text in why.items()]
    columns = ("output", "points", "widest_interval", "change_from_half", "wanted", "sum_of_first", "verdict", "reason")
    return columns, rows


def ablation(
    config: StudyExperiment,
    cases: Sequence[AblationCase],
    curves: Sequence[Answer],
    made: Sequence[Mapping[str, Number]],
) -> Table:
    """One row a case: outputs with errors, their change against its base, seconds, and how far off the targets."""
    assert config.ablation is not None
    names, target = [o.name for o in config.output], config.ablation.target
    at = {c.label: m for c, m in zip(cases, made, strict=True)}
    still = _still(config, cases, made)
    rows: list[dict[str, object]] = []
    for case, curve, numbers in zip(cases, curves, made, strict=True):
        base = at[case.base]
        row: dict[str, object] = {
            "case": case.label,
            "group": case.group,
            "base": case.base,
            "row": case.row,
            "option": case.option,
            "choice": case.choice,
            "same_as": case.same_as,
            "moves": "" if case.group == "base" else "no" if case.label in still else "yes",
            "seconds": None if case.same_as else float(curve["seconds"]),
            "solving_seconds": None if case.same_as else curve.get("solving_seconds"),
            "samples": None if case.same_as else curve.get("samples"),
            "note": curve.get("error") or next((numbers[n].reason for n in names if numbers[n].reason), ""),
        }
        for n in names:
            row[n] = finite(numbers[n].value)
            row[f"{n} error"] = finite(numbers[n].standard_error)
            twin = (case.same_as or case.label) == case.base
            row[f"{n} change"] = 0.0 if twin else finite(numbers[n].value - base[n].value)
            error = float(np.hypot(numbers[n].standard_error, base[n].standard_error))
            row[f"{n} change error"] = 0.0 if twin else finite(error)
        far = distance({n: numbers[n].value for n in names}, target)
        row |= {f"{n} off": finite(x) for n, x in far.items()}
        row["worst off"] = finite(max(far.values())) if far and all(np.isfinite(list(far.values()))) else None
        rows.append(row)
    return tuple(rows[0]), rows


def _still(config: StudyExperiment, cases: Sequence[AblationCase], made: Sequence[Mapping[str, Number]]) -> list[str]:
    """Labels of cases that move no output by more than its error, or than a thousandth of its level."""
    at = {c.label: m for c, m in zip(cases, made, strict=True)}
    names = [o.name for o in config.output]
    level = {n: max((abs(m[n].value) for m in made if np.isfinite(m[n].value)), default=0.0) for n in names}

    def nothing(case: AblationCase, n: str) -> bool:
        here, base = at[case.label][n], at[case.base][n]
        change, error = here.value - base.value, float(np.hypot(here.standard_error, base.standard_error))
        twin = (case.same_as or case.label) == case.base
        return twin or bool(np.isfinite(change) and np.isfinite(error) and changes_nothing(change, error, level[n]))

    return [c.label for c in cases if c.group != "base" and all(nothing(c, n) for n in names)]


def idle_notes(
    config: StudyExperiment, cases: Sequence[AblationCase], made: Sequence[Mapping[str, Number]]
) -> list[str]:
    """What to say of cases that change the scene and move no output by more than its error."""
    still = set(_still(config, cases, made))
    told = [c.label for c in cases if c.label in still and not c.same_as]
    if not told:
        return []
    more = f" and {len(told) - MOST_NAMED} more" if len(told) > MOST_NAMED else ""
    return [
        f"{len(told)} of {len(cases)} cases change the scene and move no output by more than its error (three standard "
        f"errors, or a thousandth of its level): {', '.join(told[:MOST_NAMED])}{more}."
    ]


def targets(wanted: Sequence[Target]) -> Table:
    """Numbers that a case may explain."""
    return ("output", "value", "tolerance", "source"), [t.model_dump() for t in wanted]


def costs(
    config: StudyExperiment, answers: Sequence[Answer], curves: Sequence[Answer], wall: float
) -> list[dict[str, object]]:
    """What the study took."""
    samples = sum(int(c.get("samples", 0)) for c in curves)
    rows: list[dict[str, object]] = [
        {
            "stage": "all evaluations",
            "seconds": wall,
            "evaluations": len(curves),
            "samples": samples or None,
            "solver": config.solver.kind,
        }
    ]
    recorded = {str(a["recording"]): a["recording"] for a in answers if a.get("recording")}
    if recorded:
        spent = sum(float(a["seconds"]) for a in answers) - sum(float(c["seconds"]) for c in curves)
        photons = sum(int(r["photons"]) for r in recorded.values())
        rows.append({"stage": "of that, recording", "seconds": spent, "samples": photons, "solver": "ledger"})
    return rows


def shared_notes(cases: Sequence[AblationCase], given: Mapping[str, Answer]) -> list[str]:
    """Notes of solvers, each once, with how many cases it concerns; those that differ in numbers only count as one."""
    by_form: dict[str, dict[str, str]] = {}
    for case in cases:
        for text in given[case.label].get("notes", ()):
            said = NOT_REACHED if "not reached" in text else text
            by_form.setdefault(re.sub(r"\d[\d., ]*", "#", said), {}).setdefault(case.label, said)
    made = []
    for found in by_form.values():
        texts = list(dict.fromkeys(found.values()))
        who = next(iter(found)) if len(found) == 1 else f"{len(found)} cases"
        made.append(f"{who}: {texts[0]}{' (in others with other numbers)' if len(texts) > 1 else ''}")
    return made


def _column(name: str) -> str:
    return f"{name} (factor)" if name in _OWN else name


def _numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
