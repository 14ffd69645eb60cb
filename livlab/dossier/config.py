"""The dossier's file: which experiments it shows, in which order, and which of the thesis's figures each answers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from livlab.config.load import load_section
from livlab.config.schema import Name, Section, Text
from livlab.errors import InputError

Figure = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,80}$")]
"""Name of a file of a run, without its folder."""
Anchor = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]{0,40}$")]
Line = Annotated[str, Field(min_length=1, max_length=300, pattern=r"^[^\r\n]+$")]


class Ours(Section):
    """Where our number stands: a claim of a run, or a cell of one of its tables."""

    experiment: Name = Field(description="The experiment that has it.")
    claim: Line | None = Field(None, description="A claim, by its name in claims.csv.")
    table: Figure | None = Field(None, description="A table, NAME of NAME.csv.")
    column: str | None = Field(None, description="Its column.")
    error: str | None = Field(None, description="The column of its standard error.")
    where: dict[str, str | float | int] = Field(default_factory=dict, description="The row: columns and their values.")
    scale: float = Field(1.0, description="Factor that brings it to the unit shown.")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.claim is None) == (self.table is None) or (self.table is None) != (self.column is None):
            given = {"claim": self.claim, "table": self.table, "column": self.column}
            raise InputError.of("ours", given, "must name a claim, or a table and its column", "Give one of the two.")
        return self


class Printed(Section):
    """A number that the thesis prints, and ours beside it."""

    what: Line = Field(description="What it is.")
    printed: Line = Field(description="As the thesis prints it, with its unit.")
    unit: str = Field("", max_length=30, description="Unit of ours.")
    ours: Ours | None = Field(None, description="Where our number stands.")
    missing: Text = Field("", description="Why there is none of ours.")
    why: Text = Field("", description="Why the two differ.")

    @model_validator(mode="after")
    def _ours_or_why_not(self) -> Self:
        if (self.ours is None) == (not self.missing):
            raise InputError.of(
                "missing", self.missing, "goes with a number that has no ours, and only then", "Give one of the two."
            )
        return self


class Shown(Section):
    """A figure or pictures of a run."""

    experiment: Name = Field(description="The experiment that has them.")
    figures: dict[Figure, Line] = Field(default_factory=dict, description="Of its figures/, without .svg: captions.")
    pictures: bool = Field(False, description="Its pictures.")


class ThesisAnswer(Section):
    """A figure or table of the thesis, and what answers it."""

    id: Anchor = Field(description="Anchor in the page, e.g. figure-7-2.")
    name: Line = Field(description="What the thesis calls it, e.g. Fig. 7.2.")
    title: Line = Field(description="What it is about, in our words.")
    shows: Text = Field(description="What the thesis's shows, in our words: its images are not ours to copy.")
    show: tuple[Shown, ...] = Field((), strict=False, description="What of ours stands beside it.")
    number: tuple[Printed, ...] = Field((), strict=False, description="Numbers that the thesis prints.")
    deviation: Text = Field("", description="How ours deviates, and why.")
    missing: Text = Field("", description="Why no experiment answers it.")

    @model_validator(mode="after")
    def _answered_or_said(self) -> Self:
        if not self.show and not any(n.ours for n in self.number) and not self.missing:
            raise InputError.of("missing", self.missing, "must say why nothing answers it", "Give `show` or `missing`.")
        return self

    @property
    def experiments(self) -> tuple[str, ...]:
        """Experiments that it needs, in order."""
        named = [s.experiment for s in self.show] + [n.ours.experiment for n in self.number if n.ours]
        return tuple(dict.fromkeys(named))


class Entry(Section):
    """An experiment in its group."""

    name: Name = Field(description="Name of the file in the experiments' folder, without .toml.")
    text: Text = Field("", description="What to look at.")
    figures: dict[Figure, Line] = Field(default_factory=dict, description="Shown on the group's page: captions.")


class Group(Section):
    """Experiments that share a page."""

    id: Anchor = Field(description="Name of the page.")
    title: Line = Field(description="Its heading.")
    short: str = Field("", max_length=20, description="How the menu calls it; its title if not said.")
    text: Text = Field("", description="What it is about.")
    effects: bool = Field(False, description="Whether the page gathers what every run left out.")
    experiment: tuple[Entry, ...] = Field(strict=False, min_length=1, description="In this order.")


class Unrecorded(Section):
    """Claims that a baseline leaves out."""

    claim: Line = Field(description="Pattern of claim names, * for anything.")
    why: Text = Field(min_length=1, description="Why.")


class Dossier(Section):
    """The dossier's file."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this form: 1.")
    title: Line = Field(description="Heading of the site.")
    description: Text = Field("", description="What it is for.")
    folder: Line = Field("..", description="The experiments' folder, from the file's own.")
    group: tuple[Group, ...] = Field((), strict=False, description="Groups of experiments, in order.")
    answer: tuple[ThesisAnswer, ...] = Field((), strict=False, description="The thesis's figures and tables, in order.")
    unrecorded: tuple[Unrecorded, ...] = Field((), strict=False, description="Claims that a baseline leaves out.")

    @model_validator(mode="after")
    def _names_once(self) -> Self:
        listed = [e.name for g in self.group for e in g.experiment]
        for what, names in (
            ("group.id", [g.id for g in self.group]),
            ("answer.id", [a.id for a in self.answer]),
            ("experiment.name", listed),
        ):
            twice = next((n for n in names if names.count(n) > 1), None)
            if twice is not None:
                raise InputError.of(what, twice, "appears twice", "Keep one.")
        reserved = {"index", "thesis", "rest"} & {g.id for g in self.group}
        if reserved:
            raise InputError.of("group.id", min(reserved), "is the name of another page", "Choose another.")
        for answer in self.answer:
            unknown = next((n for n in answer.experiments if n not in listed), None)
            if unknown is not None:
                raise InputError.of(
                    f"answer {answer.id}", unknown, "is in no group", "Add it to one, or mend its name."
                )
        return self


def load_dossier(path: Path | str) -> Dossier:
    """Read and check a dossier's file.

    Raises
    ------
    ConfigError
        It is missing, no TOML, or does not fit the schema.
    """
    return load_section(path, Dossier)


def builtin_dossier() -> Path:
    """The dossier that comes with livlab.

    >>> builtin_dossier().name
    'dossier.toml'
    """
    from livlab.config.load import builtin_experiments

    return next(iter(builtin_experiments().values())).parent / "dossier" / "dossier.toml"


__all__ = ["Dossier", "Group", "Printed", "ThesisAnswer", "builtin_dossier", "load_dossier"]
