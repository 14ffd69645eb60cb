"""What is to be walked through: a tissue, and which shapes of the scene bound it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack


@runtime_checkable
class Distances(Protocol):
    """Distance to a body's surface on a grid, as `livlab.model.shapes` makes it.

    `values` are float32 [z, y, x] in mm, positive inside: exact near the surface, nowhere more than the distance.
    """

    @property
    def origin_mm(self) -> NDArray[np.float64]:
        """Place of the first value."""
        ...

    @property
    def spacing_mm(self) -> float:
        """Step of the grid."""
        ...

    @property
    def values(self) -> NDArray[np.float32]:
        """[z, y, x] distances."""
        ...


@dataclass(frozen=True, eq=False)
class Body:
    """A body of tissue in a scene.

    Attributes
    ----------
    stack
        Its layers from the surface inwards, at the wavelengths of the picture.
    surfaces
        Names (ids) of the shapes that bound it: one, whose inner layers are found by their depth below it; or one an
        interface from the outside in, nested, as many as the stack has layers, or one more around a clear inside.
    distances
        Distance field of the surface in mm, in the scene's own frame: needed with one surface if there is more than
        one layer, and with it no ray need be cast where the surface is far.
    mm_per_unit
        Length of the scene's unit.
    patch_mm
        How far a surface counts as flat to find a layer by its depth; None: so far that a surface with a tenth of the
        body's size as radius of curvature leaves it by 2 % of the layers' thickness.

    Raises
    ------
    InputError
        Numbers of surfaces, layers and fields that do not go together.
    """

    stack: OpticalStack
    surfaces: Sequence[str]
    distances: Distances | None = None
    mm_per_unit: float = 1.0
    patch_mm: float | None = None
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        names = (self.surfaces,) if isinstance(self.surfaces, str) else tuple(self.surfaces)
        object.__setattr__(self, "surfaces", names)
        if not names or len(set(names)) != len(names):
            raise InputError.of("surfaces", names, "must name distinct shapes", "Name the shape that bounds the body.")
        layers = len(self.stack.layers)
        if len(names) > 1 and len(names) not in {layers, layers + 1}:
            raise InputError.of(
                "surfaces",
                names,
                f"{len(names)} interfaces, but the stack has {layers} layers",
                "Name one shape an interface, merge layers (model.effects.reduce.merged), or tell them by depth.",
            )
        if len(names) == 1 and layers > 1 and self.distances is None:
            raise InputError.of(
                "distances",
                None,
                f"must be given: {layers} layers inside one surface are told by their depth",
                "Make it with livlab.model.shapes.distance_field.",
            )
        if not (math.isfinite(self.mm_per_unit) and self.mm_per_unit > 0):
            raise InputError.of("mm_per_unit", self.mm_per_unit, "must be > 0", "Give the scene's unit in mm.")
        if self.patch_mm is not None and not self.patch_mm > 0:
            raise InputError.of("patch_mm", self.patch_mm, "must be > 0", "Give a length, or None.")

    @property
    def nested(self) -> bool:
        """Whether every interface is a shape of its own."""
        return len(self.surfaces) > 1

    @property
    def hollow(self) -> bool:
        """Whether the innermost shape bounds a clear inside, of index `n_below`."""
        return len(self.surfaces) == len(self.stack.layers) + 1 and self.nested

    @property
    def depth_of_layers_mm(self) -> float:
        """Depth of the deepest interface between two layers."""
        return float(sum(x.thickness_mm for x in self.stack.layers[:-1]))
