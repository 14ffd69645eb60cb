"""The counting error against a model whose variance is known: overlapping discs at random places (Boolean model)."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import erf

from livlab.acquire.micrographs.files import MicrographPage
from livlab.acquire.micrographs.fractions import Method, counting_error, measure_page


def discs(rng, size, radius, fraction):
    """Boolean model: a periodic field of discs is cut in the middle, so that no edge is special."""
    margin = int(np.ceil(radius)) + 1
    whole = size + 2 * margin
    intensity = -np.log(1 - fraction) / (np.pi * radius**2)
    centres = rng.random((rng.poisson(intensity * whole**2), 2)) * whole
    mask = np.zeros((whole, whole), bool)
    reach = np.arange(-margin, margin + 1)
    for cy, cx in centres:
        iy, ix = int(cy), int(cx)
        inside = (reach[:, None] + iy + 0.5 - cy) ** 2 + (reach + ix + 0.5 - cx) ** 2 <= radius**2
        y, x = iy + reach, ix + reach
        ky, kx = (y >= 0) & (y < whole), (x >= 0) & (x < whole)
        mask[np.ix_(y[ky], x[kx])] |= inside[np.ix_(ky, kx)]
    return mask[margin:-margin, margin:-margin]


def true_error(size, radius, fraction):
    """Standard deviation of the share: the covariance (1−p)² (e^(λK(h)) − 1) over all pairs of pixels (Matheron 1975).

    K is the overlap of two discs at distance h.
    """
    intensity = -np.log(1 - fraction) / (np.pi * radius**2)
    lag = np.arange(-int(2 * radius) - 1, int(2 * radius) + 2)
    h = np.minimum(np.hypot(lag[:, None], lag), 2 * radius)
    overlap = 2 * radius**2 * np.arccos(h / (2 * radius)) - h / 2 * np.sqrt(4 * radius**2 - h**2)
    covariance = (1 - fraction) ** 2 * np.expm1(intensity * overlap)
    pairs = (size - np.abs(lag))[:, None] * (size - np.abs(lag))
    return np.sqrt(np.sum(covariance * pairs)) / size**2


def block_error(size, edge, radius, fraction):
    """What blocks of one edge give on average: their variance less the whole field's, over their count."""
    blocks = (size // edge) ** 2
    within = true_error(edge, radius, fraction) ** 2 - true_error(size, radius, fraction) ** 2
    return np.sqrt(within * blocks / (blocks - 1) / blocks)


def test_counting_error_of_random_discs():
    """60 fields of 256², radius 5, 20 %: the scatter is known to 9 %; the mean of 60 estimates of 15 degrees of
    freedom each to 2.4 %. A binomial of the pixel count is eight times too small and would fail at once.
    """
    rng = np.random.default_rng(8)
    size, radius, fraction, fields = 256, 5.0, 0.2, 60
    expected = true_error(size, radius, fraction)
    shares, errors = [], []
    for _ in range(fields):
        mask = discs(rng, size, radius, fraction)
        shares.append(mask.mean())
        errors.append(counting_error(mask, np.ones_like(mask))[0])
    scatter = np.std(shares, ddof=1)
    assert abs(scatter / expected - 1) < 4 / np.sqrt(2 * (fields - 1))
    # Digital discs: the mean share is right within its own error.
    assert abs(np.mean(shares) - fraction) < 4 * expected / np.sqrt(fields)
    # Blocks of a finite edge miss a little; the largest over sizes gives some of it back.
    largest = max(block_error(size, edge, radius, fraction) for edge in (4, 8, 16, 32, 64))
    assert 0.85 < largest / expected < 1.0
    estimate = np.sqrt(np.mean(np.square(errors)))
    assert largest * (1 - 4 * 0.024) < estimate < 1.15 * expected
    assert np.sqrt(fraction * (1 - fraction)) / size < 0.15 * expected
    # Student's t with 15 degrees of freedom leaves 6.4 % outside two standard errors.
    covered = np.mean(np.abs(np.array(shares) - fraction) <= 2 * np.array(errors))
    assert covered >= 0.936 - 3 * np.sqrt(0.936 * 0.064 / fields)


def test_independent_pixels_give_the_binomial_error():
    rng = np.random.default_rng(1)
    mask = rng.random((300, 200)) < 0.3
    error, settled = counting_error(mask, np.ones_like(mask))
    assert settled
    assert 1.0 <= error / np.sqrt(0.3 * 0.7 / mask.size) < 1.5


def test_one_big_structure_does_not_settle():
    mask = np.zeros((256, 256), bool)
    mask[:, :128] = True
    assert not counting_error(mask, np.ones_like(mask))[1]


def test_a_narrow_strip_is_blocked_along_its_length():
    """Stripes across a strip of three rows: the rows repeat each other and must not count thrice."""
    rng = np.random.default_rng(4)
    row = np.repeat(rng.random(500) < 0.3, 4)
    once = counting_error(row[None, :], np.ones((1, 2000), bool))[0]
    thrice = counting_error(np.tile(row, (3, 1)), np.ones((3, 2000), bool))[0]
    assert thrice == pytest.approx(once, rel=0.05)


def page_of(values):
    return MicrographPage("noisy", 0, values, None, True, 255.0)


def noisy_strips(rng, share, sigma, background, level, blur):
    """Vertical strips whose brightness, blurred by a normal kernel, is known in closed form."""
    size, period = 400, 40
    x = np.arange(size) + 0.5
    width = share * period
    left = (np.arange(-1, size // period + 2) * period)[:, None] + 10.0
    profile = np.sum(
        (erf((x - left) / (np.sqrt(2) * blur)) - erf((x - left - width) / (np.sqrt(2) * blur))) / 2, axis=0
    )
    mean = np.tile(background + (level - background) * profile, (size, 1))
    image = np.zeros((size, size, 3))
    for channel in (0, 1, 2):
        image[..., channel] = mean + sigma * rng.normal(size=mean.shape)
    return mean, np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("blur", [0.3, 3.0])
@pytest.mark.parametrize(("sigma", "background"), [(2.0, 0.0), (5.0, 0.0), (4.0, 6.0)])
def test_fixed_threshold_counts_what_noise_and_blur_make_of_it(sigma, background, blur):
    """Share above 10 = mean of P(noise lifts a pixel to 10.5 or more); of 160 000 pixels, 4 errors are ≤ 0.005."""
    rng = np.random.default_rng(6)
    mean, image = noisy_strips(rng, 0.3, sigma, background, 180.0, blur)
    above = stats.norm.sf(10.5, mean, sigma)
    error = np.sqrt(np.sum(above * (1 - above))) / mean.size
    found = measure_page(page_of(image), Method()).elastin.value
    assert abs(found - above.mean()) < 4 * error
    # Magenta takes the lesser of two noisy channels: the chance is squared.
    both = above**2
    error = np.sqrt(np.sum(both * (1 - both))) / mean.size
    assert abs(measure_page(page_of(image), Method()).collagen.value - both.mean()) < 4 * error
    # Blur widens what a low threshold sees: the closed form must be clearly above the true share there.
    if blur == 3.0:
        assert above.mean() > 0.35


def literal_otsu(mean, sigma):
    """Otsu's threshold of a mixture of normals: largest w0 w1 (m1 - m0)², no histogram, thresholds tried one by one."""
    levels, counts = np.unique(mean[0], return_counts=True)
    weight = counts / counts.sum()
    best = (0.0, 0.0)
    for t in np.arange(1.5, 254.5):
        z = (t - levels) / sigma
        below = weight * stats.norm.cdf(z)
        w0 = below.sum()
        first = np.sum(below * levels) - sigma * np.sum(weight * stats.norm.pdf(z))
        if 0 < w0 < 1:
            m0, m1 = first / w0, (weight @ levels - first) / (1 - w0)
            best = max(best, (w0 * (1 - w0) * (m1 - m0) ** 2, t))
    return best[1]


@pytest.mark.parametrize("sigma", [4.0, 12.0])
@pytest.mark.parametrize("blur", [0.3, 3.0])
def test_otsu_against_a_literal_one(sigma, blur):
    """Background five sigma off black, so that nothing is clipped at 0; the share within 4 errors and a grey level."""
    mean, image = noisy_strips(np.random.default_rng(7), 0.3, sigma, 60.0, 180.0, blur)
    page = measure_page(page_of(image), Method(threshold="otsu"))
    threshold = literal_otsu(mean, sigma)
    if blur == 3.0:  # sharp strips leave a gap in the histogram, where every threshold is as good
        assert abs(page.elastin.threshold + 0.5 - threshold) <= 1.5
    low, high = (stats.norm.sf(threshold + k, mean, sigma).mean() for k in (1.5, -1.5))
    noise = 4 * np.sqrt(0.25 / mean.size)
    assert low - noise <= page.elastin.value <= high + noise
    fixed = measure_page(page_of(np.maximum(image, 60) - 60), Method()).elastin.value
    if blur == 0.3:
        assert page.elastin.value == pytest.approx(0.3, abs=0.002)
    # The fixed threshold sees the blurred flanks, Otsu's cuts higher up.
    assert abs(page.elastin.value - 0.3) < abs(fixed - 0.3)
