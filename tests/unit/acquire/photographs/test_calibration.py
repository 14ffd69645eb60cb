"""Camera from boards, colours from a chart: pictures are made here, so that the camera is known."""

import functools

import cv2
import numpy as np
import pytest

from livlab.acquire.photographs.calibration import PARAMETERS, Board, calibrate_camera, find_corners
from livlab.acquire.photographs.calibration_chart import calibrate_colour
from livlab.acquire.photographs.linearity import response
from livlab.brdf.geometry import Camera
from livlab.errors import InputError

CAMERA = Camera(
    480,
    360,
    np.array([[520.0, 0, 243.0], [0, 524.0, 176.0], [0, 0, 1]]),
    distortion=np.array([-0.15, 0.08, 0.001, -0.001, 0]),
)
CHARUCO = Board("charuco", 9, 7, 20.0, 15.0, "DICT_4X4_100")
CHESS = Board("chessboard", 8, 6, 20.0)


def printed(board, px=48):
    """The board from above, `px` pixels a square, with a white margin of one square."""
    if board.kind == "charuco":
        code = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        grid = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, code)
        return grid.generateImage(((board.columns + 2) * px, (board.rows + 2) * px), marginSize=px).astype(float)
    rows, columns = board.rows + 1, board.columns + 1
    checks = np.kron((np.indices((rows, columns)).sum(axis=0) % 2) * 255.0, np.ones((px, px)))
    return np.pad(checks, px, constant_values=255.0)


SUB = 3


@functools.cache
def rays():
    """Directions of SUB x SUB rays a pixel, once for all pictures: inverting the lens takes most of the time."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(float)
    steps = (np.arange(SUB) + 0.5) / SUB - 0.5
    return [CAMERA.rays(u + a, v + b)[1] for a in steps for b in steps]


def seen(board, turn, shift, px=48):
    """What the camera sees of a board."""
    flat = printed(board, px)
    rotation, _ = cv2.Rodrigues(np.asarray(turn, dtype=float))
    total = np.zeros((CAMERA.height, CAMERA.width))
    for d in rays():
        t = (rotation[:, 2] @ np.asarray(shift)) / (d @ rotation[:, 2])
        on = (t[..., None] * d - shift) @ rotation
        x, y = ((on[..., k] / board.square_mm * px + px - 0.5).astype(np.float32) for k in (0, 1))
        total += cv2.remap(flat, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=120.0)
    return total / SUB**2


@functools.cache
def views(board, count=14, noise=2.0):
    rng = np.random.default_rng(9)
    w, h = (board.columns, board.rows) if board.kind == "charuco" else (board.columns + 1, board.rows + 1)
    middle = np.array([w, h, 0]) * board.square_mm / 2
    out = []
    for k in range(count):
        turn = np.array([0.45 * np.cos(2.4 * k), 0.45 * np.sin(2.4 * k), 0.3 * (k % 3 - 1)])
        rotation, _ = cv2.Rodrigues(turn)
        at = np.array([45 * (k % 3 - 1), 32 * (k // 3 % 3 - 1), 330.0 + 6 * k]) - rotation @ middle
        out.append((f"{k}.png", seen(board, turn, at) + rng.normal(0, noise, (CAMERA.height, CAMERA.width))))
    return out


@pytest.mark.parametrize("board", [CHARUCO, CHESS], ids=["charuco", "chessboard"])
def test_the_camera_is_recovered_within_what_is_told(board):
    found = calibrate_camera(views(board), board)
    assert found.residual_px < 0.12
    true = [520.0, 524.0, 243.0, 176.0, -0.15, 0.08, 0.001, -0.001, 0.0]
    m, lens = found.camera.matrix, found.camera.distortion
    value = [m[0, 0], m[1, 1], m[0, 2], m[1, 2], *lens]
    told = np.array([found.standard_uncertainty()[name] for name in PARAMETERS])
    z = (np.array(value) - true) / told
    # Corners of one picture err alike, which the covariance does not know: twice its claim is allowed.
    assert np.all(np.abs(z[:4]) < 5), z
    assert abs(value[0] / 520 - 1) < 0.003
    u, v = np.meshgrid(np.linspace(60, 420, 9), np.linspace(50, 310, 7))
    a, b = (cam.rays(u, v)[1].reshape(-1, 3) for cam in (CAMERA, found.camera))
    # A principal point that is off acts as a turn of the camera, which board poses take up.
    left, _, right = np.linalg.svd(a.T @ b)
    assert np.sqrt(np.mean(np.sum((a - b @ (left @ right).T) ** 2, axis=1))) * 520 < 0.15
    assert found.coverage > 0.8


def test_pictures_without_the_board_are_skipped_and_named():
    pictures = [*views(CHESS, 4), ("none.png", np.full((360, 480), 90.0))]
    found = calibrate_camera(pictures, CHESS)
    assert found.skipped[0][0] == "none.png"


def test_too_few_boards_are_refused():
    with pytest.raises(InputError, match="found in 2 of 3"):
        calibrate_camera([*views(CHESS, 2), ("none.png", np.zeros((360, 480)))], CHESS)
    with pytest.raises(InputError, match="three pictures"):
        calibrate_camera([], CHESS)
    with pytest.raises(InputError, match="one size"):
        calibrate_camera([("a", np.zeros((9, 9))), ("b", np.zeros((9, 8)))], CHESS)


def test_a_wrong_count_of_squares_finds_nothing():
    picture = views(CHESS, 1)[0][1]
    assert find_corners(picture, CHESS) is not None
    assert find_corners(picture, Board("chessboard", 7, 6, 20.0)) is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("charuco", 9, 7, 20.0, 25.0), "marker_mm"),
        (("chessboard", 2, 7, 20.0), "3 x 3"),
        (("chessboard", 8, 7, 0.0), "square_mm"),
    ],
)
def test_wrong_boards_are_refused(arguments, said):
    with pytest.raises(InputError, match=said):
        Board(*arguments)


def test_an_unknown_dictionary_is_refused():
    with pytest.raises(InputError, match="no dictionary"):
        find_corners(np.zeros((50, 50)), Board("charuco", 9, 7, 20.0, 15.0, "DICT_MINE"))


PATCHES = (  # the 24-patch chart as its maker gives it in 8-bit sRGB
    (115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170),
    (214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46),
    (56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161),
    (243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52),
)  # fmt: skip


def chart(matrix, exposure=1.0):
    """A 24-patch chart in linear light as a camera with these colours sees it."""
    stored = np.array(PATCHES).reshape(4, 6, 3) / 255
    linear = response("srgb").decode(stored)
    picture = np.full((430, 560, 3), 0.3)
    picture[40:360, 50:510] = 0.02
    for r in range(4):
        for c in range(6):
            picture[56 + 74 * r : 116 + 74 * r, 62 + 74 * c : 122 + 74 * c] = linear[r, c]
    return exposure * picture @ np.asarray(matrix).T


MATRIX = np.array([[0.8, 0.15, 0.02], [0.1, 0.7, 0.1], [0.02, 0.2, 0.6]])


@pytest.mark.parametrize("exposure", [1.0, 0.3])
def test_a_chart_gives_the_colour_matrix(exposure):
    found = calibrate_colour(chart(MATRIX, exposure))
    # OpenCV's reference values are of another print run than the ones drawn: they differ by up to 0.06.
    assert found.residual < 0.03
    assert found.residual < 0.4 * found.residual_before
    np.testing.assert_allclose(found.matrix @ MATRIX * exposure, np.eye(3), atol=0.12)


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.zeros((300, 300, 3)), "shows nothing"),
        (np.random.default_rng(1).random((300, 300, 3)), "no colour chart"),
        (np.full((300, 300, 3), 0.5), "no colour chart"),
        (np.zeros((300, 300, 1)), "RGB"),
    ],
    ids=["black", "noise", "flat", "grey"],
)
def test_a_chart_that_is_not_there_is_a_clear_error(picture, said):
    with pytest.raises(InputError, match=said):
        calibrate_colour(picture, "chart.png")
