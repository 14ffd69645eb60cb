"""The camera from pictures of a board: intrinsics and lens, with residual and covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.brdf.geometry import Camera
from livlab.errors import InputError

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Order of a calibration's parameters and covariance."""


@dataclass(frozen=True)
class Board:
    """A plane board of squares.

    Attributes
    ----------
    kind
        "charuco" (markers in the white squares) or "chessboard".
    columns, rows
        Squares of a ChArUco board, inner corners of a chessboard.
    square_mm
        Side of a square.
    marker_mm
        Side of a ChArUco marker.
    dictionary
        OpenCV's name of the markers.
    """

    kind: Literal["charuco", "chessboard"]
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise InputError.of("board", (self.columns, self.rows), "must be 3 x 3 at least", "Count them again.")
        if not self.square_mm > 0:
            raise InputError.of("board.square_mm", self.square_mm, "must be > 0", "Measure a square.")
        if self.kind == "charuco" and not 0 < self.marker_mm < self.square_mm:
            raise InputError.of("board.marker_mm", self.marker_mm, "must lie in (0, square_mm)", "Measure a marker.")


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated camera.

    Attributes
    ----------
    camera
        At the origin of the world, looking along +z.
    residual_px
        Root mean square distance of the corners from where the camera would put them.
    view_residuals_px
        The same for each used picture.
    covariance
        (9, 9) of `PARAMETERS`, board poses marginalised, scaled by the residual.
    corners
        Corners used.
    coverage
        Share of a 4 x 4 grid of the picture in which there are corners.
    skipped
        Pictures in which the board was not found, with the reason.
    notes
        What a reader should know.
    """

    camera: Camera
    residual_px: float
    view_residuals_px: tuple[float, ...]
    covariance: FloatArray
    corners: int
    coverage: float
    skipped: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()

    def standard_uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each parameter, by its name."""
        return dict(zip(PARAMETERS, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def calibrate_camera(pictures: Sequence[tuple[str, NDArray[np.generic]]], board: Board) -> CameraCalibration:
    """Intrinsics and lens distortion (Zhang 2000, by OpenCV) from pictures of a board in several attitudes.

    Parameters
    ----------
    pictures
        Names and (rows, columns[, channels]) pictures, 8 or 16 bit or floating point, as stored.
    board
        What they show.

    Raises
    ------
    InputError
        Sizes that differ, or the board found in fewer than three pictures.
    """
    import cv2

    if not pictures:
        raise InputError.of("calibration", 0, "needs three pictures of the board at least", "Add pictures.")
    sizes = {p.shape[:2] for _, p in pictures}
    if len(sizes) > 1:
        raise InputError.of("calibration", sorted(sizes), "pictures must have one size", "Give them uncropped.")
    rows, columns = sizes.pop()
    objects, images, skipped = [], [], []
    for name, picture in pictures:
        found = find_corners(picture, board)
        if found is None:
            skipped.append((name, f"no {board.kind} of {board.columns} x {board.rows} found"))
        else:
            objects.append(found[0])
            images.append(found[1])
    if len(objects) < 3:
        raise InputError.of(
            "calibration",
            f"{board.kind} found in {len(objects)} of {len(pictures)} pictures",
            "must be found in three at least",
            "Check the board's kind, counts and dictionary, and that it is sharp, lit evenly and whole.",
        )
    rms, matrix, lens, turns, shifts, _, _, views = cv2.calibrateCameraExtended(
        objects, images, (columns, rows), np.eye(3), np.zeros(5)
    )
    lens = np.asarray(lens, dtype=np.float64).reshape(-1)[:5]
    covariance = _covariance(objects, images, matrix, lens, turns, shifts)
    grid = np.zeros((4, 4), dtype=bool)
    for corners in images:
        at = np.clip((corners.reshape(-1, 2) / [columns, rows] * 4).astype(int), 0, 3)
        grid[at[:, 1], at[:, 0]] = True
    sd = np.sqrt(np.diag(covariance))
    notes = []
    if grid.mean() < 0.75:
        notes.append(f"The corners cover {grid.mean():.0%} of the picture: the lens is not known beyond them.")
    if sd[0] > 0.01 * matrix[0, 0]:
        notes.append(f"The focal length is known to {sd[0] / matrix[0, 0]:.1%} only: tilt the board more.")
    if rms > 1.0:
        notes.append(f"The residual of {rms:.2f} px is large: a bent board, blur or a wrong count of squares.")
    camera = Camera(columns, rows, np.asarray(matrix, dtype=np.float64), distortion=lens)
    return CameraCalibration(
        camera,
        float(rms),
        tuple(float(v) for v in np.ravel(views)),
        covariance,
        sum(len(c) for c in images),
        float(grid.mean()),
        tuple(skipped),
        tuple(notes),
    )


def find_corners(picture: NDArray[np.generic], board: Board) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Corners of a board, on it (n, 1, 3) in mm and in the picture (n, 1, 2) in px; None where it is not found."""
    import cv2

    eight = _eight_bit(picture)
    if board.kind == "chessboard":
        found, corners = cv2.findChessboardCornersSB(
            eight, (board.columns, board.rows), flags=cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        if not found:
            return None
        corners = _refined(eight, corners, board.columns)
        v, u = np.mgrid[0 : board.rows, 0 : board.columns]
        plane = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 1, 3) * board.square_mm
        return np.asarray(plane, dtype=np.float32), np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    code = getattr(cv2.aruco, board.dictionary, None)
    if not isinstance(code, int) or not board.dictionary.startswith("DICT_"):
        raise InputError.of("board.dictionary", board.dictionary, "is no dictionary of OpenCV", "Say DICT_4X4_50.")
    grid = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_mm, board.marker_mm, cv2.aruco.getPredefinedDictionary(code)
    )
    corners, ids, _, _ = cv2.aruco.CharucoDetector(grid).detectBoard(eight)
    if ids is None or len(ids) < 6:
        return None
    objects, images = grid.matchImagePoints(corners, ids)
    flat = np.asarray(objects, dtype=np.float32).reshape(-1, 1, 3)
    return flat, np.asarray(images, dtype=np.float32).reshape(-1, 1, 2)


def _refined(eight: NDArray[np.uint8], corners: NDArray[np.float32], columns: int) -> NDArray[np.float32]:
    """Corners where the gradients around them meet, in a window of a third of a square: halves the residual."""
    import cv2

    at = np.asarray(corners, dtype=np.float32).reshape(-1, columns, 2)
    apart = min(float(np.linalg.norm(np.diff(at, axis=k), axis=2).min()) for k in (0, 1))
    window = max(int(apart / 3), 2)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    return np.asarray(cv2.cornerSubPix(eight, at.reshape(-1, 1, 2).copy(), (window, window), (-1, -1), stop))


def _eight_bit(picture: NDArray[np.generic]) -> NDArray[np.uint8]:
    grey = np.asarray(picture, dtype=np.float64)
    grey = grey.mean(axis=2) if grey.ndim == 3 else grey
    low, high = np.nanpercentile(grey, [0.5, 99.5])
    scaled = np.clip((np.nan_to_num(grey, nan=low) - low) / max(high - low, 1e-12), 0, 1)
    return np.asarray(np.round(scaled * 255), dtype=np.uint8)


def _covariance(
    objects: Sequence[NDArray[np.float32]],
    images: Sequence[NDArray[np.float32]],
    matrix: FloatArray,
    lens: FloatArray,
    turns: Sequence[FloatArray],
    shifts: Sequence[FloatArray],
) -> FloatArray:
    """(9, 9) covariance of the intrinsics: normal equations of all views, the poses eliminated (Schur complement)."""
    import cv2

    normal = np.zeros((9, 9))
    square, count = 0.0, 0
    for obj, img, turn, shift in zip(objects, images, turns, shifts, strict=True):
        seen, jacobian = cv2.projectPoints(obj, turn, shift, matrix, lens)
        pose, inner = jacobian[:, :6], jacobian[:, 6:15]
        cross = pose.T @ inner
        normal += inner.T @ inner - cross.T @ np.linalg.solve(pose.T @ pose, cross)
        off = (seen - img).reshape(-1)
        square += float(off @ off)
        count += off.size
    freedom = max(count - 9 - 6 * len(objects), 1)
    return np.asarray(np.linalg.pinv(normal) * square / freedom, dtype=np.float64)
