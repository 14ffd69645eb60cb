"""Numbers that a study makes of each curve: metrics against references, colour, amplitude, peak, with their errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.kinds.shared.references import Known, load_reference
from livlab.kinds.shared.sections import Reference
from livlab.kinds.study.config_parts import COLOUR, COMPARING, Output
from livlab.metrics import (
    Normalisation,
    amplitude,
    amplitude_ratio,
    bootstrap_interval,
    colour_difference,
    mse,
    normalise,
    pearson,
    rmse,
    squared_error_sum,
)
from livlab.model.colour import daylight_doubt, daylight_lab
from livlab.units import FloatArray

RESAMPLES = 200

_PAIRS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "rmse": rmse,
    "mse": mse,
    "squared error sum": squared_error_sum,
    "pearson": pearson,
    "amplitude ratio": amplitude_ratio,
}


@dataclass(frozen=True)
class Number:
    """A value and its Monte Carlo error; nan with a reason where there is none."""

    value: float
    standard_error: float = 0.0
    reason: str = ""


@dataclass(eq=False)
class Outputs:
    """The outputs of a study over its wavelengths; references are loaded and held against the bands here.

    Attributes
    ----------
    wavelength_nm
        (W,) of every curve.
    missing
        By output, why it cannot be had at all: a reference that nobody has as numbers.
    names
        Of the outputs.

    Raises
    ------
    InputError
        A reference that is shorter than an output's band, or that is constant where a metric needs it to vary.
    DatasetError
        A dataset that is unknown or damaged, or a column that it lacks.
    """

    specs: Sequence[Output]
    references: Sequence[Reference]
    wavelength_nm: FloatArray
    by: Normalisation
    seed: int = 1
    missing: dict[str, str] = field(default_factory=dict)
    known: list[Known] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.known = [load_reference(r) for r in self.references]
        by_label = {k.spec.label: k for k in self.known}
        self._use = {o.name: o.points(self.wavelength_nm) for o in self.specs}
        self._data: dict[str, FloatArray] = {}
        self._lab: dict[str, Callable[[FloatArray], FloatArray]] = {}
        for o in self.specs:
            use = self._use[o.name]
            if o.metric in COLOUR:
                self._lab[o.name] = daylight_lab(self.wavelength_nm[use])
            if o.metric not in COMPARING:
                continue
            known = by_label[str(o.against)]
            if known.dataset is None:
                self.missing[o.name] = known.reason
                continue
            data = known.at(self.wavelength_nm[use])[0]
            if not np.isfinite(data).all():
                low, high = known.dataset.range_nm
                first, last = self.wavelength_nm[use][[0, -1]]
                raise InputError.of(
                    f"output {o.name}.against",
                    known.spec.label,
                    f"reaches from {low:g} to {high:g} nm only, and the band from {first:g} to {last:g} nm",
                    f"Give band_nm = [{max(low, first):g}, {min(high, last):g}], or fewer wavelengths.",
                )
            if o.metric in ("pearson", "amplitude ratio") and float(np.ptp(data)) == 0.0:
                raise InputError.of(
                    f"output {o.name}.against", known.spec.label, "is constant in the band", "Widen the band."
                )
            self._data[o.name] = data

    @property
    def names(self) -> list[str]:
        """Of the outputs."""
        return [o.name for o in self.specs]

    def numbers(self, value: FloatArray, standard_error: FloatArray | None = None) -> dict[str, Number]:
        """Every output of a curve; with a standard error, each with its own by a parametric bootstrap.

        Parameters
        ----------
        value
            (W,) the curve.
        standard_error
            (W,) its Monte Carlo error, independent from point to point.
        """
        return {o.name: self._number(o, value, standard_error) for o in self.specs}

    def doubts(self, curves: Sequence[FloatArray]) -> list[str]:
        """What cannot be known of the colours of (W,) curves at these wavelengths, one text for outputs alike."""
        by_text: dict[str, list[str]] = {}
        for name in self._lab:
            use = self._use[name]
            seen = [x[use] for x in curves if np.isfinite(x[use]).all()]
            seen += [self._data[name]] if name in self._data else []
            if seen and (told := daylight_doubt(self.wavelength_nm[use], np.stack(seen))):
                by_text.setdefault(told, []).append(name)
        return [f"{', '.join(names)}: {told}" for told, names in by_text.items()]

    def _number(self, o: Output, value: FloatArray, standard_error: FloatArray | None) -> Number:
        if o.name in self.missing:
            return Number(math.nan, math.nan, self.missing[o.name])
        use = self._use[o.name]
        curve = value[use]
        data = self._data.get(o.name, curve)

        def compute(a: FloatArray, b: FloatArray) -> float:
            return self._compute(o, a, b)

        try:
            plain = compute(curve, data)
        except LivlabError as error:
            return Number(math.nan, math.nan, error.message)
        if standard_error is None or not standard_error[use].any():
            return Number(plain)
        try:
            found = bootstrap_interval(
                compute, curve, data, values_error=standard_error[use], resamples=RESAMPLES, seed=self.seed
            )
        except LivlabError:
            return Number(plain, math.nan, "its error could not be had: noise makes some draws impossible")
        return Number(plain, found.standard_error)

    def _compute(self, o: Output, curve: FloatArray, data: FloatArray) -> float:
        if o.metric in _PAIRS:
            return _PAIRS[o.metric](normalise(curve, self.by), normalise(data, self.by))
        if o.metric == "colour difference":
            lab = self._lab[o.name]
            return float(colour_difference(lab(normalise(curve, self.by)), lab(normalise(data, self.by))))
        if o.metric == "mean":
            return float(np.mean(curve))
        if o.metric == "amplitude":
            return amplitude(normalise(curve, self.by))
        if o.metric == "peak wavelength":
            return float(self.wavelength_nm[self._use[o.name]][int(np.argmax(curve))])
        return float(self._lab[o.name](curve)[("lightness", "a*", "b*").index(o.metric)])


def finite(value: Any) -> float | None:
    """A number for a table: None in place of nan."""
    return None if value is None or not math.isfinite(value) else float(value)
