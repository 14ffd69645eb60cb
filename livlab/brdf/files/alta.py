"""Text files of the ALTA library: a header of `#KEY VALUE` lines, then numbers: inputs, outputs, intervals."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import direction, from_half_angles
from livlab.brdf.files.interface import FileFunctions
from livlab.brdf.samples import sample_dataset
from livlab.core.files import readable
from livlab.errors import DatasetError, InputError

FloatArray = npt.NDArray[np.float64]
Pair = tuple[FloatArray, FloatArray]

LARGEST_BYTES = 1 << 29


def _half(x: FloatArray) -> Pair:
    return from_half_angles(x[:, 0], x[:, 1], x[:, 2])


def _half_azimuth(x: FloatArray) -> Pair:
    return from_half_angles(x[:, 0], x[:, 2], x[:, 3], x[:, 1])


def _half_plane(x: FloatArray) -> Pair:
    return from_half_angles(x[:, 0], x[:, 1], np.full(len(x), np.pi / 2))


def _spherical(x: FloatArray) -> Pair:
    return direction(x[:, 0], x[:, 1]), direction(x[:, 2], x[:, 3])


def _isotropic(x: FloatArray) -> Pair:
    return direction(x[:, 1], x[:, 2]), direction(x[:, 0], np.zeros(len(x)))


def _cartesian(x: FloatArray) -> Pair:
    return x[:, 3:6], x[:, 0:3]


INPUTS: dict[str, tuple[int, Callable[[FloatArray], Pair]]] = {
    "RUSIN_TH_TD_PD": (3, _half),
    "RUSIN_TH_PH_TD_PD": (4, _half_azimuth),
    "RUSIN_TH_TD": (2, _half_plane),
    "SPHERICAL_TL_PL_TV_PV": (4, _spherical),
    "ISOTROPIC_TV_TL_DPHI": (3, _isotropic),
    "CARTESIAN": (6, _cartesian),
}
"""Input parametrisations that are read, their number of columns, and wi (light) and wo (view) of them; radians.

CARTESIAN has the view first. RUSIN_TH_TD has no azimuth: it is read at φ_d = π/2, as ALTA does."""

OUTPUTS = {
    "INV_STERADIAN": ("0",),
    "INV_STERADIAN_COSINE_FACTOR": ("0",),
    "RGB_COLOR": ("R", "G", "B"),
    "XYZ_COLOR": ("X", "Y", "Z"),
}
"""Output parametrisations that are read, and their channels."""


def read_alta(path: Path) -> xr.Dataset:
    """Samples of an ALTA text file, 1/sr without cosine; values with the light's cosine in them are divided by it.

    Raises
    ------
    DatasetError
        No such file, a header without `#DIM`, `#PARAM_IN` or `#PARAM_OUT`, a parametrisation that is not read, a line
        with another number of columns, directions below the surface where a cosine is to be divided out.
    """
    try:
        text = readable(path, "BRDF file", LARGEST_BYTES, "Split it.", DatasetError)
        lines = text.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeError) as error:
        raise DatasetError(f"Cannot read {path} as text: {error}.", remedy="Check the path.") from error
    header = _header(lines)
    kind, out = _one(path, header, "PARAM_IN", INPUTS), _one(path, header, "PARAM_OUT", OUTPUTS)
    inputs, to_pair = INPUTS[kind]
    channels = list(OUTPUTS[out])
    dim = header.get("DIM", [])
    many = out == "INV_STERADIAN" and len(dim) == 2 and re.fullmatch("[0-9]{1,4}", dim[1]) and int(dim[1]) > 0
    if many:  # a spectrum: as many outputs as the header says
        channels = [str(c) for c in range(int(dim[1]))]
    if dim != [str(inputs), str(len(channels))]:
        raise DatasetError.of(
            f"{path.name}, #DIM", " ".join(dim), f"must be {inputs} {len(channels)} for {kind} and {out}", "Mend it."
        )
    table, first = _numbers(path, lines, inputs + len(channels))
    wi, wo = to_pair(table[:, :inputs])
    value = table[:, inputs : inputs + len(channels)]
    if out == "INV_STERADIAN_COSINE_FACTOR":
        cosine = wi[:, 2:]
        if np.any(cosine <= 0):
            row = int(np.flatnonzero(cosine[:, 0] <= 0)[0])
            raise DatasetError.of(
                f"{path.name}, line {first[row]}", float(cosine[row, 0]), "cosine of the light must be > 0", "Drop it."
            )
        value = value / cosine
    attrs = {"source": f"ALTA file {path.name}", "alta_param_in": kind, "alta_param_out": out}
    try:
        return sample_dataset(wi, wo, value, channels=channels, attrs=attrs)
    except InputError as error:
        raise DatasetError(f"{path.name}: {error.message}", remedy=error.remedy) from error


def _header(lines: list[str]) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    for line in lines:
        words = line[1:].split() if line.startswith("#") and not line.startswith("# ") else []
        if words:
            header.setdefault(words[0], words[1:])
    return header


def _one(path: Path, header: dict[str, list[str]], key: str, known: Mapping[str, object]) -> str:
    name = (header.get(key) or [""])[0]
    if name not in known:
        raise DatasetError.of(
            f"{path.name}, #{key}",
            name,
            f"must be one of {', '.join(known)}",
            "Convert it with ALTA's data2data.",
        )
    return name


def _numbers(path: Path, lines: list[str], least: int) -> tuple[FloatArray, list[int]]:
    rows, where, width = [], [], 0
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        width = width or len(words)
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != width or len(row) < least:
            raise DatasetError.of(
                f"{path.name}, line {number}",
                line,
                f"must hold {max(width, least)} numbers",
                "The file may be cut short.",
            )
        rows.append(row)
        where.append(number)
    if not rows:
        raise DatasetError.of(path.name, "no numbers", "must hold at least one sample", "The file may be cut short.")
    return np.asarray(rows, dtype=np.float64), where


FILE = FileFunctions(read_alta)
