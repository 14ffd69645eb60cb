"""Valid files of every BRDF format: a maker for each row of `livlab.brdf.files.registry.FORMATS`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

ALTA = "#DIM 3 1\n#PARAM_IN RUSIN_TH_TD_PD\n#PARAM_OUT INV_STERADIAN\n#VS 0\n0.1 0.2 0.3 0.5\n0.2 0.2 0.3 0.4\n"
TYPED = b"theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_0,light\n0,0,10,0,0.5,1\n20,0,30,9,0.4,2\n"


def _samples() -> xr.Dataset:
    from livlab.brdf.samples import sample_dataset

    way = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8]])
    return sample_dataset(way, way[::-1], np.full((3, 1), 0.3), channels=["L"])


def _netcdf(place: Path) -> list[bytes]:
    from livlab.brdf.files.netcdf import write_netcdf
    from livlab.brdf.grid import Grid
    from livlab.brdf.table import merge

    found = []
    for data in (_samples(), merge(_samples(), Grid.uniform(4, 4, 4))):
        write_netcdf(place / "seed.nc", data)
        found.append((place / "seed.nc").read_bytes())
    return found


def _csv(place: Path) -> list[bytes]:
    from livlab.brdf.files.csv import write_csv

    write_csv(place / "seed.csv", _samples())
    return [(place / "seed.csv").read_bytes(), TYPED]


def _merl(_: Path) -> list[bytes]:
    return [np.array([90, 90, 180], "<i4").tobytes() + bytes(240)]


def _mitsuba(place: Path) -> list[bytes]:
    from livlab.brdf.files.mitsuba import write_mitsuba

    write_mitsuba(place / "seed.bsdf", lambda wi, wo: np.full((len(wi), 1), 0.3), theta_count=4, size=4)
    return [(place / "seed.bsdf").read_bytes()]


def _alta(_: Path) -> list[bytes]:
    return [ALTA.encode(), ALTA.replace("3 1", "2 3").replace("_TD_PD", "_TD").replace("INV_STER", "RGB_").encode()]


def _fit(_: Path) -> list[bytes]:
    from livlab.brdf.fit.fit import fit
    from livlab.brdf.models.model import model
    from livlab.brdf.samples import sample_dataset

    rng = np.random.default_rng(1)
    wi, wo = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in rng.uniform(0.1, 1.0, (2, 40, 3)))
    truth = {"kd": [0.45, 0.2], "alpha": [0.3, 0.3], "eta": [1.5, 1.5], "ks": [1.0, 1.0]}
    value = model("plastic").evaluate(wi, wo, {name: np.array(x) for name, x in truth.items()})
    found = []
    for name, channels in (("plastic", ["R", "G"]), ("lambert", ["L"])):
        samples = sample_dataset(wi, wo, value[:, : len(channels)], channels=channels)
        found.append(fit(samples, name, bootstrap=None, starts=1, warn=False).to_json().encode())
    return found


SEEDS: dict[str, Callable[[Path], list[bytes]]] = {
    "netcdf": _netcdf,
    "csv": _csv,
    "merl": _merl,
    "mitsuba": _mitsuba,
    "alta": _alta,
    "fit": _fit,
}
"""Makers of seeds by the format's name; they may write in the folder that they are given."""

DEAR = {"netcdf": 10}
"""About how many times the milliseconds of a cheap reader a format's takes."""
