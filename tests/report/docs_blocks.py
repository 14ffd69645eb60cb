"""Fenced blocks of a Markdown page, and what the comment above each says is to be done with it.

<!-- run -->          run it (bash or python); `run exit=2` if it must end so
<!-- file NAME -->    write it to a file
<!-- output -->       the command above must have printed these lines; … stands for anything, alone for any lines
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)[^\n]*$")
_WISH = re.compile(r"^ *<!-- (?P<wish>(run|file|output)\b[^>]*?) -->$")


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    page: Path
    line: int
    language: str
    wish: tuple[str, ...]
    text: str

    @property
    def place(self) -> str:
        return f"{self.page.name}, line {self.line}"

    @property
    def exit_code(self) -> int:
        return next((int(w.removeprefix("exit=")) for w in self.wish if w.startswith("exit=")), 0)


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path) -> Iterator[Block]:
    lines = page.read_text(encoding="utf-8").split("\n")
    wish: tuple[str, ...] = ()
    k = 0
    while k < len(lines):
        if found := _WISH.match(lines[k]):
            wish = tuple(found["wish"].split())
        elif found := _FENCE.match(lines[k]):
            indent, start = len(found["indent"]), k + 1
            k = start
            while not lines[k].strip().startswith("```"):
                k += 1
            yield Block(page, start, found["language"], wish, "\n".join(x[indent:] for x in lines[start:k]) + "\n")
            wish = ()
        elif lines[k].strip():
            wish = ()
        k += 1


def follow(page: Path, folder: Path) -> int:
    """Do what the page's blocks ask for, in order, in a folder; the number of blocks run."""
    environment = surroundings(folder)
    printed: str | None = None
    count = 0
    for block in blocks(page):
        if not block.wish:
            continue
        kind = block.wish[0]
        if kind == "file":
            path = folder / block.wish[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif kind == "run":
            printed = run(block, folder, environment)
            count += 1
        elif printed is not None:
            compare(block, printed)
    return count


def surroundings(folder: Path) -> dict[str, str]:
    """An environment in which `livlab` is the one on trial, and the user's own data are not touched."""
    own = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "200", "NO_COLOR": "1"}
    return {**os.environ, **own, "LIVLAB_DATA": str(folder / ".data"), "MPLBACKEND": "agg"}


def run(block: Block, folder: Path, environment: Mapping[str, str]) -> str:
    shell = ["bash", "-euo", "pipefail", "-c", block.text]
    command = {"bash": shell, "python": [sys.executable, "-c", block.text]}[block.language]
    done = subprocess.run(
        command, cwd=folder, env=dict(environment), capture_output=True, text=True, timeout=1800, check=False
    )
    said = f"{block.place}\n{done.stdout}\n{done.stderr}"
    assert done.returncode == block.exit_code, f"ended with {done.returncode}: {said}"
    return done.stdout + (done.stderr if block.exit_code else "")


def compare(block: Block, printed: str) -> None:
    """Hold an output block against what was printed, spaces at the end of lines aside."""
    parts = [".*".join(map(re.escape, line.rstrip().split("…"))) for line in block.text.rstrip().split("\n")]
    pattern = "".join(r"(?:[^\n]*\n)*?" if part == ".*" else f"{part} *\n" for part in parts)
    assert re.search(rf"(?:^|\n){pattern}", printed.rstrip() + "\n"), (
        f"{block.place} shows\n{block.text}\nbut\n{printed}"
    )
