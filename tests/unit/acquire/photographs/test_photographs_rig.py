"""A rig with everything: camera from a board, near lights from two mirror balls, a colour chart, merged exposures."""

import numpy as np
import pytest
import tifffile
from deep_pictures import deep_png
from PIL import Image
from synthetic_camera import Faults, camera, lambert, render, sphere_for
from test_calibration import CAMERA, CHARUCO, MATRIX, chart, views
from test_lights import mirror

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.brdf.geometry import Light
from livlab.errors import InputError

ALBEDO = 0.5


def save(path, values):
    tifffile.imwrite(path, np.round(np.clip(values, 0, 1) * 65535).astype(np.uint16), photometric="minisblack")


def silhouette(cam, balls, sub=4):
    total = np.zeros((cam.height, cam.width))
    for ball in balls:
        lit = [Light(np.ones(1), direction=ball.centre_mm / np.linalg.norm(ball.centre_mm))]
        total += render(cam, ball, lit, lambert(), background=1.0, sub=sub)[0] - 1
    return 0.8 * (1 + total)


@pytest.fixture(scope="module")
def near(tmp_path_factory):
    """Two mirror balls and a matte one, all with one camera, under three near lights."""
    folder = tmp_path_factory.mktemp("near")
    cam = camera(300, 190, focal_px=900.0)
    balls = [sphere_for(cam, 60.0, (-75.0, 2.0)), sphere_for(cam, 60.0, (70.0, -3.0))]
    matte = sphere_for(cam, 45.0, (-5.0, 4.0))
    at = [matte.centre_mm + np.array(x) for x in ([90.0, -60, -150], [-110.0, -40, -140], [10.0, 100, -160])]
    lights = [Light(np.array([np.sum((p - matte.centre_mm) ** 2)]), position_mm=p) for p in at]
    save(folder / "balls.tif", silhouette(cam, balls))
    save(folder / "matte.tif", silhouette(cam, [matte]))
    for k, (light, image) in enumerate(zip(lights, render(cam, matte, lights, lambert(ALBEDO)), strict=True)):
        shown = sum(mirror(cam, ball, light.position_mm, half=np.deg2rad(1.5), sub=4) for ball in balls)
        save(folder / f"m{k}.tif", shown / 25)
        for name, t in (("long", 8.0), ("short", 2.0)):
            save(folder / f"{name}{k}.tif", Faults(exposure=t, gain=1e-5, seed=3)(image, k))
    pictures = '["m0.tif", "m1.tif", "m2.tif"]'
    text = ["format = 1", 'lights_are = "near"', "[camera]", 'kind = "pinhole"', "focal_px = 900.0"]
    text += [f"centre_px = [{cam.matrix[0, 2]}, {cam.matrix[1, 2]}]", "[sphere]", "radius_mm = 20.0"]
    text += ['outline = "matte.tif"', "[white]", f"value = [{1 / np.pi}]", "reflectance = 1.0", "light = 0"]
    for ball in balls:
        u, v = cam.project(ball.centre_mm)
        text += ["[[mirror]]", f"images = {pictures}", "radius_mm = 20.0", 'outline = "balls.tif"']
        text += [f"near = [{u:.0f}.0, {v:.0f}.0, 58.0]"]
    for k, light in enumerate(lights):
        text += ["[[light]]", f'images = ["long{k}.tif", "short{k}.tif"]', "exposures = [8.0, 2.0]"]
        text += [f"intensity = [{light.intensity[0]}]"]
    (folder / "rig.toml").write_text("\n".join(text))
    return folder, lights, matte


def test_near_lights_are_found_and_the_truth_comes_out(near):
    folder, lights, matte = near
    rig = open_rig(folder)
    for found, true, covariance in zip(rig.lights, lights, rig.light_covariances, strict=True):
        off = np.linalg.norm(found.position_mm - true.position_mm)
        assert off < 0.03 * np.linalg.norm(true.position_mm - matte.centre_mm)
        assert off < 4 * np.sqrt(np.trace(covariance))
    samples = extract_samples(rig).samples
    relative = samples["value"].values / (ALBEDO / np.pi) - 1
    assert np.sqrt(np.mean(relative**2)) < 0.05
    assert abs(np.mean(relative)) < 0.02


def test_the_same_lights_taken_as_distant_are_far_off(near):
    folder, *_ = near
    text = (folder / "rig.toml").read_text().replace('lights_are = "near"', 'lights_are = "distant"')
    text = "\n".join(line for line in text.splitlines() if not line.startswith("intensity"))
    (folder / "distant.toml").write_text(text)
    value = extract_samples(open_rig(folder / "distant.toml")).samples["value"].values
    assert np.std(value) / np.mean(value) > 0.1


def test_one_mirror_ball_is_not_enough_for_near_lights(near):
    folder, *_ = near
    text = (folder / "rig.toml").read_text()
    first, second = text.index("[[mirror]]"), text.rindex("[[mirror]]")
    (folder / "one.toml").write_text(text[:first] + text[second:])
    with pytest.raises(InputError, match="two mirror balls"):
        open_rig(folder / "one.toml")


def test_a_camera_from_a_board_and_colours_from_a_chart(tmp_path):
    sphere = sphere_for(CAMERA, 70.0, (20.0, -10.0))
    light = Light(np.ones(1), direction=np.array([0.3, -0.4, -0.8660254]))
    albedo = np.array([0.6, 0.4, 0.2])
    image = render(CAMERA, sphere, [light], lambert(1.0), sub=2)[0]
    seen = (image[..., None] * albedo) @ MATRIX.T
    deep_png(tmp_path / "0.png", np.round(np.clip(seen, 0, 1) * 65535).astype(np.uint16))
    deep_png(tmp_path / "chart.png", np.round(np.clip(chart(MATRIX, 0.9), 0, 1) * 65535).astype(np.uint16))
    save(tmp_path / "out.tif", silhouette(CAMERA, [sphere], sub=2))
    names = []
    for name, picture in views(CHARUCO)[:9]:
        Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(tmp_path / f"b{name}")
        names.append(f"b{name}")
    text = ["format = 1", "[camera]", 'kind = "board"', "[camera.board]", f"images = {names}".replace("'", '"')]
    text += ["columns = 9", "rows = 7", "square_mm = 20.0", "marker_mm = 15.0", 'dictionary = "DICT_4X4_100"']
    text += ["[sphere]", "radius_mm = 20.0", 'outline = "out.tif"', "[colour]", 'chart = "chart.png"']
    text += ["[[light]]", 'images = ["0.png"]', f"direction = {light.direction.tolist()}"]
    (tmp_path / "rig.toml").write_text("\n".join(text))
    rig = open_rig(tmp_path)
    assert rig.calibration.residual_px < 0.12
    assert rig.focal_sd < 0.005
    assert np.linalg.norm(rig.sphere.centre_mm - sphere.centre_mm) < 0.01 * np.linalg.norm(sphere.centre_mm)
    found = extract_samples(rig)
    mean = found.samples["value"].mean("sample").values
    # Ratios of the channels as they are in truth; the camera's own would be .54, .35, .22 over .54.
    np.testing.assert_allclose(mean / mean[0], albedo / albedo[0], atol=0.04)
    assert not any("lens distortion" in text for text in found.unresolved)
