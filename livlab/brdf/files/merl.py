"""MERL's `.binary` files: isotropic tables of 90 x 90 x 180 half-angle cells in three colours (Matusik et al. 2003)."""

from pathlib import Path

import numpy as np
import xarray as xr

from livlab.brdf.files.interface import FileFunctions, Function, Holes, tabulated
from livlab.brdf.grid import DIMS, Grid, grid_of
from livlab.brdf.lookup import fill_holes, lookup, table_of
from livlab.brdf.table import as_table
from livlab.core.files import readable, whole
from livlab.errors import DatasetError, InputError

SHAPE = (90, 90, 180)
"""Cells along θ_h, θ_d and φ_d."""

SCALES = (1.0 / 1500, 1.15 / 1500, 1.66 / 1500)
"""What the stored red, green and blue are multiplied by."""

CHANNELS = ("R", "G", "B")
HOLE = -1.0
"""Stored where nothing was measured; any negative value reads as a hole."""

_BYTES = 12 + 3 * 8 * 90 * 90 * 180


def read_merl(path: Path) -> xr.Dataset:
    """A MERL file as a table, 1/sr without cosine; negative values are holes.

    The file holds three int32 (90, 90, 180), then a plane of float64 for red, green and blue, θ_h slowest and φ_d
    fastest. Its θ_h runs with the square root, θ_h = (i/90)² π/2; φ_d is folded to [0, π).

    Raises
    ------
    DatasetError
        The file is not there, or is not as long as 90 x 90 x 180 cells in three colours take; nothing of it is read.
    """
    try:
        size = readable(path, "BRDF file", 1 << 40, "Check the path.", DatasetError).stat().st_size
        with path.open("rb") as stream:
            shape = tuple(np.fromfile(stream, dtype="<i4", count=3).tolist())
            if size != _BYTES or shape != SHAPE:
                raise DatasetError.of(
                    str(path.name),
                    f"{size} bytes, dimensions {shape}",
                    f"must be {_BYTES} bytes with dimensions {SHAPE}",
                    "Fetch the file again; anisotropic and resampled variants of the format are not read.",
                )
            planes = np.fromfile(stream, dtype="<f8", count=3 * int(np.prod(SHAPE))).reshape(3, *SHAPE)
    except OSError as error:
        raise DatasetError(f"Cannot read {path}: {error.strerror}.", remedy="Check the path.") from error
    value = np.empty((*SHAPE, 3))
    for c, scale in enumerate(SCALES):
        # A NaN compares false too, so that it ends as a hole like a negative value.
        value[..., c] = np.where(planes[c] >= 0, planes[c] * scale, np.nan)
    return table_of(value, Grid.merl(), CHANNELS, source=f"MERL file {path.name}")


def write_merl(path: Path, table: xr.Dataset) -> None:
    """Write a table as a MERL file; one channel is written three times, cells of another grid are interpolated.

    Holes are written as −1, which MERL's readers know: fill them first (`livlab.brdf.lookup.fill_holes`) if they
    should have values.

    Raises
    ------
    InputError
        Neither one nor three channels, or negative values.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    grid, merl = grid_of(table), Grid.merl()
    channels = table.sizes["channel"]
    if channels not in (1, 3):
        raise InputError.of("table.channel", channels, "must be 1 or 3 channels in a MERL file", "Choose three.")
    same = grid.shape == merl.shape and np.allclose(grid.theta_h, merl.theta_h, atol=1e-9) and not grid.mirror
    value = table["value"].transpose(*DIMS, "channel").values
    if np.any(value < 0):
        raise InputError.of(
            "table.value",
            float(np.nanmin(value)),
            "must be >= 0, MERL's readers take others for holes",
            "Clip it.",
        )
    if not same:
        wi, wo = merl.directions()
        above = merl.reachable()
        resampled = np.full((*SHAPE, channels), np.nan)
        for h in range(SHAPE[0]):
            resampled[h][above[h]] = lookup(table, wi[h][above[h]], wo[h][above[h]])
        value = resampled
    with whole(path) as temporary, temporary.open("wb") as stream:
        np.asarray(SHAPE, dtype="<i4").tofile(stream)
        for c, scale in enumerate(SCALES):
            plane = value[..., c % channels]
            np.where(np.isfinite(plane), plane / scale, HOLE).astype("<f8").tofile(stream)


def _write(path: Path, data: xr.Dataset, holes: Holes) -> None:
    table = as_table(data, Grid.merl())
    write_merl(path, fill_holes(table) if holes == "fill" else table)


def _write_function(path: Path, function: Function) -> None:
    write_merl(path, tabulated(function, Grid.merl()))


FILE = FileFunctions(read_merl, _write, _write_function)
