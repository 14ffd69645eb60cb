"""The catalogue of hard cases: what is run, what is trusted, and what must hold.

`catalogue.toml` is written by people: inputs, rules, and where each trusted value comes from. `trusted.csv`
holds the values themselves, computed from the same inputs (docs/stress.md).
"""

from __future__ import annotations

import csv
import fnmatch
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from livlab.errors import InputError
from livlab.units import FloatArray

CATALOGUE = Path(__file__).with_name("catalogue.toml")
TRUSTED = Path(__file__).with_name("trusted.csv")
COLUMNS = ("case", "quantity", "index", "value", "by")

Rule = Literal["relative", "absolute", "sigma", "at least", "at most"]
"""|difference| at most allowed·|trusted|, at most allowed, at most allowed·σ; or a bound, allowed·σ to spare."""


class Expectation(BaseModel):
    """What must hold of one quantity of a case."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    quantity: str = Field(min_length=1, description="Name of a result of the case's runner.")
    value: float | None = Field(None, description="Trusted value where it is plain: a bound, a count, an identity.")
    by: str = Field("", description="Why that value holds; for computed ones, the reference that computes it.")
    reference: str = Field("", description="Function that computes the value (docs/stress.md).")
    of: str = Field("", description="The reference's quantity, if it has another name.")
    rule: Rule = Field("absolute", description="How the allowance is meant.")
    allowed: float = Field(0.0, ge=0.0, description="The allowance, in the rule's measure.")
    power: float | None = Field(None, gt=0.0, description="sigma: largest standard error that shows anything.")

    @model_validator(mode="after")
    def _whole(self) -> Expectation:
        if (self.value is None) == (not self.reference):
            raise InputError.of(self.quantity, self.value, "needs a value or a reference, not both", "Give one.")
        if self.value is not None and not self.by:
            raise InputError.of(self.quantity, self.value, "must say why it is trusted (by)", "Give the reason.")
        if (self.rule == "sigma") != (self.power is not None):
            raise InputError.of(
                self.quantity, self.power, "power belongs to the rule sigma, which needs it", "Mend it."
            )
        return self

    @property
    def name(self) -> str:
        """The reference's name of the quantity."""
        return self.of or self.quantity


class Case(BaseModel):
    """One hard case."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: str = Field(min_length=1, description="Topic and name, `mie/strong absorption`.")
    what: str = Field(min_length=1, description="What is hard about it, in a sentence.")
    run: str = Field(min_length=1, description="Runner.")
    args: dict[str, Any] = Field(default={}, description="Its arguments.")
    reference_args: dict[str, Any] | None = Field(None, description="The reference's arguments, if they differ.")
    sweep: str = Field("", description="Argument that counts the values up, for the table.")
    slow: bool = Field(False, description="Left out unless asked for.")
    expect: list[Expectation] = Field(min_length=1, description="What must hold.")

    @property
    def topic(self) -> str:
        """The part of the name before the slash."""
        return self.name.partition("/")[0]

    @property
    def trusted_args(self) -> dict[str, Any]:
        """Arguments of its references."""
        return self.args if self.reference_args is None else self.reference_args

    def label(self, index: int) -> str:
        """Where in its sweep a value lies."""
        values = self.args.get(self.sweep)
        return f"{self.sweep} = {values[index]!r}" if isinstance(values, list) and index < len(values) else ""


@cache
def cases() -> tuple[Case, ...]:
    """Every case of the catalogue, in its order.

    Raises
    ------
    InputError
        A name that appears twice.
    """
    data = tomllib.loads(CATALOGUE.read_text(encoding="utf-8"))
    found = tuple(Case.model_validate(entry) for entry in data["case"])
    names = [case.name for case in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError.of("case.name", twice, "appears twice", "Rename one.")
    return found


def select(pattern: str | None = None, *, slow: bool = False) -> tuple[Case, ...]:
    """The case of that name, or the cases whose name holds or matches a pattern, slow ones if asked for.

    Raises
    ------
    InputError
        If none does.

    Examples
    --------
    >>> {case.topic for case in select("fresnel")}
    {'fresnel'}
    """
    low = (pattern or "").lower()
    exact = tuple(c for c in cases() if c.name.lower() == low)
    found = exact or tuple(
        c for c in cases() if (low in c.name.lower() or fnmatch.fnmatch(c.name.lower(), low)) and (slow or not c.slow)
    )
    if not found:
        topics = ", ".join(dict.fromkeys(c.topic for c in cases()))
        raise InputError.of("only", pattern, "matches no case", f"Topics: {topics}.")
    return found


@cache
def trusted_values() -> dict[tuple[str, str], tuple[FloatArray, str]]:
    """(case, quantity) → its trusted values in the order of the sweep, and how they came about."""
    values: dict[tuple[str, str], list[float]] = {}
    how: dict[tuple[str, str], str] = {}
    with TRUSTED.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            key = (row["case"], row["quantity"])
            values.setdefault(key, []).append(float(row["value"]))
            how[key] = row["by"]
    return {key: (np.array(found), how[key]) for key, found in values.items()}


def trusted(case: Case, expectation: Expectation) -> tuple[FloatArray, str]:
    """Trusted values of one expectation and where they come from.

    Raises
    ------
    InputError
        If the value was never computed.
    """
    if expectation.value is not None:
        return np.array([expectation.value]), expectation.by
    found = trusted_values().get((case.name, expectation.quantity))
    if found is None:
        raise InputError.of(
            f"{case.name}: {expectation.quantity}",
            None,
            "is not in trusted.csv",
            "Run python -m tests.helpers.trusted_values.",
        )
    return found
