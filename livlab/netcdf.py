"""Reading NetCDF that may be damaged: one kind of error, and no more memory than such a file can hold."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from livlab.errors import InputError
from livlab.files import DENSEST, first_line, readable

if TYPE_CHECKING:
    import xarray as xr

SPARE_BYTES = 1 << 24
"""What a file may claim however small it is: HDF5 does not store cells that were never written."""


class NetcdfTrouble(ValueError):
    """A file that cannot be read as NetCDF; the text says why in one line."""


def load_netcdf(path: Path, *, group: str | None = None) -> xr.Dataset | None:
    """Everything in a NetCDF file, or in one of its groups; None if it has no such group.

    Raises
    ------
    NetcdfTrouble
        No such file, no NetCDF, damaged, or a claim of more numbers than a file of its size can hold.
    """
    import h5netcdf
    import h5py
    import xarray as xr

    # A file that h5netcdf gives up on is closed by the garbage collector, which would print that this is not there.
    h5netcdf.File._writable = False

    try:
        size = readable(path, "file", 1 << 50).stat().st_size
        with h5py.File(path):
            pass
        with xr.open_dataset(path, engine="h5netcdf", group=group) as opened:
            if opened.nbytes > DENSEST * size + SPARE_BYTES:
                raise NetcdfTrouble(f"it claims {opened.nbytes / 2**20:.0f} MiB of numbers in {size / 2**20:.2g} MiB")
            return opened.load()
    except (NetcdfTrouble, MemoryError):
        raise
    except InputError as error:
        raise NetcdfTrouble(error.message) from error
    except Exception as error:  # HDF5, h5netcdf and xarray raise whatever they stumble over
        if group is not None and "group not found" in str(error).lower():
            return None
        raise NetcdfTrouble(first_line(error)) from error
