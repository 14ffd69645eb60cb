"""One door to the files of BRDFs, by their suffix: NetCDF, MERL, Mitsuba's measured, CSV, ALTA's text.

| suffix | what | read | written from |
|---|---|---|---|
| `.nc` | samples or table, everything about them | as they were | samples or table |
| `.csv` | samples | samples | samples, or the cells of a table |
| `.binary` | MERL's table | table | table, or samples merged in its cells |
| `.bsdf` | Mitsuba's `measured` | table of its values at the cells' middles | table, or samples merged |
| `.alta`, `.dat`, `.data`, `.txt` | ALTA's text | samples | not |
| `.json` | a fitted model | table of its values at the cells' middles | by `livlab brdf fit` |
"""

from pathlib import Path

import numpy as np
import xarray as xr

from livlab.brdf.files.alta import read_alta
from livlab.brdf.files.csv import read_csv, write_csv
from livlab.brdf.files.fitted import Fitted, read_fit
from livlab.brdf.files.merl import read_merl, write_merl
from livlab.brdf.files.mitsuba import Holes, read_mitsuba, write_mitsuba
from livlab.brdf.files.netcdf import check, read_netcdf, write_netcdf
from livlab.brdf.grid import DIMS, Grid, grid_of
from livlab.brdf.lookup import fill_holes, tabulate
from livlab.brdf.samples import sample_dataset
from livlab.brdf.table import merge
from livlab.errors import InputError

READ = (".nc", ".csv", ".binary", ".bsdf", ".alta", ".dat", ".data", ".txt", ".json")
WRITTEN = (".nc", ".csv", ".binary", ".bsdf")


def read_brdf(path: Path) -> xr.Dataset:
    """Samples or a table from a file, whatever its format.

    Raises
    ------
    InputError
        A suffix that is not known; `DatasetError` where the file is not there or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".nc":
        return read_netcdf(path)
    if suffix == ".csv":
        return read_csv(path)
    if suffix == ".binary":
        return read_merl(path)
    if suffix == ".bsdf":
        material = read_mitsuba(path)
        table = tabulate(material.evaluate, Grid.uniform(), material.channels)
        return table.assign_attrs(source=f"Mitsuba file {path.name}: {material.description}")
    if suffix == ".json":
        return _tabulated(read_fit(path), Grid.uniform())
    if suffix in READ:
        return read_alta(path)
    raise InputError.of("path", path.name, f"must end in one of {', '.join(READ)}", "Rename it after its format.")


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
    suffix = path.suffix.lower()
    if suffix not in WRITTEN:
        raise InputError.of("path", path.name, f"must end in one of {', '.join(WRITTEN)}", "Choose a format by suffix.")
    check(data)
    samples = data.attrs["kind"] == "BRDF samples"
    if suffix == ".nc":
        write_netcdf(path, data)
    elif suffix == ".csv":
        write_csv(path, data if samples else cells_as_samples(data))
    elif suffix == ".binary":
        table = merge(data, Grid.merl()) if samples else data
        write_merl(path, fill_holes(table) if holes == "fill" else table)
    else:
        write_mitsuba(path, merge(data) if samples else data, holes=holes)


def write_fitted(path: Path, fitted: Fitted) -> None:
    """Write a fitted model: evaluated where the format has its values, so that there are no holes.

    `.bsdf` and `.binary` are evaluated at their own points, `.nc` and `.csv` at the middles of `Grid.uniform`'s cells.

    Raises
    ------
    InputError
        A suffix that is not written, or channels that the format does not have.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    if path.suffix.lower() == ".bsdf":
        write_mitsuba(path, fitted.evaluate, description=f"livlab, {fitted.model.name}")
        return
    write_brdf(path, _tabulated(fitted, Grid.merl() if path.suffix.lower() == ".binary" else Grid.uniform()))


def _tabulated(fitted: Fitted, grid: Grid) -> xr.Dataset:
    return tabulate(fitted.evaluate, grid, fitted.channels).assign_attrs(source=f"fitted model {fitted.model.name}")


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
