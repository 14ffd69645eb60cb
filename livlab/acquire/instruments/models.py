"""The table of virtual spectrometers: what an experiment file's `instrument.kind` can be.

A new one is a file beside this one, with a class that derives from `livlab.acquire.instruments.base.VirtualInstrument`,
and a row here. Every default that the literature does not fix is marked "assumed" in its description, which
`livlab schema` shows.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, TypeAlias

from pydantic import Field

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.fibre_probe import FibreProbe
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere

INSTRUMENTS: tuple[type[VirtualInstrument], ...] = (
    Collinear,
    IntegratingSphere,
    FibreProbe,
    HyperspectralCamera,
)
"""Every kind, in the order of the schema."""

if TYPE_CHECKING:
    Instrument: TypeAlias = VirtualInstrument
else:
    Instrument = Annotated[reduce(or_, INSTRUMENTS), Field(discriminator="kind")]
    """A virtual instrument, by `kind`."""
