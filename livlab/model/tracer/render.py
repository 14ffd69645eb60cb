"""Pictures of a scene with a body of tissue, at any number of wavelengths, with the error of every pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from livlab.model.tracer.body import Body
from livlab.model.tracer.film import Film, row_samples
from livlab.model.tracer.tracer import VARIANT, Tracer


def render(
    scene: Mapping[str, Any] | Any,
    wavelengths_nm: Sequence[float],
    *,
    body: Body | None = None,
    spp: int = 16,
    seed: int = 0,
    estimator: str = "expected",
    sensor: int = 0,
    variant: str = VARIANT,
    max_steps: int = 100_000,
) -> xr.Dataset:
    """Radiance that a camera sees.

    Parameters
    ----------
    scene
        A scene as `mitsuba.load_dict` takes it, or a loaded one of the same variant. The body's surfaces are shapes
        of it, named by their keys; their BSDF is not used.
    wavelengths_nm
        (W,) wavelengths; those of the body's stack.
    body
        The tissue; None: a scene without.
    spp
        Samples a pixel; each serves all wavelengths.
    seed
        Natural number.

    Returns
    -------
    xr.Dataset
        radiance and its standard error radiance_se on (row, column, wavelength).
    """
    tracer = Tracer(
        scene,
        np.asarray(wavelengths_nm),
        body,
        sensor=sensor,
        estimator=estimator,
        variant=variant,
        max_steps=max_steps,
    )
    film = Film(tracer.shape, tracer.wavelengths, row_samples(spp))
    while film.samples < spp:
        rows = min(tracer.most_rows(), (spp - film.samples) // film.row_samples)
        film.add(tracer.launch(rows, film.row_samples, seed, film.passes), rows, tracer.padded)
    out = film.dataset()
    out.attrs = {
        "samples": film.samples,
        "seed": seed,
        "variant": variant,
        "estimator": estimator,
        "seconds": tracer.seconds,
        "compile_seconds": tracer.compile_seconds,
        **tracer.troubles,
    }
    return out
