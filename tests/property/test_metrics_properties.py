"""What must hold for any curves."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from livlab import metrics

curve = arrays(np.float64, 9, elements=st.floats(-100, 100, width=32))
scale = st.floats(0.01, 100)
shift = st.floats(-100, 100)


@given(curve, curve)
def test_rmse_is_a_distance(a, b):
    assert metrics.rmse(a, b) == metrics.rmse(b, a) >= 0
    assert metrics.rmse(a, a) == 0
    np.testing.assert_allclose(metrics.rmse(a, b) ** 2, metrics.mse(a, b), rtol=1e-12, atol=1e-300)
    assert metrics.rmse(a, b) <= metrics.rmse(a, np.zeros(9)) + metrics.rmse(b, np.zeros(9)) + 1e-9


@given(curve, curve, scale, shift)
@settings(max_examples=60)
def test_pearson_ignores_scale_and_offset(a, b, k, c):
    assume(np.std(a) > 1e-2 and np.std(b) > 1e-2)
    r = metrics.pearson(a, b)
    assert -1 <= r <= 1
    np.testing.assert_allclose(r, stats.pearsonr(a, b).statistic, atol=1e-9)
    np.testing.assert_allclose(metrics.pearson(k * a + c, b), r, atol=1e-7)
    np.testing.assert_allclose(metrics.pearson(-a, b), -r, atol=1e-9)
    np.testing.assert_allclose(metrics.pearson(a, a), 1, atol=1e-12)


@given(arrays(np.float64, 7, elements=st.floats(1e-3, 1e3)), scale)
def test_normalising_forgets_the_scale(v, k):
    for by in ("max", "sum"):
        np.testing.assert_allclose(metrics.normalise(k * v, by), metrics.normalise(v, by), rtol=1e-12)
    assert metrics.normalise(v, "max").max() == 1
    np.testing.assert_allclose(metrics.normalise(v, "sum").sum(), 1, rtol=1e-12)
