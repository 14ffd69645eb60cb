"""Interpolation, smoothing and normalisation by hand, and what they refuse."""

import numpy as np
import pytest

from livlab import curves
from livlab.curves import Curve
from livlab.errors import InputError, RangeError

GRID = curves.regular_grid(500, 720, 20)


def test_regular_grid_refuses_a_step_that_does_not_divide():
    assert len(GRID) == 12
    for band in [(500, 720, 7), (500, 500, 5), (500, 400, 5), (500, 720, 0), (500, 720, float("nan"))]:
        with pytest.raises(InputError):
            curves.regular_grid(*band)


def test_window_of_four_by_hand():
    step = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    left = curves.moving_average_matrix(8, 4, "left") @ step
    right = curves.moving_average_matrix(8, 4, "right") @ step
    centred = curves.moving_average_matrix(8, 4) @ step
    assert left[2:7].tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert right[1:6].tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert centred[2:6].tolist() == [0.125, 0.375, 0.625, 0.875]
    assert left[2:6].tolist() == np.convolve(step, np.full(4, 0.25), "same")[2:6].tolist()


def test_ends_keep_what_exists():
    left = curves.moving_average_matrix(6, 4, "left")
    assert left[0].tolist() == [0.5, 0.5, 0, 0, 0, 0]
    assert left[5] == pytest.approx([0, 0, 0, 1 / 3, 1 / 3, 1 / 3])
    assert curves.moving_average_matrix(6, 4)[0] * 5 == pytest.approx([2, 2, 1, 0, 0, 0])


def test_window_one_and_odd_windows():
    assert (curves.moving_average_matrix(5, 1) == np.eye(5)).all()
    for alignment in ("centred", "left", "right"):
        assert curves.moving_average_matrix(5, 3, alignment)[2] == pytest.approx([0, 1 / 3, 1 / 3, 1 / 3, 0])


def test_interpolation_hits_nodes_and_refuses_outside():
    curve = Curve.of([500, 520, 560], [1.0, 3.0, -1.0])
    assert curves.interpolate(curve, [500, 510, 520, 540, 560]).value.tolist() == [1, 2, 3, 1, -1]
    for outside in (499.9, 560.1):
        with pytest.raises(RangeError, match="500–560"):
            curves.interpolate(curve, [outside])


def test_maximum_becomes_one_without_error():
    done = curves.normalise(Curve.of(GRID, np.linspace(1, 4, 12), np.full(12, 0.1)))
    assert done.value[-1] == 1.0
    assert done.standard_error[-1] == 0.0
    # y = v/m: relative variances add.
    assert done.standard_error[0] == pytest.approx(0.25 * np.hypot(0.1 / 1, 0.1 / 4))


def test_sum_is_one_with_no_error_of_its_own():
    done = curves.normalise(Curve.of(GRID, np.linspace(1, 4, 12), np.full(12, 0.1)), "sum")
    assert done.value.sum() == pytest.approx(1.0)
    assert np.ones(12) @ done.covariance @ np.ones(12) == pytest.approx(0.0, abs=1e-18)


def test_thesis_curve_end_to_end():
    value = np.linspace(0.1, 0.3, 12)
    done = curves.thesis_curve(Curve.of(GRID, value, np.full(12, 1e-3)))
    assert done.wavelength_nm.tolist() == list(np.arange(500, 721, 5.0))
    assert done.value.max() == 1.0
    # A straight line passes the interior untouched, up to the one factor of the normalisation.
    inner = done.value[4:-4]
    assert np.diff(inner) == pytest.approx(np.full(len(inner) - 1, np.diff(inner).mean()), rel=1e-9)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Curve.of([500, 490], [1, 2]), "rise strictly"),
        (lambda: Curve.of([500, 500], [1, 2]), "rise strictly"),
        (lambda: Curve.of([500, float("nan")], [1, 2]), "finite"),
        (lambda: Curve.of([], []), "non-empty"),
        (lambda: Curve.of([500, 510], [1, float("nan")]), "value"),
        (lambda: Curve.of([500, 510], [1, 2, 3]), "value"),
        (lambda: Curve.of([500, 510], [1, 2], [0.1, -0.1]), "standard_error"),
        (lambda: Curve.of([500, 510], [1, 2], [0.1]), "standard_error"),
        (lambda: curves.moving_average_matrix(3, 4), "window"),
        (lambda: curves.moving_average_matrix(3, 0), "window"),
        (lambda: curves.moving_average_matrix(9, 4, "middle"), "alignment"),
        (lambda: curves.moving_average(Curve.of([500, 510, 530, 540], [1, 2, 3, 4])), "regular grid"),
        (lambda: curves.normalise(Curve.of([500, 510], [0, 0])), "above 0"),
        (lambda: curves.thesis_curve(Curve.of([500, 507, 520], [1, 2, 3]), step_nm=3), "divide"),
    ],
)
def test_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()
