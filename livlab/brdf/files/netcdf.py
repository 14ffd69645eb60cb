"""Samples and tables in NetCDF, conventions spelt out as attributes: the form in which livlab keeps them."""

from pathlib import Path

import numpy as np
import xarray as xr

from livlab.brdf.files.interface import FileFunctions, Function, Holes, tabulated
from livlab.brdf.table import check_brdf
from livlab.core.files import whole
from livlab.core.netcdf import NetcdfTrouble, load_netcdf
from livlab.errors import DatasetError, InputError

FORMAT = 1
"""Version of the layout."""

_SPOKEN = {
    "quantity": "bidirectional reflectance distribution function without the cosine",
    "value_units": "1/sr",
    "wi": "unit vector from the surface to the light",
    "wo": "unit vector from the surface to the eye",
}
"""What a file has to say for its numbers to be taken as they are."""


def write_netcdf(path: Path, data: xr.Dataset) -> None:
    """Write samples or a table, every number to the last bit.

    Raises
    ------
    InputError
        The data are neither samples nor a table of this package.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    check_brdf(data)
    out = data.assign_attrs(livlab_brdf_format=FORMAT)
    packing = {
        str(name): {"zlib": True, "complevel": 1, "shuffle": True}
        for name, variable in out.variables.items()
        if variable.dtype.kind in "fib" and variable.size > 4096
    }
    with whole(path) as temporary:
        out.to_netcdf(temporary, engine="h5netcdf", encoding=packing)


def read_netcdf(path: Path) -> xr.Dataset:
    """Samples or a table as `write_netcdf` wrote them.

    Raises
    ------
    DatasetError
        No NetCDF file, a newer layout, or one whose attributes state other conventions.
    """
    try:
        data = load_netcdf(path) or xr.Dataset()
    except NetcdfTrouble as error:
        raise DatasetError(
            f"Cannot read {path} as NetCDF: {error}.", remedy="Check the path; the file may be cut short."
        ) from error
    version = data.attrs.pop("livlab_brdf_format", 0)
    if not np.array_equal(version, FORMAT):
        raise DatasetError.of(
            path.name,
            f"layout {version}",
            f"must be layout {FORMAT} of BRDF files",
            "Read it with a newer livlab.",
        )
    for name, text in _SPOKEN.items():
        if not np.array_equal(data.attrs.get(name, ""), text):
            raise DatasetError.of(
                f"{path.name}, attribute {name}",
                data.attrs.get(name),
                f"must be {text!r}",
                "Convert the values to this convention and say so in the attribute.",
            )
    try:
        check_brdf(data)
    except InputError as error:
        raise DatasetError(f"{path.name}: {error.message}", remedy=error.remedy) from error
    return data


def _write(path: Path, data: xr.Dataset, _: Holes) -> None:
    write_netcdf(path, data)


def _write_function(path: Path, function: Function) -> None:
    write_netcdf(path, tabulated(function))


FILE = FileFunctions(read_netcdf, _write, _write_function)
