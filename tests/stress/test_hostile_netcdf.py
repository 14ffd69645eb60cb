"""A NetCDF file over which HDF5 would loop for ever is refused before HDF5 sees it."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from livlab.core.netcdf import NetcdfTrouble, check_heaps, load_netcdf
from livlab.runs.compare import compare_file
from livlab.runs.files import sha256

READ = """
import sys
from pathlib import Path
from livlab.core.netcdf import NetcdfTrouble, load_netcdf
try:
    load_netcdf(Path(sys.argv[1]))
except NetcdfTrouble as trouble:
    print(trouble)
"""


def whole(path: Path) -> bytes:
    data = xr.Dataset({"r": ("wavelength", np.arange(5.0))}, coords={"wavelength": np.arange(5.0)})
    data.to_netcdf(path, engine="h5netcdf")
    return path.read_bytes()


def endless(raw: bytes) -> bytes:
    """The same with free space of no size at the second object of its global heap."""
    heap = raw.index(b"GCOL")
    (length,) = struct.unpack("<Q", raw[heap + 24 : heap + 32])
    second = heap + 32 + (length + 7) // 8 * 8
    return raw[:second] + struct.pack("<HHIQ", 0, 0, 0, 0) + raw[second + 16 :]


def test_a_heap_without_end_is_refused_and_not_walked(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    path.write_bytes(endless(whole(path)))
    # In a process of its own: what hangs in HDF5 hears no signal.
    call = [sys.executable, "-c", READ, str(path)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "a heap in it is damaged\n"


def test_a_whole_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    whole(path)
    found = load_netcdf(path)
    assert found is not None
    np.testing.assert_array_equal(found["r"], np.arange(5.0))


@pytest.mark.parametrize("raw", [b"", b"GCOL", b"\x89HDF\r\n\x1a\n", b"CDF\x01" + bytes(60)])
def test_what_is_no_netcdf_is_refused(raw: bytes, tmp_path: Path) -> None:
    with pytest.raises(NetcdfTrouble, match="no NetCDF-4"):
        check_heaps(raw)
    (tmp_path / "a.nc").write_bytes(raw)
    with pytest.raises(NetcdfTrouble):
        load_netcdf(tmp_path / "a.nc")


def test_offsets_of_another_size_are_refused(tmp_path: Path) -> None:
    raw = whole(tmp_path / "a.nc")
    assert raw[8] < 2  # the older form of the first block, whose sizes stand at 13 and 14
    with pytest.raises(NetcdfTrouble, match="no NetCDF-4"):
        check_heaps(raw[:14] + b"\x04" + raw[15:])


def test_a_heap_cut_off_by_the_files_end_is_not_walked_beyond(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    raw = whole(path)
    heap = raw.index(b"GCOL")
    for end in range(heap, heap + 80, 5):
        path.write_bytes(raw[:end])
        with pytest.raises(NetcdfTrouble):  # by HDF5, which sees that the file is truncated
            load_netcdf(path)


def test_two_runs_are_compared_though_one_is_endless(tmp_path: Path) -> None:
    old, new = tmp_path / "old.nc", tmp_path / "new.nc"
    raw = whole(new)
    old.write_bytes(endless(raw))
    verdict = compare_file("result.nc", old, new, sha256(old), "")
    assert verdict.verdict == "differs"
    assert "heap" in verdict.detail
