"""What every experiment file has (schema, kind, name, title, seed), and the form of each of its tables."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

SCHEMA = 1
"""Version of the experiment file's form that this livlab reads."""

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Text = Annotated[str, StringConstraints(max_length=4000)]
Label = Annotated[str, StringConstraints(pattern=r"^\S(.{0,78}\S)?$")]


class Section(BaseModel):
    """A table of an experiment file: no key it does not know, no nan, no value of another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True, populate_by_name=True)


S = TypeVar("S", bound=Section)


class Experiment(Section):
    """What every experiment file says, whatever its kind."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this form: 1.")
    name: Name = Field(description="Names the run folder: letters, digits, '-' and '_', at most 64.")
    title: Text = Field("", description="Heading of the report.")
    description: Text = Field("", description="What the experiment is for; shown in the report.")
    seed: int = Field(1, ge=0, lt=2**31, description="Seed of every random draw.")

    def resolve(self) -> Self:
        """The same experiment with every default, preset and name written out; resolving twice changes nothing."""
        return self

    def datasets(self) -> tuple[str, ...]:
        """Names of the datasets whose content decides the result, sorted."""
        return ()

    def plain(self) -> dict[str, Any]:
        """As TOML's own types, the keys that are unset left out."""
        plain: dict[str, Any] = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        return plain
