"""What storing a picture costs: masks that are no photographs, responses of their own, steps, compression, sums."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from synthetic_camera import camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.lossy import mean_square, measured_scatter
from livlab.acquire.photographs.merge import estimate_noise
from livlab.acquire.photographs.open import open_rig
from livlab.errors import ConfigError, InputError

CAMERA = camera(180, 170, focal_px=600.0)
SPHERE = sphere_for(CAMERA, 60.0, (-4.0, 5.0))
LIGHTS = ring(3, 40)
IMAGES = render(CAMERA, SPHERE, LIGHTS, lambert(0.6), sub=3)
IMAGES = IMAGES * 0.8 / IMAGES.max()
SHADE = render(CAMERA, SPHERE, LIGHTS[:1], lambert(1e-9), background=1.0)[0]  # 1 beside the ball, shares at its edge


def srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-12) ** (1 / 2.4) - 0.055)


def write(folder, *, suffix="png", quality=90, noise=0.0, response="", channels=1, outline=None, tint=(1.0, 1.0, 1.0)):
    rng = np.random.default_rng(3)
    for k, image in enumerate(IMAGES):
        x = image[..., None] * np.array(tint)[:channels]
        x = x + rng.normal(size=x.shape) * noise * np.sqrt(0.1 + np.clip(x, 0, None))
        stored = np.round(255 * srgb(np.clip(x, 0, 1))).astype(np.uint8)
        more = {"quality": quality} if suffix == "jpg" else {}
        Image.fromarray(stored[..., 0] if channels == 1 else stored).save(folder / f"{k}.{suffix}", **more)
    Image.fromarray(np.round(255 * (SHADE if outline is None else outline)).astype(np.uint8)).save(folder / "mask.png")
    lines = ["format = 1", "[camera]", 'kind = "pinhole"', f"focal_px = {CAMERA.matrix[0, 0]}"]
    lines += [f"centre_px = {[float(x) for x in CAMERA.matrix[:2, 2]]}", "[sphere]", "radius_mm = 20.0"]
    lines += ['outline = "mask.png"', "[response]", 'kind = "srgb"', response]
    for k, light in enumerate(LIGHTS):
        lines += ["[[light]]", f'images = ["{k}.{suffix}"]', f"direction = {light.direction.tolist()}"]
    (folder / "rig.toml").write_text("\n".join(lines))
    return folder


def pose_off(rig):
    return (rig.pose.circle_px[2] - truth_px()) / rig.pose.circle_sd_px[2]


def truth_px():
    curve = SPHERE.outline(CAMERA, 720)
    middle = curve.mean(axis=0)
    return float(np.linalg.norm(curve - middle, axis=1).mean())


def test_a_mask_is_not_decoded(tmp_path):
    assert abs(pose_off(open_rig(write(tmp_path)))) < 2
    # Said to be sRGB itself, it is decoded: half way between its levels lies elsewhere.
    decoded = open_rig(write(tmp_path, response='[[response.own]]\nimages = ["mask.png"]\nkind = "srgb"'))
    assert abs(pose_off(decoded)) > 5


def test_a_silhouette_that_is_a_photograph_is_decoded(tmp_path):
    """Of grey ground and dark ball, stored as sRGB, with noise: no mask, whatever its edge looks like."""
    rng = np.random.default_rng(1)
    grey = srgb(np.clip(0.02 + 0.6 * SHADE + 0.002 * rng.normal(size=SHADE.shape), 0, 1))
    assert abs(pose_off(open_rig(write(tmp_path, outline=grey)))) < 3


def test_any_picture_can_have_its_own_response(tmp_path):
    """One picture linear among encoded ones, said so: the reflectance comes out as one."""
    folder = write(tmp_path, response='[[response.own]]\nimages = ["1.png"]\nkind = "linear"')
    Image.fromarray(np.round(255 * IMAGES[1]).astype(np.uint8)).save(folder / "1.png")
    value = extract_samples(open_rig(folder)).samples["value"].values
    assert np.std(value) / np.mean(value) < 0.02
    path = folder / "rig.toml"
    path.write_text(path.read_text().replace('images = ["1.png"]\nkind', 'images = ["11.png"]\nkind'))
    with pytest.raises((InputError, ConfigError), match="is no picture of this rig"):
        open_rig(folder)


def z_of(folder):
    samples = extract_samples(open_rig(folder)).samples
    inner = (samples["theta_i"].values < 1.0) & (samples["theta_o"].values < 1.0)
    value, error = samples["value"].values[inner], samples["standard_error"].values[inner]
    return (value - np.median(value, axis=0)) / error


@pytest.mark.parametrize(("noise", "least"), [(0.0, 0.6), (0.005, 0.88), (0.02, 0.92)])
def test_steps_of_eight_bits_are_in_the_error(tmp_path, noise, least):
    """Without any noise the pattern of steps on a ball is taken for some: then the error is rather too large."""
    z = z_of(write(tmp_path, noise=noise))
    assert z.size > 3000
    assert least < np.sqrt(np.mean(z**2)) < 1.12
    assert np.max(np.abs(z)) < 6


@pytest.mark.parametrize(
    ("quality", "noise", "channels", "tint"),
    [(95, 0.0, 1, (1, 1, 1)), (75, 0.0, 1, (1, 1, 1)), (85, 0.01, 1, (1, 1, 1)), (75, 0.01, 3, (1, 0.8, 0.6))],
)
def test_compression_is_in_the_error(tmp_path, quality, noise, channels, tint):
    """Rather too large than too small, by a factor of 2.5 at most; z was up to 6."""
    z = z_of(write(tmp_path, suffix="jpg", quality=quality, noise=noise, channels=channels, tint=tint))
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.5


def test_scatter_is_that_of_the_blocks():
    """Blocks with errors of known variance on a ramp: the measure finds it, and none where there are no blocks."""
    rng = np.random.default_rng(0)
    ramp = np.add.outer(np.linspace(60, 120, 320), np.linspace(0, 60, 320))
    steps = np.kron(rng.normal(size=(40, 40)), np.ones((8, 8)))
    found = measured_scatter((ramp + 2 * steps)[..., None])
    # Constants make jumps of 2 σ², slopes more: what is in between is taken.
    assert found.variance.mean() == pytest.approx(4 * 2 / 24**0.5, rel=0.15)
    assert measured_scatter(ramp[..., None] + rng.normal(size=(320, 320, 1))).variance.mean() < 0.2
    assert measured_scatter(np.zeros((20, 400, 1))) is None


def test_mean_square_without_edges():
    rng = np.random.default_rng(2)
    x = rng.normal(size=200_000)
    x[:2000] = 50.0
    assert mean_square(x) == pytest.approx(1, abs=0.06)


def test_noise_is_not_told_twice():
    """Rounded values: the steps' share is told beside, so that what is estimated is the rest."""
    rng = np.random.default_rng(4)
    level = np.add.outer(np.linspace(0, 200, 300), np.linspace(0, 40, 300))
    for sd in (0.0, 0.5, 2.0):
        found = estimate_noise(np.round(level + sd * rng.normal(size=level.shape)), 1 / 12)
        got = 0.0 if found is None else np.sqrt(found.read**2 + found.gain * 100)
        assert got == pytest.approx(sd, abs=0.12)


def test_what_is_grouped_is_summed(tmp_path):
    folder = write(tmp_path)
    counts = (3, 5, 7)
    for k, count in enumerate(counts):
        picture = np.array(Image.open(folder / f"{k}.png"))
        picture[80, 60 : 60 + count] = 255
        Image.fromarray(picture).save(folder / f"{k}.png")
    told = [w for w in extract_samples(open_rig(folder)).warnings if "clipped" in w]
    assert told == ["3 lights: 15 values are clipped and left out. (most under light 2: 7)"]
