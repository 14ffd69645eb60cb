"""What a pixel averages over: directions and weights at points inside it, so that a fit can average its model alike.

A sample's value is L / (E cos θ_i) with the radiance L of the whole pixel and everything else at its centre. A model
f predicts that value as Σ_k w_k f(wi_k, wo_k) over points k inside the pixel, where

    w_k = a_k (E_k cos θ_i,k) / (E_0 cos θ_i,0),

a_k is the share of the pixel that point k stands for and 0 is the centre. A point that misses the sphere or that the
light does not reach has w_k = 0, so the weights of a pixel need not sum to 1.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import local_frames
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.rig import rig_of
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Rule = Literal["gauss", "midpoint"]

BYTES_PER_POINT = 400
"""Temporary memory for each point inside a pixel while directions are made."""


class Footprint(NamedTuple):
    """Points inside the pixels of some samples.

    Attributes
    ----------
    index : (n,) int array
        Which samples.
    wi, wo : (n, k, 3) arrays
        Unit vectors in the local frame at each point, to the light and to the eye.
    weight : (n, k) array
        Weights; the model's value of sample n is the sum over k of weight times f(wi, wo).
    """

    index: IntArray
    wi: FloatArray
    wo: FloatArray
    weight: FloatArray


def pixel_points(n: int, rule: Rule) -> tuple[FloatArray, FloatArray]:
    """Offsets (n², 2) from a pixel's centre, column and row, and their shares (n²,) of its area.

    `midpoint` are the centres of n by n equal parts; `gauss` are Gauss-Legendre nodes, exact for polynomials up to
    degree 2n − 1: 3 by 3 of them do what 8 by 8 midpoints do where f is smooth within a pixel.
    """
    if not (isinstance(n, int | np.integer) and 1 <= n <= 64):
        raise InputError.of("n", n, "must be a whole number from 1 to 64", "Give 3 with gauss, 8 with midpoint.")
    if rule == "gauss":
        nodes, weights = np.polynomial.legendre.leggauss(int(n))
        nodes, weights = nodes / 2, weights / 2
    else:
        nodes, weights = (np.arange(n) + 0.5) / n - 0.5, np.full(n, 1 / n)
    columns, rows = np.meshgrid(nodes, nodes)
    return np.stack([columns.ravel(), rows.ravel()], axis=-1), np.outer(weights, weights).ravel()


def footprints(
    samples: xr.Dataset,
    n: int = 8,
    *,
    rule: Rule = "midpoint",
    index: npt.ArrayLike | None = None,
    max_bytes: int = 256 << 20,
) -> Iterator[Footprint]:
    """Points inside the pixels of samples, batch after batch, each small enough for `max_bytes`.

    Parameters
    ----------
    samples : Dataset
        Of `livlab.brdf.sphere.extract`; any selection along `sample` keeps working.
    n : int
        Points along each side of a pixel.
    rule : "gauss" or "midpoint"
        See `pixel_points`.
    index : (m,) int or (sample,) bool array, or None
        Which samples; all.
    max_bytes : int
        Memory that a batch may take while it is made.

    Raises
    ------
    InputError
        The samples carry no rig or no pixels.
    """
    camera, lights, sphere = rig_of(samples)
    offsets, shares = pixel_points(n, rule)
    chosen = np.arange(samples.sizes["sample"]) if index is None else np.asarray(index)
    chosen = np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen.astype(np.intp)
    rows, columns, light_of = (samples[name].values[chosen] for name in ("row", "column", "light"))
    # Samples of one light alone (`by_light`) keep the light's number, but their rig holds one light.
    alone = len(lights) == 1
    axis = np.asarray(samples.attrs.get("pole", (0.0, 1.0, 0.0)), dtype=np.float64)
    step = max(int(max_bytes // (BYTES_PER_POINT * len(shares))), 1)
    for k in np.unique(light_of):
        light = lights[0 if alone else int(k)]
        mine = np.flatnonzero(light_of == k)
        for start in range(0, len(mine), step):
            part = mine[start : start + step]
            yield _batch(camera, light, sphere, chosen[part], columns[part], rows[part], offsets, shares, axis)


def footprint(
    samples: xr.Dataset,
    n: int = 8,
    *,
    rule: Rule = "midpoint",
    index: npt.ArrayLike | None = None,
    max_bytes: int = 1 << 30,
) -> Footprint:
    """Points inside the pixels of all chosen samples at once, in the order of `index`; see `footprints`.

    Raises
    ------
    InputError
        They would take more than `max_bytes`, or the samples carry no rig.
    """
    chosen = np.arange(samples.sizes["sample"]) if index is None else np.asarray(index)
    chosen = np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen.astype(np.intp)
    points = n * n
    needed = len(chosen) * points * 7 * 8
    if needed > max_bytes:
        raise InputError.of(
            "samples",
            f"{len(chosen)} samples with {points} points each, {needed / 2**20:.0f} MiB",
            f"take more memory than max_bytes = {max_bytes / 2**20:.0f} MiB",
            "Go through livlab.brdf.footprint.footprints, choose samples with index, or use rule='gauss' with n=3.",
        )
    wi, wo = np.empty((len(chosen), points, 3)), np.empty((len(chosen), points, 3))
    weight = np.empty((len(chosen), points))
    for batch in footprints(samples.isel(sample=chosen), n, rule=rule):
        wi[batch.index], wo[batch.index], weight[batch.index] = batch.wi, batch.wo, batch.weight
    return Footprint(chosen, wi, wo, weight)


def _batch(
    camera: Camera,
    light: Light,
    sphere: Sphere,
    index: IntArray,
    columns: npt.NDArray[np.integer],
    rows: npt.NDArray[np.integer],
    offsets: FloatArray,
    shares: FloatArray,
    axis: FloatArray,
) -> Footprint:
    def look(column: FloatArray, row: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        origins, directions = camera.rays(column, row)
        hits = sphere.meet(origins, directions)
        towards, scale = light.at(hits.points_mm)
        cos_i = np.einsum("...i,...i->...", towards, hits.normals)
        return hits.normals, directions, towards, np.where(hits.hit, scale * np.maximum(cos_i, 0.0), 0.0)

    normals, directions, towards, received = look(columns[:, None] + offsets[:, 0], rows[:, None] + offsets[:, 1])
    at_centre = look(columns.astype(np.float64), rows.astype(np.float64))[3]
    weight = shares * received / at_centre[:, None]
    frames = local_frames(normals, axis)
    wi = np.einsum("nkij,nkj->nki", frames, towards)
    wo = np.einsum("nkij,nkj->nki", frames, -directions)
    # A point of no weight gets directions in which every model is finite.
    idle = (weight <= 0)[..., None]
    up = np.array([0.0, 0.0, 1.0])
    return Footprint(index, np.where(idle, up, wi), np.where(idle, up, wo), weight)
