"""Presets: tissues as files, with their states and variants. Another organ is another file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError, model_validator

from livlab.config.errors import explain, nearest
from livlab.core.files import readable
from livlab.core.toml_text import parse_toml
from livlab.errors import ConfigError, InputError
from livlab.model.tissue.spectra import Spec
from livlab.model.tissue.tissue import Tissue, override

LARGEST_BYTES = 1 << 20
"""A preset file is some pages."""

_REMEDY = "Name a preset file (TOML)."


class State(Spec):
    """A state of a tissue: what it sets, by path."""

    description: str = Field("", description="What the state is, and where its numbers came from.")
    set: dict[str, Any] = Field({}, description="Value by path.")


class Variant(Spec):
    """Some of a tissue's layers."""

    description: str = Field("", description="What the variant is.")
    layers: tuple[str, ...] = Field(strict=False, min_length=1, description="Names of the layers it keeps.")


class Preset(Spec):
    """A preset file: a tissue, its states and variants."""

    default_state: str = Field(description="State it is in unless another is asked for.")
    states: dict[str, State] = Field(min_length=1, description="States by name.")
    variants: dict[str, Variant] = Field({}, description="Variants by name, beside `whole`.")
    tissue: Tissue = Field(description="The tissue, in the state that sets nothing.")

    @model_validator(mode="after")
    def _default_known(self) -> Preset:
        if self.default_state not in self.states:
            raise InputError.of(
                "default_state", self.default_state, f"must be one of {', '.join(self.states)}", "Pick one."
            )
        return self

    def build(self, state: str | None = None, variant: str = "whole") -> Tissue:
        """The tissue in a state, whole or some of its layers.

        Raises
        ------
        ConfigError
            An unknown state or variant.
        """
        name = self.default_state if state is None else state
        if name not in self.states:
            raise _unknown("state", name, list(self.states))
        made = self.tissue.model_copy(update={"state": name})
        if self.states[name].set:
            made = override(made, self.states[name].set, by=f"state {name}")
        if variant == "whole":
            return made
        if variant not in self.variants:
            raise _unknown("variant", variant, ["whole", *self.variants])
        kept = made.with_layers(self.variants[variant].layers)
        return kept.model_copy(update={"name": f"{made.name}, {variant.replace('_', ' ')}"})


def preset_names() -> tuple[str, ...]:
    """Names of the presets that come with livlab, sorted.

    >>> "liver" in preset_names()
    True
    """
    folder = resources.files("livlab.model.tissue") / "preset_files"
    return tuple(sorted(x.name.removesuffix(".toml") for x in folder.iterdir() if x.name.endswith(".toml")))


def read_preset(name: str | Path) -> Preset:
    """A preset by name, or from a file of one's own (a path that ends in .toml).

    Raises
    ------
    ConfigError
        An unknown name, or a file that is missing, not TOML, or does not fit.
    """
    if isinstance(name, Path) or name.endswith(".toml"):
        path = Path(name)
        try:
            text = readable(path, "preset", LARGEST_BYTES, _REMEDY, ConfigError).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path} cannot be read: {error}.", remedy=_REMEDY) from None
        source = str(path)
    else:
        known = preset_names()
        if name not in known:
            raise _unknown("preset", name, list(known))
        text = (resources.files("livlab.model.tissue") / "preset_files" / f"{name}.toml").read_text(encoding="utf-8")
        source = f"preset {name}"
    try:
        data = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source}: not TOML: {error}.", remedy="Mend the line.") from None
    try:
        return Preset.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, text, Preset.model_json_schema(), source) from None


def load_preset(
    name: str | Path, *, state: str | None = None, variant: str = "whole", changes: Mapping[str, Any] | None = None
) -> Tissue:
    """A preset tissue in a state, whole or in part, with single values changed by path.

    Parameters
    ----------
    name
        Preset ("liver"), or the path of a preset file.
    state
        "ex_vivo", "in_vivo", "steatosis" for the liver; the preset's default if not said.
    variant
        "whole", "capsule_only", "parenchyma_only" for the liver.
    changes
        Value by path, see `livlab.model.tissue.tissue.override`.

    Raises
    ------
    ConfigError
        An unknown preset, state, variant or path, or a value that does not fit.

    Examples
    --------
    >>> load_preset("liver", state="in_vivo").layers[1].elements["blood"].oxygenation
    0.9
    """
    made = read_preset(name).build(state, variant)
    return override(made, changes) if changes else made


class TissueSpec(Spec):
    """A tissue as an experiment file names it: a preset with changes, or a tissue written out (`inline`)."""

    preset: str | None = Field(None, description="Preset by name, or a preset file; liver if neither is given.")
    state: str | None = Field(None, description="State of the preset.")
    variant: str = Field("whole", description="Variant of the preset.")
    set: dict[str, Any] = Field({}, description="Value by path, e.g. layers.parenchyma.elements.blood.oxygenation.")
    inline: Tissue | None = Field(None, description="A tissue written out, in place of a preset.")

    @model_validator(mode="after")
    def _one_source(self) -> TissueSpec:
        if self.inline is not None and (self.preset is not None or self.state is not None or self.variant != "whole"):
            raise InputError.of("inline", self.inline.name, "cannot be given beside a preset", "Drop one of them.")
        return self

    def build(self) -> Tissue:
        """The tissue.

        Raises
        ------
        ConfigError
            See `load_preset`.
        """
        if self.inline is not None:
            return override(self.inline, self.set) if self.set else self.inline
        return load_preset(self.preset or "liver", state=self.state, variant=self.variant, changes=self.set)

    def resolve(self) -> TissueSpec:
        """The same tissue written out in full; resolving twice changes nothing."""
        return TissueSpec(inline=self.build())


def _unknown(what: str, name: str, known: list[str]) -> ConfigError:
    hint = nearest(name, known)
    return ConfigError(f"{what} = {name!r}: must be one of {', '.join(known)}.", remedy=hint or "Pick one.")
