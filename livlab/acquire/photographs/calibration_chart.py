"""From a camera's own colours to linear sRGB, by a picture of a colour chart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.errors import InputError

PATCHES = 24


@dataclass(frozen=True, eq=False)
class ColourCalibration:
    """A colour chart as one camera saw it.

    Attributes
    ----------
    matrix
        (3, 3): linear sRGB = matrix · linear camera values, neutral patches kept at their reflectance.
    patches
        (24, 3) linear camera values of the patches.
    reference
        (24, 3) linear sRGB that they should have.
    residual
        Root mean square difference over patches and channels after the correction, white = 1.
    residual_before
        The same with a single scale for all channels instead of the matrix.
    box
        (4, 2) corners of the chart in the picture.
    """

    matrix: FloatArray
    patches: FloatArray
    reference: FloatArray
    residual: float
    residual_before: float
    box: FloatArray


def calibrate_colour(picture: NDArray[np.floating], name: str = "chart") -> ColourCalibration:
    """Find a 24-patch chart and fit the colour matrix (linear least squares in linear RGB, by OpenCV).

    Parameters
    ----------
    picture : (rows, columns, 3) array
        Linear values, evenly lit.
    name : str
        What messages call it.

    Raises
    ------
    InputError
        Not RGB, no chart in it, or patches that are clipped or black.
    """
    import cv2

    linear = np.asarray(picture, dtype=np.float64)
    if linear.ndim != 3 or linear.shape[2] != 3:
        raise InputError.of(name, linear.shape, "must be an RGB picture", "Give the chart in colour.")
    top = float(np.nanpercentile(linear, 99.8))
    if not top > 0:
        raise InputError.of(name, "black", "shows nothing", "Light the chart.")
    # The detector knows the chart as pictures show it: encoded, 8 bits, blue first.
    shown = np.clip(np.nan_to_num(linear) / top, 0, 1) ** (1 / 2.2)
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    found = detector.process(np.ascontiguousarray((255 * shown[..., ::-1]).round().astype(np.uint8)), 1)
    charts = detector.getListColorChecker() if found else ()
    if not charts:
        raise InputError.of(
            name,
            f"{linear.shape[1]}x{linear.shape[0]} px",
            "shows no colour chart of 24 patches that can be found",
            "Take it flat, evenly lit, sharp, unrotated by more than 20 degrees, and a quarter of the frame at least.",
        )
    patches = np.array([_patch(linear, quad) for quad in np.reshape(charts[0].getColorCharts(), (PATCHES, 4, 2))])
    if not np.all(np.isfinite(patches)) or np.any(patches.max(axis=1) <= 0):
        raise InputError.of(name, "a patch is black or not finite", "must be exposed", "Expose the chart longer.")
    white = patches[18]
    if float(np.ptp(patches[18:24].mean(axis=1))) < 0.2 * float(white.mean()):
        raise InputError.of(name, "its grey row has one level", "is clipped or no chart", "Expose the chart shorter.")
    scale = 0.9 / float(white[1])
    model = cv2.ccm.ColorCorrectionModel((patches * scale).reshape(PATCHES, 1, 3), cv2.ccm.COLORCHECKER_MACBETH)
    model.setColorSpace(cv2.ccm.COLOR_SPACE_SRGB)
    model.setCcmType(cv2.ccm.CCM_LINEAR)
    model.setDistance(cv2.ccm.DISTANCE_RGBL)
    model.setLinearization(cv2.ccm.LINEARIZATION_IDENTITY)
    model.compute()
    # OpenCV multiplies rows from the left.
    matrix = np.asarray(model.getColorCorrectionMatrix(), dtype=np.float64).T * scale
    reference = np.asarray(model.getRefLinearRGB(), dtype=np.float64).reshape(PATCHES, 3)
    one = float(np.sum(patches * reference) / np.sum(patches**2))
    return ColourCalibration(
        matrix,
        patches,
        reference,
        float(np.sqrt(np.mean((patches @ matrix.T - reference) ** 2))),
        float(np.sqrt(np.mean((one * patches - reference) ** 2))),
        np.asarray(charts[0].getBox(), dtype=np.float64),
    )


def _patch(picture: FloatArray, quad: FloatArray) -> FloatArray:
    import cv2

    inside = np.zeros(picture.shape[:2], dtype=np.uint8)
    cv2.fillConvexPoly(inside, np.round(quad).astype(np.int32), 1)
    return np.asarray(np.median(picture[inside > 0], axis=0))
