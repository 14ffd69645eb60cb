"""Small copies of pictures: light is averaged, files are small, and what is no picture is refused."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from livlab.errors import InputError
from livlab.kinds.picture.gallery_small import shrunk, small_copies


def coded(light: np.ndarray) -> np.ndarray:
    """sRGB code values of light, as IEC 61966-2-1 has them."""
    return np.rint(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def test_noise_is_averaged_as_light_and_the_mean_is_kept() -> None:
    rng = np.random.default_rng(5)
    light = np.clip(rng.normal([0.30, 0.10, 0.08], 0.02, (120, 160, 3)), 0, 1)
    file = io.BytesIO()
    Image.fromarray(coded(light).astype(np.uint8)).save(file, "PNG")
    with Image.open(io.BytesIO(shrunk(file.getvalue(), 40))) as small:
        assert small.size == (40, 30)
        found = np.asarray(small.convert("RGB"), dtype=float)
    # 16 pixels each: the standard error of the mean of 1200 of them is far below a code value.
    assert np.abs(found.mean(axis=(0, 1)) - coded(np.array([0.30, 0.10, 0.08]))).max() < 1.0
    spread = coded(np.array([0.305, 0.105, 0.085])) - coded(np.array([0.295, 0.095, 0.075]))
    assert (found.std(axis=(0, 1)) < spread).all()


def test_a_narrow_picture_keeps_its_size() -> None:
    file = io.BytesIO()
    Image.new("RGB", (20, 10), (120, 40, 30)).save(file, "PNG")
    with Image.open(io.BytesIO(shrunk(file.getvalue(), 64))) as small:
        assert small.size == (20, 10)
        assert np.all(np.asarray(small.convert("RGB")) == (120, 40, 30))


def test_no_run_and_no_width_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one run"):
        small_copies([], tmp_path, 64)
    with pytest.raises(InputError, match="16–4096"):
        small_copies([tmp_path], tmp_path, 3)
