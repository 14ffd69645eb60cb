"""DiLiGenT's layout: read as it is, refused where its files do not fit each other."""

import numpy as np
import pytest
from deep_pictures import deep_png
from PIL import Image
from synthetic_camera import camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.diligent import load_folder
from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.errors import InputError

INTENSITIES = np.array([[1.0, 0.9, 0.8], [1.4, 1.5, 1.6], [0.7, 0.7, 0.7], [1.1, 1.0, 0.9]])


@pytest.fixture
def folder(tmp_path):
    # From far away a sphere is what the orthographic camera of the layout takes it for.
    cam = camera(120, 110, focal_px=40000.0)
    sphere = sphere_for(cam, 40.0, (-3.0, 2.0))
    lights = ring(4, 35)
    images = render(cam, sphere, lights, lambert(0.5))
    for k, image in enumerate(images):
        scaled = image[..., None] * INTENSITIES[k] * 2.0
        deep_png(tmp_path / f"{k:03d}.png", np.round(scaled * 65535).astype(np.uint16))
    mask = render(cam, sphere, lights[:1], lambert(), background=9.0)[0] < 4.5
    Image.fromarray(mask.astype(np.uint8) * 255).save(tmp_path / "mask.png")
    (tmp_path / "filenames.txt").write_text("".join(f"{k:03d}.png\r\n" for k in range(4)))
    up = [light.direction * [1, -1, -1] for light in lights]
    (tmp_path / "light_directions.txt").write_text("".join(" ".join(f"{x:.8f}" for x in d) + "\n" for d in up))
    rows = (" ".join(map(str, row)) for row in INTENSITIES)
    (tmp_path / "light_intensities.txt").write_text("\n".join(rows) + "\n")
    return tmp_path


def test_the_truth_comes_out_up_to_a_factor(folder):
    rig = open_rig(folder)
    assert rig.camera.orthographic
    np.testing.assert_allclose(rig.pose.circle_px[2], 40.0, atol=0.15)
    found = extract_samples(rig)
    value = found.samples["value"].values
    assert value.shape[1] == 3
    assert np.std(value) / np.mean(value) < 0.02
    assert found.linearity.verdict == "linear"
    assert "factor" in found.samples.attrs["scale"] or "arbitrary" in found.samples.attrs["scale"]
    assert found.samples["channel"].values.tolist() == ["R", "G", "B"]


def test_directions_run_x_right_y_up_z_to_the_camera(folder):
    wrong = folder / "light_directions.txt"
    rows = np.loadtxt(wrong)
    np.savetxt(wrong, rows * [1, -1, 1])  # as if y ran down
    value = extract_samples(load_folder(folder)).samples["value"].values
    assert np.std(value) / np.mean(value) > 0.2


def test_without_mask_and_intensities(folder):
    (folder / "mask.png").unlink()
    (folder / "light_intensities.txt").unlink()
    rig = load_folder(folder)
    assert rig.mask is None
    assert rig.lights[0].intensity.tolist() == [1.0]


def replaced(name, old, new):
    def spoil(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return spoil


def cut(name):
    def spoil(folder):
        lines = (folder / name).read_text().splitlines()
        (folder / name).write_text("\n".join(lines[:-1]))

    return spoil


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (cut("light_directions.txt"), "one line for each picture"),
        (cut("light_intensities.txt"), "one line for each picture"),
        (replaced("light_intensities.txt", "1.4 1.5", "0.0 1.5"), "line 2.*must be > 0"),
        (replaced("light_intensities.txt", "1.4 1.5", "-1.0 1.5"), "line 2.*must be > 0"),
        (replaced("light_intensities.txt", "1.4 1.5", "x 1.5"), "line 2.*finite numbers"),
        (replaced("light_intensities.txt", "1.4 1.5", "1.5"), "line 2.*finite numbers"),
        (replaced("light_directions.txt", "0.", "3."), "unit length"),
        (replaced("light_directions.txt", "0.", "nan "), "finite numbers"),
        (replaced("filenames.txt", "002.png", "../002.png"), "climb out"),
        (replaced("filenames.txt", "002.png", "777.png"), "is not a file"),
        (lambda f: (f / "filenames.txt").write_text(""), "is empty"),
        (lambda f: (f / "light_directions.txt").unlink(), "is missing"),
        (lambda f: Image.fromarray(np.zeros((9, 9), np.uint8)).save(f / "mask.png"), "must be the camera's"),
        (lambda f: deep_png(f / "002.png", np.zeros((9, 9, 3), np.uint16)), "must be 120x110"),
    ],
)
def test_what_does_not_fit_is_refused(folder, spoil, said):
    spoil(folder)
    with pytest.raises(InputError, match=said):
        extract_samples(load_folder(folder))


def test_a_folder_that_is_no_rig(tmp_path):
    with pytest.raises(InputError, match="is no rig file"):
        open_rig(tmp_path)
