"""What a virtual camera has seen so far: sums a pixel and wavelength, kept in double precision, and their error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tracer.given_up import GivenUp
from livlab.units import FloatArray


@dataclass
class CameraFilm:
    """Sums over batches of samples of every pixel; another pass adds to them.

    Attributes
    ----------
    wavelength_nm
        (W,) wavelengths.
    total, square
        (row, column, W) sum of the batches' mean radiance, and of its square.
    batch
        Samples of a batch: the error of a pixel follows from how its batches differ.
    batches
        Batches in the sums.
    passes
        Launches in the sums: the next has this number, which its random numbers follow from.
    seconds, compile_seconds, setup_seconds
        What they took in all, and of it what compiling and making the scene ready took.
    spectra
        For each batch the (W,) mean over the lit body: how errors at different wavelengths go together.
    trace
        (seconds, samples, relative error) after each pass.
    about
        What else the renderer tells: variant, effects, notes.
    given_up, level
        What paths still weighed that were given up, and the (W,) radiance of a white surface under the scene's lights,
        which bound what is missing for it; None: nothing was.
    """

    wavelength_nm: FloatArray
    total: FloatArray
    square: FloatArray
    batch: int = 1
    batches: int = 0
    passes: int = 0
    seconds: float = 0.0
    compile_seconds: float = 0.0
    setup_seconds: float = 0.0
    spectra: list[FloatArray] = field(default_factory=list)
    trace: list[tuple[float, float, float]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    given_up: GivenUp | None = None
    level: FloatArray | float = 0.0

    @classmethod
    def empty(cls, rows: int, columns: int, wavelength_nm: FloatArray, batch: int = 1) -> CameraFilm:
        """A film that has seen nothing."""
        shape = (rows, columns, len(wavelength_nm))
        return cls(np.asarray(wavelength_nm, dtype=np.float64), np.zeros(shape), np.zeros(shape), batch)

    @property
    def samples(self) -> int:
        """Samples a pixel so far."""
        return self.batches * self.batch

    @property
    def walking_seconds(self) -> float:
        """What following light took, compiling and setting up apart."""
        return max(self.seconds - self.compile_seconds - self.setup_seconds, 0.0)

    @property
    def radiance(self) -> FloatArray:
        """(row, column, W) mean radiance."""
        self._seen()
        return self.total / self.batches

    @property
    def standard_error(self) -> FloatArray:
        """(row, column, W) standard error of the mean: √((⟨L²⟩ − ⟨L⟩²)/(n − 1)) over n batches; nan for one."""
        self._seen()
        if self.batches < 2:
            return np.full_like(self.total, np.nan)
        spread = self.square / self.batches - (self.total / self.batches) ** 2
        return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (self.batches - 1)))

    @property
    def systematic(self) -> FloatArray:
        """(row, column, W) bound of the radiance that is missing, as paths were given up."""
        if self.given_up is None:
            return np.zeros_like(self.total)
        radiance = self.radiance.reshape(-1, self.total.shape[2])
        level = np.broadcast_to(self.level, radiance.shape[1])
        return self.given_up.systematic(radiance, level, self.samples).reshape(self.total.shape)

    @property
    def notes(self) -> list[str]:
        """What is to be said of paths given up."""
        if self.given_up is None:
            return []
        paths = self.samples * self.total.shape[0] * self.total.shape[1]
        return self.given_up.notes(paths, self.systematic, self.radiance)

    def relative_error(self, lit: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
        """Median over the lit pixels of mean standard error over mean radiance, both over the wavelengths.

        A pixel that has seen no light yet counts as off by all of its value (1).
        """
        if not lit.any() or self.batches < 2:
            return float("nan")
        mean = self.total[lit].sum(axis=1) / self.batches
        spread = self.square[lit] / self.batches - (self.total[lit] / self.batches) ** 2
        error = np.sqrt(np.maximum(spread, 0.0) / (self.batches - 1)).sum(axis=1)
        seen = mean > 0
        share = np.ones(len(mean))
        share[seen] = error[seen] / mean[seen]
        return float(np.median(share))

    def mean_spectrum(self) -> tuple[FloatArray, FloatArray]:
        """(W,) mean over the lit body, and its (W, W) covariance from how the batches differ; nan for one batch."""
        self._seen()
        each = np.asarray(self.spectra)
        if len(each) < 2:
            return each.mean(axis=0), np.full((each.shape[1],) * 2, np.nan)
        return each.mean(axis=0), np.atleast_2d(np.cov(each, rowvar=False, ddof=1)) / len(each)

    def to_dataset(self) -> xr.Dataset:
        """For a checkpoint; `from_dataset` gives the film back exactly."""
        dims = ("row", "column", "wavelength")
        trace = np.array(self.trace, dtype=np.float64).reshape(-1, 3)
        spectra = np.array(self.spectra, dtype=np.float64).reshape(-1, len(self.wavelength_nm))
        return xr.Dataset(
            {
                "total": (dims, self.total),
                "square": (dims, self.square),
                "spectra": (("batch", "wavelength"), spectra),
                "trace": (("pass", "what"), trace),
                **({} if self.given_up is None else {"given_up": (("pixel", "wavelength"), self.given_up.weight)}),
            },
            {"wavelength": self.wavelength_nm},
            {
                "batch": self.batch,
                "batches": self.batches,
                "passes": self.passes,
                "seconds": self.seconds,
                "compile_seconds": self.compile_seconds,
                "setup_seconds": self.setup_seconds,
                **({} if self.given_up is None else self.given_up.counts() | {"level": np.atleast_1d(self.level)}),
                **{f"about_{k}": v for k, v in self.about.items() if isinstance(v, str | int | float)},
            },
        )

    @classmethod
    def from_dataset(cls, saved: xr.Dataset) -> CameraFilm:
        """What `to_dataset` kept."""
        a = saved.attrs
        given_up = GivenUp.of(saved["given_up"].to_numpy(), a) if "given_up" in saved else None
        return cls(
            saved["wavelength"].to_numpy(),
            saved["total"].to_numpy(),
            saved["square"].to_numpy(),
            batch=int(a["batch"]),
            batches=int(a["batches"]),
            passes=int(a["passes"]),
            seconds=float(a["seconds"]),
            compile_seconds=float(a["compile_seconds"]),
            setup_seconds=float(a["setup_seconds"]),
            spectra=list(saved["spectra"].to_numpy()),
            trace=[(float(x), float(y), float(z)) for x, y, z in saved["trace"].to_numpy()],
            about={k.removeprefix("about_"): v for k, v in a.items() if k.startswith("about_")},
            given_up=given_up,
            level=np.asarray(a.get("level", 0.0), dtype=np.float64),
        )

    def _seen(self) -> None:
        if self.batches < 1:
            raise InputError.of("film.batches", self.batches, "must be ≥ 1", "Expose the film first.")
