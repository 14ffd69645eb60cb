"""From stored photographs to linear radiance with its variance: dark and flat frames, and exposures merged by noise."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.calibration_chart import ColourCalibration
from livlab.acquire.photographs.linearity import CameraResponse
from livlab.acquire.photographs.lossy import mean_square
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.read import Photograph
from livlab.brdf.sphere import Noise
from livlab.errors import InputError

Float32Array = NDArray[np.float32]

SATURATION = 0.99
"""Share of full scale at and above which a stored value counts as clipped."""

_DISAGREE = 0.05
_LEAST_LEVEL = 0.03

CLIPPED = "values are clipped and left out."
CLIPPED_IN_ALL = "values clip in every exposure: the shortest is too long for the highlight."
NOT_FINITE = "values are NaN or infinite in the file and left out."

_BLOCK = 6_000_000
"""Values that are merged at a time: a large photograph takes several times its size in double precision."""


@dataclass(frozen=True, eq=False)
class Development:
    """What turns stored values into linear ones.

    Attributes
    ----------
    response
        Stored to linear.
    noise
        Variance of linear values (0 to 1), `read`² + `gain` · value; None where it is not known.
    dark
        Linear values (rows, columns, channels) with the lens covered, by relative exposure; None where there are none.
    flat
        What an evenly lit field gives, 1 in the middle; None where there is none.
    saturation
        Share of full scale at which values clip.
    float_scale
        Full scale of floating-point files: the value that counts as 1.
    """

    response: CameraResponse
    noise: Noise | None = None
    dark: tuple[tuple[float, Float32Array], ...] = ()
    flat: Float32Array | None = None
    saturation: float = SATURATION
    float_scale: float = 1.0

    def stored(self, photograph: Photograph) -> Float32Array:
        """Stored values as shares of full scale, NaN where the file has none."""
        if np.isfinite(photograph.full_scale):
            return np.asarray(photograph.values / np.float32(photograph.full_scale), dtype=np.float32)
        values = np.asarray(photograph.values / self.float_scale, dtype=np.float32)
        return np.where(np.isfinite(values), values, np.float32(np.nan))

    def quantum(self, photograph: Photograph) -> float:
        """Step of the stored values as a share of full scale; 0 of floating point."""
        return 1.0 / photograph.full_scale if np.isfinite(photograph.full_scale) else 0.0

    def stored_variance(self, photograph: Photograph, stored: Float32Array) -> NDArray[np.floating]:
        """Variance of the linear values by how they were stored: their step, (q f')² / 12, and lossy compression."""
        step = (self.quantum(photograph) * (photograph.response or self.response).slope(stored)) ** 2
        lossy = 0.0 if photograph.scatter is None else photograph.scatter.at(photograph.values)
        return np.asarray(step * (1 / 12 + lossy))

    def linear(
        self, photograph: Photograph, exposure: float, rows: slice | None = None
    ) -> tuple[Float32Array, Float32Array, NDArray[np.bool_]]:
        """Linear values, their variance (NaN where the noise is not known), and which are clipped, all (r, c, ch).

        `rows` says which rows of the dark and flat frames belong to a photograph that is a part of a larger one.
        """
        stored = self.stored(photograph)
        clipped = np.zeros(stored.shape, dtype=bool)
        if np.isfinite(photograph.full_scale):
            clipped = stored >= self.saturation
        answer = photograph.response or self.response
        value = np.asarray(answer.decode(stored), dtype=np.float32)
        if self.noise is None:
            variance = np.full(value.shape, np.nan, dtype=np.float32)
        else:
            noise = self.noise.read**2 + self.noise.gain * np.clip(value, 0, None)
            variance = np.asarray(noise + self.stored_variance(photograph, stored), dtype=np.float32)
        dark = self._dark(exposure, value.shape, rows)
        if dark is not None:
            value = value - dark
        if self.flat is not None:
            flat = _fitting("flat", self.flat, value.shape, rows)
            value, variance = value / flat, variance / flat**2
        return value, variance, clipped

    def _dark(self, exposure: float, shape: tuple[int, ...], rows: slice | None) -> Float32Array | None:
        if not self.dark:
            return None
        nearest = min(self.dark, key=lambda pair: abs(np.log(pair[0] / exposure)))[1]
        return _fitting("dark", nearest, shape, rows)


def _fitting(name: str, whole: Float32Array, shape: tuple[int, ...], rows: slice | None) -> Float32Array:
    frame = whole if rows is None else whole[rows]
    if frame.shape[:2] != shape[:2] or frame.shape[2] not in (1, shape[2]):
        raise InputError.of(
            f"{name} frame", whole.shape, "must have the size of the pictures", "Take it with the same camera."
        )
    return frame


@dataclass(frozen=True, eq=False)
class Merged:
    """One picture from its exposures.

    Attributes
    ----------
    value, variance
        (rows, columns, channels) linear radiance at exposure 1; NaN where no exposure holds it.
    clipped
        Share of the pixels that every exposure clips.
    not_finite
        Share that a file gave as NaN or infinite.
    agreement
        For each exposure the median ratio of its values to those of the next shorter one; NaN where none compare.
    remarks
        What a reader should know.
    counts
        The same of what was counted: how many, by what is said after the number.
    """

    value: Float32Array
    variance: Float32Array
    clipped: float
    not_finite: float
    agreement: tuple[float, ...]
    remarks: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """All that a reader should know of this picture."""
        return (*self.remarks, *(f"{count} {said}" for said, count in self.counts.items()))


def merge(photographs: Sequence[Photograph], exposures: Sequence[float], development: Development) -> Merged:
    """Merge exposures of one still scene, each weighted with the inverse of its variance; clipped values are left out.

    The estimate of x = value / exposure over exposures i is Σ t_i² x_i / v_i over Σ t_i² / v_i. The variance v_i is
    taken at the merged value and not at the noisy one, which would favour values that came out low.

    Parameters
    ----------
    photographs, exposures
        One or more pictures and their relative exposures.
    development
        Response, noise, dark and flat frames.

    Raises
    ------
    InputError
        No picture, exposures that are not > 0, or sizes that differ.
    """
    if not photographs or len(photographs) != len(exposures):
        counts = f"{len(photographs)} pictures, {len(exposures)} exposures"
        raise InputError.of("photographs", counts, "must be one exposure for each, one at least", "Mend the lists.")
    if not all(np.isfinite(t) and t > 0 for t in exposures):
        raise InputError.of("exposures", list(exposures), "must be > 0", "Give seconds, or any unit they share.")
    shapes = {p.values.shape for p in photographs}
    if len(shapes) > 1:
        names = ", ".join(f"{p.name} {p.values.shape[1]}x{p.values.shape[0]}" for p in photographs[:4])
        raise InputError.of("photographs", names, "must have one size", "Give all pictures uncropped.")
    first = photographs[0].values
    value = np.empty(first.shape, dtype=np.float32)
    variance = np.empty(first.shape, dtype=np.float32)
    clipped = lost = 0
    tall = max(_BLOCK // (first.shape[1] * first.shape[2]), 1)
    for start in range(0, first.shape[0], tall):
        rows = slice(start, start + tall)
        frames = [
            development.linear(replace(p, values=p.values[rows]), t, rows)
            for p, t in zip(photographs, exposures, strict=True)
        ]
        value[rows], variance[rows] = _weighted(frames, exposures, development.noise)
        clipped += int(np.all([c for _, _, c in frames], axis=0).sum())
        lost += int(np.all([~np.isfinite(x) for x, _, _ in frames], axis=0).sum())
    agreement, notes = _agreement(photographs, exposures, development)
    counted: dict[str, int] = {}
    if clipped:
        counted[CLIPPED if len(photographs) == 1 else CLIPPED_IN_ALL] = clipped
    if lost:
        counted[NOT_FINITE] = lost
    shares = clipped / first.size, lost / first.size
    return Merged(value, variance, *shares, agreement, tuple(notes), counted)


_Frame = tuple[Float32Array, Float32Array, NDArray[np.bool_]]


def _weighted(
    frames: Sequence[_Frame], exposures: Sequence[float], known: Noise | None
) -> tuple[Float32Array, Float32Array]:
    """Merged values and their variance."""
    good = [np.isfinite(x) & ~clipped for x, _, clipped in frames]
    if len(frames) == 1:
        one = np.float32(exposures[0])
        return np.where(good[0], frames[0][0] / one, np.float32(np.nan)), frames[0][1] / one**2
    noise = known or Noise(read=1e-3, gain=1e-4)  # weights alone: the variance stays unknown
    estimate: FloatArray | None = None
    weights = np.zeros(0)
    for _ in range(3):
        total = np.zeros(frames[0][0].shape)
        weights = np.zeros(frames[0][0].shape)
        for (x, told, _), t, use in zip(frames, exposures, good, strict=True):
            own = np.clip(np.nan_to_num(x), 0, None)
            at = own if estimate is None else np.clip(np.nan_to_num(estimate) * t, 0, None)
            variance: NDArray[np.floating] = noise.read**2 + noise.gain * at
            if known is not None:
                # Flat and quantisation as they were found, photon noise at the merged value.
                variance = variance + np.clip(np.nan_to_num(told - noise.read**2 - noise.gain * own), 0, None)
            w = np.where(use, t**2 / np.maximum(variance, 1e-30), 0.0)
            total += np.where(use, w * x / t, 0.0)
            weights += w
        with np.errstate(invalid="ignore", divide="ignore"):
            estimate = np.where(weights > 0, total / weights, np.nan)
    assert estimate is not None
    with np.errstate(divide="ignore"):
        spread = np.where(weights > 0, 1 / weights, np.nan) if known is not None else np.full(weights.shape, np.nan)
    return np.asarray(estimate, dtype=np.float32), np.asarray(spread, dtype=np.float32)


def _agreement(
    photographs: Sequence[Photograph], exposures: Sequence[float], development: Development
) -> tuple[tuple[float, ...], list[str]]:
    """Ratios of each exposure to the next shorter one, where both hold, on every n-th row."""
    shares = [float("nan")] * len(photographs)
    if len(photographs) == 1:
        return (1.0,), []
    rows = slice(None, None, max(photographs[0].values.size // _BLOCK, 1))
    frames = [
        development.linear(replace(p, values=p.values[rows]), t, rows)
        for p, t in zip(photographs, exposures, strict=True)
    ]
    for i, j in itertools.pairwise(np.argsort(exposures)):
        (x, _, clip_x), (y, _, clip_y) = frames[i], frames[j]
        both = ~clip_x & ~clip_y & (x > _LEAST_LEVEL) & np.isfinite(y)
        if both.sum() > 50:
            shares[j] = float(np.median(y[both] / exposures[j] / (x[both] / exposures[i])))
    off = [abs(s - 1) for s in shares if np.isfinite(s)]
    if not off or max(off) <= _DISAGREE:
        return tuple(shares), []
    shown = ", ".join(f"{s:.3f}" for s in shares if np.isfinite(s))
    return tuple(shares), [
        f"The exposures disagree (each over the next shorter one: {shown}): wrong exposure times, a light that "
        "flickers, movement, stray light, a dark offset or a wrong response."
    ]


def flat_field(
    photograph: Photograph, development: Development, exposure: float = 1.0, blur_px: float = 3.0
) -> FloatArray:
    """What the lens passes to each pixel, 1 in the middle, from a picture of an even white field (rows, columns, ch).

    Raises
    ------
    InputError
        It is clipped, not finite, or so dark at a corner that it is no flat field.
    """
    from scipy import ndimage

    value, _, clipped = development.linear(photograph, exposure)
    if clipped.any() or not np.isfinite(value).all():
        raise InputError.of(
            "flat", photograph.name, "is clipped or not finite", "Expose it to about half of full scale."
        )
    smooth = ndimage.gaussian_filter(value.astype(np.float64), (blur_px, blur_px, 0), mode="nearest")
    rows, columns = smooth.shape[:2]
    middle = smooth[
        rows * 9 // 20 : max(rows * 11 // 20, rows * 9 // 20 + 1),
        columns * 9 // 20 : max(columns * 11 // 20, columns * 9 // 20 + 1),
    ]
    flat = smooth / middle.mean(axis=(0, 1))
    if not np.all(flat > 0.05):
        raise InputError.of(
            "flat",
            f"{photograph.name}: {flat.min():.3g} of the middle",
            "falls below 5 %",
            "Picture an even white field.",
        )
    return np.asarray(flat)


def estimate_noise(value: NDArray[np.floating], stored: NDArray[np.floating] | float = 0.0) -> Noise | None:
    """Noise from one linear picture: differences of neighbours by level; texture and edges make it an upper bound.

    `stored` is the part of each value's variance that storing it makes, which is told beside and not again here.
    None where the picture is too small or does not vary.
    """
    x = np.asarray(value, dtype=np.float64)
    x = x if x.ndim == 3 else x[..., None]
    steps = np.broadcast_to(np.asarray(stored, dtype=np.float64), x.shape)[:, 1:-1]
    bend = (x[:, :-2] + x[:, 2:] - 2 * x[:, 1:-1]) / np.sqrt(6.0)
    level = (x[:, :-2] + x[:, 2:] + x[:, 1:-1]) / 3
    use = np.isfinite(bend) & np.isfinite(level)
    level, bend, steps = level[use], bend[use], steps[use]
    if level.size < 500:
        return None
    edges = np.quantile(level, np.linspace(0, 1, 21))
    points = []
    for low, high in itertools.pairwise(edges):
        here = (level >= low) & (level <= high)
        if here.sum() > 50:
            seen = mean_square(bend[here])
            points.append((float(level[here].mean()), max(seen - float(steps[here].mean()), 0.0)))
    at, variance = np.array(points).T
    from scipy import optimize

    scale = max(float(at.max()), 1e-12)
    (read2, gain), _ = optimize.nnls(np.column_stack([np.ones_like(at), np.clip(at, 0, None) / scale]), variance)
    if read2 + gain <= 0:
        return None
    return Noise(read=float(np.sqrt(read2)), gain=float(gain / scale))


def coloured(merged: Merged, colour: ColourCalibration | None, *, grey: bool) -> Merged:
    """A picture in a chart's colours, in grey, or as it is.

    Raises
    ------
    InputError
        A chart, and pictures that are not in RGB.
    """
    value, variance = merged.value, merged.variance
    if colour is not None:
        if value.shape[2] != 3:
            raise InputError.of("colour", value.shape, "needs pictures in RGB", "Leave the chart out.")
        value = np.asarray(value @ colour.matrix.T.astype(np.float32))
        variance = np.asarray(variance @ (colour.matrix.T**2).astype(np.float32))
    if grey:
        # Channels that are the same numbers err alike: a grey picture stored as RGB is one measurement, not three.
        alike = value.shape[2] > 1 and bool((value[..., :1] == value[..., 1:])[np.isfinite(value[..., 1:])].all())
        variance = variance.sum(axis=2, keepdims=True) / np.float32(value.shape[2] ** (1 if alike else 2))
        value = value.mean(axis=2, keepdims=True)
    return replace(merged, value=value, variance=variance)
