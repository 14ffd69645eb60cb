"""Where a trouble lies in an experiment file, and what the message says about it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from livlab.config import Section
from livlab.config.errors import allowed_keys, explain, locate, nearest
from livlab.errors import ConfigError, InputError


class Sphere(Section):
    kind: Literal["sphere"] = "sphere"
    port_mm: float = Field(5.0, gt=0)


class Camera(Section):
    kind: Literal["camera"] = "camera"
    angle_deg: float = Field(0.0, ge=0, lt=90)


class Part(Section):
    name: str
    share: float = Field(ge=0, le=1)


class Whole(Section):
    title: str = ""
    part: list[Part] = Field(default_factory=list)
    device: Annotated[Sphere | Camera, Field(discriminator="kind")] = Sphere()
    mode: Literal["fast", "exact"] = "exact"

    @model_validator(mode="after")
    def _sum(self) -> Whole:
        total = sum(p.share for p in self.part)
        if total > 1:
            raise InputError.of("part", total, "the shares must add up to at most 1", "Lower one.")
        return self


def trouble(text: str) -> ConfigError:
    import tomllib

    data = tomllib.loads(text)
    with pytest.raises(ValidationError) as caught:
        Whole.model_validate(data)
    return explain(caught.value, data, text, Whole.model_json_schema(), "a.toml")


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        ("titel = 'x'", "a.toml, line 1: titel = 'x': unknown key.", "Did you mean 'title'?"),
        (
            "[[part]]\nname='a'\nshare=0.1\n[[part]]\nname='b'\n# c\nshar=0.2\nshare=0.1",
            "a.toml, line 7: part[1].shar = 0.2: unknown key.",
            "Did you mean 'share'?",
        ),
        (
            "[[part]]\nname='a'\nshare=-0.1",
            "a.toml, line 3: part[0].share = -0.1: must be greater than or equal to 0.",
            "Give at least 0.0.",
        ),
        ("[[part]]\nname='a'", "a.toml, line 1: part[0].share: the key is missing.", "Add it."),
        (
            "[device]\nkind='camera'\nangle=3",
            "a.toml, line 3: device.angle = 3: unknown key.",
            "Did you mean 'angle_deg'?",
        ),
        (
            "[device]\nkind='camera'\nangle_deg=90",
            "a.toml, line 3: device.angle_deg = 90: must be less than 90.",
            "Give less than 90.0.",
        ),
        (
            "[device]\nkind='spere'",
            "a.toml, line 1: device.kind = 'spere': must be one of 'sphere', 'camera'.",
            "Did you mean 'sphere'?",
        ),
        ("mode = 'Exact'", "a.toml, line 1: mode = 'Exact': must be one of 'fast', 'exact'.", "Did you mean 'exact'?"),
        (
            "[[part]]\nname='a'\nshare=nan",
            "a.toml, line 3: part[0].share = nan: must be a finite number.",
            "Give a finite",
        ),
        ("title = 3", "a.toml, line 1: title = 3: must be a valid string.", "Give a string."),
        (
            "part = [\n {name='a', share=0.7},\n {name='b', share=0.7},\n]",
            "a.toml, line 1: part = 1.4: the shares must add up to at most 1.",
            "Lower one.",
        ),
    ],
)
def test_a_trouble_says_line_path_value_bound_and_remedy(text: str, message: str, remedy: str) -> None:
    error = trouble(text)
    assert error.message == message
    assert error.remedy.startswith(remedy)


def test_all_troubles_are_told_at_once_in_one_message() -> None:
    error = trouble("titel='x'\nmode='f'\n[[part]]\nshare=2.0\nname='a'")
    assert error.message.splitlines()[0] == "a.toml: 3 troubles:"
    assert "line 1: titel" in error.message
    assert "line 4: part[0].share" in error.message
    assert "line 2: mode" in error.message


def test_an_unknown_key_far_from_any_lists_the_known_ones() -> None:
    assert trouble("zzz = 1").remedy == "Known here: title, part, device, mode."


def test_allowed_keys_follow_the_tag_of_a_union() -> None:
    schema: dict[str, Any] = Whole.model_json_schema()
    data = {"device": {"kind": "camera"}, "part": [{}]}
    assert allowed_keys(schema, ("device",), data) == ["kind", "angle_deg"]
    assert allowed_keys(schema, ("part", 0), data) == ["name", "share"]
    assert set(allowed_keys(schema, ("device",), {"device": {}})) == {"kind", "angle_deg", "port_mm"}


def test_lines_are_found_past_multi_line_strings_comments_and_arrays() -> None:
    text = '''a = """
b = 1
[c]
"""
b = [ # [x]
  "]", 'y = 2',
  {z = 1},
]
[ c . "d e" ]
f.g = '#'
[[h]]
[[h]]
i = 1
[h.j]
k = 2
[[h.l]]
m = 3
'''
    lines = locate(text)
    assert lines == {
        ("a",): 1,
        ("b",): 5,
        ("c", "d e"): 9,
        ("c", "d e", "f"): 10,
        ("c", "d e", "f", "g"): 10,
        ("h", 0): 11,
        ("h", 1): 12,
        ("h", 1, "i"): 13,
        ("h", 1, "j"): 14,
        ("h", 1, "j", "k"): 15,
        ("h", 1, "l", 0): 16,
        ("h", 1, "l", 0, "m"): 17,
    }


def test_a_near_miss_ignores_case_and_dashes() -> None:
    assert nearest("Adding_Doubling", ["walk", "adding-doubling"]) == "Did you mean 'adding-doubling'?"
    assert nearest("qqq", ["walk"]) == ""
