"""A spectrum in a notebook: wavelengths, values, their errors, and the way in and out of other packages."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from livlab.core import markup
from livlab.errors import InputError, RangeError
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

    from livlab.kinds.spectral.config import SpectralExperiment


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """A curve over wavelength with its standard error, where one is known.

    Attributes
    ----------
    wavelength_nm
        (W,) strictly rising, nm.
    value
        (W,) the curve; a reflectance is a ratio.
    standard_error
        (W,) its standard error; 0 where the number is exact, nan where nobody knows.
    name
        What plots and tables call it.
    notes
        Sentences that go with the numbers.
    data
        The whole measurement, where livlab made it: budget of the light, samples, attributes.
    experiment
        The experiment that gives these numbers, where livlab made them.

    Raises
    ------
    InputError
        Wavelengths that do not rise, lengths that differ, a value that is no finite number, a negative error.

    Examples
    --------
    >>> s = Spectrum.of([500, 600], [0.1, 0.3], name="mine")
    >>> s
    <Spectrum 'mine': 2 wavelengths, 500–600 nm, 0.1 to 0.3>
    >>> s.at([550]).tolist()
    [0.2]
    >>> np.asarray(s).tolist()
    [0.1, 0.3]
    """

    wavelength_nm: FloatArray
    value: FloatArray
    standard_error: FloatArray
    name: str = "spectrum"
    notes: tuple[str, ...] = ()
    data: xr.Dataset | None = None
    experiment: SpectralExperiment | None = field(default=None)

    def __post_init__(self) -> None:
        from livlab.curves import check_grid

        for key in ("wavelength_nm", "value", "standard_error"):
            # A copy that cannot be written: a spectrum is passed on, and must not change under its holder.
            array = numbers(key, getattr(self, key))
            array.flags.writeable = False
            object.__setattr__(self, key, array)
        check_grid("wavelength_nm", self.wavelength_nm)
        for key in ("value", "standard_error"):
            if getattr(self, key).shape != self.wavelength_nm.shape:
                raise InputError.of(
                    key, getattr(self, key).shape, f"must have {len(self)} entries, one a wavelength", "Give as many."
                )
        if not np.isfinite(self.value).all():
            k = int(np.argmin(np.isfinite(self.value)))
            raise InputError.of(f"value[{k}]", float(self.value[k]), "must be a finite number", "Leave it out.")
        if (self.standard_error < 0).any() or np.isinf(self.standard_error).any():
            raise InputError.of("standard_error", float(self.standard_error.min()), "must be ≥ 0, or nan", "Mend it.")

    def __len__(self) -> int:
        return len(self.wavelength_nm)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        """The values, for NumPy and what builds on it: `np.asarray(s)`, `np.max(s)`."""
        return np.array(self.value, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        first, last = self.wavelength_nm[[0, -1]]
        what = f"{len(self)} wavelength{'s' if len(self) > 1 else ''}, {first:g}–{last:g} nm"
        return f"<Spectrum {self.name!r}: {what}, {self.value.min():.4g} to {self.value.max():.4g}>"

    def _repr_html_(self) -> str:
        first, last = self.wavelength_nm[[0, -1]]
        rows: list[tuple[object, object]] = [("wavelengths", f"{len(self)}, {first:g} to {last:g} nm")]
        rows.append(("value", f"{self.value.min():.4g} to {self.value.max():.4g}"))
        known = self.standard_error[np.isfinite(self.standard_error)]
        rows.append(("standard error", f"at most {known.max():.2g}" if known.size else "not known"))
        if self.data is not None:
            rows.append(("solver", self.data.attrs.get("rung", "")))
            rows.append(("seconds", f"{float(self.data.attrs.get('seconds', 0.0)):.3g}"))
        patch, doubt = "", ""
        with suppress(InputError), warnings.catch_warnings():  # wavelengths that leave the eye out
            warnings.simplefilter("ignore", UserWarning)
            doubt = self.colour_error()[1]
            patch = f"<p>{markup.swatch(self.srgb().tolist(), 'under D65')} as seen under D65</p>"
        drawing = markup.curve(self.wavelength_nm.tolist(), self.value.tolist(), self.name)
        return markup.card(
            self.name,
            "spectrum",
            drawing,
            patch,
            markup.table(["", ""], rows),
            markup.notes([*self.notes, *([f"Colour: {doubt}"] if doubt else [])]),
        )

    @classmethod
    def of(
        cls,
        wavelength_nm: ArrayLike,
        value: ArrayLike,
        standard_error: ArrayLike | float | None = None,
        *,
        name: str = "spectrum",
    ) -> Spectrum:
        """A spectrum from plain numbers; an error that is not given is not known.

        Parameters
        ----------
        wavelength_nm, value
            (W,) each.
        standard_error
            (W,), or one for all.
        name
            What plots call it.
        """
        grid = numbers("wavelength_nm", wavelength_nm)
        error = np.nan if standard_error is None else standard_error
        given = numbers("standard_error", error)
        return cls(grid, numbers("value", value), np.full_like(grid, given) if given.ndim == 0 else given, name)

    @classmethod
    def from_pandas(cls, series: pd.Series | pd.DataFrame, *, name: str | None = None) -> Spectrum:
        """From a series whose index is the wavelength in nm, or a frame.

        Of a frame the wavelengths are the column called so, else the index; the curve is the column `value`, else the
        only one beside standard deviations; `standard_error` is taken where it is. Percent becomes a ratio.

        >>> import pandas as pd
        >>> Spectrum.from_pandas(pd.Series([0.1, 0.2], index=[500, 510], name="a")).name
        'a'
        >>> Spectrum.from_pandas(pd.DataFrame({"Wavelength (nm)": [500, 510], "R (%)": [10, 20]})).value.tolist()
        [0.1, 0.2]
        """
        from livlab.api.frames import curve_of

        grid, value, error, found = curve_of(series)
        return cls.of(grid, value, error, name=name or found)

    @classmethod
    def from_colour(cls, distribution: Any, *, name: str | None = None) -> Spectrum:
        """From a `SpectralDistribution` of colour-science, its wavelengths taken as nm.

        >>> from livlab.model.colour.science import colour_science
        >>> sd = colour_science().SpectralDistribution({500: 0.1, 510: 0.2}, name="tile")
        >>> Spectrum.from_colour(sd)
        <Spectrum 'tile': 2 wavelengths, 500–510 nm, 0.1 to 0.2>
        """
        if not (hasattr(distribution, "wavelengths") and hasattr(distribution, "values")):
            raise InputError.of(
                "distribution", distribution, "is no SpectralDistribution", "Give one of colour-science."
            )
        made = name or str(getattr(distribution, "name", "") or "spectrum")
        return cls.of(distribution.wavelengths, distribution.values, name=made)

    def to_colour(self) -> Any:
        """As a `SpectralDistribution` of colour-science, which takes over from there.

        >>> Spectrum.of([500, 510], [0.1, 0.2], name="mine").to_colour().name
        'mine'
        """
        from livlab.model.colour.science import colour_science

        pairs = dict(zip(self.wavelength_nm.tolist(), self.value.tolist(), strict=True))
        return colour_science().SpectralDistribution(pairs, name=self.name)

    def to_pandas(self) -> pd.DataFrame:
        """Index wavelength_nm; value, standard_error, and the light's budget where livlab made the curve."""
        import pandas as pd

        index = pd.Index(self.wavelength_nm, name="wavelength_nm")
        frame = pd.DataFrame({"value": self.value, "standard_error": self.standard_error}, index=index)
        if self.data is not None:
            for key, column in self.data.data_vars.items():
                if column.dims == ("wavelength",) and key not in frame:
                    frame[str(key)] = column.to_numpy()
        return frame

    def to_xarray(self) -> xr.Dataset:
        """The whole measurement, or value and standard_error on `wavelength`."""
        import xarray as xr

        if self.data is not None:
            return self.data.copy()
        unit = {"units": "1"}
        return xr.Dataset(
            {"value": ("wavelength", self.value, unit), "standard_error": ("wavelength", self.standard_error, unit)},
            coords={"wavelength": ("wavelength", self.wavelength_nm, {"units": "nm"})},
            attrs={"name": self.name},
        )

    def to_csv(self, path: Path | str) -> Path:
        """Write wavelength, value and standard error, whole or not at all; `livlab.read_spectrum` reads it again."""
        from livlab.runs.files import csv_text, write_whole

        def shown(x: float) -> float | None:
            return float(x) if np.isfinite(x) else None

        columns = ["wavelength_nm", "reflectance"]
        errors = np.isfinite(self.standard_error).all()
        columns += ["standard_error"] if errors else []
        rows = [
            dict(zip(columns, (float(x), float(y), shown(e)), strict=False))
            for x, y, e in zip(self.wavelength_nm, self.value, self.standard_error, strict=True)
        ]
        write_whole(Path(path), csv_text(columns, rows))
        return Path(path)

    def to_toml(self) -> str:
        """The experiment that gives these numbers, for `livlab run FILE`.

        Raises
        ------
        InputError
            livlab did not make this spectrum.
        """
        from livlab.config.load import to_toml

        if self.experiment is None:
            raise InputError.of("spectrum", self.name, "was not simulated by livlab", "Use livlab.spectrum.")
        return to_toml(self.experiment)

    def at(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Values at wavelengths in nm, interpolated linearly.

        Raises
        ------
        RangeError
            A wavelength outside the spectrum.
        """
        asked = np.atleast_1d(numbers("wavelength_nm", wavelength_nm))
        first, last = self.wavelength_nm[[0, -1]]
        outside = (asked < first) | (asked > last)
        if outside.any():
            raise RangeError.of(
                "wavelength_nm", float(asked[outside][0]), f"{self.name} covers {first:g}–{last:g} nm", "Stay inside."
            )
        return np.interp(asked, self.wavelength_nm, self.value)

    def between(self, low_nm: float, high_nm: float) -> Spectrum:
        """The points within a band.

        >>> len(Spectrum.of([500, 510, 520], [1, 2, 3]).between(505, 520))
        2
        """
        inside = (self.wavelength_nm >= low_nm) & (self.wavelength_nm <= high_nm)
        if not inside.any():
            raise InputError.of("band_nm", (low_nm, high_nm), f"holds no wavelength of {self.name}", "Widen it.")
        return replace(
            self,
            wavelength_nm=self.wavelength_nm[inside],
            value=self.value[inside],
            standard_error=self.standard_error[inside],
            data=None if self.data is None else self.data.isel(wavelength=np.flatnonzero(inside)),
            experiment=None if not inside.all() else self.experiment,
        )

    def srgb(self, illuminant: str = "D65") -> FloatArray:
        """(3,) encoded sRGB, 0–1, as the 2° observer sees it under an illuminant; clipped to what a screen shows.

        Raises
        ------
        InputError
            Wavelengths that tell no colour (400–700 nm in steps of 10 nm suffice).

        Warns
        -----
        UserWarning
            The colour may be off by more than the eye notices: see `colour_error`.
        """
        from livlab.model.colour import cie_rgb, encode_srgb, in_gamut

        if told := self.colour_error(illuminant)[1]:
            warnings.warn(f"{self.name}: {told}", UserWarning, stacklevel=2)
        return np.asarray(encode_srgb(in_gamut(cie_rgb(self._radiance(), illuminant))).to_numpy())

    def colour_error(self, illuminant: str = "D65") -> tuple[float, str]:
        """ΔE00 by which `srgb` may be off because wavelengths are few or end early, and in words; "" if not to be seen.

        See `livlab.model.colour.colour_error`; raises as `srgb`.
        """
        from livlab.model.colour import colour_error

        found = colour_error(self._radiance(), illuminant)
        return float(found), str(found.attrs["told"])

    def _radiance(self) -> Any:
        import xarray as xr

        return xr.DataArray(self.value, dims="wavelength", coords={"wavelength": self.wavelength_nm})

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw it with ±2 standard errors where they are known; returns the axes.

        Parameters
        ----------
        ax
            Where; new axes if not given.
        style
            For `Axes.plot`.
        """
        from livlab.api.draw import axes

        ax = axes(ax)
        (line,) = ax.plot(self.wavelength_nm, self.value, **({"label": self.name} | style))
        error = np.nan_to_num(self.standard_error)
        if error.any():
            low, high = self.value - 2 * error, self.value + 2 * error
            ax.fill_between(self.wavelength_nm, low, high, color=line.get_color(), alpha=0.25, lw=0)
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("reflectance")
        return ax


def numbers(field_name: str, given: Any) -> FloatArray:
    """A new array of float64, or an error that names the field."""
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError.of(field_name, given, "must be numbers", "Give numbers.") from None
