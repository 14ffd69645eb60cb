"""Where the uncertainty of a BRDF from photographs comes from: each source moved by what is not known of it.

Pixels keep their radiance; the rig moves. Sources of few dimensions are moved along the principal axes of their
covariance (finite differences), those of many are drawn from it (Monte Carlo). What the model cannot follow (spots,
gloss that it does not have) is no part of it: that shows in the residual of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import xarray as xr

from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.rig import PhotographedRig
from livlab.brdf.angles import local_frames
from livlab.brdf.fit.fit import BrdfFit, fit
from livlab.brdf.fit.loss import LossName
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.rig import rig_of, rig_variables
from livlab.brdf.samples import angles_of
from livlab.errors import InputError

Evaluate = Callable[[xr.Dataset, int], Mapping[str, float]]
"""Quantities by name from samples, integrated over so many points along each side of a pixel."""

UNTESTED_GAMMA_SD = 0.03
"""Standard uncertainty of the response's exponent where it was declared and no exposure stack tested it; assumed."""

DRAWS = 12
SOURCES = ("light direction", "pose", "focal length", "linearity", "noise", "footprint", "white reference")


@dataclass(frozen=True, eq=False)
class ErrorBudget:
    """An error budget.

    Attributes
    ----------
    table
        One row a quantity and source: value, sd, relative (sd / |value|), share (of the variance), how.
    totals
        By quantity: value, sd, relative.
    ignored_footprint
        By quantity: how far it would move if pixels were taken as points.
    samples
        Samples that each evaluation saw.
    """

    table: pd.DataFrame
    totals: pd.DataFrame
    ignored_footprint: dict[str, float]
    samples: int


def error_budget(
    rig: PhotographedRig,
    samples: xr.Dataset,
    evaluate: Evaluate,
    *,
    points: int = 2,
    most: int = 20_000,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ErrorBudget:
    """How much of the uncertainty of some quantities comes from which source.

    Parameters
    ----------
    rig
        The photographs, with the covariances of lights and pose.
    samples
        Samples extracted from them.
    evaluate
        Gives the quantities, for instance a fit's parameters, from samples.
    points
        Points along each side of a pixel over which the final result averages.
    most
        Samples on which each evaluation runs, drawn at random.
    draws
        Of the sources of many dimensions; their standard deviations are known to 1 / sqrt(2 draws).
    seed
        Of the draws.
    progress
        Called with each source as it begins.

    Raises
    ------
    InputError
        No samples, fewer than four draws, or quantities that come out not finite.
    """
    if not samples.sizes.get("sample"):
        raise InputError.of("samples", 0, "must not be empty", "Extract some first.")
    if draws < 4:
        raise InputError.of("draws", draws, "must be >= 4", "Twelve know a standard deviation to a fifth.")
    rng = np.random.default_rng(seed)
    total = samples.sizes["sample"]
    chosen = np.sort(rng.choice(total, min(most, total), replace=False))
    part = samples.isel(sample=chosen)
    base = _finite(evaluate(part, points))
    told = progress or (lambda _: None)
    rows: list[dict[str, object]] = []

    def add(source: str, sd: Mapping[str, float], how: str) -> None:
        rows.extend({"quantity": q, "source": source, "sd": sd[q], "how": how} for q in base)

    camera, lights, sphere = rig_of(part)
    told("light direction")
    shifts = [
        evaluate(moved(part, camera, _drawn(lights, rig.light_covariances, rng), sphere), points) for _ in range(draws)
    ]
    add("light direction", _spread(shifts, base), f"{draws} draws")
    told("pose")
    add("pose", _pose(rig, evaluate, part, points, base), "finite differences")
    told("focal length")
    add("focal length", _focal(rig, evaluate, part, points, base), "finite differences")
    told("linearity")
    gamma_sd, how = _gamma_sd(rig)
    absolute = bool(np.isfinite(rig.white_sd))
    bent = _half(evaluate, points, [_bent(part, 1 + sign * gamma_sd, absolute=absolute) for sign in (1, -1)])
    add("linearity", {q: abs(v) for q, v in bent.items()}, how)
    told("noise")
    if rig.noise_known == "unknown":
        add("noise", dict.fromkeys(base, float("nan")), "not known")
    else:
        noisy = [evaluate(_noisy(part, rng), points) for _ in range(draws)]
        # A fit to all samples sees less of it than one to a part.
        less = np.sqrt(len(chosen) / total)
        add("noise", _spread(noisy, base, less), f"{draws} draws, {rig.noise_known}")
    told("footprint")
    finer = evaluate(part, points + 1)
    add("footprint", {q: abs(finer[q] - base[q]) for q in base}, f"{points} against {points + 1} points a side")
    ignored = base if points == 1 else evaluate(part, 1)
    told("white reference")
    if np.isfinite(rig.white_sd):
        scaled = _half(evaluate, points, [_scaled(part, 1 + sign * rig.white_sd) for sign in (1, -1)])
        add("white reference", {q: abs(v) for q, v in scaled.items()}, "finite differences")
    else:
        add("white reference", dict.fromkeys(base, float("nan")), "none: known up to a factor")
    return _budget(rows, base, {q: ignored[q] - finer[q] for q in base}, len(chosen))


def fitted(samples: xr.Dataset, which: str, loss: LossName) -> tuple[Evaluate, BrdfFit]:
    """The parameters of a model as quantities, refitted from where a fit to all samples ended; and that fit."""
    found = fit(samples, which, loss=loss, warn=False)
    start = {
        # One number where channels share a parameter: several would set them free.
        name: found.values[labels[0]] if len(set(labels)) == 1 else [found.values[label] for label in labels]
        for name, labels in found.layout.names.items()
    }
    free = [str(name) for name, row in found.table.iterrows() if row["status"] != "fixed"]

    def evaluate(part: xr.Dataset, points: int) -> dict[str, float]:
        footprint = points if points > 1 else None
        again = fit(part, which, loss=loss, footprint=footprint, starts=1, start=start, bootstrap=None, warn=False)
        return {name: again.values[name] for name in free}

    return evaluate, found


def moved(samples: xr.Dataset, camera: Camera, lights: Sequence[Light], sphere: Sphere) -> xr.Dataset:
    """The same pixels and radiances read with another rig; pixels that then miss the sphere are dropped."""
    before = rig_of(samples)
    old = _geometry(samples, *before)
    new = _geometry(samples, camera, lights, sphere)
    keep = new.cosine > 0.02
    radiance = samples["value"].values * old.irradiance
    part = samples.isel(sample=np.flatnonzero(keep))
    factor = new.irradiance[keep]
    scale = old.irradiance[keep] / factor
    out = part.copy()
    out["wi"] = (("sample", "xyz"), new.wi[keep], samples["wi"].attrs)
    out["wo"] = (("sample", "xyz"), new.wo[keep], samples["wo"].attrs)
    out["value"] = (("sample", "channel"), radiance[keep] / factor, samples["value"].attrs)
    out["standard_error"] = part["standard_error"] * xr.DataArray(scale, dims=("sample", "channel"))
    angles = angles_of(new.wi[keep], new.wo[keep])
    out = out.assign_coords({n: ("sample", a, samples[n].attrs) for n, a in angles.items() if n in samples.coords})
    return out.assign(rig_variables(camera, list(lights), sphere))


@dataclass(frozen=True, eq=False)
class _Geometry:
    wi: FloatArray
    wo: FloatArray
    cosine: FloatArray
    irradiance: FloatArray


def _geometry(samples: xr.Dataset, camera: Camera, lights: Sequence[Light], sphere: Sphere) -> _Geometry:
    rows, columns = samples["row"].values, samples["column"].values
    hits = sphere.meet(*camera.rays(columns, rows))
    _, directions = camera.rays(columns, rows)
    frames = local_frames(hits.normals, np.asarray(samples.attrs.get("pole", (0.0, 1.0, 0.0))))
    index = samples["light"].values
    towards, scale = np.empty_like(hits.normals), np.empty(len(index))
    intensity = np.empty((len(index), samples.sizes["channel"]))
    for k in np.unique(index):
        mine = index == k
        towards[mine], scale[mine] = lights[int(k)].at(hits.points_mm[mine])
        intensity[mine] = lights[int(k)].intensity
    cosine = np.einsum("ni,ni->n", towards, hits.normals)
    wo = np.einsum("nij,nj->ni", frames, -directions)
    usable = np.where(hits.hit & (wo[:, 2] > 0.02), cosine, 0.0)
    irradiance = intensity * (scale * np.maximum(usable, 1e-9))[:, None]
    return _Geometry(np.einsum("nij,nj->ni", frames, towards), wo, usable, irradiance)


def _half(evaluate: Evaluate, points: int, pair: Sequence[xr.Dataset]) -> dict[str, float]:
    up, down = (evaluate(x, points) for x in pair)
    return {q: 0.5 * (up[q] - down[q]) for q in up}


def _spread(drawn: Sequence[Mapping[str, float]], base: Mapping[str, float], share: float = 1.0) -> dict[str, float]:
    """Standard deviation of each quantity over the draws, times `share`."""
    return {q: float(np.std([s[q] for s in drawn], ddof=1) * share) for q in base}


def _drawn(lights: Sequence[Light], covariances: Sequence[FloatArray], rng: np.random.Generator) -> list[Light]:
    out = []
    for light, covariance in zip(lights, covariances, strict=True):
        shift = rng.multivariate_normal(np.zeros(3), covariance, method="eigh")
        if light.direction is not None:
            turned = light.direction + shift
            out.append(replace(light, direction=turned / np.linalg.norm(turned)))
        elif light.position_mm is not None:
            out.append(replace(light, position_mm=light.position_mm + shift))
    return out


def _shifted(sphere: Sphere, by: FloatArray) -> Sphere:
    return Sphere(sphere.centre_mm + by[:3], sphere.radius_mm + float(by[3]))


def _pose(
    rig: PhotographedRig, evaluate: Evaluate, part: xr.Dataset, points: int, base: Mapping[str, float]
) -> dict[str, float]:
    """The sphere moved along each principal axis of the covariance of its centre and radius."""
    camera, lights, sphere = rig_of(part)
    values, axes = np.linalg.eigh(rig.sphere_covariance)
    steps = [np.sqrt(v) * a for v, a in zip(values, axes.T, strict=True) if v > 1e-12 * max(values.max(), 1e-300)]
    deltas = [
        _half(evaluate, points, [moved(part, camera, lights, _shifted(sphere, sign * x)) for sign in (1, -1)])
        for x in steps
    ]
    return {q: float(np.sqrt(sum(d[q] ** 2 for d in deltas))) for q in base}


def _focal(
    rig: PhotographedRig, evaluate: Evaluate, part: xr.Dataset, points: int, base: Mapping[str, float]
) -> dict[str, float]:
    """A focal length that is off moves the sphere along with it, since its outline stays where it is."""
    if not rig.focal_sd or rig.camera.orthographic:
        return dict.fromkeys(base, 0.0)
    camera, lights, sphere = rig_of(part)
    pair = []
    for sign in (1, -1):
        by = 1 + sign * rig.focal_sd
        matrix = camera.matrix.copy()
        matrix[0, 0] *= by
        matrix[1, 1] *= by
        at = camera.rotation @ sphere.centre_mm + camera.translation
        at = at * [1.0, 1.0, by]
        centre = camera.rotation.T @ (at - camera.translation)
        pair.append(moved(part, replace(camera, matrix=matrix), lights, Sphere(centre, sphere.radius_mm)))
    return {q: abs(v) for q, v in _half(evaluate, points, pair).items()}


def _gamma_sd(rig: PhotographedRig) -> tuple[float, str]:
    if rig.linearity is not None and np.isfinite(rig.linearity.standard_error):
        return rig.linearity.standard_error, f"exponent +- {rig.linearity.standard_error:.3f}, from the stack"
    return UNTESTED_GAMMA_SD, f"exponent +- {UNTESTED_GAMMA_SD:g}, assumed"


def _bent(samples: xr.Dataset, exponent: float, *, absolute: bool) -> xr.Dataset:
    geometry = _geometry(samples, *rig_of(samples))
    radiance = samples["value"].values * geometry.irradiance
    # A white target of the same light is bent along with the sphere; without one the mean level stays.
    if absolute:
        pivot = np.median(geometry.irradiance / np.maximum(geometry.cosine, 1e-9)[:, None], axis=0) / np.pi
    else:
        pivot = np.exp(np.mean(np.log(np.maximum(np.abs(radiance), 1e-12)), axis=0))
    bent = np.sign(radiance) * pivot * (np.abs(radiance) / pivot) ** exponent
    out = samples.copy()
    out["value"] = (("sample", "channel"), bent / geometry.irradiance, samples["value"].attrs)
    return out


def _noisy(samples: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
    error = np.nan_to_num(samples["standard_error"].values)
    out = samples.copy()
    noisy = samples["value"].values + rng.normal(size=error.shape) * error
    out["value"] = (("sample", "channel"), noisy, samples["value"].attrs)
    return out


def _scaled(samples: xr.Dataset, factor: float) -> xr.Dataset:
    return samples.assign(value=samples["value"] * factor, standard_error=samples["standard_error"] * factor)


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    bad = [q for q, v in values.items() if not np.isfinite(v)]
    if bad or not values:
        raise InputError.of("quantities", bad or "none", "must be finite", "See that the fit converges first.")
    return dict(values)


def _budget(
    rows: list[dict[str, object]], base: Mapping[str, float], ignored: dict[str, float], count: int
) -> ErrorBudget:
    table = pd.DataFrame(rows)
    table["value"] = table["quantity"].map(base)
    table["relative"] = table["sd"] / table["value"].abs()
    square = table["sd"].fillna(0.0) ** 2
    total = square.groupby(table["quantity"]).transform("sum")
    table["share"] = np.where(total > 0, square / total.where(total > 0, 1.0), 0.0)
    sums = np.sqrt(square.groupby(table["quantity"]).sum())
    totals = pd.DataFrame({"value": pd.Series(base), "sd": sums}).loc[list(base)]
    totals["relative"] = totals["sd"] / totals["value"].abs()
    columns = ["quantity", "source", "value", "sd", "relative", "share", "how"]
    return ErrorBudget(table[columns], totals, ignored, count)
