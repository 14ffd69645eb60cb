"""The page of errors quotes messages that the code still has."""

from __future__ import annotations

import ast
import re
from functools import lru_cache
from itertools import pairwise

import pytest
from docs_blocks import ROOT

PAGE = ROOT / "docs" / "errors.md"


def quoted() -> list[str]:
    """Messages in tables of a first column `message`, and in quotations."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    found, table = [], False
    for above, line in pairwise(["", *lines]):
        if line.startswith("| message |"):
            table = True
        elif not line.startswith("|"):
            table = False
        elif table and not line.startswith("|---"):
            found.append(re.split(r"(?<!\\)\|", line)[1].strip().strip("`"))
        if line.startswith("> ") and not above.startswith("> "):
            found.append(line.removeprefix("> "))
    return found


@lru_cache
def strings() -> tuple[str, ...]:
    """Every string of the code, what is put in at run time as an ellipsis."""
    made = []
    for path in sorted((ROOT / "livlab").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                made.append(node.value)
            elif isinstance(node, ast.JoinedStr):
                made.append("".join(str(v.value) if isinstance(v, ast.Constant) else "…" for v in node.values))
    return tuple(made)


def in_code(message: str) -> bool:
    pattern = re.compile(".*".join(map(re.escape, message.split("…"))), re.DOTALL)
    return any(pattern.search(text) for text in strings())


def test_the_page_quotes_many() -> None:
    assert len(quoted()) >= 25


@pytest.mark.parametrize("message", quoted())
def test_quoted_message_is_in_the_code(message: str) -> None:
    assert in_code(message), f"no error of livlab says {message!r} any more: mend docs/errors.md"


def test_a_message_that_nobody_says_is_found() -> None:
    assert not in_code("wavelengths must fall")
    assert not in_code("No usable libLLVM found (need … or older)")
