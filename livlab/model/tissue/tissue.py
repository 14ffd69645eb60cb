"""A tissue as data: layers of elements, what each reading changes in it, and changes by path."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from livlab.config.errors import explain, nearest
from livlab.core import markup
from livlab.errors import ConfigError, InputError
from livlab.model.tissue.elements import Element
from livlab.model.tissue.layers import FlatLayer, Layer
from livlab.model.tissue.readings import Reading, Subject, options_of
from livlab.model.tissue.spectra import Index, Spec, names_of


class Choice(Spec):
    """Values that a tissue takes under some readings: data, so that a reading needs no code for a tissue."""

    when: dict[str, str | float] = Field(min_length=1, description="Options of the reading that must all hold.")
    state: str = Field("", description="State in which it counts; every state if not said.")
    set: dict[str, Any] = Field(min_length=1, description="Value by path, e.g. layers.capsule.elements.elastin.index.")

    @model_validator(mode="after")
    def _known(self) -> Choice:
        for option, value in self.when.items():
            field = Reading.model_fields.get(option)
            if field is None:
                hint = nearest(option, Reading.model_fields)
                raise InputError.of("when", option, "is no option of a reading", hint or "See docs/readings.md.")
            try:
                TypeAdapter(field.rebuild_annotation()).validate_python(value, strict=True)
            except ValidationError:
                raise InputError.of(
                    f"when.{option}", value, "is no value of the option", "See docs/readings.md."
                ) from None
        return self

    def holds(self, reading: Reading, state: str) -> bool:
        """Whether it counts under a reading and in a state."""
        return (not self.state or self.state == state) and all(getattr(reading, k) == v for k, v in self.when.items())


class Tissue(Spec):
    """A tissue: plane layers from the surface down, and what the readings change in them."""

    name: str = Field(min_length=1, max_length=80, description="Name, as reports use it.")
    state: str = Field("", description="State it is in, e.g. ex_vivo.")
    description: str = Field("", description="What it is.")
    n_above: Index = Field(1.0, description="Refractive index above the first layer.")
    n_below: Index = Field(1.0, description="Refractive index below the last layer.")
    layers: tuple[Layer, ...] = Field(strict=False, min_length=1, description="Layers from the surface down.")
    choices: tuple[Choice, ...] = Field((), strict=False, description="What each reading changes.")
    given: dict[str, str] = Field(
        {}, description="Paths set by a state or a user, and by which: no reading changes them any more."
    )

    @model_validator(mode="after")
    def _holds_together(self) -> Tissue:
        names = [x.name for x in self.layers]
        for name in names:
            if names.count(name) > 1:
                raise InputError.of("layers", name, "two layers have this name", "Rename one.")
        for layer in self.layers[:-1]:
            if layer.thickness_mm == float("inf"):
                raise InputError.of(
                    f"layers.{layer.name}.thickness_mm", layer.thickness_mm, "only the last layer may be infinite",
                    "Give it a thickness.",
                )  # fmt: skip
        data = _plain(self.model_dump(exclude={"choices"}))
        for choice in self.choices:
            for path in choice.set:
                _place(data, path)
        return self

    def __repr__(self) -> str:
        layers = ", ".join(f"{x.name} {_thickness(x)}" for x in self.layers)
        return f"<Tissue {self.name}{f', {self.state}' if self.state else ''}: {layers}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """As a notebook shows it: each layer, its elements, and where each number came from."""
        parts = []
        for layer in self.layers:
            index = layer.index if isinstance(layer.index, float) else layer.index.kind
            rows = [row for name, element in layer.elements.items() for row in _rows(name, element)]
            thick = f"{_thickness(layer)}, index {index}"
            sublayers = f", {len(layer.profile)} sublayers" if layer.profile else ""
            columns = ("element", "", "value", "unit", "source")
            parts.append(markup.card(layer.name, thick + sublayers, markup.table(columns, rows)))
        about = ", ".join(filter(None, (self.state.replace("_", " "), self.description)))
        return markup.card(self.name, about, *parts)

    def flat(self) -> tuple[FlatLayer, ...]:
        """Layers of constant composition, sublayers written out."""
        return tuple(flat for layer in self.layers for flat in layer.flat())

    def under(self, reading: Reading) -> Tissue:
        """The tissue as a reading takes it: its choices made, its scatterers picked, nothing left to choose.

        What a user has set by path stays as set; a choice that names a state also overrides that state's value.
        """
        changes: dict[str, Any] = {}
        for choice in self.choices:
            if choice.holds(reading, self.state):
                for path, value in choice.set.items():
                    if self._takes_rest(path):
                        continue
                    by = next((who for p, who in self.given.items() if _overlap(p, path)), "")
                    if not by or (choice.state and by.startswith("state ")):
                        changes[path] = value
        made = override(self, changes, by=f"reading {reading.name}") if changes else self
        published = reading.parenchyma_scattering == "published"
        layers = []
        for layer in made.layers:
            stand_ins = {n: x.stands_in_for for n, x in layer.elements.items()}
            out = {r for r in stand_ins.values() if r} if published else {n for n, r in stand_ins.items() if r}
            kept = {n: x.settled() for n, x in layer.elements.items() if n not in out}
            profile = tuple(
                s.model_copy(update={"fractions": {n: f for n, f in s.fractions.items() if n in kept}})
                for s in layer.profile
            )
            rest = layer.rest if layer.rest in kept else None
            layers.append(layer.model_copy(update={"elements": kept, "profile": profile, "rest": rest}))
        return made.model_copy(update={"layers": tuple(layers), "choices": ()})

    def _takes_rest(self, path: str) -> str:
        """Layer of whose rest a path is the fraction, which follows from the others; empty for any other path."""
        for number, layer in enumerate(self.layers):
            if layer.rest is not None:
                tail = f"elements.{layer.rest}.{layer.elements[layer.rest].share_key()}"
                if path in (f"layers.{layer.name}.{tail}", f"layers.{number}.{tail}"):
                    return layer.name
        return ""

    def options(self) -> tuple[str, ...]:
        """Options of a reading that bear on this tissue: on what it is made of, its own choices, and any walk.

        Examples
        --------
        >>> from livlab.model.tissue.presets import load_preset
        >>> "hepatocyte_axes" in load_preset("liver").options(), "hepatocyte_axes" in load_preset("skin").options()
        (True, False)
        """
        subjects: set[Subject] = {s for x in self.layers for e in x.elements.values() for s in e.subjects()}
        return options_of(subjects | {"walk"}, {key for choice in self.choices for key in choice.when})

    def dataset_names(self) -> tuple[str, ...]:
        """Datasets that the tissue may need under any reading, sorted."""
        found = {*names_of(self.n_above), *names_of(self.n_below)}
        for layer in self.layers:
            found.update(layer.dataset_names())
        for choice in self.choices:
            found.update(v for path, v in choice.set.items() if path.endswith(".dataset"))
        return tuple(sorted(found))

    def with_layers(self, names: tuple[str, ...]) -> Tissue:
        """Only these layers, in the tissue's order.

        Raises
        ------
        ConfigError
            A layer that the tissue does not have.
        """
        known = [x.name for x in self.layers]
        for name in names:
            if name not in known:
                raise ConfigError.of("layers", name, f"{self.name} has {', '.join(known)}", nearest(name, known))
        out = [f"layers.{n}" for n in known if n not in names]

        def stays(path: str) -> bool:
            return not any(_overlap(path, gone) for gone in out)

        choices = []
        for choice in self.choices:
            kept = {p: v for p, v in choice.set.items() if stays(p)}
            if kept:
                choices.append(choice.model_copy(update={"set": kept}))
        return self.model_copy(
            update={
                "layers": tuple(x for x in self.layers if x.name in names),
                "choices": tuple(choices),
                "given": {p: by for p, by in self.given.items() if stays(p)},
            }
        )

    @classmethod
    def parse(cls, data: Mapping[str, Any], *, text: str = "", source: str = "tissue") -> Self:
        """A tissue from a table as TOML gives it, with errors that name path, value, bound and remedy.

        Raises
        ------
        ConfigError
            What does not fit.
        """
        plain = _plain(dict(data))
        try:
            return cls.model_validate(plain)
        except ValidationError as error:
            found = explain(error, plain, text, cls.model_json_schema(), source)
            raise ConfigError(_by_name(found.message, plain), remedy=found.remedy) from None


def override(tissue: Tissue, changes: Mapping[str, Any], *, by: str = "user") -> Tissue:
    """Change a tissue by path; the result is checked as a whole.

    Parameters
    ----------
    changes
        Value by path. A layer is found by name (or number from 0), an element by name:
        `layers.parenchyma.elements.blood.oxygenation`. A whole table can be set, and an element added.
    by
        Who changes it; kept in `given`, so that reports can say it and no reading changes it back.

    Raises
    ------
    ConfigError
        A path that leads nowhere, or a value that does not fit.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> redder = override(load_preset("liver"), {"layers.parenchyma.elements.blood.oxygenation": 0.6})
    >>> redder.layers[1].elements["blood"].oxygenation
    0.6
    """
    data = _plain(tissue.model_dump())
    for path, value in changes.items():
        place, key = _place(data, path)
        place[key] = _plain(value)
        data["given"][path] = by
    made = type(tissue).parse(data, source=f"tissue {tissue.name}")
    for path in changes:
        if layer := made._takes_rest(path):
            raise ConfigError.of(
                path, changes[path], f"follows from the others, since it takes the rest of {layer}",
                f"Leave it out, or set layers.{layer}.rest = '' first.",
            )  # fmt: skip
    return made


def value_at(tissue: Tissue, path: str) -> Any:
    """The value that a path leads to, as `override` takes it.

    Raises
    ------
    ConfigError
        A path that leads nowhere.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> value_at(load_preset("liver"), "layers.parenchyma.elements.blood.fraction")
    0.084
    """
    place, key = _place(_plain(tissue.model_dump()), path)
    if isinstance(place, dict) and key not in place:
        raise _lost(path, str(key), path.rpartition(".")[0], list(place))
    return place[key]


def _thickness(layer: Layer) -> str:
    return "endless" if math.isinf(layer.thickness_mm) else f"{layer.thickness_mm:g} mm"


def _rows(name: str, element: Element) -> list[tuple[object, ...]]:
    """Rows of an element in a table: its numbers with unit and source, then the datasets it draws on."""
    title = f"{name} ({element.kind.replace('_', ' ')})"
    rows: list[tuple[object, ...]] = []
    for x in element.values():
        if isinstance(x.value, float):
            bare = re.sub(r"_(um|nm|per_cm|g_per_l|umol_per_l)$", "", x.label).replace("_", " ")
            unit = "" if x.unit == "1" else x.unit
            rows.append((title, x.phrase or bare, x.value, unit, element.sources.get(x.key, "")))
    rows += [(title, "dataset", text, "", "") for text in element.dataset_names()]
    return [("" if k else title, *row[1:]) for k, row in enumerate(rows)]


def _place(data: Any, path: str) -> tuple[Any, Any]:
    """The table (or list) and the key that a path leads to; the last key of a table may be new."""
    parts = path.split(".")
    here = data
    done = ""
    for position, part in enumerate(parts):
        key: Any = part
        if isinstance(here, list):
            names = [x.get("name") for x in here if isinstance(x, dict)]
            if part in names:
                key = names.index(part)
            elif part.isdigit() and int(part) < len(here):
                key = int(part)
            else:
                known = [str(n) for n in names if n]
                raise _lost(path, part, done, known or [str(k) for k in range(len(here))])
        elif not isinstance(here, dict):
            raise _lost(path, part, done, [])
        elif part not in here and (position < len(parts) - 1 or not part or not done):
            raise _lost(path, part, done, list(here), _ending(data, part) if not done else ())
        if position == len(parts) - 1:
            return here, key
        here = here[key]
        done = f"{done}.{part}" if done else part
    raise AssertionError("unreachable: split gives at least one part")


def _ending(data: Any, part: str, done: str = "") -> list[str]:
    """Every path of a value that ends in a key; where a value is from has the same keys and is none."""
    found = []
    for k, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        key = str(value.get("name", k)) if isinstance(data, list) and isinstance(value, dict) else str(k)
        if key in ("sources", "given", "choices"):
            continue
        found += [f"{done}{key}"] if key == part else []
        found += _ending(value, part, f"{done}{key}.")
    return found


def _lost(path: str, part: str, done: str, known: list[str], elsewhere: Sequence[str] = ()) -> ConfigError:
    where = done or "the tissue"
    bound = f"{where} has no {part!r}"
    if elsewhere:
        return ConfigError(f"{path}: {bound}.", remedy=f"Did you mean {' or '.join(map(repr, elsewhere[:3]))}?")
    remedy = nearest(part, known) or (f"It has: {', '.join(known)}." if known else "It is a single value.")
    return ConfigError(f"{path}: {bound}.", remedy=remedy)


def _overlap(a: str, b: str) -> bool:
    return a == b or a.startswith(f"{b}.") or b.startswith(f"{a}.")


def _plain(value: Any) -> Any:
    if isinstance(value, Spec):
        return _plain(value.model_dump())
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


def _by_name(message: str, data: Any) -> str:
    """Layers by name where the message has them by number."""

    def name(found: re.Match[str]) -> str:
        layers = data.get("layers")
        number = int(found[1])
        layer = layers[number] if isinstance(layers, list) and number < len(layers) else None
        called = layer.get("name") if isinstance(layer, dict) else None
        return f"layers.{called}" if called else found[0]

    return re.sub(r"\blayers\[(\d+)\]", name, message)
