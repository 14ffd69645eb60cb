"""Spectra and refractive indices that a tissue names: constants, dispersion formulas and datasets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from livlab import datasets
from livlab.errors import InputError, RangeError
from livlab.units import FloatArray

Outside = Literal["error", "hold"]
"""What to do outside the range a source covers: refuse, or hold the value at its end (and note it)."""

MOLAR = ("1/(cm M)", "1/(mm M)")
"""Units of a molar extinction."""

Note = Callable[[str], None]
"""Takes a warning that a report must show."""


class Spec(BaseModel):
    """A piece of a tissue as a file gives it: no key it does not know, no nan, no value of another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)


class FromDatasets(Spec):
    """A column of datasets, by their names in order of preference."""

    datasets: tuple[str, ...] = Field(strict=False, min_length=1, description="Datasets in order of preference.")
    column: str = Field(description="Column to read.")
    outside: Outside = Field("error", description="Outside every dataset's range: error, or hold the nearest end.")

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, data: Any) -> Any:
        return {"datasets": [data]} if isinstance(data, str) else data


class AbsorptionSpectrum(FromDatasets):
    """An absorption spectrum by dataset name; of several datasets the first that covers a wavelength is used.

    In a file a plain name stands for `{datasets = [name]}`.
    """

    __qualname__ = "Spectrum"  # what schemas call it
    model_config = ConfigDict(title="Spectrum")

    column: str = Field("absorption_per_cm", description="Column to read, an absorption coefficient.")

    def per_mm(self, wavelength_nm: FloatArray, note: Note) -> FloatArray:
        """Absorption in 1/mm at wavelengths in nm.

        Raises
        ------
        RangeError
            A wavelength that no dataset covers, unless `outside` is "hold".
        DatasetError, InputError
            A missing or damaged dataset, or a column that is no absorption coefficient.
        """
        for name in self.datasets:
            columns = datasets.load(name).meta.columns.items()
            unit = next((c.unit for key, c in columns if self.column in (key, *c.aliases)), "")
            if unit in MOLAR:
                raise InputError.of(
                    f"{name}.{self.column}",
                    unit,
                    "is a molar extinction, and this element asks for an absorption coefficient",
                    'Use an element of kind = "solute", which has a concentration, or another column.',
                )
        return _first_that_covers(self.datasets, self.column, "1/mm", wavelength_nm, self.outside, note)


AbsorptionSpectrum.__qualname__ = "AbsorptionSpectrum"


class Extinction(FromDatasets):
    """A molar extinction (to the base 10) by dataset name, as `Spectrum`."""

    column: str = Field("molar_extinction", description="Column to read, a molar extinction.")

    def per_mm_per_mol_per_l(self, wavelength_nm: FloatArray, note: Note) -> FloatArray:
        """Molar extinction in 1/(mm M) at wavelengths in nm.

        Raises
        ------
        RangeError
            A wavelength that no dataset covers, unless `outside` is "hold".
        DatasetError, InputError
            A missing or damaged dataset, or a column that is no molar extinction.
        """
        return _first_that_covers(self.datasets, self.column, "1/(mm M)", wavelength_nm, self.outside, note)


class Cauchy(Spec):
    """Dispersion by Cauchy's formula n = Σ A_k λ^(−2k), λ in µm."""

    kind: Literal["cauchy"]
    coefficients: tuple[float, ...] = Field(strict=False, min_length=1, description="A_0, A_1 in µm², A_2 in µm⁴, …")
    valid_nm: tuple[float, float] = Field(strict=False, description="Range the formula was fitted on, in nm.")
    outside: Outside = Field("error", description="Outside the range: error, or hold the index at its end.")

    @model_validator(mode="after")
    def _ordered(self) -> Cauchy:
        low, high = self.valid_nm
        if not 0 < low < high:
            raise InputError.of("valid_nm", (low, high), "must rise from a wavelength > 0", "Give [low, high].")
        if min(_cauchy(self.coefficients, np.linspace(low, high, 101))) <= 0:
            raise InputError.of("coefficients", self.coefficients, "must give an index > 0", "Check the coefficients.")
        return self


class DatasetIndex(Spec):
    """Index from a dataset's column."""

    __qualname__ = "Tabulated"  # what schemas call it
    model_config = ConfigDict(title="Tabulated")

    kind: Literal["dataset"]
    dataset: str = Field(description="Name of the dataset.")
    column: str = Field("n", description="Column to read.")
    outside: Outside = Field("error", description="Outside the range: error, or hold the nearest end.")


DatasetIndex.__qualname__ = "DatasetIndex"


def _index_kind(value: Any) -> str | None:
    if isinstance(value, dict):
        return value.get("kind")
    if isinstance(value, (Cauchy, DatasetIndex)):
        return value.kind
    return "constant"


Index = Annotated[
    Annotated[float, Field(gt=0.1, lt=10.0), Tag("constant")]
    | Annotated[Cauchy, Tag("cauchy")]
    | Annotated[DatasetIndex, Tag("dataset")],
    Discriminator(_index_kind),
]
"""A refractive index: a number, {kind = "cauchy", …} or {kind = "dataset", …}."""


def refractive_index(index: float | Cauchy | DatasetIndex, wavelength_nm: FloatArray, note: Note) -> FloatArray:
    """Refractive index at wavelengths in nm, one entry a wavelength.

    Raises
    ------
    RangeError
        A wavelength outside the formula's or the dataset's range, unless `outside` is "hold".

    Examples
    --------
    >>> giannios = Cauchy(kind="cauchy", coefficients=(1.3591, 0.00827, -0.000576), valid_nm=(450, 1551))
    >>> refractive_index(giannios, np.array([500.0]), print).round(4)
    array([1.383])
    """
    wavelength_nm = np.asarray(wavelength_nm, dtype=float)
    if isinstance(index, Cauchy):
        low, high = index.valid_nm
        beyond = (wavelength_nm < low) | (wavelength_nm > high)
        _refuse_or_note(wavelength_nm[beyond], index.outside, f"the dispersion formula ({low:g}–{high:g} nm)", note)
        return _cauchy(index.coefficients, np.clip(wavelength_nm, low, high))
    if isinstance(index, DatasetIndex):
        return _first_that_covers((index.dataset,), index.column, "1", wavelength_nm, index.outside, note)
    return np.full_like(wavelength_nm, float(index))


def names_of(index: float | Cauchy | DatasetIndex) -> tuple[str, ...]:
    """Datasets that an index needs."""
    return (index.dataset,) if isinstance(index, DatasetIndex) else ()


def _cauchy(coefficients: tuple[float, ...], wavelength_nm: FloatArray) -> FloatArray:
    inverse_square = (wavelength_nm * 1e-3) ** -2
    total = np.zeros_like(wavelength_nm)
    for a in reversed(coefficients):
        total = total * inverse_square + a
    return total


def _first_that_covers(
    names: tuple[str, ...], column: str, unit: str, wavelength_nm: FloatArray, outside: Outside, note: Note
) -> FloatArray:
    wavelength_nm = np.asarray(wavelength_nm, dtype=float)
    tables = [datasets.load(name) for name in names]
    spans = [table.range_nm for table in tables]
    inside = np.zeros(wavelength_nm.shape, dtype=bool)
    for low, high in spans:
        inside |= (wavelength_nm >= low) & (wavelength_nm <= high)
    asked = wavelength_nm
    if not inside.all():
        ends = np.array([end for span in spans for end in span])
        gap = np.abs(wavelength_nm[:, None] - ends)
        # A wavelength that went through a unit conversion may miss an end by rounding.
        asked = np.where(inside, wavelength_nm, ends[np.argmin(gap, axis=1)])
        far = ~inside & (np.abs(asked - wavelength_nm) > 1e-9 * wavelength_nm)
        shown = " and ".join(f"{n} ({low:g}–{high:g} nm)" for n, (low, high) in zip(names, spans, strict=True))
        _refuse_or_note(wavelength_nm[far], outside, shown, note)
    result = np.full_like(wavelength_nm, np.nan)
    for table, (low, high) in zip(tables, spans, strict=True):
        here = np.isnan(result) & (asked >= low) & (asked <= high)
        if here.any():
            result[here] = table.interpolate(column, asked[here], unit=unit)
    return result


def _refuse_or_note(beyond_nm: FloatArray, outside: Outside, what: str, note: Note) -> None:
    if not beyond_nm.size:
        return
    if outside == "error":
        raise RangeError.of(
            "wavelength_nm",
            float(beyond_nm[0]),
            f"is outside the range of {what}",
            'Stay inside, name a wider source, or set its `outside = "hold"`.',
        )
    note(f"The value at the end of the range of {what} is held at {beyond_nm.size} wavelength(s) beyond it.")
