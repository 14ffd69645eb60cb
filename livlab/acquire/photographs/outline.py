"""Outline of a sphere in a picture: seeds, and edge points where the brightness is half way between both sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STEP_PX = 0.25
"""Step at which a profile across the edge is sampled."""

_SIDE_PX = (1.5, 3.5)
"""Stretch on either side of the edge whose mean is the level of that side: past the lens's blur, near the edge."""


def grey(image: NDArray[np.floating] | NDArray[np.integer]) -> FloatArray:
    """Mean over the channels, as float64; NaN stays NaN.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels) array
        Linear radiance.
    """
    array = np.asarray(image)
    return np.asarray(array.mean(axis=2, dtype=np.float64) if array.ndim == 3 else array, dtype=np.float64)


def thinned(image: FloatArray, most: int = 250_000) -> FloatArray:
    """Every n-th row and column, so that statistics of a large picture cost no more than of a small one."""
    step = max(int(np.ceil(np.sqrt(image.size / most))), 1)
    return image[::step, ::step]


def circle_path(u: float, v: float, radius: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Points (count, 2) on a circle in the picture, and the outward normals there."""
    phi = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    normals = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    return np.array([u, v]) + radius * normals, normals


def half_maximum_points(
    image: FloatArray, path: FloatArray, normals: FloatArray, reach_px: float
) -> tuple[FloatArray, FloatArray]:
    """Edge points near a path: where profiles across it pass the mean of the levels on their two sides.

    The place of the steepest step of a slightly smoothed profile is found first; the levels are the means over
    1.5 to 3.5 px on either side of it, and the point is the crossing of their mean nearest to the step.

    Parameters
    ----------
    image : (rows, columns) array
        NaN where a pixel is not usable.
    path, normals : (n, 2) arrays
        Points (u, v) and outward unit normals.
    reach_px : float
        How far from the path an edge is looked for.

    Returns
    -------
    points : (n, 2) array
        Edge points; NaN where the profile leaves the picture, meets a NaN, or has no step.
    contrast : (n,) array
        Level inside minus level outside; NaN likewise.
    """
    from scipy import ndimage

    half = reach_px + _SIDE_PX[1] + 1.0
    s = np.arange(-half, half + STEP_PX / 2, STEP_PX)
    places = path[:, None, :] + s[None, :, None] * normals[:, None, :]
    profile = ndimage.map_coordinates(
        image, [places[..., 1], places[..., 0]], order=1, mode="constant", cval=np.nan, prefilter=False
    )
    # Compressed, since a highlight inside has larger steps than a dim limb, but no steeper ratios.
    low, high = np.nanpercentile(thinned(image), [0.5, 99.5])
    ground = 0.01 * (high - low) or 1.0
    smooth = np.log(np.clip(profile - low, 0, None) + ground)
    smooth = ndimage.gaussian_filter1d(smooth, 1.0 / STEP_PX, axis=1, mode="nearest")
    slope = np.abs(np.gradient(smooth, STEP_PX, axis=1))
    slope[:, np.abs(s) > reach_px] = -1.0
    slope[np.isnan(slope)] = -1.0
    row = np.arange(len(path))
    step = np.argmax(slope, axis=1)
    found = slope[row, step] > 0
    near, far = (round(x / STEP_PX) for x in _SIDE_PX)
    offsets = np.arange(near, far + 1)
    last = len(s) - 1
    inside = profile[row[:, None], np.clip(step[:, None] - offsets, 0, last)].mean(axis=1)
    outside = profile[row[:, None], np.clip(step[:, None] + offsets, 0, last)].mean(axis=1)
    relative = profile - 0.5 * (inside + outside)[:, None]
    # A crossing lies between two samples of unlike sign; of several, the one nearest to the step counts.
    crossing = relative[:, :-1] * relative[:, 1:] <= 0
    crossing &= relative[:, :-1] != relative[:, 1:]
    apart = np.where(crossing, np.abs(np.arange(last)[None, :] - step[:, None] + 0.5), np.inf)
    k = np.argmin(apart, axis=1)
    found &= apart[row, k] * STEP_PX < _SIDE_PX[0]
    a, b = relative[row, k], relative[row, k + 1]
    at = s[k] + STEP_PX * np.divide(a, a - b, out=np.zeros_like(a), where=found & (a != b))
    points = path + at[:, None] * normals
    contrast = inside - outside
    found &= np.isfinite(contrast)
    points[~found] = np.nan
    contrast[~found] = np.nan
    return points, contrast


def seeds(image: FloatArray, most: int = 8) -> list[tuple[float, float, float]]:
    """Circles (u, v, radius) from which a search for the outline may start, likeliest first; not measurements.

    Hough's transform on a reduced 8-bit copy finds what is round, Otsu's threshold finds what stands out.
    """
    part = thinned(image)
    usable = part[np.isfinite(part)]
    if usable.size == 0 or np.ptp(usable) == 0:
        return []
    found: list[tuple[float, float, float]] = []
    low = float(np.percentile(usable, 0.5))
    scale = min(1.0, 400.0 / max(image.shape))
    # The brightest may be highlights that leave the limb in the dark: a second look cuts them off.
    for share in (99.5, 85.0):
        high = float(np.percentile(usable, share))
        if high <= low:
            high = float(usable.max())
        found += _round_things(np.clip((np.nan_to_num(image, nan=low) - low) / (high - low), 0.0, 1.0), scale, most)
    kept: list[tuple[float, float, float]] = []
    for u, v, r in found:
        u, v, r = (u + 0.5) / scale - 0.5, (v + 0.5) / scale - 0.5, r / scale  # noqa: PLW2901
        if all(np.hypot(u - a, v - b) + abs(r - c) > 0.08 * r for a, b, c in kept):
            kept.append((u, v, r))
    return kept[: 3 * most]


def _round_things(scaled: FloatArray, scale: float, most: int) -> list[tuple[float, float, float]]:
    import cv2

    eight = np.round(255 * np.sqrt(scaled)).astype(np.uint8)  # the square root lifts a dim limb
    if scale < 1:
        size = (max(1, round(eight.shape[1] * scale)), max(1, round(eight.shape[0] * scale)))
        eight = cv2.resize(eight, size, interpolation=cv2.INTER_AREA)
    eight = cv2.medianBlur(eight, 3)
    smallest, largest = 0.04 * min(eight.shape), 0.75 * max(eight.shape)
    found = _blobs(eight, smallest)
    for threshold in (40, 20):
        circles = cv2.HoughCircles(
            eight,
            method=cv2.HOUGH_GRADIENT,
            dp=1,
            minDist=8,
            param1=120,
            param2=threshold,
            minRadius=int(max(4, smallest)),
            maxRadius=int(largest),
        )
        if circles is not None:
            for circle in circles.reshape(-1, circles.shape[-1])[:most]:
                found.append((float(circle[0]), float(circle[1]), float(circle[2])))
    return found


def _blobs(eight: NDArray[np.uint8], smallest: float) -> list[tuple[float, float, float]]:
    import cv2

    found = []
    for kind in (cv2.THRESH_BINARY, cv2.THRESH_BINARY_INV):
        _, mask = cv2.threshold(eight, 0, 255, kind | cv2.THRESH_OTSU)
        count, _, boxes, centres = cv2.connectedComponentsWithStats(mask)
        for k in range(1, count):
            _, _, width, height, area = (int(x) for x in boxes[k])
            if area > np.pi * smallest**2 and max(width, height) < max(eight.shape):
                found.append((area, (float(centres[k][0]), float(centres[k][1]), float(np.sqrt(area / np.pi)))))
    return [seed for _, seed in sorted(found, reverse=True)[:4]]
