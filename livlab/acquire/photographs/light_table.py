"""The lights of a rig as a table: where they are given, where highlight and shading put them, how strong they are."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from livlab.acquire.photographs.light_check import LightCheck, judge
from livlab.acquire.photographs.lights import Highlight, distant_direction, mirror_highlight
from livlab.acquire.photographs.merge import Merged
from livlab.acquire.photographs.open import open_rig
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.pose import SpherePose
from livlab.acquire.photographs.rig import PhotographedRig
from livlab.acquire.photographs.rig_file import NAME, read_rig_file
from livlab.acquire.photographs.rig_load import MirrorBalls, load_mirrors
from livlab.acquire.photographs.shading import Shading, shading
from livlab.brdf.geometry import Camera
from livlab.errors import InputError

PIXELS = 900
"""Pixels of each picture on which lights are judged; fewer where there are many lights."""

_ALL_PIXELS = 12_000
_LEAST_PIXELS = 180

MAX_ANGLE = float(np.deg2rad(75.0))
"""Largest angle from the eye of the pixels on which lights are judged."""

_BROAD = 0.05
"""Share of the disc above which a bright patch is no highlight."""

APART = float(np.deg2rad(3.0))
"""Angle between what is given and what a highlight shows below which nothing is told; or 4 of its sd."""


@dataclass(frozen=True, eq=False, repr=False)
class LightReport:
    """The lights of a rig, held against its pictures.

    Attributes
    ----------
    name
        What the data set is called.
    table
        One row a light: `light`; `x`, `y`, `z` (unit vector from the sphere, world frame); `from_camera_deg` and
        `around_deg` (as direction_deg of a rig file) with `sd_deg`, NaN where it was not said; `highlight_deg`,
        `highlight_around_deg`, `highlight_sd_deg` where a highlight puts it; `apart_deg` between the two;
        `shading_deg`, the angle at which its shading puts it, and `shading_sd_deg`; `gain`, its strength over what
        lights that stand alike to the camera let expect, and `gain_sd`; `residual`, a share of the picture's level;
        `clipped`, the share of the sphere's pixels; `verdict`.
    check
        What was judged; None of mirror balls alone.
    warnings, notes
        In words.
    """

    name: str
    table: pd.DataFrame
    check: LightCheck | None
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        text = self.table.to_string(index=False, float_format=lambda x: f"{x:.3g}")
        told = "" if self.check is None else f"\n{self.check.told}"
        return f"{self.name}\n{text}{told}" + "".join(f"\nwarning: {w}" for w in self.warnings)


def light_table(source: Path | str | PhotographedRig) -> LightReport:
    """Where the lights are and how strong, as given and as the pictures have it.

    Parameters
    ----------
    source
        A rig file, its folder, a folder in DiLiGenT's layout, or a rig that was opened. A rig file with mirror balls
        need not name a sphere or a light: then the table holds what their highlights say.

    Raises
    ------
    InputError
        What opening the rig refuses.
    """
    if isinstance(source, PhotographedRig):
        return _of_rig(source)
    path = Path(source)
    file = path / NAME if (path / NAME).is_file() else path
    if file.is_file() and not read_rig_file(file).light:
        return _of_mirrors(load_mirrors(file))
    return _of_rig(open_rig(path))


def thinned_pixels(rig: PhotographedRig) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns on which the lights are judged."""
    most = int(np.clip(_ALL_PIXELS / len(rig.lights), _LEAST_PIXELS, PIXELS))
    return rig.inside(most, MAX_ANGLE)


def shading_of(
    rig: PhotographedRig,
    rows: np.ndarray,
    columns: np.ndarray,
    values: Sequence[FloatArray],
    noise: Sequence[FloatArray],
) -> Shading | None:
    """Pixels of the rig's pictures, ready to be judged; None where too few are usable."""
    origins, towards = rig.camera.rays(columns, rows)
    hits = rig.sphere.meet(origins, towards)
    pixels = (hits.points_mm, hits.normals, -towards)
    return shading(rig.camera, rig.sphere, rig.lights, pixels, values, noise)


def at_pixels(frame: Merged, rows: np.ndarray, columns: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Radiance of some pixels, mean over the channels, and its variance."""
    value = frame.value[rows, columns].astype(np.float64).mean(axis=-1)
    variance = frame.variance[rows, columns].astype(np.float64).mean(axis=-1) / frame.value.shape[-1]
    return value, variance


def sd_of(rig: PhotographedRig) -> FloatArray:
    """(lights,) standard uncertainty of each direction, rad; 0 where it was not said."""
    found = []
    for light, covariance in zip(rig.lights, rig.light_covariances, strict=True):
        sd = math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
        if light.position_mm is not None:
            sd /= float(np.linalg.norm(light.position_mm - rig.sphere.centre_mm))
        found.append(sd)
    return np.array(found)


def judged(rig: PhotographedRig, seen: Shading | None) -> LightCheck | None:
    """The verdict on the lights of a rig."""
    if seen is None:
        return None
    return judge(seen, sd_of(rig)[list(seen.kept)].tolist())


def _of_rig(rig: PhotographedRig) -> LightReport:
    rows, columns = thinned_pixels(rig)
    values, noise, clipped, own = [], [], [], []
    for k in range(len(rig.lights)):
        frame = rig.frames[k]
        value, variance = at_pixels(frame, rows, columns)
        values.append(value)
        noise.append(variance)
        clipped.append(float(np.mean(~np.isfinite(value))))
        own.append(_highlight(rig, k, frame))
    seen = shading_of(rig, rows, columns, values, noise)
    check = judged(rig, seen)
    rows_of = [_row(rig, k, own[k], clipped[k]) for k in range(len(rig.lights))]
    table = pd.DataFrame(rows_of)
    if check is not None:
        table = _with_check(table, check)
    warnings = (*(check.warnings if check is not None else ()), *_apart_in_words(table))
    table["verdict"] = [_verdict(row, check) for row in table.to_dict("records")]
    return LightReport(rig.name, table, check, (*rig.warnings, *warnings), rig.notes)


_Shown = tuple[FloatArray, float, FloatArray]
"""Direction, its sd (rad), and the point (mm) at which it was seen."""


def _highlight(rig: PhotographedRig, k: int, frame: Merged) -> _Shown | None:
    """What a highlight shows: on the mirror balls, else on the sphere itself if it has a sharp one."""
    if rig.highlights:
        direction, covariance = distant_direction(rig.highlights[k])
        sd = math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
        return direction, sd, np.asarray(np.mean([h.origin_mm for h in rig.highlights[k]], axis=0))
    curve = rig.sphere.outline(rig.camera)
    radius = float(np.ptp(curve, axis=0).mean() / 2)
    pose = rig.pose or _given_pose(rig, radius)
    with contextlib.suppress(InputError):
        peak = float(np.nanmax(frame.value))
        # A clipped highlight is a hole here: filled with more than all else it is where it was.
        shown = np.where(np.isfinite(frame.value), frame.value, 1.5 * peak)
        found = mirror_highlight(shown, rig.camera, pose, saturation=1.5 * peak)
        if found.area_px <= _BROAD * math.pi * radius**2:
            return found.direction, found.sd_rad, found.origin_mm
    return None


def _given_pose(rig: PhotographedRig, radius_px: float) -> SpherePose:
    middle = rig.sphere.outline(rig.camera).mean(axis=0)
    circle = (float(middle[0]), float(middle[1]), radius_px)
    none = np.empty((0, 2))
    return SpherePose(
        sphere=rig.sphere,
        covariance=rig.sphere_covariance,
        circle_px=circle,
        circle_sd_px=(0.0, 0.0, 0.0),
        systematic_px=(0.0, 0.0),
        residual_px=0.0,
        support=1.0,
        points=none,
        outline=none,
        kind="silhouette",
    )


def _row(rig: PhotographedRig, k: int, highlight: _Shown | None, clipped: float) -> dict[str, float | int | str]:
    direction = rig.lights[k].at(rig.sphere.centre_mm)[0]
    sd = float(np.rad2deg(sd_of(rig)[k]))
    row: dict[str, float | int | str] = {"light": k, **_placed(rig.camera, direction)}
    row["sd_deg"] = sd if sd > 0 else math.nan
    row |= dict.fromkeys(("highlight_deg", "highlight_around_deg", "highlight_sd_deg", "apart_deg"), math.nan)
    if highlight is not None:
        there, sd_there, seen_from = highlight
        angles = _placed(rig.camera, there)
        row["highlight_deg"], row["highlight_around_deg"] = angles["from_camera_deg"], angles["around_deg"]
        row["highlight_sd_deg"] = float(np.rad2deg(sd_there))
        row["apart_deg"] = float(np.rad2deg(np.arccos(np.clip(rig.lights[k].at(seen_from)[0] @ there, -1, 1))))
    row["clipped"] = clipped
    return row


def _placed(camera: Camera, direction: FloatArray) -> dict[str, float]:
    x, y, z = camera.rotation @ direction
    return {
        "x": float(direction[0]),
        "y": float(direction[1]),
        "z": float(direction[2]),
        "from_camera_deg": float(np.rad2deg(np.arccos(np.clip(-z, -1, 1)))),
        "around_deg": float(np.rad2deg(np.arctan2(-y, x))),
    }


def _with_check(table: pd.DataFrame, check: LightCheck) -> pd.DataFrame:
    names = ("shading_deg", "shading_sd_deg", "gain", "gain_sd", "residual")
    columns = {name: np.full(len(table), math.nan) for name in names}
    at = list(check.kept)
    columns["shading_deg"][at] = np.rad2deg(check.shading.angle_rad)
    columns["shading_sd_deg"][at] = np.rad2deg(check.shading.sd_rad)
    columns["gain"][at] = check.gains.off
    columns["gain_sd"][at] = check.gains.sd / check.gains.gain * check.gains.off
    columns["residual"][at] = check.each_residual
    clipped = table.pop("clipped")
    return table.assign(**columns, clipped=clipped)


def _is_apart(row: Mapping[Any, Any]) -> bool:
    limit = max(float(np.rad2deg(APART)), 4 * row["highlight_sd_deg"], 3 * np.nan_to_num(row["sd_deg"]))
    return bool(row["apart_deg"] > limit)


def _apart_in_words(table: pd.DataFrame) -> list[str]:
    far = [row for row in table.to_dict("records") if _is_apart(row)]
    if not far:
        return []
    worst = max(far, key=lambda row: row["apart_deg"])
    return [
        f"The highlights of {len(far)} of {len(table)} pictures are elsewhere than the lights' directions say "
        f"(light {worst['light']} by {worst['apart_deg']:.1f} +- {worst['highlight_sd_deg']:.1f} degrees)."
    ]


def _verdict(row: Mapping[Any, Any], check: LightCheck | None) -> str:
    said = []
    k = int(row["light"])
    if check is None or k not in check.kept:
        return "not judged: too few pixels"
    at = check.kept.index(k)
    if check.astray[at]:
        said.append("elsewhere")
    elif _is_apart(row):
        said.append("highlight elsewhere")
    if check.gains.wrong[at]:
        said.append(f"{check.gains.off[at] - 1:+.0%} strength")
    return ", ".join(said) or "agrees"


def _of_mirrors(balls: MirrorBalls) -> LightReport:
    rows = []
    for k, seen in enumerate(balls.highlights):
        direction, covariance = distant_direction(seen)
        sd = float(np.rad2deg(math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))))
        row: dict[str, float | int | str] = {"light": k, **_placed(balls.camera, direction), "sd_deg": sd}
        row["clipped_highlight"] = float(np.mean([h.saturated for h in seen]))
        row["below_sr"] = min(h.solid_angle_sr for h in seen)
        row["verdict"] = _balls_agree(seen, direction)
        rows.append(row)
    table = pd.DataFrame(rows)
    apart = [row for row in rows if row["verdict"] != "agrees" and len(balls.highlights[0]) > 1]
    warnings = list(balls.warnings)
    if apart:
        warnings.append(
            f"{len(apart)} of {len(rows)} lights stand in unlike directions from the mirror balls: near lights "
            '(lights_are = "near"), or a ball whose radius or outline is wrong.'
        )
    return LightReport(balls.name, table, None, tuple(warnings), balls.notes)


def _balls_agree(seen: Sequence[Highlight], mean: FloatArray) -> str:
    if len(seen) == 1:
        return "one ball"
    off = [math.acos(float(np.clip(h.direction @ mean, -1, 1))) for h in seen]
    far = max(range(len(seen)), key=lambda k: off[k] / seen[k].sd_rad)
    return "agrees" if off[far] < 4 * seen[far].sd_rad else f"ball {far} is {np.rad2deg(off[far]):.1f} degrees off"
