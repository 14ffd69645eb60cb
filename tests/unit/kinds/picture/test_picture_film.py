"""The film's sums: means and errors of what was exposed, kept and taken up again."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.kinds.picture.camera import add
from livlab.kinds.picture.film import CameraFilm


def exposed(samples: np.ndarray) -> CameraFilm:  # type: ignore[type-arg]
    """(sample, row, column, W) on a film."""
    film = CameraFilm.empty(*samples.shape[1:3], np.arange(samples.shape[3]) * 10.0 + 500.0)
    film.total += samples.sum(axis=0)
    film.square += (samples**2).sum(axis=0)
    film.spectra += [sample.mean(axis=(0, 1)) for sample in samples]
    film.batches += len(samples)
    film.passes += 1
    return film


def test_mean_and_standard_error_are_those_of_the_samples() -> None:
    samples = np.random.default_rng(1).exponential(size=(50, 3, 4, 2))
    film = exposed(samples)
    assert np.allclose(film.radiance, samples.mean(axis=0), rtol=1e-12)
    assert np.allclose(film.standard_error, samples.std(axis=0, ddof=1) / np.sqrt(50), rtol=1e-9)


def test_relative_error_is_the_median_pixels() -> None:
    samples = np.random.default_rng(2).exponential(size=(400, 8, 8, 3))
    film = exposed(samples)
    lit = np.zeros((8, 8), dtype=bool)
    lit[:4] = True
    expected = np.median((film.standard_error.sum(axis=2) / film.radiance.sum(axis=2))[lit])
    assert film.relative_error(lit) == pytest.approx(expected, rel=1e-12)
    assert film.relative_error(lit) == pytest.approx(1 / np.sqrt(400), rel=0.1)  # exponential: sd = mean


def test_batches_are_what_errors_follow_from() -> None:
    samples = np.random.default_rng(9).exponential(size=(400, 5, 5, 2))
    one, eight = (
        CameraFilm.empty(5, 5, np.array([500.0, 600.0])),
        CameraFilm.empty(5, 5, np.array([500.0, 600.0]), batch=8),
    )
    lit = np.arange(10)
    add(one, np.pad(samples, [(0, 0)] * 3 + [(0, 14)]), 400, 16, lit)
    add(eight, np.pad(samples.reshape(50, 8, 5, 5, 2).sum(axis=1), [(0, 0)] * 3 + [(0, 14)]), 50, 16, lit)
    assert one.samples == eight.samples == 400
    assert np.allclose(one.radiance, eight.radiance, rtol=1e-6)
    # 50 batches know their spread to 10 %; the mean over 50 pixels and wavelengths to 2 %.
    assert np.mean(eight.standard_error / one.standard_error) == pytest.approx(1.0, abs=0.06)


def test_the_mean_spectrum_knows_how_its_errors_go_together() -> None:
    rng = np.random.default_rng(3)
    film = CameraFilm.empty(4, 4, np.array([500.0, 600.0, 700.0]))
    common = rng.exponential(size=(500, 4, 4, 1))
    samples = np.concatenate([common, 2 * common, rng.exponential(size=(500, 4, 4, 1))], axis=3)
    add(film, np.pad(samples, [(0, 0)] * 3 + [(0, 13)]), 500, 16, np.arange(8))
    mean, covariance = film.mean_spectrum()
    kept = samples.reshape(500, 16, 3)[:, :8].mean(axis=1)
    assert np.allclose(mean, kept.mean(axis=0), rtol=1e-6)
    assert np.allclose(covariance, np.cov(kept, rowvar=False) / 500, rtol=1e-4)
    assert covariance[0, 1] == pytest.approx(np.sqrt(covariance[0, 0] * covariance[1, 1]), rel=1e-4)
    assert abs(covariance[0, 2]) < 0.2 * covariance[0, 0]


def test_a_pixel_that_saw_no_light_counts_as_unknown() -> None:
    film = exposed(np.zeros((5, 2, 2, 1)))
    assert film.relative_error(np.ones((2, 2), dtype=bool)) == 1.0
    assert np.isnan(film.relative_error(np.zeros((2, 2), dtype=bool)))


def test_a_film_comes_back_from_its_dataset_exactly() -> None:
    film = exposed(np.random.default_rng(3).exponential(size=(5, 2, 3, 2)))
    film.trace.append((1.5, 5.0, 0.25))
    film.seconds, film.about = 2.5, {"variant": "llvm_ad_mono"}
    back = CameraFilm.from_dataset(film.to_dataset())
    assert np.array_equal(back.total, film.total)
    assert np.array_equal(back.square, film.square)
    assert np.array_equal(back.mean_spectrum()[0], film.mean_spectrum()[0])
    assert (back.samples, back.passes, back.seconds, back.trace) == (5, 1, 2.5, film.trace)
    assert back.about == film.about


def test_an_empty_film_shows_nothing() -> None:
    film = CameraFilm.empty(2, 2, np.array([500.0]))
    with pytest.raises(InputError, match="Expose"):
        _ = film.radiance
