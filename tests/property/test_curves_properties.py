"""What must hold for any curve and any window."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from livlab import curves
from livlab.curves import Curve

alignments = st.sampled_from(["centred", "left", "right"])


@given(st.integers(1, 30), st.data(), alignments)
def test_smoothing_keeps_constants_and_bounds(size, data, alignment):
    window = data.draw(st.integers(1, size))
    v = data.draw(arrays(np.float64, size, elements=st.floats(-10, 10)))
    matrix = curves.moving_average_matrix(size, window, alignment)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=1e-12)
    assert (matrix >= 0).all()
    smooth = matrix @ v
    assert smooth.max() <= v.max() + 1e-9
    assert smooth.min() >= v.min() - 1e-9


@given(st.integers(2, 8))
def test_centred_keeps_a_line_and_left_moves_it_half_a_position(half_window):
    window = 2 * half_window
    line = np.arange(40.0)
    inner = slice(window, -window)
    centred = curves.moving_average_matrix(40, window) @ line
    left = curves.moving_average_matrix(40, window, "left") @ line
    np.testing.assert_allclose(centred[inner], line[inner], rtol=1e-12)
    np.testing.assert_allclose(left[inner], line[inner] - 0.5, rtol=1e-12)


@given(arrays(np.float64, 8, elements=st.floats(-5, 5)), st.lists(st.floats(500, 640), min_size=1, max_size=9))
def test_interpolation_agrees_with_numpy(v, points):
    grid = np.linspace(500, 640, 8)
    got = curves.interpolate(Curve.of(grid, v), sorted(set(points)))
    np.testing.assert_allclose(got.value, np.interp(got.wavelength_nm, grid, v), atol=1e-12)


@given(arrays(np.float64, 8, elements=st.floats(0.1, 5)), st.sampled_from(["max", "sum"]))
def test_covariance_stays_a_covariance(v, by):
    done = curves.thesis_curve(Curve.of(np.linspace(500, 640, 8), v, 0.01 * v), by=by)
    assert np.linalg.eigvalsh(done.covariance)[0] >= -1e-12
    np.testing.assert_allclose(done.covariance, done.covariance.T, atol=1e-18)
