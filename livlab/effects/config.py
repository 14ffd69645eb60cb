"""What an experiment file says of effects: `effects = "auto"`, or a table with a tolerance and effects forced."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from livlab.config.errors import nearest
from livlab.errors import ConfigError, InputError

Force = Literal["on", "off", "auto"]
"""`on`: simulated whatever it changes; `off`: left out whatever it changes; `auto`: the plan decides."""


class EffectsConfig(BaseModel):
    """Which effects are simulated. In a file `effects = "auto"` or `effects = "all"` stands for the table's `mode`.

    Every other key of the table is the name of an effect (`livlab plan FILE` lists them), or a pattern of names with
    `*`, and forces it: `capsule = "off"`. A name goes before a pattern, and an earlier pattern before a later one.

    Examples
    --------
    >>> EffectsConfig.model_validate({"capsule": "off", "tolerance": 0.01}).forced
    {'capsule': 'off'}
    """

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False, strict=True)
    __pydantic_extra__: dict[str, Force] = Field(init=False)

    mode: Literal["all", "auto"] = Field(
        "auto", description="all: every effect but those forced off; auto: what the scene calls for."
    )
    tolerance: float = Field(
        0.002, gt=0.0, le=1.0, description="How far the instrument's value may move at any wavelength."
    )
    tolerance_of: Literal["value", "maximum"] = Field(
        "value", description="Unit of the tolerance: the instrument's value itself, or the maximum of its curve."
    )

    @model_validator(mode="before")
    @classmethod
    def _from_word(cls, data: Any) -> Any:
        return {"mode": data} if isinstance(data, str) else data

    @property
    def forced(self) -> dict[str, Force]:
        """Names and patterns of the effects that are forced."""
        return dict(self.__pydantic_extra__ or {})


def forced_effects(names: list[str], forced: Mapping[str, Force]) -> dict[str, Force]:
    """What each effect is forced to, by its name.

    Raises
    ------
    InputError
        A value that is none of on, off and auto.
    ConfigError
        A name or pattern that no effect of the scene has.
    """
    for key, value in forced.items():
        if value not in ("on", "off", "auto"):
            raise InputError.of(f"effects.{key}", value, "must be 'on', 'off' or 'auto'", "Pick one.")
        if not any(fnmatchcase(n, key) for n in names):
            hint = nearest(key, names) or "`livlab plan FILE` lists the effects of a scene."
            raise ConfigError.of(f"effects.{key}", value, "the scene has no such effect", hint)
    found: dict[str, Force] = {}
    for name in names:
        by_pattern = [v for k, v in forced.items() if fnmatchcase(name, k)]
        if by_pattern and (rule := forced.get(name, by_pattern[0])) != "auto":
            found[name] = rule
    return found
