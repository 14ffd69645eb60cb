"""A sphere of liver in the rig, beside a flat sample of it in the goniometer: Figs. 7.4 and 7.5 of Nunes 2019."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.acquire.instruments.goniometer import goniometer, unoriented
from livlab.acquire.instruments.sphere_rig_tissue import photograph_tissue
from livlab.brdf.sphere import extract
from livlab.kinds.brdf.compare import COMPARISON, Seen, compared, judged
from livlab.kinds.brdf.config import BrdfExperiment
from livlab.kinds.brdf.cuts import BrdfCut, at_angles, flat_cut, half_angle_map, sphere_cut
from livlab.kinds.brdf.materials import COSTS
from livlab.kinds.brdf.pictures import sheet
from livlab.kinds.shared.names import as_kept
from livlab.kinds.shared.seeds import reading_seed
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.tissue.tissue import Tissue
    from livlab.runs.work import Run, Table

RADII = ("reading", "wavelength_nm", "radius_mm", "ratio", "ratio_se")
CUTS = ("reading", "wavelength_nm", "angle_deg", "at_deg", "samples", "sphere", "sphere_se", "goniometer",
        "goniometer_se", "fit")  # fmt: skip


def prepare_liver(config: BrdfExperiment) -> Callable[[Run], None]:
    """The tissue under each reading, then the job."""
    from livlab.kinds.brdf.fits import known_model

    assert config.tissue is not None and config.wavelengths is not None
    tissue = config.tissue.build()
    grid = config.wavelengths.grid()
    stacks = {r.name: optical_stack(tissue, r, grid) for r in config.all_readings}
    if config.fit is not None:
        known_model(config.fit, {})
    return lambda run: _work(run, config, tissue, stacks)


def _work(run: Run, config: BrdfExperiment, tissue: Tissue, stacks: dict[str, OpticalStack]) -> None:
    from livlab.machine.llvm import choose_libllvm

    run.info |= {"variant": config.variant}
    if config.variant == "llvm":
        run.info["libllvm"] = choose_libllvm().name
    run.progress.begin(list(stacks))
    costs: list[dict[str, object]] = []
    tables: dict[str, list[dict[str, object]]] = {
        name: [] for name in ("pictures", "samples", "fits", "radii", "comparison", "cuts")
    }
    seen: dict[str, Seen] = {}
    for name, stack in stacks.items():
        seen[name] = one = _one(run, config, name, stack, costs, tables)
        for nm in (*stack.wavelength_nm.tolist(), None):
            for pair, row in compared(one, stack.wavelength_nm, nm, seed=config.seed).items():
                one.comparison[pair, nm] = row
                tables["comparison"].append({"reading": name, "wavelength_nm": nm, "between": pair, **row})
        tables["cuts"] += _cut_rows(name, stack, one)
        if any(i.redirect != "none" for layer in stack.layers for i in layer.interactions):
            run.note(
                f"{name}: the azimuth in the factor of Algorithm 2 is counted from an axis drawn anew at each "
                "redirection, on the sphere and on the flat sample: the text names none, and a BRDF needs one."
            )
        for note in stack.notes:
            run.note(f"{name}: {note}")
        run.progress.advance(name, 1.0)
    _write(run, config, tissue, stacks, seen, costs, tables)


def _one(
    run: Run,
    config: BrdfExperiment,
    name: str,
    stack: OpticalStack,
    costs: list[dict[str, object]],
    tables: dict[str, list[dict[str, object]]],
) -> Seen:
    seed = reading_seed(config.seed, name)
    samples, seconds = _sphere(run, config, name, stack, config.rig.radius_mm, seed, costs, tables["pictures"])
    measured = _flat(run, config, name, stack, seed, costs)
    scan = config.scan
    cut = _cut(config, samples)
    flat = flat_cut(
        measured, scan.kind, incidence_deg=scan.incidence_deg, last_deg=scan.last_deg, step_deg=scan.step_deg
    )
    one = Seen(cut, flat, measured, samples, stack.wavelength_nm, seconds=seconds + float(measured.attrs["seconds"]))
    tables["samples"].append(_counted(name, samples))
    if config.fit is not None:
        from livlab.kinds.brdf.fits import fit_rows, fit_samples

        started = time.perf_counter()
        one.fit = fit_samples(samples, config.fit, seed=config.seed)
        one.fitted = _along(lambda wi, wo: one.fit.evaluate(wi, wo).to_numpy(), scan.kind, scan.incidence_deg, cut)
        costs.append({"stage": "fit", "subject": name, "seconds": time.perf_counter() - started})
        tables["fits"] += [{"reading": name, **row} for row in fit_rows(one.fit, config.fit, {})]
    if config.radii_mm:
        levels = {}
        for radius in sorted({*config.radii_mm, config.rig.radius_mm}):
            other = samples
            if radius != config.rig.radius_mm:
                other, _ = _sphere(run, config, name, stack, radius, seed, costs, None)
            levels[radius] = _level(other)
        tables["radii"] += _ratios(name, stack, levels)
    return one


def _sphere(
    run: Run,
    config: BrdfExperiment,
    name: str,
    stack: OpticalStack,
    radius_mm: float,
    seed: int,
    costs: list[dict[str, object]],
    rows: list[dict[str, object]] | None,
) -> tuple[xr.Dataset, float]:
    """Samples from pictures of a sphere: as an earlier call left them, or rendered."""
    key = f"sphere {name} {radius_mm:g} mm"
    disc = config.rig.lights.half_angle_deg
    rig = replace(
        config.rig.model_copy(update={"radius_mm": radius_mm}).build(len(stack.wavelength_nm)), silhouette="none"
    )
    kept = run.load_piece(key)
    if kept is None:

        def told(share: float) -> None:
            run.progress.advance(name, 0.6 * share, f"sphere of {radius_mm:g} mm")
            run.stop_if_asked()

        pictures = photograph_tissue(rig, stack, half_angle_deg=disc, seed=seed, variant=config.variant, progress=told)
        assert pictures.variance is not None
        told_of = {which: pictures.images.attrs[which] for which in ("paths", "troubles", "given_up")}
        both = {"images": pictures.images, "variance": pictures.variance}
        kept = xr.Dataset(both, attrs={"seconds": pictures.seconds, **told_of})
        run.save_piece(key, kept)
    seconds = float(kept.attrs["seconds"])
    paths = int(kept.attrs["paths"])
    if kept.attrs["troubles"] > 1e-3 * paths:
        run.note(f"{name}, {radius_mm:g} mm: {int(kept.attrs['troubles'])} of {paths} paths were given up or strayed.")
    lacking = float(kept.attrs.get("given_up", 0.0))
    if lacking > 0.0:
        run.note(
            f"{name}, {radius_mm:g} mm: paths given up still had {lacking:.2g} of all weight; as much light is missing."
        )
    costs.append(
        {"stage": "render", "subject": f"{name}, {radius_mm:g} mm", "seconds": seconds, "samples": paths,
         "samples_per_second": paths / seconds}
    )  # fmt: skip
    if rows is not None:
        png, exposure = sheet(run, f"sphere-{len(rows) + 1}.png", kept["images"])
        rows.append({"reading": name, "png": png, "exposure": exposure})
    started = time.perf_counter()
    samples = extract(
        kept["images"], rig.camera, rig.lights, rig.sphere, variance=kept["variance"],
        max_angle=float(np.radians(config.max_angle_deg)), empty_lights="skip",
    )  # fmt: skip
    costs.append({"stage": "extract", "subject": f"{name}, {radius_mm:g} mm", "seconds": time.perf_counter() - started})
    run.stop_if_asked()
    return samples, seconds


def _flat(
    run: Run, config: BrdfExperiment, name: str, stack: OpticalStack, seed: int, costs: list[dict[str, object]]
) -> xr.Dataset:
    """The goniometer's measurement: as an earlier call left it, or walked."""
    key, spec, scan = f"flat {name}", config.goniometer, config.scan
    measured = run.load_piece(key)
    if measured is None:
        wanted = set(config.lobes_deg)
        if scan.kind == "collinear":
            wanted |= set(np.arange(0.0, scan.last_deg + 1e-9, scan.step_deg).tolist())
        else:
            wanted.add(scan.incidence_deg)

        def told(share: float) -> None:
            run.progress.advance(name, 0.6 + 0.35 * share, "goniometer")
            run.stop_if_asked()

        found = goniometer(
            unoriented(stack), np.radians(sorted(wanted)), spec.detectors(), samples=spec.samples, seed=seed,
            variant=config.variant, progress=told,
        )  # fmt: skip
        measured = as_kept(found)
        run.save_piece(key, measured)
    walked = spec.samples * measured.sizes["theta_i"] * measured.sizes["wavelength"]
    seconds = float(measured.attrs["seconds"])
    costs.append(
        {"stage": "goniometer", "subject": name, "seconds": seconds, "samples": walked,
         "samples_per_second": walked / seconds}
    )  # fmt: skip
    return measured


def _cut(config: BrdfExperiment, samples: xr.Dataset) -> BrdfCut:
    scan, spec = config.scan, config.goniometer
    return sphere_cut(
        samples, scan.kind, incidence_deg=scan.incidence_deg, half_width_deg=scan.width_deg, last_deg=scan.last_deg,
        theta_step_deg=spec.theta_step_deg, phi_step_deg=spec.phi_step_deg, step_deg=scan.step_deg,
    )  # fmt: skip


def _along(evaluate: Callable[[Any, Any], Any], kind: str, incidence_deg: float, cut: BrdfCut) -> Any:
    """(W, A) a fitted model along a cut, where the sphere's samples lie."""
    eye = np.radians(np.where(np.isfinite(cut.at_deg), cut.at_deg, cut.angle_deg))
    # Signed θ_o counts away from the light, which stands at −incidence.
    light = -eye if kind == "collinear" else np.full_like(eye, np.radians(incidence_deg))
    wi = np.stack([-np.sin(light), 0 * light, np.cos(light)], axis=1)
    wo = np.stack([np.sin(eye), 0 * eye, np.cos(eye)], axis=1)
    return evaluate(wi, wo).T


def _counted(name: str, samples: xr.Dataset) -> dict[str, object]:
    from livlab.brdf.grid import Grid
    from livlab.brdf.table import merge

    value, error = samples["value"].to_numpy(), samples["standard_error"].to_numpy()
    lit = value > 0
    return {
        "reading": name,
        "samples": samples.sizes["sample"],
        "median_error": float(np.median(error[lit] / value[lit])) if lit.any() else None,
        "coverage": float(merge(samples, Grid.uniform()).attrs["coverage"]),
    }


def _level(samples: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """(W,) mean of f cos θ_i over all samples, and its standard error."""
    cosine = np.cos(samples["theta_i"].to_numpy())[:, None]
    value, error = samples["value"].to_numpy() * cosine, samples["standard_error"].to_numpy() * cosine
    return value.mean(0), np.sqrt((error**2).sum(0)) / len(value)


def _ratios(
    name: str, stack: OpticalStack, levels: dict[float, tuple[FloatArray, FloatArray]]
) -> list[dict[str, object]]:
    """What each sphere returns, over what the largest returns in the same rig."""
    top, top_error = levels[max(levels)]
    rows: list[dict[str, object]] = []
    for radius, (value, error) in levels.items():
        own = radius != max(levels)
        for w, nm in enumerate(stack.wavelength_nm.tolist()):
            ratio = float(value[w] / top[w])
            spread = float(np.hypot(error[w] / value[w], top_error[w] / top[w])) if own else 0.0
            rows.append(
                {"reading": name, "wavelength_nm": nm, "radius_mm": radius, "ratio": ratio, "ratio_se": ratio * spread}
            )
    return rows


def _cut_rows(name: str, stack: OpticalStack, one: Seen) -> list[dict[str, object]]:
    here = np.flatnonzero(np.isfinite(one.sphere.at_deg))
    known, known_se = at_angles(one.flat, one.sphere.at_deg)
    return [
        {
            "reading": name,
            "wavelength_nm": nm,
            "angle_deg": float(one.sphere.angle_deg[k]),
            "at_deg": float(one.sphere.at_deg[k]),
            "samples": int(one.sphere.count[k]),
            "sphere": float(one.sphere.value[w, k]),
            "sphere_se": float(one.sphere.error[w, k]),
            "goniometer": float(known[w, k]),
            "goniometer_se": float(known_se[w, k]),
            "fit": None if one.fitted is None else float(one.fitted[w, k]),
        }
        for w, nm in enumerate(stack.wavelength_nm.tolist())
        for k in here
    ]


def _write(
    run: Run,
    config: BrdfExperiment,
    tissue: Tissue,
    stacks: dict[str, OpticalStack],
    seen: dict[str, Seen],
    costs: list[dict[str, object]],
    tables: dict[str, list[dict[str, object]]],
) -> None:
    from livlab.kinds.shared import tissue_tables

    readings = config.all_readings
    names = xr.DataArray(list(seen), dims="reading", name="reading")
    parts = [_result(config, stacks[name], one) for name, one in seen.items()]
    root = xr.concat(parts, names, data_vars="all", coords="different", compat="equals", join="outer",
                     combine_attrs="drop")  # fmt: skip
    root.attrs = {"scan": config.scan.kind, "seed": config.seed, "max_angle_deg": config.max_angle_deg}
    run.write_result({"/": root})
    grid = next(iter(stacks.values())).wavelength_nm
    made: dict[str, Table] = {
        "pictures.csv": (("reading", "png", "exposure"), tables["pictures"]),
        "samples.csv": (("reading", "samples", "median_error", "coverage"), tables["samples"]),
        "comparison.csv": (COMPARISON, tables["comparison"]),
        "cuts.csv": (CUTS, tables["cuts"]),
        "radii.csv": (RADII, tables["radii"]),
        "tissue.csv": tissue_tables.tissue(tissue, readings),
        "readings.csv": tissue_tables.readings(readings, tissue),
        "provenance.csv": tissue_tables.provenance(tissue, readings, grid, []),
    }
    if config.fit is not None:
        from livlab.kinds.brdf.fits import COLUMNS

        made["fits.csv"] = (("reading", *COLUMNS), tables["fits"])
    run.finish(judged(config, seen), made, (COSTS, costs))


def _result(config: BrdfExperiment, stack: OpticalStack, one: Seen) -> xr.Dataset:
    """One reading's part of result.nc."""
    cut, dims = one.sphere, ("wavelength", "cut_angle")
    value = one.samples["value"].to_numpy()
    lit = value > 0
    # A pixel that no path reached knows nothing: an error of all of it.
    error = np.where(lit, one.samples["standard_error"].to_numpy() / np.where(lit, value, 1.0), 1.0)
    spec = config.goniometer
    flat, sphere = [], []
    for angle in config.lobes_deg:
        line = flat_cut(one.measured, "incidence", incidence_deg=angle, last_deg=85.0)
        dots = sphere_cut(
            one.samples, "incidence", incidence_deg=angle, half_width_deg=config.scan.width_deg, last_deg=85.0,
            theta_step_deg=spec.theta_step_deg, phi_step_deg=spec.phi_step_deg,
        )  # fmt: skip
        flat.append(line.value)
        sphere.append(dots.value)
    made = xr.Dataset(
        {
            "cut_sphere": (dims, cut.value),
            "cut_sphere_se": (dims, cut.error),
            "cut_at": ("cut_angle", cut.at_deg),
            "cut_goniometer": (dims, one.flat.value),
            "cut_goniometer_se": (dims, one.flat.error),
            "cut_fit": (dims, np.full_like(cut.value, np.nan) if one.fitted is None else one.fitted),
            "flat_lobes": (("incidence", "wavelength", "theta"), np.stack(flat)),
            "sphere_lobes": (("incidence", "wavelength", "theta"), np.stack(sphere)),
            "brdf": one.measured["brdf"],
            "brdf_se": one.measured["brdf_se"],
            "diffuse_reflectance": one.measured["diffuse_reflectance"],
            "diffuse_reflectance_se": one.measured["diffuse_reflectance_se"],
        },
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "cut_angle": ("cut_angle", cut.angle_deg, {"units": "deg"}),
            "incidence": ("incidence", np.asarray(config.lobes_deg, dtype=float), {"units": "deg"}),
            "theta": ("theta", line.angle_deg),
        },
    )
    return xr.merge([made, half_angle_map(one.samples, error)], combine_attrs="drop")
