"""BRDFs in a notebook: samples from photographs of a sphere, files in and out, models fitted."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from livlab.errors import InputError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from livlab.brdf.fit.result import BrdfFit
    from livlab.brdf.geometry import Camera, Light, Sphere


def extract(
    source: xr.DataArray | Path | str,
    camera: Camera | None = None,
    lights: Sequence[Light] | None = None,
    sphere: Sphere | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Samples of a BRDF from pictures of a sphere under known lights.

    Parameters
    ----------
    source
        A folder of photographs with a rig.toml, the rig.toml itself, or a folder in DiLiGenT's layout
        (docs/photographs.md); or linear images (light, row, column[, channel]).
    camera, lights, sphere
        The rig, with images only.
    progress
        Called with the lights done and all of them, with photographs only.
    options
        With photographs as `livlab.acquire.photographs.extract.extract_samples`, with images as
        `livlab.brdf.sphere.extract`.

    Returns
    -------
    Dataset on `sample`, as `livlab.brdf.sphere.extract` describes. What the photographs show to be wrong is warned of,
    and kept with what no calibration was given for in the attributes `warnings` and `not_corrected`, a line each.

    Raises
    ------
    InputError
        What is no rig, or what either extraction refuses.
    """
    rig = {"camera": camera, "lights": lights, "sphere": sphere}
    if isinstance(source, (str, Path)):
        given = [name for name, value in rig.items() if value is not None]
        if given:
            raise InputError.of("rig", ", ".join(given), "stands in the folder's rig.toml", "Leave it out here.")
        return _from_photographs(Path(source), progress, options)
    if not (hasattr(source, "dims") and hasattr(source, "to_numpy")):
        raise InputError.of(
            "source", type(source).__name__, "is neither a folder nor images", "Give a path, or an xarray.DataArray."
        )
    if camera is None or lights is None or sphere is None:
        missing = ", ".join(name for name, value in rig.items() if value is None)
        raise InputError.of("rig", missing, "is needed beside images", "Give camera, lights and sphere.")
    if progress is not None:
        raise InputError.of("progress", progress, "goes with photographs only", "Leave it out.")
    from livlab.brdf.sphere import extract as from_images

    return from_images(source, camera, lights, sphere, **options)


def read(path: Path | str) -> xr.Dataset:
    """Samples or a table from a file: .nc, .csv, .binary (MERL), .bsdf (Mitsuba), .alta, or a fit's .json.

    See `livlab.brdf.files.registry`.
    """
    from livlab.brdf.files.formats import read_brdf

    return read_brdf(Path(path))


def write(path: Path | str, data: xr.Dataset | BrdfFit, *, holes: Any = "refuse") -> Path:
    """Write samples, a table, or the model of a fit, by the file's suffix.

    `holes` of a table are "refuse", "fill" (marked) or "zero"; a fitted model has none.
    """
    from livlab.brdf.files.fitted import Fitted
    from livlab.brdf.files.formats import write_brdf, write_fitted
    from livlab.brdf.fit.result import BrdfFit

    if isinstance(data, BrdfFit):
        values = {str(name): found.to_numpy() for name, found in data.parameters().items()}
        write_fitted(Path(path), Fitted(data.model, values, data.layout.channels))
    else:
        write_brdf(Path(path), data, holes=holes)
    return Path(path)


def fit_model(data: xr.Dataset, model: str, *, loss: Any = "cosine-weighted-l2", **options: Any) -> BrdfFit:
    """Fit a model ("lambert+ggx") to samples or a table; further options as `livlab.brdf.fit.fit.fit`."""
    from livlab.brdf.fit.fit import fit
    from livlab.brdf.table import as_samples

    return fit(as_samples(data), model, loss=loss, **options)


def plot(data: xr.Dataset, found: BrdfFit | None = None, *, title: str = "") -> list[Axes]:
    """Draw samples or a table: the sphere and its residuals where there are pictures, polar lobes, cells with holes.

    Parameters
    ----------
    data
        Samples or a table.
    found
        A fit whose residuals and lobes are drawn, too.
    title
        Heading.

    Returns
    -------
    The figure's axes, colour bars' last; `axes[0].figure` is the figure.
    """
    from livlab.brdf.table import as_samples
    from livlab.reports.sphere_figures import lobes_of, sphere_figure

    samples = as_samples(data)
    predicted = None if found is None else found.predict(samples).mean("channel").values
    lobes = None if found is None else lobes_of(found.evaluate)
    heading = title or ("" if found is None else f"{found.model.name}, {found.relative_rmse:.2%} rms")
    made = sphere_figure(samples, predicted, lobes, heading)
    bars = [ax for ax in made.axes if ax.get_label() == "<colorbar>"]
    return [*(ax for ax in made.axes if ax not in bars), *bars]


def _from_photographs(path: Path, progress: Callable[[int, int], None] | None, options: dict[str, Any]) -> xr.Dataset:
    from livlab.acquire.photographs.extract import extract_samples
    from livlab.acquire.photographs.open import open_rig

    photographs = open_rig(path)
    found = extract_samples(photographs, progress=progress, **options)
    for text in found.warnings:
        warnings.warn(f"{photographs.name}: {text}", UserWarning, stacklevel=3)
    return found.samples.assign_attrs(warnings="\n".join(found.warnings), not_corrected="\n".join(found.unresolved))
