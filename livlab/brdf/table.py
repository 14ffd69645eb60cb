"""Samples merged in half-angle cells: mean, spread, standard error, holes, and how far reciprocity holds."""

from collections.abc import Callable, Iterable
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import half_angles
from livlab.brdf.grid import DIMS, Grid, grid_of
from livlab.brdf.samples import check_samples, sample_dataset
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
Weighting = Literal["area", "inverse_variance", "uniform"]
Evaluate = Callable[[FloatArray, FloatArray], FloatArray]
"""A BRDF: directions wi and wo (n, 3) to values (n,) or (n, channel) in 1/sr without cosine."""

KINDS = ("BRDF samples", "BRDF table")
"""What a data set of BRDFs says in its attribute `kind`."""

CHUNK = 1 << 18
"""Samples that are merged at once, so that what it takes on the way does not grow with them."""

CONVENTIONS = {
    "kind": "BRDF table",
    "quantity": "bidirectional reflectance distribution function without the cosine",
    "value_units": "1/sr",
    "wi": "unit vector from the surface to the light",
    "wo": "unit vector from the surface to the eye",
    "frame": "isotropic; theta_h, theta_d, phi_d after Rusinkiewicz 1998, phi_d of wi, folded by reciprocity",
    "angles": "radians",
}

ATTRS = {
    "value": {"units": "1/sr", "long_name": "weighted mean of the BRDF without cosine; NaN in a hole"},
    "spread": {"units": "1/sr", "long_name": "weighted standard deviation of the samples of a cell"},
    "standard_error": {"units": "1/sr", "long_name": "standard error of value"},
    "reciprocity_residual": {
        "units": "1",
        "long_name": "(f(wi, wo) - f(wo, wi)) / value, from samples on the two sides of the fold; NaN if one is empty",
    },
    "count": {"units": "1", "long_name": "samples in the cell"},
    "hole": {"long_name": "no sample in the cell"},
    "filled": {"long_name": "0 as merged, 1 filled from the mirrored cell, 2 filled from the nearest cell"},
    "reachable": {"long_name": "the middle of the cell has both directions within max_angle_rad of the normal"},
    "theta_h_mean": {"units": "rad", "long_name": "weighted mean theta_h of the samples"},
    "theta_d_mean": {"units": "rad", "long_name": "weighted mean theta_d of the samples"},
    "phi_d_mean": {"units": "rad", "long_name": "weighted mean phi_d of the samples, folded"},
}


def merge(
    samples: xr.Dataset | Iterable[xr.Dataset],
    grid: Grid | None = None,
    *,
    weighting: Weighting = "area",
    max_angle: float | None = None,
) -> xr.Dataset:
    """Merge samples in half-angle cells.

    Parameters
    ----------
    samples : Dataset or Dataset after Dataset
        Samples, all at once or light by light (`livlab.brdf.sphere.by_light`).
    grid : Grid
        Cells; 2° in θ_h, 2° in θ_d, 4° in φ_d.
    weighting
        `area`: by the surface that the pixel sees (by 1 where the samples do not say). `inverse_variance`: by
        1 / standard_error², channel by channel. `uniform`: by 1. Photon noise makes `inverse_variance` favour samples
        that came out too dark; take it where the noise was estimated apart from the values.
    max_angle : float or None
        Angle in radians up to which cells are counted as reachable; None: that of the samples, else π/2.

    Returns
    -------
    Dataset
        Dimensions theta_h, theta_d, phi_d, channel: value, spread, standard_error, reciprocity_residual; count, hole,
        filled, reachable without channel. The standard error comes from the samples' own where they have one, else
        from the spread; `standard_error_from` says which. `coverage` is the share of reachable cells with samples.

    Raises
    ------
    InputError
        No samples at all, or `inverse_variance` without standard errors.
    """
    cells: _Cells | None = None
    limit = np.pi / 2 if max_angle is None else max_angle
    for batch in [samples] if isinstance(samples, xr.Dataset) else samples:
        check_samples(batch.isel(sample=slice(0, 1)) if "sample" in batch.dims else batch)
        if cells is None:
            cells = _Cells(grid or Grid.uniform(), batch["channel"].values, weighting)
            if max_angle is None:
                limit = float(batch.attrs.get("max_angle_rad", np.pi / 2))
        for start in range(0, batch.sizes["sample"], CHUNK):
            part = batch.isel(sample=slice(start, start + CHUNK))
            check_samples(part)
            cells.add(part)
    if cells is None or cells.empty:
        raise InputError.of("samples", "none", "must hold at least one sample", "Check the limits of the extraction.")
    return cells.table(limit)


def cells_as_samples(table: xr.Dataset) -> xr.Dataset:
    """One sample for each cell of a table that has a value, at the cell's middle."""
    grid = grid_of(table)
    wi, wo = grid.directions()
    value = table["value"].transpose(*DIMS, "channel").values
    known = np.isfinite(value).all(axis=-1) & grid.reachable()
    error = None
    if "standard_error" in table:
        error = table["standard_error"].transpose(*DIMS, "channel").values[known]
    return sample_dataset(
        wi[known],
        wo[known],
        value[known],
        standard_error=error,
        channels=table["channel"].values.tolist(),
        attrs={"source": "middles of the cells of a table"},
    )


def as_samples(data: xr.Dataset) -> xr.Dataset:
    """Samples as they are; of a table the middles of its cells."""
    return data if data.attrs.get("kind") == "BRDF samples" else cells_as_samples(data)


def as_table(data: xr.Dataset, grid: Grid | None = None) -> xr.Dataset:
    """A table as it is; samples merged in the cells of a grid."""
    return merge(data, grid) if data.attrs.get("kind") == "BRDF samples" else data


def check_brdf(data: xr.Dataset) -> None:
    """See that a data set is samples or a table.

    Raises
    ------
    InputError
        It is neither.
    """
    kind = data.attrs.get("kind")
    if kind == "BRDF samples":
        check_samples(data)
    elif kind == "BRDF table":
        grid = grid_of(data)
        if data["value"].sizes.get("theta_h") != grid.shape[0] or not np.issubdtype(data["value"].dtype, np.floating):
            raise InputError.of("table.value", data["value"].dims, "must fit the cells' edges", "Merge anew.")
    else:
        raise InputError.of("kind", kind, f"must be one of {', '.join(KINDS)}", "Pass samples or a table.")


class _Cells:
    """Running sums of cells on either side of the fold, joined batch after batch (Chan et al. 1983, eq. 2.1)."""

    def __init__(self, grid: Grid, channels: npt.NDArray[np.generic], weighting: Weighting) -> None:
        if weighting not in ("area", "inverse_variance", "uniform"):
            raise InputError.of("weighting", weighting, "must be area, inverse_variance or uniform", "Choose one.")
        self.grid, self.channels, self.weighting = grid, channels, weighting
        shape = (2 * grid.size, len(channels))
        self.count = np.zeros(2 * grid.size, dtype=np.int64)
        self.weight, self.weight2, self.mean, self.square, self.noise = (np.zeros(shape) for _ in range(5))
        self.place = np.zeros((2 * grid.size, 3))

    @property
    def empty(self) -> bool:
        return not self.count.any()

    def add(self, samples: xr.Dataset) -> None:
        if samples.sizes["channel"] != len(self.channels):
            raise InputError.of(
                "samples.channel",
                samples["channel"].values.tolist(),
                f"must be the same in every batch, {self.channels.tolist()}",
                "Merge samples of one camera at a time.",
            )
        value = samples["value"].values
        finite = np.isfinite(value).all(axis=1)
        angles = half_angles(samples["wi"].values[finite], samples["wo"].values[finite])
        placed = self.grid.place(angles.theta_h, angles.theta_d, angles.phi_d)
        cell = placed.cell + self.grid.size * placed.swapped
        where, cell = np.unique(cell, return_inverse=True)
        position = np.stack([angles.theta_h, angles.theta_d, placed.phi_d], axis=1)
        self.count[where] += np.bincount(cell)
        for c in range(len(self.channels)):
            weight, error = self._weights(samples, finite, c)
            total, mean, square = _moments(cell, weight, value[finite, c])
            old, new = self.weight[where, c], self.weight[where, c] + total
            shift = mean - self.mean[where, c]
            self.mean[where, c] += shift * total / new
            self.square[where, c] += square + shift**2 * old * total / new
            self.weight[where, c] = new
            self.weight2[where, c] += np.bincount(cell, weight**2)
            self.noise[where, c] += np.bincount(cell, (weight * error) ** 2)
            if c == 0:
                for j in range(3):
                    centre = np.bincount(cell, weight * position[:, j]) / total
                    self.place[where, j] += (centre - self.place[where, j]) * total / new

    def _weights(self, samples: xr.Dataset, finite: npt.NDArray[np.bool_], c: int) -> tuple[FloatArray, FloatArray]:
        known = "standard_error" in samples
        error = samples["standard_error"].values[finite, c] if known else np.full(int(finite.sum()), np.nan)
        if self.weighting == "inverse_variance":
            if not np.all(error > 0):
                raise InputError.of(
                    "samples.standard_error",
                    "not > 0 everywhere",
                    "must be known for weighting by inverse variance",
                    "Give extract a variance, or weight by area.",
                )
            return 1 / error**2, error
        if self.weighting == "area" and "area" in samples.variables:
            return samples["area"].values[finite], error
        return np.ones(len(error)), error

    def table(self, max_angle: float) -> xr.Dataset:
        grid, size, channels = self.grid, self.grid.size, len(self.channels)
        a, b = slice(0, size), slice(size, None)
        with np.errstate(invalid="ignore", divide="ignore"):
            weight, count = self.weight[a] + self.weight[b], self.count[a] + self.count[b]
            shift = self.mean[b] - self.mean[a]
            mean = self.mean[a] + shift * (self.weight[b] / weight)
            square = self.square[a] + self.square[b] + shift**2 * (self.weight[a] * self.weight[b] / weight)
            spread = np.where(count[:, None] > 1, np.sqrt(square / weight), np.nan)
            noise = self.noise[a] + self.noise[b]
            from_noise = bool(np.all(np.isfinite(noise)))
            effective = weight**2 / (self.weight2[a] + self.weight2[b])
            error = np.sqrt(noise) / weight if from_noise else spread / np.sqrt(effective - 1)
            both = (self.count[a] > 0) & (self.count[b] > 0)
            residual = np.where(both[:, None], -shift / mean, np.nan)
            share = self.weight[b][:, :1] / weight[:, :1]
            place = np.where(count[:, None] > 0, self.place[a] + (self.place[b] - self.place[a]) * share, np.nan)
        reachable = grid.reachable(max_angle).ravel()
        observed = count > 0
        whole = (*grid.shape, channels)
        data = {
            "value": ((*DIMS, "channel"), mean.reshape(whole)),
            "spread": ((*DIMS, "channel"), spread.reshape(whole)),
            "standard_error": ((*DIMS, "channel"), error.reshape(whole)),
            "reciprocity_residual": ((*DIMS, "channel"), residual.reshape(whole)),
            "count": (DIMS, count.reshape(grid.shape).astype(np.int32)),
            "hole": (DIMS, ~observed.reshape(grid.shape)),
            "filled": (DIMS, np.zeros(grid.shape, dtype=np.int8)),
            "reachable": (DIMS, reachable.reshape(grid.shape)),
            **{f"{name}_mean": (DIMS, place[:, j].reshape(grid.shape)) for j, name in enumerate(DIMS)},
        }
        table = xr.Dataset(data, coords={"channel": self.channels, **grid.coordinates()})
        for name, attrs in ATTRS.items():
            table[name].attrs.update(attrs)
        compared = residual[both & np.isfinite(residual).all(axis=1)]
        table.attrs = {
            **CONVENTIONS,
            "weighting": self.weighting,
            "standard_error_from": "standard errors of the samples" if from_noise else "spread within the cell",
            "max_angle_rad": max_angle,
            "coverage": float(np.mean(observed[reachable])),
            "samples": int(count.sum()),
            "reciprocity_cells": int(both.sum()),
            "reciprocity_rms": float(np.sqrt(np.mean(compared**2))) if len(compared) else float("nan"),
            "mirror": int(grid.mirror),
        }
        return table


def _moments(
    cell: npt.NDArray[np.intp], weight: FloatArray, value: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum of weights, mean, and weighted sum of squared deviations of each cell."""
    total = np.asarray(np.bincount(cell, weight), dtype=np.float64)
    mean = np.asarray(np.bincount(cell, weight * value), dtype=np.float64) / total
    square = np.asarray(np.bincount(cell, weight * (value - mean[cell]) ** 2), dtype=np.float64)
    return total, mean, square
