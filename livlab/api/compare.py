"""How far two spectra are apart, with the error of every number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.api.arguments import explained
from livlab.api.curve import Spectrum
from livlab.api.sources import as_spectrum
from livlab.core import markup
from livlab.criteria import format_value, format_with_error
from livlab.errors import InputError
from livlab.metrics import Interval, Normalisation, amplitude_ratio, bootstrap_interval, mse, pearson, rmse
from livlab.metrics import normalise as normalised
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

METRICS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "rmse": rmse,
    "mse": mse,
    "pearson": pearson,
    "amplitude ratio": amplitude_ratio,
}


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Two spectra on the same wavelengths.

    Attributes
    ----------
    metrics
        Interval by name: rmse, mse, pearson, amplitude ratio; what cannot be computed is left out.
    first, second
        The two curves where both are known, normalised.
    normalise
        How.
    delta_e
        Colour difference CIEDE2000 of the curves as they are under D65; None where they leave out what the eye sees.
    unknown_error
        Names of curves whose error nobody knows: the intervals leave it out.
    delta_e_error
        How far that may be off at most, as the wavelengths are few or end early: the sum of both colours' errors.
    notes
        What to know of the colour difference.
    """

    metrics: dict[str, Interval]
    first: Spectrum
    second: Spectrum
    normalise: Normalisation
    delta_e: float | None
    unknown_error: tuple[str, ...] = ()
    delta_e_error: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def rmse(self) -> float:
        """Root mean square difference of the normalised curves."""
        return self.metrics["rmse"].estimate

    @property
    def pearson(self) -> float:
        """Pearson's correlation; nan where a curve is constant."""
        found = self.metrics.get("pearson")
        return float("nan") if found is None else found.estimate

    def __repr__(self) -> str:
        shown = ", ".join(f"{k} {format_value(v.estimate, v.standard_error)}" for k, v in self.metrics.items())
        return f"<Comparison {self.first.name!r} with {self.second.name!r}: {shown}>"

    def _repr_html_(self) -> str:
        rows = [
            (k, format_with_error(v.estimate, v.standard_error), f"{v.low:.4g} to {v.high:.4g}")
            for k, v in self.metrics.items()
        ]
        if self.delta_e is not None:
            range_ = "" if self.delta_e_error is None else f"off by at most {self.delta_e_error:.1f}"
            rows.append(("ΔE00 under D65, as they are", f"{self.delta_e:.2f}", range_))
        said = [f"The error of {name} is not known and not in these intervals." for name in self.unknown_error]
        said += self.notes
        first, last = self.first.wavelength_nm[[0, -1]]
        how = "as they are" if self.normalise == "none" else f"over their {self.normalise}"
        return markup.card(
            f"{self.first.name} with {self.second.name}",
            f"{len(self.first)} wavelengths, {first:g}–{last:g} nm, {how}",
            markup.table(["metric", "value", "95 % interval"], rows),
            markup.notes(said),
        )

    def to_pandas(self) -> pd.DataFrame:
        """Index metric; value, standard_error, low, high."""
        import pandas as pd

        rows = {k: (v.estimate, v.standard_error, v.low, v.high) for k, v in self.metrics.items()}
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=["value", "standard_error", "low", "high"])
        frame.index.name = "metric"
        return frame

    def plot(self, ax: Axes | None = None) -> Axes:
        """Both curves as compared; returns the axes."""
        ax = self.second.plot(ax, color="0.35", lw=2)
        self.first.plot(ax)
        ax.set_ylabel("reflectance" + ("" if self.normalise == "none" else f" / its {self.normalise}"))
        ax.legend()
        return ax


@explained
def compare(
    first: Any,
    second: Any,
    *,
    normalise: Normalisation = "max",
    band_nm: tuple[float, float] | None = None,
    resamples: int = 1000,
    seed: int = 1,
) -> Comparison:
    """Compare a spectrum with another on the wavelengths of the first; the second is interpolated linearly.

    Parameters
    ----------
    first, second
        `Spectrum`, (wavelengths, values), a pandas Series, a SpectralDistribution, or the path of a CSV.
    normalise
        Divide each within the band by its "max", its "sum", or "none" (both have an absolute scale).
    band_nm
        First and last wavelength; what both cover if not said.
    resamples, seed
        Of the bootstrap that carries the curves' errors into the metrics (`livlab.metrics.bootstrap_interval`).

    Raises
    ------
    InputError
        Fewer than two wavelengths of the first lie in both.

    Examples
    --------
    >>> compare(([500, 600, 700], [0.1, 0.2, 0.4]), ([450, 720], [0.2, 0.9]), normalise="max").pearson > 0.98
    True
    """
    a, b = as_spectrum(first, "first"), as_spectrum(second, "second")
    low, high = band_nm or (a.wavelength_nm[0], a.wavelength_nm[-1])
    low, high = max(low, b.wavelength_nm[0]), min(high, b.wavelength_nm[-1])
    grid = a.wavelength_nm[(a.wavelength_nm >= low) & (a.wavelength_nm <= high)]
    if len(grid) < 2:
        one, other_range = (f"{x.wavelength_nm[0]:g}–{x.wavelength_nm[-1]:g} nm" for x in (a, b))
        raise InputError.of(
            "band_nm", band_nm, f"leaves {len(grid)} wavelengths of {a.name} ({one}) that {b.name} "
            f"({other_range}) covers", "Compare curves that overlap, in a band (low, high) that both have.",
        )  # fmt: skip
    x = a.between(float(grid[0]), float(grid[-1]))
    other = Spectrum.of(grid, b.at(grid), np.interp(grid, b.wavelength_nm, b.standard_error), name=b.name)

    def judged(metric: Callable[[FloatArray, FloatArray], float]) -> Interval:
        return bootstrap_interval(
            lambda p, q: metric(normalised(p, normalise), normalised(q, normalise)),
            x.value,
            other.value,
            values_error=np.nan_to_num(x.standard_error),
            reference_error=np.nan_to_num(other.standard_error),
            resamples=resamples,
            seed=seed,
        )

    found = {"rmse": judged(rmse)}  # a curve that cannot be normalised is told here
    for name, metric in METRICS.items():
        if name not in found:
            try:
                found[name] = judged(metric)
            except InputError:  # a constant curve has no correlation, and no amplitude
                continue
    unknown = tuple(s.name for s in (x, other) if np.isnan(s.standard_error).any())
    curves = _scaled(x, normalise), _scaled(other, normalise)
    return Comparison(found, *curves, normalise, *_colours(x, other, unknown))


def _scaled(s: Spectrum, how: Normalisation) -> Spectrum:
    value = normalised(s.value, how)
    k = int(np.argmax(np.abs(s.value)))
    size = float(value[k] / s.value[k]) if s.value[k] else 1.0
    return Spectrum(s.wavelength_nm, value, s.standard_error * abs(size), s.name, s.notes)


def _colours(
    a: Spectrum, b: Spectrum, unknown: tuple[str, ...]
) -> tuple[float | None, tuple[str, ...], float | None, tuple[str, ...]]:
    """The last fields of a comparison: what the eye sees of it, and how sure that is."""
    import xarray as xr

    from livlab.model.colour import cie_rgb, colour_error, delta_e_2000

    both = [xr.DataArray(s.value, dims="wavelength", coords={"wavelength": s.wavelength_nm}) for s in (a, b)]
    try:
        found = float(delta_e_2000(*(cie_rgb(x) for x in both)))
        errors = [colour_error(x) for x in both]
    except InputError:
        return None, unknown, None, ()
    told = {str(e.attrs["told"]): s.name for e, s in zip(errors, (a, b), strict=True) if e.attrs["told"]}
    return found, unknown, float(sum(errors)), tuple(f"{name}: {text}" for text, name in told.items())
