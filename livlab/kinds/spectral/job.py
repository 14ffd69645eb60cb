"""The spectral job: tissue → optical stack → instrument → curves → metrics → claims, one reading after the other."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.spectrometer import MeasurementProgress, measure
from livlab.criteria import Claim
from livlab.kinds.shared import tissue_tables
from livlab.kinds.shared.names import as_kept, as_solved
from livlab.kinds.shared.references import Known, load_reference
from livlab.kinds.shared.seeds import reading_seed
from livlab.kinds.spectral import tables
from livlab.kinds.spectral.claims import judge, points, processed, shown
from livlab.kinds.spectral.config import SpectralExperiment
from livlab.machine.gpu import name_device
from livlab.model.tissue.optics import optical_stack, stack_coefficients
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue
from livlab.runs.work import PieceUnderWay, Run, Table

if TYPE_CHECKING:
    from livlab.effects.plan import Plan

SAVE_EVERY_SECONDS = 5.0
"""A reading under way is saved this often, so that a killed process loses little."""

_BUDGET = ("specular", "transmittance", "lost", "redirect_loss", "residual", "absorbed", "diffuse_reflectance")


@dataclass(frozen=True)
class Prepared:
    """A spectral experiment made ready: the tissue under each reading, what its scene calls for, its references."""

    config: SpectralExperiment
    tissue: Tissue
    stacks: dict[str, OpticalStack]
    plans: dict[str, Plan]
    references: list[Known]
    costs: list[dict[str, object]]


def prepare(config: SpectralExperiment) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed: datasets, ranges, the tissue under each reading.

    Parameters
    ----------
    config
        A resolved experiment.

    Returns
    -------
    The job: called with the run, it simulates, measures, compares and writes the run's files.

    Raises
    ------
    RangeError
        A wavelength outside the range of a dataset of the tissue.
    DatasetError
        A dataset that is missing or was tampered with, or a column that it lacks.
    """
    references = [load_reference(r) for r in config.reference]
    tissue = config.tissue.build()
    grid = config.wavelengths.grid()
    stacks: dict[str, OpticalStack] = {}
    costs: list[dict[str, object]] = []
    for reading in config.all_readings:
        started = time.perf_counter()
        stacks[reading.name] = optical_stack(tissue, reading, grid)
        costs.append({"stage": "tissue", "reading": reading.name, "seconds": time.perf_counter() - started})
    made = Prepared(config, tissue, stacks, _plans(config, tissue, stacks, costs), references, costs)
    return lambda run: _work(run, made)


def _plans(
    config: SpectralExperiment, tissue: Tissue, stacks: dict[str, OpticalStack], costs: list[dict[str, object]]
) -> dict[str, Plan]:
    """What each reading's scene calls for; nothing where the experiment does not ask."""
    if config.effects is None:
        return {}
    from livlab.effects.plan import plan

    made = {}
    for reading in config.all_readings:
        started = time.perf_counter()
        made[reading.name] = plan(
            stacks[reading.name],
            config.instrument,
            config.effects.tolerance,
            config.effects.forced,
            tolerance_of=config.effects.tolerance_of,
            mode=config.effects.mode,
            tissue=tissue,
            reading=reading,
            literal=config.solver.literal,
        )
        costs.append({"stage": "plan", "reading": reading.name, "seconds": time.perf_counter() - started})
    return made


def _work(run: Run, made: Prepared) -> None:
    config, stacks, plans, costs = made.config, made.stacks, made.plans, made.costs
    if config.solver.sampled:
        name_device(run.info, config.variant)
    run.progress.begin(list(stacks))
    pieces: dict[str, xr.Dataset] = {}
    for name, full in stacks.items():
        stack, instrument = full, config.instrument
        if name in plans:
            stack, instrument = plans[name].reduced.stack, plans[name].instrument
            if plans[name].dropped:
                run.note(
                    f"{name}: left out {', '.join(plans[name].dropped)}; "
                    f"the value moves by at most {plans[name].bound:.2g}."
                )
        pieces[name] = piece = _measured(run, config, name, stack, instrument)
        samples = int(piece.attrs["samples"])
        seconds, compiling = float(piece.attrs["seconds"]), float(piece.attrs["compile_seconds"])
        if compiling:
            costs.append({"stage": "compile", "reading": name, "seconds": compiling})
        walking = max(seconds - compiling, 1e-9)
        costs.append(
            {
                "stage": "measure",
                "reading": name,
                "seconds": walking,
                "samples": samples,
                "samples_per_second": samples / walking if samples else None,
                "solver": piece.attrs["rung"],
                "error": tables.largest_error(piece),
                "relative_error": tables.largest_error(piece) / max(float(piece["value"].max()), 1e-300),
            }
        )
    walked = next((p.attrs["variant"] for p in pieces.values() if p.attrs["variant"] != "none"), None)
    if walked is not None and config.solver.is_auto:
        name_device(run.info, walked)
    # `auto` chooses by speed: whoever runs it again must be able to see that another solver answered.
    run.info["solvers"] = {name: str(piece.attrs["rung"]) for name, piece in pieces.items()}
    _note(run, pieces)
    started = time.perf_counter()
    claims, metrics = judge(config, pieces, made.references)
    costs.append({"stage": "claims", "reading": None, "seconds": time.perf_counter() - started})
    if plans:
        from livlab.effects.plan import COLUMNS

        rows = [{"reading": name, **row} for name, plan in plans.items() for row in plan.records()]
        run.write_table("plan.csv", ("reading", *COLUMNS), rows)
    if config.bench is not None:
        started = time.perf_counter()
        run.write("bench.json", json.dumps(bench_of(config, config.bench), separators=(",", ":"), allow_nan=False))
        costs.append({"stage": "bench", "reading": config.bench, "seconds": time.perf_counter() - started})
    _write(run, made, pieces, claims, metrics)


def bench_of(
    config: SpectralExperiment,
    name: str,
    standard_error: float = 1e-3,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """The bench about one reading, on the experiment's band and in steps that draw a curve.

    Parameters
    ----------
    config
        The experiment.
    name
        One of its readings.
    standard_error
        Of the recorded walk.
    progress
        Called with the share walked.
    """
    from livlab.kinds.spectral.bench import bench_data, bench_grid

    grid = bench_grid(config.wavelengths.grid())
    references: list[dict[str, Any]] = []
    for r in map(load_reference, config.reference):
        if r.dataset is not None:
            values = [float(v) if np.isfinite(v) else None for v in r.at(grid)[0]]
            references.append({"label": r.spec.label, "value": values, "absolute": False})
    return bench_data(
        config.tissue.build(),
        next(r for r in config.all_readings if r.name == name),
        grid,
        config.instrument,
        references=references,
        standard_error=standard_error,
        seed=config.seed,
        progress=progress,
    )


def _measured(
    run: Run, config: SpectralExperiment, name: str, stack: OpticalStack, instrument: Instrument
) -> xr.Dataset:
    """One reading's measurement: as an earlier call left it, gone on from there, or from the start."""
    solver = config.solver.with_seed(reading_seed(config.seed, name))
    kept = PieceUnderWay(run, f"measure {name}", every_seconds=SAVE_EVERY_SECONDS)
    earlier = kept.load()
    if earlier is not None and earlier.attrs["finished"]:
        run.progress.advance(name, 1.0, "as saved")
        return earlier
    run.progress.advance(name, 0.0)

    def on_round(so_far: xr.Dataset, progress: MeasurementProgress) -> None:
        run.progress.advance(name, min(progress.done, 0.999), f"{progress.samples / 1e6:.1f} M samples")
        kept.step(lambda: as_kept(so_far).assign_attrs(finished=0))

    done = measure(
        stack,
        instrument,
        solver,
        accuracy=config.accuracy,
        variant=config.variant,
        on_round=on_round,
        resume=None if earlier is None else as_solved(earlier),
    )
    done = as_kept(done).assign_attrs(finished=1)
    kept.keep(done)
    run.progress.advance(name, 1.0)
    run.stop_if_asked()
    return done


def _note(run: Run, pieces: dict[str, xr.Dataset]) -> None:
    """Warnings of the stacks and instruments; one that several readings share is said once."""
    by_text: dict[str, list[str]] = {}
    for name, piece in pieces.items():
        for text in filter(None, str(piece.attrs["notes"]).split("\n")):
            by_text.setdefault(text, []).append(name)
    for text, names in by_text.items():
        run.note(text if len(names) == len(pieces) > 1 else f"{', '.join(names)}: {text}")


def _write(
    run: Run,
    made: Prepared,
    pieces: dict[str, xr.Dataset],
    claims: list[Claim],
    metrics: list[dict[str, object]],
) -> None:
    config, tissue, readings = made.config, made.tissue, made.config.all_readings
    coefficients = _stacked({name: stack_coefficients(stack) for name, stack in made.stacks.items()})
    result = _result(config, pieces, made.references)
    run.write_result({"/": result, "coefficients": coefficients})
    written: dict[str, Table] = {
        "spectra.csv": tables.spectra(pieces),
        "curves.csv": tables.curves(result),
        "coefficients.csv": tables.coefficients(coefficients),
        "budget.csv": tables.budget(pieces),
        "tissue.csv": tissue_tables.tissue(tissue, readings),
        "readings.csv": tissue_tables.readings(readings, tissue),
        "provenance.csv": tissue_tables.provenance(tissue, readings, config.wavelengths.grid(), made.references),
        "metrics.csv": (tables.METRICS, metrics),
        "convergence.csv": tables.convergence(pieces),
    }
    run.finish(claims, written, (tissue_tables.COSTS, made.costs))


def _result(config: SpectralExperiment, pieces: dict[str, xr.Dataset], references: list[Known]) -> xr.Dataset:
    """The root group of result.nc."""
    made = {}
    for name, piece in pieces.items():
        parts = [f"{b}{end}" for b in _BUDGET for end in ("", "_se", "_systematic")]
        # What was kept before systematic errors were is gone on from, too.
        kept = piece[[x for x in (*parts, "samples", "converged") if x in piece]]
        if "systematic" in piece:
            kept = kept.assign(reflectance_systematic=piece["systematic"])
        kept = kept.assign(reflectance=piece["value"], reflectance_se=piece["standard_error"])
        curve = processed(points(piece), config.processing)
        value, error = shown(curve, config.processing)
        x = ("wavelength_curve", curve.wavelength_nm, {"units": "nm"})
        kept = kept.assign_coords(wavelength_curve=x).assign(
            curve=("wavelength_curve", value, {"units": "1"}),
            curve_se=("wavelength_curve", error, {"units": "1"}),
        )
        made[name] = kept.drop_attrs(deep=False)
    root = _stacked(made)
    root["reflectance"].attrs |= {"units": "1", "long_name": f"value seen by the instrument ({config.instrument.kind})"}
    root = root.transpose("reading", "layer", "wavelength", "wavelength_curve", missing_dims="ignore")
    grid = root["wavelength_curve"].to_numpy()
    known = [r for r in references if r.dataset is not None]
    if known:
        means, sds = zip(*(_scaled(r, grid, config.processing.normalise) for r in known), strict=True)
        root = root.assign_coords(reference_name=[r.spec.label for r in known])
        root["reference"] = (("reference_name", "wavelength_curve"), np.array(means), {"units": "1"})
        root["reference_sd"] = (("reference_name", "wavelength_curve"), np.array(sds), {"units": "1"})
    p, first = config.processing, next(iter(pieces.values()))
    root.attrs = {
        "units": "1",
        "normalisation": p.normalise,
        "smoothing": f"linear interpolation to {p.interpolate_nm:g} nm, moving average of {p.moving_average}, "
        f"{p.alignment}",
        "instrument": config.instrument.model_dump_json(),
        "solver": config.solver.model_dump_json(exclude_none=True, exclude={"seed"}),
        "samples": sum(int(x.attrs["samples"]) for x in pieces.values()),
        "seed": config.seed,
        "variant": str(first.attrs["variant"]),
        "estimator": str(first.attrs["estimator"]),
    }
    return root


def _scaled(reference: Known, grid: Any, by: str) -> tuple[Any, Any]:
    """A reference on the curves' grid, normalised as they are where it is known."""
    mean, sd = reference.at(grid)
    known = mean[np.isfinite(mean)]
    size = 1.0 if by == "none" or not known.size else float(known.max() if by == "max" else known.sum())
    return mean / size, np.full_like(mean, np.nan) if sd is None else sd / size


def _stacked(parts: dict[str, xr.Dataset]) -> xr.Dataset:
    """One dataset along a new dimension `reading`."""
    names = xr.DataArray(list(parts), dims="reading", name="reading")
    return xr.concat(
        list(parts.values()), dim=names, data_vars="all", coords="different", compat="equals", join="outer",
        combine_attrs="drop_conflicts", fill_value=np.nan,
    )  # fmt: skip


__all__ = ["bench_of", "prepare"]
