"""Samples as CSV: a header of comments that states the conventions, a line of column names, a line for each sample.

Columns: `wi_x, wi_y, wi_z, wo_x, wo_y, wo_z` (unit vectors in the local frame, to the light and to the eye) or, for
tables typed in by hand, `theta_i_deg, phi_i_deg, theta_o_deg, phi_o_deg`; `value_NAME` for each channel in 1/sr
without cosine; optionally `standard_error_NAME`, `light`, `row`, `column`, `pixel_solid_angle`, `source_solid_angle`,
`area`. Lines that start with # are comments.
"""

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import direction
from livlab.brdf.files.interface import FileFunctions, Function, Holes, tabulated
from livlab.brdf.samples import CONVENTIONS, check_samples, sample_dataset
from livlab.brdf.table import as_samples
from livlab.core.files import readable, whole
from livlab.errors import DatasetError, InputError

FIRST = "# livlab BRDF samples 1"
EXTRA = ("light", "row", "column", "pixel_solid_angle", "source_solid_angle", "area")
WHOLE = ("light", "row", "column")
VECTORS = ("wi_x", "wi_y", "wi_z", "wo_x", "wo_y", "wo_z")
DEGREES = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")
CHUNK = 100_000
LARGEST_BYTES = 1 << 29
"""Some two million samples; NetCDF takes more."""


def write_csv(path: Path, samples: xr.Dataset) -> None:
    """Write samples as CSV, 17 digits a number so that it comes back to the last bit. The rig is not written.

    Raises
    ------
    InputError
        The data are not samples.
    EnvironmentProblem
        The file cannot be written; an old one stays as it was.
    """
    check_samples(samples)
    names = [str(name) for name in samples["channel"].values]
    columns: dict[str, npt.NDArray[np.generic]] = {}
    for j, axis in enumerate("xyz"):
        columns[f"wi_{axis}"] = samples["wi"].values[:, j]
    for j, axis in enumerate("xyz"):
        columns[f"wo_{axis}"] = samples["wo"].values[:, j]
    for kind in ("value", "standard_error"):
        if kind in samples and not np.all(np.isnan(samples[kind].values)):
            columns |= {f"{kind}_{name}": samples[kind].values[:, c] for c, name in enumerate(names)}
    columns |= {name: samples[name].values for name in EXTRA if name in samples.variables}
    count = samples.sizes["sample"]
    with whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(f"{FIRST}\n")
        for key in ("quantity", "value_units", "wi", "wo", "frame"):
            stream.write(f"# {key}: {CONVENTIONS[key]}\n")
        stream.write(",".join(columns) + "\n")
        for start in range(0, count, CHUNK):
            rows = [values[start : start + CHUNK].tolist() for values in columns.values()]
            stream.writelines(",".join(map(repr, row)) + "\n" for row in zip(*rows, strict=True))


def read_csv(path: Path) -> xr.Dataset:
    """Samples of a CSV file as this module describes it.

    Raises
    ------
    DatasetError
        No such file, columns missing or unknown, a cell that is not a number, directions not of unit length.
    """
    lines = _lines(path)
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    channels = [name.removeprefix("value_") for name in names if name.startswith("value_")]
    errors = [f"standard_error_{name}" for name in channels]
    given = VECTORS if set(VECTORS) <= set(names) else DEGREES
    _check_names(path, names, given, channels)
    numbers = _numbers(path, lines, names)
    if given == VECTORS:
        wi = np.stack([numbers[name] for name in VECTORS[:3]], axis=1)
        wo = np.stack([numbers[name] for name in VECTORS[3:]], axis=1)
    else:
        theta_i, phi_i, theta_o, phi_o = (np.deg2rad(numbers[name]) for name in DEGREES)
        wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    complete = all(name in numbers for name in errors)
    extra = {
        name: numbers[name].astype(np.int32) if name in WHOLE else numbers[name] for name in EXTRA if name in numbers
    }
    try:
        return sample_dataset(
            wi,
            wo,
            np.stack([numbers[f"value_{name}"] for name in channels], axis=1),
            standard_error=np.stack([numbers[name] for name in errors], axis=1) if complete else None,
            channels=[int(name) if re.fullmatch("[0-9]{1,9}", name) else name for name in channels],
            extra=extra,
            attrs={"source": f"CSV file {path.name}"},
        )
    except InputError as error:
        raise DatasetError(f"{path.name}: {error.message}", remedy=error.remedy) from error


def _lines(path: Path) -> list[str]:
    """The names' line and the samples', without comments."""
    try:
        text = readable(path, "BRDF file", LARGEST_BYTES, "Write it as NetCDF.", DatasetError)
        lines = text.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise DatasetError(f"Cannot read {path}: {error.strerror}.", remedy="Check the path.") from error
    except UnicodeError as error:
        raise DatasetError(f"Cannot read {path} as text: {error}.", remedy="Save it as CSV in UTF-8.") from error
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _check_names(path: Path, names: list[str], given: tuple[str, ...], channels: list[str]) -> None:
    errors, values = (f"standard_error_{name}" for name in channels), (f"value_{name}" for name in channels)
    known = {*VECTORS, *DEGREES, *EXTRA, *errors, *values}
    missing = [name for name in given if name not in names] + ([] if channels else ["value_NAME"])
    unknown = [name for name in names if name not in known]
    twice = sorted({name for name in names if names.count(name) > 1})
    if missing or unknown or twice:
        what = f"lacks {', '.join(missing)}" if missing else f"has unknown columns {', '.join(unknown)}"
        raise DatasetError.of(
            path.name,
            names,
            f"has {', '.join(twice)} twice" if twice else what,
            "Name the columns as docs/brdf.md does; values are in 1/sr, without cosine.",
        )


def _numbers(path: Path, lines: list[str], names: list[str]) -> dict[str, npt.NDArray[np.float64]]:
    """The columns by name; those of whole numbers are small enough to be such."""
    if len(lines) < 2:
        raise DatasetError.of(path.name, "no lines", "must hold at least one sample", "The file may be cut short.")
    try:
        cells = np.loadtxt(lines[1:], delimiter=",", ndmin=2, dtype=np.float64).reshape(-1, len(names))
    except ValueError as error:
        raise DatasetError(
            f"{path.name} holds a cell that is not a number: {error}.", remedy="Rows are counted without comments."
        ) from error
    numbers = dict(zip(names, cells.T, strict=True))
    for name in WHOLE:
        bad = np.flatnonzero(~(np.abs(numbers.get(name, np.zeros(1))) < 2**31))  # NaN too
        if bad.size:
            raise DatasetError.of(
                f"{path.name}, sample {bad[0] + 1}, {name}", float(numbers[name][bad[0]]), "must be a number below 2³¹",
                "Mend it, or leave the column out.",
            )  # fmt: skip
    return numbers


def _write(path: Path, data: xr.Dataset, _: Holes) -> None:
    write_csv(path, as_samples(data))


def _write_function(path: Path, function: Function) -> None:
    write_csv(path, as_samples(tabulated(function)))


FILE = FileFunctions(read_csv, _write, _write_function)
