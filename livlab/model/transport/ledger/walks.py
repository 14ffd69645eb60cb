"""The walks of a ledger: a pilot finds the anchors, then photons are walked until the target is met."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.device import Device, Variant, device
from livlab.model.transport.ledger.bias import interpolation_bias
from livlab.model.transport.ledger.data import Coefficients, Detector, Entries
from livlab.model.transport.ledger.file import stack_digest
from livlab.model.transport.ledger.plan import (
    ACCEPTED,
    LARGEST_DEGENERACY,
    LEAST_ABSORPTION,
    MAX_DEGREE,
    RecordingPlan,
    Share,
    anchors_of,
    make_plan,
    reference_stack,
    share,
    smoothness,
)
from livlab.model.transport.ledger.recorder import Recorder, join
from livlab.model.transport.ledger.recording import LEAST_SAMPLES, Recording
from livlab.model.transport.source import Source, check_half_width
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

PILOT = 8192
"""Photons an anchor of the first launch."""

MOST_PHOTONS = 1 << 25
"""Photons of all anchors at which recording stops, whatever was asked: about 2 GB of rows."""

MAX_STEPS = 1 << 24
_JUDGED = 32
_PLENTY = 4.0  # times the least effective sample size
RESERVE = 0.1
SMOOTHNESS = 40.0
"""Error of ln(1 − g) that interpolation between anchors may make, over the standard error asked: what it leaves
in the reflectance was 0.012 of that at most in liver (`interpolation_bias`), half a standard error."""

R = TypeVar("R", bound=Recording)


@dataclass(frozen=True)
class RecordingTarget:
    """How many photons are wanted at each anchor, or how small an error of the total reflectance.

    Raises
    ------
    InputError
        Photons beside an error, or either out of bounds.
    """

    samples: int | None = None
    standard_error: float | None = None
    relative: float | None = None

    def __post_init__(self) -> None:
        samples, errors = self.samples, {k: getattr(self, k) for k in ("standard_error", "relative")}
        if samples is not None and any(x is not None for x in errors.values()):
            raise InputError.of("samples", samples, "is given beside a wanted error", "Give one of them.")
        if samples is not None and samples < 2:
            raise InputError.of("samples", samples, "must be >= 2", "Ask for more photons.")
        for name, value in errors.items():
            if value is not None and not 1e-7 <= value <= 1.0:
                raise InputError.of(name, value, "must be within [1e-7, 1]", "Ask for an error such as 1e-3.")

    def photons(self, recording: Recording, sets: Coefficients, walked: int) -> int:
        """Photons an anchor that it takes, judged by those walked."""
        if self.samples is not None:
            return self.samples
        # The error is smooth in the wavelength: a few dozen settings tell it.
        some = np.unique(np.linspace(0, len(sets) - 1, _JUDGED).astype(int))
        found = recording.answer(sets.take(some) if self.relative is None else sets, Detector.total())
        worst = math.sqrt(_PLENTY * LEAST_SAMPLES / max(float(found.effective_samples.min()), 1.0))
        if self.standard_error is not None:
            worst = max(worst, float(found.standard_error.max()) / self.standard_error)
        if self.relative is not None:
            value = np.maximum(found.value, 1e-300)
            worst = max(worst, float((found.standard_error / value).max()) / self.relative)
        # A little more than predicted, so that one step is usually enough.
        return walked if worst <= 1.0 else math.ceil(walked * (1.02 * worst) ** 2)


@dataclass(frozen=True)
class RecordingRequest:
    """What is to be recorded beside the stack: the arguments of `record`, which says what they mean."""

    target: RecordingTarget
    seed: int = 0
    source: Source = field(default_factory=Source.collimated)
    tally: Tally = field(default_factory=Tally)
    half_width_mm: float | None = None
    also: Sequence[OpticalStack] = ()
    reserve: float = RESERVE
    anchors: int | None = None
    variant: Variant = "llvm"
    progress: Callable[[float], None] | None = None
    max_steps: int = MAX_STEPS
    check_bias: bool = True
    most_photons: int = MOST_PHOTONS

    @property
    def positions(self) -> bool:
        """Whether places of exit are recorded."""
        return bool(self.tally.radius_edges)

    @property
    def lateral(self) -> bool:
        """Whether places matter at all."""
        return self.half_width_mm is not None or self.positions

    @property
    def first(self) -> int:
        """Photons an anchor of the pilot."""
        return PILOT if self.target.samples is None else min(PILOT, self.target.samples)

    def check(self, stack: OpticalStack) -> None:
        """Refuse what does not fit the stack.

        Raises
        ------
        InputError
        """
        width = len(stack.wavelength_nm)
        if not 0.0 <= self.reserve < 1.0:
            raise InputError.of("reserve", self.reserve, "must be within [0, 1)", "Give a share such as 0.1.")
        if self.anchors is not None and not 1 <= self.anchors <= width:
            raise InputError.of(
                "anchors", self.anchors, f"must be within [1, {width}]", "Leave it out to let livlab choose."
            )
        if self.max_steps < 1:
            raise InputError.of("max_steps", self.max_steps, "must be >= 1", "Ask for at least one.")
        if len(np.unique(stack.wavelength_nm)) != width:
            raise InputError.of("stack.wavelength_nm", "repeated", "must differ", "Give each wavelength once.")
        check_half_width(self.half_width_mm, self.source)
        low, high = stack.wavelength_nm.min(), stack.wavelength_nm.max()
        for other in self.also:
            if len(other.layers) != len(stack.layers):
                wanted = f"must have {len(stack.layers)} layers"
                raise InputError.of("also", len(other.layers), wanted, "Give like stacks.")
            if other.wavelength_nm.min() < low - 1e-9 or other.wavelength_nm.max() > high + 1e-9:
                raise InputError.of("also", "wavelengths", "lie beyond the stack's band", "Give like stacks.")


def make_recording(kind: type[R], stack: OpticalStack, request: RecordingRequest) -> R:
    """Walk once, and keep what answers for all wavelengths of a stack, as a kind of `Recording`.

    Raises
    ------
    InputError, EnvironmentProblem
        As `record`.
    """
    request.check(stack)
    started = time.perf_counter()
    d = device(request.variant)
    stack = stack.at(np.argsort(stack.wavelength_nm, kind="stable").tolist())
    served = Coefficients.of(stack)
    sets = Coefficients.joined([served, *(Coefficients.of(x).fitted(served.thickness_mm) for x in request.also)])
    if request.lateral and any(i.redirect == "cos" for x in stack.layers for i in x.interactions):
        raise InputError.of("redirect", "cos", "has mean zero: no weight for a ledger", "Use walk for such a stack.")
    pilot = _piloted(d, stack, sets, request)
    if pilot.split.degeneracy > LARGEST_DEGENERACY:
        raise InputError.of(
            "stack",
            f"{len(served)} wavelengths",
            "scattering changes too much over the band in layers that are not endless "
            f"(log variance {pilot.split.degeneracy:.2g})",
            "Record shorter bands, or use walk or adding_doubling.",
        )
    walks = _Walks(kind, stack, served, request, pilot, started)
    made = walks.recording()
    most = max(request.most_photons // len(pilot.plan.rows), request.first)
    while True:
        wanted = request.target.photons(made, sets, walks.walked)
        if min(wanted, most) <= walks.walked:
            return made
        walks.walk(min(wanted, most), wanted)
        made = walks.recording()


@dataclass(frozen=True)
class _Pilot:
    """A plan that was tried, and the rows of the trial."""

    plan: RecordingPlan
    recorder: Recorder
    entries: Entries
    paths: FloatArray
    split: Share
    bias: float
    compile_seconds: float


def _piloted(d: Device, stack: OpticalStack, sets: Coefficients, request: RecordingRequest) -> _Pilot:
    """Try plans of rising degree until reweighting and interpolation between the anchors cost little."""
    width, wanted = len(stack.wavelength_nm), request.target.standard_error
    smooth = SMOOTHNESS * (wanted or 1e-3)
    degree = smoothness(sets.take(range(width)), smooth)
    if request.anchors is not None:
        degree = min(degree, request.anchors - 1)
    compiling = 0.0
    while True:
        plan = make_plan(
            stack, sets, lateral=request.lateral, reserve=request.reserve, degree=degree, anchors=request.anchors
        )
        recorder = _recorder(d, stack, plan, request)
        walks = anchors_of(recorder.walked, np.ones(len(plan.rows), dtype=np.int64))
        if math.isinf(share(sets, walks, plan.degree, plan.scaled, np.ones(len(stack.layers))).degeneracy):
            raise InputError.of(
                "stack",
                stack.name,
                "has an endless layer with too little absorption for a walk to end "
                f"(below {LEAST_ABSORPTION:g} of its reduced scattering), or scattering that appears within the band",
                "Give it some absorption or a thickness, or record shorter bands.",
            )
        entries, spent = recorder.launch(request.first, request.seed)
        compiling += spent
        paths = _mean_paths(entries, len(stack.layers))
        split = share(sets, walks, plan.degree, plan.scaled, paths)
        good = split.degeneracy <= ACCEPTED and split.curvature <= 0.25 * smooth
        bias = math.nan
        if request.check_bias and good:
            source = request.source
            tested = interpolation_bias(stack, walks, plan.rows, plan.degree, split.bear, plan.scaled, source)
            bias = float(np.abs(tested).max(initial=0.0))
            good = bias <= 0.5 * (wanted or math.inf)
        if good or request.anchors is not None or degree >= min(MAX_DEGREE, width - 1):
            return _Pilot(plan, recorder, entries, paths, split, bias, compiling)
        degree += 1


def _recorder(d: Device, stack: OpticalStack, plan: RecordingPlan, request: RecordingRequest) -> Recorder:
    return Recorder(
        d=d,
        walked=reference_stack(stack, plan, request.lateral),
        counted=plan.counted,
        source=request.source,
        tally=request.tally,
        half_width_mm=request.half_width_mm,
        positions=request.positions,
        max_steps=request.max_steps,
    )


class _Walks(Generic[R]):
    """Rows recorded so far, and what they come to.

    Attributes
    ----------
    walked
        Photons at each anchor.
    """

    def __init__(
        self,
        kind: type[R],
        stack: OpticalStack,
        served: Coefficients,
        request: RecordingRequest,
        pilot: _Pilot,
        started: float,
    ) -> None:
        self._kind, self._served, self._request, self._pilot, self._started = kind, served, request, pilot, started
        self._parts, self.walked, self._compiling = [pilot.entries], request.first, pilot.compile_seconds
        self._about: dict[str, Any] = {
            "seed": request.seed,
            "variant": request.variant,
            "source": repr(request.source),
            "half_width_mm": math.inf if request.half_width_mm is None else request.half_width_mm,
            "max_steps": request.max_steps,
            "layers": [x.name for x in stack.layers],
            "stack": stack.name,
            "digest": stack_digest(stack),
            "notes": list(stack.notes),
            "interpolation_bias": pilot.bias,
        }

    def walk(self, photons: int, wanted: int) -> None:
        """Go on until so many photons were walked at each anchor; progress counts in those wanted."""
        while self.walked < photons:
            n = min(photons - self.walked, self._pilot.recorder.most)
            entries, spent = self._pilot.recorder.launch(n, self._request.seed)
            self._compiling += spent
            self._parts.append(entries)
            self.walked += n
            if self._request.progress is not None:
                self._request.progress(min(self.walked / max(wanted, 1), 1.0))

    def recording(self) -> R:
        """All of it."""
        plan, request = self._pilot.plan, self._request
        rows = join(self._parts)
        self._parts = [rows]
        photons = np.full(len(plan.rows), self.walked, dtype=np.int64)
        times = {"seconds": time.perf_counter() - self._started, "compile_seconds": self._compiling}
        return self._kind(
            entries=rows,
            anchors=anchors_of(self._pilot.recorder.walked, photons),
            served=self._served,
            degree=plan.degree,
            scaled=plan.scaled,
            counted=plan.counted,
            tally=request.tally,
            source=request.source,
            positions=request.positions,
            paths=self._pilot.paths,
            bear=self._pilot.split.bear,
            depth_bias=plan.depth_bias,
            about={**self._about, **times},
        )


def _mean_paths(entries: Entries, layers: int) -> FloatArray:
    """(L,) mean path of the photons that left, at the reference absorption, mm."""
    weight = np.exp(entries.log_weight.astype(np.float64))
    total = float(weight.sum())
    return np.asarray(weight @ entries.features[:, :layers].astype(np.float64) / max(total, 1e-300))
