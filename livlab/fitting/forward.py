"""A spectrum as a function of tissue parameters: one recorded ledger answers for every trial of a fit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.instruments.models import Instrument
from livlab.errors import InputError, LivlabError
from livlab.fitting.stacks import StackMaker
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue
from livlab.model.transport.device import Variant
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.transport.geometry import Readout
    from livlab.model.transport.ledger.record_ledger import Detector, Ledger

STEP = 1e-6
"""Relative step of the differences of coefficients: they are smooth, and exact to 1e-15, so one side is enough."""


@dataclass(frozen=True, eq=False)
class Response:
    """What an instrument reads at (W,) wavelengths.

    Attributes
    ----------
    value, standard_error
        (W,) the reading and its Monte Carlo error.
    valid
        (W,) whether the ledger can answer there.
    slopes
        (W,) derivative by each parameter, by name; empty unless asked for.
    """

    value: FloatArray
    standard_error: FloatArray
    valid: NDArray[np.bool_]
    slopes: Mapping[str, FloatArray]


class LedgerForward:
    """The reading of an instrument on a tissue whose values, by path, are the parameters.

    Call `record` before the first `answer`. The draws stay the same until the next `record` (common random numbers),
    so that an answer is a smooth function of the parameters.

    Parameters
    ----------
    tissue, reading
        The tissue, and how it is read.
    wavelength_nm
        (W,) rising.
    instrument
        What looks at it.
    names
        Paths of the parameters, e.g. layers.parenchyma.elements.blood.fraction.
    standard_error
        Of the total reflectance at the recorded parameters.
    variant
        Where it walks.

    Raises
    ------
    ConfigError
        A path that leads nowhere.
    """

    def __init__(
        self,
        tissue: Tissue,
        reading: Reading,
        wavelength_nm: FloatArray,
        instrument: Instrument,
        names: Sequence[str],
        *,
        standard_error: float = 1e-3,
        variant: Variant = "llvm",
    ) -> None:
        self.tissue, self.reading, self.instrument = tissue, reading, instrument
        self.wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
        self.names = tuple(names)
        self.standard_error, self.variant = standard_error, variant
        self.ledger: Ledger | None = None
        self.readout: Readout | None = None
        self.recordings: list[dict[str, object]] = []
        self._whole = StackMaker(tissue, reading, self.wavelength_nm, self.names)
        self._asked = self._whole
        self._use = np.ones(len(self.wavelength_nm), dtype=bool)

    def stack(self, values: Mapping[str, float]) -> OpticalStack:
        """The optical stack at given values of the parameters."""
        return self._whole(values)

    def focus(self, use: NDArray[np.bool_] | None) -> None:
        """Answer at some of the wavelengths only, (W,), until told otherwise; the others are nan and not valid."""
        self._use = np.ones(len(self.wavelength_nm), dtype=bool) if use is None else np.asarray(use, dtype=bool)
        whole = bool(self._use.all())
        used = self.wavelength_nm[self._use]
        self._asked = self._whole if whole else StackMaker(self.tissue, self.reading, used, self.names)

    def adopt(self, other: LedgerForward) -> None:
        """Answer from what another forward recorded, of the same layers and instrument."""
        self.ledger, self.readout, self.recordings = other.ledger, other.readout, list(other.recordings)

    def record(
        self,
        centre: Mapping[str, float],
        others: Sequence[Mapping[str, float]] = (),
        *,
        seed: int = 1,
        coarser: float = 1.0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Walk anew about a centre, so that `others` are served too, with `coarser` times the standard error.

        Raises
        ------
        InputError
            Values at which the tissue does not hold together, or that one ledger cannot serve.
        """
        stacks = [self.stack(other) for other in others]
        self.record_stacks(self.stack(centre), stacks, seed=seed, coarser=coarser, progress=progress)

    def record_stacks(
        self,
        stack: OpticalStack,
        others: Sequence[OpticalStack] = (),
        *,
        seed: int = 1,
        coarser: float = 1.0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """`record`, of optical stacks as they are."""
        from livlab.model.transport.ledger.record_ledger import record

        started = time.perf_counter()
        self.readout = self.instrument.readout(stack.n_above)
        self.ledger = record(
            stack,
            standard_error=coarser * self.standard_error,
            seed=seed,
            source=self.readout.source,
            tally=self.readout.tally,
            half_width_mm=self.readout.half_width_mm,
            also=others,
            variant=self.variant,
            progress=progress,
        )
        self.recordings.append(
            {
                "seed": seed,
                "standard_error": coarser * self.standard_error,
                "photons": self.ledger.photons,
                "rows": len(self.ledger),
                "anchors_nm": " ".join(f"{x:g}" for x in self.ledger.anchors.wavelength_nm),
                "interpolation_bias": float(self.ledger.about["interpolation_bias"]),
                "seconds": time.perf_counter() - started,
            }
        )

    def answer(self, values: Mapping[str, float], *, gradient: bool = False) -> Response:
        """The reading at given values.

        Raises
        ------
        InputError
            Values at which the tissue does not hold together, or nothing recorded yet.
        """
        at = {name: float(values[name]) for name in self.names}
        found, by_absorption, by_scattering = self._read(self._asked(at), gradient)
        slopes = {}
        if gradient:
            for name in self.names:
                absorption, scattering = self._tangent(at, name)
                slopes[name] = self._spread((by_absorption * absorption + by_scattering * scattering).sum(axis=1))
        valid = np.zeros(len(self._use), dtype=bool)
        valid[self._use] = found.valid
        return Response(self._spread(found.value), self._spread(found.standard_error), valid, slopes)

    def noise_covariance(self, values: Mapping[str, float]) -> FloatArray:
        """(W, W) covariance of the reading's Monte Carlo errors, nan outside the focus.

        One photon answers at every wavelength, so they hang together.

        Raises
        ------
        InputError
            As `answer`.
        """
        from livlab.fitting.noise import covariance

        stack = self._asked({name: float(values[name]) for name in self.names})
        size = len(self._use)
        made = np.full((size, size), np.nan)
        made[np.ix_(self._use, self._use)] = covariance(self._recorded(), stack, self._detectors())
        return made

    def bias_covariance(self) -> FloatArray:
        """(W, W) second moments of what interpolation between the ledger's anchors costs: smooth, and of unknown sign.

        The largest that was measured when it was recorded, alike within half the distance of two anchors.
        """
        ledger, x = self._recorded(), self.wavelength_nm
        bias = abs(float(ledger.about["interpolation_bias"]))
        reach = max(0.5 * float(x[-1] - x[0]) / max(len(ledger.anchors) - 1, 1), 1.0)
        return np.asarray(bias**2 * np.exp(-0.5 * ((x[:, None] - x) / reach) ** 2))

    def _spread(self, values: FloatArray) -> FloatArray:
        """Values at the wavelengths in focus, on all."""
        made = np.full(len(self._use), np.nan)
        made[self._use] = values
        return made

    def _recorded(self) -> Ledger:
        if self.ledger is None or self.readout is None:
            raise InputError.of("ledger", None, "nothing is recorded yet", "Call record first.")
        return self.ledger

    def answer_stack(self, stack: OpticalStack) -> Response:
        """The reading of an optical stack as it is; the slope "absorption" is that by its last layer's coefficient.

        Raises
        ------
        InputError
            A stack that the ledger cannot answer for, or nothing recorded yet.
        """
        found, by_absorption, _ = self._read(stack, True)
        return Response(found.value, found.standard_error, found.valid, {"absorption": by_absorption[:, -1]})

    def _read(self, stack: OpticalStack, gradient: bool) -> tuple[Response, FloatArray, FloatArray]:
        """The reading, and its (W, L) derivatives by the layers' coefficients."""
        from livlab.model.transport.ledger.plan import specular
        from livlab.model.transport.ledger.tables import fitted

        ledger = self._recorded()
        assert self.readout is not None
        size = len(stack.wavelength_nm)
        value, variance, valid = np.zeros(size), np.zeros(size), np.ones(size, dtype=bool)
        sets = fitted(ledger, stack)
        by_absorption, by_scattering = np.zeros_like(sets.absorption), np.zeros_like(sets.absorption)
        for detector, weight in self._detectors():
            found = ledger.answer(sets, detector, gradient=gradient)
            value += weight * found.value
            variance += (weight * found.standard_error) ** 2
            valid &= found.valid
            by_absorption += weight * found.by_absorption
            by_scattering += weight * found.by_scattering
        if self.readout.specular_weight:
            value += self.readout.specular_weight * specular(sets.index, self.readout.source)
        return Response(value, np.sqrt(variance), valid, {}), by_absorption, by_scattering

    def _tangent(self, at: Mapping[str, float], name: str) -> tuple[FloatArray, FloatArray]:
        """(W, L) change of the coefficients with a parameter: a smooth function without chance, so differences do."""
        from livlab.model.transport.ledger.tables import fitted

        ledger = self._recorded()
        here = fitted(ledger, self._asked(at))
        h = STEP * abs(at[name]) if at[name] else STEP
        for step in (h, -h):
            try:
                there = fitted(ledger, self._asked({**at, name: at[name] + step}))
            except LivlabError:  # the tissue ends here: a share of 1, say
                continue
            # Scattering acts by s (1 − g): a change of g is one of s.
            turned = here.scattering * (there.anisotropy - here.anisotropy) / (1.0 - here.anisotropy)
            absorption, scattering = there.absorption - here.absorption, there.scattering - here.scattering - turned
            return absorption / step, scattering / step
        return np.zeros_like(here.absorption), np.zeros_like(here.absorption)

    def _detectors(self) -> list[tuple[Detector, float]]:
        """What of the light that leaves counts, and how much."""
        from itertools import pairwise

        from livlab.model.transport.ledger.record_ledger import Detector

        assert self.readout is not None
        tally, weights = self.readout.tally, self.readout.weights
        found = []
        for t, theta in enumerate(pairwise(tally.theta)):
            for r, radius in enumerate(pairwise(tally.radius)):
                if t < weights.shape[0] and r < weights.shape[1] and weights[t, r]:
                    found.append((Detector("up", theta, radius), float(weights[t, r])))
        return found
