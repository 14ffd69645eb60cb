"""Another model of a fit: a variant of the tissue, another reading, values and parameters of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

from pydantic import Field, model_validator

from livlab.config.schema import Label, Section, Text
from livlab.errors import InputError
from livlab.kinds.fit.config_parameter import FitParameter
from livlab.model.tissue.presets import TissueSpec, read_preset
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.tissue import Tissue, override, value_at


class Alternative(Section):
    """A model that is fitted beside the one of the file, with the same parameters where it has them."""

    name: Label = Field(description="How tables call it, e.g. no capsule.")
    description: Text = Field("", description="What it is.")
    variant: str | None = Field(None, description="Variant of the preset; the file's if not said.")
    layers: tuple[str, ...] | None = Field(
        None, strict=False, min_length=1, description="Layers that it keeps, in place of a variant."
    )
    reading: Reading | None = Field(None, description="How the tissue is read; as in the file if not said.")
    set: dict[str, Any] = Field({}, description="Values by path that it changes; a parameter set here is not fitted.")
    parameter: tuple[FitParameter, ...] = Field(
        (), strict=False, max_length=30, description="Parameters that it has beside the file's, or in their place."
    )
    inline: Tissue | None = Field(None, description="Its tissue written out, in place of variant, layers and set.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.variant is not None and self.layers is not None:
            raise InputError.of(
                f"alternative {self.name}.layers", self.layers, "cannot stand beside a variant", "Drop one."
            )
        if self.inline is not None and (self.variant or self.layers):
            raise InputError.of(
                f"alternative {self.name}.inline",
                self.inline.name,
                "cannot stand beside variant or layers",
                "Drop one.",
            )
        return self

    def tissue(self, base: TissueSpec) -> Tissue:
        """Its tissue, from the file's.

        Raises
        ------
        ConfigError
            A variant, layer or path that there is none of.
        """
        if self.inline is not None:
            return override(self.inline, self.set, by=self.by) if self.set else self.inline
        made = base.build() if self.variant is None else self._variant(base)
        if self.layers is not None:
            made = made.with_layers(self.layers)
        return override(made, self.set, by=self.by) if self.set else made

    @property
    def by(self) -> str:
        """Who changes the tissue, for its table."""
        return f"alternative {self.name}"

    def resolve(self, base: TissueSpec) -> Alternative:
        """The same with its tissue written out; what is set stays named, since parameters give way to it."""
        if self.inline is not None:
            return self
        return self.model_copy(update={"inline": self.tissue(base), "variant": None, "layers": None})

    def _variant(self, base: TissueSpec) -> Tissue:
        """The variant with all that the file sets, also in layers that its own variant lacks or this one does."""
        if base.inline is not None:
            raise InputError.of(
                f"alternative {self.name}.variant", self.variant, "belongs to a preset, and the tissue is written out",
                "Say layers = [...] instead.",
            )  # fmt: skip
        preset = read_preset(base.preset or "liver")
        whole = base.model_copy(update={"variant": "whole"}).build()
        kept = preset.build(base.state, self.variant or "whole")  # refuses a variant that there is none of
        return whole.with_layers(tuple(layer.name for layer in kept.layers)).model_copy(update={"name": kept.name})


def has(tissue: Tissue, path: str) -> bool:
    """Whether a path leads to a number of a tissue that can be moved."""
    try:
        value = value_at(tissue, path)
    except InputError:
        return False
    return isinstance(value, float)


def lacking(
    tissue: Tissue, parameters: Sequence[FitParameter], alternative: Alternative
) -> tuple[list[FitParameter], list[str]]:
    """The parameters that an alternative shares with the file, and what to say of the others."""
    own = {p.path for p in alternative.parameter}
    kept, said, gone = [], [], set()
    for p in parameters:
        if p.path in own:
            continue
        if p.path in alternative.set:
            said.append(f"sets {p.name} to {alternative.set[p.path]}")
        elif not has(tissue, p.path):
            said.append(f"has no {p.name}")
        else:
            kept.append(p)
            continue
        gone.add(p.name)
    led = [p for p in kept if p.tied in gone]
    said += [f"does not fit {p.name}, which follows {p.tied}" for p in led]
    return [p for p in kept if p not in led], said


__all__ = ["Alternative", "has", "lacking"]
