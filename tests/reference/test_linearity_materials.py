"""What spheres of known materials say about known encodings: a verdict, where there is one, is never the wrong one."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest

from livlab.acquire.photographs.linearity import Linearity
from livlab.acquire.photographs.merge import Merged
from livlab.acquire.photographs.rig import DevelopedFrames, PhotographedRig
from livlab.brdf.angles import local_frames
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.models.model import model

PIXELS = 41
ENCODED = {"linear": None, "sRGB": "srgb", "gamma 1.8": 1.8, "gamma 2.2": 2.2}
MATERIALS = {
    "matte": ("lambert", {"kd": 0.4}),
    **{f"rough {s}": ("oren-nayar", {"kd": 0.4, "sigma": s}) for s in (0.3, 0.6, 0.9)},
    **{
        f"plastic {a} on {kd}": ("plastic", {"kd": kd, "alpha": a, "eta": 1.5, "ks": 1.0})
        for a, kd in itertools.product((0.05, 0.15, 0.4), (0.05, 0.4))
    },
    **{f"metal {a}": ("ggx", {"ks": 0.8, "alpha": a, "eta": 3.0}) for a in (0.1, 0.4)},
}


def ring(angle: float, count: int) -> np.ndarray:
    at, a = np.arange(count) * 2 * np.pi / count, np.deg2rad(angle)
    return np.stack([np.sin(a) * np.cos(at), np.sin(a) * np.sin(at), np.full(count, -np.cos(a))], axis=1)


LIGHTS = {
    "two rings": np.concatenate([ring(35, 6), ring(70, 6)]),
    "three": ring(35, 3),
    "three from the side": ring(60, 3),
    "one beside the camera": ring(5, 1),
    "ring beside the camera": ring(15, 6),
}


def encoded(linear: np.ndarray, how: str) -> np.ndarray:
    """8-bit values of a camera whose highlights clip at the 99.5th percentile."""
    x = np.clip(linear * 0.95 / np.quantile(linear, 0.995), 0, 1)
    if how == "sRGB":
        x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-12) ** (1 / 2.4) - 0.055)
    elif how != "linear":
        x = x ** (1 / ENCODED[how])
    stored = np.round(255 * x)
    return np.where(stored < 255, stored / 255, np.nan)


MATRIX = np.array([[1.0, 0, PIXELS // 2], [0, 1.0, PIXELS // 2], [0, 0, 1]])
CAMERA = Camera(PIXELS, PIXELS, MATRIX, orthographic=True)
SPHERE = Sphere([0.0, 0.0, 300.0], PIXELS / 2 - 1.5)


@functools.cache
def pictures(material: str, lights: str) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(PIXELS), np.arange(PIXELS))
    origins, towards = CAMERA.rays(columns, rows)
    hits = SPHERE.meet(origins, towards)
    name, parameters = MATERIALS[material]
    given = {k: np.array([v]) for k, v in parameters.items()}
    frames = local_frames(hits.normals[hits.hit], np.array([0.0, 1.0, 0.0]))
    eye = np.einsum("nij,nj->ni", frames, -towards[hits.hit])
    made = np.zeros((len(LIGHTS[lights]), PIXELS, PIXELS))
    for k, light in enumerate(LIGHTS[lights]):
        wi = frames @ light
        lit = wi[:, 2] > 0.01
        value = np.zeros(len(wi))
        value[lit] = model(name).evaluate(wi[lit], eye[lit], given)[..., 0] * wi[lit, 2]
        made[k][hits.hit] = value
    return made


def verdict(material: str, how: str, lights: str) -> Linearity:
    stored = encoded(pictures(material, lights), how)[..., None].astype(np.float32)
    shots = DevelopedFrames(lambda k: Merged(stored[k], stored[k], 0.0, 0.0, (1.0,)), len(stored), stored.shape[1:])
    rig = PhotographedRig(
        "made", shots, ("grey",), CAMERA, tuple(Light([1.0], direction=d) for d in LIGHTS[lights]), SPHERE, None,
        np.zeros((4, 4)), tuple(np.zeros((3, 3)) for _ in stored), np.ones(1),
    )  # fmt: skip
    return rig.matte_linearity()


@pytest.mark.parametrize("lights", LIGHTS)
@pytest.mark.parametrize("material", MATERIALS)
def test_no_verdict_is_wrong(material: str, lights: str) -> None:
    for how in ENCODED:
        found = verdict(material, how, lights)
        assert found.verdict in ({"linear"} if how == "linear" else {"not linear"}) | {"undecided"}, (how, found)
        if found.verdict == "undecided":
            assert np.isnan(found.gamma)
            assert np.isinf(found.standard_error)
            assert "exponent 0" not in found.told()
            assert "would tell" in found.told()
            assert found.contradiction("linear") is None


@pytest.mark.parametrize("lights", ["two rings", "three", "three from the side"])
@pytest.mark.parametrize(
    "material", ["matte", "rough 0.3", "plastic 0.05 on 0.4", "plastic 0.15 on 0.4", "plastic 0.15 on 0.05"]
)
def test_lights_from_the_side_tell_an_encoding_by_common_materials(material: str, lights: str) -> None:
    assert [verdict(material, how, lights).verdict for how in ENCODED] == ["linear"] + ["not linear"] * 3


@pytest.mark.parametrize("how", ENCODED)
def test_a_metal_tells_nothing(how: str) -> None:
    assert verdict("metal 0.1", how, "two rings").verdict == "undecided"
