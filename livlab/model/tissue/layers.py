"""A layer of tissue: thickness, index, elements, and how their fractions change with depth."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, StringConstraints, model_validator

from livlab.config.errors import nearest
from livlab.errors import InputError
from livlab.model.tissue.elements import Element
from livlab.model.tissue.elements.base import Share
from livlab.model.tissue.spectra import Index, Spec, names_of

NAME = r"^[^\s.*\[\]](?:[^.*\[\]]{0,62}[^\s.*\[\]])?$"
"""A name that a path can hold: no dot, star or bracket, no blank at its ends."""

Name = Annotated[str, StringConstraints(pattern=NAME)]


class Slice(Spec):
    """A sublayer: where it ends, as share of the layer's thickness from the surface, and its fractions."""

    to: float = Field(gt=0.0, le=1.0, description="Lower end, share of the layer's thickness from the surface.")
    fractions: dict[str, Share] = Field(description="Volume fraction of elements, by name.")


@dataclass(frozen=True)
class FlatLayer:
    """A layer of constant composition, as transport sees it."""

    name: str
    thickness_mm: float
    index: Index
    elements: Mapping[str, Element]


class Layer(Spec):
    """A layer of the tissue; with a `profile` it stands for sublayers (Nunes 2019, Table 6.1)."""

    name: Name = Field(description="Name, as paths and reports use it.")
    thickness_mm: float = Field(gt=0.0, allow_inf_nan=True, description="Thickness in mm; inf for the last layer only.")
    index: Index = Field(description="Refractive index, also of the medium around fibres.")
    elements: dict[str, Element] = Field({}, description="Elements by name.")
    profile: tuple[Slice, ...] = Field((), strict=False, description="Sublayers from the surface down, if it has any.")
    sources: dict[str, str] = Field({}, description="Where each number came from, by its key.")

    @model_validator(mode="after")
    def _holds_together(self) -> Layer:
        ends = [x.to for x in self.profile]
        if self.profile and (sorted(set(ends)) != ends or abs(ends[-1] - 1.0) > 1e-9):
            raise InputError.of("profile", ends, "ends must rise to 1", "Order the sublayers from the surface down.")
        for name in self.elements:
            if not re.fullmatch(NAME, name):
                raise InputError.of(
                    "elements", name, "a name holds no dot, star or bracket, and no blank at its ends", "Rename it."
                )
        for part in self.profile:
            for name in part.fractions:
                if name in self.elements and not self.elements[name].budget:
                    raise InputError.of("profile", name, "has no volume fraction", "Leave it out of the profile.")
                if name not in self.elements:
                    raise InputError.of(
                        "profile",
                        name,
                        f"is no element of layer {self.name}",
                        nearest(name, self.elements) or "Add the element to the layer.",
                    )
        for name, element in self.elements.items():
            replaced = element.stands_in_for
            if replaced and replaced not in self.elements:
                raise InputError.of(
                    f"elements.{name}.replaces",
                    replaced,
                    f"is no element of layer {self.name}",
                    nearest(replaced, self.elements) or "Name one, or leave it out.",
                )
        for flat in self.flat():
            _fits(flat)
        return self

    def flat(self) -> tuple[FlatLayer, ...]:
        """The layer as layers of constant composition: itself, or its sublayers named "NAME 1", "NAME 2", …."""
        if not self.profile:
            return (FlatLayer(self.name, self.thickness_mm, self.index, self.elements),)
        made = []
        start = 0.0
        for number, part in enumerate(self.profile, start=1):
            elements = {
                name: element.with_share(part.fractions[name]) if name in part.fractions else element
                for name, element in self.elements.items()
            }
            thickness = (part.to - start) * self.thickness_mm
            made.append(FlatLayer(f"{self.name} {number}", thickness, self.index, elements))
            start = part.to
        return tuple(made)

    def dataset_names(self) -> tuple[str, ...]:
        """Datasets that the layer needs."""
        return (*names_of(self.index), *(n for x in self.elements.values() for n in x.dataset_names()))


def _fits(layer: FlatLayer) -> None:
    for budget in ("composition", "structure"):
        shares = {n: x.share for n, x in layer.elements.items() if x.budget == budget}
        total = sum(shares.values())
        if total > 1.0 + 1e-9:
            listed = ", ".join(f"{n} {s:g}" for n, s in shares.items())
            raise InputError.of(
                f"fractions of {layer.name}", round(total, 9), f"must sum to at most 1 ({listed})", "Lower a fraction."
            )
