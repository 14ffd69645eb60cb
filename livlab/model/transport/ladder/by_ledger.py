"""The ledger as a solver: one recorded walk for all wavelengths, in a pilot and, where that is not enough, in full."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.device import Variant
from livlab.model.transport.geometry import Readout
from livlab.model.transport.sampling import Clock
from livlab.units import FloatArray

PILOT = 8192
"""Photons an anchor of the pilot."""

MOST = 1 << 25
"""Photons of all anchors, about 2 GB."""

MARGIN = 0.93
"""Share of the wished error that is asked for: what is said of an error is itself known to some percent only."""

FINEST = 1e-7
"""Least error that may be asked of a ledger."""


@dataclass(frozen=True)
class Recorded:
    """What a recorded walk says. (W,) arrays.

    Attributes
    ----------
    value, standard_error
        The reading, and the error of sampling it.
    systematic
        What the interpolation between the anchors may be off, as found half-way between them, and what the light of
        photons that were given up could have added.
    valid
        Whether the record can answer.
    ratio
        Largest error of the reading over the largest of the total reflectance, which is what a ledger is asked for.
    samples
        Photons of all anchors.
    seconds, compile_seconds
        Time of recording and answering, compiling apart; and of compiling.
    given_up
        Largest share of the light, over the wavelengths, that the photons given up held.
    """

    value: FloatArray
    standard_error: FloatArray
    systematic: FloatArray
    valid: NDArray[np.bool_]
    ratio: float
    samples: int
    seconds: float
    compile_seconds: float
    given_up: float = 0.0

    @property
    def notes(self) -> list[str]:
        """What was given up, in words."""
        if not self.given_up:
            return []
        return [f"ledger: photons with {self.given_up:.1g} of the light were given up: it counts as systematic error"]

    @property
    def error(self) -> FloatArray:
        """(W,) both errors together."""
        return np.asarray(np.hypot(self.standard_error, self.systematic))


def recorded(
    stack: OpticalStack,
    view: Readout,
    seed: int,
    *,
    samples: int | None = None,
    standard_error: float | None = None,
    variant: str = "llvm",
    clock: Clock = time.perf_counter,
) -> Recorded:
    """Record a walk, and read the instrument's value at every wavelength.

    Parameters
    ----------
    samples, standard_error
        Photons an anchor, or the error wished of the total reflectance. Only in the second case is the bias of
        interpolation sought.

    Raises
    ------
    InputError
        Scattering that changes too much over the band for a ledger.
    """
    from livlab.model.transport.ledger.record_ledger import record

    started = clock()
    made = record(
        stack,
        samples=samples,
        standard_error=standard_error,
        seed=seed,
        source=view.source,
        tally=view.tally,
        half_width_mm=view.half_width_mm,
        variant=cast(Variant, variant),
        check_bias=samples is None,
        most_photons=MOST,
    )
    # The ledger sorts its wavelengths.
    found = made.spectrum(degenerate="mark").sel(wavelength=stack.wavelength_nm)
    total, total_error = found["reflectance"].to_numpy(), found["reflectance_se"].to_numpy()
    if view.tally.binned:
        value, error = found["reflectance_binned"].to_numpy(), found["reflectance_binned_se"].to_numpy()
        seen = np.einsum("wtr,tr->w", value, view.weights)
        # A photon leaves in one bin, so that the bins' errors are all but independent (the rest lowers them).
        random = np.sqrt(np.einsum("wtr,tr->w", np.square(error), np.square(view.weights)))
    else:
        weight = float(view.weights[0, 0])
        seen, random = weight * total, weight * total_error
    bias = float(found.attrs["interpolation_bias"])
    share = seen / np.maximum(total, 1e-300)
    # Few rows, so that what their own scatter says of them is taken on top.
    held = found["residual"].to_numpy() + found["residual_se"].to_numpy()
    compiling = float(found.attrs["compile_seconds"])
    return Recorded(
        value=seen + view.specular_weight * found["specular"].to_numpy(),
        standard_error=random,
        systematic=(0.0 if math.isnan(bias) else bias) * share + float(np.abs(view.weights).max()) * held,
        valid=np.asarray(found["valid"].to_numpy(), dtype=bool),
        ratio=float(random.max() / max(float(total_error.max()), 1e-300)),
        samples=made.photons,
        seconds=max(clock() - started - compiling, 1e-9),
        compile_seconds=compiling,
        given_up=float(held.max()),
    )


def pilot(
    stack: OpticalStack, view: Readout, seed: int, *, variant: str = "llvm", clock: Clock = time.perf_counter
) -> Recorded:
    """A short record that gauges error and time."""
    return recorded(stack, view, seed, samples=PILOT, variant=variant, clock=clock)


def seconds_for(first: Recorded, accuracy: Accuracy) -> float:
    """Seconds that a wish for an error takes, judged by a shorter record."""
    target = accuracy.target(first.value) or math.inf
    return first.seconds * max(float(first.standard_error.max()) / (MARGIN * target), 1.0) ** 2


def until_met(
    stack: OpticalStack,
    view: Readout,
    accuracy: Accuracy,
    first: Recorded | None,
    seed: int,
    *,
    variant: str = "llvm",
    clock: Clock = time.perf_counter,
    started: float | None = None,
) -> Recorded:
    """Record to the error that the wish asks, or that its time allows; anew and finer if it was missed.

    Parameters
    ----------
    first
        The pilot, if there is one.
    started
        When time began to count, by the clock.
    """
    started = clock() if started is None else started
    last = first or pilot(stack, view, seed, variant=variant, clock=clock)
    asked = math.inf
    for k in range(1, 4):
        worst = float(last.standard_error.max())
        target = accuracy.target(last.value)
        if accuracy.seconds is not None:
            left = accuracy.seconds - (clock() - started)
            # What a first record says of speed includes what each takes anew: it errs towards too little.
            target = worst * math.sqrt(last.seconds / max(0.9 * left, 1e-9))
            if target >= (worst if k == 1 else 0.8 * worst):
                return last
        assert target is not None
        if k > 1 and (float(last.error.max()) <= target or float(last.systematic.max()) >= target):
            return last
        asked = max(min(MARGIN * target / max(last.ratio, 1e-300), 0.8 * asked, 1.0), FINEST)
        last = recorded(stack, view, seed + k, standard_error=asked, variant=variant, clock=clock)
    return last
