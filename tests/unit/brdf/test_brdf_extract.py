"""Extraction: options, bookkeeping, and what bad input is told."""

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.footprint import footprint, footprints
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.images import binned
from livlab.brdf.rig import rig_of
from livlab.brdf.sphere import Noise, by_light, extract
from livlab.errors import InputError

SIZE, RADIUS_PX = 64, 28.0
SPHERE = Sphere([0.0, 0.0, 0.0], 20.0)


def camera(size=SIZE, radius_px=RADIUS_PX, distance=200.0, **changes):
    focal = radius_px * np.sqrt((distance / 20) ** 2 - 1)
    middle = (size - 1) / 2
    given = {"matrix": [[focal, 0, middle], [0, focal, middle], [0, 0, 1]], "translation": [0, 0, distance]}
    return Camera(size, size, **(given | changes))


def lights(channels=1):
    return [
        Light(np.full(channels, 3e4), position_mm=[60.0, -30.0, -150.0], solid_angle_sr=1e-3),
        Light(np.full(channels, 1.5), direction=[-0.6, 0.0, -0.8]),
    ]


def lambert(view, given, reflectance=0.5, channels=1):
    """Images of a Lambertian sphere, black where not lit."""
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    hits = SPHERE.meet(*view.rays(columns, rows))
    frames = []
    for light in given:
        towards, scale = light.at(hits.points_mm)
        cosine = np.maximum(np.sum(towards * hits.normals, axis=-1), 0) * hits.hit
        frames.append(reflectance / np.pi * (scale * cosine)[..., None] * np.broadcast_to(light.intensity, channels))
    return xr.DataArray(np.array(frames), dims=("light", "row", "column", "channel"))


def broken(images, **where):
    images = images.copy(deep=True)
    images.loc[where] = np.nan
    return images


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_lambertian_sphere_is_lambertian(orthographic):
    view = camera()
    if orthographic:
        view = camera(matrix=[[1.4, 0, 31.5], [0, 1.4, 31.5], [0, 0, 1]], orthographic=True)
    samples = extract(lambert(view, lights()), view, lights(), SPHERE)
    assert samples["value"].values == pytest.approx(0.5 / np.pi, rel=1e-12)
    assert samples.sizes["sample"] > 2000
    assert float(samples["theta_i"].max()) <= np.deg2rad(80) + 1e-12
    assert np.nanmax(samples["shadow_level"].values) == 0
    assert np.all(samples["area"].values > 0)
    assert np.all((samples["pixel_solid_angle"].values == 0) == orthographic)


def test_images_may_come_without_channels_in_any_order_and_as_integers():
    view, given = camera(), lights()
    images = lambert(view, given)
    expected = extract(images, view, given, SPHERE)["value"].values
    flat = images.isel(channel=0, drop=True).transpose("column", "light", "row")
    assert np.array_equal(extract(flat, view, given, SPHERE)["value"].values, expected)
    gain = 40000 / float(images.max())
    whole = (images * gain).round().astype(np.uint16)
    got = extract(whole, view, given, SPHERE, white=gain)["value"].values
    assert got == pytest.approx(expected, rel=0.5 / (gain * 0.15 * 0.5 / np.pi))


def test_exposure_and_white_reference_divide_light_by_light_and_channel_by_channel():
    view, given = camera(), lights(2)
    exposure, white = [0.1, 30.0], [[2.0, 3.0], [5.0, 7.0]]
    images = lambert(view, given, channels=2) * np.array(exposure)[:, None, None, None]
    images = images * np.array(white)[:, None, None, :]
    samples = extract(images, view, given, SPHERE, exposure=exposure, white=white)
    assert samples["value"].values == pytest.approx(0.5 / np.pi, rel=1e-12)


def test_standard_errors_follow_the_noise():
    view, given = camera(), lights()
    images, noise = lambert(view, given), Noise(read=1e-3, gain=4e-4)
    samples = extract(images, view, given, SPHERE, variance=noise)
    given_array = extract(images, view, given, SPHERE, variance=xr.zeros_like(images) + noise(images.values))
    assert given_array["standard_error"].values == pytest.approx(samples["standard_error"].values, rel=1e-12)
    rng = np.random.default_rng(3)
    noisy = images + rng.normal(size=images.shape) * np.sqrt(noise(images.values))
    pulls = (extract(noisy, view, given, SPHERE)["value"] - 0.5 / np.pi) / samples["standard_error"].values
    count = pulls.size
    assert abs(float(pulls.mean())) < 4 / np.sqrt(count)
    assert abs(float(pulls.std()) - 1) < 4 / np.sqrt(2 * count)
    assert np.all(np.isnan(extract(images, view, given, SPHERE)["standard_error"].values))


def test_noise_of_two_exposures_scales_with_the_exposure():
    view, given = camera(), lights()
    long = extract(lambert(view, given) * 4, view, given, SPHERE, exposure=4, variance=Noise(read=1e-3))
    short = extract(lambert(view, given), view, given, SPHERE, variance=Noise(read=1e-3))
    assert long["standard_error"].values * 4 == pytest.approx(short["standard_error"].values, rel=1e-12)


def test_nan_masked_and_saturated_pixels_are_dropped_and_counted():
    view, given = camera(), lights()
    images = lambert(view, given)
    whole = extract(images, view, given, SPHERE)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:20] = False
    dropped = images.copy(deep=True)
    dropped[0, 30, 30] = np.nan
    dropped[1, 31, 31] = np.inf
    dropped[1, 33, 33] = 99.0
    samples = extract(dropped, view, given, SPHERE, mask=mask, saturation=50.0)
    assert samples["dropped_not_finite"].values.tolist() == [1, 1]
    assert samples["dropped_saturated"].values.tolist() == [0, 1]
    above = [int(np.sum((whole["row"] < 20) & (whole["light"] == k))) for k in (0, 1)]
    assert samples["dropped_masked"].values.tolist() == above
    assert samples["used"].values.tolist() == (whole["used"].values - above - [1, 2]).tolist()
    assert samples["value"].values == pytest.approx(0.5 / np.pi)
    assert samples["row"].values.min() >= 20


def test_light_by_light_is_the_same_as_all_at_once():
    view, given = camera(), lights()
    images = lambert(view, given)
    parts = list(by_light(images, view, given, SPHERE, variance=Noise(read=1e-3)))
    joined = extract(images, view, given, SPHERE, variance=Noise(read=1e-3))
    assert [set(part["light"].values) for part in parts] == [{0}, {1}]
    for name in ("wi", "wo", "value", "standard_error", "phi_d", "area"):
        assert np.array_equal(np.concatenate([part[name].values for part in parts]), joined[name].values)
    for part in parts:
        mine = footprint(part, 2)
        theirs = footprint(joined, 2, index=np.flatnonzero(joined["light"].values == part["light"].values[0]))
        assert np.array_equal(mine.weight, theirs.weight) and np.array_equal(mine.wi, theirs.wi)


def test_samples_carry_their_rig():
    view, given = camera(distortion=[-0.1, 0.02, 1e-3, 0, 0]), lights(2)
    samples = extract(lambert(view, given, channels=2), view, given, SPHERE)
    back, again, sphere = rig_of(samples.isel(sample=slice(0, 1)))
    assert (back.width, back.height, back.orthographic) == (SIZE, SIZE, False)
    for name in ("matrix", "rotation", "translation", "distortion"):
        assert np.array_equal(getattr(back, name), getattr(view, name))
    assert np.array_equal(again[0].position_mm, given[0].position_mm) and again[0].direction is None
    assert np.array_equal(again[1].direction, given[1].direction) and again[0].solid_angle_sr == 1e-3
    assert sphere.radius_mm == 20


def test_source_solid_angle_shrinks_with_distance():
    view, given = camera(), lights()
    samples = extract(lambert(view, given), view, given, SPHERE)
    one = samples.isel(sample=samples["light"].values == 0)
    view_points = SPHERE.meet(*view.rays(one["column"].values, one["row"].values)).points_mm
    near = np.sum((given[0].position_mm - view_points) ** 2, axis=1)
    centre = np.sum(given[0].position_mm ** 2)
    assert one["source_solid_angle"].values == pytest.approx(1e-3 * centre / near, rel=1e-12)


def test_footprints_keep_to_their_memory_and_follow_a_selection():
    view, given = camera(), lights()
    samples = extract(lambert(view, given), view, given, SPHERE)
    batches = list(footprints(samples, 4, max_bytes=400 * 16 * 100))
    assert max(len(batch.index) for batch in batches) <= 100
    together = footprint(samples, 4)
    order = np.concatenate([batch.index for batch in batches])
    assert sorted(order) == list(range(samples.sizes["sample"]))
    for batch in batches[:5]:
        assert np.array_equal(together.wi[batch.index], batch.wi)
    some = np.array([500, 3, 1700])
    assert np.array_equal(footprint(samples.isel(sample=some), 4).weight, together.weight[some])
    assert np.array_equal(footprint(samples, 4, index=some).weight, together.weight[some])
    with pytest.raises(InputError, match="more memory"):
        footprint(samples, 64, max_bytes=1 << 20)
    with pytest.raises(InputError, match="1 to 64"):
        footprint(samples, 0)
    with pytest.raises(InputError, match="no camera"):
        footprint(samples.drop_vars("camera_matrix"))


def test_binned_images_see_the_same_sphere():
    view, given = camera(size=128, radius_px=56), lights()
    fine = lambert(view, given)
    small, coarse = binned(fine, view, 2)
    assert small.sizes["row"] == 64 and coarse.width == 64
    points = np.array([[0.0, 3.0, 5.0], [10.0, -4.0, 0.0]])
    assert coarse.project(points) * 2 + 0.5 == pytest.approx(view.project(points), abs=1e-9)
    samples = extract(small, coarse, given, SPHERE)
    assert float(np.sqrt(np.mean((samples["value"] * np.pi / 0.5 - 1) ** 2))) < 0.01
    with pytest.raises(InputError, match="factor"):
        binned(fine, view, 3)


def test_stray_light_shows_in_the_attached_shadow():
    view, given = camera(), lights()[1:]
    images = lambert(view, given)
    stray = 0.02 * float(images.max())
    samples = extract(images + stray, view, given, SPHERE)
    seen = (images + stray).values[0, samples["row"].values, samples["column"].values, 0]
    assert samples["shadow_level"].values[0, 0] == pytest.approx(stray / seen.mean(), rel=1e-9)
