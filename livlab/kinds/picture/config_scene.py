"""What stands before the camera of a picture experiment: shape, camera, lights and other objects.

Lengths are in mm, angles in degrees (turned into radians where they are used), the world is right-handed.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from livlab.config.schema import Label, Section
from livlab.core.files import readable
from livlab.errors import ConfigError, InputError

Length = Annotated[float, Field(gt=0.0, le=1e4)]
Place = Annotated[tuple[float, float, float], Field(strict=False)]
Level = Annotated[float, Field(ge=0.0, le=1e6)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Reflectance = tuple[Share, Share, Share]
_THREE = "At 700, 546.1 and 435.8 nm; linear between them, held beyond."
_LEVEL = (
    "How bright: the radiance of a perfect white diffuser at the camera's target that faces this light alone. "
    "Every kind of light is measured so, and 1 is white in the picture."
)


def _hash_of(path: str) -> str:
    remedy = "Name a file that is there."
    try:
        with readable(Path(path), "path", 1 << 40, remedy, ConfigError).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror or error}.", remedy=remedy) from None


class FileSpec(Section):
    """A file of the user's; its hash is part of the resolved experiment, so that a changed file is another run."""

    path: str = Field(min_length=1, description="The file.")
    sha256: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="Its hash, filled in by livlab; a file that differs is refused."
    )

    def resolve(self) -> Self:
        """The same, its hash written out.

        Raises
        ------
        ConfigError
            The file cannot be read, or is not the one that the hash was taken of.
        """
        found = _hash_of(self.path)
        if self.sha256 is not None and self.sha256 != found:
            raise ConfigError(
                f"{self.path}: its sha256 is {found[:12]}…, not {self.sha256[:12]}….",
                remedy="Bring the file back, or leave `sha256` out.",
            )
        return self.model_copy(update={"sha256": found})


class LiverShape(Section):
    """The liver that comes with livlab: an implicit solid with lobes, notch and gallbladder bed, meshed."""

    kind: Literal["liver"] = "liver"
    size_mm: Length = Field(140.0, description="Its largest extent.")
    resolution_mm: Length = Field(1.5, description="Cell of the grid that it is meshed on.")


class SphereShape(Section):
    """A sphere around the origin."""

    kind: Literal["sphere"]
    radius_mm: Length = Field(description="Its radius.")


class BlockShape(Section):
    """A box around the origin."""

    kind: Literal["block"]
    size_mm: tuple[Length, Length, Length] = Field(strict=False, description="Extent along x, y and z.")


class MeshShape(FileSpec):
    """A mesh of one's own (OBJ, PLY, STL): watertight, in mm; `livlab mesh` makes one from a segmentation."""

    kind: Literal["mesh"]


Shape = Annotated[LiverShape | SphereShape | BlockShape | MeshShape, Field(discriminator="kind")]


class Cut(Section):
    """A plane; what lies on the side its normal points to is cut away by constructive solid geometry."""

    point_mm: Place = Field(description="A point of the plane.")
    normal: Place = Field(description="Points to what is cut away.")

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if not math.hypot(*self.normal) > 1e-9:
            raise InputError.of("normal", self.normal, "must not be zero", "Give a direction.")
        return self


class Geometry(Section):
    """The body, and where its layers lie."""

    shape: Shape = Field(default_factory=LiverShape, description="The body's surface.")
    rotate_deg: Place = Field((0.0, 0.0, 0.0), description="Turned about x, then y, then z, through the origin.")
    layering: Literal["depth", "nested"] = Field(
        "depth",
        description="How layers (capsule and parenchyma) are told apart: by a point's distance to the surface, or by "
        "an inner mesh, the outer one moved inwards by the thickness of what lies above the last (Nunes 2019).",
    )
    cut: Cut | None = Field(None, description="A section: the body is cut by a plane.")


class CameraSpec(Section):
    """A pinhole camera."""

    position_mm: Place = Field(description="Where it stands.")
    target_mm: Place = Field((0.0, 0.0, 0.0), description="What it looks at: the picture's centre.")
    up: Place = Field((0.0, 0.0, 1.0), description="Which way is up in the picture.")
    fov_deg: float = Field(30.0, gt=0.1, lt=170.0, description="Angle of view over the picture's width.")
    width: int = Field(960, ge=1, le=8192, description="Pixels across.")
    height: int = Field(540, ge=1, le=8192, description="Pixels down.")

    @model_validator(mode="after")
    def _can_look(self) -> Self:
        view = [t - p for t, p in zip(self.target_mm, self.position_mm, strict=True)]
        if not math.hypot(*view) > 1e-6:
            raise InputError.of("target_mm", self.target_mm, "must not be where the camera stands", "Move one.")
        x, y, z = view
        a, b, c = self.up
        across = math.hypot(y * c - z * b, z * a - x * c, x * b - y * a)
        if not across > 1e-6 * math.hypot(*view) * max(math.hypot(*self.up), 1e-9):
            raise InputError.of("up", self.up, "must not lie along the view", "Give another direction.")
        return self


class AreaLight(Section):
    """A rectangle that shines on the side that faces the target."""

    kind: Literal["area"]
    position_mm: Place = Field(description="Its centre.")
    size_mm: tuple[Length, Length] = Field(strict=False, description="Width and height.")
    level: Level = Field(1.0, description=_LEVEL)


class PointLight(Section):
    """A point that shines alike in all directions."""

    kind: Literal["point"]
    position_mm: Place = Field(description="Where it is.")
    level: Level = Field(1.0, description=_LEVEL)


class SpotLight(Section):
    """A point that shines into a cone around the target."""

    kind: Literal["spot"]
    position_mm: Place = Field(description="Where it is.")
    cone_deg: float = Field(20.0, gt=0.0, lt=89.0, description="Half-angle beyond which it is dark.")
    even_deg: float = Field(15.0, gt=0.0, lt=89.0, description="Half-angle up to which it is even.")
    level: Level = Field(1.0, description=_LEVEL)

    @model_validator(mode="after")
    def _fades(self) -> Self:
        if not self.even_deg < self.cone_deg:
            raise InputError.of("even_deg", self.even_deg, f"must be below cone_deg = {self.cone_deg:g}", "Lower it.")
        return self


class DirectionalLight(Section):
    """Parallel light from far away."""

    kind: Literal["directional"]
    towards: Place = Field(description="Direction from the scene to the light.")
    level: Level = Field(1.0, description=_LEVEL)

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if not math.hypot(*self.towards) > 1e-9:
            raise InputError.of("towards", self.towards, "must not be zero", "Give a direction.")
        return self


class EnvironmentLight(Section):
    """Light from all around: even, or a picture of the surroundings (latitude–longitude)."""

    kind: Literal["environment"]
    level: Level = Field(1.0, description="Radiance of an even environment; factor on a picture's values.")
    image: FileSpec | None = Field(None, description="A picture (EXR) in place of an even environment.")


LightSpec = Annotated[
    AreaLight | PointLight | SpotLight | DirectionalLight | EnvironmentLight, Field(discriminator="kind")
]


class Matt(Section):
    """A Lambertian surface."""

    kind: Literal["matt"]
    reflectance: Reflectance = Field((0.5, 0.5, 0.5), strict=False, description="Albedo. " + _THREE)


class Metal(Section):
    """A metal, mirror-like or brushed."""

    kind: Literal["metal"]
    reflectance: Reflectance = Field((0.7, 0.7, 0.7), strict=False, description="Factor on a perfect mirror. " + _THREE)
    roughness: float = Field(0.1, ge=0.0, le=1.0, description="Beckmann roughness; 0 is a mirror.")


class Glass(Section):
    """A clear dielectric."""

    kind: Literal["glass"]
    n: float = Field(1.5, gt=1.0, lt=4.0, description="Refractive index.")


Material = Annotated[Matt | Metal | Glass, Field(discriminator="kind")]


class ObjectSpec(Section):
    """Another body in the scene."""

    name: Label = Field(description="How reports call it.")
    shape: Literal["sphere", "rectangle", "block", "cylinder"] = Field(
        description="A unit shape: sphere of radius 1, square and cube from −1 to 1, cylinder of radius 1 about z "
        "from −1 to 1."
    )
    scale_mm: Place = Field(description="How long 1 is along the shape's own x, y and z.")
    rotate_deg: Place = Field((0.0, 0.0, 0.0), description="Turned about x, then y, then z.")
    position_mm: Place = Field((0.0, 0.0, 0.0), description="Where its centre is.")
    material: Material = Field(description="What its surface is.")

    @model_validator(mode="after")
    def _has_size(self) -> Self:
        if not all(s > 0 for s in self.scale_mm):
            raise InputError.of("scale_mm", self.scale_mm, "must be > 0 along each axis", "Give lengths.")
        return self


def resolved_files(part: Any) -> Any:
    """A section with the hashes of its files written out, however deep."""
    if isinstance(part, FileSpec):
        return part.resolve()
    if isinstance(part, Section):
        changes = {k: resolved_files(getattr(part, k)) for k in type(part).model_fields}
        return part.model_copy(update=changes)
    if isinstance(part, tuple):
        return tuple(resolved_files(x) for x in part)
    return part
