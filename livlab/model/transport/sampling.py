"""Walks until a wish is met: each wavelength gets the samples that it needs, or its share of the time there is.

A sensor that saw nothing is not taken for dark without noise. What was sampled so far is itself the state to go on
from: the sums of every wavelength, and how the error fell on the way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.geometry import Readout
from livlab.model.transport.tally import SampleMoments
from livlab.model.transport.walk.tables import Estimator
from livlab.units import FloatArray

BUDGET = ("reflectance", "transmittance", "lost", "redirect_loss", "residual", "absorbed")
"""Where light can end, beside the specular reflection; `absorbed` by layer."""

GROWTH = 8
"""A wavelength's samples grow at most this much at once: its noise is only an estimate yet."""

FIRST_AGAINST_THE_CLOCK = 200_000
"""Samples of the first launch, all wavelengths together, where time rules and nobody knows the speed."""

SLACK = 0.03
"""Share of a wished time that may be left unused: a launch too small to help is not made."""

Clock = Callable[[], float]


@dataclass(frozen=True)
class SamplingRule:
    """What rules the sampling: one of `samples`, `standard_error`, `relative` and `seconds`; and its limits.

    Attributes
    ----------
    estimator
        "expected" or "analog".
    samples
        For every wavelength.
    standard_error, relative
        Error that every wavelength must meet; as it is, or as share of the curve's maximum.
    seconds
        Time for all wavelengths; their errors are levelled.
    pilot
        Samples that first gauge a wavelength's noise.
    largest_launch, max_samples, max_seconds
        Samples of a launch, all wavelengths together; of a wavelength; and the time after which to stop unfinished.
    seed
        Of every draw.
    """

    estimator: Estimator = "expected"
    samples: int | None = None
    standard_error: float | None = None
    relative: float | None = None
    seconds: float | None = None
    pilot: int = 65536
    largest_launch: int = 4_000_000
    max_samples: int = 10**9
    max_seconds: float | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        rules = [k for k in ("samples", "standard_error", "relative", "seconds") if getattr(self, k) is not None]
        if len(rules) != 1:
            raise InputError.of("sampling", rules, "exactly one rule is needed", "Give samples, an error, or a time.")


class Point(NamedTuple):
    """Where a sampling stood after a launch: seconds, samples, and root mean square error over the wavelengths."""

    seconds: float
    samples: int
    error: float


class Walks:
    """Sums over photons at each wavelength, and what is still to be sampled.

    Attributes
    ----------
    samples, unfinished
        (W,) photons walked, and given up.
    unfinished_share
        (W,) light at most that those given up still held.
    specular
        (W,) reflection of the first surface.
    launches, seconds, compile_seconds
        Launches so far and the time they took, of which compiling.
    trace
        How the error fell, a point a launch.
    """

    def __init__(
        self,
        stack: OpticalStack,
        view: Readout,
        rule: SamplingRule,
        *,
        variant: str = "llvm",
        clock: Clock = time.perf_counter,
    ) -> None:
        self.stack, self.view, self.rule, self.variant, self._clock = stack, view, rule, variant, clock
        w, layers = len(stack.wavelength_nm), len(stack.layers)
        self.samples = np.zeros(w, dtype=np.int64)
        shapes = dict.fromkeys(("value", *BUDGET), (w,)) | {"absorbed": (w, layers)}
        self._total: dict[str, FloatArray] = {name: np.zeros(shape) for name, shape in shapes.items()}
        self._squares: dict[str, FloatArray] = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.specular = np.zeros(w)
        self.unfinished = np.zeros(w, dtype=np.int64)
        self.unfinished_share = np.zeros(w)
        self.launches, self.seconds, self.compile_seconds = 0, 0.0, 0.0
        self.trace: list[Point] = []

    def mean(self, name: str) -> FloatArray:
        """Mean a photon of "value" (without the specular part) or a part of the budget."""
        return self._total[name] / self._n(name)

    def standard_error(self, name: str) -> FloatArray:
        """Its standard error, from the photons' own variance."""
        n = self._n(name)
        spread = np.maximum(self._squares[name] - self._total[name] ** 2 / n, 0.0)
        return np.asarray(np.sqrt(spread / np.maximum(n - 1.0, 1.0) / n))

    def value(self) -> FloatArray:
        """(W,) what the instrument reads."""
        return self.mean("value") + self.view.specular_weight * self.specular

    def error(self) -> FloatArray:
        """(W,) its error as sampling takes it: no light seen is no proof of none, one photon more could have come."""
        least = float(self.view.weights.max()) / np.maximum(self.samples, 1)
        return np.asarray(np.maximum(self.standard_error("value"), least))

    def systematic(self, name: str) -> FloatArray:
        """Bound of what "value" or a part of the budget lacks because photons were given up: all that it could get."""
        share = self.unfinished_share
        if name == "value":
            return np.asarray(float(np.abs(self.view.weights).max()) * share)
        if name == "absorbed":
            return np.asarray(share[:, None] * np.stack([x.absorption > 0 for x in self.stack.layers], axis=1))
        shut = {
            "transmittance": math.isinf(self.stack.layers[-1].thickness_mm),
            "lost": self.view.half_width_mm is None,
            "redirect_loss": all(i.redirect == "none" for x in self.stack.layers for i in x.interactions),
        }
        return np.zeros_like(share) if shut.get(name, False) else share.copy()

    def notes(self) -> list[str]:
        """What was given up, in words."""
        if not self.unfinished.any():
            return []
        return [
            f"{int(self.unfinished.sum())} photons were given up before they ended, with up to "
            f"{self.unfinished_share.max():.1g} of the light: it counts as systematic error"
        ]

    def go(self, on_launch: Callable[[Walks], None] | None = None) -> None:
        """Launch until the rule is met; what `on_launch` raises stops it."""
        while (plan := self.plan()) is not None:
            self.launch(*plan)
            if on_launch is not None:
                on_launch(self)

    def needed(self) -> FloatArray:
        """(W,) samples that each wavelength wants in the end, as far as is known."""
        s = self.rule
        if s.samples is not None:
            return np.full(len(self.samples), float(s.samples))
        if s.seconds is not None:
            return self.samples.astype(np.float64)
        error = self.error()
        target = s.standard_error if s.standard_error is not None else (s.relative or 0.0) * float(np.max(self.value()))
        if target <= 0.0:
            # Nothing at all reached the sensor yet: look on for a while, then give up.
            return np.full(len(self.samples), 64.0 * s.pilot)
        wanted = self.samples * np.square(error / target)
        # A resumed state has been through rounding once.
        met = error <= target * (1.0 + 1e-9)
        return np.where(met, self.samples, np.maximum(np.ceil(1.02 * wanted), self.samples + 1))

    def plan(self) -> tuple[NDArray[np.intp], int] | None:
        """Wavelengths and samples of the next launch; None when all is done."""
        s = self.rule
        if s.seconds is not None:
            return self._plan_by_time(s.seconds)
        if s.max_seconds is not None and self.launches and self.seconds >= s.max_seconds:
            return None
        first = s.pilot if s.samples is None else min(s.pilot, s.samples)
        needed = np.where(self.samples == 0, first, self.needed())
        needed = np.minimum(needed, s.max_samples)
        left = needed - self.samples
        active = np.flatnonzero(left > 0)
        if not active.size:
            return None
        # Those who need about as little as the least go together, so that launches stay few.
        near = left[active][left[active] <= 1.3 * left[active].min()]
        wanted = near.max()
        if s.samples is None:
            wanted = max(wanted, first / 4)
            wanted = min(wanted, max(first, GROWTH * float(self.samples[active].min())))
        room = s.largest_launch // active.size
        if s.max_seconds is not None and self.launches:
            room = min(room, int(self.speed() * (s.max_seconds - self.seconds) / active.size))
        return active, max(1, min(math.ceil(wanted), max(room, 1)))

    def _plan_by_time(self, seconds: float) -> tuple[NDArray[np.intp], int] | None:
        """The noisiest wavelengths next, with no more than half of what is left unless they are all."""
        s = self.rule
        if not self.launches:
            first = max(1000, min(s.pilot, FIRST_AGAINST_THE_CLOCK // len(self.samples)))
            return np.arange(len(self.samples)), min(first, s.max_samples)
        left = seconds - self.seconds
        error = np.where(self.samples < s.max_samples, self.error(), 0.0)
        if left <= SLACK * seconds or not error.any():
            return None
        active = np.flatnonzero(error >= 0.7 * error.max())
        time_share = left if active.size == len(error) else 0.5 * left
        room = self.speed() * time_share / active.size
        have = int(self.samples[active].min())
        # What cannot shrink an error by half a percent is not worth its launch.
        if room < max(1.0, 0.01 * have):
            return None
        count = min(room, float(GROWTH * have), float(s.max_samples - have), s.largest_launch / active.size)
        return active, max(1, int(count))

    def launch(self, active: NDArray[np.intp], samples: int) -> None:
        """Walk `samples` photons at each of some wavelengths, and add them up."""
        from livlab.model.transport.walk.walk import walk

        started = self._clock()
        part = walk(
            self.stack.at(active.tolist()),
            source=self.view.source,
            tally=self.view.tally,
            samples=samples,
            seed=_seed(self.rule.seed, self.launches),
            estimator=self.rule.estimator,
            half_width_mm=self.view.half_width_mm,
            variant=self.variant,  # type: ignore[arg-type]
        )
        for name in BUDGET:
            self._add(name, active, SampleMoments.from_mean(samples, *_pair(part, name)))
        self._add_value(active, samples, part)
        self.specular[active] = part["specular"].to_numpy()
        self.unfinished[active] += part["unfinished"].to_numpy()
        held = self.unfinished_share[active] * self.samples[active] + part["unfinished_share"].to_numpy() * samples
        self.samples[active] += samples
        self.unfinished_share[active] = held / self.samples[active]
        self.launches += 1
        self.seconds += self._clock() - started
        self.compile_seconds += float(part.attrs["compile_seconds"])
        error = float(np.sqrt(np.mean(np.square(self.error()))))
        self.trace.append(Point(self.seconds, int(self.samples.sum()), error))

    def speed(self) -> float:
        """Samples a second so far, compiling apart."""
        return float(self.samples.sum()) / max(self.seconds - self.compile_seconds, 1e-3)

    def take(self, earlier: xr.Dataset) -> None:
        """Go on from an earlier result of the same walks: what `spectrometer.measure` returned."""
        self.samples = earlier["samples"].to_numpy().astype(np.int64)
        self.specular = earlier["specular"].to_numpy().copy()
        self.unfinished = earlier["unfinished"].to_numpy().astype(np.int64)
        # An older result knows only how many; each of them held at most its whole light.
        share = earlier["unfinished_share"] if "unfinished_share" in earlier else earlier["unfinished"] / self.samples
        self.unfinished_share = np.asarray(share.to_numpy(), dtype=np.float64).copy()
        for name in BUDGET:
            self._restore(name, *_pair(earlier, name))
        scattered = earlier["value"].to_numpy() - self.view.specular_weight * self.specular
        self._restore("value", scattered, earlier["standard_error"].to_numpy())
        for name in ("launches", "seconds", "compile_seconds"):
            setattr(self, name, earlier.attrs[name])
        columns = [np.atleast_1d(earlier.attrs.get(f"trace_{name}", [])).tolist() for name in Point._fields]
        self.trace = [Point(float(t), int(n), float(e)) for t, n, e in zip(*columns, strict=True)]

    def converged(self) -> NDArray[np.bool_]:
        """(W,) whether each wavelength has all it needs."""
        blind = self.rule.relative is not None and float(np.max(self.value())) <= 0.0
        return np.asarray((self.samples > 0) & (self.samples >= self.needed()) & (not blind))

    def done(self) -> tuple[float, float]:
        """Share done, and the seconds left at the mean speed so far."""
        have = int(self.samples.sum())
        if self.rule.seconds is not None:
            return min(1.0, self.seconds / self.rule.seconds), max(self.rule.seconds - self.seconds, 0.0)
        wanted = np.maximum(np.minimum(self.needed(), self.rule.max_samples), self.samples).sum()
        done = have / float(wanted)
        left = max(self.seconds - self.compile_seconds, 0.0) * (1.0 / done - 1.0)
        if self.rule.max_seconds is not None:
            left = min(left, max(self.rule.max_seconds - self.seconds, 0.0))
        return done, left

    def trace_attributes(self) -> dict[str, Any]:
        """The trace as `take` reads it: one list a column."""
        columns = zip(*self.trace, strict=True) if self.trace else ([], [], [])
        return {f"trace_{name}": np.array(x) for name, x in zip(Point._fields, columns, strict=True)}

    def _n(self, name: str) -> FloatArray:
        n = np.maximum(self.samples, 1).astype(np.float64)
        return n[:, None] if self._total[name].ndim == 2 else n

    def _add(self, name: str, at: NDArray[np.intp], sums: SampleMoments) -> None:
        self._total[name][at] += sums.total
        self._squares[name][at] += sums.squares

    def _add_value(self, at: NDArray[np.intp], samples: int, part: xr.Dataset) -> None:
        binned = self.view.tally.binned
        sums = SampleMoments.from_mean(samples, *_pair(part, "reflectance_binned" if binned else "reflectance"))
        total, squares = (x if binned else x[:, None, None] for x in (sums.total, sums.squares))
        # A photon leaves once, so it is in one bin: the squares of the weighted sum add without cross terms.
        self._total["value"][at] += np.einsum("wtr,tr->w", total, self.view.weights)
        self._squares["value"][at] += np.einsum("wtr,tr->w", squares, np.square(self.view.weights))

    def _restore(self, name: str, mean: FloatArray, error: FloatArray) -> None:
        n = self._n(name)
        self._total[name] = n * mean
        self._squares[name] = n * np.square(mean) + np.square(error) * (n - 1.0) * n


def _pair(part: xr.Dataset, name: str) -> tuple[FloatArray, FloatArray]:
    return part[name].to_numpy(), part[f"{name}_se"].to_numpy()


def _seed(seed: int, launch: int) -> int:
    return int(np.random.SeedSequence([seed, launch]).generate_state(1)[0] >> 1)
