"""What a BRDF fit found, how sure it is, and what to mistrust about it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from livlab.brdf.fit.problem import Layout
from livlab.brdf.fit.widen import skew
from livlab.brdf.models.model import Model
from livlab.core import markup
from livlab.optimise import Identifiability, OptimiseResult
from livlab.optimise.misfit import Misfit, times


@dataclass(frozen=True, eq=False)
class BrdfFit:
    """Outcome of `livlab.brdf.fit.fit.fit`.

    True in a condition if the search converged, all parameters are held, and the model does not miss the data.

    Attributes
    ----------
    model
        What was fitted.
    table
        One row a parameter: value; sd and lower, upper, both from the scatter between the same blocks (`resampled`);
        sd_independent, as if every residual were independent; status, held, channel, meaning.
    loss, loss_value
        The loss in words, and half its sum of squares at the optimum.
    rmse, relative_rmse
        Root mean square of (f_model − f) cos θ_i over the pixels, in 1/sr and over that of f cos θ_i.
    misfit
        How far the model misses the data by their own noise, on what the residuals hang, and where most.
    noise_floor
        What `relative_rmse` would be of noise alone; NaN if the noise is not known.
    samples, pixels, effective
        Samples after pixels were merged, pixels, and how many independent residuals they are worth.
    aic, bic
        Akaike's and Schwarz's criteria with `effective` samples; they compare models on the same data and loss.
    correlation
        Of the free parameters.
    identifiability
        What the data hold.
    combinations
        In words, the products that are measured where their factors are not.
    footprint
        How pixels were integrated.
    resampled, left_out, level
        What sd and intervals take as independent, which errors they cannot hold, and the intervals' coverage.
    widened
        Largest factor by which sd and interval of a parameter grew since the model misses the data (column `widened`).
    theta_d_range
        Smallest and largest θ_d of the samples in radians: what the angle dependence of Fresnel's term rests on.
    warnings
        Sentences.
    search
        The optimiser's record of the final stage.
    starts
        One row a start of the search on a part of the samples.
    seconds
        Wall time.
    """

    model: Model
    table: pd.DataFrame
    loss: str
    loss_value: float
    rmse: float
    relative_rmse: float
    misfit: Misfit
    noise_floor: float
    samples: int
    pixels: int
    effective: float
    aic: float
    bic: float
    correlation: pd.DataFrame
    identifiability: Identifiability
    combinations: tuple[str, ...]
    footprint: str
    resampled: str
    left_out: str
    widened: float
    level: float
    theta_d_range: tuple[float, float]
    warnings: tuple[str, ...]
    search: OptimiseResult
    starts: pd.DataFrame = field(repr=False)
    seconds: float
    layout: Layout = field(repr=False)

    def __bool__(self) -> bool:
        return bool(self.search) and self.identifiability.verdict != "not held" and self.misfit.adequate is not False

    @property
    def values(self) -> dict[str, float]:
        """Every fit parameter by name; those of one channel carry its label, as in kd[R]."""
        return {str(k): float(v) for k, v in self.table["value"].items()}

    @property
    def uncertainty(self) -> str:
        """What sd and intervals are of."""
        text = f"sd and {100 * self.level:.4g} % intervals from the scatter between {self.resampled}"
        if self.widened <= 1.0:
            return text
        return f"{text}; widened up to {times(self.widened)} x, as far as parts of the data pull the parameters apart"

    def parameters(self) -> xr.Dataset:
        """The model's parameters with dimension `channel`, as `Model.evaluate` takes them."""
        values = self.values
        data = {name: ("channel", [values[label] for label in labels]) for name, labels in self.layout.names.items()}
        return xr.Dataset(data, coords={"channel": list(self.layout.channels)}, attrs={"model": self.model.name})

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> xr.DataArray:
        """The fitted BRDF in 1/sr without the cosine, for (..., 3) directions in the local frame: (..., channel)."""
        found = self.model.evaluate(wi, wo, {str(n): v.values for n, v in self.parameters().items()})
        dims = [f"dim_{k}" for k in range(found.ndim - 1)]
        attrs = {"units": "1/sr", "long_name": "fitted BRDF without cosine", "model": self.model.name}
        return xr.DataArray(found, dims=(*dims, "channel"), coords={"channel": list(self.layout.channels)}, attrs=attrs)

    def predict(self, samples: xr.Dataset) -> xr.DataArray:
        """The fitted BRDF at the directions of samples (pixel centres): (sample, channel)."""
        return self.evaluate(samples["wi"].values, samples["wo"].values).rename(dim_0="sample")

    def to_frame(self) -> pd.DataFrame:
        """The table of parameters."""
        return self.table.copy()

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "model": self.model.name,
            "parameters": [{"parameter": str(n), **_plain(row.to_dict())} for n, row in self.table.iterrows()],
            "loss": self.loss,
            "loss_value": self.loss_value,
            "rmse_per_sr": self.rmse,
            "relative_rmse": self.relative_rmse,
            "samples": self.samples,
            "pixels": self.pixels,
            "effective_samples": self.effective,
            "aic": _finite(self.aic),
            "bic": _finite(self.bic),
            "correlation": {str(k): _plain(v) for k, v in self.correlation.to_dict().items()},
            "identifiability": {
                "verdict": self.identifiability.verdict,
                "condition": _finite(self.identifiability.condition),
                "combination": self.identifiability.combination,
            },
            "combinations": list(self.combinations),
            "misfit": self.misfit.to_dict(),
            "noise_floor": _finite(self.noise_floor),
            "intervals_widened": self.widened,
            "footprint": self.footprint,
            "resampled": self.resampled,
            "not_in_sd_and_intervals": self.left_out,
            "level": self.level,
            "theta_d_range_rad": list(self.theta_d_range),
            "warnings": list(self.warnings),
            "search": self.search.to_dict(),
            "seconds": self.seconds,
        }

    def to_json(self, **options: Any) -> str:
        """`to_dict` as JSON; numbers that are not finite become null."""
        return json.dumps(self.to_dict(), allow_nan=False, ensure_ascii=False, **options)

    def summary(self) -> str:
        """A text table. A parameter that the data do not hold by itself has its range there instead of a value."""
        low, high = (math.degrees(a) for a in self.theta_d_range)
        lines = [
            f"{'model':<12} {self.model.name}",
            f"{'loss':<12} {self.loss}",
            f"{'footprint':<12} {self.footprint}",
            f"{'data':<12} {self.pixels} pixels in {self.samples} samples, worth {self.effective:.0f} independent "
            f"residuals; theta_d {low:.1f} to {high:.1f} deg",
            f"{'rms':<12} {self.rmse:.4g} 1/sr of f cos(theta_i), {100 * self.relative_rmse:.3g} % of it",
            f"{'misfit':<12} {self.misfit.words}",
            f"{'criteria':<12} AIC {self.aic:.6g}, BIC {self.bic:.6g}: for models on the same data and loss only",
            f"{'errors':<12} {self.uncertainty}",
            f"{'not in them':<12} {self.left_out}",
            f"{'search':<12} {self.search.algorithm}: {self.search.stop}; "
            f"{self.search.evaluations} evaluations in the last stage, {self.seconds:.3g} s in all",
            "",
        ]
        wide = max([len(str(n)) for n in self.table.index] + [9])
        lines.append(f"{'parameter':<{wide}}  {'value':>12}  {'sd':>10}  {'interval':<26}  status")
        for name, row in self.table.iterrows():
            shown, sd = f"{row['value']:12.6g}", f"{row['sd']:10.3g}" if np.isfinite(row["sd"]) else f"{'':>10}"
            span = f"{row['lower']:.6g} to {row['upper']:.6g}" if np.isfinite(row["lower"]) else ""
            if not row["held"]:
                shown, sd, span = f"{'-':>12}", f"{'':>10}", "not held by itself"
            lines.append(f"{name:<{wide}}  {shown}  {sd}  {span:<26}  {row['status']}")
        lines += [f"measured: {words}" for words in self.combinations]
        lines += [f"warning: {sentence}" for sentence in self.warnings if sentence != self.misfit.words]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        told = ", ".join(self._told(str(n), row) for n, row in self.table.iterrows() if row["status"] != "fixed")
        return f"BrdfFit({self.model.name}: {told}; {self.misfit.words})"

    def _told(self, name: str, row: pd.Series) -> str:
        """A parameter with its sd, or with its interval where it sits at a bound or reaches unlike to its sides."""
        if not row["held"]:
            return f"{name} not held by itself"
        value, sd, low, high = (float(row[c]) for c in ("value", "sd", "lower", "upper"))
        if str(row["status"]).startswith("at ") or skew(low, value, high):
            return f"{name} = {value:.5g} [{low:.5g}, {high:.5g}]"
        return f"{name} = {value:.5g} ± {sd:.2g}" if math.isfinite(sd) else f"{name} = {value:.5g}"

    def _repr_html_(self) -> str:
        rows = [
            (name, row["value"], row["sd"], row["lower"], row["upper"], row["status"])
            if row["held"]
            else (name, None, None, None, None, "not held by itself")
            for name, row in self.table.iterrows()
        ]
        columns = ("parameter", "value", "sd", "lower", "upper", "status")
        told = (f"measured: {words}" for words in self.combinations)
        subtitle = f"{100 * self.relative_rmse:.3g} % rms of f cos(theta_i), {self.pixels} pixels"
        return markup.card(
            self.model.name,
            subtitle,
            markup.table(columns, rows),
            markup.notes(
                (
                    self.misfit.words,
                    self.loss,
                    f"{self.uncertainty}; not in them: {self.left_out}",
                    *told,
                    *(w for w in self.warnings if w != self.misfit.words),
                )
            ),
        )


def adequate_in_words(results: Mapping[str, BrdfFit]) -> list[str]:
    """Which of several fits describe the data to the noise, and by how much each other one misses, a line each."""
    if not results:
        return []
    first = next(iter(results.values()))
    floor = first.noise_floor
    known = f"noise floor: {100 * floor:.2g} % of f cos(theta_i) ({first.misfit.noise})"
    lines = [known if math.isfinite(floor) else f"noise floor: not known ({first.misfit.noise})"]
    good = [name for name, one in results.items() if one.misfit.adequate]
    if math.isfinite(floor):
        lines.append(f"adequate: {', '.join(good) if good else 'none of these models describes the data to the noise'}")
    lines += [f"{name}: {one.misfit.words}" for name, one in results.items() if not one.misfit.adequate]
    return lines


def _finite(value: Any) -> Any:
    return None if isinstance(value, float | np.floating) and not math.isfinite(value) else value


def _plain(row: dict[Any, Any]) -> dict[str, Any]:
    return {str(k): _finite(v.item() if isinstance(v, np.generic) else v) for k, v in row.items()}
