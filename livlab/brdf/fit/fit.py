"""Fits of BRDF models to samples: the loss stated, pixels integrated, uncertainties and their limits told."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from livlab.brdf.fit.data import Footprint, Packed, pack
from livlab.brdf.fit.judge import groupings, judge, noise_floor
from livlab.brdf.fit.loss import LossName
from livlab.brdf.fit.problem import BrdfProblem, Choices, Layout, Sharing
from livlab.brdf.fit.report import combinations_in_words, parameter_table, sentences
from livlab.brdf.fit.result import BrdfFit
from livlab.brdf.fit.spread import Normal, Resampling, Spread, blocks_of, spread
from livlab.brdf.fit.widen import at_bounds, largest, widen
from livlab.brdf.models.model import Model, model
from livlab.errors import InputError, Interrupted
from livlab.optimise import FitWarning, OptimiseResult, ParameterSpace, identifiability, minimise
from livlab.optimise.misfit import Misfit

__all__ = ["BrdfFit", "Packed", "compare", "fit", "pack"]

PART = 4000
"""Samples on which starts are tried; the best goes on to all of them."""

TRIALS = 12
"""Shapes tried for each start that is followed."""

LOST_CONDITION = 1e4
"""Condition from which a combination counts as not held: its parameters' effects differ by 2 % of them, which is what
images of spheres repeat to."""


def fit(
    samples: xr.Dataset | Iterable[xr.Dataset] | Packed,
    which: str | Model,
    *,
    loss: LossName = "cosine-weighted-l2",
    footprint: Footprint = "auto",
    shared: Sharing = "shape",
    fixed: Mapping[str, ArrayLike] | None = None,
    free: Collection[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    start: Mapping[str, ArrayLike] | None = None,
    starts: int = 3,
    algorithm: str = "LD_SLSQP",
    bootstrap: Resampling = "auto",
    replicates: int = 400,
    level: float = 0.6827,
    widening: bool = True,
    max_seconds: float = math.inf,
    seed: int = 0,
    warn: bool = True,
) -> BrdfFit:
    """Fit a BRDF model to samples by NLopt.

    Minimises ½ Σ w (g(f_model cos θ_i) − g(f cos θ_i))² over all samples and channels, where g and w are the loss's and
    f_model is the model averaged over each pixel. The loss is a choice that moves the answer: another one can change
    a fitted roughness by a fifth and an exponent by two fifths where the model is not the truth.

    Parameters
    ----------
    samples
        Of `livlab.brdf.sphere.extract`, or an iterable of them (`by_light`: memory then does not grow with the lights),
        or samples without pixels (files), or the result of `pack`.
    which
        A model or its name, see `livlab.brdf.models.model.model`: "ggx", "lambert+ggx", "plastic", …
    loss
        "cosine-weighted-l2", "log", "cube-root", or "chi2" if the samples have standard errors.
    footprint
        "auto" integrates pixels as finely as needed; n takes n × n midpoints in every pixel; None takes the centres,
        which reads narrow lobes too wide. Given with the samples if they are packed.
    shared
        "shape": channels share all but albedos and reflectances; "all"; "none"; or names of what they share.
    fixed, free, bounds, start
        Changes to the model's parameters by name; fixed and start take one number or one a channel. A refractive index
        is fixed (1.5) unless freed.
    starts
        How many of the best trial shapes are followed.
    algorithm
        NLopt's, with gradient: LD_SLSQP, LD_LBFGS, LD_MMA.
    bootstrap, replicates, level
        What sd and intervals take as independent ("auto": whole lights from six on, else patches of pictures), how
        often it is drawn, and the intervals' coverage. None as "auto", with Student's intervals.
    widening
        Whether sd and intervals are widened where the model misses the data, see `livlab.brdf.fit.widen.widen`; if not,
        they are of the scatter alone. The misfit is told either way.
    max_seconds
        Limit of the search.
    seed
        Of the trials and the bootstrap.
    warn
        Also raise each warning of the result as a `livlab.optimise.FitWarning`.

    Raises
    ------
    InputError
        Unknown names, samples that hold nothing, fewer samples than parameters, a loss that they do not allow.
    Interrupted
        The user stopped it.
    """
    begun = time.perf_counter()
    chosen = model(which)
    data = samples if isinstance(samples, Packed) else pack(samples, footprint)
    layout = Layout(chosen, data.channels, Choices(shared, fixed, free, bounds, start))
    if data.value.size <= len(layout.space.names):
        raise InputError.of(
            "samples", data.value.size, f"are too few for {len(layout.space.names)} parameters", "Fix some parameters."
        )
    problem = BrdfProblem(layout, data, loss)
    search = _Search(max(starts, 1), algorithm, begun + max_seconds, seed)
    found, tried = _search(problem, loss, search)
    # The last stage began at its optimum; what counts is where the search began.
    found = replace(found, status=layout.space.status(layout.space.vector(found.best), layout.space.start))
    sure = spread(problem, found.best, resampling=bootstrap, replicates=replicates, level=level, seed=seed)
    rms = _rms(problem, found.best)
    missed = judge(problem, found.best, [str(n) for n in sure.robust.matrix.index], rms[1])
    normal = Normal(problem, found.best)
    if widening and missed.told:
        sure = widen(normal, found.best, sure, groupings(data))
    sure = at_bounds(normal, found.best, sure, blocks_of(problem, bootstrap), level)
    result = _result(problem, loss, _Found(found, tried, sure, missed, rms), level=level, begun=begun)
    if warn:
        for note in result.warnings:
            warnings.warn(note, FitWarning, stacklevel=2)
    return result


class _Found(NamedTuple):
    """An optimum, the starts tried, how sure it is, how far it misses the data, and (absolute, relative) residual."""

    search: OptimiseResult
    tried: pd.DataFrame
    sure: Spread
    missed: Misfit
    rms: tuple[float, float]


def _result(problem: BrdfProblem, loss: LossName, at: _Found, *, level: float, begun: float) -> BrdfFit:
    """What a fit tells of an optimum and how sure it is."""
    found, sure = at.search, at.sure
    layout, data, values = problem.layout, problem.data, found.best
    held = identifiability(sure.independent, lost=LOST_CONDITION)
    rss = 2.0 * problem.value(values)
    free = len(layout.space.names)
    likelihood = sure.effective * math.log(max(rss, 1e-300) / data.value.size)
    return BrdfFit(
        model=layout.model,
        table=parameter_table(layout, values, found.status, sure, held),
        loss=f"{loss}: {problem.loss.words}",
        loss_value=0.5 * rss,
        rmse=at.rms[0],
        relative_rmse=at.rms[1],
        misfit=at.missed,
        noise_floor=noise_floor(data),
        samples=data.size,
        pixels=int(data.pixels.sum()),
        effective=sure.effective,
        aic=likelihood + 2.0 * (free + 1),
        bic=likelihood + math.log(max(sure.effective, 2.0)) * (free + 1),
        correlation=sure.independent.correlation,
        identifiability=held,
        combinations=combinations_in_words(layout, values, sure, held),
        footprint=data.footprint,
        resampled=sure.resampled,
        left_out=sure.left_out,
        widened=largest(sure.widened),
        level=level,
        theta_d_range=(float(data.theta_d.min()), float(data.theta_d.max())),
        warnings=tuple(sentences(problem, found, held, sure, at.missed)),
        search=found,
        starts=at.tried,
        seconds=time.perf_counter() - begun,
        layout=layout,
    )


def compare(
    samples: xr.Dataset | Iterable[xr.Dataset] | Packed,
    which: Sequence[str | Model],
    *,
    loss: LossName = "cosine-weighted-l2",
    footprint: Footprint = "auto",
    **options: object,
) -> tuple[pd.DataFrame, dict[str, BrdfFit]]:
    """Fit several models to the same samples and rank them.

    The criteria count residuals at the worth they have for the best model, so that one number serves all; where no
    model is true to the noise they rank misfit, and small differences mean nothing.

    Parameters
    ----------
    samples, loss, footprint, options
        As of `fit`.
    which
        Models or their names.

    Returns
    -------
    table, results
        One row a model, the smallest BIC first: parameters, rmse, relative_rmse, over_noise (residual over noise), p
        and adequate (see `livlab.optimise.misfit.Misfit`), aic, bic, delta_bic, identifiable, at_bound, seconds; and
        the fits by name. `table.attrs` has the loss, the noise's source, and `noise_floor`, the relative_rmse of noise
        alone.
    """
    data = samples if isinstance(samples, Packed) else pack(samples, footprint)
    results = {}
    for entry in which:
        one = fit(data, entry, loss=loss, footprint=footprint, **options)  # type: ignore[arg-type]
        results[one.model.name] = one
    best = min(results.values(), key=lambda r: r.loss_value)
    rows = []
    for name, one in results.items():
        k = len(one.layout.space.names)
        likelihood = best.effective * math.log(max(2.0 * one.loss_value, 1e-300) / data.value.size)
        rows.append(
            {
                "model": name,
                "parameters": k,
                "rmse": one.rmse,
                "relative_rmse": one.relative_rmse,
                "over_noise": one.misfit.ratio,
                "p": one.misfit.worst,
                "adequate": one.misfit.adequate,
                "aic": likelihood + 2.0 * (k + 1),
                "bic": likelihood + math.log(max(best.effective, 2.0)) * (k + 1),
                "identifiable": one.identifiability.verdict,
                "at_bound": ", ".join(str(n) for n, s in one.table["status"].items() if str(s).startswith("at ")),
                "seconds": one.seconds,
            }
        )
    table = pd.DataFrame(rows).set_index("model").sort_values("bic")
    table.insert(8, "delta_bic", table["bic"] - table["bic"].min())
    table.attrs = {
        "loss": loss,
        "effective_samples": best.effective,
        "noise": best.misfit.noise,
        "noise_floor": best.noise_floor,
    }
    return table, results


class _Search(NamedTuple):
    """How the optimum is looked for: starts that are followed, NLopt's algorithm, when it must end, seed of trials."""

    starts: int
    algorithm: str
    deadline: float
    seed: int


def _search(problem: BrdfProblem, loss: str, how: _Search) -> tuple[OptimiseResult, pd.DataFrame]:
    """Try shapes on a part of the samples, follow the best there, and take the best of those to all samples."""
    layout, data = problem.layout, problem.data
    part = BrdfProblem(layout, data.select(_part(data, how.seed)) if data.size > PART else data, loss, quick=True)
    trials = _trials(part, how.starts, how.seed)
    rows, best = [], None
    for number, values in enumerate(trials[: how.starts]):
        one = _minimise(part, values, how._replace(seed=how.seed + number), 1e-9, test=False)
        rows.append({"value": one.value, "evaluations": one.evaluations, "stop": one.stop, **one.best})
        if best is None or one.value < best.value:
            best = one
    assert best is not None
    tried = pd.DataFrame(rows)
    tried.index.name = "start"
    final = _minimise(problem, best.best, how, 1e-12)
    # A second go, rescaled where the first ended, mends a quasi-Newton matrix that went astray.
    again = _minimise(problem, final.best, how, 1e-13) if final.converged else final
    return (again if again.value <= final.value and again.converged else final), tried


def _part(data: Packed, seed: int) -> np.ndarray:
    """A third of the part from the lobe's core, the rest by chance, in order."""
    rng = np.random.default_rng(seed)
    core = np.argsort(data.theta_h, kind="stable")[: max(data.size // 20, PART)]
    core = rng.choice(core, PART // 3, replace=False)
    rest = rng.choice(data.size, PART - PART // 3, replace=False)
    return np.union1d(core, rest)


def _trials(problem: BrdfProblem, starts: int, seed: int) -> list[dict[str, float]]:
    """The default shape and others spread over the box, each with its best scales, the smallest loss first."""
    from scipy.stats import qmc

    space = problem.layout.space
    own = space.values(space.start)
    shapes = problem.layout.shape_names
    candidates = [own]
    if shapes:
        index = [space.names.index(n) for n in shapes]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            shares = qmc.Sobol(len(shapes), rng=np.random.default_rng(seed)).random(TRIALS + 2 * starts)
        for share in shares:
            x = space.start.copy()
            x[index] = space.low[index] + (space.high - space.low)[index] * (0.03 + 0.94 * share)
            candidates.append(space.values(x))
    scored: list[tuple[float, int, dict[str, float]]] = []
    for values in candidates:
        moved = problem.with_scales(values)
        cost = problem.value(moved)
        if math.isfinite(cost):
            scored.append((cost, len(scored), moved))
    if not scored:
        return [own]
    return [values for _, _, values in sorted(scored)]


def _minimise(
    problem: BrdfProblem, values: Mapping[str, float], how: _Search, tolerance: float, *, test: bool = True
) -> OptimiseResult:
    space: ParameterSpace = problem.scaled_space(values)
    size = max(problem.value(values), 1e-300)

    def objective(v: Mapping[str, float]) -> float:
        return problem.value(v) / size

    def gradient(v: Mapping[str, float]) -> dict[str, float]:
        return {name: slope / size for name, slope in problem.gradient(v).items()}

    found = minimise(
        objective,
        space,
        gradient=gradient,
        algorithm=how.algorithm,
        value_tolerance=tolerance,
        parameter_tolerance=1e-9,
        max_evaluations=300 * (len(space.names) + 1),
        max_seconds=max(how.deadline - time.perf_counter(), 1e-3),
        seed=how.seed,
        warn=False,
        test=test,
    )
    if found.interrupted:
        raise Interrupted("The fit was stopped.", remedy="Run it again; max_seconds= ends it with a result.")
    return _times(found, size)


def _times(found: OptimiseResult, size: float) -> OptimiseResult:
    """The record with its values in the loss's own unit."""
    path = found.path.assign(value=found.path["value"] * size, best=found.path["best"] * size)
    return replace(found, value=found.value * size, path=path)


def _rms(problem: BrdfProblem, values: Mapping[str, float]) -> tuple[float, float]:
    data = problem.data
    weight = data.pixels * data.cos_i**2
    total = level = 0.0
    for c in range(len(data.channels)):
        total += float(np.sum(weight * (problem.predicted(values, c) - data.value[:, c]) ** 2))
        level += float(np.sum(weight * data.value[:, c] ** 2))
    pixels = float(data.pixels.sum()) * len(data.channels)
    return math.sqrt(total / pixels), math.sqrt(total / level) if level > 0 else math.inf
