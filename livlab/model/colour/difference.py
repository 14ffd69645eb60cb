"""How different two colours look."""

from __future__ import annotations

from typing import Literal

import xarray as xr

from livlab.errors import InputError
from livlab.metrics import ciede2000
from livlab.model.colour.encoding import check_channels
from livlab.model.colour.primaries import lab

Space = Literal["linear-srgb", "lab"]


def delta_e_2000(first: xr.DataArray, second: xr.DataArray, *, space: Space = "linear-srgb") -> xr.DataArray:
    """Colour difference ΔE00 (CIEDE2000; CIE 142-2001; Sharma, Wu & Dalal 2005). 1 is about just noticeable.

    Parameters
    ----------
    first, second
        Dimension `channel` of length 3 and any others, which broadcast.
    space
        "linear-srgb": linear sRGB, not clipped; white (1, 1, 1) is CIELAB's white. "lab": CIELAB as it is.

    Returns
    -------
    ΔE00 ≥ 0, without the dimension `channel`.

    Raises
    ------
    InputError
        No dimension `channel` of length 3, or an unknown space.

    Examples
    --------
    >>> grey = xr.DataArray([0.5, 0.5, 0.5], dims="channel")
    >>> float(delta_e_2000(grey, grey))
    0.0
    """
    check_channels(first)
    check_channels(second)
    a, b = xr.broadcast(first.drop_vars("channel", errors="ignore"), second.drop_vars("channel", errors="ignore"))
    a, b = a.transpose(..., "channel"), b.transpose(..., "channel")
    if space == "linear-srgb":
        labs = (lab(a.to_numpy()), lab(b.to_numpy()))
    elif space == "lab":
        labs = (a.to_numpy(), b.to_numpy())
    else:
        raise InputError.of("space", space, 'must be "linear-srgb" or "lab"', "Pick one.")
    template = a.isel(channel=0, drop=True)
    difference = template.copy(data=ciede2000(*labs).reshape(template.shape))
    return difference.rename("delta_e_2000").drop_attrs().assign_attrs(units="1")
