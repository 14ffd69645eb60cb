"""The fit job: measured curves → targets → search with fresh draws → intervals, checks on unseen bands, claims."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.acquire.forward import LedgerForward
from livlab.config_fit import FitExperiment, Measurement, Scene
from livlab.config_spectral import Reference
from livlab.errors import InputError, Interrupted, RangeError
from livlab.gpu import name_device
from livlab.model.tissue.tissue import override
from livlab.optimise import ParameterSpace
from livlab.study import fit_coverage, spectral_tables
from livlab.study import fit_tables as tables
from livlab.study.fit import GUIDE, FitOutcome, fit
from livlab.study.fit_round_trip import SEEDS, Trip, round_trip
from livlab.study.fit_scenes import JointForward
from livlab.study.fit_targets import Target
from livlab.study.spectral_claims import Known, load_reference
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.runs_work import Run


def prepare(config: FitExperiment) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed: datasets, bands, the tissue at the start.

    Raises
    ------
    InputError
        A measurement without enough points on the wavelengths, or none to fit that is to be had.
    DatasetError, RangeError
        A dataset that is damaged, or does not reach.
    """
    known = [_load(m) for m in config.measurement]
    grid = config.wavelengths.grid()
    scenes = config.scenes()
    targets = {}
    for m, k in zip(config.measurement, known, strict=True):
        if k.dataset:
            place = next(i for i, scene in enumerate(scenes) if m.label in scene.labels)
            targets[m.label] = _target(m, k, grid, place, len(scenes))
    if not any(m.role == "fit" and m.label in targets for m in config.measurement):
        raise InputError.of(
            "measurement", "none available", known[0].reason or "has no numbers", "Add the data: livlab data add FILE."
        )
    space = ParameterSpace(config.parameters())
    forward = JointForward([_forward(config, scene) for scene in scenes], [scene.keys for scene in scenes])
    forward.stack(space.values(space.vector({})))
    return lambda run: _work(run, config, forward, space, targets, known)


def _forward(config: FitExperiment, scene: Scene) -> LedgerForward:
    tissue = config.tissue.build()
    return LedgerForward(
        override(tissue, scene.set, by="measurement") if scene.set else tissue,
        config.reading,
        config.wavelengths.grid(),
        config.instrument,
        list(scene.keys),
        standard_error=config.search.standard_error,
        variant=config.variant,
    )


def _load(m: Measurement) -> Known:
    return load_reference(
        Reference(label=m.label, dataset=m.dataset, column=m.column, sd_column=m.sd_column, subjects=m.subjects)
    )


def _target(m: Measurement, known: Known, grid: FloatArray, place: int, scenes: int) -> Target:
    """A measurement on the wavelengths of its own scene; the other scenes' places are not used.

    Raises
    ------
    InputError
        A curve shorter than its band, or that cannot be compared.
    """
    data, sd = known.at(grid)
    if m.sd_column is not None and sd is not None:
        sigma = sd / np.sqrt(m.subjects)
    elif m.sd is not None:
        sigma = np.full_like(data, m.sd)
    elif m.relative_sd is not None:
        sigma = m.relative_sd * np.abs(data)
    else:
        sigma = np.full_like(data, np.nan)
    use = np.isfinite(data)
    if m.band_nm is not None:
        band = (grid >= m.band_nm[0]) & (grid <= m.band_nm[1])
        if not use[band].all():
            assert known.dataset is not None
            low, high = known.dataset.range_nm
            had = (max(low, m.band_nm[0]), min(high, m.band_nm[1]))
            remedy = f"Use band_nm = [{had[0]:g}, {had[1]:g}]." if had[0] < had[1] else "Use a curve of that band."
            raise InputError.of(
                f"measurement {m.label}.band_nm", m.band_nm, f"reaches beyond the curve, {low:g}–{high:g} nm", remedy
            )
        use &= band
    colour = _colour(m, grid[use])

    def placed(values: Any, empty: Any) -> Any:
        made = np.full((scenes, len(grid)), empty)
        made[place] = values
        return made.ravel()

    return Target(
        m.label, placed(use, False), placed(data, np.nan), placed(sigma, np.nan), m.scaling, m.loss, m.weight, colour
    )


def _colour(m: Measurement, wavelength_nm: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
    """The colour of a curve, where the loss is one.

    Raises
    ------
    InputError
        A band that leaves out more of white's light than a colour can do without.
    """
    if m.loss != "colour":
        return None
    try:
        return lab_of(wavelength_nm)
    except (RangeError, InputError) as error:
        band = f"{wavelength_nm[0]:g}–{wavelength_nm[-1]:g} nm" if len(wavelength_nm) else "no wavelength"
        raise InputError.of(
            f"measurement {m.label}.loss",
            "colour",
            f"needs a band that holds 99 % of white's luminance, and {band} are compared: {error.message}",
            "Compare 450–720 nm or more with steps of 10 nm or less (wavelengths, band_nm, and what the dataset has), "
            "or use another loss.",
        ) from None


def lab_of(wavelength_nm: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """CIE L*a*b* of a reflectance under D65 for the 2° observer, white being a perfect diffuser."""
    from livlab.model.colour import cie_weights

    weights = cie_weights(wavelength_nm).transpose("channel", "wavelength").to_numpy()

    def lab(curve: FloatArray) -> FloatArray:
        from colour import RGB_COLOURSPACES, RGB_to_XYZ, XYZ_to_Lab

        return np.asarray(XYZ_to_Lab(RGB_to_XYZ(weights @ curve, RGB_COLOURSPACES["sRGB"])))

    return lab


def _work(
    run: Run,
    config: FitExperiment,
    forward: JointForward,
    space: ParameterSpace,
    targets: dict[str, Target],
    known: Sequence[Known],
) -> None:
    begun = time.perf_counter()
    name_device(run.info, config.variant)
    run.progress.begin(["fit", *(["round trips"] if config.round_trip else [])])
    fitted = [targets[m.label] for m in config.measurement if m.role == "fit" and m.label in targets]

    def tell(stage: str, share: float) -> None:
        run.progress.advance("fit", min(share, 0.999), stage)
        if stage == "record":
            run.stop_if_asked()

    try:
        found = fit(
            forward,
            fitted,
            space,
            algorithm="auto" if config.search.algorithm == ("auto",) else config.search.algorithm,
            starts=config.search.starts,
            seed=config.seed,
            max_evaluations=config.search.max_evaluations,
            max_seconds=config.search.max_seconds,
            most_recordings=config.search.most_recordings,
            level=config.level,
            progress=tell,
            stopping=run.stopping.is_set,
        )
    except Interrupted:
        run.stop_if_asked()
        raise
    run.progress.advance("fit", 1.0)
    best = forward.answer(found.best)
    first = forward.answer(found.space.values(found.space.vector({})))
    begin = np.where(first.valid, first.value, np.nan)
    for text in (*forward.stack(found.best).notes, *found.notes, *found.verdict.sentences):
        run.note(tables.named(text, config))
    run.write_result({"/": tables.result(config, best, begin, targets, found)})
    scores = tables.scores(config, targets, best.value, begin)
    run.write_table("fit.csv", tables.INTERVALS, tables.intervals(config, found))
    run.write_table("scores.csv", tables.SCORES, scores)
    run.write_table("correlation.csv", *tables.correlation(config, found))
    run.write_table("path.csv", *tables.path(config, found))
    run.write_table("costs.csv", tables.COSTS, tables.costs(config.reading.name, found, forward, best))
    run.write_table("recordings.csv", tuple(forward.recordings[0]), forward.recordings)
    tissue, reading = config.tissue.build(), (config.reading,)
    run.write_table("tissue.csv", *spectral_tables.tissue(tissue, reading))
    run.write_table("provenance.csv", *spectral_tables.provenance(tissue, reading, config.wavelengths.grid(), known))
    if config.bench:
        run.write("bench.json", json.dumps(_bench(config, found, targets), separators=(",", ":"), allow_nan=False))
    trips = _round_trips(run, config, forward, space, fitted) if config.round_trip is not None else []
    if trips:
        run.write_table("round_trip.csv", *fit_coverage.by_parameter(trips, config.labels()))
        run.write_table("round_trips.csv", *fit_coverage.by_tissue(trips, config.labels()))
        for text in fit_coverage.sentences(trips, config.labels()):
            run.note(text)
    seconds = time.perf_counter() - begun
    reasons = {k.spec.label: k.reason for k in known}
    claims = tables.claims(config, scores, found, fit_coverage.overall(trips), reasons, seconds)
    run.write_claims(claims)
    run.info["claim_notes"] = {c.criterion: c.note for c in claims if c.note}


def _round_trips(
    run: Run, config: FitExperiment, forward: JointForward, space: ParameterSpace, targets: Sequence[Target]
) -> list[Trip]:
    """Every tissue's own numbers depend on its number and the seed alone."""
    how = config.round_trip
    assert how is not None
    for scene in forward.scenes:
        scene.standard_error = how.standard_error
    trips = []
    for number in range(how.tissues):
        run.stop_if_asked()
        run.progress.advance("round trips", number / how.tissues, f"tissue {number + 1}")
        trips.append(
            round_trip(
                forward,
                targets,
                space,
                relative_sd=how.relative_sd,
                rng=np.random.default_rng([config.seed, number]),
                seed=config.seed + (number + 1) * SEEDS,
                level=config.level,
                starts=config.search.starts,
                algorithm="auto" if config.search.algorithm == ("auto",) else config.search.algorithm,
                stopping=run.stopping.is_set,
            )
        )
    run.progress.advance("round trips", 1.0)
    return trips


def _bench(config: FitExperiment, found: FitOutcome, targets: dict[str, Target]) -> dict[str, Any]:
    """The bench about the fitted tissue of the first measurement, and the curves measured on it."""
    from livlab.acquire.bench import bench_data

    scene = config.scenes()[0]
    size = len(config.wavelengths.grid())
    known = [
        {
            "label": label,
            "value": [float(v) if u and np.isfinite(v) else None for v, u in zip(t.data[:size], t.use, strict=False)],
            "absolute": t.scaling == "none",
        }
        for label, t in targets.items()
        if label in scene.labels
    ]
    values = {**scene.set, **{path: found.best[key] for path, key in scene.keys.items()}}
    return bench_data(
        override(config.tissue.build(), values, by="fit"),
        config.reading,
        config.wavelengths.grid(),
        config.instrument,
        references=known,
        standard_error=GUIDE * config.search.standard_error,
        seed=config.seed,
    )


__all__ = ["prepare"]
