"""One door to the files of BRDFs, by their suffix; `livlab.brdf.files.registry.FORMATS` says which there are.

A format that holds a function of directions (Mitsuba's material, a fitted model) is read as a table of its values at
the middles of `Grid.uniform`'s cells.
"""

from pathlib import Path

import xarray as xr

from livlab.brdf.files.interface import Function, Holes, tabulated
from livlab.brdf.files.registry import format_to_read, format_to_write
from livlab.brdf.table import check_brdf


def read_brdf(path: Path) -> xr.Dataset:
    """Samples or a table from a file, whatever its format.

    Raises
    ------
    InputError
        A suffix that is not known; `DatasetError` where the file is not there or damaged.
    """
    found = format_to_read(path).functions().read(path)
    return found if isinstance(found, xr.Dataset) else tabulated(found)


def write_brdf(path: Path, data: xr.Dataset, *, holes: Holes = "refuse") -> None:
    """Write samples or a table in the format that the suffix names.

    Parameters
    ----------
    holes
        For `.bsdf`, which cannot say that nothing was measured: `refuse`, `fill` or `zero`. For `.binary`: `fill`
        fills, otherwise holes are marked as such.

    Raises
    ------
    InputError
        A suffix that is not known or not written, data that are neither samples nor a table or do not fit the format.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    write = format_to_write(path).functions().write
    assert write is not None
    check_brdf(data)
    write(path, data, holes)


def write_fitted(path: Path, fitted: Function) -> None:
    """Write a fitted model: evaluated where the format has its values, so that there are no holes.

    `.bsdf` and `.binary` are evaluated at their own points, `.nc` and `.csv` at the middles of `Grid.uniform`'s cells.

    Raises
    ------
    InputError
        A suffix that is not written, or channels that the format does not have.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    write = format_to_write(path).functions().write_function
    assert write is not None
    write(path, fitted)


def convert(source: Path, target: Path, *, holes: Holes = "refuse") -> None:
    """Read one file and write another; of a fit the model is written, which has no holes.

    Raises
    ------
    InputError
        As of `read_brdf` and `write_brdf`.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    found = format_to_read(source).functions().read(source)
    if isinstance(found, xr.Dataset):
        write_brdf(target, found, holes=holes)
    elif found.exact:
        write_fitted(target, found)
    else:
        write_brdf(target, tabulated(found), holes=holes)
