"""What a layer is made of: an element is a file here and a row of `ELEMENTS`; everything else follows from the row."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from livlab.model.tissue.elements.base import ElementBase
from livlab.model.tissue.elements.blood import Blood
from livlab.model.tissue.elements.cell import Cell
from livlab.model.tissue.elements.fibre import Fibre
from livlab.model.tissue.elements.law_absorber import LawAbsorber
from livlab.model.tissue.elements.mixture import Mixture
from livlab.model.tissue.elements.pigment import Pigment
from livlab.model.tissue.elements.power_law import PowerLawScatterer
from livlab.model.tissue.elements.published import PublishedScatterer
from livlab.model.tissue.elements.solute import Solute

ELEMENTS: tuple[type[ElementBase], ...] = (
    Fibre,
    Blood,
    Mixture,
    Pigment,
    Solute,
    LawAbsorber,
    Cell,
    PowerLawScatterer,
    PublishedScatterer,
)
"""Every element, in the order of the schema."""

if TYPE_CHECKING:
    Element = ElementBase
else:
    Element = Annotated[reduce(or_, ELEMENTS), Field(discriminator="kind")]
"""Any element, told apart by its `kind`."""

__all__ = ["ELEMENTS", "Element", "ElementBase"]
