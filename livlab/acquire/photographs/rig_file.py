"""`rig.toml`: which pictures belong to which light, and what is known about camera, sphere and lights.

Everything lies beside the file: a path that is absolute, climbs out with `..` or leads out through a link is refused.
The world is the camera's frame (x right, y down, z away from the camera, mm) unless `frame` says otherwise.
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from livlab.config.errors import explain
from livlab.core.toml_text import parse_toml
from livlab.errors import ConfigError, InputError

NAME = "rig.toml"
LARGEST_BYTES = 1 << 20

FilePath = Annotated[str, Field(min_length=1, max_length=1000)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Box = Annotated[list[int], Field(min_length=4, max_length=4)]
Positive = Annotated[float, Field(gt=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class BoardTable(_Table):
    """Pictures of a calibration board."""

    images: Annotated[list[FilePath], Field(min_length=3)] = Field(description="Pictures of the board.")
    kind: Literal["charuco", "chessboard"] = Field("charuco", description="What the board is.")
    columns: int = Field(ge=3, description="Squares of a ChArUco board, inner corners of a chessboard, across.")
    rows: int = Field(ge=3, description="The same, downwards.")
    square_mm: Positive = Field(description="Side of a square.")
    marker_mm: float = Field(0.0, ge=0, description="Side of a marker.")
    dictionary: str = Field("DICT_4X4_50", description="OpenCV's name of the markers.")


class CameraTable(_Table):
    """The camera: orthographic, a pinhole of known focal length, or one from pictures of a board."""

    kind: Literal["orthographic", "pinhole", "board"] = Field(description="How the camera is known.")
    mm_per_pixel: Positive = Field(1.0, description="Scale of an orthographic camera.")
    focal_px: Positive | None = Field(None, description="Focal length of a pinhole, px.")
    centre_px: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="Principal point (u, v); the middle of the picture where absent."
    )
    distortion: list[float] = Field(default_factory=list, description="k1, k2, p1, p2, k3.")
    focal_sd: float = Field(0.0, ge=0, description="Relative standard uncertainty of the focal length.")
    board: BoardTable | None = Field(None, description="Pictures of the board.")

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.kind == "pinhole" and self.focal_px is None:
            raise InputError.of(
                "camera.focal_px", None, "is needed by a pinhole", "Give it, or calibrate with a board."
            )
        if self.kind == "board" and self.board is None:
            raise InputError.of("camera.board", None, "is needed", "Name the pictures of the board.")
        return self


class SphereTable(_Table):
    """The sphere: its size, and the picture in which its outline is looked for."""

    radius_mm: Positive | None = Field(None, description="Radius; an orthographic camera reads it off the picture.")
    radius_sd_mm: float = Field(0.0, ge=0, description="Standard uncertainty of the radius.")
    outline: FilePath | None = Field(None, description="Silhouette or mask; absent: the maximum over the lights.")
    kind: Literal["all-round", "silhouette", "single", "mask"] | None = Field(
        None, description="What the outline picture is; a mask is not decoded. Absent: a mask if it holds two values."
    )
    near: Vector | None = Field(None, description="Roughly where it is: u, v, radius in px.")
    cut: bool = Field(False, description="Take a sphere of which a part lies outside the pictures.")
    centre_mm: Vector | None = Field(None, description="Centre, where it is known.")
    centre_sd_mm: float = Field(0.0, ge=0, description="Standard uncertainty of a known centre.")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.centre_mm is not None and self.radius_mm is None:
            raise InputError.of("sphere.radius_mm", None, "is needed with centre_mm", "Give both, or neither.")
        return self


class StackTable(_Table):
    """An exposure stack of one still scene, which shows the response."""

    images: Annotated[list[FilePath], Field(min_length=2)] = Field(description="Pictures of one still scene.")
    exposures: Annotated[list[Positive], Field(min_length=2)] | None = Field(None, description="Absent: from EXIF.")


class OwnResponseTable(_Table):
    """The response of some pictures that is not that of the others."""

    images: Annotated[list[FilePath], Field(min_length=1)] = Field(description="As they are named elsewhere.")
    kind: Literal["linear", "srgb", "gamma", "table"] = Field(description="The declaration.")
    gamma: Positive | None = Field(None, description="linear = stored ** gamma.")
    table: FilePath | None = Field(None, description="CSV of linear values at equally spaced stored ones.")


class ResponseTable(_Table):
    """How stored values stand for linear ones."""

    kind: Literal["linear", "srgb", "gamma", "table", "debevec"] = Field("linear", description="The declaration.")
    gamma: Positive | None = Field(None, description="linear = stored ** gamma.")
    table: FilePath | None = Field(None, description="CSV of linear values at equally spaced stored ones.")
    stack: StackTable | None = Field(None, description="Exposures that test the declaration, or give debevec's.")
    own: list[OwnResponseTable] = Field(default_factory=list, description="Pictures with another response.")
    saturation: float = Field(0.99, gt=0.1, le=1, description="Share of full scale that counts as clipped.")
    full_scale: Positive = Field(1.0, description="Value that counts as 1 in floating-point files.")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        needed = {"gamma": self.gamma, "table": self.table, "debevec": self.stack}
        if self.kind in needed and needed[self.kind] is None:
            name = "stack" if self.kind == "debevec" else self.kind
            raise InputError.of(f"response.{name}", None, f"is needed by kind {self.kind}", "Add it.")
        return self


class NoiseTable(_Table):
    """Noise of linear values as shares of full scale: variance = read² + gain · value."""

    read: float = Field(0.0, ge=0, description="Standard deviation in the dark.")
    gain: float = Field(0.0, ge=0, description="Variance per value: 1 / (electrons at full scale).")


class FrameTable(_Table):
    """A dark or flat frame."""

    image: FilePath = Field(description="The picture.")
    exposure: Positive | None = Field(None, description="Relative exposure; absent: from EXIF, else 1.")


class WhiteTable(_Table):
    """A white target of known reflectance that faces a light where the sphere stands."""

    image: FilePath | None = Field(None, description="Picture of the target.")
    box: Box | None = Field(None, description="Columns and rows on it: u0, v0, u1, v1.")
    value: list[Positive] | None = Field(None, description="What it reads at exposure 1, in place of a picture.")
    exposure: Positive | None = Field(None, description="Exposure of its picture.")
    reflectance: float = Field(0.99, gt=0, le=1.2, description="Its diffuse reflectance.")
    sd: float = Field(0.02, ge=0, description="Relative standard uncertainty of all of it.")
    light: int = Field(0, ge=0, description="Which light lit it, counted from 0.")
    cosine: float = Field(1.0, gt=0, le=1, description="Cosine between its normal and the light.")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.image is None) == (self.value is None) or (self.image is not None and self.box is None):
            raise InputError.of("white", "image and value", "must be value, or image and box", "Give one of them.")
        return self


class ColourTable(_Table):
    """A colour chart that takes the camera's colours to linear sRGB."""

    chart: FilePath = Field(description="Picture of a 24-patch chart.")


class MirrorTable(_Table):
    """A mirror ball: one picture for each light, with the same camera."""

    images: Annotated[list[FilePath], Field(min_length=1)] = Field(description="One picture a light, in their order.")
    radius_mm: Positive | None = Field(None, description="Radius.")
    radius_sd_mm: float = Field(0.0, ge=0, description="Standard uncertainty of the radius.")
    outline: FilePath | None = Field(None, description="Silhouette or mask; absent: the maximum over the lights.")
    near: Vector | None = Field(None, description="Roughly where it is: u, v, radius in px.")


class LightTable(_Table):
    """One light: its pictures, and where it stands if no mirror ball shows it."""

    images: Annotated[list[FilePath], Field(min_length=1)] = Field(description="Its exposures of the sphere.")
    exposures: Annotated[list[Positive], Field(min_length=1)] | None = Field(None, description="Absent: from EXIF.")
    direction: Vector | None = Field(None, description="From the sphere to a distant light; scaled to unit length.")
    direction_deg: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="Of a distant light: from the camera's direction, and round it from the right, 90 above."
    )
    position_mm: Vector | None = Field(None, description="Of a near light.")
    sd_deg: float = Field(0.0, ge=0, description="Standard uncertainty of the direction, degrees.")
    sd_mm: float = Field(0.0, ge=0, description="Standard uncertainty of the position, mm.")
    intensity: Annotated[list[Positive], Field(min_length=1)] = Field([1.0], description="One, or one a channel.")
    solid_angle_sr: float | None = Field(
        None, ge=0, lt=6.28, description="That the source spans from the sphere; 0 of a point. Absent: not known."
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [name for name in ("direction", "direction_deg", "position_mm") if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError.of("light", " and ".join(given), "must not both be given", "Keep one.")
        if self.direction_deg is not None and not 0 <= self.direction_deg[0] <= 180:
            bound = "must begin with 0 to 180 degrees from the camera's direction"
            raise InputError.of("light.direction_deg", self.direction_deg, bound, "Say [from the camera, round it].")
        if self.direction is not None and not any(self.direction):
            raise InputError.of("light.direction", self.direction, "must not be 0", "Point it at the light.")
        if self.exposures is not None and len(self.exposures) != len(self.images):
            counts = f"{len(self.images)} images, {len(self.exposures)} exposures"
            raise InputError.of("light.exposures", counts, "must be one for each", "Mend the lists.")
        return self

    @property
    def placed(self) -> bool:
        """Whether it says where it is."""
        return any(x is not None for x in (self.direction, self.direction_deg, self.position_mm))

    def towards(self, frame: str) -> tuple[float, float, float] | None:
        """Unit vector to a distant light in the camera's frame (x right, y down, z away); None if none is said."""
        if self.direction_deg is not None:
            a, b = (math.radians(x) for x in self.direction_deg)
            x, y, z = math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)
            return x, -y, -z
        if self.direction is None:
            return None
        length = math.hypot(*self.direction)
        x, y, z = (component / length for component in self.direction)
        return (x, y, z) if frame == "camera" else (x, -y, -z)


class RigFile(_Table):
    """A rig file."""

    format: Literal[1] = Field(description="Version of this form: 1.")
    name: str = Field("", max_length=200, description="What the data set is called.")
    frame: Literal["camera", "photometric-stereo"] = Field(
        "camera", description="Of directions and positions: camera (y down, z away) or x right, y up, z to the camera."
    )
    channels: Literal["as stored", "grey"] = Field("as stored", description="Keep colours, or their mean.")
    lights_are: Literal["distant", "near"] = Field("distant", description="What mirror balls are to give.")
    intensities_are: Literal["as given", "from the sphere"] = Field(
        "as given", description="From the sphere: those at which it best follows a cosine, if it is matte."
    )
    camera: CameraTable
    sphere: SphereTable = Field(default_factory=SphereTable)
    response: ResponseTable = Field(default_factory=ResponseTable)
    noise: NoiseTable | None = None
    dark: list[FrameTable] = Field(default_factory=list)
    flat: FrameTable | None = None
    white: WhiteTable | None = None
    colour: ColourTable | None = None
    black_box: Box | None = Field(
        None, description="Columns and rows u0, v0, u1, v1 that are black in truth: their level is stray light."
    )
    mask: FilePath | None = Field(None, description="Picture that is > 0 where pixels may be used.")
    mirror: list[MirrorTable] = Field(default_factory=list)
    light: list[LightTable] = Field(default_factory=list, description="May be absent where mirror balls are all.")

    @model_validator(mode="after")
    def _counts(self) -> Self:
        if not self.light and not self.mirror:
            raise InputError.of("light", 0, "must be one at least", "Name the pictures of each light under [[light]].")
        for k, mirror in enumerate(self.mirror):
            if self.light and len(mirror.images) != len(self.light):
                counts = f"{len(mirror.images)} pictures, {len(self.light)} lights"
                raise InputError.of(f"mirror[{k}].images", counts, "must be one for each light", "Mend the list.")
        for k, light in enumerate(self.light):
            if not light.placed and not self.mirror:
                remedy = "Give direction, direction_deg or position_mm."
                raise InputError.of(f"light[{k}].direction", None, "is needed without a mirror ball", remedy)
        if self.lights_are == "near" and len(self.mirror) < 2 and any(x.position_mm is None for x in self.light):
            raise InputError.of("mirror", len(self.mirror), "near lights need two mirror balls", "Add a ball.")
        if len({len(mirror.images) for mirror in self.mirror}) > 1:
            balls = [len(mirror.images) for mirror in self.mirror]
            raise InputError.of("mirror.images", balls, "must be as many of each ball", "Mend the lists.")
        known = self.pictures()
        for k, own in enumerate(self.response.own):
            for name in own.images:
                if name not in known:
                    raise InputError.of(
                        f"response.own[{k}].images", name, "is no picture of this rig", "Mend its name."
                    )
        if self.white is not None and self.white.light >= len(self.light):
            raise InputError.of("white.light", self.white.light, f"must be < {len(self.light)}", "Count from 0.")
        return self

    def pictures(self) -> set[str]:
        """Names of all pictures."""
        lists = [*(x.images for x in self.light), *(x.images for x in self.mirror)]
        lists += [self.camera.board.images] if self.camera.board is not None else []
        lists += [self.response.stack.images] if self.response.stack is not None else []
        single = [self.sphere.outline, self.mask, *(x.outline for x in self.mirror), *(x.image for x in self.dark)]
        single += [x.image for x in (self.flat, self.white) if x is not None]
        single += [self.colour.chart] if self.colour is not None else []
        return {name for names in lists for name in names} | {name for name in single if name is not None}


def read_rig_file(path: Path) -> RigFile:
    """A rig file, checked; the pictures that it names are not opened.

    Raises
    ------
    ConfigError
        No such file, no TOML, unknown keys, wrong values or counts: with line, key, value, bound and remedy.
    """
    if not path.is_file():
        raise ConfigError.of("rig", str(path), "is not a file", f"Name a {NAME}, or a folder that holds one.")
    if path.stat().st_size > LARGEST_BYTES:
        raise ConfigError.of("rig", path.name, "is larger than 1 MiB", "Name the rig file, not a picture.")
    try:
        text = path.read_text(encoding="utf-8-sig")
        data = parse_toml(text)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path.name}: is no TOML ({error}).", remedy="Mend the file.") from error
    try:
        return RigFile.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, text, RigFile.model_json_schema(), path.name) from error


def within(folder: Path, name: str) -> Path:
    """The path of a file that a rig names, which has to lie in the rig's folder.

    Raises
    ------
    InputError
        An absolute path, one that climbs out, or a link that leads out.
    """
    plain = PurePosixPath(name.replace("\\", "/"))
    remedy = "Put the pictures beside the rig file, or below it."
    if not plain.parts or plain.is_absolute() or ".." in plain.parts or ":" in plain.parts[0] or "\0" in name:
        raise InputError.of("rig path", name, "must be relative to the rig file and not climb out", remedy)
    root = folder.resolve()
    try:
        found = (root / plain).resolve()
    except (OSError, RuntimeError) as error:  # links in a ring; a name that the system does not take
        raise InputError.of("rig path", name, f"leads nowhere ({error})", remedy) from error
    if not found.is_relative_to(root):
        raise InputError.of("rig path", name, "leads out of the rig's folder through a link", remedy)
    return found
