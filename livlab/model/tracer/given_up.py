"""Paths that are given up before they end: what they still weighed, and how much light is missing for it.

A path is given up after so many steps, or after so many objects hit. It then still carries a weight w, at every
wavelength: the part of the light at its place and in its direction that would have come to the camera. What is
missing is w times that light, which nobody has seen; so it is bounded.

If L is the radiance of the scene without cuts, L' that of the cut paths and K what paths are given up with,
L = L' + K L. With the greatest values over all places and directions ‖L‖ ≤ ‖L'‖ / (1 − ‖K‖), and a pixel of given-up
weight k lacks at most k ‖L'‖ / (1 − ‖K‖). Of an evenly lit closed room this is what it lacks, exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.units import FloatArray

HEAVIEST = 64.0
"""Most that a given-up path counts. Sums are kept in whole numbers, which add up alike in any order."""

FINEST = 2.0**-20
"""Least unit of these sums."""

ENDLESS = 1e-3
"""Share of the light, fading between two cuts, below which what is missing is not known."""

SHRUNK = 4.0
"""Paths without given-up weight that a pixel's share is judged with: few samples tell little."""

_COUNTS = ("by_steps", "by_bounces", "max_steps", "max_bounces")


class Leftover:
    """A launch's sums of given-up weight, on the device.

    Attributes
    ----------
    pixels, padded
        Pixels of the picture and length of a row of the film.
    unit
        Weight of a count of 1.
    """

    def __init__(self, mi: Any, dr: Any, *, pixels: int, padded: int, paths_a_pixel: float) -> None:
        self.mi, self.dr = mi, dr
        self.pixels, self.padded = pixels, padded
        self.unit = max(FINEST, paths_a_pixel * (HEAVIEST + 1.0) / 2.0**32)
        self.sums = dr.zeros(mi.UInt32, pixels * padded)
        self.paths = dr.zeros(mi.UInt32, 2)
        self.inverse, self.width = dr.opaque(mi.Float, 1.0 / self.unit), dr.opaque(mi.UInt32, pixels)

    def add(self, row: Any, weight: Sequence[Any], bounced: Any) -> None:
        """Keep what the lanes' paths still weigh at every wavelength, and whether objects or steps ended them."""
        dr, mi = self.dr, self.mi
        at = (row % self.width) * self.padded
        for k, x in enumerate(weight):
            count = dr.ceil(dr.clip(x, 0.0, HEAVIEST) * self.inverse)
            dr.scatter_add(self.sums, mi.UInt32(count), at + k)
        dr.scatter_add(self.paths, mi.UInt32(1), dr.select(bounced, mi.UInt32(1), 0))

    def read(self, width: int) -> GivenUp:
        """To the host, `width` wavelengths wide."""
        by_steps, by_bounces = (int(x) for x in np.array(self.paths))
        if not by_steps + by_bounces:
            return GivenUp.none(self.pixels, width)
        sums = np.array(self.sums, dtype=np.float64).reshape(self.pixels, self.padded)[:, :width]
        return GivenUp(sums * self.unit, by_steps, by_bounces)


@dataclass
class GivenUp:
    """What was given up of a picture.

    Attributes
    ----------
    weight
        (pixel, W) sum of what the given-up paths still weighed.
    by_steps, by_bounces
        Paths given up after too many steps, and after too many objects hit.
    max_steps, max_bounces
        How many that is.
    """

    weight: FloatArray
    by_steps: int = 0
    by_bounces: int = 0
    max_steps: int = 0
    max_bounces: int = 0

    @classmethod
    def none(cls, pixels: int, width: int) -> GivenUp:
        """Nothing so far."""
        return cls(np.zeros((pixels, width)))

    @classmethod
    def of(cls, weight: FloatArray, counts: Mapping[str, Any]) -> GivenUp:
        """From its weight and what `counts` gave."""
        return cls(weight, *(int(counts[f"given_up_{name}"]) for name in _COUNTS))

    def counts(self) -> dict[str, int]:
        """All but the weight, for a file's attributes."""
        return {f"given_up_{name}": int(getattr(self, name)) for name in _COUNTS}

    @property
    def paths(self) -> int:
        """Paths given up."""
        return self.by_steps + self.by_bounces

    def add(self, other: GivenUp) -> None:
        """Add another launch's."""
        self.weight = self.weight + other.weight
        self.by_steps += other.by_steps
        self.by_bounces += other.by_bounces
        self.max_steps, self.max_bounces = other.max_steps, other.max_bounces

    def systematic(self, radiance: FloatArray, level: FloatArray, paths_a_pixel: int) -> FloatArray:
        """Bound of the radiance that is missing.

        Parameters
        ----------
        radiance
            (pixel, W) found.
        level
            (W,) radiance of a white surface under the scene's lights: there may be brighter places than the picture's.
        paths_a_pixel
            Samples.

        Returns
        -------
        (pixel, W): k ‖L'‖ / (1 − ‖K‖), with k a pixel's given-up weight a path, ‖L'‖ the brightest pixel or the
        level, ‖K‖ the greatest k, of which a pixel of few samples says little; infinite where ‖K‖ is 1 and light does
        not fade.
        """
        if not self.paths:
            return np.zeros_like(self.weight)
        share = self.weight / max(paths_a_pixel, 1)
        worst = np.maximum(share.mean(axis=0), (self.weight / (paths_a_pixel + SHRUNK)).max(axis=0))
        brightest = np.maximum(np.nan_to_num(radiance).max(axis=0), level)
        fades = 1.0 - worst
        bound = np.where(fades > ENDLESS, brightest / np.maximum(fades, ENDLESS), np.inf)
        return np.where(share > 0.0, share * np.where(share > 0.0, bound, 0.0), 0.0)

    def notes(self, paths: int, systematic: FloatArray, radiance: FloatArray) -> list[str]:
        """In words: how many of all paths, why, and what it means for a picture of this radiance."""
        if not self.paths:
            return []
        worst, brightest = float(systematic.max()), float(np.nan_to_num(radiance).max())
        missing = f"A pixel lacks at most {worst:.2g} for it, {worst / max(brightest, 1e-300):.2g} of the brightest."
        if not np.isfinite(worst):
            missing = "How much light is missing nobody can tell: it does not fade on its way."
        said = []
        for count, after, name, why in (
            (self.by_steps, f"{self.max_steps} steps", "max_steps", "absorb more in the tissue"),
            (self.by_bounces, f"{self.max_bounces} objects hit", "max_bounces", "make the objects darker"),
        ):
            if count:
                said.append(
                    f"{count} of {paths} paths were given up after {after}, with light still to be found. {missing} "
                    f"Stated as `systematic`; to lower it, raise {name} or {why}."
                )
        return said
