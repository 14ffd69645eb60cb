"""Sums of a picture: what every pixel has seen at each wavelength, and how much its samples differ."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tracer.given_up import GivenUp
from livlab.units import FloatArray


@dataclass
class Film:
    """Sums over rows of samples, in double precision.

    Attributes
    ----------
    shape
        Rows and columns of the picture.
    wavelength_nm
        (W,) wavelengths.
    row_samples
        Samples whose mean is one row: a pixel's error follows from how its rows differ.
    total, squares
        (pixel, W) sums of the rows, and of their squares.
    rows
        Rows summed up.
    passes
        Launches that made them: the next one's number, which its random numbers follow from.
    given_up
        What the paths still weighed that were given up.
    level
        (W,) radiance of a white surface under the scene's lights; 0 if unknown.
    """

    shape: tuple[int, int]
    wavelength_nm: FloatArray
    row_samples: int
    total: FloatArray = field(init=False)
    squares: FloatArray = field(init=False)
    rows: int = 0
    passes: int = 0
    given_up: GivenUp = field(init=False)
    level: FloatArray | float = 0.0

    def __post_init__(self) -> None:
        size = (self.shape[0] * self.shape[1], len(self.wavelength_nm))
        self.total, self.squares = np.zeros(size), np.zeros(size)
        self.given_up = GivenUp.none(*size)

    @property
    def samples(self) -> int:
        """Samples a pixel so far."""
        return self.rows * self.row_samples

    def add(self, total: FloatArray, squares: FloatArray, rows: int) -> None:
        """Add a launch: (pixel, W) sums over its rows, and of their squares."""
        self.total += total
        self.squares += squares
        self.rows += rows
        self.passes += 1

    def mean(self) -> FloatArray:
        """(row, column, W) radiance."""
        return (self.total / max(self.rows, 1)).reshape(*self.shape, -1)

    def standard_error(self) -> FloatArray:
        """(row, column, W) its standard error; NaN of a single row."""
        if self.rows < 2:
            return np.full((*self.shape, len(self.wavelength_nm)), np.nan)
        spread = np.maximum(self.squares - np.square(self.total) / self.rows, 0.0)
        return np.sqrt(spread / (self.rows - 1) / self.rows).reshape(*self.shape, -1)

    def systematic(self) -> FloatArray:
        """(row, column, W) bound of the radiance that is missing, as paths were given up."""
        radiance = self.total / max(self.rows, 1)
        found = self.given_up.systematic(radiance, np.broadcast_to(self.level, radiance.shape[1]), self.samples)
        return found.reshape(*self.shape, -1)

    def dataset(self) -> xr.Dataset:
        """Radiance, its standard error and what is missing, with their coordinates."""
        dims = ("row", "column", "wavelength")
        about = {"units": "radiance of the scene's sources"}
        return xr.Dataset(
            {
                "radiance": (dims, self.mean(), about | {"long_name": "radiance"}),
                "radiance_se": (dims, self.standard_error(), about | {"long_name": "standard error of the radiance"}),
                "systematic": (dims, self.systematic(), about | {"long_name": "bound of the radiance given up"}),
            },
            coords={"wavelength": ("wavelength", self.wavelength_nm, {"units": "nm"})},
        )

    def state(self) -> xr.Dataset:
        """All there is to go on from."""
        dims = ("pixel", "wavelength")
        return xr.Dataset(
            {
                "total": (dims, self.total.copy()),
                "squares": (dims, self.squares.copy()),
                "given_up": (dims, self.given_up.weight.copy()),
            },
            coords={"wavelength": self.wavelength_nm},
            attrs={
                "shape": list(self.shape),
                "row_samples": self.row_samples,
                "rows": self.rows,
                "passes": self.passes,
                **self.given_up.counts(),
            },
        )

    def take(self, state: xr.Dataset) -> None:
        """Go on from an earlier state.

        Raises
        ------
        InputError
            If it is of another picture, or of rows of other length.
        """
        own = {"shape": list(self.shape), "row_samples": self.row_samples}
        for name, value in own.items():
            found = np.asarray(state.attrs.get(name)).tolist()
            if found != value:
                raise InputError.of(f"resume: {name}", found, f"is not this picture's ({value})", "Start anew.")
        if not np.array_equal(state["wavelength"].to_numpy(), self.wavelength_nm):
            raise InputError.of("resume: wavelengths", "others", "are not this picture's", "Start anew.")
        self.total, self.squares = state["total"].to_numpy().copy(), state["squares"].to_numpy().copy()
        self.rows, self.passes = int(state.attrs["rows"]), int(state.attrs["passes"])
        if "given_up" in state:
            self.given_up = GivenUp.of(state["given_up"].to_numpy().copy(), state.attrs)


def row_samples(samples: int) -> int:
    """Samples of a row: a divisor of all, so that rows stay many enough to tell the error, few enough to keep.

    >>> [row_samples(n) for n in (1, 8, 128, 1000, 127)]
    [1, 1, 4, 10, 1]
    """
    most = min(max(1, samples // 32), 16)
    return max(k for k in range(1, most + 1) if samples % k == 0)
