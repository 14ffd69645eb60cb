"""Values of a table where they are wanted: read it off, fill it on request, or make one from a function."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import half_angles, unit_directions
from livlab.brdf.grid import DIMS, Grid, grid_of
from livlab.brdf.table import ATTRS, CONVENTIONS, Evaluate
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
Filling = Literal["mirror", "nearest"]

_STEPS = (3.0, 2.0, 1.0)
"""How far one cell counts along θ_h, θ_d, φ_d when the nearest is sought: a BRDF changes most along θ_h, least along
φ_d."""


def lookup(
    table: xr.Dataset, wi: npt.ArrayLike, wo: npt.ArrayLike, *, method: Literal["linear", "nearest"] = "linear"
) -> FloatArray:
    """Values (n, channel) of a table at pairs of directions (n, 3); NaN below the surface and in holes.

    `linear` goes between the middles of the eight cells around, periodic in φ_d; holes among them are left out and the
    others weighted up. `nearest` takes the cell in which the pair lies.
    """
    first, second = unit_directions("wi", wi), unit_directions("wo", wo)
    grid = grid_of(table)
    values = table["value"].transpose(*DIMS, "channel").values.reshape(grid.size, -1)
    angles = half_angles(first, second)
    below = (first[:, 2] <= 0) | (second[:, 2] <= 0)
    if method == "nearest":
        found = values[grid.place(angles.theta_h, angles.theta_d, angles.phi_d).cell]
    else:
        found = _between(grid, values, angles.theta_h, angles.theta_d, grid.fold(angles.phi_d)[0])
    return np.where(below[:, None], np.nan, found)


def _between(grid: Grid, values: FloatArray, theta_h: FloatArray, theta_d: FloatArray, phi_d: FloatArray) -> FloatArray:
    corners: list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]] = []
    for axis, (middle, at) in enumerate(zip(grid.centres(), (theta_h, theta_d, phi_d), strict=True)):
        count = len(middle)
        if axis == 2:  # over the fold: the first cell follows the last, or its mirror image is itself
            ends = (2 * grid.phi_d[0] - middle[0], 2 * grid.phi_d[-1] - middle[-1])
            if not grid.mirror:
                ends = (middle[-1] - np.pi, middle[0] + np.pi)
            place = np.interp(at, np.concatenate([[ends[0]], middle, [ends[1]]]), np.arange(-1, count + 1))
        else:
            place = np.interp(at, middle, np.arange(count))
        low = np.floor(place).astype(np.intp)
        part = place - low
        ends_meet = axis == 2 and not grid.mirror
        pair = [np.mod(i, count) if ends_meet else np.clip(i, 0, count - 1) for i in (low, low + 1)]
        corners.append((pair[0], pair[1], part))
    total = np.zeros((len(theta_h), values.shape[1]))
    weight = np.zeros((len(theta_h), values.shape[1]))
    for code in range(8):
        index, share = [], np.ones(len(theta_h))
        for axis, (low, high, part) in enumerate(corners):
            upper = code >> axis & 1
            index.append(high if upper else low)
            share = share * (part if upper else 1 - part)
        at_corner = values[np.ravel_multi_index(index, grid.shape)]
        known = np.isfinite(at_corner)
        total += np.where(known, share[:, None] * np.where(known, at_corner, 0.0), 0.0)
        weight += share[:, None] * known
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight > 1e-12, total / weight, np.nan)


def fill_holes(table: xr.Dataset, how: Sequence[Filling] = ("mirror", "nearest")) -> xr.Dataset:
    """A copy of a table whose holes above the surface have values, each marked in `filled`.

    `mirror` takes the cell at π − φ_d, which is equal for an isotropic material that is its own mirror image; `nearest`
    takes the nearest cell that was observed. `hole` keeps saying what was not observed.

    Raises
    ------
    InputError
        Another word than those two, or a table without a single value.
    """
    if not how or any(word not in ("mirror", "nearest") for word in how):
        raise InputError.of("how", how, "must name mirror, nearest or both in order", "Give ('mirror', 'nearest').")
    grid = grid_of(table)
    out = table.copy(deep=True)
    value = out["value"].transpose(*DIMS, "channel").values.copy()
    filled = out["filled"].transpose(*DIMS).values.copy()
    empty = ~np.isfinite(value).all(axis=-1)
    if empty.all():
        raise InputError.of("table", "all holes", "must hold at least one value", "Merge samples first.")
    above = grid.reachable()
    for word in how:
        todo = empty & above
        if word == "mirror":
            source = value[:, :, ::-1]
            todo = todo & ~empty[:, :, ::-1] & bool(not grid.mirror)
            value[todo] = source[todo]
        else:
            value[todo] = _nearest(value, empty, grid.mirror)[todo]
        filled[todo] = 1 if word == "mirror" else 2
        empty = empty & ~todo
    out["value"] = ((*DIMS, "channel"), value, table["value"].attrs)
    out["filled"] = (DIMS, filled, ATTRS["filled"])
    out.attrs["filled_cells"] = int(np.count_nonzero(filled))
    return out


def _nearest(value: FloatArray, empty: npt.NDArray[np.bool_], mirror: bool) -> FloatArray:
    from scipy.ndimage import distance_transform_edt

    count = value.shape[2]
    order = [np.arange(count)] * 3 if not mirror else [np.arange(count)[::-1], np.arange(count), np.arange(count)[::-1]]
    around = np.concatenate(order)
    place = distance_transform_edt(empty[:, :, around], sampling=_STEPS, return_distances=False, return_indices=True)
    h, d, p = (axis[:, :, count : 2 * count] for axis in place)
    return np.asarray(value[h, d, around[p]])


def tabulate(evaluate: Evaluate, grid: Grid | None = None, channels: Sequence[object] | None = None) -> xr.Dataset:
    """A table of a function's values at the middles of the cells; cells below the surface are holes.

    Parameters
    ----------
    evaluate
        wi, wo (n, 3) to (n,) or (n, channel) in 1/sr without cosine.
    grid
        Cells; those of `Grid.uniform`.
    channels
        Names of the channels.
    """
    grid = grid or Grid.uniform()
    wi, wo = grid.directions()
    above = grid.reachable()
    inside = [
        np.asarray(evaluate(wi[rows][above[rows]], wo[rows][above[rows]]), float) for rows in range(grid.shape[0])
    ]
    flat = np.concatenate([part.reshape(len(part), -1) for part in inside])
    value = np.full((*grid.shape, flat.shape[1]), np.nan)
    value[above] = flat
    return table_of(value, grid, channels, source="function at the middles of the cells")


def table_of(
    value: FloatArray, grid: Grid, channels: Sequence[object] | None = None, *, source: str = ""
) -> xr.Dataset:
    """A table of given values (θ_h, θ_d, φ_d, channel), NaN in holes, with nothing known but them."""
    hole = ~np.isfinite(value).all(axis=-1)
    names = list(range(value.shape[-1])) if channels is None else list(channels)
    table = xr.Dataset(
        {
            "value": ((*DIMS, "channel"), value, ATTRS["value"]),
            "hole": (DIMS, hole, ATTRS["hole"]),
            "filled": (DIMS, np.zeros(grid.shape, dtype=np.int8), ATTRS["filled"]),
        },
        coords={"channel": names, **grid.coordinates()},
    )
    table.attrs = {**CONVENTIONS, "source": source, "mirror": int(grid.mirror)}
    return table
