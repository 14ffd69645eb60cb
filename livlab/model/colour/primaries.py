"""sRGB's primaries and white, the matrix that follows from them, and CIELAB of linear sRGB: the only door to it."""

from __future__ import annotations

import numpy as np

from livlab.units import FloatArray

SRGB_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x, y of red, green, blue and white (IEC 61966-2-1, ITU-R BT.709)."""


def primary_matrix(chromaticities: tuple[float, ...]) -> FloatArray:
    """(3, 3) from linear RGB to XYZ with white's Y = 1 (SMPTE RP 177-1993).

    Its columns are the primaries' XYZ, scaled so that they add up to white.

    Parameters
    ----------
    chromaticities
        x, y of red, green, blue and white.
    """
    xy = np.asarray(chromaticities, dtype=np.float64).reshape(4, 2)
    xyz = np.stack([xy[:, 0], xy[:, 1], 1.0 - xy.sum(axis=1)]) / xy[:, 1]
    return np.asarray(xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3]))


SRGB_TO_XYZ = primary_matrix(SRGB_CHROMATICITIES)
"""Not rounded to four digits as IEC 61966-2-1 prints it: white then is exactly white."""

LUMINANCE = tuple(float(x) for x in SRGB_TO_XYZ[1])
"""Share of R, G and B in luminance."""


def lab(linear: FloatArray) -> FloatArray:
    """(…, 3) CIELAB (CIE 015:2018, 8.2.1) of (…, 3) linear sRGB, white (1, 1, 1) being its white; not clipped.

    Examples
    --------
    >>> lab(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])).round(9) + 0.0
    array([[100.,   0.,   0.],
           [  0.,   0.,   0.]])
    """
    ratio = np.asarray(linear, dtype=np.float64) @ (SRGB_TO_XYZ / SRGB_TO_XYZ.sum(axis=1, keepdims=True)).T
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(np.maximum(ratio, 0.0)), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)
