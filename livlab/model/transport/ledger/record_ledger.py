"""The ledger: one recorded walk that answers for every absorption, and for nearby scattering.

Absorption only weighs a path, exp(−Σ µ_a,j ℓ_j) over the layers; a change of scattering weighs it by
Π (s'/s)ⁿ e^(−(s'−s) ℓ). `record` walks at a few anchor wavelengths and keeps, for each photon that leaves, its
path length and scatterings in every layer; `Ledger` answers from that: spectra, parameter sets, gradients.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.device import Variant, device
from livlab.model.transport.ledger.bias import interpolation_bias
from livlab.model.transport.ledger.data import Coefficients, Detector, Entries
from livlab.model.transport.ledger.file import load, stack_digest
from livlab.model.transport.ledger.ledger import LEAST_SAMPLES, Ledger
from livlab.model.transport.ledger.plan import (
    ACCEPTED,
    LEAST_ABSORPTION,
    MAX_DEGREE,
    WORN,
    Plan,
    anchors_of,
    make_plan,
    reference_stack,
    share,
    smoothness,
)
from livlab.model.transport.ledger.recorder import Recorder, join
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

if TYPE_CHECKING:
    from livlab.units import FloatArray

__all__ = ["Detector", "Ledger", "load", "record"]

PILOT = 8192
"""Photons an anchor of the first launch."""

MOST_PHOTONS = 1 << 25
"""Photons of all anchors at which recording stops, whatever was asked: about 2 GB of rows."""

MAX_STEPS = 100_000
_JUDGED = 32
_PLENTY = 4.0  # times the least effective sample size
RESERVE = 0.1
SMOOTHNESS = 40.0
"""Error of ln(1 − g) that interpolation between anchors may make, over the standard error asked: what it leaves
in the reflectance was 0.012 of that at most in liver (`interpolation_bias`), half a standard error."""


def record(
    stack: OpticalStack,
    *,
    samples: int | None = None,
    standard_error: float | None = None,
    relative: float | None = None,
    seed: int = 0,
    source: Source | None = None,
    tally: Tally | None = None,
    half_width_mm: float | None = None,
    also: Sequence[OpticalStack] = (),
    reserve: float = RESERVE,
    anchors: int | None = None,
    variant: Variant = "llvm",
    progress: Callable[[float], None] | None = None,
    max_steps: int = MAX_STEPS,
    check_bias: bool = True,
    most_photons: int = MOST_PHOTONS,
) -> Ledger:
    """Walk once, and keep what answers for all wavelengths of a stack.

    Each anchor is walked with an absorption a little below the least that is to be served: later weights
    e^(−(µ_a − µ_ref) ℓ) then never exceed one. The last layer, where it is endless to light, is kept in units of
    its mean free path and serves every scattering; the other layers serve scattering near an anchor's.

    Parameters
    ----------
    stack
        Layers and all wavelengths to be served, in any order. Phase functions are used at the anchors only.
    samples
        Photons at each anchor. Or:
    standard_error, relative
        Wanted standard error of the total reflectance at every wavelength, absolute or as a share of it; default
        1e-3 absolute.
    seed
        Natural number; the same seed gives the same ledger on one machine.
    source
        Default: a collimated pencil along the normal.
    tally
        Bins of exit angle and radius that are to be kept when the ledger is compressed. Radii need places, which
        are recorded only if it has `radius_edges`.
    half_width_mm
        Half the side of a square sample; None: endless layers.
    also
        Further stacks to be served, equal in layers and wavelengths' band but for their coefficients: they lower
        the reference absorption, and count in the accuracy.
    reserve
        Share by which the reference absorption stays below the least one served, in [0, 1).
    anchors
        Number of anchors; chosen from the change of phase functions, indices and scattering if not given.
    variant
        "llvm" or "cuda".
    progress
        Called with the fraction done; it may raise to stop.
    max_steps
        Meetings and interfaces after which a photon is given up (`residual`).
    check_bias
        Whether to solve half-way between anchors by `adding_doubling`, so that the bias of interpolation can be told
        (NaN if not).
    most_photons
        Photons in all at which recording stops even if the error is not met (`attrs` of answers tell it).

    Returns
    -------
    Ledger

    Raises
    ------
    InputError
        An argument out of bounds, a factor cos θ (its mean is zero) where places matter, layers that differ
        between the stacks, or scattering that changes too much over the band for the ledger.
    EnvironmentProblem
        The variant cannot run here.
    """
    source, tally = source or Source.collimated(), tally or Tally()
    target = _target(samples, standard_error, relative)
    _check(stack, also, reserve, anchors, half_width_mm, source, max_steps)
    started = time.perf_counter()
    d = device(variant)
    stack = stack.at(np.argsort(stack.wavelength_nm, kind="stable").tolist())
    served = Coefficients.of(stack)
    sets = Coefficients.joined([served, *(Coefficients.of(x).fitted(served.thickness_mm) for x in also)])
    lateral = half_width_mm is not None or bool(tally.radius_edges)
    if lateral and any(i.redirect == "cos" for x in stack.layers for i in x.interactions):
        raise InputError.of("redirect", "cos", "has mean zero: no weight for a ledger", "Use walk for such a stack.")

    def start(plan: Plan) -> Recorder:
        walked = reference_stack(stack, plan, lateral)
        return Recorder(d, walked, plan.counted, source, tally, half_width_mm, bool(tally.radius_edges), max_steps)

    first = PILOT if target.samples is None else min(PILOT, target.samples)
    smooth = SMOOTHNESS * (target.standard_error or 1e-3)
    degree = smoothness(served, smooth) if anchors is None else min(smoothness(served, smooth), anchors - 1)
    compiling = 0.0
    while True:
        plan = make_plan(stack, sets, lateral=lateral, reserve=reserve, degree=degree, anchors=anchors)
        recorder = start(plan)
        walks = anchors_of(recorder.walked, np.ones(len(plan.rows), dtype=np.int64))
        if math.isinf(share(sets, walks, plan.degree, plan.scaled, np.ones(len(stack.layers))).wear):
            raise InputError.of(
                "stack",
                stack.name,
                "has an endless layer with too little absorption for a walk to end "
                f"(below {LEAST_ABSORPTION:g} of its reduced scattering), or scattering that appears within the band",
                "Give it some absorption or a thickness, or record shorter bands.",
            )
        entries, spent = recorder.launch(first, seed)
        compiling += spent
        paths = _mean_paths(entries, len(stack.layers))
        split = share(sets, walks, plan.degree, plan.scaled, paths)
        good = split.wear <= ACCEPTED and split.curvature <= 0.25 * smooth
        bias = math.nan
        if check_bias and good:
            tested = interpolation_bias(stack, walks, plan.rows, plan.degree, split.bear, plan.scaled, source)
            bias = float(np.abs(tested).max(initial=0.0))
            good = bias <= 0.5 * (target.standard_error or math.inf)
        if good or anchors is not None or degree >= min(MAX_DEGREE, len(served) - 1):
            break
        degree += 1
    if split.wear > WORN:
        raise InputError.of(
            "stack",
            f"{len(served)} wavelengths",
            f"scattering changes too much over the band in layers that are not endless (log variance {split.wear:.2g})",
            "Record shorter bands, or use walk or adding_doubling.",
        )
    parts, walked = [entries], first
    about = {
        "seed": seed,
        "variant": variant,
        "source": repr(source),
        "half_width_mm": math.inf if half_width_mm is None else half_width_mm,
        "max_steps": max_steps,
        "layers": [x.name for x in stack.layers],
        "stack": stack.name,
        "digest": stack_digest(stack),
        "notes": list(stack.notes),
        "interpolation_bias": bias,
    }

    def ledger() -> Ledger:
        rows = join(parts)
        parts[:] = [rows]
        photons = np.full(len(plan.rows), walked, dtype=np.int64)
        times = {"seconds": time.perf_counter() - started, "compile_seconds": compiling}
        return Ledger(
            rows,
            anchors_of(recorder.walked, photons),
            served,
            plan.degree,
            plan.scaled,
            plan.counted,
            tally,
            source,
            bool(tally.radius_edges),
            paths,
            split.bear,
            plan.depth_bias,
            {**about, **times},
        )

    made = ledger()
    while True:
        wanted = target.photons(made, sets, walked)
        left = min(wanted, max(most_photons // len(plan.rows), first)) - walked
        if left <= 0:
            return made
        while left > 0:
            n = min(left, recorder.most)
            entries, spent = recorder.launch(n, seed)
            compiling += spent
            parts.append(entries)
            walked += n
            left -= n
            if progress is not None:
                progress(min(walked / max(wanted, 1), 1.0))
        made = ledger()


@dataclass(frozen=True)
class _Target:
    """How many photons are wanted, or how small an error."""

    samples: int | None
    standard_error: float | None
    relative: float | None

    def photons(self, ledger: Ledger, sets: Coefficients, walked: int) -> int:
        """Photons an anchor that it takes, judged by those walked."""
        if self.samples is not None:
            return self.samples
        # The error is smooth in the wavelength: a few dozen settings tell it.
        some = np.unique(np.linspace(0, len(sets) - 1, _JUDGED).astype(int))
        found = ledger.answer(sets.take(some) if self.relative is None else sets, Detector.total())
        worst = math.sqrt(_PLENTY * LEAST_SAMPLES / max(float(found.effective_samples.min()), 1.0))
        if self.standard_error is not None:
            worst = max(worst, float(found.standard_error.max()) / self.standard_error)
        if self.relative is not None:
            value = np.maximum(found.value, 1e-300)
            worst = max(worst, float((found.standard_error / value).max()) / self.relative)
        # A little more than predicted, so that one step is usually enough.
        return walked if worst <= 1.0 else math.ceil(walked * (1.02 * worst) ** 2)


def _target(samples: int | None, standard_error: float | None, relative: float | None) -> _Target:
    if samples is not None and (standard_error is not None or relative is not None):
        raise InputError.of("samples", samples, "is given beside a wanted error", "Give one of them.")
    if samples is not None and samples < 2:
        raise InputError.of("samples", samples, "must be >= 2", "Ask for more photons.")
    for name, value in (("standard_error", standard_error), ("relative", relative)):
        if value is not None and not 1e-7 <= value <= 1.0:
            raise InputError.of(name, value, "must be within [1e-7, 1]", "Ask for an error such as 1e-3.")
    if samples is None and relative is None and standard_error is None:
        standard_error = 1e-3
    return _Target(samples, standard_error, relative)


def _mean_paths(entries: Entries, layers: int) -> FloatArray:
    """(L,) mean path of the photons that left, at the reference absorption, mm."""
    weight = np.exp(entries.log_weight.astype(np.float64))
    total = float(weight.sum())
    return np.asarray(weight @ entries.features[:, :layers].astype(np.float64) / max(total, 1e-300))


def _check(
    stack: OpticalStack,
    also: Sequence[OpticalStack],
    reserve: float,
    anchors: int | None,
    half_width_mm: float | None,
    source: Source,
    max_steps: int,
) -> None:
    if not 0.0 <= reserve < 1.0:
        raise InputError.of("reserve", reserve, "must be within [0, 1)", "Give a share such as 0.1.")
    if anchors is not None and not 1 <= anchors <= len(stack.wavelength_nm):
        raise InputError.of(
            "anchors", anchors, f"must be within [1, {len(stack.wavelength_nm)}]", "Leave it out to let livlab choose."
        )
    if max_steps < 1:
        raise InputError.of("max_steps", max_steps, "must be >= 1", "Ask for at least one.")
    if len(np.unique(stack.wavelength_nm)) != len(stack.wavelength_nm):
        raise InputError.of("stack.wavelength_nm", "repeated", "must differ", "Give each wavelength once.")
    if half_width_mm is not None:
        if not half_width_mm > 0 or math.isinf(half_width_mm):
            raise InputError.of("half_width_mm", half_width_mm, "must be finite and > 0", "Use None for no sides.")
        if source.reach_mm > half_width_mm:
            raise InputError.of(
                "source", source.reach_mm, f"beam reaches beyond half_width_mm = {half_width_mm}", "Narrow the beam."
            )
    for other in also:
        if len(other.layers) != len(stack.layers):
            raise InputError.of("also", len(other.layers), f"must have {len(stack.layers)} layers", "Give like stacks.")
        low, high = stack.wavelength_nm.min(), stack.wavelength_nm.max()
        if other.wavelength_nm.min() < low - 1e-9 or other.wavelength_nm.max() > high + 1e-9:
            raise InputError.of("also", "wavelengths", "lie beyond the stack's band", "Give like stacks.")
