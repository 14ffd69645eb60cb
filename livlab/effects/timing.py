"""What leaving effects out saves in truth: paired walks, timed in processor seconds at equal standard error."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from livlab.effects.plan import Plan, without
from livlab.effects.scene import OpticalScene
from livlab.errors import InputError
from livlab.model.transport.device import Variant
from livlab.model.transport.sampling import SamplingRule, Walks

PILOT = 20_000


@dataclass(frozen=True)
class Saving:
    """A measured saving.

    Attributes
    ----------
    saving
        1 − (t s²) reduced / (t s²) full, t a photon's seconds and s² its variance, mean over the wavelengths.
    standard_error
        From the spread over the pairs.
    full_ns, reduced_ns
        Nanoseconds of processor a photon.
    """

    saving: float
    standard_error: float
    full_ns: float
    reduced_ns: float

    @property
    def factor(self) -> float:
        """How many times faster."""
        return 1.0 / (1.0 - self.saving)


def measured(plan: Plan, *, seconds: float = 1.0, pairs: int = 3, seed: int = 0, variant: Variant = "llvm") -> Plan:
    """The plan with the measured saving of each dropped effect alone, and of all of them together.

    Parameters
    ----------
    plan
        The plan.
    seconds
        Processor seconds that one timing of the full scene takes, about.
    pairs
        Timings of full and reduced, in turn; at least 2.
    seed, variant
        As for a walk.

    Raises
    ------
    InputError
        Fewer than 2 pairs, or seconds that are not above 0.
    """
    if not plan.dropped:
        return plan
    rows = []
    for row in plan.rows:
        found = row
        if row.effect in plan.dropped:
            alone = without(plan.scene, plan.effects, frozenset({row.effect}))
            saving = time_pair(plan.scene, alone, seconds=seconds, pairs=pairs, seed=seed, variant=variant).saving
            found = replace(row, measured_saving=saving)
        rows.append(found)
    together = time_pair(plan.scene, plan.reduced, seconds=seconds, pairs=pairs, seed=seed, variant=variant)
    return replace(plan, rows=tuple(rows), measured_saving=together.saving)


def time_pair(
    full: OpticalScene,
    reduced: OpticalScene,
    *,
    seconds: float = 1.0,
    pairs: int = 3,
    seed: int = 0,
    variant: Variant = "llvm",
) -> Saving:
    """Time two scenes in turn; arguments and errors as `measured`.

    Seconds are the processor's, of all threads together, so that other work on the machine does not count; on a
    graphics card they are the clock's. Compiling happens before.
    """
    if pairs < 2:
        raise InputError.of("pairs", pairs, "must be >= 2", "Two give a spread.")
    if not (np.isfinite(seconds) and seconds > 0):
        raise InputError.of("seconds", seconds, "must be finite and > 0", "Give about 1.")
    scenes = (full, reduced)
    samples = []
    for scene in scenes:
        _walk(scene, PILOT, seed, variant)
        spent, _ = _walk(scene, PILOT, seed + 1, variant)
        samples.append(int(np.clip(PILOT * seconds / max(spent, 1e-4), PILOT, 4_000_000)))
        _walk(scene, samples[-1], seed + 2, variant)
    cost = np.empty((pairs, 2))
    nanoseconds = np.empty((pairs, 2))
    variance = np.zeros(2)
    for k in range(pairs):
        for j, scene in enumerate(scenes):
            spent, squared = _walk(scene, samples[j], seed + 3 + k, variant)
            nanoseconds[k, j] = 1e9 * spent / samples[j] / len(scene.stack.wavelength_nm)
            variance[j] += squared * samples[j] / pairs
    cost = nanoseconds * variance
    ratio = cost[:, 1] / cost[:, 0]
    full_ns, reduced_ns = nanoseconds.mean(axis=0)
    spread = float(ratio.std(ddof=1) / np.sqrt(pairs))
    return Saving(1.0 - float(ratio.mean()), spread, float(full_ns), float(reduced_ns))


def _walk(scene: OpticalScene, samples: int, seed: int, variant: Variant) -> tuple[float, float]:
    """Seconds, and the squared standard error of the value, mean over the wavelengths."""
    clock = time.process_time if variant == "llvm" else time.perf_counter
    view = scene.instrument.readout(scene.stack.n_above)
    rule = SamplingRule(samples=samples, pilot=samples, largest_launch=10**9, seed=seed)
    started = clock()
    walks = Walks(scene.stack, view, rule, variant=variant)
    walks.go()
    return clock() - started, float(np.mean(np.square(walks.standard_error("value"))))
