"""What is recorded while photons walk: each observer adds its own state to the loop of the kernel.

The kernel knows nothing of tallies. It tells every observer of each step (how far, in which layer, met or
not, what was absorbed) and of each photon's end; a further recorder (path lengths and scatterings a layer,
say) is one more class here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from livlab.model.transport.device import Device
from livlab.model.transport.tally import LANE_FIXED_POINT, SampleMoments
from livlab.units import FloatArray


@dataclass(frozen=True)
class Step:
    """One step of every lane: Bool and Float arrays.

    Attributes
    ----------
    inside
        For each layer, whether the step lies in it.
    path
        Length in mm.
    met
        Whether it ended in a collision with an element (else at an interface or a side).
    absorbed, redirect_loss
        Weight that the collision took, by absorption and by the factor of Algorithm 2; 0 without collision.
    """

    inside: tuple[Any, ...]
    path: Any
    met: Any
    absorbed: Any
    redirect_loss: Any


@dataclass(frozen=True)
class End:
    """The lanes whose photon ends with this step.

    Attributes
    ----------
    done
        Whether it left, was given up, culled or absorbed.
    up, down, side
        Left through the top, the bottom, a side of the sample.
    stopped
        Given up: too many steps, or a weight too small to count.
    unfinished
        The first of these.
    culled
        Ended by roulette, after very many steps.
    balance
        Weight of those stopped or culled, less what roulette gave the photons it left alive; 0 for all others.
    weight
        What it leaves with.
    entered
        What it entered with, 1 less the specular reflection.
    cosine
        Of the exit direction outside with the normal.
    radius
        Of the exit point in mm, None where positions are not followed.
    wavelength
        Index of the lane's wavelength.
    across
        (x, y) of the exit direction outside, () where positions are not followed.
    """

    done: Any
    up: Any
    down: Any
    side: Any
    stopped: Any
    unfinished: Any
    culled: Any
    balance: Any
    weight: Any
    entered: Any
    cosine: Any
    radius: Any
    wavelength: Any
    across: Any = ()


class Observer(Protocol):
    """Records of a walk: state carried by the loop, and what it comes to."""

    def start(self, d: Device, lanes: int) -> Any:
        """State before the first step (a tuple of arrays)."""
        ...

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """State after a step."""
        ...

    def end(self, d: Device, state: Any, end: End) -> Any:
        """State after photons ended; what belongs to one photon is cleared where `end.done`."""
        ...

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """Sums over all lanes, wavelengths first."""
        ...


def _by_wavelength(array: Any, wavelengths: int) -> FloatArray:
    return np.asarray(np.array(array, dtype=np.float64).reshape(wavelengths, -1).sum(1))


class Register:
    """A lane's own sum and sum of squares, over at most `LANE_PHOTONS` photons before the host adds in double.

    The sum counts in units of 2⁻²² (no drift, whatever the number of terms) and keeps what rounding to them
    leaves, so that contributions far below a unit count too; the squares are in float32 (they only make a
    standard error, and may be far below 1).
    """

    @staticmethod
    def start(d: Device, lanes: int) -> tuple[Any, Any, Any]:
        """Zeros."""
        return d.dr.zeros(d.Int32, lanes), d.dr.zeros(d.Float, lanes), d.dr.zeros(d.Float, lanes)

    @staticmethod
    def add(d: Device, sums: tuple[Any, Any, Any], where: Any, value: Any) -> tuple[Any, Any, Any]:
        """Add one photon's contribution, at most 1 in magnitude, in some lanes."""
        v = d.dr.select(where, value, 0.0)
        units = v * LANE_FIXED_POINT
        whole = d.dr.round(units)
        return sums[0] + d.Int32(whole), sums[1] + (units - whole), d.dr.fma(v, v, sums[2])

    @staticmethod
    def moments(sums: tuple[Any, Any, Any], wavelengths: int, samples: int) -> SampleMoments:
        """Sums over lanes, (W,)."""
        units, rest, squares = (_by_wavelength(x, wavelengths) for x in sums)
        return SampleMoments(samples, (units + rest) / LANE_FIXED_POINT, squares)


@dataclass(frozen=True)
class Totals:
    """Reflected, transmitted, lost, and the redirect factor's part.

    Attributes
    ----------
    sides, redirects, random_entry
        Whether light can leave sideways, whether a factor applies, whether entering light varies.
    """

    sides: bool
    redirects: bool
    random_entry: bool

    def start(self, d: Device, lanes: int) -> Any:
        """Registers, a photon's redirect loss, and the count of walks too long."""
        names = ["reflectance", "transmittance", "residual"]
        names += ["lost"] * self.sides + ["redirect_loss"] * self.redirects + ["specular"] * self.random_entry
        return {n: Register.start(d, lanes) for n in names}, d.dr.zeros(d.Float, lanes), d.dr.zeros(d.UInt32, lanes)

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """Add to the photon's redirect loss."""
        sums, loss, count = state
        return (sums, loss + step.redirect_loss, count) if self.redirects else state

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Close the photon's account."""
        sums, loss, count = state
        sums = dict(sums)
        parts = [("reflectance", end.up), ("transmittance", end.down)]
        for name, where in parts + [("lost", end.side)] * self.sides:
            sums[name] = Register.add(d, sums[name], where, end.weight)
        sums["residual"] = Register.add(d, sums["residual"], d.Bool(True), end.balance)
        if self.random_entry:
            sums["specular"] = Register.add(d, sums["specular"], end.done, 1.0 - end.entered)
        if self.redirects:
            # With the plain cosine a photon can lose more than it brought: up to twice.
            half = Register.add(d, sums["redirect_loss"], end.done, 0.5 * loss)
            sums["redirect_loss"], loss = half, d.dr.select(end.done, 0.0, loss)
        return sums, loss, count + d.dr.select(end.unfinished, d.UInt32(1), d.UInt32(0))

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """(W,) each."""
        sums, _, count = state
        out = {name: Register.moments(x, wavelengths, samples) for name, x in sums.items()}
        if self.redirects:
            half = out["redirect_loss"]
            out["redirect_loss"] = SampleMoments(samples, 2.0 * half.total, 4.0 * half.squares)
        stopped = _by_wavelength(count, wavelengths)
        return out | {"unfinished": SampleMoments(samples, stopped, stopped)}


@dataclass(frozen=True)
class Absorbed:
    """Weight absorbed in each layer."""

    layers: int

    def start(self, d: Device, lanes: int) -> Any:
        """A photon's weight and a register for each layer."""
        return tuple((d.dr.zeros(d.Float, lanes), Register.start(d, lanes)) for _ in range(self.layers))

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """Add to the layer the photon is in."""
        return tuple(
            (d.dr.select(here, photon + step.absorbed, photon), sums)
            for here, (photon, sums) in zip(step.inside, state, strict=True)
        )

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Close the photon's account."""
        return tuple(
            (d.dr.select(end.done, 0.0, photon), Register.add(d, sums, end.done, photon)) for photon, sums in state
        )

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """(W, L)."""
        parts = [Register.moments(sums, wavelengths, samples) for _, sums in state]
        total, squares = np.stack([m.total for m in parts], 1), np.stack([m.squares for m in parts], 1)
        return {"absorbed": SampleMoments(samples, total, squares)}
