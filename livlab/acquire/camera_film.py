"""What a virtual camera has seen so far: sums a pixel and wavelength, kept in double precision, and their error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.units import FloatArray


@dataclass
class Film:
    """Sums over the samples of every pixel; another pass is added to them.

    Attributes
    ----------
    wavelength_nm
        (W,) wavelengths.
    total, square
        (row, column, W) sum of the samples' radiance, and of its square.
    samples
        Samples a pixel in the sums.
    passes
        Passes in the sums: the next has this index, and a seed that follows from it.
    seconds, compile_seconds
        What they took; compiling is part of the seconds.
    trace
        (seconds, samples, relative error) after each pass.
    about
        What else the renderer tells: variant, effects, notes.
    """

    wavelength_nm: FloatArray
    total: FloatArray
    square: FloatArray
    samples: int = 0
    passes: int = 0
    seconds: float = 0.0
    compile_seconds: float = 0.0
    trace: list[tuple[float, float, float]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def empty(cls, rows: int, columns: int, wavelength_nm: FloatArray) -> Film:
        """A film that has seen nothing."""
        shape = (rows, columns, len(wavelength_nm))
        return cls(np.asarray(wavelength_nm, dtype=np.float64), np.zeros(shape), np.zeros(shape))

    @property
    def radiance(self) -> FloatArray:
        """(row, column, W) mean radiance."""
        self._seen()
        return self.total / self.samples

    @property
    def standard_error(self) -> FloatArray:
        """(row, column, W) standard error of the mean: √((⟨L²⟩ − ⟨L⟩²)/(n − 1)); nan with one sample."""
        self._seen()
        if self.samples < 2:
            return np.full_like(self.total, np.nan)
        spread = self.square / self.samples - (self.total / self.samples) ** 2
        return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (self.samples - 1)))

    def relative_error(self, lit: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
        """Median over the lit pixels of mean standard error over mean radiance, both over the wavelengths.

        A pixel that has seen no light yet counts as off by all of its value (1).
        """
        if not lit.any() or self.samples < 2:
            return float("nan")
        mean = self.total[lit].sum(axis=1) / self.samples
        spread = self.square[lit] / self.samples - (self.total[lit] / self.samples) ** 2
        error = np.sqrt(np.maximum(spread, 0.0) / (self.samples - 1)).sum(axis=1)
        seen = mean > 0
        share = np.ones(len(mean))
        share[seen] = error[seen] / mean[seen]
        return float(np.median(share))

    def to_dataset(self) -> xr.Dataset:
        """For a checkpoint; `from_dataset` gives the film back exactly."""
        dims = ("row", "column", "wavelength")
        trace = np.array(self.trace, dtype=np.float64).reshape(-1, 3)
        return xr.Dataset(
            {"total": (dims, self.total), "square": (dims, self.square), "trace": (("pass", "what"), trace)},
            {"wavelength": self.wavelength_nm},
            {
                "samples": self.samples,
                "passes": self.passes,
                "seconds": self.seconds,
                "compile_seconds": self.compile_seconds,
                **{f"about_{k}": v for k, v in self.about.items() if isinstance(v, str | int | float)},
            },
        )

    @classmethod
    def from_dataset(cls, saved: xr.Dataset) -> Film:
        """What `to_dataset` kept."""
        a = saved.attrs
        return cls(
            saved["wavelength"].to_numpy(),
            saved["total"].to_numpy(),
            saved["square"].to_numpy(),
            int(a["samples"]),
            int(a["passes"]),
            float(a["seconds"]),
            float(a["compile_seconds"]),
            [(float(x), float(y), float(z)) for x, y, z in saved["trace"].to_numpy()],
            {k.removeprefix("about_"): v for k, v in a.items() if k.startswith("about_")},
        )

    def _seen(self) -> None:
        if self.samples < 1:
            raise InputError.of("film.samples", self.samples, "must be ≥ 1", "Expose the film first.")
