"""Which effects a picture calls for, by the planner that knows plane layers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.effects.plane import ANGLES_DEG, widest_change
from livlab.errors import InputError
from livlab.kinds.picture.config import PictureExperiment
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue

if TYPE_CHECKING:
    from livlab.effects.plan import Plan

LOOKED_AT = 3
"""Wavelengths that are planned for: where the last layer absorbs least and most, and between. Each is worked out once
an effect, so that a plan takes about 3 s of a core a wavelength where there are many effects."""


@dataclass(frozen=True)
class PicturePlan:
    """A plan, and the stack that follows from it at all of the picture's wavelengths.

    Attributes
    ----------
    plan
        Made at some of the wavelengths.
    wavelength_nm
        Those.
    stack
        What is simulated.
    widest
        Largest change of the radiance factor of flat layers over `ANGLES_DEG` of light and eye, mean over azimuth.
    """

    plan: Plan
    wavelength_nm: tuple[float, ...]
    stack: OpticalStack
    widest: float

    @property
    def told(self) -> str:
        """One sentence: what is left out, and how far that moves flat layers; empty if nothing is."""
        if not self.plan.dropped:
            return ""
        at = ", ".join(f"{x:g}" for x in self.wavelength_nm)
        return (
            f"left out {', '.join(self.plan.dropped)}; by the plan the radiance factor of flat layers moves by at most "
            f"{self.plan.bound:.2g} on the normal in light at 45°, and by {self.widest:.2g} at angles of light and eye "
            f"up to {ANGLES_DEG[-1]:.0f}° (at {at} nm)."
        )


def looked_at_of(stack: OpticalStack) -> list[int]:
    """Indices of the wavelengths that are planned for, rising."""
    absorbed = sum(
        ((1.0 - i.albedo) * i.rate for i in stack.layers[-1].interactions), np.zeros_like(stack.wavelength_nm)
    )
    count = len(absorbed)
    ranks = np.linspace(0, count - 1, min(LOOKED_AT, count)).round().astype(int)
    return sorted(np.argsort(absorbed, kind="stable")[ranks].tolist())


def plan_picture(config: PictureExperiment, tissue: Tissue, reading: Reading, stack: OpticalStack) -> PicturePlan:
    """The plan for flat layers of a tissue that a camera sees; a body that is thin or lit from behind is beyond it.

    Raises
    ------
    InputError
        The experiment asks for no plan.
    """
    from livlab.effects.catalogue import catalogue
    from livlab.effects.plan import plan, without
    from livlab.effects.scene import OpticalScene

    asked = config.effects
    if asked is None:
        raise InputError.of("effects", None, "asks for no plan", "Write effects = 'auto'.")
    looked_at = looked_at_of(stack)
    made = plan(
        stack.at(looked_at),
        HyperspectralCamera(),
        asked.tolerance,
        asked.forced,
        tolerance_of=asked.tolerance_of,
        mode=asked.mode,
        tissue=tissue,
        reading=reading,
        literal=config.sampling.estimator == "analog",
    )
    scene = OpticalScene(stack, HyperspectralCamera())
    reduced = without(scene, catalogue(scene, tissue, reading), frozenset(made.dropped)).stack
    widest = widest_change(stack.at(looked_at), reduced.at(looked_at)) if made.dropped else 0.0
    return PicturePlan(made, tuple(float(x) for x in stack.wavelength_nm[looked_at]), reduced, widest)
