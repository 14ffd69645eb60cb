"""Points of a study: from values by path to a tissue, a reading and an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from livlab.acquire.instruments.models import Instrument
from livlab.config.errors import nearest
from livlab.errors import InputError
from livlab.model.tissue.readings import Reading, reading
from livlab.model.tissue.tissue import Tissue, override

_INSTRUMENT: TypeAdapter[Any] = TypeAdapter(Instrument)


@dataclass(frozen=True)
class Base:
    """What a point changes."""

    tissue: Tissue
    reading: Reading
    instrument: Instrument

    def at(self, values: Mapping[str, Any]) -> Base:
        """With values by path: reading.OPTION, instrument.FIELD, or a path of the tissue.

        Raises
        ------
        InputError
            A path that leads nowhere, or a value that does not fit.
        """
        parts: dict[str, dict[str, Any]] = {"reading": {}, "instrument": {}, "tissue": {}}
        for path, value in values.items():
            head, _, rest = path.partition(".")
            if head in ("reading", "instrument") and rest:
                parts[head][rest] = value
            else:
                parts["tissue"][path] = value
        made = {
            "tissue": override(self.tissue, parts["tissue"], by="study") if parts["tissue"] else self.tissue,
            "reading": _changed_reading(self.reading, parts["reading"]) if parts["reading"] else self.reading,
            "instrument": (
                _changed_instrument(self.instrument, parts["instrument"]) if parts["instrument"] else self.instrument
            ),
        }
        return Base(**made)  # type: ignore[arg-type]


def _changed_reading(base: Reading, options: Mapping[str, Any]) -> Reading:
    own = base.model_dump(exclude={"name", "base"})
    return reading(base.base, **{**own, **options})


def _changed_instrument(base: Instrument, fields: Mapping[str, Any]) -> Instrument:
    known = [k for k in type(base).model_fields if k != "kind"]
    for field in fields:
        if field not in known:
            hint = nearest(field, known) or f"It has: {', '.join(known)}."
            raise InputError.of(f"instrument.{field}", fields[field], f"a {base.kind} has no such field", hint)
    try:
        made: Instrument = _INSTRUMENT.validate_python({**base.model_dump(), **fields})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(x) for x in first["loc"][1:]) or next(iter(fields))
        raise InputError.of(f"instrument.{where}", first["input"], first["msg"], "Give a value that fits.") from None
    return made
