"""An element's fields as rows of a table: unit, bounds, default and meaning, as pydantic holds them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo


@dataclass(frozen=True)
class ElementParameter:
    """A field of an element, or of a part of one (`parts.NAME.share`).

    Attributes
    ----------
    key
        Its path below the element.
    unit
        Unit, "1" for a pure number; empty for what is none.
    low, high
        Bounds, None where there is none; `open_low`, `open_high` say that the bound itself is out.
    choices
        The words it can take, if it is one of some.
    default
        Value if not said; None if it must be said, or may be left out (`required` tells them apart).
    meaning
        What it is.
    """

    key: str
    unit: str
    low: float | None
    high: float | None
    open_low: bool
    open_high: bool
    is_number: bool
    choices: tuple[str, ...]
    required: bool
    default: Any
    meaning: str

    @property
    def bounds(self) -> str:
        """Bounds as mathematics writes them, or the choices."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low is None and self.high is None:
            return ""
        left = "(−∞" if self.low is None else f"{'(['[not self.open_low]}{self.low:g}"
        right = "∞)" if self.high is None else f"{self.high:g}{')]'[not self.open_high]}"
        return f"{left}, {right}"


def parameters_of(
    model: type[BaseModel], units: Mapping[str, str], skip: Collection[str] = ()
) -> tuple[ElementParameter, ...]:
    """A row a field of a model, and a row a field of what a table of parts (`parts.NAME.…`) holds."""
    return tuple(_rows(model, units, skip, ""))


def _rows(
    model: type[BaseModel], units: Mapping[str, str], skip: Collection[str], above: str
) -> Iterator[ElementParameter]:
    for key, field in model.model_fields.items():
        if key in skip:
            continue
        inner = [x for x in get_args(field.annotation) if isinstance(x, type) and issubclass(x, BaseModel)]
        if get_origin(field.annotation) is dict and inner:
            yield from _rows(inner[0], units, skip, f"{above}{key}.NAME.")
        else:
            yield _row(f"{above}{key}", field, units.get(key, ""))


def _row(key: str, field: FieldInfo, unit: str) -> ElementParameter:
    found = list(_leaves(field.annotation))
    kinds = [x for x in found if isinstance(x, type)]
    bounds: dict[str, float] = {}
    for part in (*field.metadata, *(x for x in found if not isinstance(x, type))):
        for own in (part, *getattr(part, "metadata", ())):
            bounds |= {b: getattr(own, b) for b in ("gt", "ge", "lt", "le") if getattr(own, b, None) is not None}
    words = tuple(x for x in get_args(field.annotation) if isinstance(x, str)) if _is_choice(field) else ()
    return ElementParameter(
        key=key,
        unit=unit,
        low=bounds.get("ge", bounds.get("gt")),
        high=bounds.get("le", bounds.get("lt")),
        open_low="gt" in bounds,
        open_high="lt" in bounds,
        is_number=float in kinds,
        choices=words,
        required=field.is_required(),
        default=None if field.is_required() else field.default,
        meaning=field.description or "",
    )


def _is_choice(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is Literal


def _leaves(annotation: Any) -> Iterator[Any]:
    """Types and constraints that an annotation is made of."""
    inner = get_args(annotation)
    if not inner or get_origin(annotation) is Literal:
        yield annotation
    for x in inner:
        yield from _leaves(x)
