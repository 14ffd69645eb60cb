"""A layer of tissue: thickness, index, elements, and how their fractions change with depth."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import Field, StringConstraints, model_validator

from livlab.config.errors import nearest
from livlab.errors import InputError
from livlab.model.tissue.elements import ELEMENTS, Element
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
    rest: str | None = Field(
        None, description="Element whose fraction is what the others of its budget leave of 1, whatever it says itself."
    )
    sources: dict[str, str] = Field({}, description="Where each number came from, by its key.")

    @model_validator(mode="before")
    @classmethod
    def _rest_said(cls, data: Any) -> Any:
        """What takes the rest need not say its fraction; an empty name says that nothing does."""
        if not isinstance(data, Mapping) or "rest" not in data:
            return data
        elements = data.get("elements")
        element = elements.get(data["rest"]) if isinstance(elements, Mapping) else None
        if isinstance(element, Mapping):
            key = next(
                (x.share_key() for x in ELEMENTS if element.get("kind") in get_args(x.model_fields["kind"].annotation)),
                "",
            )
            if key and key not in element:
                elements = {**elements, data["rest"]: {**element, key: 0.0}}  # type: ignore[dict-item]
        return {**data, "rest": data["rest"] or None, **({"elements": elements} if elements is not None else {})}

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
        if self.rest is not None:
            self._check_rest()
            self.elements[self.rest] = _filling(self.elements, self.rest)
        for flat in self.flat():
            _fits(flat, self)
        return self

    def _check_rest(self) -> None:
        """Whether the element that takes the rest can.

        Raises
        ------
        InputError
            It is none of the layer's, has no fraction, or is given one by the profile.
        """
        name = self.rest or ""
        if name not in self.elements:
            hint = nearest(name, self.elements) or f"It has: {', '.join(self.elements) or 'none'}."
            raise InputError.of("rest", name, f"is no element of layer {self.name}", hint)
        if not self.elements[name].budget:
            fit = [n for n, x in self.elements.items() if x.budget]
            raise InputError.of("rest", name, "has no volume fraction", f"Name one of {', '.join(fit)}.")
        if any(name in part.fractions for part in self.profile):
            raise InputError.of("rest", name, "is given fractions by the profile", "Leave it out of the profile.")

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
            if self.rest is not None:
                elements[self.rest] = _filling(elements, self.rest)
            thickness = (part.to - start) * self.thickness_mm
            made.append(FlatLayer(f"{self.name} {number}", thickness, self.index, elements))
            start = part.to
        return tuple(made)

    def dataset_names(self) -> tuple[str, ...]:
        """Datasets that the layer needs."""
        return (*names_of(self.index), *(n for x in self.elements.values() for n in x.dataset_names()))


def _filling(elements: Mapping[str, Element], rest: str) -> Element:
    """The element with what the others of its budget leave of 1; nothing where they leave nothing."""
    own = elements[rest]
    others = sum(x.share for n, x in elements.items() if n != rest and x.budget == own.budget)
    made = own.with_share(min(max(1.0 - others, 0.0), 1.0))
    said = {**own.sources, own.share_key(): "what the others leave of 1"}
    return made.model_copy(update={"sources": said})


def _fits(flat: FlatLayer, layer: Layer) -> None:
    for budget in ("composition", "structure"):
        shares = {n: x.share for n, x in flat.elements.items() if x.budget == budget}
        total = sum(shares.values())
        if total > 1.0 + 1e-9:
            listed = ", ".join(f"{n} {s:g}" for n, s in shares.items())
            remedy = f"Lower a fraction (by {total - 1.0:.3g} in all)"
            given = {n for part in layer.profile for n in part.fractions}
            free = [n for n in sorted(shares, key=lambda n: -shares[n]) if n not in given]
            if layer.rest not in shares and free:
                remedy += f", or let one be what the others leave: layers.{layer.name}.rest = {free[0]!r}"
            raise InputError.of(
                f"fractions of {flat.name}", round(total, 9), f"must sum to at most 1 ({listed})", f"{remedy}."
            )
