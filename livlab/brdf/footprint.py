"""What a pixel averages over: directions and weights at points inside it, so that a fit can average its model alike.

A sample's value is L / (E cos θ_i) with the radiance L of the whole pixel and everything else at its centre. A model
f predicts that value as Σ_k w_k f(wi_k, wo_k) over points k inside the pixel, where

    w_k = a_k (E_k cos θ_i,k) / (E_0 cos θ_i,0),

a_k is the share of the pixel that point k stands for and 0 is the centre. A point that misses the sphere or that the
light does not reach has w_k = 0, so the weights of a pixel need not sum to 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

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


@dataclass(frozen=True, eq=False)
class Footprint:
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
    lights = lights * (int(light_of.max(initial=0)) + 1) if len(lights) == 1 else lights
    axis = np.asarray(samples.attrs.get("pole", (0.0, 1.0, 0.0)), dtype=np.float64)
    # Pixels serve several lights: what the eye sees is worked out once for each.
    pixels, pixel_of = np.unique(rows.astype(np.int64) * camera.width + columns, return_inverse=True)
    by_pixel = np.argsort(pixel_of, kind="stable")
    step = max(int(max_bytes // (BYTES_PER_POINT * len(shares))), 1)
    for start in range(0, len(pixels), step):
        part = pixels[start : start + step]
        seen = _Seen(camera, sphere, part % camera.width, part // camera.width, offsets, shares, axis)
        first, last = np.searchsorted(pixel_of, (start, start + step), sorter=by_pixel)
        here = by_pixel[first:last]
        for k in np.unique(light_of[here]):
            mine = here[light_of[here] == k]
            yield seen.under(lights[int(k)], pixel_of[mine] - start, chosen[mine])


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


class _Seen:
    """What the points inside some pixels see of the sphere: all that does not depend on the light."""

    def __init__(
        self,
        camera: Camera,
        sphere: Sphere,
        columns: npt.NDArray[np.integer],
        rows: npt.NDArray[np.integer],
        offsets: FloatArray,
        shares: FloatArray,
        axis: FloatArray,
    ) -> None:
        self.shares = shares
        self.centres = sphere.meet(*camera.rays(columns, rows))
        origins, directions = camera.rays(columns[:, None] + offsets[:, 0], rows[:, None] + offsets[:, 1])
        self.points = sphere.meet(origins, directions)
        self.frames = local_frames(self.points.normals, axis)
        self.wo = np.einsum("nkij,nkj->nki", self.frames, -directions)

    def under(self, light: Light, pixels: IntArray, index: IntArray) -> Footprint:
        """Points inside some of the pixels with one light."""
        points, normals = self.points.points_mm[pixels], self.points.normals[pixels]
        towards, scale = light.at(points)
        at_centre = received(light, self.centres.points_mm[pixels], self.centres.normals[pixels])
        cos_i = np.einsum("nki,nki->nk", towards, normals)
        weight = (
            self.shares * np.where(self.points.hit[pixels], scale * np.maximum(cos_i, 0.0), 0.0) / at_centre[:, None]
        )
        wi = np.einsum("nkij,nkj->nki", self.frames[pixels], towards)
        wo = self.wo[pixels]
        # A point of no weight gets directions in which every model is finite.
        idle = weight <= 0
        if idle.any():
            wi[idle] = wo[idle] = (0.0, 0.0, 1.0)
        return Footprint(index, wi, wo, weight)


def received(light: Light, points_mm: FloatArray, normals: FloatArray) -> FloatArray:
    """E cos θ_i over the light's intensity, at points of a surface."""
    towards, scale = light.at(points_mm)
    return np.asarray(scale * np.maximum(np.einsum("...i,...i->...", towards, normals), 0.0))
