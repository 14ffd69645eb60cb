"""`livlab.brdf`: samples from a folder of photographs and from images in memory, files in and out, a model fitted."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from deep_pictures import deep_png
from PIL import Image
from synthetic_camera import camera, lambert, render, ring, sphere_for

import livlab
from livlab.acquire.photographs.extract import extract_samples
from livlab.acquire.photographs.open import open_rig
from livlab.brdf.sphere import extract
from livlab.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of a matte ball in DiLiGenT's layout, in a folder with blanks and letters beyond ASCII."""
    place = tmp_path_factory.mktemp("bola à mão")
    cam = camera(120, 110, focal_px=40000.0)
    sphere, lights = sphere_for(cam, 40.0, (-3.0, 2.0)), ring(4, 35)
    for k, image in enumerate(render(cam, sphere, lights, lambert(0.5))):
        deep_png(place / f"{k:03d}.png", np.round(image[..., None].repeat(3, axis=-1) * 2.0 * 65535).astype(np.uint16))
    mask = render(cam, sphere, lights[:1], lambert(), background=9.0)[0] < 4.5
    Image.fromarray(mask.astype(np.uint8) * 255).save(place / "mask.png")
    (place / "filenames.txt").write_text("".join(f"{k:03d}.png\n" for k in range(4)))
    up = [light.direction * [1, -1, -1] for light in lights]
    (place / "light_directions.txt").write_text("".join(" ".join(f"{x:.8f}" for x in d) + "\n" for d in up))
    return place


@pytest.mark.parametrize("kind", [Path, str])
def test_a_folder_of_photographs_gives_the_commands_samples(folder: Path, kind: type) -> None:
    expected = extract_samples(open_rig(folder))
    heard: list[tuple[int, int]] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = livlab.brdf.extract(kind(folder), progress=lambda done, of: heard.append((done, of)))
    assert [str(w.message).partition(": ")[2] for w in caught if w.category is UserWarning] == list(expected.warnings)
    assert found.sizes == expected.samples.sizes
    np.testing.assert_array_equal(found["value"].to_numpy(), expected.samples["value"].to_numpy())
    assert found.attrs["not_corrected"].splitlines() == list(expected.unresolved)
    assert heard[-1] == (4, 4)


def test_images_in_memory_give_the_librarys_samples(folder: Path) -> None:
    rig = open_rig(folder)
    found = livlab.brdf.extract(rig.images, rig.camera, rig.lights, rig.sphere, mask=rig.mask)
    own = extract(rig.images, rig.camera, rig.lights, rig.sphere, mask=rig.mask)
    np.testing.assert_array_equal(found["value"].to_numpy(), own["value"].to_numpy())
    with pytest.raises(InputError, match=r"lights, sphere.*is needed beside images"):
        livlab.brdf.extract(rig.images, rig.camera)
    with pytest.raises(InputError, match="goes with photographs only"):
        livlab.brdf.extract(rig.images, rig.camera, rig.lights, rig.sphere, progress=print)  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_samples_go_to_a_file_and_back_and_are_fitted(folder: Path, tmp_path: Path) -> None:
    found = livlab.brdf.extract(folder, most=3000)
    path = livlab.brdf.write(str(tmp_path / "amostras.nc"), found)
    again = livlab.brdf.read(path)
    np.testing.assert_array_equal(again["value"].to_numpy(), found["value"].to_numpy())
    assert again.attrs["not_corrected"] == found.attrs["not_corrected"]
    fitted = livlab.brdf.fit_model(again, "lambert")
    assert fitted.relative_rmse < 0.03
    assert fitted.values["kd[R]"] == pytest.approx(0.5, rel=0.02)  # no white reference: scaled to a mean of a half
