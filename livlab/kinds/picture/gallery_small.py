"""Small copies of a run's pictures, for a README or a talk."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from livlab.core.files import write_whole
from livlab.errors import InputError
from livlab.kinds.picture.report import shown_pictures
from livlab.reports.folder import read_run, sound
from livlab.runs.files import told_plainly

COLOURS = 256
"""A palette holds a small picture's colours and halves its size."""

WIDEST = 4096


def small_copies(folders: Sequence[Path], out: Path, width: int) -> list[Path]:
    """Write each picture of some runs, by their first colour route, as a small PNG with a palette.

    Light is averaged, not code values: pixels are decoded (IEC 61966-2-1), averaged over areas, and encoded again, so
    that noise is averaged out as more samples would. Pictures that are narrower already keep their size.

    Parameters
    ----------
    folders
        Run folders of picture experiments.
    out
        Where `RUN-TISSUE-READING.png` go; it is made if missing.
    width
        Of the copies, in pixels.

    Raises
    ------
    InputError
        No folder, a width outside 16–4096, or a run without a finished picture.
    EnvironmentProblem
        The folder cannot be written.
    """
    if not 16 <= width <= WIDEST:
        raise InputError.of("small", width, f"must lie in 16–{WIDEST}", "Take 320.")
    if not folders:
        raise InputError.of("runs", [], "at least one run folder is needed", "Run an experiment: livlab run FILE.")
    with told_plainly(out):
        out.mkdir(parents=True, exist_ok=True)
    made = []
    for folder in folders:
        run = read_run(folder)
        with sound(run):
            rows = shown_pictures(run)
            if not rows:
                raise InputError.of("run", str(folder), "has no finished picture", "Finish it: livlab run FILE.")
            first = str(rows[0]["route"])
            for row in [r for r in rows if r["route"] == first]:
                source = run.path / str(row["png"])
                name = source.stem.removesuffix(f"-{first}")
                target = out / f"{run.path.name.rsplit('-', 1)[0]}-{name}.png"
                write_whole(target, shrunk(source.read_bytes(), width))
                made.append(target)
    return made


def shrunk(png: bytes, width: int) -> bytes:
    """A PNG made narrower by averaging light over areas, and given a palette.

    Examples
    --------
    Black and white in turn average to half of the light, which sRGB encodes as 188.

    >>> stripes = Image.fromarray(np.tile(np.array([0, 255], dtype=np.uint8), (4, 16)))
    >>> file = io.BytesIO()
    >>> stripes.save(file, "PNG")
    >>> np.unique(np.asarray(Image.open(io.BytesIO(shrunk(file.getvalue(), 16))).convert("L"))).tolist()
    [188]
    """
    with Image.open(io.BytesIO(png)) as opened:
        coded = np.asarray(opened.convert("RGB"), dtype=np.float64) / 255.0
    if coded.shape[1] > width:
        light = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
        size = (width, max(1, round(coded.shape[0] * width / coded.shape[1])))
        channels = [
            np.asarray(Image.fromarray(light[:, :, k].astype(np.float32)).resize(size, Image.Resampling.BOX))
            for k in range(3)
        ]
        mean = np.clip(np.stack(channels, axis=2).astype(np.float64), 0.0, 1.0)
        coded = np.where(mean <= 0.0031308, 12.92 * mean, 1.055 * mean ** (1 / 2.4) - 0.055)
    picture = Image.fromarray(np.rint(255.0 * coded).astype(np.uint8))
    file = io.BytesIO()
    palette = picture.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette.save(file, "PNG", optimize=True)
    return file.getvalue()
