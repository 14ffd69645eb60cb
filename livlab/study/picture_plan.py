"""Which effects a picture calls for, by the planner that knows plane layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from livlab.acquire.instruments import HyperspectralCamera
from livlab.config_picture import PictureExperiment
from livlab.errors import InputError
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue

if TYPE_CHECKING:
    from livlab.model.effects.plan import Plan


def plan_picture(config: PictureExperiment, tissue: Tissue, reading: Reading, stack: OpticalStack) -> Plan:
    """The plan for flat layers of a tissue that a camera sees; a body that is thin or lit from behind is beyond it.

    Raises
    ------
    InputError
        The experiment asks for no plan.
    """
    from livlab.model.effects.plan import plan

    asked = config.effects
    if asked is None:
        raise InputError.of("effects", None, "asks for no plan", "Write effects = 'auto'.")
    return plan(
        stack,
        HyperspectralCamera(),
        asked.tolerance,
        asked.forced,
        tolerance_of=asked.tolerance_of,
        mode=asked.mode,
        tissue=tissue,
        reading=reading,
        literal=config.sampling.estimator == "analog",
    )
