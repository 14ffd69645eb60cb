"""What people really have: turned pictures, other units, frames and orders, a ball that the frame cuts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image
from synthetic_camera import blinn_phong, camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.errors import ConfigError, InputError

ALBEDO = 0.6
CAMERA = camera(110, 100, focal_px=400.0)
SPHERE = sphere_for(CAMERA, 35.0, (-4.0, 5.0))
RINGS = [(35, 3), (65, 4)]
LIGHTS = [light for angle, count in RINGS for light in ring(count, angle)]
UP = [light.direction * [1, -1, -1] for light in LIGHTS]  # x right, y up, z to the camera
MATTE = render(CAMERA, SPHERE, LIGHTS, lambert(ALBEDO))
GLOSSY = render(CAMERA, SPHERE, LIGHTS, blinn_phong(0.15, 0.5, 40.0))


def write(folder, directions, images=MATTE, *, more="", sphere="radius_mm = 20.0", frame="photometric-stereo", left=0):
    for k, image in enumerate(images):
        stored = np.round(image[:, left:] * 240 / images.max()).astype(np.uint8)
        Image.fromarray(stored).save(folder / f"{k}.png")
    back = render(CAMERA, SPHERE, LIGHTS[:1], lambert(), background=9.0)[0] > 4.5
    Image.fromarray((back[:, left:] * 255).astype(np.uint8)).save(folder / "outline.png")
    centre = [CAMERA.matrix[0, 2] - left, CAMERA.matrix[1, 2]]
    lines = ["format = 1", f'frame = "{frame}"', "[camera]", 'kind = "pinhole"', f"focal_px = {CAMERA.matrix[0, 0]}"]
    lines += [f"centre_px = {[float(x) for x in centre]}", "[sphere]", 'outline = "outline.png"', sphere, more]
    for k, entry in enumerate(directions):
        said = entry if isinstance(entry, str) else f"direction = {[float(x) for x in entry]}"
        lines += ["[[light]]", f'images = ["{k}.png"]', said]
    path = folder / "rig.toml"
    path.write_text("\n".join(lines))
    return path


def warnings_of(path):
    return extract_samples(open_rig(path)).warnings


@pytest.mark.parametrize("images", [MATTE, GLOSSY], ids=["matte", "glossy"])
def test_lights_where_they_are_said_to_be_are_not_doubted(tmp_path, images):
    assert warnings_of(write(tmp_path, UP, images)) == ()


@pytest.mark.parametrize("images", [MATTE, GLOSSY], ids=["matte", "glossy"])
@pytest.mark.parametrize(
    ("signs", "frame", "said"),
    [
        ([1, 1, 1], "camera", "the other frame"),
        ([1, -1, -1], "photometric-stereo", "the other frame"),
        ([1, -1, 1], "photometric-stereo", "up and down exchanged"),
        ([-1, 1, 1], "photometric-stereo", "left and right exchanged"),
        ([-1, -1, -1], "photometric-stereo", "lead from the light to the sphere"),
    ],
)
def test_a_slip_of_signs_is_told_with_its_name(tmp_path, images, signs, frame, said):
    rig = open_rig(write(tmp_path, [d * signs for d in UP], images, frame=frame))
    try:
        found = extract_samples(rig)
    except InputError as error:  # lights from behind give no sample, or nothing is lit where it should be
        told = error.remedy
    else:
        told = found.warnings[0]
        assert not any("interreflection" in text for text in found.warnings)
        assert found.linearity is None  # nor is it judged whether they are linear
    assert "look lit from elsewhere" in told
    assert said in told


def test_pictures_in_another_order_are_told(tmp_path):
    told = warnings_of(write(tmp_path, [*UP[1:], UP[0]]))
    assert "another order" in told[0]
    assert "the direction of light 0 fits picture 1" in told[0]


def test_one_wrong_light_is_named(tmp_path):
    told = warnings_of(write(tmp_path, [*UP[:5], -UP[5] * [1, 1, -1], UP[6]]))
    assert told[0].startswith("1 of 7 pictures look lit from elsewhere than their lights' directions say (light 5 by")
    assert "check the entries of light 5" in told[0]


def test_angles_are_as_good_as_vectors(tmp_path):
    (tmp_path / "a").mkdir()
    given = [f"direction_deg = [{math.degrees(math.acos(d[2]))}, {math.degrees(math.atan2(d[1], d[0]))}]" for d in UP]
    by_angle = open_rig(write(tmp_path, given)).lights
    by_vector = open_rig(write(tmp_path / "a", [d * 1234 for d in UP]))
    for one, other in zip(by_angle, by_vector.lights, strict=True):
        np.testing.assert_allclose(one.direction, other.direction, atol=1e-12)
    assert any("length 1234 to 1234 are scaled to 1" in note for note in by_vector.notes)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("direction_deg = [200.0, 0.0]", "0 to 180 degrees"),
        ("direction_deg = [20.0, 0.0]\ndirection = [0.0, 0.0, 1.0]", "must not both be given"),
        ("direction_deg = [20.0]", "at least 2"),
        ("angles = [20.0, 0.0]", "unknown key"),
        ("direction = [20.0, 30.0]", "at least 3"),
    ],
)
def test_wrong_angles_are_refused_with_their_key(tmp_path, entry, said):
    with pytest.raises((ConfigError, InputError), match=said) as caught:
        open_rig(write(tmp_path, [entry, *UP[1:]]))
    assert "light[0]" in caught.value.message


@pytest.mark.parametrize(("radius", "told"), [(0.02, True), (20.0, False), (20_000.0, True)])
def test_a_radius_in_another_unit_is_doubted(tmp_path, radius, told):
    found = warnings_of(write(tmp_path, UP, sphere=f"radius_mm = {radius}"))
    assert any("Say it in millimetres" in text for text in found) == told


def test_a_mirror_ball_of_another_unit_is_doubted(tmp_path):
    # Far from being a mirror's: all that counts here is that its size does not fit its place.
    spots = render(CAMERA, SPHERE, LIGHTS, blinn_phong(0.0, 1.0, 3000.0))
    for k, image in enumerate(spots):
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(tmp_path / f"m{k}.png")
    names = ", ".join(f'"m{k}.png"' for k in range(len(spots)))
    more = f'[[mirror]]\nimages = [{names}]\noutline = "outline.png"\nradius_mm = '
    good = open_rig(write(tmp_path, UP, more=f"{more}20.0"))
    assert not any("mirror" in text for text in good.warnings)
    diameter = open_rig(write(tmp_path, UP, more=f"{more}40.0"))
    assert any("mirror[0].radius_mm" in text and "diameter" in text for text in diameter.warnings)


def test_a_picture_that_exif_turns_is_taken_as_stored_and_told(tmp_path):
    path = write(tmp_path, UP)
    upright = extract_samples(open_rig(path))
    tag = Image.Exif()
    tag[0x0112] = 6
    for k in (2, 3):
        Image.open(tmp_path / f"{k}.png").save(tmp_path / f"{k}.png", exif=tag)
    found = extract_samples(open_rig(path))
    assert any(text.startswith("2.png and 1 more: EXIF") for text in found.warnings)
    np.testing.assert_array_equal(found.samples["value"].values, upright.samples["value"].values)


def test_a_ball_cut_by_the_frame_is_refused_or_taken_on_request(tmp_path):
    left = 40
    with pytest.raises(InputError, match="cut by the frame") as caught:
        open_rig(write(tmp_path, UP, left=left))
    assert "cut = true under [sphere]" in caught.value.remedy
    rig = open_rig(write(tmp_path, UP, left=left, sphere="radius_mm = 20.0\ncut = true"))
    assert np.all(np.abs(rig.sphere.centre_mm - SPHERE.centre_mm) < [0.1, 0.1, 1.5])
    found = extract_samples(rig)
    whole = extract_samples(open_rig(write(tmp_path, UP)))
    assert 0.5 < found.samples.sizes["sample"] / whole.samples.sizes["sample"] < 0.9
    value = found.samples["value"].values
    assert np.std(value) / np.mean(value) < 0.02


def test_a_missing_picture_is_named_with_the_one_that_was_meant(tmp_path):
    path = write(tmp_path, UP)
    (tmp_path / "4.png").rename(tmp_path / "4.PNG")
    with pytest.raises(InputError, match=r"4\.png") as caught:
        extract_samples(open_rig(path))
    assert caught.value.remedy == "Did you mean '4.PNG'?"
    (tmp_path / "4.PNG").unlink()
    with pytest.raises(InputError, match="is not a file") as caught:
        extract_samples(open_rig(path))
    assert caught.value.remedy == "Check the path."
