"""Lens distortion on the plane z = 1, by OpenCV's model: radial, rational, tangential, thin prism, tilted sensor."""

import numpy as np
import numpy.typing as npt

from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]

LENGTHS = (0, 4, 5, 8, 12, 14)
"""How many coefficients OpenCV's models have."""

CLOSE = 1e-9
"""Largest distance on the plane z = 1 between a point and its undistorted image distorted again."""


def distorted(plane: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Where a lens puts points (..., 2) of the plane z = 1 (OpenCV, calib3d, camera model)."""
    if not np.any(coefficients):
        return plane
    import cv2

    flat = plane.reshape(-1, 2)
    known = np.isfinite(flat).all(axis=-1)
    points = np.concatenate([flat[known], np.ones((int(known.sum()), 1))], axis=-1)
    out = np.full_like(flat, np.nan)
    if len(points):
        still = np.zeros(3)
        out[known] = cv2.projectPoints(points, still, still, np.eye(3), coefficients)[0].reshape(-1, 2)
    return out.reshape(plane.shape)


def undistorted(plane: FloatArray, coefficients: FloatArray) -> FloatArray:
    """The points (..., 2) of the plane z = 1 that a lens puts at `plane`: the inverse of `distorted`.

    Raises
    ------
    InputError
        OpenCV's iteration does not come back to the point: the distortion folds over there, or is too strong.
    """
    if not np.any(coefficients) or plane.size == 0:
        return plane
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    flat = np.ascontiguousarray(plane.reshape(-1, 1, 2))
    found = cv2.undistortPoints(flat, np.eye(3), coefficients, None, None, None, stop).reshape(plane.shape)
    off = np.abs(distorted(found, coefficients) - plane)
    if not np.all(off <= CLOSE):
        raise InputError.of(
            "camera.distortion",
            np.round(coefficients, 6).tolist(),
            f"cannot be inverted at {int(np.sum(~(off <= CLOSE).all(axis=-1)))} of the pixels asked for",
            "Crop the image to where the calibration holds, or calibrate with fewer coefficients.",
        )
    return np.asarray(found, dtype=np.float64)
