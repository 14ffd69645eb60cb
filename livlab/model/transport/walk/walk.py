"""Random walk of light through plane layers, all wavelengths in one launch (Nunes 2019, section 6.3).

`analog` is the thesis's walk word for word: every element draws a free path (eq. 6.18), the shortest one is
met, Algorithm 1 absorbs or redirects, Algorithm 2 weighs a redirection by its azimuth. `expected` is the
same walk with the summed rate: absorption lowers the weight, a scatterer is met by its share, and the
azimuth is drawn in proportion to the factor, so that it is a constant. Both estimate the same numbers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, get_args

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.device import BATCH_PHOTONS, LANES, Device, Variant, device
from livlab.model.transport.fresnel import fresnel
from livlab.model.transport.source import Source, check_half_width
from livlab.model.transport.tally import LANE_PHOTONS, LAUNCH_PHOTONS, SampleMoments, Tally
from livlab.model.transport.walk.bins import Bins, Directions
from livlab.model.transport.walk.columns import Columns, Settings
from livlab.model.transport.walk.kernel import trace
from livlab.model.transport.walk.observers import Absorbed, Observer, Totals
from livlab.model.transport.walk.roulette import heaviest
from livlab.model.transport.walk.tables import Estimator, Tables, tables

__all__ = ["Source", "Tally", "merge", "walk"]

CAPTURE_WEIGHT = 0.5
"""A photon of the expected walk below this weight survives a collision by chance, whole, or is absorbed whole.

That is Russian roulette whose survival probability is the albedo itself: unbiased, and unlike the usual
kind it moves no energy from photon to photon, so that every photon's account closes."""

MAX_STEPS = 1 << 24
"""Steps after which a photon is given up: long after roulette has begun to end walks without bias."""

_LANE_SHARE = 48
_VECTOR = 16

_LABELS = {
    "reflectance": ("wavelength",),
    "specular": ("wavelength",),
    "transmittance": ("wavelength",),
    "absorbed": ("wavelength", "layer"),
    "lost": ("wavelength",),
    "redirect_loss": ("wavelength",),
    "residual": ("wavelength",),
    "reflectance_binned": ("wavelength", "theta_o", "radius"),
    "transmittance_binned": ("wavelength", "theta_o", "radius"),
    "reflectance_directed": ("wavelength", "theta_o", "phi"),
}
_MEANING = {
    "reflectance": "light that leaves through the top, without the specular reflection",
    "specular": "Fresnel reflection at the first surface",
    "transmittance": "light that leaves through the bottom",
    "absorbed": "light absorbed in each layer",
    "lost": "light that leaves through the sides",
    "redirect_loss": "light that the redirect factor of Algorithm 2 removes without absorbing it",
    "residual": "light of photons given up before they ended, and what roulette took less what it gave",
    "reflectance_binned": "reflectance in each bin of exit angle and radius",
    "transmittance_binned": "transmittance in each bin of exit angle and radius",
    "reflectance_directed": "reflectance in each bin of exit angle and azimuth",
}


def walk(
    stack: OpticalStack,
    *,
    source: Source | None = None,
    tally: Tally | None = None,
    samples: int = 1_000_000,
    seed: int = 0,
    estimator: Estimator = "expected",
    half_width_mm: float | None = None,
    variant: Variant = "llvm",
    progress: Callable[[float], None] | None = None,
    max_steps: int = MAX_STEPS,
    batch_photons: int | None = None,
) -> xr.Dataset:
    """Reflectance, transmittance and absorption of a stack by random walk.

    Nunes 2019, eq. 6.18 and 6.19, Algorithms 1 and 2; Fresnel's equations for unpolarised light at every
    change of index, sampled; a fresh draw after every interface.

    Parameters
    ----------
    stack
        Layers and wavelengths.
    source
        Default: a collimated pencil along the normal.
    tally
        Bins of exit angle and radius; default: totals only.
    samples
        Photons at each wavelength.
    seed
        Natural number; the same seed gives the same result to the last bit on one machine, any other seed an
        independent one.
    estimator
        "expected" or "analog".
    half_width_mm
        Half the side of a square sample; light that reaches a side is lost. None: endless layers.
    variant
        "llvm" (processor) or "cuda".
    progress
        Called after each batch with the fraction done; it may raise to stop.
    max_steps
        Collisions and interfaces after which a photon is given up (counted in `unfinished` and `residual`). From
        `roulette.FROM` = 131 072 steps on a photon goes on by chance, with more weight: without bias.
    batch_photons
        Photons in one launch over all wavelengths, the grain of progress; default: what suits the variant.

    Returns
    -------
    xr.Dataset
        On `wavelength` in nm: reflectance, specular, transmittance, lost, redirect_loss, residual, absorbed
        (and `layer`), each as a share of the incident light with its standard error `_se` from the photons'
        own variance; `unfinished` photons; `reflectance_binned`, `transmittance_binned` on (`theta_o`,
        `radius`) and `reflectance_directed` on (`theta_o`, `phi`) if asked. reflectance + specular +
        transmittance + Σ absorbed + lost + redirect_loss + residual = 1 for every photon. Attributes: samples,
        seed, variant, estimator, seconds, compile_seconds.

    Raises
    ------
    InputError
        If an argument is out of bounds or the beam is wider than the sample.
    EnvironmentProblem
        If the variant cannot run here.
    """
    source, tally = source or Source.collimated(), tally or Tally()
    d = device(variant)
    batch_photons = BATCH_PHOTONS[variant] if batch_photons is None else batch_photons
    _check(source, samples, estimator, half_width_mm, max_steps, batch_photons)
    started = time.perf_counter()
    t = tables(stack, estimator)
    wavelengths = len(stack.wavelength_nm)
    batches = _batches(samples, max(1, batch_photons // wavelengths))
    total: dict[str, SampleMoments] = {}
    compiling, done = 0.0, 0
    launcher = _Launcher(d, t, source, tally, half_width_mm, max_steps, max(batches))
    for k, n in enumerate(batches):
        part, spent = launcher.batch(n, seed, k)
        total = {name: total[name] + m for name, m in part.items()} if total else part
        compiling += spent
        done += n
        if progress is not None:
            progress(done / samples)
    if "specular" not in total:
        total["specular"] = _constant(_specular(stack, source), samples)
    zero = np.zeros(wavelengths)
    for name in ("lost", "redirect_loss"):
        total.setdefault(name, _constant(zero, samples))
    attributes = {
        "samples": samples,
        "seed": seed,
        "variant": variant,
        "estimator": estimator,
        "seconds": time.perf_counter() - started,
        "compile_seconds": compiling,
        "source": repr(source),
        "half_width_mm": math.inf if half_width_mm is None else half_width_mm,
        "max_steps": max_steps,
    }
    return _dataset(total, stack.wavelength_nm, [x.name for x in stack.layers], tally, attributes)


def merge(results: Sequence[xr.Dataset]) -> xr.Dataset:
    """One result from several independent ones (other seeds) of the same stack and settings.

    Means are weighted by samples and the standard errors follow from the pooled sums, as if all photons had
    been walked at once. `seed` becomes the list of seeds.

    Raises
    ------
    InputError
        If there is none, they differ in wavelengths, layers, bins or settings, or a seed repeats.
    """
    if not results:
        raise InputError.of("results", (), "at least one result is needed", "Walk first.")
    first = results[0]
    seeds = [s for r in results for s in np.atleast_1d(r.attrs["seed"]).tolist()]
    if len(set(seeds)) != len(seeds):
        raise InputError.of("seed", seeds, "seeds must differ", "Walk each part with a seed of its own.")
    same = ("variant", "estimator", "source", "half_width_mm", "max_steps")
    for r in results[1:]:
        for name in same:
            if r.attrs[name] != first.attrs[name]:
                raise InputError.of(name, r.attrs[name], f"differs from {first.attrs[name]!r}", "Merge like results.")
        if set(r.variables) != set(first.variables) or any(not r[c].equals(first[c]) for c in first.coords):
            raise InputError.of("results", list(r.sizes.items()), "differ in their coordinates", "Merge like results.")
    merged = first.copy(deep=True)
    for name in (str(v) for v in first.data_vars if f"{v}_se" in first):
        parts = [
            SampleMoments.from_mean(r.attrs["samples"], r[name].to_numpy(), r[f"{name}_se"].to_numpy()) for r in results
        ]
        pooled = sum(parts[1:], parts[0])
        merged[name].data[...] = pooled.mean
        merged[f"{name}_se"].data[...] = pooled.standard_error
    merged["unfinished"].data[...] = sum(r["unfinished"].to_numpy() for r in results)
    for name in ("samples", "seconds", "compile_seconds"):
        merged.attrs[name] = sum(r.attrs[name] for r in results)
    shares = sum(r["unfinished_share"].to_numpy() * r.attrs["samples"] for r in results)
    merged["unfinished_share"].data[...] = shares / merged.attrs["samples"]
    merged.attrs["seed"] = seeds if len(seeds) > 1 else seeds[0]
    return merged


class _Launcher:
    """A stack on the device, ready for one batch after the other."""

    def __init__(
        self,
        d: Device,
        t: Tables,
        source: Source,
        tally: Tally,
        half_width_mm: float | None,
        max_steps: int,
        largest_batch: int,
    ) -> None:
        redirects = t.shape.redirects != (0,)
        followed = bool(tally.radius_edges or tally.phi_edges)
        space = half_width_mm is not None or followed or (redirects and t.shape.steered)
        self.d, self.tally, self.wavelengths = d, tally, t.index.shape[1]
        self.settings = Settings(source, half_width_mm, CAPTURE_WEIGHT, max_steps, space)
        lanes = _lanes(LANES[d.variant], self.wavelengths, largest_batch)
        self.columns = Columns(d, t, self.settings, lanes)

    def batch(self, samples: int, seed: int, number: int) -> tuple[dict[str, SampleMoments], float]:
        """Sums of every record, and the seconds spent on compiling."""
        shape, dr = self.columns.t.shape, self.d.dr
        random_entry = self.settings.source.kind == "diffuse"
        observers: list[Observer] = [
            Totals(self.settings.half_width_mm is not None, shape.redirects != (0,), random_entry),
            Absorbed(shape.layers),
        ]
        if self.tally.binned:
            observers.append(Bins(self.d, self.tally, self.wavelengths))
        if self.tally.phi_edges:
            observers.append(Directions(self.d, self.tally, self.wavelengths))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            states = trace(self.columns, self.settings, observers, samples, seed, number)
            spent = sum(h.get("codegen_time", 0.0) + h.get("backend_time", 0.0) for h in dr.kernel_history())
        sums: dict[str, SampleMoments] = {}
        for observer, state in zip(observers, states, strict=True):
            sums |= observer.result(self.d, state, self.wavelengths, samples)
        return sums, 1e-3 * spent


def _lanes(target: int, wavelengths: int, samples: int) -> int:
    """Lanes a wavelength: whole vectors, photons enough in each to outlast the longest walk, few enough to sum."""
    wanted = max(min(target // wavelengths, samples // _LANE_SHARE), math.ceil(samples / LANE_PHOTONS), 1)
    return math.ceil(wanted / _VECTOR) * _VECTOR


def _batches(samples: int, most: int) -> list[int]:
    count = math.ceil(samples / most)
    return [samples // count + (k < samples % count) for k in range(count)]


def _constant(values: Any, samples: int) -> SampleMoments:
    return SampleMoments.from_mean(samples, values, np.zeros_like(values))


def _specular(stack: OpticalStack, source: Source) -> Any:
    mu = np.full_like(stack.n_above, math.cos(source.angle_rad))
    return fresnel(stack.n_above, stack.layers[0].n, mu)


def _dataset(
    total: dict[str, SampleMoments], wavelength_nm: Any, layers: list[str], tally: Tally, attributes: dict[str, Any]
) -> xr.Dataset:
    out = xr.Dataset(coords={"wavelength": ("wavelength", wavelength_nm, {"units": "nm"}), "layer": layers})
    axes = [("theta_o", tally.theta, "rad")] if tally.binned or tally.phi_edges else []
    axes += [("radius", tally.radius, "mm")] if tally.binned else []
    axes += [("phi", tally.phi_edges, "rad")] if tally.phi_edges else []
    for name, edges, unit in axes:
        middle = [0.5 * (a + b) for a, b in pairwise(edges)]
        out = out.assign_coords({name: (name, middle, {"units": unit, "edges": list(edges)})})
    for name, dims in _LABELS.items():
        if name not in total:
            continue
        about = {"units": "1", "long_name": _MEANING[name]}
        out[name] = (dims, total[name].mean, about)
        out[f"{name}_se"] = (dims, total[name].standard_error, {"units": "1", "long_name": f"standard error of {name}"})
    about = {"units": "1", "long_name": "photons given up before they ended"}
    count = np.rint(total["unfinished"].total).astype(np.int64)
    out["unfinished"] = ("wavelength", count, about)
    share = count * heaviest(attributes["max_steps"]) / attributes["samples"]
    out["unfinished_share"] = ("wavelength", share, {"units": "1", "long_name": "light they held at most"})
    out.attrs = attributes
    return out


def _check(
    source: Source,
    samples: int,
    estimator: Estimator,
    half_width_mm: float | None,
    max_steps: int,
    batch_photons: int,
) -> None:
    if estimator not in get_args(Estimator):
        raise InputError.of("estimator", estimator, "must be 'expected' or 'analog'", "Name one of the two.")
    for name, value in (("samples", samples), ("max_steps", max_steps), ("batch_photons", batch_photons)):
        if value < 1:
            raise InputError.of(name, value, "must be >= 1", "Ask for at least one.")
    if batch_photons > LAUNCH_PHOTONS:
        raise InputError.of("batch_photons", batch_photons, f"must be <= {LAUNCH_PHOTONS}", "Walk in smaller batches.")
    check_half_width(half_width_mm, source)
