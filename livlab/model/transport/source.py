"""Light that falls on a stack: collimated or diffuse, on a point, a square or a disc."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from livlab.errors import InputError


@dataclass(frozen=True)
class Source:
    """Where the light comes from; make it by `collimated` or `diffuse`.

    Attributes
    ----------
    kind
        "collimated" or "diffuse" (Lambertian: cosine-weighted over the hemisphere).
    angle_rad
        Angle of incidence from the normal in the medium above, in the x-z plane.
    square_half_width_mm, disc_radius_mm
        Uniform beam on |x|, |y| ≤ half width, or within the radius; both 0: a pencil at the origin.
    """

    kind: Literal["collimated", "diffuse"] = "collimated"
    angle_rad: float = 0.0
    square_half_width_mm: float = 0.0
    disc_radius_mm: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in ("collimated", "diffuse"):
            raise InputError.of("source.kind", self.kind, "must be 'collimated' or 'diffuse'", "Name one of the two.")
        if not 0.0 <= self.angle_rad < math.pi / 2:
            raise InputError.of(
                "source.angle_rad", self.angle_rad, "must be within [0, π/2)", "Measure from the normal, in radians."
            )
        for name in ("square_half_width_mm", "disc_radius_mm"):
            value = getattr(self, name)
            if not (value >= 0.0 and math.isfinite(value)):
                raise InputError.of(f"source.{name}", value, "must be finite and >= 0", "Give a length in mm.")
        if self.square_half_width_mm and self.disc_radius_mm:
            raise InputError.of(
                "source.disc_radius_mm", self.disc_radius_mm, "a beam is a square or a disc", "Drop one of the two."
            )

    @classmethod
    def collimated(
        cls, angle_rad: float = 0.0, *, square_half_width_mm: float = 0.0, disc_radius_mm: float = 0.0
    ) -> Source:
        """Parallel rays.

        >>> Source.collimated().angle_rad
        0.0
        """
        return cls("collimated", angle_rad, square_half_width_mm, disc_radius_mm)

    @classmethod
    def diffuse(cls, *, square_half_width_mm: float = 0.0, disc_radius_mm: float = 0.0) -> Source:
        """Lambertian light from the whole hemisphere above."""
        return cls("diffuse", 0.0, square_half_width_mm, disc_radius_mm)

    @property
    def extended(self) -> bool:
        """Whether entry points spread over an area."""
        return self.square_half_width_mm > 0.0 or self.disc_radius_mm > 0.0

    @property
    def reach_mm(self) -> float:
        """Largest |x| or |y| of an entry point."""
        return max(self.square_half_width_mm, self.disc_radius_mm)


def check_half_width(half_width_mm: float | None, source: Source) -> None:
    """Refuse a square sample without size, or narrower than the beam; None has no sides.

    Raises
    ------
    InputError
    """
    if half_width_mm is None:
        return
    if not half_width_mm > 0 or math.isinf(half_width_mm):
        raise InputError.of("half_width_mm", half_width_mm, "must be finite and > 0", "Use None for no sides.")
    if source.reach_mm > half_width_mm:
        raise InputError.of(
            "source", source.reach_mm, f"beam reaches beyond half_width_mm = {half_width_mm}", "Narrow the beam."
        )
