"""The two photographed balls: what the README of the photographs says about them has to come out."""

import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.light_table import light_table
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
    turned = [dataclasses.replace(x, direction=np.roll(x.direction, 1)) for x in rig.lights]
    assert dataclasses.replace(rig, lights=tuple(turned)).matte_linearity().residual > 0.2


def test_samples(rig):
    found = extract_samples(rig)
    assert found.samples.sizes["sample"] > 300_000
    assert found.samples.attrs["scale"].startswith("arbitrary")
    for fault in ("vignetting", "dark offset", "stray light", "white reference", "perspective"):
        assert any(fault in text for text in found.unresolved)


def said(rig, lights):
    return light_table(dataclasses.replace(rig, lights=tuple(lights))).warnings


def test_the_lights_of_the_real_ball_are_not_doubted(rig):
    found = light_table(rig)
    assert found.warnings == ()
    assert found.table["verdict"].eq("agrees").all()
    assert found.check.residual < 0.06
    assert np.all(np.abs(found.table["gain"] - 1) < 0.03)


def test_its_y_axis_turned_down_is_told_as_such(rig):
    lights = [dataclasses.replace(x, direction=x.direction * [1, -1, 1]) for x in rig.lights]
    found = light_table(dataclasses.replace(rig, lights=tuple(lights)))
    assert "up and down exchanged" in found.warnings[0]
    assert found.check.residual > 0.25 and found.check.residual_best < 0.06
    told = extract_samples(dataclasses.replace(rig, lights=tuple(lights)))
    assert told.linearity is None and not any("not matte" in w for w in told.warnings)


@pytest.mark.parametrize("pair", [(7, 9), (1, 10), (8, 9), (3, 11), (2, 10)])
def test_two_of_its_lights_exchanged_are_told(rig, pair):
    lights = list(rig.lights)
    lights[pair[0]], lights[pair[1]] = lights[pair[1]], lights[pair[0]]
    assert f"lights {pair[0]} and {pair[1]} exchanged" in said(rig, lights)[0]


def test_other_slips_of_its_lights_are_told(rig):
    lights = list(rig.lights)
    assert "shifted by 1" in said(rig, lights[1:] + lights[:1])[0]
    assert "reversed" in said(rig, lights[::-1])[0]
    turn = Rotation.from_rotvec(np.deg2rad([0, 0, 8])).as_matrix()
    turned = [dataclasses.replace(x, direction=turn @ x.direction) for x in lights]
    assert "turned by" in said(rig, turned)[0]
    brighter = [dataclasses.replace(x, intensity=x.intensity * (1.25 if k == 4 else 1)) for k, x in enumerate(lights)]
    assert re.match(r"Light 4 is 0\.(79|80|81) ", said(rig, brighter)[0])


def test_the_mirror_ball_alone_gives_the_same_directions(rig, tmp_path):
    shutil.copytree(PHOTOS / "chrome", tmp_path / "chrome")
    names = ", ".join(f'"chrome/light{k:02d}.png"' for k in range(COUNT))
    head = 'format = 1\n[camera]\nkind = "orthographic"\n[[mirror]]\noutline = "chrome/mask.png"\n'
    (tmp_path / "rig.toml").write_text(f"{head}images = [{names}]\n")
    table = light_table(tmp_path).table
    np.testing.assert_allclose(table[["x", "y", "z"]], [x.direction for x in rig.lights], atol=1e-12)
