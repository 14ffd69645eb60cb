"""The two photographed balls: what the README of the photographs says about them has to come out."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.acquire.photographs.pose import sphere_pose
from livlab.acquire.photographs.read import read_photograph
from livlab.brdf.geometry import Camera

PHOTOS = Path(__file__).resolve().parents[5] / "shared" / "photos"
COUNT = 12

pytestmark = [
    pytest.mark.photos,
    pytest.mark.skipif(not (PHOTOS / "gray").is_dir(), reason="the photographs beside the checkout are missing"),
]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    for name in ("gray", "chrome"):
        shutil.copytree(PHOTOS / name, folder / name)
    lines = ["format = 1", 'mask = "gray/mask.png"', "[camera]", 'kind = "orthographic"', "[sphere]"]
    lines += ['outline = "gray/mask.png"', "[[mirror]]", 'outline = "chrome/mask.png"']
    lines += [f"images = {[f'chrome/light{k:02d}.png' for k in range(COUNT)]}".replace("'", '"')]
    for k in range(COUNT):
        lines += ["[[light]]", f'images = ["gray/light{k:02d}.png"]']
    (folder / "rig.toml").write_text("\n".join(lines))
    return open_rig(folder)


@pytest.mark.parametrize(
    ("name", "centre", "radius"), [("chrome", (253.27, 147.77), 119.48), ("gray", (244.50, 144.50), 108.25)]
)
def test_circles(name, centre, radius):
    mask = read_photograph(PHOTOS / name / "mask.png").values
    matrix = np.array([[1, 0, 255.5], [0, 1, 169.5], [0, 0, 1.0]])
    pose = sphere_pose(mask, Camera(512, 340, matrix, orthographic=True), kind="silhouette")
    assert np.hypot(pose.circle_px[0] - centre[0], pose.circle_px[1] - centre[1]) < 0.3
    assert abs(pose.circle_px[2] - radius) < 0.5


def test_light_directions_come_from_the_chrome_ball(rig):
    directions = np.array([light.direction for light in rig.lights])
    # All twelve stand above and beside the camera (y runs down, z away from it).
    assert np.all(directions[:, 1] < 0)
    assert np.all(directions[:, 2] < -0.7)
    told = np.rad2deg([h.sd_rad for balls in rig.highlights for h in balls])
    assert np.all((told > 0.2) & (told < 1.0))  # a pixel is about a degree
    assert all(h.saturated > 0.5 for balls in rig.highlights for h in balls)


def test_the_grey_ball_is_lambertian_to_6_5_percent_and_linear(rig):
    whole = rig.matte_linearity(highlight=0.0)
    assert whole.residual <= 0.065
    for found in (whole, rig.matte_linearity()):
        assert found.verdict == "linear"
        assert found.residual_srgb > 0.2
        assert abs(found.gamma - 1) < 0.15


def test_turned_lights_fit_worse(rig):
    import dataclasses

    turned = [dataclasses.replace(x, direction=np.roll(x.direction, 1)) for x in rig.lights]
    assert dataclasses.replace(rig, lights=tuple(turned)).matte_linearity().residual > 0.2


def test_samples(rig):
    found = extract_samples(rig)
    assert found.samples.sizes["sample"] > 300_000
    assert found.samples.attrs["scale"].startswith("arbitrary")
    for fault in ("vignetting", "dark offset", "stray light", "white reference", "perspective"):
        assert any(fault in text for text in found.unresolved)
