"""What JPEG took from a picture: the variance of its errors, from the file's own quantisation tables.

A block of 8 x 8 is kept as DCT coefficients in whole steps q. Of a coefficient that is not 0 the error is even over a
step, q²/12. Of one that became 0 it is the coefficient itself: less than q/2, and how much less shows in how often that
coefficient is not 0 in other blocks, if coefficients follow Laplace's distribution (Lam & Goodman 2000). The DCT is
orthonormal, so the mean over a block's coefficients is the mean over its pixels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray

SIDE = 8

_CB = (0.0, -0.344136, 1.772)
_CR = (1.402, -0.714136, 0.0)
"""Red, green and blue per step of the two chroma channels (JFIF 1.02)."""


def jpeg_variance(image: Any, values: NDArray[np.uint8]) -> FloatArray | None:
    """Variance of the stored values by block (rows / 8, columns / 8, channels), steps²; None if no table is known.

    Parameters
    ----------
    image
        Pillow's open picture, which holds the tables.
    values
        (rows, columns, 1 or 3) what it decoded to.
    """
    tables: Mapping[int, Sequence[int]] | None = getattr(image, "quantization", None)
    layers: Sequence[tuple[Any, ...]] = getattr(image, "layer", [])
    if not tables or not layers:
        return None
    steps = [np.asarray(tables[min(layer[3], max(tables))], dtype=np.float64).reshape(SIDE, SIDE) for layer in layers]
    x = values.astype(np.float64)
    if values.shape[2] == 1 or len(steps) == 1:
        return np.repeat(_of_plane(x[..., 0], steps[0], 1, 1)[..., None], values.shape[2], axis=2)
    luma = x @ [0.299, 0.587, 0.114]
    tall, wide = (max(layer[k] for layer in layers) for k in (2, 1))
    shape = (-(-x.shape[0] // SIDE), -(-x.shape[1] // SIDE))
    out = np.zeros((*shape, 3)) + _of_plane(luma, steps[0], 1, 1)[..., None]
    chroma = (0.564334 * (x[..., 2] - luma), 0.713267 * (x[..., 0] - luma))
    for plane, step, layer, share in zip(chroma, steps[1:], layers[1:], (_CB, _CR), strict=False):
        by = _of_plane(plane, step, tall // layer[2], wide // layer[1])
        out += by[: shape[0], : shape[1], None] * np.square(share)
    return out


def _of_plane(plane: FloatArray, step: FloatArray, tall: int, wide: int) -> FloatArray:
    """Variance of a plane that was kept once for `tall` x `wide` pixels, for each block of 8 x 8 pixels."""
    rows, columns = plane.shape
    small = np.pad(plane, ((0, -rows % (SIDE * tall)), (0, -columns % (SIDE * wide))), mode="edge")
    whole = small
    small = small.reshape(small.shape[0] // tall, tall, small.shape[1] // wide, wide).mean(axis=(1, 3))
    variance = _blocks(small, step)
    variance = np.repeat(np.repeat(variance, tall, axis=0), wide, axis=1)
    if tall * wide > 1:
        # What the mean over several pixels lost, as far as what is left still shows it.
        again = np.repeat(np.repeat(small, tall, axis=0), wide, axis=1)
        lost = (whole - again) ** 2
        variance = variance + lost.reshape(len(lost) // SIDE, SIDE, -1, SIDE).mean(axis=(1, 3))
    return variance[: -(-rows // SIDE), : -(-columns // SIDE)]


def _blocks(plane: FloatArray, step: FloatArray) -> FloatArray:
    from scipy.fft import dctn

    blocks = (plane - 128.0).reshape(plane.shape[0] // SIDE, SIDE, plane.shape[1] // SIDE, SIDE).transpose(0, 2, 1, 3)
    kept = np.abs(np.round(dctn(blocks, axes=(2, 3), norm="ortho") / step)) > 0
    # Blocks without anything but their mean lie off the sphere and say nothing of it.
    busy = kept.reshape(*kept.shape[:2], -1)[..., 1:].any(axis=-1)
    share = kept[busy].mean(axis=0) if busy.any() else np.zeros((SIDE, SIDE))
    count = max(int(busy.sum()), 1)
    zeroed = _zeroed(np.clip(share, 0.5 / count, 1 - 1e-9), step)
    each = np.where(kept, step**2 / 12, np.where(busy[..., None, None], zeroed, 0.0))
    return np.asarray(each.mean(axis=(2, 3)))


def _zeroed(share: FloatArray, step: FloatArray) -> FloatArray:
    """Mean square of a Laplace variable below q/2 in size, of which `share` lies above."""
    bound = step / 2
    scale = bound / -np.log(share)
    x = bound / scale
    inside = 1 - np.exp(-x)
    moment = scale**2 * (2 - np.exp(-x) * (x**2 + 2 * x + 2)) / np.maximum(inside, 1e-12)
    return np.minimum(moment, bound**2 / 3)
