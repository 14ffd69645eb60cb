"""Measured curves that an experiment is held against: as they are to be had, or why they are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from livlab import datasets
from livlab.datasets.quantity import is_absorbance
from livlab.errors import InputError
from livlab.kinds.shared.sections import Reference
from livlab.units import FloatArray


@dataclass(frozen=True)
class Known:
    """A reference curve as it is to be had: its dataset, or why there is none."""

    spec: Reference
    dataset: datasets.Dataset | None
    reason: str = ""

    def at(self, wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Mean and SD over subjects at wavelengths in nm, percent as a ratio; nan outside the dataset's range."""
        assert self.dataset is not None
        low, high = self.dataset.range_nm
        inside = (wavelength_nm >= low) & (wavelength_nm <= high)
        mean = np.full(len(wavelength_nm), np.nan)
        mean[inside] = self._read(self.spec.column, wavelength_nm[inside])
        if self.spec.sd_column is None:
            return mean, None
        sd = np.full(len(wavelength_nm), np.nan)
        sd[inside] = self._read(self.spec.sd_column, wavelength_nm[inside])
        return mean, sd

    def _read(self, column: str, wavelength_nm: FloatArray) -> FloatArray:
        assert self.dataset is not None
        ratio = "1" if self.dataset.unit(column) == "%" else None
        return self.dataset.interpolate(column, wavelength_nm, unit=ratio)


def load_reference(spec: Reference) -> Known:
    """A reference of an experiment.

    Raises
    ------
    DatasetError
        An unknown or damaged dataset, or a column it does not have. A published curve that nobody has as numbers
        is no error: its claims are MISSING.
    InputError
        A column that holds an absorbance.
    """
    try:
        table = datasets.load(spec.dataset)
    except datasets.ReferenceUnavailable as error:
        return Known(spec, None, f"{error.message} {error.remedy}".strip())
    for column in (spec.column, spec.sd_column):
        if column is not None:
            table.column(column)
    if is_absorbance(spec.column):
        raise InputError.of(
            f"reference {spec.label}.column", spec.column, "is an absorbance, and reflectance is compared",
            "Convert it, R = 10^(-A) if A = -log10 R, and add the dataset again: livlab data add … "
            f"--name {spec.dataset} --replace. If it is a reflectance, name the column so.",
        )  # fmt: skip
    return Known(spec, table)
