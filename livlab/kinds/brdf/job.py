"""The BRDF job: what the experiment file asks for, checked first, then photographed, read, fitted and judged."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from livlab.kinds.brdf.config import BrdfExperiment

if TYPE_CHECKING:
    from livlab.runs.work import Run


def prepare(config: BrdfExperiment) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed.

    Parameters
    ----------
    config
        A resolved experiment.

    Raises
    ------
    InputError
        A material that Mitsuba does not take or that no rig can measure; a fit that names no model.
    DatasetError
        A dataset of the tissue that is missing or does not reach to a wavelength.
    EnvironmentProblem
        Mitsuba cannot run here.
    """
    if config.tissue is None:
        from livlab.kinds.brdf.materials import prepare_materials

        return prepare_materials(config)
    from livlab.kinds.brdf.liver import prepare_liver

    return prepare_liver(config)
