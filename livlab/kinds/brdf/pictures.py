"""Contact sheets of a rig's pictures for people to look at."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

if TYPE_CHECKING:
    from livlab.runs.work import Run

LARGEST_SIDE = 1600
"""Pixels of a sheet's longer side; larger pictures are thinned."""


def contact_sheet(images: xr.DataArray, columns: int | None = None) -> tuple[xr.DataArray, float]:
    """Pictures in rows, light by light, and the exposure that suits them.

    The exposure brings the 98th percentile of what is not dark to 0.8; a highlight may clip, for the eye alone.

    Returns
    -------
    (row, column, channel) linear RGB, and the factor.
    """
    values = np.nan_to_num(images.transpose("light", "row", "column", "channel").to_numpy())
    if values.shape[-1] != 3:
        values = np.repeat(values.mean(-1, keepdims=True), 3, axis=-1)
    count, height, width, _ = values.shape
    across = columns or min(count, 4 if count > 3 else count)
    down = math.ceil(count / across)
    step = max(1, math.ceil(max(across * width, down * height) / LARGEST_SIDE))
    values = values[:, ::step, ::step]
    height, width = values.shape[1:3]
    sheet = np.zeros((down * height, across * width, 3))
    for k in range(count):
        row, column = divmod(k, across)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = values[k]
    lit = sheet[sheet > 1e-6 * max(float(sheet.max()), 1e-300)]
    level = float(np.quantile(lit, 0.98)) if lit.size else 1.0
    picture = xr.DataArray(sheet, dims=("row", "column", "channel"), coords={"channel": ["R", "G", "B"]})
    return picture, 0.8 / level


def sheet(run: Run, name: str, images: xr.DataArray) -> tuple[str, float]:
    """Write a contact sheet into a run folder."""
    from livlab.model.colour.files import write_png

    picture, exposure = contact_sheet(images)
    write_png(run.folder / name, picture, exposure=exposure, gamut="clip")
    run.keep(name)
    return name, exposure
