"""What photographs say against what was declared about them: sizes, turned pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from livlab.acquire.photographs.outline import FloatArray

RADII_MM = (0.5, 1000.0)
"""Radii between which a ball is likely to have been photographed; beyond, units are likely to be wrong."""

APART = 1.5
"""Ratio of the distances of a mirror ball and of the sphere, above which one radius is likely to be wrong."""


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
