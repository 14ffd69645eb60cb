"""Photometric-stereo folders in DiLiGenT's layout: pictures, directions, intensities and a mask in plain files.

`filenames.txt` names a picture a line, `light_directions.txt` holds a vector a line (x right, y up, z to the camera),
`light_intensities.txt` red, green and blue a line, `mask.png` the object. The pictures are linear, 16 bit. The camera
is not part of the layout: it is taken as orthographic, one pixel a millimetre, unless one is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from livlab.acquire.photographs.linearity import response
from livlab.acquire.photographs.merge import Development, Merged, merge
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.pose import all_round, sphere_pose
from livlab.acquire.photographs.read import Photograph, read_photograph
from livlab.acquire.photographs.rig import DevelopedFrames, PhotographedRig
from livlab.acquire.photographs.rig_file import within
from livlab.acquire.photographs.rig_pictures import with_noise
from livlab.brdf.geometry import Camera, Light
from livlab.errors import InputError

FILENAMES, DIRECTIONS, INTENSITIES, MASK = (
    "filenames.txt",
    "light_directions.txt",
    "light_intensities.txt",
    "mask.png",
)

TO_CAMERA = np.array([1.0, -1.0, -1.0])
"""From x right, y up, z to the camera to the camera's frame."""


def load_folder(
    folder: Path,
    camera: Camera | None = None,
    *,
    radius_mm: float | None = None,
    light_sd_deg: float = 1.0,
    kind: str = "linear",
) -> PhotographedRig:
    """A folder in DiLiGenT's layout.

    Parameters
    ----------
    folder
        Holds `filenames.txt` and the rest.
    camera
        Where it is known; orthographic otherwise.
    radius_mm
        Of the sphere; needed with a perspective camera.
    light_sd_deg
        Standard uncertainty of the light directions, which the layout does not tell: 1 degree is what mirror balls
        reach.
    kind
        Response: "linear" or "srgb".

    Raises
    ------
    InputError
        Missing files, counts that differ, directions that are not of unit length, intensities that are not > 0,
        pictures that cannot be read or differ in size.
    """
    names, directions, intensities = _tables(folder)
    first = read_photograph(within(folder, names[0]))
    rows, columns, channels = first.values.shape
    if intensities.shape[1] not in (1, channels):
        raise InputError.of(INTENSITIES, intensities.shape[1], f"must be {channels} numbers a line", "One a channel.")
    if camera is None:
        middle = [[1.0, 0.0, (columns - 1) / 2], [0.0, 1.0, (rows - 1) / 2], [0.0, 0.0, 1.0]]
        camera = Camera(columns, rows, np.array(middle), orthographic=True)
    development, noise_known = with_noise(Development(response(kind)), first, 1.0)

    def develop(k: int) -> Merged:
        return merge([read_photograph(within(folder, names[k]))], [1.0], development)

    frames = DevelopedFrames(develop, len(names), (rows, columns, channels))
    mask = None
    if (folder / MASK).is_file():
        picture = read_photograph(folder / MASK).values.mean(axis=2)
        pose = sphere_pose(picture, camera, radius_mm, kind="silhouette")
        mask = picture > 0.5 * picture.max()
    else:
        pose = sphere_pose(all_round(frames[k].value for k in range(len(names))), camera, radius_mm)
    turned = directions / np.linalg.norm(directions, axis=1)[:, None] * TO_CAMERA @ camera.rotation
    lights = tuple(Light(intensity=i, direction=d) for i, d in zip(intensities, turned, strict=True))
    warnings = []
    if first.linear is False:
        warnings.append(f"{first.name} says that its values are encoded, not linear.")
    return PhotographedRig(
        name=folder.resolve().name,
        frames=frames,
        channels=channel_names(channels),
        camera=camera,
        lights=lights,
        sphere=pose.sphere,
        pose=pose,
        sphere_covariance=pose.covariance,
        light_covariances=tuple(tilt_covariance(d, np.deg2rad(light_sd_deg)) for d in turned),
        white=np.ones(channels),
        mask=mask,
        noise_known=noise_known,
        files={"pictures": list(names)},
        notes=(*pose.notes, *_notes(camera, first)),
        warnings=tuple(warnings),
    )


def channel_names(count: int) -> tuple[str, ...]:
    """R, G, B of three channels, else grey."""
    return ("R", "G", "B") if count == 3 else ("grey",)


def tilt_covariance(direction: FloatArray, sd_rad: float) -> FloatArray:
    """(3, 3) covariance of a unit vector that is uncertain by an angle in each of its two tilts."""
    return np.asarray(sd_rad**2 * (np.eye(3) - np.outer(direction, direction)))


def _tables(folder: Path) -> tuple[Sequence[str], FloatArray, FloatArray]:
    """Names (N), directions (N, 3) of nearly unit length and intensities (N, 1 or channels) of a folder's lights."""
    names = _lines(folder / FILENAMES)
    directions = _numbers(folder / DIRECTIONS, 3)
    intensities = _numbers(folder / INTENSITIES, None) if (folder / INTENSITIES).is_file() else np.ones((len(names), 1))
    counts = {FILENAMES: len(names), DIRECTIONS: len(directions), INTENSITIES: len(intensities)}
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{n} in {name}" for name, n in counts.items())
        raise InputError.of(str(folder.name), shown, "must be one line for each picture", "Mend the files.")
    for k, length in enumerate(np.linalg.norm(directions, axis=1)):
        if not 0.99 < length < 1.01:
            raise InputError.of(
                f"{DIRECTIONS}, line {k + 1}", directions[k].tolist(), "must have unit length", "Divide by its length."
            )
    for k, row in enumerate(intensities):
        if not np.all(row > 0):
            bound = "must be > 0"
            raise InputError.of(f"{INTENSITIES}, line {k + 1}", row.tolist(), bound, "Drop a light that was off.")
    return names, directions, intensities


def _notes(camera: Camera, first: Photograph) -> list[str]:
    """What the layout leaves open."""
    notes = []
    if camera.orthographic:
        notes.append("The layout tells no camera: it is taken as orthographic, which at 10 radii is off by 10 %.")
    if first.values.dtype == np.uint8:
        notes.append("8-bit pictures: steps of 0.4 % of full scale.")
    return notes


def _lines(path: Path) -> Sequence[str]:
    if not path.is_file():
        raise InputError.of("folder", path.name, "is missing", "Give a folder in DiLiGenT's layout.")
    if path.stat().st_size > 1 << 20:
        raise InputError.of("folder", path.name, "is larger than 1 MiB", "It should hold a line for each picture.")
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    except UnicodeDecodeError as error:
        raise InputError.of("folder", path.name, "is no text", "Mend it.") from error
    found = [line for line in lines if line]
    if not found:
        raise InputError.of("folder", path.name, "is empty", "It should hold a line for each picture.")
    return found


def _numbers(path: Path, count: int | None) -> FloatArray:
    rows: list[list[float]] = []
    for k, line in enumerate(_lines(path)):
        try:
            row = [float(x) for x in line.replace(",", " ").split()]
        except ValueError:
            row = []
        if not row or not np.all(np.isfinite(row)) or len(row) != (count or (len(rows[0]) if rows else len(row))):
            bound = f"must be {count or (len(rows[0]) if rows else 3)} finite numbers"
            raise InputError.of(f"{path.name}, line {k + 1}", line, bound, "Mend the line.")
        rows.append(row)
    return np.array(rows)
