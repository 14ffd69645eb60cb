"""Reading NetCDF that may be damaged: one kind of error, and no more memory than such a file can hold."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import TYPE_CHECKING

from livlab.core.files import DENSEST, first_line, readable
from livlab.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

SPARE_BYTES = 1 << 24
"""What a file may claim however small it is: HDF5 does not store cells that were never written."""


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEAP = b"GCOL\x01\0\0\0"


class NetcdfTrouble(ValueError):
    """A file that cannot be read as NetCDF; the text says why in one line."""


def check_heaps(raw: bytes | mmap.mmap) -> None:
    """Refuse a file over which HDF5 would loop for ever.

    HDF5 keeps names of dimensions and other data of variable length in global heaps, and reads one by stepping from
    object to object (HDF5 File Format Specification 3.0, section III.E). Free space of size zero is a step of nothing:
    the library then never returns, and no signal reaches Python meanwhile.

    Raises
    ------
    NetcdfTrouble
        No HDF5 file with offsets and lengths of eight bytes, as all that is written today, or a damaged heap.
    """
    head = bytes(raw[:16])
    sizes = head[13:15] if head[8:9] < b"\x02" else head[9:11]
    if head[:8] != _SIGNATURE or sizes != b"\x08\x08":
        raise NetcdfTrouble("it is no NetCDF-4 file")
    at = raw.find(_HEAP)
    while at >= 0:
        (size,) = struct.unpack("<Q", raw[at + 8 : at + 16].ljust(8, b"\0"))
        end, place = min(at + size, len(raw)), at + 16
        while place + 16 <= end:
            number, _, _, length = struct.unpack("<HHIQ", raw[place : place + 16])
            # Object 0 is what is free, its own head included; another's head comes on top, and eight bytes are a unit.
            step = length if number == 0 else 16 + (length + 7) // 8 * 8
            if step < 16:
                raise NetcdfTrouble("a heap in it is damaged")
            place += step
        at = raw.find(_HEAP, at + 1)


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
        if size:
            with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
                check_heaps(raw)
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
