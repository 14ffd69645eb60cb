"""What photographs say against what was declared about them: sizes, turned pictures, where the lights are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.brdf.geometry import Camera, Light, Sphere

RADII_MM = (0.5, 1000.0)
"""Radii between which a ball is likely to have been photographed; beyond, units are likely to be wrong."""

APART = 1.5
"""Ratio of the distances of a mirror ball and of the sphere, above which one radius is likely to be wrong."""

ELSEWHERE = float(np.deg2rad(30.0))
"""Angle by which shading may miss a light before it is told; roughness and gloss turn it by less than 20 degrees."""

_FITS = float(np.deg2rad(20.0))

_FRAMES = {
    'the other frame (frame = "photometric-stereo" or "camera")': np.array([1.0, -1.0, -1.0]),
    "up and down exchanged": np.array([1.0, -1.0, 1.0]),
    "left and right exchanged": np.array([-1.0, 1.0, 1.0]),
    "directions that lead from the light to the sphere": np.array([-1.0, -1.0, -1.0]),
}
"""Signs of x, y and z that a slip changes."""


def turned(names: Sequence[str]) -> list[str]:
    """The warning about pictures that are to be turned for viewing."""
    if not names:
        return []
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return [
        f"{names[0]}{more}: EXIF says that viewers shall turn or flip it. It is taken as the sensor stored it, so "
        "directions, boxes and masks must be, too; if they are not, save all pictures upright."
    ]


def sizes(radius_mm: float, centre_mm: FloatArray, mirrors: Iterable[FloatArray], *, orthographic: bool) -> list[str]:
    """Warnings about a sphere and mirror balls whose sizes cannot well be what was said."""
    found = []
    low, high = RADII_MM
    if not low <= radius_mm <= high:
        found.append(
            f"sphere.radius_mm = {radius_mm:g}: a ball's radius is between {low:g} and {high:g} mm. "
            "Say it in millimetres."
        )
    if orthographic:
        return found
    far = float(np.linalg.norm(centre_mm))
    for k, centre in enumerate(mirrors):
        ball = float(np.linalg.norm(centre))
        if max(ball / far, far / ball) > APART:
            found.append(
                f"mirror[{k}].radius_mm: that ball comes out {ball:.4g} mm from the camera, the sphere {far:.4g} mm. "
                "One radius may be a diameter or in another unit."
            )
    return found


def seen_direction(normals: FloatArray, values: NDArray[np.floating]) -> FloatArray | None:
    """Where a sphere looks lit from: the direction whose cosine its lit part follows best; None without a lit part.

    Parameters
    ----------
    normals : (n, 3) array
        Of pixels in view, world frame.
    values : (n,) array
        Their radiance; NaN where not usable, as in a clipped highlight.
    """
    known = np.isfinite(values)
    if known.sum() < 100:
        return None
    level = np.clip(values, None, float(np.quantile(values[known], 0.8)))
    lit = known & (level > 0.3 * float(level[known].max()))
    found, *_ = np.linalg.lstsq(normals[lit], level[lit], rcond=None)
    # Least absolute deviations from there: a highlight would pull the direction half way to the camera.
    for _ in range(15):
        off = np.abs(level[lit] - normals[lit] @ found)
        weight = 1 / np.sqrt(np.maximum(off, 1e-3 * float(level[lit].max()) + 1e-300))
        found, *_ = np.linalg.lstsq(normals[lit] * weight[:, None], level[lit] * weight, rcond=None)
    length = float(np.linalg.norm(found))
    return np.asarray(found / length) if length > 0 else None


def directions(lights: Sequence[Light], camera: Camera, sphere: Sphere, seen: Sequence[FloatArray | None]) -> list[str]:
    """The warning about lights that the shading contradicts, with the slip that explains it where one does.

    Parameters
    ----------
    lights, camera, sphere
        As they were declared.
    seen
        `seen_direction` of each light's picture.
    """
    kept = [k for k, s in enumerate(seen) if s is not None]
    if not kept:
        return []
    shading = np.array([seen[k] for k in kept])
    given = np.array([lights[k].at(sphere.centre_mm)[0] for k in kept])
    eye = camera.rotation.T @ (0 * sphere.centre_mm - camera.translation) - sphere.centre_mm
    eye = -camera.rotation[2] if camera.orthographic else eye / np.linalg.norm(eye)
    apart = _apart(given, shading, eye)
    off = np.diagonal(apart)
    wrong = np.flatnonzero(off > ELSEWHERE)
    if not wrong.size:
        return []
    worst = int(np.argmax(off))
    text = (
        f"{len(wrong)} of {len(kept)} pictures look lit from elsewhere than their lights' directions say "
        f"(light {kept[worst]} by {np.rad2deg(off[worst]):.0f} degrees)"
    )
    return [f"{text}: {_why(given, shading, eye, apart, wrong, kept)}"]


def _why(
    given: FloatArray,
    shading: FloatArray,
    eye: FloatArray,
    apart: FloatArray,
    wrong: NDArray[np.intp],
    kept: Sequence[int],
) -> str:
    from scipy.optimize import linear_sum_assignment

    flipped = {words: np.diagonal(_apart(given * signs, shading, eye)) for words, signs in _FRAMES.items()}
    best = min(flipped, key=lambda words: float(flipped[words].mean()))
    if np.median(flipped[best]) < _FITS:
        return f"they fit with {best}."
    if 2 * len(wrong) < len(kept) and len(wrong) < 3:
        return f"check the entries of light {' and '.join(str(kept[k]) for k in wrong)}."
    rows, columns = linear_sum_assignment(apart)
    if np.median(apart[rows, columns]) < _FITS and not np.array_equal(rows, columns):
        moved = [k for k in range(len(kept)) if columns[k] != k]
        shown = ", ".join(f"the direction of light {kept[k]} fits picture {kept[columns[k]]}" for k in moved[:3])
        return f"they are in another order: {shown}{', …' if len(moved) > 3 else ''}."
    return "check the frame, signs, units and order of the directions."


def _apart(given: FloatArray, shading: FloatArray, eye: FloatArray) -> FloatArray:
    """Angle (light, picture); to the half vector where that is nearer, since a metal shines there."""
    half = given + eye
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
    # A light from behind shows a crescent, whose shading leads no further than to the limb.
    return np.asarray(np.arccos(np.clip(np.maximum(given @ shading.T, half @ shading.T), -1.0, 1.0)))
