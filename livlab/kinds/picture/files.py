"""What a picture run leaves in its folder: spectral pictures, EXR and PNG by reading and colour route, tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.kinds.picture import tables
from livlab.kinds.picture.claims import Key, PictureSummary
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.picture.work import Work
from livlab.kinds.shared import tissue_tables
from livlab.kinds.shared.tissue_tables import Made
from livlab.model.colour import CHANNEL_CENTRES_NM, write_exr, write_png
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.runs.work import Run

_DIMS = ("row", "column", "wavelength")
_PACKED = {"zlib": True, "complevel": 1, "shuffle": True, "dtype": "float32"}


def label(key: Key) -> str:
    """How a picture is called: its reading, before it the tissue where it is not the experiment's own.

    >>> label(("", "thesis")), label(("healthy", "thesis"))
    ('thesis', 'healthy, thesis')
    """
    return f"{key[0]}, {key[1]}" if key[0] else key[1]


def stem(text: str) -> str:
    """A name as part of a file name.

    >>> stem("healthy, plain cos")
    'healthy-plain-cos'
    """
    kept = "".join(c if c.isalnum() and c.isascii() else " " for c in text)
    return "-".join(kept.split()) or "picture"


def preview(run: Run, work: Work, film: CameraFilm) -> None:
    """preview.png: the picture under way as it stands."""
    route = next(iter(work.routes.values()))
    write_png(run.folder / "preview.png", route.rgb(_picture(film.radiance, work.grid)), exposure=_exposure(work))


def write_pictures(run: Run, work: Work, films: Mapping[Key, CameraFilm], baselines: Mapping[str, FloatArray]) -> None:
    """image.nc (the experiment's own tissue), image-TISSUE.nc, baselines.nc, and every picture as EXR and PNG."""
    shown: list[dict[str, object]] = []
    for tissue in dict.fromkeys(key[0] for key in films):
        mine = {key[1]: film for key, film in films.items() if key[0] == tissue}
        name = "image.nc" if not tissue else f"image-{stem(tissue)}.nc"
        run.write(name, _dataset(work, mine).to_netcdf(None, engine="h5netcdf", encoding=_encoding()))
    for key, film in films.items():
        shown += _colours(run, work, label(key), film.radiance, {"tissue": key[0], "reading": key[1]})
    if baselines:
        names = list(baselines)
        stacked = xr.DataArray(np.stack([baselines[n] for n in names]), dims=("baseline", *_DIMS))
        made = xr.Dataset({"radiance": stacked}, {"baseline": names, "wavelength": work.grid})
        packed = made.to_netcdf(None, engine="h5netcdf", encoding={"radiance": _PACKED})
        run.write("baselines.nc", packed)
        for name, radiance in baselines.items():
            shown += _colours(run, work, f"baseline {name}", radiance, {"baseline": name})
    first = shown[0]
    for kind in ("png", "exr"):
        run.write(f"image.{kind}", (run.folder / str(first[kind])).read_bytes())
    run.write("preview.png", (run.folder / "image.png").read_bytes())
    columns = ("tissue", "reading", "baseline", "route", "png", "exr", "below_gamut", "above_white", "pixels")
    run.write_table("pictures.csv", columns, shown)


def tables_of(work: Work, films: Mapping[Key, CameraFilm], pictures: Mapping[Key, PictureSummary]) -> dict[str, Made]:
    """Every CSV of the run but its costs and claims."""
    config = work.config
    readings = config.all_readings
    own = config.tissue.build()
    lit = work.camera.lit
    made: dict[str, Made] = {
        "absorption.csv": tables.absorption(work.curves),
        "optics.csv": tables.optics(work.stacks, CHANNEL_CENTRES_NM),
        "convergence.csv": tables.convergence(films),
        "tissue.csv": tissue_tables.tissue(own, readings),
        "readings.csv": tissue_tables.readings(readings, own, *(c.tissue.build() for c in config.compared)),
        "provenance.csv": tissue_tables.provenance(own, readings, work.grid, ()),
    }
    if lit.any():
        made["colours.csv"] = tables.colours(pictures)
        if len(work.routes) > 1:
            made["differences.csv"] = tables.colour_differences(films, lit, work.routes, _exposure(work))
    if work.plans:
        from livlab.effects.plan import COLUMNS

        rows = [{"reading": label(key), **row} for key, plan in work.plans.items() for row in plan.plan.records()]
        made["plan.csv"] = (("reading", *COLUMNS), rows)
    return made


def _colours(
    run: Run, work: Work, name: str, radiance: FloatArray, about: dict[str, object]
) -> list[dict[str, object]]:
    """One picture by every route, as EXR (linear) and PNG (as a screen shows it)."""
    rows = []
    for route in work.routes.values():
        rgb = route.rgb(_picture(radiance, work.grid))
        base = f"{stem(name)}-{route.name}"
        write_exr(run.folder / f"{base}.exr", rgb, metadata={"route": route.name}, depth="half")
        moved = write_png(run.folder / f"{base}.png", rgb, exposure=_exposure(work))
        for suffix in ("exr", "png"):
            run.keep(f"{base}.{suffix}")
        rows.append(
            {
                **about,
                "route": route.name,
                "png": f"{base}.png",
                "exr": f"{base}.exr",
                "below_gamut": moved.attrs["gamut_below"],
                "above_white": moved.attrs["gamut_above"],
                "pixels": moved.attrs["gamut_colours"],
            }
        )
    return rows


def _picture(radiance: FloatArray, grid: FloatArray) -> xr.DataArray:
    return xr.DataArray(radiance, dims=_DIMS, coords={"wavelength": grid})


def _exposure(work: Work) -> float:
    return work.config.colour.exposure


def _dataset(work: Work, films: Mapping[str, CameraFilm]) -> xr.Dataset:
    dims = ("reading", *_DIMS)
    units = {"units": "1", "long_name": "radiance over that of a white diffuser of level 1"}
    missing = {"units": "1", "long_name": "bound of the radiance of paths given up"}
    data: dict[str, Any] = {
        "radiance": (dims, np.stack([f.radiance for f in films.values()]).astype(np.float32), units),
        "radiance_se": (dims, np.stack([f.standard_error for f in films.values()]).astype(np.float32), units),
        "systematic": (dims, np.stack([f.systematic for f in films.values()]).astype(np.float32), missing),
        "samples": (("reading",), [f.samples for f in films.values()]),
        "lit": (_DIMS[:2], work.camera.lit),
    }
    coords = {"reading": list(films), "wavelength": ("wavelength", work.grid, {"units": "nm"})}
    used = {f"route_{r.name}": ",".join(map(str, r.indices)) for r in work.routes.values()}
    first = next(iter(films.values()))
    return xr.Dataset(
        data,
        coords,
        {
            "seed": work.config.seed,
            "variant": work.config.sampling.variant,
            "estimator": work.config.sampling.estimator,
            "samples": sum(f.samples for f in films.values()),
            "seconds": sum(f.seconds for f in films.values()),
            **used,
            **{k: v for k, v in first.about.items() if isinstance(v, str | int | float)},
        },
    )


def _encoding() -> dict[str, dict[str, Any]]:
    return {name: dict(_PACKED) for name in ("radiance", "radiance_se", "systematic")}
