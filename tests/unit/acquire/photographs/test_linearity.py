"""Declared responses, and what exposure stacks and matte spheres say about them."""

import numpy as np
import pytest

from livlab.acquire.photographs.linearity import CameraResponse, debevec, from_exposures, from_matte_sphere, response
from livlab.errors import InputError

RNG = np.random.default_rng(11)
TIMES = (1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4)


def scene(shape=(60, 80, 3)):
    """Radiances over three decades, smooth as pictures are."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    base = 10 ** (3 * (u / shape[1]) - 1.5)
    return base[..., None] * (1 + 0.3 * np.sin(v / 9))[..., None] * np.array([1.0, 0.8, 0.6])[: shape[2]]


def encoded(x, kind):
    x = np.clip(x, 0, 1)
    if kind == "srgb":
        return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return x ** (1 / kind)


def stack(kind, noise=0.002, offset=0.0):
    frames = []
    for t in TIMES:
        x = encoded(np.clip(scene() * t, 0, 1), kind) + offset
        frames.append(np.round(np.clip(x + RNG.normal(0, noise, x.shape), 0, 1) * 255) / 255)
    return frames


@pytest.mark.parametrize(("kind", "exponent"), [("srgb", None), ("gamma", 2.2), ("linear", 1.0)])
def test_declared_responses_invert_their_encoding(kind, exponent):
    x = np.linspace(0, 1, 101)[:, None]
    decoded = response(kind, gamma=exponent).decode(encoded(x, "srgb" if kind == "srgb" else exponent))
    np.testing.assert_allclose(decoded, x, atol=2e-4)


def test_slope_is_the_derivative():
    r = response("srgb")
    x = np.linspace(0.1, 0.9, 20)[:, None]
    numeric = (r.decode(x + 1e-3) - r.decode(x - 1e-3)) / 2e-3
    np.testing.assert_allclose(r.slope(x), numeric, rtol=2e-3)
    np.testing.assert_array_equal(response("linear").slope(x), np.ones_like(x))


def test_a_table_by_channel():
    table = np.column_stack([np.linspace(0, 2, 11), np.linspace(0, 2, 11) ** 2])
    found = response("table", table=table).decode(np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(found, [[0.5, 0.25]])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"kind": "cubic"}, "must be linear"),
        ({"kind": "gamma"}, "between 0.1 and 10"),
        ({"kind": "gamma", "gamma": 40.0}, "between 0.1 and 10"),
        ({"kind": "table", "table": [0.0, 0.5, 0.4, 1.0]}, "never fall"),
    ],
)
def test_wrong_responses_are_refused(arguments, said):
    with pytest.raises(InputError, match=said):
        response(**arguments)


def test_a_flat_table_is_refused():
    with pytest.raises(InputError, match="must rise"):
        CameraResponse("table", np.zeros(5))


def test_a_stack_says_linear_of_a_linear_camera():
    frames = stack(1.0)
    found = from_exposures(frames, TIMES, frames)
    assert found.verdict == "linear"
    assert found.gamma == pytest.approx(1.0, abs=0.01)
    assert found.contradiction("linear") is None


@pytest.mark.parametrize(("kind", "low", "high"), [(2.2, 2.1, 2.3), ("srgb", 1.8, 2.4)])
def test_a_stack_contradicts_linear_when_it_is_encoded(kind, low, high):
    frames = stack(kind)
    found = from_exposures(frames, TIMES, frames)
    assert found.verdict == "not linear"
    assert low < found.gamma < high
    assert "not what was declared" in found.contradiction("linear")


def test_a_stack_contradicts_srgb_when_it_is_linear():
    frames = stack(1.0)
    srgb = response("srgb")
    found = from_exposures([srgb.decode(f) for f in frames], TIMES, frames)
    assert found.verdict == "not linear"
    assert found.gamma < 0.6


def test_a_black_offset_is_told_from_a_gamma():
    frames = stack(1.0, offset=0.05)
    found = from_exposures(frames, TIMES, frames)
    assert found.verdict == "not linear"
    assert "black offset" in found.notes[0]


def test_a_stack_of_clipped_and_black_pictures_decides_nothing():
    frames = [np.zeros((20, 20, 1)), np.ones((20, 20, 1))]
    assert from_exposures(frames, (1.0, 4.0), frames).verdict == "undecided"


@pytest.mark.parametrize("kind", [1.0, 2.2, "srgb"])
def test_debevec_finds_the_response(kind):
    frames = [np.round(f * 255).astype(np.uint8) for f in stack(kind, noise=0.001)]
    found = debevec(frames, TIMES)
    x = np.linspace(0.1, 0.8, 20)
    decoded = found.decode(encoded(x, kind)[:, None].repeat(3, axis=1))
    # The scale is free: ratios are what it has to get right.
    ratio = decoded / x[:, None]
    np.testing.assert_allclose(ratio / ratio[10], 1, atol=0.06)
    linear = from_exposures([found.decode(f / 255) for f in frames], TIMES, [f / 255 for f in frames])
    assert linear.verdict == "linear"


@pytest.mark.parametrize(
    ("frames", "times", "said"),
    [
        ([np.zeros((9, 9, 3), np.uint8)], [1.0], "two at least"),
        ([np.zeros((9, 9, 3), np.uint8)] * 2, [1.0], "one each"),
        ([np.zeros((9, 9, 3), np.uint8)] * 2, [1.0, 1.0], "unlike"),
        ([np.zeros((9, 9, 3), np.uint8)] * 2, [1.0, -1.0], "> 0"),
        ([np.zeros((9, 9, 3), np.uint8), np.zeros((9, 8, 3), np.uint8)], [1.0, 2.0], "one size"),
        ([np.zeros((9, 9, 3), np.uint16)] * 2, [1.0, 2.0], "8-bit"),
    ],
)
def test_wrong_stacks_are_refused(frames, times, said):
    with pytest.raises(InputError, match=said):
        debevec(frames, times)


def matte(exponent, gloss=0.0):
    normals = RNG.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lights = RNG.normal(size=(8, 3)) + np.array([0, 0, 3])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    cosines = lights @ normals.T
    x = np.clip(cosines, 0, None) * (1 + RNG.normal(0, 0.03, cosines.shape)) + gloss * np.clip(cosines, 0, 1) ** 60
    return np.clip(x, 0, None) ** (1 / exponent), cosines


@pytest.mark.parametrize(("exponent", "verdict"), [(1.0, "linear"), (2.2, "not linear"), (0.5, "not linear")])
def test_a_matte_sphere_tells_the_exponent(exponent, verdict):
    found = from_matte_sphere(*matte(exponent))
    assert found.verdict == verdict
    assert found.gamma == pytest.approx(exponent, rel=0.02)


def test_a_mirror_is_no_matte_sphere():
    values, cosines = matte(1.0, gloss=20.0)
    found = from_matte_sphere(values, cosines)
    assert found.verdict == "undecided"
    assert "not matte" in found.notes[0]
    assert np.isnan(found.gamma)  # a bound that was hit is not found
    assert found.told().startswith("undecided: the sphere is not matte")


def test_srgb_taken_as_linear_is_named_with_its_remedy():
    values, cosines = matte(1.0)
    bent = np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.clip(values, 0.003, None) ** (1 / 2.4) - 0.055)
    told = from_matte_sphere(bent, cosines).contradiction("linear")
    assert told is not None
    assert 'kind = "srgb" under [response]' in told


def test_too_few_values_are_refused():
    with pytest.raises(InputError, match="hundred"):
        from_matte_sphere(np.ones((1, 50)), np.ones((1, 50)))
