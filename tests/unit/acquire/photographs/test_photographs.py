"""Photographs to samples: a synthetic camera's faults one by one, corrected where calibrated, else told."""

import dataclasses

import numpy as np
import pytest
import tifffile
from PIL import Image
from synthetic_camera import Faults, camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.errors import InputError

RADIUS_PX = 40.0
ALBEDO = 0.6
LENS = (-0.25, 0.05, 0.001, -0.001, 0.0)
WHITE = 0.99


@dataclasses.dataclass
class Shot:
    """A scene on disk: what the camera saw, and what a rig file may say about it."""

    folder: object
    cam: object
    sphere: object
    lights: list
    images: np.ndarray

    def write(self, faults, **tables):
        """Pictures through faults, and the rig file; returns its path. `white` is what the target truly gives."""
        for k, image in enumerate(self.images):
            save(self.folder / f"{k}.tif", faults(image, k))
        save(self.folder / "outline.tif", faults(outline(self) * 0.8 / faults.exposure, 90))
        save(self.folder / "board.tif", faults(np.full(self.images[0].shape, 0.5 / faults.exposure), 91))
        save(self.folder / "dark.tif", faults(np.zeros(self.images[0].shape), 92))
        target = np.zeros(self.images[0].shape)
        target[60:80, 60:80] = WHITE / np.pi
        save(self.folder / "white.tif", faults(target, 93))
        path = self.folder / "rig.toml"
        path.write_text(rig_text(self, **tables))
        return path


def save(path, picture):
    if picture.dtype.kind == "f":
        picture = picture.astype(np.float32)
    tifffile.imwrite(path, picture, photometric="minisblack")


def outline(shot):
    back = dataclasses.replace(ring(1, 0)[0], direction=shot.sphere.centre_mm / np.linalg.norm(shot.sphere.centre_mm))
    return render(shot.cam, shot.sphere, [back], lambert(), background=1.0)[0]


def rig_text(shot, *, lens=True, exposure=1.0, extra="", white=True, response="", lights=None):
    lines = [
        "format = 1",
        'name = "test"',
        extra,
        "[camera]",
        'kind = "pinhole"',
        f"focal_px = {shot.cam.matrix[0, 0]}",
    ]
    lines += [f"centre_px = [{shot.cam.matrix[0, 2]}, {shot.cam.matrix[1, 2]}]"]
    if lens and shot.cam.distortion.any():
        lines += [f"distortion = {shot.cam.distortion.tolist()}"]
    lines += ["[sphere]", f"radius_mm = {shot.sphere.radius_mm}", 'outline = "outline.tif"', response]
    if white:
        lines += ["[white]", 'image = "white.tif"', "box = [62, 62, 78, 78]", f"reflectance = {WHITE}", "sd = 0.01"]
        lines += [f"exposure = {exposure}"]
    for k, light in enumerate(shot.lights if lights is None else lights):
        lines += ["[[light]]", f'images = ["{k}.tif"]', f"exposures = [{exposure}]"]
        lines += [f"direction = {light.direction.tolist()}", "sd_deg = 0.2"]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def scene():
    cam = camera(130, 120, focal_px=420.0, distortion=LENS)
    sphere = sphere_for(cam, RADIUS_PX, (-4.0, 5.0))
    lights = ring(3, 40) + ring(2, 110)
    return cam, sphere, lights, render(cam, sphere, lights, lambert(ALBEDO))


@pytest.fixture
def shot(scene, tmp_path):
    return Shot(tmp_path, *scene)


def run(path, **options):
    return extract_samples(open_rig(path), **options)


def off(found):
    """Relative rms deviation from the truth, and the bias."""
    relative = found.samples["value"].values / (ALBEDO / np.pi) - 1
    return float(np.sqrt(np.mean(relative**2))), float(np.mean(relative))


def test_without_faults_the_truth_comes_out(shot):
    found = run(shot.write(Faults(exposure=2.0, bits=16), exposure=2.0))
    rms, bias = off(found)
    assert rms < 0.001
    assert abs(bias) < 0.0005
    assert found.samples.attrs["scale"].startswith("absolute")
    assert found.linearity.verdict == "linear"


def corrected(shot, faults, bad, good):
    """Deviations with and without the calibration."""
    told = run(shot.write(faults, **bad))
    return off(told), off(run(shot.write(faults, **good))), told


def test_distortion(shot):
    faults = Faults(exposure=2.0, bits=16)
    before, after, _ = corrected(shot, faults, {"exposure": 2.0, "lens": False}, {"exposure": 2.0})
    assert after[0] < 0.001
    assert before[0] > 3 * after[0]
    assert "lens distortion: no calibration board" in run(shot.write(faults, exposure=2.0, lens=False)).unresolved


def test_vignetting(shot):
    faults = Faults(exposure=2.0, vignetting=0.35, bits=16)
    good = {"exposure": 2.0, "response": '[flat]\nimage = "board.tif"\nexposure = 2.0'}
    before, after, told = corrected(shot, faults, {"exposure": 2.0}, good)
    assert after[0] < 0.001
    assert before[0] > 30 * after[0]
    assert "vignetting: no flat field" in told.unresolved


def test_gamma(shot):
    faults = Faults(exposure=2.0, gamma=2.2, bits=16)
    good = {"exposure": 2.0, "response": '[response]\nkind = "gamma"\ngamma = 2.2'}
    before, after, told = corrected(shot, faults, {"exposure": 2.0}, good)
    assert after[0] < 0.001
    assert before[0] > 0.2
    assert any("response is not what was declared" in w for w in told.warnings)


def test_a_stack_contradicts_the_declaration(shot):
    faults = Faults(gamma=2.2, bits=8)
    names = []
    for t in (0.5, 1.0, 2.0, 4.5):
        save(shot.folder / f"s{t}.tif", dataclasses.replace(faults, exposure=t)(shot.images.max(axis=0)))
        names.append(f"s{t}.tif")
    stack = f"[response.stack]\nimages = {names}\nexposures = [0.5, 1.0, 2.0, 4.5]".replace("'", '"')
    told = open_rig(shot.write(dataclasses.replace(faults, exposure=2.0), exposure=2.0, response=stack))
    assert told.linearity.verdict == "not linear"
    assert any("exposure stack shows values" in w for w in told.warnings)
    # Debevec's response from the same stack mends it.
    mended = run(
        shot.write(
            dataclasses.replace(faults, exposure=2.0), exposure=2.0, response=f'[response]\nkind = "debevec"\n{stack}'
        )
    )
    assert off(mended)[0] < 0.06
    assert not any("declared" in w for w in mended.warnings)


def test_noise_is_told_by_the_standard_error(shot):
    found = run(
        shot.write(
            Faults(exposure=2.0, gain=2e-4, read=0.002, bits=16),
            exposure=2.0,
            response="[noise]\ngain = 2e-4\nread = 0.002",
        )
    )
    z = (found.samples["value"] - ALBEDO / np.pi) / found.samples["standard_error"]
    # Footprint bias at the limb and the terminator left out, what remains is noise.
    inner = (found.samples["theta_i"] < 1.1) & (found.samples["theta_o"] < 1.1)
    z = z.values[inner.values]
    assert z.size > 3000
    assert np.std(z) == pytest.approx(1.0, abs=0.08)
    assert abs(np.mean(z)) < 0.25


def test_quantisation(shot):
    coarse, fine = (off(run(shot.write(Faults(exposure=2.0, bits=b), exposure=2.0)))[0] for b in (8, 16))
    assert fine < 0.001 < coarse < 0.01


def test_clipping_is_refused_then_merged_away(shot):
    long = Faults(exposure=9.0, bits=16)
    path = shot.write(long, exposure=9.0, white=False)
    with pytest.raises(InputError, match="overexposed"):
        run(path)
    found = run(path, max_clipped=1.0)
    assert any("clipped" in w for w in found.warnings)
    # With a shorter exposure beside each the hole closes.
    for k, image in enumerate(shot.images):
        save(shot.folder / f"short{k}.tif", dataclasses.replace(long, exposure=1.0)(image, k + 50))
    text = rig_text(shot, exposure=9.0, white=False)
    for k in range(len(shot.images)):
        text = text.replace(
            f'images = ["{k}.tif"]\nexposures = [9.0]', f'images = ["{k}.tif", "short{k}.tif"]\nexposures = [9.0, 1.0]'
        )
    path.write_text(text)
    merged = run(path)
    assert merged.samples.sizes["sample"] > found.samples.sizes["sample"] * 1.3
    value = merged.samples["value"].values
    assert np.std(value) / np.mean(value) < 0.001
    assert not any("clipped" in w for w in merged.warnings)


def test_stray_light(shot):
    faults = Faults(exposure=2.0, stray=0.03, bits=16)
    good = {"exposure": 2.0, "extra": "black_box = [0, 0, 12, 12]"}
    before, after, told = corrected(shot, faults, {"exposure": 2.0}, good)
    assert after[0] < 0.001
    assert before[0] > 30 * after[0]
    assert any("stray light in the lens" in w for w in told.warnings)
    assert any(u.startswith("stray light: no black box") for u in told.unresolved)


def test_dark_offset(shot):
    faults = Faults(exposure=2.0, dark=0.02, bits=16)
    good = {"exposure": 2.0, "response": '[[dark]]\nimage = "dark.tif"\nexposure = 2.0'}
    before, after, told = corrected(shot, faults, {"exposure": 2.0}, good)
    assert after[0] < 0.001
    assert before[0] > 30 * after[0]
    assert "dark offset: no dark frame" in told.unresolved


def test_light_from_a_table_below_is_told_as_such(shot):
    cam, sphere = shot.cam, shot.sphere
    below = np.array([0.0, 1.0, 0.0])
    rows, columns = np.mgrid[0 : cam.height, 0 : cam.width]
    hits = sphere.meet(*cam.rays(columns, rows))
    glow = np.where(hits.hit, 0.05 * ALBEDO / np.pi * (1 + hits.normals @ below) / 2, 0.0)
    shot.images = shot.images + glow
    told = run(shot.write(Faults(exposure=2.0, bits=16), exposure=2.0))
    assert any("towards below" in w for w in told.warnings)


def test_without_a_white_reference_the_scale_is_free_and_said(shot):
    found = run(shot.write(Faults(exposure=2.0, bits=16), exposure=2.0, white=False))
    assert found.samples.attrs["scale"].startswith("arbitrary")
    value = found.samples["value"].values
    assert np.std(value) / np.mean(value) < 0.001
    assert any("white reference" in u for u in found.unresolved)


def test_intensities_from_the_sphere(shot):
    true = np.array([1.0, 1.6, 0.7, 1.2, 0.9])
    shot.images = shot.images * true[:, None, None]
    table = {"exposure": 1.2, "white": False}
    wrong = run(shot.write(Faults(exposure=1.2, bits=16), **table)).samples["value"].values
    rig = open_rig(shot.write(Faults(exposure=1.2, bits=16), extra='intensities_are = "from the sphere"', **table))
    found = np.array([light.intensity[0] for light in rig.lights])
    np.testing.assert_allclose(found, true / true.mean(), rtol=2e-3)
    right = extract_samples(rig).samples["value"].values
    assert np.std(wrong) / np.mean(wrong) > 0.2
    assert np.std(right) / np.mean(right) < 0.002
    assert any("from the sphere" in note for note in rig.notes)


def test_pictures_are_thinned_to_what_is_asked_for(shot):
    path = shot.write(Faults(exposure=2.0, bits=16), exposure=2.0)
    whole = run(path).samples.sizes["sample"]
    part = run(path, most=int(whole / 3.5))
    assert part.stride == 2
    assert whole / 5 < part.samples.sizes["sample"] < whole / 3.4


def test_a_light_behind_gives_no_sample(shot):
    back = dataclasses.replace(shot.lights[0], direction=shot.sphere.centre_mm / np.linalg.norm(shot.sphere.centre_mm))
    path = shot.write(Faults(exposure=2.0, bits=16), exposure=2.0, lights=[*shot.lights[:4], back])
    with pytest.raises(InputError, match="stands behind"):
        run(path)
    assert run(path, skip_empty=True).samples["used"].values[4] == 0


def test_nan_pixels_are_left_out_and_told(shot):
    path = shot.write(Faults(exposure=2.0, clip=False), exposure=2.0)
    picture = tifffile.imread(shot.folder / "0.tif")
    picture[55:65, 50:60] = np.nan
    save(shot.folder / "0.tif", picture)
    found = run(path)
    assert any("NaN" in w for w in found.warnings)
    assert off(found)[0] < 0.001


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: save(f / "2.tif", np.zeros((50, 60), np.uint16)), "must be 130x120"),
        (lambda f: (f / "2.tif").write_bytes((f / "2.tif").read_bytes()[:900]), "cannot be decoded"),
        (lambda f: (f / "3.tif").unlink(), "is not a file"),
        (lambda f: Image.fromarray(np.zeros((120, 130, 3), np.uint8)).save(f / "1.tif"), "with 1 channels"),
        (lambda f: save(f / "outline.tif", np.zeros((120, 130), np.uint16)), "no sphere"),
    ],
    ids=["size", "truncated", "missing", "colour", "black outline"],
)
def test_bad_pictures_are_refused_by_name(shot, spoil, said):
    path = shot.write(Faults(exposure=2.0, bits=16), exposure=2.0)
    spoil(shot.folder)
    with pytest.raises(InputError, match=said):
        run(path)
