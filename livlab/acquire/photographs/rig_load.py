"""A `rig.toml` made into photographs that are calibrated: response, frames, camera, sphere, lights, white."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs import check
from livlab.acquire.photographs.calibration import Board, CameraCalibration, calibrate_camera
from livlab.acquire.photographs.calibration_chart import ColourCalibration, calibrate_colour
from livlab.acquire.photographs.diligent import TO_CAMERA, channel_names, tilt_covariance
from livlab.acquire.photographs.lights import Highlight, distant_direction, mirror_highlight, near_position
from livlab.acquire.photographs.linearity import CameraResponse, Linearity
from livlab.acquire.photographs.merge import Development, Merged, coloured, merge
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.pose import Kind, SpherePose, all_round, sphere_pose
from livlab.acquire.photographs.read import Photograph
from livlab.acquire.photographs.rig import DevelopedFrames, PhotographedRig, with_matte_intensities
from livlab.acquire.photographs.rig_file import (
    LightTable,
    MirrorTable,
    RigFile,
    WhiteTable,
    read_rig_file,
)
from livlab.acquire.photographs.rig_pictures import RigPictures
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.errors import InputError


def load_rig(path: Path) -> PhotographedRig:
    """Photographs as a rig file describes them; pictures of the sphere are read again, one by one, when they are used.

    Raises
    ------
    InputError
        What the rig file, the pictures and the calibrations refuse, each named.
    """
    table = read_rig_file(path)
    rig = _Loader(table, path.resolve().parent).load()
    return with_matte_intensities(rig) if table.intensities_are == "from the sphere" else rig


@dataclass(frozen=True, eq=False)
class MirrorBalls:
    """Mirror balls by themselves: what their highlights say of the lights.

    Attributes
    ----------
    name
        What the data set is called.
    camera
        The camera.
    highlights
        For each light what each ball shows.
    notes, warnings
        What a reader should know; what is likely wrong.
    """

    name: str
    camera: Camera
    highlights: tuple[tuple[Highlight, ...], ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def load_mirrors(path: Path) -> MirrorBalls:
    """The mirror balls of a rig file; it need not name any light or sphere.

    Raises
    ------
    InputError
        No mirror ball, and what the rig file, the pictures and the calibrations refuse.
    """
    table = read_rig_file(path)
    return _Loader(table, path.resolve().parent).load_mirrors()


@dataclass
class _Loader:
    rig: RigFile
    folder: Path
    mirrors: list[Sphere] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pictures = RigPictures(self.rig, self.folder)
        self.notes, self.warnings = self.pictures.notes, self.pictures.warnings

    def load(self) -> PhotographedRig:
        rig = self.rig
        if not rig.light:
            raise InputError.of(
                "light", 0, "must be one at least to extract", "livlab brdf lights tells what mirror balls alone show."
            )
        exposures = [self._exposures(k, light) for k, light in enumerate(rig.light)]
        self._one_unit(exposures)
        first = self.pictures.read(rig.light[0].images[0])
        rows, columns, stored = first.values.shape
        answer, linearity = self.pictures.response(rig.response)
        self._declared(first, answer)
        development, noise_known = self.pictures.development(answer, first, exposures[0][0])
        colour = self._colour(development)
        grey = rig.channels == "grey"
        count = 1 if grey else stored

        def develop(k: int) -> Merged:
            pictures = [self.pictures.read(name) for name in rig.light[k].images]
            merged = self._without_stray(merge(pictures, exposures[k], development))
            return coloured(merged, colour, grey=grey)

        frames = DevelopedFrames(develop, len(rig.light), (rows, columns, count))
        camera, calibration = self._camera(columns, rows)
        pose, sphere, covariance = self._sphere(frames, camera, development)
        lights, light_covariances, highlights = self._lights(camera, sphere, development, count)
        white, white_sd = self._white(rig.white, development, lights, sphere, count, colour, grey=grey)
        self._doubt(camera, sphere)
        focal = rig.camera.focal_sd
        if calibration is not None:
            focal = float(np.sqrt(calibration.covariance[0, 0]) / camera.matrix[0, 0])
        return PhotographedRig(
            name=rig.name or self.folder.name,
            frames=frames,
            channels=channel_names(count),
            camera=camera,
            lights=lights,
            sphere=sphere,
            pose=pose,
            sphere_covariance=covariance,
            light_covariances=light_covariances,
            white=white,
            white_sd=white_sd,
            focal_sd=focal,
            mask=self._mask((rows, columns)),
            noise_known=noise_known,
            linearity=linearity,
            highlights=highlights,
            calibration=calibration,
            sized=all(light.solid_angle_sr is not None for light in rig.light),
            cut=rig.sphere.cut,
            colour=colour,
            corrected=self._corrected(calibration, linearity),
            files={f"light {k}": list(light.images) for k, light in enumerate(rig.light)},
            notes=tuple(self.notes),
            warnings=tuple(self.warnings),
        )

    def _declared(self, first: Photograph, answer: CameraResponse) -> None:
        """Warn where a file says of its values what the rig does not."""
        said = first.response or answer
        if first.linear is False and said.linear:
            self.warnings.append(f"{first.name} says that its values are encoded, but the rig declares them linear.")
        if first.linear is True and not said.linear:
            self.warnings.append(f"{first.name} holds linear values, but the rig declares {said.name}.")

    def _mask(self, size: tuple[int, int]) -> NDArray[np.bool_] | None:
        if self.rig.mask is None:
            return None
        picture = self.pictures.sized(self.rig.mask, size).values.mean(axis=2)
        return np.asarray(picture > 0.5 * picture.max())

    def load_mirrors(self) -> MirrorBalls:
        rig = self.rig
        if not rig.mirror:
            raise InputError.of("mirror", 0, "must be one ball at least", "Name its pictures under [[mirror]].")
        first = self.pictures.read(rig.mirror[0].images[0])
        answer, _ = self.pictures.response(rig.response)
        development, _ = self.pictures.development(answer, first, 1.0)
        rows, columns = first.values.shape[:2]
        camera, _ = self._camera(columns, rows)
        seen = [self._mirror(m, camera, development) for m in rig.mirror]
        self.warnings += check.turned(list(self.pictures.turned))
        name = rig.name or self.folder.name
        return MirrorBalls(name, camera, tuple(zip(*seen, strict=True)), tuple(self.notes), tuple(self.warnings))

    def _doubt(self, camera: Camera, sphere: Sphere) -> None:
        self.warnings += check.turned(list(self.pictures.turned))
        mirrors = [ball.centre_mm for ball in self.mirrors]
        if self.rig.sphere.radius_mm is not None:
            self.warnings += check.sizes(sphere.radius_mm, sphere.centre_mm, mirrors, orthographic=camera.orthographic)
        long = [math.hypot(*x.direction) for x in self.rig.light if x.direction is not None]
        if long and not 0.99 < min(long) <= max(long) < 1.01:
            self.notes.append(
                f"Light directions of length {min(long):.4g} to {max(long):.4g} are scaled to 1. Angles in degrees are "
                "said by direction_deg, places by position_mm."
            )

    def _corrected(self, calibration: CameraCalibration | None, linearity: Linearity | None) -> frozenset[str]:
        rig = self.rig
        given = {
            "dark": bool(rig.dark),
            "flat": rig.flat is not None,
            "lens": calibration is not None or bool(rig.camera.distortion),
            "linearity": linearity is not None and linearity.verdict == "linear",
            "stray": rig.black_box is not None,
            "colour": rig.colour is not None,
        }
        return frozenset(name for name, there in given.items() if there)

    def _exposures(self, k: int, light: LightTable) -> list[float]:
        if light.exposures is not None:
            return list(light.exposures)
        found = [self.pictures.read(name).exposure.value for name in light.images]
        if all(value is not None for value in found):
            return [float(value) for value in found if value is not None]
        if any(value is not None for value in found) or len(found) > 1:
            shown = f"{sum(v is not None for v in found)} of {len(found)} pictures"
            raise InputError.of(f"light[{k}].exposures", shown, "tell their exposure (EXIF)", "Give exposures.")
        return [1.0]

    def _one_unit(self, exposures: Sequence[Sequence[float]]) -> None:
        given = [light.exposures is not None for light in self.rig.light]
        told = [e != [1.0] for e, g in zip(exposures, given, strict=True) if not g]
        if len(set(given)) > 1 or len(set(told)) > 1:
            raise InputError.of(
                "light.exposures", "given for some lights", "must be given for all, or for none", "Mend the rig file."
            )

    def _colour(self, development: Development) -> ColourCalibration | None:
        if self.rig.colour is None:
            return None
        picture = self.pictures.read(self.rig.colour.chart)
        value, _, clipped = development.linear(picture, float(picture.exposure.value or 1.0))
        found = calibrate_colour(np.where(clipped, np.nan, value), picture.name)
        # A chart tells colours, not how bright the lights are: the green of a neutral stays as it was.
        return replace(found, matrix=found.matrix / found.matrix[1].sum())

    def _without_stray(self, merged: Merged) -> Merged:
        if self.rig.black_box is None:
            return merged
        u0, v0, u1, v1 = self.rig.black_box
        part = merged.value[max(v0, 0) : v1, max(u0, 0) : u1]
        if not part.size or not np.isfinite(part).any():
            raise InputError.of("black_box", self.rig.black_box, "lies outside the pictures", "Give u0, v0, u1, v1.")
        return replace(merged, value=merged.value - np.nanmean(part, axis=(0, 1)))

    def _camera(self, columns: int, rows: int) -> tuple[Camera, CameraCalibration | None]:
        table = self.rig.camera
        if table.board is not None and table.kind == "board":
            b = table.board
            board = Board(b.kind, b.columns, b.rows, b.square_mm, b.marker_mm, b.dictionary)
            found = calibrate_camera([(name, self.pictures.read(name).values) for name in b.images], board)
            self.notes += found.notes
            if (found.camera.width, found.camera.height) != (columns, rows):
                shown = f"{found.camera.width}x{found.camera.height}"
                raise InputError.of("camera.board", shown, f"must be {columns}x{rows}", "Use the pictures' own size.")
            return found.camera, found
        focal = 1 / table.mm_per_pixel if table.kind == "orthographic" else float(table.focal_px or 0)
        u, v = table.centre_px or [(columns - 1) / 2, (rows - 1) / 2]
        if table.kind == "orthographic":
            self.notes.append("An orthographic camera is exact only far away: at 10 radii it is off by 10 %.")
        matrix = np.array([[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]])
        lens = np.array(table.distortion)
        return Camera(columns, rows, matrix, distortion=lens, orthographic=table.kind == "orthographic"), None

    def _sphere(
        self, frames: DevelopedFrames, camera: Camera, development: Development
    ) -> tuple[SpherePose | None, Sphere, FloatArray]:
        table = self.rig.sphere
        frame: NDArray[np.floating]
        kind: Kind
        shown: Kind
        if table.centre_mm is not None and table.radius_mm is not None:
            sd = [table.centre_sd_mm] * 3 + [table.radius_sd_mm]
            return None, Sphere(self._vector(table.centre_mm), table.radius_mm), np.diag(np.square(sd))
        near = None if table.near is None else (table.near[0], table.near[1], table.near[2])
        if table.outline is not None:
            frame = self.pictures.outline(table.outline, frames.shape[:2], development, table)
            kind = "silhouette" if table.kind is None or table.kind == "mask" else table.kind
        else:
            frame = all_round(frames[k].value for k in range(frames.count))
            shown = "all-round" if frames.count > 2 else "single"
            kind = shown if table.kind is None or table.kind == "mask" else table.kind
        pose = sphere_pose(
            frame, camera, table.radius_mm, kind=kind, near=near, radius_sd_mm=table.radius_sd_mm, cut=table.cut
        )
        self.notes += pose.notes
        return pose, pose.sphere, pose.covariance

    def _vector(self, vector: Sequence[float]) -> FloatArray:
        turned = np.asarray(vector, dtype=np.float64)
        return turned if self.rig.frame == "camera" else turned * TO_CAMERA

    def _lights(
        self, camera: Camera, sphere: Sphere, development: Development, count: int
    ) -> tuple[tuple[Light, ...], tuple[FloatArray, ...], tuple[tuple[Highlight, ...], ...]]:
        seen = [self._mirror(m, camera, development) for m in self.rig.mirror]
        highlights = tuple(zip(*seen, strict=True)) if seen else ()
        lights, covariances = [], []
        for k, table in enumerate(self.rig.light):
            intensity = np.array(table.intensity)
            if intensity.size not in (1, count):
                raise InputError.of(f"light[{k}].intensity", intensity.tolist(), f"must be 1 or {count}", "Mend it.")
            if table.position_mm is not None:
                at, covariance = self._vector(table.position_mm), table.sd_mm**2 * np.eye(3)
                lights.append(Light(intensity, None, at, table.solid_angle_sr or 0.0))
            elif (towards := table.towards(self.rig.frame)) is not None:
                d = np.array(towards)
                covariance = tilt_covariance(d, float(np.deg2rad(table.sd_deg)))
                lights.append(Light(intensity, d, None, table.solid_angle_sr or 0.0))
            elif self.rig.lights_are == "near":
                near = near_position(highlights[k])
                covariance = near.covariance
                lights.append(Light(intensity, None, near.position_mm, table.solid_angle_sr or 0.0))
            else:
                d, covariance = distant_direction(highlights[k])
                lights.append(Light(intensity, d, None, table.solid_angle_sr or 0.0))
            covariances.append(covariance)
        return tuple(lights), tuple(covariances), highlights

    def _mirror(self, table: MirrorTable, camera: Camera, development: Development) -> list[Highlight]:
        size = (camera.height, camera.width)
        near = None if table.near is None else (table.near[0], table.near[1], table.near[2])
        # Highlights clip; all that counts is where they are.
        frame: NDArray[np.floating]
        pictures = (development.linear(self.pictures.sized(name, size), 1.0)[0] for name in table.images)
        if table.outline is not None:
            frame, kind = self.pictures.outline(table.outline, size, development, None), "silhouette"
        else:
            frame, kind = all_round(pictures), "all-round"
        pose = sphere_pose(
            frame,
            camera,
            table.radius_mm,
            kind="silhouette" if kind == "silhouette" else "all-round",
            near=near,
            radius_sd_mm=table.radius_sd_mm,
        )
        self.notes += [f"Mirror ball: {note}" for note in pose.notes]
        self.mirrors.append(pose.sphere)
        found = []
        for name in table.images:
            value, _, clipped = development.linear(self.pictures.sized(name, size), 1.0)
            level = float(value[clipped].min()) if clipped.any() else None
            found.append(mirror_highlight(value, camera, pose, saturation=level, name=name))
        return found

    def _white(
        self,
        table: WhiteTable | None,
        development: Development,
        lights: Sequence[Light],
        sphere: Sphere,
        count: int,
        colour: ColourCalibration | None,
        *,
        grey: bool,
    ) -> tuple[FloatArray, float]:
        """Value at exposure 1 of a radiance of 1: V π / (ρ E cos θ) of a target of reflectance ρ that reads V."""
        if table is None:
            self.notes.append("Without a white reference the BRDF is known up to a factor.")
            return np.ones(count), float("nan")
        if table.value is not None:
            value = np.array(table.value)
            if value.size not in (1, count):
                raise InputError.of("white.value", value.tolist(), f"must be 1 or {count} numbers", "One a channel.")
        else:
            picture = self.pictures.read(table.image or "")
            exposure = float(table.exposure or picture.exposure.value or 1.0)
            merged = coloured(self._without_stray(merge([picture], [exposure], development)), colour, grey=grey)
            u0, v0, u1, v1 = table.box or [0, 0, 0, 0]
            part = merged.value[v0:v1, u0:u1].reshape(-1, count)
            if u0 < 0 or v0 < 0 or not part.size or not np.isfinite(part).all():
                bound = "must lie in the picture and not be clipped"
                raise InputError.of("white.box", table.box, bound, "Mark the white target.")
            value = np.median(part, axis=0)
        if not np.all(value > 0):
            raise InputError.of("white", value.tolist(), "reads black", "Mark the white target.")
        light = lights[table.light]
        facing = light.intensity * light.at(sphere.centre_mm)[1] * table.cosine
        return np.broadcast_to(value * np.pi / (table.reflectance * facing), (count,)).copy(), table.sd
