"""Spheres of known materials: how near samples and fits come to `bsdf.eval`, with the pose known and with it found."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.acquire.instruments.sphere_rig import Photographs, check_material, photograph, true_value
from livlab.acquire.photographs.pose import sphere_pose
from livlab.brdf.grid import Grid
from livlab.brdf.sphere import extract
from livlab.brdf.table import merge
from livlab.criteria import Claim
from livlab.kinds.brdf.config import BrdfCriterion, BrdfExperiment, MaterialSpec
from livlab.kinds.brdf.cuts import Evaluate, half_angle_map, lobes
from livlab.kinds.brdf.pictures import sheet
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.brdf.geometry import Sphere
    from livlab.runs.work import Run, Table

COSTS = ("stage", "subject", "seconds", "samples", "samples_per_second")
SAMPLES = ("material", "pose", "samples", "relative_rms", "weighted_rms", "percentile_99", "worst", "coverage")
POSES = ("material", "pose", "centre_off_px", "radius_off_px", "residual_px")
POSE_NAMES = ("known", "outline")


@dataclass
class MeasuredMaterial:
    """One material under one pose."""

    samples: xr.Dataset
    truth: FloatArray
    fit: Any = None
    seconds: float = 0.0

    @property
    def error(self) -> FloatArray:
        """(sample, channel) f / f_true − 1."""
        return np.asarray(self.samples["value"].to_numpy() / self.truth - 1.0)

    @property
    def rms(self) -> float:
        """Root mean square of the relative error."""
        return float(np.sqrt(np.mean(self.error**2)))


def prepare_materials(config: BrdfExperiment) -> Callable[[Run], None]:
    """Check every material and model, then the job."""
    if any(m.fit for m in config.material):
        from livlab.kinds.brdf.fits import known_model
    for spec in config.material:
        check_material(spec.bsdf)
        if spec.fit is not None:
            known_model(spec.fit, spec.true)
    return lambda run: _work(run, config)


def _work(run: Run, config: BrdfExperiment) -> None:
    from livlab.machine.llvm import choose_libllvm

    run.info |= {"variant": "llvm_ad_rgb", "libllvm": choose_libllvm().name}
    run.progress.begin([m.name for m in config.material])
    costs: list[dict[str, object]] = []
    tables: dict[str, list[dict[str, object]]] = {"samples": [], "fits": [], "poses": [], "pictures": []}
    found: dict[tuple[str, str], MeasuredMaterial] = {}
    groups: list[xr.Dataset] = []
    for spec in config.material:
        parts = _one(run, config, spec, costs, tables)
        found |= {(spec.name, pose): part for pose, part in parts.items()}
        groups.append(_lobes(config, spec, parts))
        run.progress.advance(spec.name, 1.0)
        run.stop_if_asked()
    claims = [claim for c in config.criterion for claim in _judge(config, c, found)]
    names = xr.DataArray([m.name for m in config.material], dims="material", name="material")
    root = xr.concat(groups, names, data_vars="all", coords="different", compat="equals", join="outer")
    root.attrs = {"max_angle_deg": config.max_angle_deg, "lights": config.rig.lights.number, "seed": config.seed}
    run.write_result({"/": root})
    made: dict[str, Table] = {
        "samples.csv": (SAMPLES, tables["samples"]),
        "poses.csv": (POSES, tables["poses"]),
        "fits.csv": (_fit_columns(), tables["fits"]),
        "pictures.csv": (("material", "png", "exposure"), tables["pictures"]),
    }
    run.finish(claims, made, (COSTS[:3], costs))


def _fit_columns() -> tuple[str, ...]:
    from livlab.kinds.brdf.fits import COLUMNS

    return ("material", "pose", *COLUMNS)


def _one(
    run: Run,
    config: BrdfExperiment,
    spec: MaterialSpec,
    costs: list[dict[str, object]],
    tables: dict[str, list[dict[str, object]]],
) -> dict[str, MeasuredMaterial]:
    """Photograph one material and read it twice."""
    rig = config.rig.build()
    count = len(rig.lights)

    def told(done: int) -> None:
        run.progress.advance(spec.name, 0.5 * done / count, f"{done} of {count} pictures")
        run.stop_if_asked()

    pictures = photograph(rig, spec.bsdf, seed=config.seed, progress=told)
    costs.append({"stage": "render", "subject": spec.name, "seconds": pictures.seconds})
    name, exposure = sheet(run, f"sphere-{len(tables['pictures']) + 1}.png", pictures.images)
    tables["pictures"].append({"material": spec.name, "png": name, "exposure": exposure})
    made = {}
    for pose in POSE_NAMES:
        started = time.perf_counter()
        sphere = pictures.sphere if pose == "known" else _found(spec, pictures, tables["poses"])
        posed = time.perf_counter()
        samples = extract(
            pictures.images, pictures.camera, pictures.lights, sphere,
            max_angle=float(np.radians(config.max_angle_deg)), empty_lights="skip",
        )  # fmt: skip
        taken = time.perf_counter()
        truth = true_value(spec.bsdf, samples["wi"].to_numpy(), samples["wo"].to_numpy())
        part = made[pose] = MeasuredMaterial(samples, truth)
        fitting = time.perf_counter()
        if spec.fit is not None:
            from livlab.kinds.brdf.fits import fit_rows, fit_samples

            part.fit = fit_samples(samples, spec.fit, seed=config.seed)
            tables["fits"] += [
                {"material": spec.name, "pose": pose, **row} for row in fit_rows(part.fit, spec.fit, spec.true)
            ]
        done = time.perf_counter()
        part.seconds = taken - started + done - fitting
        for stage, seconds in (("pose", posed - started), ("extract", taken - posed), ("fit", done - fitting)):
            if (stage != "pose" or pose != "known") and (stage != "fit" or spec.fit is not None):
                costs.append({"stage": stage, "subject": f"{spec.name}, {pose} pose", "seconds": seconds})
        tables["samples"].append({"material": spec.name, "pose": pose, **_summary(part)})
        run.stop_if_asked()
    return made


def _found(spec: MaterialSpec, pictures: Photographs, rows: list[dict[str, object]]) -> Sphere:
    """The sphere as its silhouette shows it, and how far off that is in pixels."""
    assert pictures.outline is not None
    kind = "all-round" if "all-round" in str(pictures.outline.attrs["long_name"]) else "silhouette"
    pose = sphere_pose(pictures.outline.to_numpy(), pictures.camera, pictures.sphere.radius_mm, kind=kind)  # type: ignore[arg-type]
    true = _circle(pictures)
    u, v, r = pose.circle_px
    rows.append(
        {
            "material": spec.name,
            "pose": "outline",
            "centre_off_px": float(np.hypot(u - true[0], v - true[1])),
            "radius_off_px": r - true[2],
            "residual_px": pose.residual_px,
        }
    )
    return pose.sphere


def _circle(pictures: Photographs) -> tuple[float, float, float]:
    """Middle and mean radius of the true outline, px."""
    curve = pictures.sphere.outline(pictures.camera, 720)
    u, v = curve.mean(axis=0)
    return float(u), float(v), float(np.hypot(curve[:, 0] - u, curve[:, 1] - v).mean())


def _summary(part: MeasuredMaterial) -> dict[str, object]:
    samples, error = part.samples, part.error
    weight = np.cos(samples["theta_i"].to_numpy()) * np.cos(samples["theta_o"].to_numpy())
    weighted = np.sqrt(
        np.sum(weight[:, None] * (samples["value"].to_numpy() - part.truth) ** 2)
        / np.sum(weight[:, None] * part.truth**2)
    )
    size = np.abs(error)
    return {
        "samples": samples.sizes["sample"],
        "relative_rms": part.rms,
        "weighted_rms": float(weighted),
        "percentile_99": float(np.quantile(size, 0.99)),
        "worst": float(size.max()),
        "coverage": float(merge(samples, Grid.uniform()).attrs["coverage"]),
    }


def _lobes(config: BrdfExperiment, spec: MaterialSpec, parts: dict[str, MeasuredMaterial]) -> xr.Dataset:
    """What the report draws of a material, from the pictures with the known pose."""
    part = parts["known"]
    lines: dict[str, Evaluate] = {"true": lambda wi, wo: true_value(spec.bsdf, wi, wo)}
    if part.fit is not None:
        lines["fitted"] = lambda wi, wo: part.fit.evaluate(wi, wo).to_numpy()
    made = lobes(part.samples, lines, config.lobes_deg)
    if "fitted" not in made:
        made["fitted"] = xr.full_like(made["true"], np.nan)
    return xr.merge([made, half_angle_map(part.samples, part.error)])


def _judge(config: BrdfExperiment, c: BrdfCriterion, found: dict[tuple[str, str], MeasuredMaterial]) -> list[Claim]:
    claims = []
    for spec in config.material:
        if c.of not in ("all", spec.name):
            continue
        part = found[spec.name, c.pose]
        what = c.metric if c.parameter is None else f"{c.parameter} relative error"
        name = f"{what} {spec.name} vs bsdf.eval, {c.pose} pose"
        if c.metric == "relative rms":
            value = part.rms
        elif c.metric == "seconds":
            name = f"seconds of extraction and fit {spec.name}, {c.pose} pose"
            value = part.seconds
        elif c.metric == "parameter error" and part.fit is not None:
            from livlab.kinds.brdf.fits import relative_error

            found_error = relative_error(part.fit, spec.true, str(c.parameter))
            if found_error is None:
                if c.of != "all":
                    claims.append(Claim.missing(name, "the material's true value is not given", aim=c.aim))
                continue
            value = found_error
        else:
            if c.of == "all":
                continue
            reason = "nothing was fitted" if c.metric == "parameter error" else "is judged for a tissue only"
            claims.append(Claim.missing(name, reason, aim=c.aim))
            continue
        claims.append(Claim.judged(name, value, 0.0, c.aim, seconds=part.seconds))
    return claims
