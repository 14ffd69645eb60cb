"""The pictures that a rig file names: read, each with its own response, and what turns them into linear values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.linearity import CameraResponse, Linearity, debevec, from_exposures, response
from livlab.acquire.photographs.merge import Development, estimate_noise, flat_field
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.read import Photograph, eight_bit, read_photograph
from livlab.acquire.photographs.rig_file import FrameTable, ResponseTable, RigFile, SphereTable, within
from livlab.brdf.sphere import Noise
from livlab.errors import InputError

EDGE_WIDTH = 2.0
"""Pixels across the edge of a mask that may be neither in nor out."""

_NO_NOISE = Noise(read=1e-6)
"""Where a picture shows none: what its steps hide lies far below them."""


@dataclass
class RigPictures:
    """Reader of a rig's pictures.

    Attributes
    ----------
    rig, folder
        The rig file, and where its pictures lie.
    notes, warnings
        What a reader should know, and what is likely wrong; both grow.
    turned
        Names of pictures that EXIF turns.
    """

    rig: RigFile
    folder: Path
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    turned: dict[str, None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._own = {
            name: self._plain(own.kind, own.gamma, own.table) for own in self.rig.response.own for name in own.images
        }

    def read(self, name: str) -> Photograph:
        """A picture as stored, with its own response if the rig gives it one."""
        found = read_photograph(within(self.folder, name))
        if found.turned:
            self.turned[found.name] = None
        return replace(found, response=self._own[name]) if name in self._own else found

    def sized(self, name: str, size: tuple[int, int]) -> Photograph:
        """A picture that must have (rows, columns)."""
        picture = self.read(name)
        if picture.values.shape[:2] != size:
            shown = f"{picture.name}: {picture.values.shape[1]}x{picture.values.shape[0]}"
            raise InputError.of("picture", shown, f"must be {size[1]}x{size[0]} like the others", "Give it uncropped.")
        return picture

    def _plain(self, kind: str, gamma: float | None, table: str | None) -> CameraResponse:
        values = None
        if table is not None:
            try:
                values = np.loadtxt(within(self.folder, table), delimiter=",", ndmin=2)
            except (OSError, ValueError) as error:
                raise InputError.of("response.table", table, f"cannot be read ({error})", "Give a CSV.") from error
        return response(kind, gamma=gamma, table=values)

    def response(self, table: ResponseTable) -> tuple[CameraResponse, Linearity | None]:
        """The response of all pictures that have none of their own, and what an exposure stack says of it."""
        stack: list[Photograph] = []
        exposures: list[float] = []
        if table.stack is not None:
            stack = [self.read(name) for name in table.stack.images]
            exposures = [float(p.exposure.value or 0) for p in stack]
            if table.stack.exposures is not None:
                exposures = list(table.stack.exposures)
        if table.kind == "debevec":
            codes = [eight_bit(p) for p in stack]
            answer = debevec(codes, exposures)
            low, high = (float(np.percentile(codes, q)) / 255 for q in (0.5, 99.5))
            if high < 0.9:
                self.notes.append(
                    f"The stack shows stored values {low:.2f} to {high:.2f}; above, debevec extrapolates."
                )
        else:
            answer = self._plain(table.kind, table.gamma, table.table)
        if not stack:
            return answer, None
        plain = Development(answer, float_scale=table.full_scale)
        stored = [plain.stored(p) for p in stack]
        found = from_exposures([answer.decode(s) for s in stored], exposures, stored)
        warning = found.contradiction(answer.name)
        if warning:
            self.warnings.append(warning)
        return answer, found

    def development(self, answer: CameraResponse, first: Photograph, exposure: float) -> tuple[Development, str]:
        """Response, frames and noise together, and how the noise is known."""
        rig = self.rig
        development = Development(answer, saturation=rig.response.saturation, float_scale=rig.response.full_scale)
        dark = [(table.exposure, self.read(table.image)) for table in rig.dark]
        frames = tuple(
            (float(given or picture.exposure.value or exposure), development.linear(picture, 1.0)[0])
            for given, picture in dark
        )
        development = replace(development, dark=frames)
        if rig.flat is not None:
            flat = self._flat(rig.flat, development)
            development = replace(development, flat=flat.astype(np.float32))
        if rig.noise is not None:
            return replace(development, noise=Noise(rig.noise.read, rig.noise.gain)), "declared"
        # Estimated before the flat field, which multiplies the noise.
        return with_noise(development, first, exposure)

    def _flat(self, table: FrameTable, development: Development) -> FloatArray:
        picture = self.read(table.image)
        return flat_field(picture, development, float(table.exposure or picture.exposure.value or 1.0))

    def outline(
        self, name: str, size: tuple[int, int], development: Development, table: SphereTable | None
    ) -> NDArray[np.floating]:
        """An outline picture: a mask as it is, a photograph in linear values.

        Half way between encoded levels is elsewhere than half way between linear ones; but a mask is no photograph,
        and the grey at its edge is a share of the pixel.
        """
        picture = self.sized(name, size)
        if picture.response is None and ((table is not None and table.kind == "mask") or looks_like_a_mask(picture)):
            return np.asarray(development.stored(picture))
        value, _, clipped = development.linear(picture, float(picture.exposure.value or 1.0))
        if clipped.any() and len(np.unique(picture.values)) > 2:
            self.notes.append(f"{name} is clipped: right for a mask, but in a photograph it moves the outline.")
        return value


def with_noise(development: Development, first: Photograph, exposure: float) -> tuple[Development, str]:
    """The development with noise estimated from a picture, and how it is known."""
    plain = replace(development, flat=None, noise=None)
    value = plain.linear(first, exposure)[0]
    # Of the steps alone: neighbours in a block of a lossy picture do not show its errors.
    steps = plain.stored_variance(replace(first, scatter=None), plain.stored(first))
    noise = estimate_noise(value, steps)
    if noise is not None:
        return replace(development, noise=noise), "estimated"
    if plain.quantum(first) > 0:
        return replace(development, noise=_NO_NOISE), "quantisation"
    return development, "unknown"


def looks_like_a_mask(picture: Photograph) -> bool:
    """Whether a picture holds 0 and the highest value (or 1) and between them no more than the edge of a disc."""
    grey = picture.values.astype(np.float64).mean(axis=2)
    high = float(grey.max())
    low, top = int(np.count_nonzero(grey == 0)), int(np.count_nonzero(grey == high))
    # 2 sqrt(pi A) is the circumference of a disc of A pixels.
    edge = EDGE_WIDTH * 2 * np.sqrt(np.pi * min(low, top))
    return high in (picture.full_scale, 1.0) and grey.size - low - top <= edge
