"""Bad input to an extraction: each is refused with the field, the bound and a remedy."""

import tracemalloc

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.sphere import Noise, extract
from livlab.errors import InputError

SIZE = 48
SPHERE = Sphere([0.0, 0.0, 0.0], 20.0)
FRONT = Light(np.ones(1), direction=[0.0, 0.0, -1.0])


def camera(**changes):
    given = {
        "width": SIZE,
        "height": SIZE,
        "matrix": [[200.0, 0, 23.5], [0, 200.0, 23.5], [0, 0, 1]],
        "translation": [0, 0, 200],
    }
    return Camera(**(given | changes))


def ones(count=1, size=(SIZE, SIZE), channels=1):
    return xr.DataArray(np.ones((count, *size, channels)), dims=("light", "row", "column", "channel"))


def refused(match, images=None, view=None, lights=None, sphere=SPHERE, **options):
    with pytest.raises(InputError, match=match) as caught:
        extract(ones() if images is None else images, view or camera(), lights or [FRONT], sphere, **options)
    assert caught.value.remedy  # every refusal says how to mend it
    return str(caught.value)


def test_the_case_that_all_others_change_works():
    assert extract(ones(), camera(), [FRONT], SPHERE).sizes["sample"] > 900


def test_overexposed():
    images = ones()
    images[:, 20:28, 20:28] = 4095.0
    refused("overexposed", images, saturation=4095.0)
    refused("overexposed", (ones() * 65535).astype(np.uint16))
    extract(images, camera(), [FRONT], SPHERE, saturation=4095.0, max_saturated=0.2)


def test_sphere_cut_by_the_frame():
    refused("cut by the frame", sphere=Sphere([8.0, 0.0, 0.0], 20.0))
    refused("cut by the frame", sphere=Sphere([0.0, -300.0, 0.0], 20.0))
    part = extract(ones(), camera(), [FRONT], Sphere([8.0, 0.0, 0.0], 20.0), cut=True)
    assert 0 < part.sizes["sample"] < extract(ones(), camera(), [FRONT], SPHERE).sizes["sample"]


def test_nothing_of_the_sphere_in_the_frame():
    refused("leaves no pixel", sphere=Sphere([0.0, -300.0, 0.0], 20.0), cut=True)


def test_light_behind():
    behind = Light(np.ones(1), direction=[0.0, 0.0, 1.0])
    message = refused(r"lights\[1\].*behind", ones(2), lights=[FRONT, behind])
    assert "direction points from the sphere to the light" in message
    grazing = Light(np.ones(1), direction=[np.sin(2.7), 0.0, -np.cos(2.7)])
    refused("beyond 80 degrees", lights=[grazing])
    samples = extract(ones(2), camera(), [FRONT, behind], SPHERE, empty_lights="skip")
    assert samples["used"].values[1] == 0 and set(samples["light"].values) == {0}


@pytest.mark.parametrize("count", [0, 1, 3])
def test_counts_of_images_and_lights_differ(count):
    refused("one image for each light", ones(count), lights=[FRONT, FRONT])


def test_nan_pixels():
    images = ones(2)
    images[1] = np.nan
    refused(r"lights\[1\].*not finite", images, lights=[FRONT, FRONT])
    images = ones()
    images[0, ::2] = np.nan
    some = extract(images, camera(), [FRONT], SPHERE)
    assert np.isfinite(some["value"].values).all() and some["row"].values.min() % 2 == 1


def test_all_pixels_masked():
    refused("masked", mask=np.zeros((SIZE, SIZE), dtype=bool))


@pytest.mark.parametrize(
    ("mask", "match"),
    [(np.ones((SIZE, SIZE)), "bools"), (np.ones((4, 4), dtype=bool), "shape"), (np.ones(3, dtype=bool), "shape")],
)
def test_mask_that_does_not_fit(mask, match):
    refused(match, mask=mask)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, [[1.0]]])
def test_intensity_that_is_not_positive(value):
    with pytest.raises(InputError, match="intensity"):
        Light(np.atleast_1d(value), direction=[0, 0, -1])


def test_intensities_for_other_channels():
    refused("3 numbers|1 number", ones(channels=3), lights=[Light(np.ones(2), direction=[0, 0, -1])])


@pytest.mark.parametrize("name", ["exposure", "white"])
@pytest.mark.parametrize("value", [0.0, -2.0, np.nan, [1.0, 2.0, 3.0]])
def test_exposure_and_white(name, value):
    refused(name, ones(2), lights=[FRONT, FRONT], **{name: value})


def test_directions_and_positions():
    with pytest.raises(InputError, match="unit vector"):
        Light(np.ones(1), direction=[0.0, 0.0, -2.0])
    with pytest.raises(InputError, match="not both"):
        Light(np.ones(1), direction=[0.0, 0.0, -1.0], position_mm=[0.0, 0.0, -100.0])
    with pytest.raises(InputError, match="not both"):
        Light(np.ones(1))
    with pytest.raises(InputError, match="three finite"):
        Light(np.ones(1), position_mm=[0.0, np.nan, 1.0])
    with pytest.raises(InputError, match="solid_angle"):
        Light(np.ones(1), direction=[0, 0, -1], solid_angle_sr=7.0)
    refused("outside the sphere", lights=[Light(np.ones(1), position_mm=[0.0, 0.0, -19.0])])


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([200.0, 0.0, 1.0]),
        np.diag([-200.0, 200.0, 1.0]),
        np.full((3, 3), np.nan),
        np.eye(2),
        [[200, 0, 23.5], [0, 200, 23.5], [0, 0.1, 1]],
    ],
)
def test_camera_matrix(matrix):
    with pytest.raises(InputError, match=r"camera\.matrix"):
        camera(matrix=matrix)


def test_camera_otherwise():
    for changes, match in (
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "rotation"),
        ({"rotation": 2 * np.eye(3)}, "rotation"),
        ({"translation": [0, 0]}, "translation"),
        ({"distortion": [0.1, 0.2]}, "distortion"),
        ({"distortion": [0.1, 0, 0, 0], "orthographic": True}, "orthographic"),
        ({"width": 0}, "width"),
        ({"height": 1.5}, "height"),
    ):
        with pytest.raises(InputError, match=match):
            camera(**changes)


def test_camera_in_the_wrong_place():
    refused("outside the sphere", view=camera(translation=[0, 0, 10]))
    refused("in front", view=camera(translation=[0, 0, -200]))
    refused("in front", view=camera(translation=[100, 0, 5]))
    refused("as large as the camera", view=camera(width=40))


def test_lens_that_folds_over():
    refused("inverted", view=camera(distortion=[-40.0, 0, 0, 0, 0]))


def test_images_that_are_none():
    refused("DataArray", np.ones((1, SIZE, SIZE)))
    refused("dimensions", ones().rename(light="lamp"))
    refused("real numbers", ones().astype(complex))


@pytest.mark.parametrize("value", [0.0, np.pi / 2, -1.0, 80.0, np.nan])
def test_max_angle(value):
    refused("max_angle", max_angle=value)


def test_sphere():
    for radius in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="radius"):
            Sphere([0, 0, 0], radius)
    refused("leaves no pixel", sphere=Sphere([0, 0, 0], 0.05))
    refused("leaves no pixel", grazing_px=40.0)


def test_noise():
    for given in ({}, {"read": -1.0}, {"gain": np.inf}, {"read": np.nan}):
        with pytest.raises(InputError, match="noise"):
            Noise(**given)
    refused("variance", variance=ones(2))
    refused("variance", variance=-ones())


def test_images_of_400_megapixels():
    side = 20000
    flat = np.broadcast_to(np.float32(1.0), (1, side, side, 1))
    images = xr.DataArray(flat, dims=("light", "row", "column", "channel"))

    def huge(focal):
        matrix = [[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]]
        return camera(width=side, height=side, matrix=matrix)

    refused("max_bytes", images, huge(90000.0))
    tracemalloc.start()
    samples = extract(images, huge(1000.0), [FRONT], SPHERE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert samples.sizes["sample"] > 20000 and peak < 60e6  # only the sphere's part of the image is touched


def test_more_samples_than_memory_may_take():
    count = 40
    message = refused("max_bytes", ones(count), lights=[FRONT] * count, max_bytes=4 << 20)
    assert "by_light" in message
