"""The documentation's examples: those marked for it are run, and every other block is at least what it says it is."""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from docs_blocks import ROOT, Block, blocks, compare, follow, pages
from typer.main import get_command

from livlab.cli.app import app

PAGES = pages()
FOLLOWED = [p for p in PAGES if any(b.wish and b.wish[0] == "run" for b in blocks(p))]
COMMAND = get_command(app)
BLOCKS = [b for p in PAGES for b in blocks(p)]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", FOLLOWED, ids=name)
def test_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    assert follow(page, tmp_path) > 0


def test_the_four_walks_through_livlab_are_run() -> None:
    assert {"spectrum.md", "ball.md", "review.md", "index.md", "errors.md"} <= {p.name for p in FOLLOWED}


def test_output_is_compared() -> None:
    block = Block(Path("p.md"), 1, "text", ("output",), "a … c\n…\nlast\n")
    compare(block, "first\na b c\nmore\nlast\n")
    for other in ("a b\nmore\nlast\n", "a b c\nmore\nlost\n", ""):
        with pytest.raises(AssertionError):
            compare(block, other)


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language == "toml"], ids=lambda b: b.place)
def test_toml_is_toml(block: Block) -> None:
    assert tomllib.loads(block.text)


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language == "python"], ids=lambda b: b.place)
def test_python_is_python_and_names_what_there_is(block: Block) -> None:
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("livlab"):
            known = exported(str(node.module))
            assert {a.name for a in node.names} <= known, f"{block.place}: {node.module} has no such name"


def exported(module: str) -> set[str]:
    """Names that a module of livlab defines or imports, by its source alone."""
    path = ROOT / module.replace(".", "/")
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    assert source.is_file(), f"there is no module {module}"
    found = {p.stem for p in path.glob("*.py")} | {p.parent.name for p in path.glob("*/__init__.py")}
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            found |= {a.asname or a.name for a in node.names}
        elif isinstance(node, ast.Name):
            found.add(node.id)
    return found


def commands_shown() -> Iterator[tuple[str, list[str]]]:
    """Every `livlab …` in a block of commands or between backticks, in words."""
    for block in BLOCKS:
        if block.language in {"", "bash", "console"}:
            for line in block.text.replace("\\\n", " ").splitlines():
                if found := re.match(r"^(?:\$ )?(livlab .*?)(?:\s+#.*|\s{3,}.*|\s*[|>&].*)?$", line):
                    yield f"{block.place}: {line}", found[1].split()
    for page in PAGES:
        prose = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for found in re.finditer(r"`(livlab [a-z][^`]*)`", prose):
            yield f"{page.name}: {found[1]}", found[1].split()


def test_every_command_shown_exists() -> None:
    shown = list(commands_shown())
    assert len(shown) > 60
    wrong = [f"{place}: {trouble}" for place, words in shown if (trouble := mistake(words))]
    assert wrong == []


def mistake(words: list[str]) -> str:
    """What is wrong with a command line, or nothing."""
    command: Any = COMMAND
    rest = words[1:]
    while getattr(command, "commands", None) and rest and not rest[0].startswith("-"):
        # An ellipsis or several subcommands at once ("list | show") stand for whatever there is.
        if rest[0] not in command.commands:
            return "" if rest[0] in {"…", "COMMAND"} else f"there is no {rest[0]}"
        command, rest = command.commands[rest[0]], rest[1:]
    options = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    unknown = [w for w in rest if re.match(r"^--?[a-z]", w) and w.split("=")[0].rstrip(".,;") not in options]
    return f"no option {unknown[0]}" if unknown else ""


def test_a_command_that_is_not_there_is_found() -> None:
    assert mistake(shlex.split("livlab rum spectral"))
    assert mistake(shlex.split("livlab run spectral --outt x"))
    assert not mistake(shlex.split("livlab data add FILE --name x --yes"))


def test_make_commands_shown_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in PAGES:
        for target in re.findall(r"(?:^|`)make ([a-z][a-z-]*)", page.read_text(encoding="utf-8"), re.MULTILINE):
            assert target in targets, f"{page.name}: make {target}"
