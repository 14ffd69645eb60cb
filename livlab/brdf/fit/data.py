"""Samples packed for a fit: values, loss weights, blocks for errors, and the points at which a model is averaged."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import half_angles
from livlab.brdf.fit import blocks
from livlab.brdf.fit.noise import NEIGHBOURS, REPEATS, STATED, UNKNOWN, of_neighbours, of_repeats
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.models.lobes import Cosines
from livlab.brdf.rig import rig_of
from livlab.brdf.samples import check_samples
from livlab.errors import InputError
from livlab.units import FloatArray

IntArray = npt.NDArray[np.intp]
Footprint = Literal["auto"] | int | None
"""How pixels are integrated: by squares and Gauss points as needed, by n × n midpoints each, or not at all."""

TILE = 16
"""Side in pixels of the blocks within which residuals are taken to hang together."""

ROWS = ("value", "error", "noise", "cos_i", "pixels", "light", "tile", "theta_h", "theta_d", "phi_h")
"""What `Packed` has one row a sample of."""

DIRECTIONS = "directions"
"""Footprint, in words, of samples that are no pixels."""


@dataclass(frozen=True, eq=False)
class Packed:
    """Samples ready for a fit.

    Attributes
    ----------
    value, error : (n, channels) arrays
        Measured BRDF and its standard error (NaN if unknown), 1/sr.
    cos_i : (n,) array
        Light's cosine at the samples.
    pixels : (n,) array
        How many pixels each stands for.
    at : Cosines
        (m,) cosines at the points, sample after sample.
    weight : (m,) array
        Of the points.
    first : (n,) int array
        First point of each sample.
    light, tile : (n,) int arrays
        Light's number, and number of the patch of picture (within its light).
    theta_h, theta_d, phi_h : (n,) arrays
        Angles of the samples.
    noise : (n, channels) array
        Standard error, stated or estimated, 1/sr; NaN if unknown.
    noise_from, noise_dof
        Where the noise is from, in words, and degrees of freedom of an estimate.
    channels : tuple
        Labels.
    dropped : int
        Samples left out since they were not finite.
    source_rad : float
        Largest angular radius of a light as the surface sees it.
    footprint : str
        How pixels are integrated, in words.
    notes : tuple of str
        What the reader should know about the packing.
    source_known : bool
        Whether the lights' size was said; photographs often do not know it.
    radius_px : float
        Radius of the sphere's picture, px; infinite of samples that are no pixels.
    """

    value: FloatArray
    error: FloatArray
    cos_i: FloatArray
    pixels: FloatArray
    at: Cosines
    weight: FloatArray
    first: IntArray
    light: IntArray
    tile: IntArray
    theta_h: FloatArray
    theta_d: FloatArray
    phi_h: FloatArray
    noise: FloatArray
    channels: tuple[str, ...]
    noise_from: str = STATED
    noise_dof: float = np.inf
    source_rad: float = 0.0
    footprint: str = DIRECTIONS
    dropped: int = 0
    notes: tuple[str, ...] = ()
    source_known: bool = True
    radius_px: float = math.inf

    @property
    def size(self) -> int:
        """Samples."""
        return len(self.cos_i)

    def averaged(self, values: FloatArray) -> FloatArray:
        """Weighted sum over each sample's points of values (m,) at the points."""
        weighted = values * self.weight
        if weighted.size == self.size:
            return weighted
        return np.asarray(np.add.reduceat(weighted, self.first))

    def select(self, index: IntArray) -> Packed:
        """Some of the samples."""
        counts = np.diff(np.append(self.first, self.weight.size))[index]
        begins = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.intp)
        points = np.repeat(self.first[index] - begins, counts) + np.arange(int(counts.sum()))
        return replace(
            self,
            at=Cosines(*(np.ascontiguousarray(c[points]) for c in self.at)),
            weight=self.weight[points],
            first=begins,
            **{name: getattr(self, name)[index] for name in ROWS},
        )


class _Raw(NamedTuple):
    """Samples as they came: directions (n, 3), values, errors, noise (n, channels), and which of them can be used."""

    wi: FloatArray
    wo: FloatArray
    value: FloatArray
    error: FloatArray
    noise: FloatArray
    keep: IntArray
    channels: tuple[str, ...]


class _Lit(NamedTuple):
    """The pixels of one light: their samples' numbers, cosines, received light and angles."""

    number: int
    light: Light
    pixels: IntArray
    cos_i: FloatArray
    received: FloatArray
    theta_h: FloatArray
    theta_d: FloatArray
    phi_h: FloatArray


def pack(samples: xr.Dataset | Iterable[xr.Dataset], footprint: Footprint = "auto") -> Packed:
    """Pack one data set, or several of the same rig one after another (`livlab.brdf.sphere.by_light`).

    Parameters
    ----------
    samples
        Of `livlab.brdf.sphere.extract` or `by_light`; without a rig (files, goniometers) `footprint` has no effect.
    footprint
        "auto": pixels in squares where nothing varies fast, integrated by Gauss–Legendre points. A number n: every
        pixel by n × n midpoints. None: the pixel's centre.

    Raises
    ------
    InputError
        No samples, channels that differ, values none of which is finite.
    """
    if not (footprint is None or footprint == "auto" or (isinstance(footprint, int) and 1 <= footprint <= 64)):
        raise InputError.of("footprint", footprint, 'must be "auto", a number from 1 to 64, or None', "Use auto.")
    parts = []
    for part in [samples] if isinstance(samples, xr.Dataset) else samples:
        check_samples(part)
        found = _pack_one(part, footprint)
        if found.size:
            parts.append(replace(found, notes=(*_scale_note(part), *found.notes)))
    if not parts:
        raise InputError.of("samples", 0, "hold no finite sample", "Check masks, exposure and lights.")
    return parts[0] if len(parts) == 1 else _joined(parts)


def _scale_note(samples: xr.Dataset) -> tuple[str, ...]:
    """That albedos and reflectances share an unknown factor, where no white reference gave the scale."""
    if not str(samples.attrs.get("scale", "")).startswith("arbitrary"):
        return ()
    return ("no white reference: albedos and reflectances are known up to one common factor, and may exceed 1",)


def _pack_one(samples: xr.Dataset, footprint: Footprint) -> Packed:
    value = np.asarray(samples["value"].values, dtype=np.float64)
    error = (
        np.asarray(samples["standard_error"].values, dtype=np.float64)
        if "standard_error" in samples
        else np.broadcast_to(np.nan, value.shape)
    )
    wi, wo = (np.asarray(samples[n].values, dtype=np.float64) for n in ("wi", "wo"))
    good = np.isfinite(value).all(axis=1) & (wi[:, 2] > 0) & (wo[:, 2] > 0)
    keep = np.flatnonzero(good)
    channels = tuple(str(c) for c in samples["channel"].values) if "channel" in samples.coords else ()
    channels = channels or tuple(str(c) for c in range(value.shape[1]))
    names = ("light", "row", "column")
    if "camera_matrix" not in samples or not all(n in samples.coords for n in names):
        return _plain(samples, _Raw(wi, wo, value, error, error, keep, channels), footprint)
    return _pictured(samples, _Raw(wi, wo, value, error, error, keep, channels), footprint)


def _stated(error: FloatArray) -> bool:
    """Whether nine samples of ten have a standard error; the rest is then not judged."""
    return error.size > 0 and bool(np.mean(np.isfinite(error) & (error > 0)) > 0.9)


def _plain(samples: xr.Dataset, raw: _Raw, footprint: Footprint) -> Packed:
    """Samples that are no pixels: points at their directions."""
    keep = raw.keep
    wi, wo = raw.wi[keep], raw.wo[keep]
    half = half_angles(wi, wo)
    at = Cosines(np.ascontiguousarray(wi[:, 2]), np.ascontiguousarray(wo[:, 2]), np.einsum("ni,ni->n", wi, wo))
    light = samples["light"].values[keep] if "light" in samples.coords else np.zeros(keep.size, dtype=np.intp)
    # Neighbouring directions share what is wrong with them: cells of about 4° stand in for patches of a picture.
    cell = np.stack([np.floor(np.degrees(a) / 4) for a in (half.theta_h, half.theta_d, np.abs(half.phi_d))], -1)
    tile = np.unique(np.column_stack([light, cell]), axis=0, return_inverse=True)[1].ravel() if keep.size else light
    notes = (
        ("the samples carry no camera: the model is taken at their directions, not over pixels",) if footprint else ()
    )
    found = None if _stated(raw.error[keep]) else of_repeats(wi, wo, raw.value[keep] * at.i[:, None])
    known = raw.error[keep] if found is None else found[0] / at.i[:, None]
    return Packed(
        value=raw.value[keep],
        error=raw.error[keep],
        noise=known,
        noise_from=REPEATS if found else STATED if _stated(known) else UNKNOWN,
        noise_dof=found[1] if found else np.inf,
        cos_i=at.i,
        pixels=np.ones(keep.size),
        at=at,
        weight=np.ones(keep.size),
        first=np.arange(keep.size),
        light=light.astype(np.intp),
        tile=tile.astype(np.intp),
        theta_h=half.theta_h,
        theta_d=half.theta_d,
        phi_h=half.phi_h,
        channels=raw.channels,
        dropped=len(raw.value) - keep.size,
        notes=notes,
    )


def _pictured(samples: xr.Dataset, raw: _Raw, footprint: Footprint) -> Packed:
    """Pixels of a sphere, light by light."""
    camera, lights, sphere = rig_of(samples)
    light_of, row, column = (samples[n].values.astype(np.intp) for n in ("light", "row", "column"))
    known = samples.attrs.get("radius_px")
    radius = float(np.sqrt(len(np.unique(row * camera.width + column)) / np.pi) if known is None else known)
    angles = [samples[n].values for n in ("theta_h", "theta_d")] if "theta_d" in samples.coords else None
    parts: list[Packed] = []
    worth = 0.0
    stated = _stated(raw.error[raw.keep])
    raw = raw if stated else raw._replace(noise=np.full(raw.error.shape, np.nan))
    for number in np.unique(light_of[raw.keep]):
        mine = raw.keep[light_of[raw.keep] == number]
        # A data set of one light keeps the light's number, but its rig holds that light alone.
        light = lights[0] if len(lights) == 1 else lights[int(number)]
        found = half_angles(raw.wi[mine], raw.wo[mine])[:2] if angles is None else (a[mine] for a in angles)
        theta_h, theta_d = found
        phi_h = np.arctan2(*(raw.wi[mine, k] + raw.wo[mine, k] for k in (1, 0)))
        cos_i, cos_o = raw.wi[mine, 2], raw.wo[mine, 2]
        received = cos_i * _scale(light, sphere, cos_i)
        lit = _Lit(int(number), light, mine, cos_i, received, theta_h, theta_d, phi_h)
        if not stated:
            read = of_neighbours(row[mine], column[mine], raw.value[mine] * received[:, None])
            if read is not None:
                worth += read[1]
                raw.noise[mine] = read[0] / received[:, None]
        squares = (
            blocks.plan(row[mine], column[mine], theta_h, cos_i, cos_o, radius)
            if footprint == "auto"
            else blocks.single_pixels(row[mine], column[mine])
        )
        parts += [_squares(raw, lit, square, (camera, sphere), footprint) for square in squares]
    packed = _joined(parts) if parts else _plain(samples, raw, None)
    solid = np.asarray(samples["source_solid_angle"].values) if "source_solid_angle" in samples.coords else np.zeros(1)
    if not stated:
        known = NEIGHBOURS if _stated(packed.noise) else UNKNOWN
        packed = replace(packed, noise_from=known, noise_dof=worth or np.inf)
    return replace(
        packed,
        dropped=len(raw.value) - raw.keep.size,
        footprint=in_words(footprint),
        source_rad=float(np.sqrt(max(np.nanmax(solid, initial=0.0), 0.0) / np.pi)),
        source_known=samples.attrs.get("lamp_size") != "not given",
        radius_px=radius,
    )


def _squares(raw: _Raw, lit: _Lit, square: blocks.Square, rig: tuple[Camera, Sphere], footprint: Footprint) -> Packed:
    """The squares of one size of one light, a sample each."""
    share = lit.received[square.members]
    total = share.sum(axis=1)
    share = share / total[:, None]
    members = lit.pixels[square.members]
    if footprint is None:
        first = members[:, 0]
        io = np.einsum("ni,ni->n", raw.wi[first], raw.wo[first])[:, None]
        points = blocks.Points(raw.wi[first, 2:], raw.wo[first, 2:], io, np.ones_like(io))
    else:
        rule = blocks.gauss(square.order) if footprint == "auto" else blocks.midpoints(int(footprint))
        points = blocks.see_points(*rig, lit.light, square, total, rule)
    n, k = points.weight.shape
    middle = 0.5 * (square.side - 1)
    tile = (square.row + middle) // TILE * 65536 + (square.column + middle) // TILE
    return Packed(
        value=np.einsum("nk,nkc->nc", share, raw.value[members]),
        error=np.sqrt(np.einsum("nk,nkc->nc", share**2, raw.error[members] ** 2)),
        noise=np.sqrt(np.einsum("nk,nkc->nc", share**2, raw.noise[members] ** 2)),
        cos_i=lit.cos_i[square.members].mean(axis=1),
        pixels=np.full(n, float(square.side**2)),
        at=Cosines(points.cos_i.ravel(), points.cos_o.ravel(), points.cos_io.ravel()),
        weight=points.weight.ravel(),
        first=np.arange(n) * k,
        light=np.full(n, lit.number, dtype=np.intp),
        tile=(lit.number << 40) + tile.astype(np.intp),
        theta_h=lit.theta_h[square.members].mean(axis=1),
        theta_d=lit.theta_d[square.members].mean(axis=1),
        phi_h=lit.phi_h[square.members[:, 0]],
        channels=raw.channels,
    )


def _scale(light: Light, sphere: Sphere, cos_i: FloatArray) -> FloatArray | float:
    """Irradiance over intensity at points of a sphere whose light stands at cos_i: 1, or 1/distance²."""
    if light.position_mm is None:
        return 1.0
    radius, away = sphere.radius_mm, float(np.linalg.norm(light.position_mm - sphere.centre_mm))
    along = radius * cos_i
    # The cosine rule in the triangle of centre, point and light.
    return np.asarray((np.sqrt(along**2 + away**2 - radius**2) - along) ** -2.0)


def in_words(footprint: Footprint) -> str:
    """How pixels are integrated."""
    if footprint is None:
        return "pixel centres"
    if footprint == "auto":
        return "pixels in squares of 1 to 8 a side where nothing varies fast, 2 x 2 or 4 x 4 Gauss points each"
    return f"{footprint} x {footprint} midpoints in each pixel"


def _joined(parts: list[Packed]) -> Packed:
    if len({p.channels for p in parts}) > 1:
        raise InputError.of("samples", [p.channels for p in parts[:3]], "have different channels", "Use one rig.")
    sizes = np.cumsum([0] + [p.weight.size for p in parts[:-1]])
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in (*ROWS, "weight")}
    sources = {p.noise_from for p in parts}
    return Packed(
        at=Cosines(*(np.concatenate([p.at[k] for p in parts]) for k in range(3))),
        first=np.concatenate([p.first + s for p, s in zip(parts, sizes, strict=True)]),
        channels=parts[0].channels,
        noise_from=parts[0].noise_from if len(sources) == 1 else UNKNOWN,
        noise_dof=sum(p.noise_dof for p in parts),
        source_rad=max(p.source_rad for p in parts),
        source_known=all(p.source_known for p in parts),
        radius_px=min(p.radius_px for p in parts),
        footprint=parts[0].footprint,
        dropped=sum(p.dropped for p in parts),
        notes=tuple(dict.fromkeys(n for p in parts for n in p.notes)),
        **joined,
    )
