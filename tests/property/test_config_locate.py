"""The line finder against the TOML reader, on files that nobody wrote by hand."""

from __future__ import annotations

import tomllib
from typing import Any

import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.config.errors import Path, locate

KEY = st.text("abcXYZ019_-", min_size=1, max_size=4)
LEAF = st.one_of(
    st.integers(-9, 9),
    st.booleans(),
    st.text("ab[]{}=#'\"\\\n. ", max_size=12),
    st.lists(st.text("a]['\"#", max_size=3), max_size=3),
)
TABLE = st.recursive(
    st.dictionaries(KEY, LEAF, max_size=3),
    lambda inner: st.dictionaries(KEY, st.one_of(LEAF, inner, st.lists(inner, min_size=1, max_size=3)), max_size=3),
    max_leaves=12,
)


def value_at(data: Any, path: Path) -> Any:
    for part in path:
        data = data[part]
    return data


@settings(max_examples=200, deadline=None)
@given(TABLE, st.booleans())
def test_every_line_found_holds_the_key_it_is_found_for(data: dict[str, Any], multiline: bool) -> None:
    text = tomli_w.dumps(data, multiline_strings=multiline)
    parsed = tomllib.loads(text)
    lines = text.split("\n")
    found = locate(text)
    for path, number in found.items():
        value_at(parsed, path)
        key = next(part for part in reversed(path) if isinstance(part, str))
        assert key in lines[number - 1]
    for key, value in data.items():
        if not isinstance(value, (dict, list)):
            assert (key,) in found
