"""Merging exposures, dark and flat frames, noise: what comes out, how sure it is, and what is said about it."""

import numpy as np
import pytest
from synthetic_camera import Faults

from livlab.acquire.photographs.linearity import response
from livlab.acquire.photographs.merge import Development, estimate_noise, flat_field, merge
from livlab.acquire.photographs.read import Exposure, Photograph
from livlab.brdf.sphere import Noise
from livlab.errors import InputError

LINEAR = response("linear")
TIMES = (0.02, 0.1, 0.5)
NOISE = Noise(read=0.002, gain=2e-4)


def photograph(values, name="a.png"):
    values = np.asarray(values)
    values = values[..., None] if values.ndim == 2 else values
    full = np.inf if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    return Photograph(name, values, full, Exposure(), None)


def scene(shape=(60, 80)):
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    return 10 ** (2.6 * u / shape[1] - 1) * (1 + 0.2 * np.sin(v / 7))


def shots(bits=16, seed=0, **faults):
    x = scene()
    camera = [Faults(exposure=t, gain=2e-4, read=0.002, bits=bits, seed=seed, **faults) for t in TIMES]
    return [photograph(f(x, k)) for k, f in enumerate(camera)]


def relative(found, truth):
    return float(np.sqrt(np.nanmean((found[..., 0] / truth - 1) ** 2)))


def test_merge_covers_the_range_and_beats_every_single_exposure():
    truth = scene()
    development = Development(LINEAR, NOISE)
    merged = merge(shots(), TIMES, development)
    assert np.isfinite(merged.value).all()
    whole = relative(merged.value, truth)
    for k, t in enumerate(TIMES):
        single = merge(shots()[k : k + 1], [t], development)
        seen = np.isfinite(single.value[..., 0])
        error = relative(np.where(seen[..., None], single.value, np.nan), truth)
        same = relative(np.where(seen[..., None], merged.value, np.nan), truth)
        assert same < error * 1.001
    assert whole < 0.06
    assert merged.clipped == 0


def test_told_variance_is_the_scatter():
    truth = scene()
    development = Development(LINEAR, NOISE)
    runs = [merge(shots(seed=s), TIMES, development) for s in range(24)]
    z = np.array([(m.value[..., 0] - truth) / np.sqrt(m.variance[..., 0]) for m in runs])
    # The darkest values are cut at black, so that their noise is one-sided: they are left out.
    z = z[:, truth > 0.15]
    # 24 runs x 4700 pixels know the variance of z to 0.4 %; the model's own approximation is a few per cent.
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.08)
    assert abs(np.mean(z)) < 0.05


def test_clipped_pixels_are_left_out_not_averaged():
    pictures = shots(bits=8)
    merged = merge(pictures, TIMES, Development(LINEAR, NOISE))
    bright = scene() > 2.5  # clips in the two longer ones
    assert bright.any()
    np.testing.assert_allclose(merged.value[bright][:, 0], scene()[bright], rtol=0.25)
    assert abs(np.mean(merged.value[bright][:, 0] / scene()[bright]) - 1) < 0.01


def test_a_shortest_exposure_that_clips_leaves_holes_and_says_so():
    merged = merge(shots()[1:], TIMES[1:], Development(LINEAR, NOISE))
    lost = scene() * TIMES[1] > 1.02
    assert np.isnan(merged.value[lost]).all()
    assert np.isfinite(merged.value[scene() * TIMES[1] < 0.95]).all()
    assert "too long for the highlight" in merged.notes[0]
    assert merged.clipped == pytest.approx(lost.mean(), abs=0.03)


def test_wrong_exposure_times_are_told():
    said = merge(shots(), (0.02, 0.1, 0.4), Development(LINEAR, NOISE)).notes
    assert any("exposures disagree" in note for note in said)
    assert merge(shots(), TIMES, Development(LINEAR, NOISE)).notes == ()


def test_a_wrong_response_is_told_by_the_exposures():
    said = merge(shots(gamma=2.2), TIMES, Development(LINEAR, NOISE)).notes
    assert any("wrong response" in note for note in said)
    assert merge(shots(gamma=2.2), TIMES, Development(response("gamma", gamma=2.2), NOISE)).notes == ()


def test_dark_frame_corrects_an_offset():
    truth = scene() * 0.1
    shot = Faults(dark=0.03, bits=16)(truth)
    dark = np.full((60, 80, 1), 0.03, dtype=np.float32)
    without = merge([photograph(shot)], [1.0], Development(LINEAR))
    corrected = merge([photograph(shot)], [1.0], Development(LINEAR, dark=((1.0, dark),)))
    ok = truth < 0.9
    before, after = (relative(np.where(ok[..., None], m.value, np.nan), truth) for m in (without, corrected))
    assert before > 0.5
    assert after < 0.001


def test_the_dark_frame_of_the_nearest_exposure_is_taken():
    dark = tuple((t, np.full((60, 80, 1), t, dtype=np.float32)) for t in (0.01, 0.1))
    development = Development(LINEAR, dark=dark)
    value, _, _ = development.linear(photograph(np.full((60, 80), 32768, np.uint16)), 0.08)
    assert value[0, 0, 0] == pytest.approx(0.4, abs=1e-4)


def test_flat_field_corrects_vignetting():
    truth = scene() * 0.15
    faults = Faults(vignetting=0.4, bits=16, gain=1e-5)
    board = faults(np.full((60, 80), 0.6), 9)
    flat = flat_field(photograph(board), Development(LINEAR)).astype(np.float32)
    shot = photograph(faults(truth))
    ok = (truth < 0.8)[..., None]
    before = relative(np.where(ok, merge([shot], [1.0], Development(LINEAR)).value, np.nan), truth)
    after = relative(np.where(ok, merge([shot], [1.0], Development(LINEAR, flat=flat)).value, np.nan), truth)
    assert before > 0.1
    assert after < 0.02


@pytest.mark.parametrize(
    ("board", "said"),
    [
        (np.full((60, 80), 65535, np.uint16), "clipped"),
        (np.outer(np.linspace(0, 1, 60), np.ones(80)).astype(np.float32), "5 %"),
        (np.full((60, 80), np.nan, np.float32), "not finite"),
    ],
)
def test_bad_flat_fields_are_refused(board, said):
    with pytest.raises(InputError, match=said):
        flat_field(photograph(board), Development(LINEAR))


def test_frames_of_another_size_are_refused():
    dark = ((1.0, np.zeros((10, 10, 1), np.float32)),)
    with pytest.raises(InputError, match="must have the size"):
        merge([photograph(np.zeros((60, 80), np.uint8))], [1.0], Development(LINEAR, dark=dark))
    with pytest.raises(InputError, match="one size"):
        merge([photograph(np.zeros((9, 9), np.uint8)), photograph(np.zeros((9, 8), np.uint8))], [1, 2], DEVELOPMENT)


DEVELOPMENT = Development(LINEAR)


@pytest.mark.parametrize("exposures", [[1.0], [1.0, 0.0], [1.0, np.nan], []])
def test_wrong_exposures_are_refused(exposures):
    pictures = [photograph(np.zeros((9, 9), np.uint8))] * 2
    with pytest.raises(InputError, match=r"exposure"):
        merge(pictures, exposures, DEVELOPMENT)


def test_nan_in_a_file_is_a_hole_and_is_counted():
    x = np.full((10, 10), 0.5, np.float32)
    x[2, 3] = np.nan
    x[4, 4] = np.inf
    found = merge([photograph(x)], [1.0], DEVELOPMENT)
    assert np.isnan(found.value[2, 3, 0])
    assert np.isnan(found.value[4, 4, 0])
    assert found.not_finite == pytest.approx(0.02)
    both = merge([photograph(x), photograph(x)], [1.0, 1.0], DEVELOPMENT)
    assert both.not_finite == pytest.approx(0.02)


def test_noise_is_estimated_from_one_picture():
    rng = np.random.default_rng(3)
    truth = np.tile(np.linspace(0.05, 0.9, 300), (200, 1))
    shot = truth + rng.normal(size=truth.shape) * np.sqrt(4e-6 + 2e-4 * truth)
    found = estimate_noise(shot)
    level = np.array([0.1, 0.5, 0.8])
    np.testing.assert_allclose(found(level), 4e-6 + 2e-4 * level, rtol=0.15)
    assert estimate_noise(np.ones((5, 5))) is None


def test_quantisation_is_part_of_the_variance():
    x = photograph((np.full((20, 20), 100)).astype(np.uint8))
    _, variance, _ = Development(LINEAR, Noise(read=1e-9)).linear(x, 1.0)
    assert variance[0, 0, 0] == pytest.approx(1 / 255**2 / 12, rel=1e-4)
